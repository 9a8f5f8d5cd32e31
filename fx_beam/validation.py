"""Checks of the numbers, vectors and functions that users give."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from numbers import Integral, Real

from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr

import numpy as np

from .errors import Failure, SceneError, StepError

TimeFunction = Callable[[float], np.ndarray]
# Parameter names, in lower case, that show a function of position instead of time.
_PLACES = {"s", "x", "y", "xi", "place", "position", "point", "fraction", "arc_length"}
#: Immutable types of values.
_IMMUTABLE = float, tuple, int


def is_number(value) -> bool:
    """Whether a value is a finite number. Booleans and arrays are not."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False


def is_whole(value, least: int, most: float = math.inf) -> bool:
    """Whether a value is an integer in a range. Booleans are not."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    return whole and least <= value <= most


def require(fits: bool, what: str, value, wanted: str) -> None:
    """Raise a SceneError unless the value is allowed; the message says what is allowed."""
    if not fits:
        raise SceneError(f"{what} = {value!r} must be {wanted}")


def vector(value, size: int, what: str) -> np.ndarray:
    """Read-only array of `size` finite numbers."""
    array = shaped(value, size, what)
    if not np.isfinite(array).all():
        raise SceneError(f"{what}: {value!r} is not finite; give finite numbers")
    array.setflags(write=False)
    return array


def shaped(value, size: int, what: str) -> np.ndarray:
    """New array of `size` numbers, finite or not."""
    try:
        parts = value if isinstance(value, list | tuple) else [value]
        if any(isinstance(part, Expr) for part in parts):
            raise TypeError("converting a UFL symbol to float never ends")
        array = np.array(value, dtype=float, ndmin=1)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (size,):
        wanted = "a number" if size == 1 else f"{size} numbers"
        raise SceneError(f"{what}: {value!r} has the wrong shape; it must be {wanted}")
    return array


def fields_in(expression) -> list:
    """dolfinx functions and constants in a UFL expression."""
    return [*extract_coefficients(expression), *extract_constants(expression)]


def refuse_fields(found: Iterable, what: str, known: Iterable = ()) -> None:
    """Refuse dolfinx functions and constants of the user in a UFL expression, unless `known`.

    They would be read once, before the run; later changes would be ignored.
    """
    ours = {id(field) for field in known}
    for field in found:
        if id(field) not in ours:
            raise SceneError(
                f"{what}: it contains {field}, a {type(field).__name__} of your own. It would be "
                "read only once; later changes would be ignored. Use numbers and UFL expressions "
                "of the function's arguments: the strains in a stored energy; step.t (time) and "
                "step.X (position) elsewhere, for example ufl.sin(3 * step.t). For a material with "
                "a memory use fx_beam.InternalVariables"
            )


class Constant:
    """A constant value (size,) as a function."""

    def __init__(self, value: np.ndarray):
        self._value = value

    def __call__(self, *_) -> np.ndarray:
        """The constant, for any arguments."""
        return self._value

    def each(self, arguments) -> np.ndarray:
        """The constant (n, size), for n tuples of arguments."""
        return np.broadcast_to(self._value, (len(arguments), len(self._value)))


def check_takes_time(function, what: str) -> None:
    """Refuse a function whose parameters show that it depends on position instead of time."""
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # a constant, or a function without a signature
        return
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    names = [p.name for p in parameters if p.kind in kinds and p.default is p.empty]
    if len(names) > 1 or names and names[0].lower() in _PLACES:
        raise SceneError(
            f"{what}: the function takes ({', '.join(names)}), but it is called with the time t "
            "only. For a load that varies along the beam, give a function of the arc length s [m] "
            "and of='arc length'"
        )


def time_function(value, size: int, what: str) -> TimeFunction:
    """A function of time with values of shape (size,), from a constant or a user's function."""
    return checked_function(value, size, what, 0.0)


def checked_function(value, size: int, what: str, *sample: float) -> CheckedFunction:
    """A function with values of shape (size,), from a constant or a user's function.

    The user's function is called once at `sample`, so that errors show before the run.
    """
    if not callable(value):
        return Constant(vector(value, size, what))
    try:
        first = value(*sample)
    except Exception as error:
        raise SceneError(f"{what}: calling it at {sample} raised {error!r}") from error
    vector(first, size, what)

    return _CheckedFunction(value, size, what)


class _CheckedFunction:
    """A user's function; its values get their shape or are refused."""

    def __init__(self, function: Callable, size: int, what: str):
        self.function, self.size, self._what = function, size, what

    def __call__(self, *arguments) -> np.ndarray:
        try:
            return shaped(self.function(*arguments), self.size, self._what)
        except SceneError:
            raise
        except Exception as error:
            raise SceneError(f"{self._what}: calling it at {arguments} raised {error!r}") from error

    def each(self, arguments) -> np.ndarray:
        """Values (n, size) for n tuples of arguments."""
        try:
            # All values are checked at once: one by one, the checks cost more than most functions.
            found = [_kept(self.function(*own)) for own in arguments]
            values = np.array(found, dtype=float)
            if values.size == len(arguments) * self.size:
                return values.reshape(-1, self.size)
        except Exception:
            pass  # the line below finds the arguments of the failure
        return np.array([self(*own) for own in arguments])


CheckedFunction = Constant | _CheckedFunction


def _kept(value):
    """A function's value, copied where the function may fill and return the same array again."""
    if isinstance(value, _IMMUTABLE):
        return value
    return (value if isinstance(value, np.ndarray) else np.array(value)).tolist()


def series(function: TimeFunction, times: np.ndarray, what: str) -> np.ndarray:
    """Finite values (n, size) of a `time_function` at n times [s].

    Raises StepError otherwise. The `time` of the error, or of an interrupt, says when.
    """
    if isinstance(function, _CheckedFunction):
        # At once, as in `each`.
        found: list = []
        try:
            for t in times.tolist():
                found.append(_kept(function.function(t)))  # noqa: PERF401 (an interrupt counts)
            values = np.array(found, dtype=float)
            if values.size == len(times) * function.size and np.isfinite(values).all():
                return values.reshape(len(times), function.size)
        except KeyboardInterrupt as interrupt:
            interrupt.time = times[len(found)]  # type: ignore[attr-defined]
            raise
        except Exception:
            pass  # the line below finds the time of the failure
    return np.array([evaluate(function, float(t), what) for t in times])


def evaluate(function: TimeFunction, t: float, what: str) -> np.ndarray:
    """Finite value of a `time_function` at the time t [s]; StepError otherwise."""
    try:
        value = function(t)
    except Exception as error:
        reason = f"{what}: evaluating it at t = {t:.6g} raised {error!r}"
        raise StepError(Failure("function", reason, t)) from error
    if not np.isfinite(value).all():
        reason = f"{what}: its value at t = {t:.6g} is {value}, which is not finite"
        raise StepError(Failure("function", reason, t))
    return value
