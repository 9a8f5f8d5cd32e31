"""Functions of time or place, constants in their place, and inputs that are set from outside."""

from __future__ import annotations

import copy
import functools
import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from fx_beam import errors
from fx_beam.dual import Dual, MaybeDual, dual_array, dual_of, floats
from fx_beam.errors import LARGEST, Failure, SceneError, StepError, all_of, is_number, shown, vector
from fx_beam.symbolic import ufl

# -- Functions of the user, of time or place, and constants in their place; values are checked --


# Parameter names, in lower case, that show a function of position instead of time.
_PLACES = {"s", "x", "y", "xi", "place", "position", "point", "fraction", "arc_length"}
#: A number, or several in an array; each may have slopes.
Numbers = np.ndarray | float
# Immutable types of values.
_IMMUTABLE = float, tuple, int, np.float64
# Fewer values are cheaper one by one; an array of so many is never taken for a vector. With slopes
# calls one by one are dear.
_LEAST, _LEAST_WITH_SLOPES = 24, 2
# Number of values of a known function that are compared.
_SAMPLES = 4
# Error of values in terms of the largest one: powers and sines of arrays may be rounded otherwise,
# and their differences are smaller than they.
_ROUNDING = 1e-13
# Places at which a function is called to learn whether it takes arrays, in parts of the length.
_PARTS = np.linspace(0.0, 1.0, 7)


class ArrayCalls:
    """Calls of functions with arrays, and whether they accept these."""

    def __init__(self) -> None:
        #: Whether a function accepts arrays, by what it describes and its code.
        self.accepted = dict[tuple[str, object], bool]()

    def values(
        self,
        function: Callable,
        size: int,
        rows: MaybeDual,
        name: str,
        one_by_one: Callable,
        is_dual: bool,
    ) -> MaybeDual:
        """Values (n, size) for rows (n, k) of arguments, by one call if the function accepts it.

        For the first function made by a line of the user's code all values are compared with calls
        one by one, for each later function some values. They may differ by round-off.
        """
        least = _LEAST_WITH_SLOPES if is_dual or isinstance(rows, Dual) else _LEAST
        key = name, getattr(function, "__code__", type(function))
        accepted = self.accepted.get(key)  # which another thread may change
        if len(rows) < least or accepted is False:
            return one_by_one(rows)
        values = _at_once(function, size, rows)
        if accepted is None:
            single_values = one_by_one(rows)
            self.accepted[key] = values is not None and _agree(values, single_values)
            return single_values
        if values is not None:
            samples, sizes = np.arange(_SAMPLES) * (len(rows) - 1) // (_SAMPLES - 1), None
            if isinstance(values, Dual):
                samples, sizes = samples[1:2], values
            if _agree(values[samples], one_by_one(rows[samples]), sizes):
                return values
        return one_by_one(rows)


#: What is known of functions of the scene that a response builds now; None outside.
BUILDING: ContextVar[ArrayCalls | None] = ContextVar("BUILDING", default=None)


class Signal:
    """A function with values (size,), mostly of time, or a constant; errors say `what` it is.

    Values have slopes if the function is made of numbers with slopes.
    """

    #: Name of the position along a beam, if it is an argument: the only one, or before the time.
    place = ""
    #: Whether it goes straight over a step to a value that is set.
    ramps = False

    def __init__(self, function: Callable | None, size: int, name: str = "", value=None):
        self.function, self.size, self.what = function, size, name
        #: The value (size,) of a constant.
        self.value = value
        # Whether values had slopes.
        self._is_dual = False
        # Last values with slopes: a motion and its derivatives ask for the same rows of arguments.
        self._last: tuple[str, np.ndarray, MaybeDual] | None = None

    @property
    def is_constant(self) -> bool:
        """Whether it has one value."""
        return self.function is None

    @property
    def arguments(self) -> str:
        """Names of its arguments in brackets; empty for a constant."""
        return f"({self.place})" if self.place else "" if self.is_constant else "(t)"

    def __call__(self, *arguments: float) -> np.ndarray:
        """The value (size,) at a time or a place; SceneError if the function fails."""
        if self.function is None:
            return self.value
        try:
            return errors.shaped(self.function(*arguments), self.size, self.what)
        except SceneError:
            raise
        except Exception as error:
            raise self._failure(arguments, error) from error

    def series(self, times: np.ndarray, name: str, arrays: ArrayCalls | None = None) -> MaybeDual:
        """Finite values (n, size) at n times [s]; StepError otherwise.

        The `time` of the error, or of another exception, says when.
        """
        return self.each(times[:, None], arrays, name)

    def each(self, rows: MaybeDual, arrays: ArrayCalls | None = None, run: str = "") -> MaybeDual:
        """Values (n, size) for rows (n, k) of arguments; SceneError for what does not fit.

        With `arrays` the function is called once for all rows, if it accepts that. With `run`, a
        name for messages, rows are times; StepError if it fails or is not finite.
        """
        if self.function is None:
            return np.broadcast_to(dual_array(self.value), (len(rows), self.size))
        last = None if isinstance(rows, Dual) else self._last
        if last is not None and last[0] == run and np.array_equal(last[1], rows):
            return last[2]
        one_by_one = functools.partial(self._one_by_one, run=run)
        if arrays is None:
            values = one_by_one(rows)
        else:
            name = run or self.what
            values = arrays.values(self.function, self.size, rows, name, one_by_one, self._is_dual)
        if isinstance(values, Dual):
            self._is_dual = True
            self._last = None if isinstance(rows, Dual) else (run, rows, values)
        return values

    def _one_by_one(self, rows: MaybeDual, run: str) -> MaybeDual:
        """Values (n, size), by one call for each row of arguments."""
        function: Any = self.function
        arguments: list = rows.tolist()
        collected: list = []
        try:
            for row in arguments:
                value = function(*row)
                collected.append(value if type(value) in _IMMUTABLE else _copied(value))
            # They are checked at once: one by one, the checks cost more than most functions.
            try:
                values = dual_array(collected).reshape(len(collected), self.size)
                if not run or all_of(np.isfinite(values)):
                    return values
            except (TypeError, ValueError, OverflowError):
                pass  # the row whose value is wrong is found below
        except BaseException as error:
            done = len(collected)
            row = arguments[min(done, len(arguments) - 1)]
            if isinstance(error, Exception) and run:
                raise _failed(row[0], error, run) from error
            if isinstance(error, Exception) and not isinstance(error, SceneError):
                raise self._failure(row, error) from error
            # Steps before this time can be taken.
            error.time = math.inf if done == len(arguments) else row[0]  # type: ignore[attr-defined]
            raise
        return dual_array([evaluate(self, row[0], run) if run else self(*row) for row in arguments])

    def _failure(self, arguments: Sequence, error: Exception) -> SceneError:
        return SceneError(f"{self.what}: calling it at {arguments} raised {error!r}")


class SignalAlong(Signal):
    """A function of the user, ``function(position, t)``, with values (size,).

    It is called once for all positions if it takes an array of them and gives numbers or arrays;
    one by one otherwise. It is tried at time 0, so that errors show before the run.
    """

    function: Callable

    def __init__(self, function: Callable, size: int, name: str, length: float, place: str):
        if not callable(function):
            raise SceneError(f"{name}: {shown(function)} must be a function of ({place}, t)")
        super().__init__(function, size, name)
        self.place, self._samples = place, length * _PARTS
        one_by_one = self._at_each(self._samples, 0.0)
        values = self._at_once(self._samples, 0.0)
        self._takes_arrays = values is not None and np.array_equal(values, one_by_one)
        self._calls, self._was_zero = 0, True

    @property
    def arguments(self) -> str:
        """Names of its arguments in brackets."""
        return f"({self.place}, t)"

    def __call__(self, *arguments: float) -> np.ndarray:
        """The largest value (size,) at some positions, as pictures show it."""
        values = floats(self.values_at(self._samples, *arguments))
        return values[np.argmax(np.linalg.norm(values, axis=1))]

    def values_at(self, positions: np.ndarray, t: float) -> MaybeDual:
        """Finite values (n, size) at n positions; SceneError otherwise."""
        values = self._at_once(positions, t) if self._takes_arrays else None
        if values is not None and self._is_right(values, positions, t):
            if (abs(floats(values)) <= LARGEST).all():
                return values
        return self._at_each(positions, t)  # which names the place

    def _is_right(self, values: MaybeDual, positions: np.ndarray, t: float) -> bool:
        """Whether values of one call equal the values of calls one by one, at two positions.

        They are compared until some values are not zero, and then after 1, 2, 4, ... calls.
        """
        self._calls += 1
        if not (len(positions) and (self._was_zero or self._calls & (self._calls - 1) == 0)):
            return True
        samples = len(positions) * np.array([1, 2]) // 3
        self._takes_arrays = _agree(values[samples], self._at_each(positions[samples], t), values)
        self._was_zero &= not floats(values).any()
        return self._takes_arrays

    def _at_once(self, positions: np.ndarray, t: float) -> MaybeDual | None:
        """Values (n, size) of one call; None if they do not fit."""
        function = self.function
        return _at_once(lambda position: function(position, t), self.size, positions[:, None])

    def _at_each(self, positions: np.ndarray, t: float) -> MaybeDual:
        places, function = positions.tolist(), self.function
        with suppress(Exception):  # which is found below, with its place
            values = dual_array([function(position, t) for position in places])
            values = values.reshape(len(places), self.size)
            if (abs(floats(values)) <= LARGEST).all():
                return values
        return dual_array([self._checked(position, t) for position in places])

    def _checked(self, position: float, t: float) -> np.ndarray:
        """The value at a place; SceneError, with the place, for a wrong one."""
        name = f"{self.what} at {self.place} = {position:g}, t = {t:g}"
        try:
            value = self.function(position, t)
        except Exception as error:
            raise SceneError(f"{name}: calling it raised {error!r}") from error
        return vector(value, self.size, name)


def constant(value: np.ndarray) -> Signal:
    """A value (size,) as a function."""
    return Signal(None, len(value), value=value)


def checked_function(value: object, size: int, name: str, *sample: float) -> Signal:
    """A function with values of shape (size,), from a constant or a user's function.

    The user's function is called once at `sample`, so that errors show before the run.
    """
    if not callable(value):
        parts = value if size > 1 and isinstance(value, (list, tuple)) else ()
        if any(callable(part) or isinstance(part, Input) for part in parts):
            raise SceneError(
                f"{name}: {shown(value)} has a function or an input as a component. Give one "
                "function of all components, such as lambda t: (f(t), 0.0), or one Input, such as "
                "fx_beam.Input('push', factor=(1, 0))"
            )
        return Signal(None, size, name, vector(value, size, name))
    if hasattr(value, "ufl_shape") and not is_number(value):  # it gives its value at the beginning
        expected = "give a number, a function or an fx_beam.Input"
        raise SceneError(f"{name}: {shown(value)} is an expression of UFL; {expected}")
    try:
        first = value(*sample)
    except Exception as error:
        raise SceneError(f"{name}: calling it at {sample} raised {error!r}") from error
    vector(first, size, name)
    signal = Signal(value, size, name)
    signal._is_dual = dual_of(first) is not None
    return signal


def function_of_place(value: object, size: int, name: str, place: str) -> Signal:
    """A checked constant, or function of a position along a beam with the name `place`."""
    signal = checked_function(value, size, name, 0.0)
    signal.place = place
    return signal


def argument_names(function) -> list[str]:
    """Names of the arguments that a function must be given; none if it does not tell."""
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # a constant, or a function without a signature
        return []
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    return [p.name for p in parameters if p.kind in kinds and p.default is p.empty]


def check_takes_time(function: object, name: str) -> None:
    """Refuse a function whose parameters show that it depends on position instead of time."""
    names = argument_names(function)
    if len(names) > 1 or names and names[0].lower() in _PLACES:
        raise SceneError(
            f"{name}: the function takes ({', '.join(names)}), but it is called with the time t "
            "only: give lambda t: ... For a load that varies along the beam, give a function of "
            "the arc length s [m] and of='arc length'"
        )


def evaluate(function: Callable, t: float, name: str) -> np.ndarray:
    """Finite value of a function at the time t [s]; StepError otherwise."""
    try:
        value = function(t)
    except Exception as error:
        raise _failed(t, error, name) from error
    if not np.isfinite(value).all():
        reason = f"{name}: its value at t = {t:.6g} is {value}, which is not finite"
        raise StepError(Failure("function", reason, t))
    return value


def _at_once(function: Callable, size: int, rows: MaybeDual) -> MaybeDual | None:
    """Finite values (n, size) of one call; None if they do not fit."""
    if isinstance(rows, Dual):
        columns: Any = [rows[:, [i]] for i in range(rows.shape[1])]
    else:
        columns = np.array(rows.T[..., None], order="C")
        columns.setflags(write=False)
    none = np.zeros((len(rows), 1))
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            result: Any = function(*columns)
        if isinstance(result, np.ndarray | Dual) and result.shape == (len(rows), size):
            values = dual_array(result)
        else:
            alone = isinstance(result, Dual) and not result.ndim
            alone = alone or not hasattr(result, "__len__") or len(result) != size
            parts: Sequence = (result,) if alone else result
            values = np.concatenate([dual_array(part) + none for part in parts], axis=1)
    except Exception as error:  # noqa: BLE001  # whatever a function does that takes single numbers
        if _is_endless(error):
            raise
        return None
    return values if values.shape[1] == size and all_of(np.isfinite(values)) else None


def _agree(values: MaybeDual, expected: MaybeDual, sizes: MaybeDual | None = None) -> bool:
    """Whether values (n, size) differ by round-off at most, in terms of the largest of `sizes`."""
    values, expected, sizes = map(floats, (values, expected, expected if sizes is None else sizes))
    return all_of(abs(values - expected) <= _ROUNDING * abs(sizes).max(axis=0))


def _copied(value: object) -> object:
    """A function's value, as a copy: a function may fill and return one array again and again."""
    if isinstance(value, _IMMUTABLE):
        return value
    return (value if isinstance(value, np.ndarray) else np.array(value)).tolist()


def _failed(t: float, error: Exception, name: str) -> StepError:
    """The error of a function of time that raised one."""
    raised = error.__cause__ if isinstance(error, SceneError) and error.__cause__ else error
    reason = f"{name}: evaluating it at t = {t:.6g} raised {raised!r}"
    if _is_endless(error):
        reason = (
            f"{name}: the function calls itself for ever, as one that runs an analysis of the "
            "scene to which it belongs. Let it use a scene without this function"
        )
    return StepError(Failure("function", reason, t))


def _is_endless(error: BaseException | None) -> bool:
    """Whether calls inside of one another were too many for Python."""
    while error is not None and not isinstance(error, RecursionError):
        error = error.__cause__ or error.__context__
    return error is not None


class Accelerogram(Signal):
    """Values (1,) at times [s], with straight lines between, and zero before and after."""

    def __init__(self, times: np.ndarray, values: np.ndarray, name: str):
        super().__init__(self._at, 1, name)
        self.times, self.values = times, values

    def _at(self, t: MaybeDual) -> MaybeDual:
        times, places = floats(dual_array(self.times)), floats(t)
        is_recorded = (places >= times[0]) & (places <= times[-1])
        interpolated = np.interp(t, dual_array(self.times), dual_array(self.values))
        return np.where(is_recorded, interpolated, 0.0)

    def each(self, rows: MaybeDual, arrays: ArrayCalls | None = None, run: str = "") -> MaybeDual:
        """Values (n, 1) at times (n, 1) [s], by one call for all."""
        return self._at(rows)

    @property
    def spacing(self) -> float:
        """The median time between two samples [s]."""
        lengths = np.diff(floats(self.times))
        return float(np.median(lengths[lengths > 0]))

    def means(self, t0: np.ndarray, t1: np.ndarray) -> MaybeDual:
        """Mean values (n,) over intervals from t0 to t1 (n,) [s], whose lengths are not zero."""
        return (self._integral(t1) - self._integral(t0)) / (t1 - t0)

    def goes_over_samples(self, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Flags (n,) of the intervals from t0 to t1 (n,) [s] that have a sample inside."""
        samples = floats(self.times)
        return np.searchsorted(samples, t0, "right") != np.searchsorted(samples, t1, "right")

    def _integral(self, t: np.ndarray) -> MaybeDual:
        """Its integral up to the times t (n,) [s]: trapezes to the sample before, and a rest."""
        times, values = dual_array(self.times), dual_array(self.values)
        areas = np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(times))
        t = np.minimum(np.maximum(t, times[0]), times[-1])
        piece = np.searchsorted(floats(times)[1:-1], floats(t), "right")
        rest = (values[piece] + self._at(t)) / 2 * (t - times[piece])
        return np.append(0.0, areas)[piece] + rest


# -- Inputs: names in the place of functions of time, whose values are set from outside ---------


@dataclass(frozen=True)
class Input:
    """A load, a motion, the position of a motor or a `Parameter` that is set from outside, by name.

    Give it in the place of a function of time. Loads and motors with the same name have the same
    input. An input is zero until it is set: in `static`, `modes` and `simulate` without `inputs`.
    An input that sets the length of a rope begins with the drawn length.

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
    if not (sizes := widths(scene)):
        return {"inputs": None, "input_names": None}
    unset, given = unset_values(scene), {} if settings is None else settings
    parts = [
        checked_function(given.get(name, unset[name]), width, f"input {name!r}", t)(t)
        for name, width in sizes.items()
    ]
    return {"inputs": np.concatenate(parts), "input_names": names_of_values(sizes)}


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
