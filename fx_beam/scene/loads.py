"""Loads, pressure, drag, natural strains, shaken bases and initial velocities, as plain data."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam import errors
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import IS_DATA, LARGEST, SceneError, as_float, is_one_of, require, shown, vector
from fx_beam.symbolic import Expr, ufl

from . import functions
from .beam import Beam, BeamPlace, Node, no_node
from .functions import ArrayCalls, Input, Signal, SignalAlong, check_takes_time, time_function
from .parameters import is_parameter, refused

if TYPE_CHECKING:
    from .ufl_symbols import Parameter


# -- Loads, drag, natural strains, initial velocities and added virtual works, as plain data ----


#: Names of the coefficients of drag.
PARTS_OF_DRAG = "linear", "quadratic", "rotation"
#: Kinds of loads on all masses, by accelerations [m/s^2]: their directions, and their sign.
ON_MASSES = {"gravity": ([0, 1], 1.0)}
ON_MASSES |= {"shaking along x": ([0], -1.0), "shaking along y": ([1], -1.0)}
# What the function of a line load may be of.
_OF = "time", "arc length", "arc length and time", "projected length"

#: Names of the components in results.
NAMES = {name: f"natural {name} strain" for name in ("axial", "shear")}
NAMES["curvature"] = "natural curvature"


def values_along(function: Signal, positions: np.ndarray, arrays: ArrayCalls | None) -> MaybeDual:
    """Finite values (n, size) of a function of position at n positions; SceneError otherwise."""
    values = function.each(positions[:, None], arrays)
    if not (abs(floats(values)) <= LARGEST).all():
        for x, value in zip(positions.tolist(), values, strict=True):
            vector(value, function.size, f"{function.what} at {function.place} = {x:g}")
    return values


class Mass(NamedTuple):
    """A lumped mass: number of the node, mass [kg] and moment of inertia [kg m^2]."""

    node: int
    mass: float
    inertia: float


@dataclass(frozen=True, eq=False)
class Load:
    """A load on a node, along a beam, or on all masses."""

    #: "force", "moment", "line load", or one of `ON_MASSES`.
    kind: str
    #: What it acts on; None for all masses.
    target: Node | Beam | BeamPlace | None
    #: ``value(t)``: [fx, fy] in N, [moment] in N m, or [qx, qy] in N per metre of reference length;
    #: a `SignalAlong` of arc length and time; of all masses accelerations in m/s^2.
    value: Signal = field(metadata=IS_DATA)
    #: Whether a force turns with the section of its node.
    follower: bool = False
    #: Arc lengths [m] between which a line load acts; None for all of the beam.
    between: tuple[float, float] | None = None
    #: Whether a line load is per length seen along it.
    projected: bool = False

    def __str__(self):
        if self.target is None:
            return self.kind
        return f"{'follower ' if self.follower else ''}{self.kind} on {label(self.target)}"


def line_load(beam: Beam, load, arguments: str, between: Sequence[float] | None = None) -> Load:
    """Line load on a beam, or on a part of it.

    A constant, its values at both ends, or a function of time, of the arc length, or of both.
    """
    name = f"line load on {label(beam)}"
    expected = "'time' or 'arc length', or 'arc length and time' for a function of both"
    expected += ", or 'projected length' for a load by this"
    require(is_one_of(arguments, _OF), f"{name}: of", arguments, expected)
    part = None if between is None else part_of(beam, between, arguments, name)
    value = _line_signal(beam, load, arguments, part or (0.0, beam.length), name)
    is_projected = arguments == "projected length"
    return Load("line load", beam, value, between=part, projected=is_projected)


def _line_signal(beam: Beam, load, arguments: str, part: tuple[float, float], name: str) -> Signal:
    """The load per length (2,) of a part of a beam, as a function of its `arguments`."""
    rows, is_row = (list, tuple, np.ndarray), getattr(load, "ndim", 1) > 0
    if isinstance(load, rows) and is_row and all(isinstance(value, rows) for value in load):
        return _between_ends(load, part, name)
    if arguments in ("time", "projected length"):
        check_takes_time(load, name)
        return time_function(load, 2, name)
    names, called = functions.argument_names(load), "s, t" if arguments.endswith("time") else "s"
    if names and names[0].lower() in ("t", "time"):
        raise SceneError(
            f"{name}: the function takes ({', '.join(names)}), but it is called with ({called}), "
            f"the arc length first: give lambda {called}: ... A function of time has of='time'"
        )
    if arguments == "arc length and time":
        return SignalAlong(load, 2, name, beam.length, "s")
    return functions.function_of_place(load, 2, name, "s")


def part_of(beam: Beam, between: Sequence[float], arguments: str, name: str) -> tuple[float, float]:
    """Both ends of a part of a beam; SceneError if there is no such part."""
    first, last = vector(between, 2, f"{name}: between").tolist()
    tolerance = 1e-9 * beam.length
    ok = -tolerance <= first < last <= beam.length + tolerance
    expected = f"two arc lengths in order, from 0 to the length of the beam, {beam.length:g}"
    require(ok, f"{name}: between", between, expected)
    if arguments == "arc length and time":
        raise SceneError(
            f"{name}: between is for loads that are constant, functions of time or of the arc "
            "length. Let the function of both be zero where nothing acts"
        )
    return max(first, 0.0), min(last, beam.length)


def _between_ends(load, part: tuple[float, float], name: str) -> Signal:
    """The signal of a load that changes in proportion to the arc length, by its end values."""
    require(len(load) == 2, name, load, "a load (qx, qy), or those at both ends")
    first, last = (vector(value, 2, f"{name}: an end") for value in load)
    start, length = part[0], part[1] - part[0]

    def load_at(s):
        x = (s - start) / length
        return tuple(a + (b - a) * x for a, b in zip(first, last, strict=True))

    return functions.function_of_place(load_at, 2, name, "s")


def changed(load: Load, value) -> Load:
    """The load with another value, of the same kind."""
    if isinstance(load.target, Beam):
        arguments = "arc length" if load.value.place else "time"
        arguments += " and time" * isinstance(load.value, SignalAlong)
        arguments = "projected length" if load.projected else arguments
        return line_load(load.target, value, arguments, load.between)
    size = 1 if load.kind == "moment" else 2
    return replace(load, value=time_function(value, size, str(load)))


def not_negative(value, name: str) -> float:
    """A number that is zero or positive; SceneError otherwise."""
    number = as_float(value)
    if not abs(number) <= LARGEST:
        (number,) = vector(value, 1, name)
    ok = number == 0 or number >= 1 / LARGEST
    require(ok, name, value, "zero or positive")
    return as_float(number)


@dataclass(frozen=True, eq=False)
class Drag:
    """Drag on a beam, per length, or on a node.

    Coefficients have one entry for all directions, or two: along and across the beam.
    """

    target: Node | Beam
    #: Force per speed [N s/m] and per its square [N s^2/m^2].
    linear: np.ndarray = field(metadata=IS_DATA)
    quadratic: np.ndarray = field(metadata=IS_DATA)
    #: Moment per spin [N m s/rad].
    rotation: np.ndarray = field(metadata=IS_DATA)

    def __post_init__(self):
        prefix = f"drag on {label(self.target)}"
        for name in PARTS_OF_DRAG:
            value, subject = getattr(self, name), f"{prefix}: {name}"
            pair = isinstance(value, list | tuple | np.ndarray)
            pair = pair and errors.real_array(value).shape == (2,)
            may_be = isinstance(self.target, Beam) and name != "rotation"
            expected = "one number; only a beam has directions along and across, for its velocity"
            require(may_be or not pair, subject, value, expected)
            coefficients = vector(value, 2 if pair else 1, subject)
            expected = "zero or positive; for a force along the motion there is add_virtual_work"
            require(coefficients.min() >= 0, subject, value, expected)
            object.__setattr__(self, name, coefficients)
        if not any(getattr(self, name).any() for name in PARTS_OF_DRAG):
            raise SceneError(f"{prefix}: give linear, quadratic or rotation, not all zero")


@dataclass(frozen=True, eq=False)
class Damping:
    """Damping in proportion to all masses [1/s] and to the stiffness of all beams [s]."""

    mass: float = field(metadata=IS_DATA)
    stiffness: float = field(metadata=IS_DATA)


def damping_of(scene) -> list[float]:
    """Factors of the mass [1/s] and of the stiffness of beams [s] in all damping of a scene."""
    if not scene.dampings:
        return [0.0, 0.0]
    return dual_array([(part.mass, part.stiffness) for part in scene.dampings]).sum(axis=0).tolist()


@dataclass(frozen=True)
class Velocity:
    """Initial velocity (2,) [m/s] and spin [rad/s] of a node, or of all nodes of a beam."""

    target: Node | Beam
    value: Signal = field(metadata=IS_DATA)
    spin: Signal = field(metadata=IS_DATA)


def initial_velocity(target: Node | Beam, velocity, spin) -> Velocity:
    """Initial velocity and spin: constants, or functions of the reference position."""
    node = target.start if isinstance(target, Beam) else target
    owner = f"of {label(target)}"
    return Velocity(
        target,
        functions.checked_function(velocity, 2, f"velocity {owner}", node.x, node.y),
        functions.checked_function(spin, 1, f"spin {owner}", node.x, node.y),
    )


@dataclass(frozen=True, eq=False)
class VirtualWork:
    """Virtual work per length of a user's force or a pressure, on one beam or on all."""

    term: Callable[..., Expr] = field(metadata=IS_DATA)
    beam: Beam | None
    #: The first and the last but one of the elements of the beam in which it acts.
    elements: tuple[int, int | None] = (0, None)
    #: Names of the parameters that it has alone: of a pressure its value.
    own: tuple[str, ...] = ()

    def __post_init__(self):
        if not callable(self.term):
            raise SceneError(f"add_virtual_work needs a function of the step, not {self.term!r}")

    def of(self, step: object, name: str) -> Expr:
        """The term of a step, in UFL; SceneError if there is none."""
        with refused(
            f"{name} must give a UFL expression of the step, which has UFL symbols, not numbers: "
            "use ufl.sin, ufl.conditional, ... in place of functions of math and NumPy, and "
            "fx_beam.Parameter for a number that changes: Parameter(name, 3.0), "
            'Parameter(name, lambda t: ...), or Parameter(name, fx_beam.Input("valve"))'
        ):
            return ufl.as_ufl(self.term(step))


def label(target: Node | Beam | BeamPlace) -> str:
    """Name of a node, beam or place in messages."""
    return f"beam {target.name!r}" if isinstance(target, Beam) else str(target)


def check_node(scene, node, name: str) -> None:
    """Refuse a value that is not a node of the scene."""
    if not isinstance(node, Node):
        raise SceneError(f"{name}: {no_node(node)}")
    node_scene: Any = node.scene
    if node_scene is not scene:
        raise SceneError(f"{name}: {node} belongs to another scene; take a node of this one")
    if node.number in node_scene.gone:
        raise SceneError(f"{name}: {node} was taken away with its member; take another node")


def check_place(scene, place, name: str) -> None:
    """Refuse a value that is neither a node of the scene nor a place on one of its beams."""
    if isinstance(place, BeamPlace):
        check_beam(scene, place.beam, name)
    else:
        check_node(scene, place, name)


def check_beam(scene, beam, name: str) -> None:
    """Refuse a value that is not a beam of the scene."""
    if not isinstance(beam, Beam):
        raise SceneError(f"{name}: {shown(beam)} is not a beam; take one that add_beam returned")
    if not scene.beams.has(beam) or beam.start.scene is not scene:
        raise SceneError(f"{name}: {label(beam)} belongs to another scene; take a beam of this one")


def check_target(scene, target, name: str) -> None:
    """Refuse a value that is neither a beam nor a node of the scene."""
    check = check_beam if isinstance(target, Beam) else check_node
    check(scene, target, name)


@dataclass(frozen=True, eq=False)
class NaturalStrain:
    """Natural strains of a beam by their names, of "axial", "shear" and "curvature"."""

    beam: Beam
    #: Functions of the time, of the fraction of the arc length, or of both, with values (1,).
    parts: Mapping[str, Signal] = field(metadata=IS_DATA)

    def __str__(self):
        return f"natural strain of beam {self.beam.name!r}"


def natural_strain(beam: Beam, components: Mapping) -> NaturalStrain:
    """Natural strains of a beam, from numbers and functions of f, of t, or of both."""
    parts = {name: _part(beam, name, x) for name, x in components.items() if x is not None}
    if not parts:
        raise SceneError(f"natural strain of beam {beam.name!r}: give axial, shear or curvature")
    return NaturalStrain(beam, parts)


def changed_strain(strain: NaturalStrain, components: Mapping) -> NaturalStrain:
    """The natural strain with other values of some components."""
    return replace(strain, parts={**strain.parts, **natural_strain(strain.beam, components).parts})


def _part(beam: Beam, name: str, value) -> Signal:
    subject = f"{NAMES[name]} of beam {beam.name!r}"
    # The names of the arguments of a function say what it is of.
    is_function = callable(value) and not isinstance(value, Input)
    arguments = functions.argument_names(value) if is_function else ["t"]
    if arguments == ["t"]:
        return time_function(value, 1, subject)
    if arguments == ["f"]:
        return functions.function_of_place(value, 1, subject, "f")
    if arguments == ["f", "t"]:
        return SignalAlong(value, 1, subject, 1.0, "f")
    raise SceneError(
        f"{subject}: the arguments of the function are ({', '.join(arguments)}). Name them f for "
        "the fraction of the arc length, t for the time, or (f, t) for both: lambda f, t: ..."
    )


def thermal(alpha: float, temperature):
    """Strain of a change of temperature, alpha T, for `Scene.add_natural_strain`.

    Parameters
    ----------
    alpha : float
        Coefficient of thermal expansion [1/K].
    temperature : float, callable or Input
        Rise of the temperature T [K], for an axial strain: a number, or a function of f, of t, or
        of (f, t), as in `Scene.add_natural_strain`. For a curvature it is -dT/dn [K/m], the fall of
        the temperature along the normal n, which points to the left of the direction of the beam.

    Returns
    -------
    float, callable or Input
        The strain, of the same kind.

    Raises
    ------
    SceneError
        For a coefficient or a temperature that is no finite number.

    Examples
    --------
    A bar of steel between two walls that becomes 50 K warmer: N = -EA alpha T.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=10.0), elements=2)
    >>> scene.clamp(bar.start)
    >>> scene.clamp(bar.end)
    >>> strain = scene.add_natural_strain(bar, axial=fb.thermal(12e-6, 50.0))
    >>> fb.static(scene, load_steps=1).resultants(bar).N[-1].round(6)
    array([-600., -600.])
    """
    (factor,) = vector(alpha, 1, "thermal: alpha")
    if isinstance(temperature, Input):
        old = 1.0 if temperature.factor is None else np.array(temperature.factor)
        return replace(temperature, factor=factor * old)
    if not callable(temperature):
        (rise,) = vector(temperature, 1, "thermal: temperature")
        return float(factor * rise)

    @functools.wraps(temperature)
    def strain(*arguments):
        return factor * np.asarray(temperature(*arguments))

    return strain


# -- Pressure on beams: a load along the normal of the deformed axis, by its virtual work -------


@dataclass(frozen=True)
class PressureTerm:
    """The virtual work p (W phi').virtual u per reference length, at the level of a step."""

    pressure: Parameter

    def __call__(self, step):
        """The term in UFL."""
        x, y = step.t0 + step.prime(step.u)
        normal = ufl.as_vector((-y, x))
        return step.load_factor * self.pressure * ufl.dot(normal, step.virtual_u)


def pressure_on(
    beam: Beam, value, arguments: str, between: Sequence[float] | None, number: int
) -> tuple[VirtualWork, Parameter]:
    """A pressure on a beam or on some of its elements, and its parameter; SceneError otherwise."""
    from .ufl_symbols import Parameter

    name = f"pressure on {label(beam)}"
    require(arguments == "time", f"{name}: of", arguments, "'time': it is the same everywhere")
    elements: tuple[int, int | None] = (0, None)
    if between is not None:
        part = part_of(beam, between, arguments, name)
        first, last = (int(abs(beam.s - end).argmin()) for end in part)
        close = np.allclose(beam.s[[first, last]], part, rtol=0.0, atol=1e-9 * beam.length)
        expected = "arc lengths of ends of elements, as a normal is that of an element: "
        expected += f"{beam.s[first]:.6g} and {beam.s[last]:.6g} are the next ones"
        require(close and first < last, f"{name}: between", between, expected)
        elements = first, last
    own_names: tuple[str, ...] = ()
    if not is_parameter(value):
        if not isinstance(value, Input):
            check_takes_time(value, name)
        value = Parameter(f"pressure {number}", value)
        own_names = (value.name,)
    return VirtualWork(PressureTerm(value), beam, elements, own_names), value


# -- Accelerations of the base of a scene, as functions of time or as records -------------------


class Shaking(NamedTuple):
    """The acceleration of the base of a scene along x and y.

    Returned by `Scene.shake`.

    Parameters
    ----------
    x, y : Load or None
        The load of each direction, for `Scene.change` and `Scene.remove`; None where the base does
        not move.

    Examples
    --------
    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> shaking = scene.shake(y=lambda t: 3.0 * math.sin(20 * t))
    >>> print(shaking.y, shaking.x)
    shaking along y None
    """

    x: Load | None = None
    y: Load | None = None


def acceleration(value: functions.TimeValue, name: str) -> Signal:
    """An acceleration (1,) over time: a constant, a function, an `Input` or a record."""
    if not isinstance(value, list | tuple | np.ndarray) or getattr(value, "ndim", 1) == 0:
        if not isinstance(value, Input):
            check_takes_time(value, name)
        return time_function(value, 1, name)
    parts = [errors.real_array(part) for part in value]
    ok = len(parts) == 2 and parts[0].ndim == 1 and parts[0].shape == parts[1].shape
    ok = ok and len(parts[0]) > 1 and bool(np.isfinite([floats(part) for part in parts]).all())
    if not ok:
        raise SceneError(
            f"{name}: a record has two lists of the same length, of at least two finite numbers: "
            "times [s] and accelerations [m/s^2]; or give a function of time"
        )
    steps = np.diff(floats(parts[0]))
    if (steps < 0).any() or not steps.any():
        late = int(np.argmax(steps < 0))
        raise SceneError(
            f"{name}: the times of a record must rise, but {floats(parts[0])[late + 1]:g} s comes "
            f"after {floats(parts[0])[late]:g} s. Sort it: order = np.argsort(times)"
        )
    return functions.Accelerogram(parts[0], parts[1], name)
