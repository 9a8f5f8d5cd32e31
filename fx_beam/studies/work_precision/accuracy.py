"""Error of a quantity of interest against a reference, and its order of convergence."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution

#: A number, a history (n,) or (n, k) at `Solution.t`, or a pair of times and such a history.
Quantity = Callable[[Solution], Any]
#: A number, or a function of times (n,) that gives (n,) or (n, k).
Exact = float | Callable[[np.ndarray], np.ndarray]

#: Relative errors below this come from Newton's tolerance and round-off; they have no order.
ROUND_OFF = 1e-10
#: An error is known if it is at least this many times that of the reference.
MARGIN = 3.0
#: Largest difference of slopes for which an order of convergence is given.
STEADY = 0.5


@dataclass(frozen=True)
class History:
    """Values (n, k) of a quantity at times (n,) [s]; a single number has one row.

    A reference has a `size` that divides errors, and its own `error`, None if it is exact.
    """

    t: np.ndarray
    values: np.ndarray
    size: float = 1.0
    error: float | None = None
    function: Callable[[np.ndarray], np.ndarray] | None = None

    def at(self, t: np.ndarray) -> np.ndarray:
        """Values (m, k) at other times (m,): exact, or linear in between and NaN outside."""
        if self.function:
            return self.function(t)
        return np.column_stack([np.interp(t, self.t, v, np.nan, np.nan) for v in self.values.T])


def called(what: str, function: Callable, *arguments) -> Any:
    """Value of a user's function, whose errors are named."""
    try:
        return function(*arguments)
    except Exception as wrong:
        raise SceneError(f"{what} failed, {type(wrong).__name__}: {wrong}") from wrong


def measure(name: str, quantity: Quantity, solution: Solution) -> History:
    """History of a quantity of interest of a solution."""
    what = f"quantity {name!r}"
    values = called(what, quantity, solution)
    if isinstance(values, tuple):
        t, values = values if len(values) == 2 else (np.zeros(()), None)
        if np.ndim(t) != 1 or (np.diff(t) <= 0).any():
            raise SceneError(f"{what}: a tuple must be increasing times and an array of values")
    else:
        t = solution.t if np.ndim(values) else solution.t[-1:]
    return History(np.asarray(t), _rows(what, values, np.size(t)))


def exact(name: str, value: Exact, t_end: float) -> History:
    """Exact reference: a number, or a function of times (n,) up to `t_end`."""
    what, times = f"exact value of {name!r}", np.linspace(0, t_end, 1001)

    def at(t):
        return _rows(what, called(what, value, t) if callable(value) else [value] * len(t), len(t))

    history = History(times, at(times), function=at)
    return replace(history, size=_complete(what, history))


def computed(name: str, fine: History, coarse: History) -> History:
    """Reference from a fine solution; a second one with twice the step and element gives its error.

    The difference of the two is three times the error for second order (Roache 1994,
    doi 10.1115/1.2910291) and equal to it for first order. The whole difference is used.
    """
    _complete(f"the reference of {name!r}", coarse)
    history = replace(fine, size=_complete(f"the reference of {name!r}", fine))
    return replace(history, error=error(name, coarse, history))


def error(name: str, history: History, reference: History) -> float:
    """Largest distance from the reference at its times, over its largest magnitude.

    Absolute if the reference is 0, NaN if a value is not finite.
    """
    expected = reference.at(history.t)
    inside = np.isfinite(expected).all(axis=1)
    if not inside.any():
        first, last = history.t[[0, -1]]
        raise SceneError(f"the reference of {name!r} has no time between {first:g} and {last:g} s")
    if (own := history.values.shape[1]) != (other := expected.shape[1]):
        raise SceneError(f"quantity {name!r} has {own} values at a time, its reference {other}")
    return _size(history.values[inside] - expected[inside]) / reference.size


def observed_order(errors: Iterable[tuple[float, float]], floor: float) -> float | None:
    """Slope of log(error) over log(step), fitted to the three smallest steps; None if unclear.

    Errors above 1 or below `floor` are left out. The errors must fall with the step, and the
    slopes between neighbours must not differ by more than `STEADY`.
    """
    points = sorted((h, e) for h, e in errors if floor < e <= 1)[:3]
    if len(points) < 3:
        return None
    log_h, log_e = np.log(points).T
    slopes = np.diff(log_e) / np.diff(log_h)
    if slopes.min() <= 0 or np.ptp(slopes) > STEADY:
        return None
    return float(np.polyfit(log_h, log_e, 1)[0])


def _rows(what: str, given: Any, n: int) -> np.ndarray:
    """Values (n, k) of a number, for n = 1, or of a history (n,) or (n, k); None gives NaN."""
    values = np.atleast_1d(np.nan if given is None else given)
    if values.dtype.kind not in "fiub" or values.ndim > 2 or values.shape[-1] == 0:
        raise SceneError(
            f"{what} must be a real number or an array (n,) or (n, k), not {given!r:.40} of "
            f"{values.dtype} with the shape {values.shape}"
        )
    if len(values) != n:
        raise SceneError(f"{what} has {len(values)} rows for {n} times")
    return values.reshape(n, -1).astype(float)


def _complete(what: str, history: History) -> float:
    """Magnitude that divides errors, 1 for a reference of 0; an error where it is not finite."""
    if (gaps := ~np.isfinite(history.values).all(axis=1)).any():
        raise SceneError(f"{what} is not a finite number at t = {history.t[gaps][0]:.4g} s")
    return _size(history.values) or 1.0


def _size(values: np.ndarray) -> float:
    """Largest norm of a row."""
    return float(np.linalg.norm(values, axis=1).max())
