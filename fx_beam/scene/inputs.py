"""Inputs: names in the place of functions of time, whose values are set from outside."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from fx_beam import errors
from fx_beam.dual import MaybeDual
from fx_beam.errors import SceneError, shown
from fx_beam.symbolic import ufl

from .functions import ArrayCalls, Signal, checked_function, constant


@dataclass(frozen=True)
class Input:
    """A load, a motion, the position of a motor or a `Parameter` that is set from outside, by name.

    It can be given instead of a function of time. Loads and motors with the same name have the same
    input. It is zero until it is set: in `static`, `modes` and `simulate` without `inputs`; the
    length of a rope is as drawn.

    Parameters
    ----------
    name : str
        Name of the input.
    factor : float or (fx, fy), optional
        The value is a single number times the factor. By default the input is the value itself:
        two numbers for a force or a line load, one for a moment, a motion or a motor.

    Raises
    ------
    SceneError
        For an empty name, or a factor that is not one or two finite numbers, or zero.

    Examples
    --------
    A horizontal push, and a moment that two bodies exert on one another:

    >>> import fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
    >>> body = scene.add_beam([(0, 0), (1, 0)], section)
    >>> arm = scene.add_beam([(1, 0), (2, 0)], section)
    >>> hinge = scene.add_joint(fb.Revolute(body.end, arm.start))
    >>> load = scene.add_force(body.start, fb.Input("push", factor=(1, 0)))
    >>> load = scene.add_moment(body.end, fb.Input("torque", factor=-1))
    >>> load = scene.add_moment(arm.start, fb.Input("torque"))
    >>> solution = fb.simulate(scene, dt=0.1, t_end=1.0, inputs={"push": lambda t: 2 * t})
    >>> solution.linear_momentum[-1].round(6)
    array([1., 0.])
    """

    name: str
    factor: Any = None

    def __post_init__(self):
        named = errors.is_name(self.name)
        errors.require(named, "Input: name", self.name, "a text that is not empty")
        if self.factor is not None:
            size = 2 if errors.real_array(self.factor).size == 2 else 1
            factor = errors.vector(self.factor, size, f"{self}: factor")
            errors.require(
                bool(factor.any()), f"{self}: factor", self.factor, "different from zero"
            )
            object.__setattr__(self, "factor", tuple(factor.tolist()))

    def __str__(self):
        return f"input {self.name!r}"


#: A constant, a function of time or an input, as users give it.
TimeValue = float | Sequence[float] | np.ndarray | Callable | Input


class InputSignal(Signal):
    """An `Input` at a place with values (size,): as drawn, or what a motion sets over its steps.

    Over a step a load is constant. A motion, of one component, goes straight from `start` to `end`.
    """

    is_constant = False

    def __init__(self, source: Input, size: int, name: str):
        if source.factor is not None and len(source.factor) != size:
            raise SceneError(
                f"{name}: {source} has {len(source.factor)} factors, but there "
                f"{'are two components' if size == 2 else 'is one component'}"
            )
        super().__init__(None, size, name)
        self.name = source.name
        #: Matrix (size, width) from the input to the values.
        self.factor = np.eye(size) if source.factor is None else np.array(source.factor)[:, None]
        #: Number of values of the input.
        self.width = self.factor.shape[1]
        #: Factor on an input of one number (width 1); an input of two numbers is the value.
        self.scale: Any = self.factor[:, 0] if self.width == 1 else 1.0
        #: Whether no motion sets it.
        self.is_open = True
        #: The input (width,) until it is set.
        self.unset = np.zeros(self.width)
        #: Values at the start and at the end of a step, and its times [s].
        self.start: Any = np.zeros(size)
        self.end: Any = self.start
        self._t0, self._t1 = -math.inf, math.inf

    def over_steps(self, ramps: bool) -> InputSignal:
        """A copy that a motion sets."""
        new = copy.copy(self)
        new.is_open, new.ramps = False, ramps
        if ramps:
            new.scale = float(self.factor[0, 0])
            new.start = new.end = float(self.end[0])
        return new

    def beginning_with(self, value: float) -> InputSignal:
        """A copy that has a value until the input, of one number, is set."""
        new = copy.copy(self)
        new.start = new.end = np.array([value])
        new.unset = new.end / self.scale
        return new

    def set(self, value: np.ndarray) -> None:
        """Set the input (width,) for the next steps, or at the end of the next one."""
        self.end = self.scale * (float(value[0]) if self.ramps else value)

    def set_times(self, t0: float, t1: float) -> None:
        """Set the times of a step [s]."""
        self._t0, self._t1 = t0, t1

    def __call__(self, *arguments: float) -> np.ndarray:
        """The value (size,) in the step, or at its nearer end."""
        if not self.ramps:
            return self.end
        if self.start == self.end:
            return np.array([self.end])
        part = (arguments[0] - self._t0) / (self._t1 - self._t0)
        return np.array([self.start + min(max(part, 0.0), 1.0) * (self.end - self.start)])

    def each(self, rows: MaybeDual, arrays: ArrayCalls | None = None, run: str = "") -> MaybeDual:
        """Values (n, size) at times (n, 1)."""
        return np.array([self(*row) for row in rows.tolist()])


def time_function(value, size: int, name: str) -> Signal:
    """A function of time with values (size,): from a constant, a function or an `Input`."""
    if isinstance(value, Input):
        return InputSignal(value, size, name)
    return checked_function(value, size, name, 0.0)


def is_open_input(function: object) -> TypeGuard[InputSignal]:
    """Whether a function of time is an input that no motion sets."""
    return isinstance(function, InputSignal) and function.is_open


def input_slots(scene) -> Iterator[tuple[InputSignal, str]]:
    """All slots of a scene with a kind: "load", "motion", "parameter" or "natural strain"."""
    motors = (c.motor for joint in scene.joints for c in joint.coordinates.values())
    strains = (part for strain in scene.natural_strains for part in strain.parts.values())
    for kind, functions in (
        ("load", (load.value for load in scene.loads)),
        ("motion", (*scene.prescribed.values(), *motors)),
        ("parameter", scene.parameters.functions.values()),
        ("natural strain", strains),
    ):
        yield from ((function, kind) for function in functions if is_open_input(function))


def widths(scene) -> dict[str, int]:
    """Number of values of each input by its name, in the order of the scene.

    SceneError for a name with different numbers of values, or for both loads and motions.
    """
    slots: dict[str, tuple[InputSignal, str]] = {}
    for slot, kind in input_slots(scene):
        first, other = slots.setdefault(slot.name, (slot, kind))
        if first.width != slot.width:
            raise SceneError(
                f"input {slot.name!r} has {first.width} value(s) as {first.what}, but "
                f"{slot.width} as {slot.what}. Give a factor, or use two names"
            )
        if kind != other:
            raise SceneError(
                f"input {slot.name!r} is a {other} as well as a {kind}: {first.what}, and "
                f"{slot.what}. Use two names"
            )
    return {name: slot.width for name, (slot, _) in slots.items()}


def unset_values(scene) -> dict[str, np.ndarray]:
    """Values (n,) of each input by its name until they are set: zero, or as a part is drawn."""
    values: dict[str, np.ndarray] = {}
    for slot, _ in input_slots(scene):
        values[slot.name] = values[slot.name] if slot.name in values else slot.unset
    return values


def check_names(names, known, subject: str) -> None:
    """Refuse names of inputs that are not among the `known` names of a scene."""
    for name in names:
        if name not in known:
            has = f"it has {list(known)}" if known else "it has none; see fx_beam.Input"
            raise SceneError(f"{subject}: the scene has no input {name!r}; {has}")


def present(scene):
    """A scene of the parts that a scene has now: none that are added or removed later."""
    new = object.__new__(type(scene))
    containers = list | set | dict
    new.__dict__.update(
        (name, copy.copy(part) if isinstance(part, containers) else part)
        for name, part in vars(scene).items()
    )
    return new


def connected(scene, function_of: Callable[[InputSignal], Signal]):
    """The scene with functions in the place of its slots; nodes and beams are the same."""

    def replaced(function):
        return function_of(function) if is_open_input(function) else function

    new = object.__new__(type(scene))
    new.__dict__.update(scene.__dict__)
    new.loads = [replace(load, value=replaced(load.value)) for load in scene.loads]
    new.parameters = scene.parameters.replaced(replaced)
    new.natural_strains = []
    for strain in scene.natural_strains:
        parts = {name: replaced(function) for name, function in strain.parts.items()}
        new.natural_strains.append(replace(strain, parts=parts))
    new.prescribed = {key: replaced(function) for key, function in scene.prescribed.items()}
    new.joints = []
    for joint in scene.joints:
        coordinates = joint.coordinates.items()
        driven = {name: replace(c, motor=replaced(c.motor)) for name, c in coordinates}
        new.joints.append(replace(joint, **driven))
    return new


def with_functions(scene, values: Mapping | None, name: str):
    """The scene with its inputs as functions of time or constants; zero where none is given."""
    if values is None:
        return scene
    errors.require(isinstance(values, Mapping), name, values, "a dictionary by names of inputs")
    sizes = widths(scene)
    check_names(values, sizes, name)
    functions = {
        name: checked_function(value, sizes[name], f"input {name!r}", 0.0)
        for name, value in values.items()
    }

    def function_of(slot: InputSignal) -> Signal:
        if slot.name not in functions:
            return slot
        signal = functions[slot.name]
        if signal.is_constant:
            return constant(slot.factor @ signal(0.0))
        return Signal(lambda t: slot.factor @ signal(t), slot.size, slot.what)

    return connected(scene, function_of)


def with_values(scene, values: np.ndarray | None):
    """The scene with all inputs at values (n,), in the order of `widths`."""
    sizes = widths(scene)
    if values is None or len(values) != sum(sizes.values()):
        return scene
    parts = np.split(values, np.cumsum(list(sizes.values()))[:-1])
    return with_functions(scene, dict(zip(sizes, parts, strict=True)), "inputs")


def values_at(scene, settings: Mapping | None, t: float) -> dict[str, np.ndarray | None]:
    """Values at t [s] and names of all inputs, as members of a `State`."""
    sizes, unset, given = widths(scene), unset_values(scene), {} if settings is None else settings
    parts = [
        checked_function(given.get(name, unset[name]), width, f"input {name!r}", t)(t)
        for name, width in sizes.items()
    ]
    values = np.concatenate(parts) if parts else None
    return {"inputs": values, "input_names": names_of_values(sizes)}


def names_of_values(sizes: Mapping[str, int]) -> np.ndarray | None:
    """The name of the input of each value, in the order of `widths`; None without any."""
    return np.repeat([*sizes], [*sizes.values()]) if sizes else None


def values_of(state, sizes: Mapping[str, int]) -> np.ndarray | None:
    """Values of all inputs from a state, in the order of `widths`; zero for unknown names."""
    values, names = state.inputs, state.input_names
    if values is None or names is None:
        return values
    state_values = {name: values[names == name] for name in sizes}
    same_size = {name: len(state_values[name]) == width for name, width in sizes.items()}
    parts = (state_values[n] if same_size[n] else np.zeros(width) for n, width in sizes.items())
    return np.concatenate([np.empty(0), *parts])


def checked_value(name: str, value: TimeValue) -> Signal:
    """A value of a parameter as a function of time (1,)."""
    if isinstance(value, ufl.core.expr.Expr):
        raise SceneError(f"parameter {name!r}: its value is {shown(value)}, not a number")
    return time_function(value, 1, f"parameter {name!r}")
