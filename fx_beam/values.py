"""What users give as numbers, vectors or functions, checked."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Integral, Real

import numpy as np

from .errors import SceneError, StepError

TimeFunction = Callable[[float], np.ndarray]


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
    """Finite array of `size` numbers."""
    array = shaped(value, size, what)
    if not np.isfinite(array).all():
        raise SceneError(f"{what}: {value!r} is not finite")
    return array


def shaped(value, size: int, what: str) -> np.ndarray:
    """Array of `size` numbers, finite or not."""
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (size,):
        wanted = "a number" if size == 1 else f"{size} numbers"
        raise SceneError(f"{what}: {value!r} has the wrong shape; it must be {wanted}")
    return array


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
                found.append(function.function(t))
            values = np.array(found, dtype=float)
            if values.size == len(times) * function.size and np.isfinite(values).all():
                return values.reshape(len(times), function.size)
        except KeyboardInterrupt as interrupt:
            interrupt.time = times[len(found)]  # type: ignore[attr-defined]
            raise
        except Exception:
            pass  # which one it was is found out below
    return np.array([evaluate(function, t, what) for t in times.tolist()])


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
