"""The two kinds of error, checks of what users give, and names of other programs in messages."""

from __future__ import annotations

import difflib
import functools
import inspect
import logging
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from decimal import Decimal
from numbers import Integral, Real
from types import FunctionType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fx_beam.dual import Dual, DualFloat, dual_of, scene_number
from fx_beam.symbolic import parts_of, ufl

# -- The two kinds of error, and checks of what users give, which raise them --------------------


#: Largest size of a number: products of a few such numbers are finite.
LARGEST = 1e75
# What is said of numbers whose size has limits.
_SIZES = re.compile("positive|finite")
# Characters of a value in a message.
_SHOWN = 200
# Types of real numbers, for which a look is enough.
_PLAIN = frozenset({float, np.float64})
_SCALARS = _PLAIN | {int}
# Methods of quantities with units, and how their number is read: of pint, astropy and unyt.
_NUMBERS = {
    "to_base_units": "value.to_base_units().magnitude",
    "decompose": "value.si.value",
    "in_base": "value.in_base().value",
}
# Without the dispatch of old versions of NumPy, which takes as long as the count.
_count_nonzero = getattr(np.count_nonzero, "__wrapped__", np.count_nonzero)


class SceneError(ValueError):
    """Bad input in a scene, section, scheme or time grid; raised before anything is computed.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Section(EA=-1.0, GA=1.0, EI=1.0)
    Traceback (most recent call last):
        ...
    fx_beam.errors.SceneError: Section: EA = -1.0 must be positive and finite
    """


@dataclass(frozen=True)
class Failure:
    """Why a run ended early.

    Parameters
    ----------
    kind : str
        What happened: "no convergence" of Newton's method, "singular" tangent, "large rotation" in
        one step, "off the end" for a node that runs off the beam on which it slides, "large slide"
        for one that passes more than two ends of elements in one step, "members" for a point that
        passes through a member it touches, or moves too far in one step, "off the pulley" for a
        rope that pulls beside it, "damping" for a step of order 4 in which it gives energy,
        "off the path" for a load step that ends on another equilibrium path, "function" for a
        function of the user's that fails or is not finite, "interrupted" by Ctrl-C or another
        exception, "too many steps", "too short" for steps far shorter than a motion needs, or "not
        converged" for a quantity of `converge`.
    reason : str
        One sentence.
    time : float
        Time at the start of the failed step, or the time at which a user's function failed [s]. In
        statics it is the load factor.
    where : str
        The node that moves most in the failed step, and the last residuals.
    advice : str
        What to try.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> scene.set_velocity(beam, lambda x, y: (0.0, 100 * x), spin=lambda x, y: 100.0)
    >>> scene.pin(beam.start)
    >>> try:
    ...     fb.simulate(scene, dt=0.1, t_end=1.0, max_halvings=0)
    ... except fb.StepError as error:
    ...     print(error.failure.kind)
    large rotation
    """

    kind: str
    reason: str
    time: float
    where: str = ""
    advice: str = ""

    def __str__(self):
        return ". ".join(filter(None, (self.reason, self.where, self.advice)))


class StepError(RuntimeError):
    """A step that failed.

    Parameters
    ----------
    failure : Failure
        What happened, where, and what to try.

    Examples
    --------
    The steps before the failure are kept in the attribute `solution`.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> load = scene.add_force(beam.end, lambda t: (0.0, 1.0 if t < 0.25 else float("nan")))
    >>> try:
    ...     fb.simulate(scene, dt=0.1, t_end=1.0)
    ... except fb.StepError as error:
    ...     print(f"{error.time:.1f}", error.solution.t.round(3))
    0.3 [0.  0.1 0.2]
    """

    def __init__(self, failure: Failure):
        super().__init__(str(failure))
        self.failure = failure
        #: The `Solution` up to the last step that succeeded.
        self.solution: Any = None

    @property
    def time(self) -> float:
        """Time or load factor of the failure, as `Failure` has it."""
        return self.failure.time

    def __reduce__(self):
        return type(self), (self.failure,), self.__dict__


def is_number(value) -> bool:
    """Whether a value is a number of a size with which one can compute; see `as_float`."""
    return abs(as_float(value)) <= LARGEST


def as_float(value) -> float:
    """A real number of Python or NumPy, also a fraction or a decimal; nan for anything else.

    Booleans, texts and times are no numbers; an array without axes is one.
    """
    kind = type(value)
    if kind in _PLAIN or (kind is int and abs(value) <= LARGEST):
        return float(value)
    if isinstance(value, Dual):
        return math.nan if value.ndim else scene_number(value)
    if isinstance(value, DualFloat):
        return value
    refuse_units(value)
    scalar = _scalar(value)
    try:
        return float(scalar) if _is_real(scalar) else math.nan
    except (OverflowError, ValueError):  # an integer too large for a float, a signalling decimal
        return math.nan


def refuse_units(value) -> None:
    """Refuse a quantity of pint, astropy or unyt, also in lists: its number depends on its unit."""
    kinds: set[Any] = {type(value)}
    for _ in range(2):  # rows of a list
        if kinds.isdisjoint((list, tuple)):
            break
        value = [x for part in value for x in (part if type(part) in (list, tuple) else [part])]
        kinds = {*map(type, value)}
    for kind in kinds:
        if number := _number_of(kind):
            raise SceneError(
                f"{shown(value)} has a unit, which would be lost. Give its number in consistent "
                f"units, as those of SI: {number}"
            )


@functools.lru_cache(maxsize=256)
def _number_of(kind: type) -> str:
    """How the number of a quantity of a kind is read; empty for a kind without units."""
    return next((text for name, text in _NUMBERS.items() if hasattr(kind, name)), "")


def _scalar(value):
    """The entry of an array without axes; other values are returned as they are."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _is_real(value) -> bool:
    """Whether a value is real; UFL functions of numbers may give numbers of UFL."""
    if type(value).__module__.startswith("ufl."):
        return isinstance(value, ufl.constantvalue.RealValue | ufl.constantvalue.Zero)
    return isinstance(value, Real | Decimal) and not isinstance(value, bool | np.timedelta64)


def is_whole(value, least: int, most: float = 1e9) -> bool:
    """Whether a value is an integer in a range. Booleans are not."""
    if type(value) is int:
        return least <= value <= most
    scalar = _scalar(value)
    return isinstance(scalar, Integral) and _is_real(scalar) and least <= int(scalar) <= most


def is_flag(value) -> bool:
    """Whether a value is True or False."""
    return isinstance(value, bool | np.bool_)


def is_name(value) -> bool:
    """Whether a value is a text that is not empty."""
    return isinstance(value, str) and bool(value.strip())


def all_of(flags: np.ndarray) -> bool:
    """Whether all flags of an array are true; of few, far quicker than their method `all`."""
    return _count_nonzero(flags) == flags.size


def any_of(values: np.ndarray) -> bool:
    """Whether any value of an array is not zero; of few, far quicker than their method `any`."""
    return _count_nonzero(values) > 0


def is_one_of(value, choices: Iterable) -> bool:
    """Whether a value is one of some texts or numbers; arrays are not."""
    return (isinstance(value, str) or _is_real(value)) and value in choices


@functools.lru_cache(maxsize=256)
def warn_once(text: str) -> None:
    """Warn, but not in each of many equal calls."""
    logging.getLogger("fx_beam").warning("%s", text)


def shown(value) -> str:
    """A value in a message."""
    try:
        text = repr(value.item() if isinstance(value, np.generic) else value)
    except ValueError:  # Python writes no integers of many thousand digits
        return "a very long integer"
    if "\n" in text:  # of a table
        text = " ".join(text.split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]} ..."


def require(ok: bool, name: str, value, expected: str) -> None:
    """Raise a SceneError unless the value is allowed; the message says what is allowed."""
    if not ok:
        raise SceneError(f"{name} = {shown(value)} must be {expected}{size_limit(value, expected)}")


def size_limit(value, expected: str) -> str:
    """Words on the limit of sizes, where only the size of a number is wrong."""
    size = abs(as_float(value))
    if "positive" in expected and 0 < size < 1 / LARGEST:
        return f", at least {1 / LARGEST:g}"
    return f", at most {LARGEST:g}" if _SIZES.search(expected) and size > LARGEST else ""


def positive(value, name: str, expected: str = "a positive number") -> float:
    """A positive number with which one can compute; SceneError for others."""
    number = as_float(value)
    require(1 / LARGEST <= number <= LARGEST, name, value, expected)
    return number


def finite(value, name: str, sign: str = "", alternative: str = "") -> float:
    """A number of a size with which one can compute, and "positive" or "not negative"."""
    number = as_float(value)
    ok = is_number(value) and (number > 0 or not sign or (number == 0 and sign != "positive"))
    require(ok, name, value, f"finite{sign and f' and {sign}'}{alternative}")
    return number


#: Mark of a field of a part of a scene; marked fields do not count for the structure of a scene.
IS_DATA = {"number": True}


Check = Callable[[object, str], object]


def real(sign: str = "", optional: bool = False, **default: Any) -> Any:
    """A field that is a number, with a sign as of `finite`; or None, if it is optional."""

    def check(value: object, name: str) -> float | None:
        alternative = ", or None" if optional else ""
        return None if value is None and optional else finite(value, name, sign, alternative)

    return field(metadata={**IS_DATA, "check": check}, **default)


def _field(ok: Callable[[object], bool], expected: str, kind: Callable, default: dict) -> Any:
    """A field that fits, and is made of a kind."""

    def check(value: object, name: str) -> object:
        require(ok(value), name, value, expected)
        return kind(value)

    return field(metadata={"check": check}, **default)


def between(low: float, high: float, expected: str = "", **default: object) -> Any:
    """A field that is a number between two others."""
    expected = expected or f"a number between {low:g} and {high:g}"
    return _field(lambda value: low < as_float(value) < high, expected, as_float, default)


def whole(least: int, most: float = 1e9, **default: object) -> Any:
    """A field that is a whole number in a range."""
    expected = f"a whole number from {least} {'on' if most == 1e9 else f'to {most:,}'}"
    return _field(lambda value: is_whole(value, least, most), expected, int, default)


def flag(**default: object) -> Any:
    """A field that is True or False."""
    return _field(is_flag, "True or False", bool, default)


class FieldKinds(NamedTuple):
    """Names of the fields of a dataclass that are structure, and numbers."""

    structure: list[str]
    numbers: list[str]
    #: Names of checked fields, their checks, and whether they are numbers.
    checks: list[tuple[str, Check, bool]]


@functools.cache
def field_kinds(kind: type) -> FieldKinds:
    """Kinds of the fields of a dataclass."""
    names: tuple[list[str], list[str]] = [], []
    for part in fields(kind):
        names["number" in part.metadata].append(part.name)
    checked = [part for part in fields(kind) if "check" in part.metadata]
    checks = [(part.name, part.metadata["check"], part.name in names[1]) for part in checked]
    return FieldKinds(*names, checks)


def check_fields(part, name: str = "") -> None:
    """Check the fields of a frozen dataclass that say how; SceneError for what does not fit.

    Numbers become floats. Errors begin with `name`, by default that of the class.
    """
    kind: Any = type(part)
    for key, check, is_real in field_kinds(kind).checks:
        value = getattr(part, key)
        # Quickly, as in scenes of many springs.
        if not (is_real and type(value) is float and 0 < value <= LARGEST):
            object.__setattr__(part, key, check(value, f"{name or kind.__name__}: {key}"))


def array_of(value, name: str) -> np.ndarray:
    """New array of real numbers of any shape, finite or not; SceneError for others."""
    array = real_array(value)
    require(array.shape != (0, 0), name, value, "an array of numbers")
    return array


def check_takes(function, arguments: str, name: str) -> None:
    """Refuse what is no function of arguments such as "t, y"."""
    require(callable(function), name, function, f"a function of ({arguments})")
    try:
        takes = inspect.signature(function)
    except (TypeError, ValueError):  # of compiled code, which says nothing
        return
    try:
        takes.bind(*arguments.split(", "))
    except TypeError:
        raise SceneError(f"{name} takes {takes}; it must take ({arguments})") from None


def vector(value, size: int, name: str) -> np.ndarray:
    """Read-only array of `size` finite numbers."""
    array = shaped(value, size, name)
    if not all_of(abs(array) <= LARGEST):
        raise SceneError(
            f"{name}: {shown(value)} is not finite, or too large; give finite numbers of at most "
            f"{LARGEST:g}"
        )
    array.setflags(write=False)
    return array


def shaped(value, size: int, name: str) -> np.ndarray:
    """New array of `size` numbers, finite or not."""
    array = real_array(value)
    array = array if array.ndim else array.reshape(1)
    if array.shape != (size,):
        expected = "a number" if size == 1 else f"{size} numbers"
        raise SceneError(
            f"{name}: {shown(value)} has the wrong type or shape; it must be {expected}"
        )
    return array


def real_array(value) -> np.ndarray:
    """New array of real numbers (see `as_float`), finite or not; of shape (0, 0) if one is not.

    The entries of a masked array that are masked are no numbers.
    """
    if type(value) is np.ndarray and value.dtype.kind in "iuf":
        return np.array(value, dtype=float)
    kinds = {*map(type, value)} if type(value) in (list, tuple) else {type(value)}
    if kinds <= _SCALARS:
        try:
            return np.array(value, dtype=float)
        except OverflowError:  # an integer too large for a float
            return np.empty((0, 0))
    refuse_units(value)
    if (dual := dual_of(value)) is not None:
        return scene_number(dual if dual.ndim else dual.reshape(1))
    parts = value if isinstance(value, list | tuple) else [value]
    if any(isinstance(part, np.ma.MaskedArray) and np.ma.is_masked(part) for part in parts):
        return np.empty((0, 0))
    try:
        # As objects, as NumPy would take texts and booleans among numbers for numbers.
        entries = np.array(value, dtype=object)
        scalars = [_scalar(entry) for entry in entries.flat]
        if all(map(_is_real, scalars)):
            return np.array([float(entry) for entry in scalars]).reshape(entries.shape)
    except Exception:  # a sequence of its own kind, or an integer too large for a float
        pass
    return np.empty((0, 0))


def fields_in(expression) -> list:
    """Functions and constants in a UFL expression, as dolfinx has them."""
    analysis = ufl.algorithms.analysis
    return [*analysis.extract_coefficients(expression), *analysis.extract_constants(expression)]


def refuse_fields(symbols: Iterable, name: str, allowed: Iterable = ()) -> None:
    """Refuse functions and constants of the user in a UFL expression, unless `allowed`.

    They would be read once, before the run; later changes would be ignored.
    """
    allowed_ids = {id(symbol) for symbol in allowed}
    for symbol in symbols:
        if id(symbol) not in allowed_ids:
            raise SceneError(
                f"{name}: it contains {symbol}, a {type(symbol).__name__} of your own. It would be "
                "read only once; later changes would be ignored. Use numbers and UFL expressions "
                "of the function's arguments: the strains in a stored energy; step.t (time) and "
                "step.X (position) elsewhere, for example ufl.sin(3 * step.t). For a number that "
                "changes use fx_beam.Parameter, in a stored energy, a law or a virtual work, for a "
                "material with a memory fx_beam.InternalVariables"
            )


def refuse_fields_in(expression, name: str, allowed: Iterable = ()) -> None:
    """Refuse functions and constants of the user, nan and inf in a UFL expression."""
    refuse_fields(fields_in(expression), name, allowed)
    for part in parts_of(expression):
        if isinstance(part, ufl.constantvalue.FloatValue) and not math.isfinite(part):
            raise SceneError(f"{name}: it contains the number {part}. Give finite numbers")


# -- Names that other programs have, and what they are called here: for messages ----------------


_Kind = TypeVar("_Kind", bound=type)

_POSITIONS = "Use solution.position(node), or solution.X + solution.q[..., :2] for all nodes"
_DISPLACEMENTS = "Use solution.displacement(node), or solution.q for all nodes"
_SUPPORT = "Use scene.clamp(node), scene.pin(node) or scene.fix(node, 'y')"
_JOINT = "Use scene.add_joint with a joint such as fb.Revolute(a, b)"
_RUN = "Use fb.simulate(scene, dt=..., t_end=...), fb.static(scene) or fb.modes(scene)"
_BEAM = "Use scene.add_beam(points, section, elements=...)"
_LOAD = "Use scene.add_force, scene.add_moment or scene.add_line_load"
_MOTION = "Use fb.simulate(scene, dt=..., t_end=...), or fb.Motion for single steps"
_RESULTANTS = "Use solution.resultants(beam).M, .N, .Q"
_OTHERS: dict[str, dict[str, str]] = {
    "fx_beam": {
        **dict.fromkeys(("solve", "run", "analyse", "analyze"), _RUN),
        **dict.fromkeys(("dynamic", "transient", "integrate", "solve_ivp", "Simulation"), _MOTION),
        **dict.fromkeys(("Hinge", "Pin", "PinJoint"), "Use fb.Revolute(a, b), or scene.pin(node)"),
        **dict.fromkeys(("Weld", "Fixed", "Clamp", "Support"), f"{_SUPPORT}, or fb.Rigid(a, b)"),
        **dict.fromkeys(("Model", "System", "Frame", "Structure", "Truss"), "Use fb.Scene()"),
        **dict.fromkeys(("Element", "BeamElement", "Rod"), _BEAM),
        **dict.fromkeys(("Force", "Moment", "Load", "PointLoad", "LineLoad"), _LOAD),
        **dict.fromkeys(("Rope", "Cable"), "Use scene.add_rope(points)"),
        **dict.fromkeys(("Mass", "PointMass"), "Use scene.add_mass(node, mass)"),
        **dict.fromkeys(("RigidBody",), "Use scene.add_body(position, mass, inertia)"),
        **dict.fromkeys(("Motor", "Actuator"), "Use motor= of a joint, or scene.prescribe"),
        **dict.fromkeys(("eigenmodes", "eigenfrequencies", "modal"), "Use fb.modes(scene)"),
        **dict.fromkeys(
            ("gradient", "grad", "optimize", "minimize"), "Use fb.Response(build, ...)"
        ),
        **dict.fromkeys(
            ("Material", "Steel", "steel"), "Use fb.materials.steel, or E= of a section"
        ),
        "linear_static": "Use fb.static(scene, linear=True)",
    },
    "Scene": {
        "add_node": "Nodes come with beams, beam.node(0.5), and bodies, body.centre, body['hook']",
        "add_torque": "Use scene.add_moment(node, moment)",
        **dict.fromkeys(("add_load", "add_point_load"), _LOAD),
        **dict.fromkeys(("add_element", "add_member", "add_rod", "add_bar", "add_truss"), _BEAM),
        "add_distributed_load": "Use scene.add_line_load(beam, load)",
        "add_gravity": "Use fb.Scene(gravity=(0, -9.81)), or set scene.gravity",
        "add_rigid_body": "Use scene.add_body(position, mass, inertia)",
        "add_damper": "Use scene.add_spring with an fb.Damper, or damper= of a joint",
        "add_motor": "Use motor= of a joint, or scene.prescribe(node, rotation=...)",
        "add_cable": "Use scene.add_rope, or scene.add_beam with a small EI",
        **dict.fromkeys(("add_support", "add_constraint", "add_boundary", "support"), _SUPPORT),
        **dict.fromkeys(("add_hinge", "add_revolute", "add_slider", "connect"), _JOINT),
        **dict.fromkeys(("run", "solve", "simulate", "static", "modes"), _RUN),
        "plot": "Use fb.plot.scene(scene, 'scene.png')",
    },
    "Solution": {
        "plot": "Use fb.plot.shapes(solution, 'shapes.png') and what else fb.plot has",
        "animate": "Use fb.plot.animate(solution, 'motion.gif')",
        **dict.fromkeys(("time", "times"), "Use solution.t"),
        **dict.fromkeys(("u", "displacements"), _DISPLACEMENTS),
        **dict.fromkeys(("x", "y", "positions"), _POSITIONS),
        "energies": "Use solution.energy",
        **dict.fromkeys(
            ("forces", "reactions"), "Use solution.reaction(node), .joint(joint).force"
        ),
        **dict.fromkeys(("M", "N", "Q", "moments"), _RESULTANTS),
        "stresses": "Use solution.stress(beam)",
        "to_vtk": "Use solution.to_paraview('motion.pvd')",
    },
    "Node": {
        **dict.fromkeys(
            ("position", "pos", "coordinates", "xy"), f"Use node.x, node.y. {_POSITIONS}"
        ),
        **dict.fromkeys(("u", "displacement", "q"), _DISPLACEMENTS),
        **dict.fromkeys(("fix", "clamp", "pin", "support"), _SUPPORT),
        **dict.fromkeys(("force", "add_force", "load"), "Use scene.add_force(node, (fx, fy))"),
        **dict.fromkeys(("id", "index"), "Use node.number"),
    },
    "Beam": {
        **dict.fromkeys(("mid", "middle", "midpoint", "center"), "Use beam.node(0.5)"),
        **dict.fromkeys(("first", "begin", "a"), "Use beam.start"),
        **dict.fromkeys(("last", "b"), "Use beam.end"),
        "L": "Use beam.length",
        **dict.fromkeys(("E", "I", "EI", "EA", "GA", "rhoA"), "Use beam.section"),
        **dict.fromkeys(("M", "N", "Q", "V", "moments", "forces"), _RESULTANTS),
        **dict.fromkeys(("stress", "stresses"), "Use solution.stress(beam)"),
        **dict.fromkeys(("u", "displacement"), f"{_DISPLACEMENTS}. Nodes are beam.node(0.5)"),
        "hinge": _JOINT,
    },
    "BeamResultants": {
        **dict.fromkeys(("V", "shear", "shear_force"), "Use resultants.Q"),
        **dict.fromkeys(("moment", "bending_moment", "Mz"), "Use resultants.M"),
        **dict.fromkeys(("axial", "axial_force", "normal", "normal_force"), "Use resultants.N"),
        "x": "Use resultants.s, the arc lengths of the points",
        "max": "Use abs(resultants.M).max()",
        **dict.fromkeys(("stress", "stresses"), "Use solution.stress(beam)"),
    },
    "Section": {
        **dict.fromkeys(("E", "modulus"), "A section has EA, GA and EI"),
        **dict.fromkeys(("area", "height", "width"), "A section has A, and its edges as edges="),
        **dict.fromkeys(("J", "Iz", "inertia", "second_moment"), "A section has I, EI and rhoI"),
        **dict.fromkeys(("rho", "density", "mass", "m"), "A section has rhoA and rhoI"),
    },
}
# Keywords of other programs, and ours: those that a function has are named.
_KEYWORDS = {
    **dict.fromkeys(("t_eval", "t_span", "times", "tspan"), ("dt", "t_end", "record")),
    **dict.fromkeys(("steps", "n_steps"), ("load_steps", "dt", "t_end")),
    **dict.fromkeys(("t", "T", "t_final", "duration", "tf"), ("t_end",)),
    **dict.fromkeys(("h", "time_step", "timestep", "step"), ("dt",)),
    **dict.fromkeys(("scale", "scale_factor", "factor"), ("magnify",)),
    **dict.fromkeys(("filename", "file", "output"), ("path",)),
    **dict.fromkeys(("num_modes", "nmodes", "n_modes", "k"), ("n", "stiffness")),
    **dict.fromkeys(("n_elements", "num_elements", "nelem", "ne"), ("elements",)),
    **dict.fromkeys(("order", "p"), ("degree",)),
    **dict.fromkeys(("J", "I"), ("inertia",)),
    "density": ("rho",),
    "m": ("mass",),
    "method": ("scheme",),
}


def hint(kind: str, name: str, names: Iterable[str]) -> str:
    """What a name that a kind of thing does not have may be called here; empty if nothing is near.

    Names of methods are compared without "add_", in which nearly all of them are alike.
    """
    known = _OTHERS.get(kind, {}).get(name)
    if kind == "keyword" and (fitting := [x for x in _KEYWORDS.get(name, ()) if x in names]):
        known = f"Use {' and '.join(fitting)}"
    if known is not None:
        return f". {known}"
    ours = {other.removeprefix("add_"): other for other in names}
    near = difflib.get_close_matches(name.removeprefix("add_"), ours, 1, 0.8)
    return f". Is it {ours[near[0]]!r}?" if near else ""


def no_attribute(owner: object, name: str, names: Iterable[str]) -> AttributeError:
    """The error for a name that an object does not have, with what it may be called."""
    kind = type(owner).__name__
    # Python asks each object for names with underscores, such as __deepcopy__.
    more = "" if name.startswith("_") else hint(kind, name, names)
    return AttributeError(f"{kind!r} object has no attribute {name!r}{more}")


def answering(kind: _Kind) -> _Kind:
    """The class, whose objects answer names that they do not have by hints."""

    def missing(self, name: str) -> Any:
        raise no_attribute(self, name, dir(type(self)))

    missing.__name__ = "__getattr__"
    setattr(kind, "__getattr__", missing)  # noqa: B010  # unknown to type checkers
    return kind


def keyword_hint(error: TypeError, keywords: Iterable[str], names: Iterable[str]) -> str:
    """A hint for the first keyword that is not among the names, if the error is of keywords."""
    unknown = [name for name in keywords if name not in names]
    is_unexpected = unknown and "unexpected keyword" in str(error)
    return hint("keyword", unknown[0], names) if is_unexpected else ""


def add_hint(error: TypeError, function: Callable, keywords: Iterable[str]) -> None:
    """Add a hint to the error of a call, if it has a keyword that the function does not know."""
    if more := keyword_hint(error, keywords, inspect.signature(function).parameters):
        error.args = (f"{error}{more}",)


def answering_keywords(called: Any, home: str = "") -> Any:
    """A function of the module `home`, or a class, with hints for keywords that it does not have.

    Functions with a decorator are as they are: it adds the hints. Of a class all public methods
    get hints, and its constructor.
    """
    if isinstance(called, type):
        for kind in called.__mro__:
            own = vars(kind) if kind.__module__.startswith("fx_beam") else {}
            for name, method in [*own.items()]:
                function = getattr(method, "__func__", method)  # of a class method
                if name[0] != "_" or name == "__init__":
                    answer = answering_keywords(function, kind.__module__)
                    if answer is not function:
                        setattr(kind, name, answer if method is function else type(method)(answer))
        return called
    if not isinstance(called, FunctionType) or hasattr(called, "__wrapped__"):
        return called

    @functools.wraps(called)
    def answer_call(*arguments, **options):
        try:
            return called(*arguments, **options)
        except TypeError as error:
            add_hint(error, called, options)
            raise

    answer_call.__module__ = home  # where pickles find it
    return answer_call


def answer_in_module(names: dict[str, Any]) -> None:
    """Give all public functions and classes of a module, by its globals, hints for keywords."""
    for name in names["__all__"]:
        names[name] = answering_keywords(names[name], names["__name__"])
