"""What users give as numbers, vectors or functions, checked."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from numbers import Integral, Real

from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr

import numpy as np

from .errors import SceneError, StepError

TimeFunction = Callable[[float], np.ndarray]
# Names that parameters bear which are places, in lower case.
_PLACES = {"s", "x", "y", "xi", "place", "position", "point", "fraction", "arc_length"}
#: Kinds of values that cannot be changed.
_FIXED = float, tuple, int


def is_number(value) -> bool:
    """Whether something is a finite number; a truth value and an array are none."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False


def is_whole(value, least: int, most: float = math.inf) -> bool:
    """Whether something is a whole number in a range; a truth value is none."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    return whole and least <= value <= most


def require(fits: bool, what: str, value, wanted: str) -> None:
    """Refuse a value that does not fit, saying what it must be."""
    if not fits:
        raise SceneError(f"{what} = {value!r} must be {wanted}")


def vector(value, size: int, what: str) -> np.ndarray:
    """Finite array of `size` numbers, which cannot be changed."""
    array = shaped(value, size, what)
    if not np.isfinite(array).all():
        raise SceneError(f"{what}: {value!r} is not finite")
    array.setflags(write=False)
    return array


def shaped(value, size: int, what: str) -> np.ndarray:
    """New array of `size` numbers, finite or not."""
    try:
        parts = value if isinstance(value, list | tuple) else [value]
        if any(isinstance(part, Expr) for part in parts):
            raise TypeError("a symbol, of which UFL tries without end to make a number")
        array = np.array(value, dtype=float, ndmin=1)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (size,):
        wanted = "a number" if size == 1 else f"{size} numbers"
        raise SceneError(f"{what}: {value!r} has the wrong shape; it must be {wanted}")
    return array


def fields_in(expression) -> list:
    """Functions and constants of dolfinx in a UFL expression."""
    return [*extract_coefficients(expression), *extract_constants(expression)]


def refuse_fields(found: Iterable, what: str, known: Iterable = ()) -> None:
    """Refuse functions and constants of a user's own in a UFL expression.

    They would be read once, before the run, and what they are changed to would be left out.

    Parameters
    ----------
    found : iterable
        What is in an expression that a user's function gave.
    what : str
        Name of the function in messages.
    known : iterable
        Functions and constants that the package keeps up to date.

    Raises
    ------
    SceneError
        If there are others.
    """
    ours = {id(field) for field in known}
    for field in found:
        if id(field) not in ours:
            raise SceneError(
                f"{what}: it contains {field}, a {type(field).__name__} of your own. That would be "
                "read once, and not when it changes. Take numbers and UFL expressions of what the "
                "function is given: of the strains in a law, and of step.t (time) and step.X "
                "(place) elsewhere, such as ufl.sin(3 * step.t)"
            )


class Constant:
    """A constant as a function.

    Parameters
    ----------
    value : (size,) float
        What it returns.
    """

    def __init__(self, value: np.ndarray):
        self._value = value

    def __call__(self, *_) -> np.ndarray:
        """The constant, whatever the arguments."""
        return self._value


def check_takes_time(function, what: str) -> None:
    """Refuse a function whose parameters show that it is one of the place, and not of the time."""
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # a constant, or a function that does not tell
        return
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    names = [p.name for p in parameters if p.kind in kinds and p.default is p.empty]
    if len(names) > 1 or names and names[0].lower() in _PLACES:
        raise SceneError(
            f"{what}: its function of ({', '.join(names)}) would be called with the time t alone. "
            "For a load that varies along the beam give a function of the arc length s [m], and "
            "of='arc length'"
        )


def time_function(value, size: int, what: str) -> TimeFunction:
    """A constant or a function of time as a function with values of shape (size,)."""
    return checked_function(value, size, what, 0.0)


def checked_function(value, size: int, what: str, *sample: float) -> Callable:
    """A constant or a user's function as a function with values of shape (size,).

    The function is called once at `sample`, so that a wrong one is found before anything runs.
    """
    if not callable(value):
        return Constant(vector(value, size, what))
    try:
        first = value(*sample)
    except Exception as error:
        raise SceneError(f"{what}: calling it at {sample} raised {error!r}") from error
    vector(first, size, what)

    return _Checked(value, size, what)


class _Checked:
    """A user's function, whose values are given their shape or refused."""

    def __init__(self, function: Callable, size: int, what: str):
        self.function, self.size, self._what = function, size, what

    def __call__(self, *arguments) -> np.ndarray:
        try:
            return shaped(self.function(*arguments), self.size, self._what)
        except SceneError:
            raise
        except Exception as error:
            raise SceneError(f"{self._what}: calling it at {arguments} raised {error!r}") from error


def series(function: TimeFunction, times: np.ndarray, what: str) -> np.ndarray:
    """Values of a user's function at several times, or a clear error.

    Parameters
    ----------
    function : callable
        What `time_function` gave.
    times : (n,) float
        Times [s].
    what : str
        Name of the function in messages.

    Returns
    -------
    (n, size) float
        Its finite values.

    Raises
    ------
    StepError
        If it raises or gives a value that is not finite. Its attribute `time` says when, as that of
        an interrupt does.
    """
    if isinstance(function, _Checked):
        # Checked all at once, as checks one by one take longer than most functions do.
        found: list = []
        try:
            for t in times.tolist():
                value = function.function(t)
                if not isinstance(value, _FIXED):
                    # It may fill and return one array or list of its own again and again.
                    value = (value if isinstance(value, np.ndarray) else np.array(value)).tolist()
                found.append(value)
            values = np.array(found, dtype=float)
            if values.size == len(times) * function.size and np.isfinite(values).all():
                return values.reshape(len(times), function.size)
        except KeyboardInterrupt as interrupt:
            interrupt.time = times[len(found)]  # type: ignore[attr-defined]
            raise
        except Exception:
            pass  # which one it was is found out below
    return np.array([evaluate(function, float(t), what) for t in times])


def evaluate(function: TimeFunction, t: float, what: str) -> np.ndarray:
    """Value of a user's function of time, or a clear error.

    Parameters
    ----------
    function : callable
        ``function(t)``.
    t : float
        Time [s].
    what : str
        Name of the function in messages.

    Returns
    -------
    float array
        Its finite value.

    Raises
    ------
    StepError
        If it raises or gives a value that is not finite.
    """
    try:
        value = function(t)
    except Exception as error:
        raise StepError(f"{what}: evaluating it at t = {t:.6g} raised {error!r}", t) from error
    if not np.isfinite(value).all():
        raise StepError(f"{what}: its value at t = {t:.6g} is {value}, not finite", t)
    return value
