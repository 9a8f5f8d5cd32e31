"""Error of a quantity of interest against a reference, and the order with which it falls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution

#: A number, a history (n,) or (n, k) at `Solution.t`, or a pair of times and such a history.
Quantity = Callable[[Solution], Any]
#: A number, or a function of times (n,) that gives (n,) or (n, k).
Exact = float | Callable[[np.ndarray], np.ndarray]

#: Relative errors below this are what Newton's tolerance and rounding leave; they have no order.
ROUND_OFF = 1e-10
#: An error is told from that of the reference when it is this many times larger.
MARGIN = 3.0
#: Two slopes are one order when they differ by no more than this.
STEADY = 0.5


@dataclass(frozen=True)
class History:
    """Values of a quantity over time.

    Parameters
    ----------
    t : (n,) float
        Times [s]; one of any value for a single number.
    values : (n, k) float
        Values, in the quantity's unit.
    """

    t: np.ndarray
    values: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Values at other times, linear in between.

        Parameters
        ----------
        t : (m,) float
            Times [s].

        Returns
        -------
        (m, k) float
            The values; exact at times that the history has.
        """
        return np.column_stack([np.interp(t, self.t, column) for column in self.values.T])

    def reference(self, size: float, error: float | None = None) -> Reference:
        """Reference that is this history, as far as it goes.

        Parameters
        ----------
        size : float
            By what errors are divided.
        error : float, optional
            Estimate of its own relative error.

        Returns
        -------
        Reference
            The reference.
        """
        return Reference(self.at, size, error, (self.t[0], self.t[-1]))


@dataclass(frozen=True)
class Reference:
    """What a quantity should be.

    Parameters
    ----------
    at : callable
        ``at(t)`` gives the values (n, k) at times (n,).
    size : float
        Largest magnitude over time, by which errors are divided; 1 where it is 0.
    error : float, optional
        Estimate of its own relative error; None if it is exact.
    span : (float, float)
        First and last time at which it is known [s]: a mid-point scheme has no force at the end.
    """

    at: Callable[[np.ndarray], np.ndarray]
    size: float
    error: float | None = None
    span: tuple[float, float] = (-np.inf, np.inf)


def measure(name: str, quantity: Quantity, solution: Solution) -> History:
    """Quantity of interest of a solution.

    Parameters
    ----------
    name : str
        Its name.
    quantity : callable
        ``quantity(solution)`` gives a number, or None where there is none; a history (n,) or
        (n, k) at `Solution.t`; or a pair of times and such a history.
    solution : Solution
        The solution.

    Returns
    -------
    History
        Its values over time.
    """
    what = f"quantity {name!r}"
    try:
        found = quantity(solution)
    except Exception as wrong:
        raise SceneError(
            f"{what} failed, {type(wrong).__name__}: {wrong}. Let it give None where there is none"
        ) from wrong
    if isinstance(found, tuple):
        if len(found) != 2 or np.ndim(found[0]) != 1 or (np.diff(found[0]) <= 0).any():
            raise SceneError(
                f"{what}: a tuple is read as times and values, but these times do not "
                "increase; give vectors over time as an array (n, k)"
            )
        t, found = found
    else:
        t = solution.t if np.ndim(found) else solution.t[-1:]
    return History(np.asarray(t), _rows(what, found, len(t)))


def exact(name: str, value: Exact, t_end: float) -> Reference:
    """Reference that is known.

    Parameters
    ----------
    name : str
        Name of the quantity.
    value : float or callable
        A number, or a function of times (n,) [s] that gives (n,) or (n, k).
    t_end : float
        End of the simulation [s].

    Returns
    -------
    Reference
        The reference, without error.
    """
    what = f"exact value of {name!r}"

    def at(t):
        return _rows(what, value(t) if callable(value) else [value] * len(t), len(t))

    t = np.linspace(0, t_end, 1001)
    try:
        values = at(t)
    except SceneError:
        raise
    except Exception as wrong:
        raise SceneError(f"{what} failed, {type(wrong).__name__}: {wrong}") from wrong
    _refuse_gaps(what, t, values)
    return Reference(at, _size(values))


def computed(name: str, fine: History, coarse: History) -> Reference:
    """Reference that is a fine solution, its error estimated by a coarser one.

    With errors of second order in step and element, and twice of both in the coarser one, its
    difference is three times the error of the fine one (Richardson). The estimate is the whole
    difference: the safety factor of 3 that Roache takes for two grids, which also covers a fall
    that is of first order only.

    Parameters
    ----------
    name : str
        Name of the quantity.
    fine, coarse : History
        The quantity in the reference, and with twice its step and half its elements.

    Returns
    -------
    Reference
        The fine solution.

    References
    ----------
    Roache (1994), doi 10.1115/1.2910291.
    """
    for history in (fine, coarse):
        _refuse_gaps(f"the reference of {name!r}", history.t, history.values)
    size = _size(fine.values)
    return fine.reference(size, error(name, coarse, fine.reference(size)))


def error(name: str, found: History, reference: Reference) -> float:
    """Largest distance from the reference over time, over the largest magnitude of that.

    Parameters
    ----------
    name : str
        Name of the quantity.
    found : History
        What was computed; it is compared at all of its own times at which the reference is known.
    reference : Reference
        What it should be.

    Returns
    -------
    float
        Relative error; absolute where the reference is 0, NaN where a value is none.
    """
    first, last = reference.span
    inside = (found.t >= first) & (found.t <= last)
    if not inside.any():
        raise SceneError(
            f"quantity {name!r} has no time between {first:g} and {last:g} s, those "
            "of its reference"
        )
    expected, values = reference.at(found.t[inside]), found.values[inside]
    if expected.shape != values.shape:
        raise SceneError(
            f"quantity {name!r} has {values.shape[1]} values at a time, but its reference "
            f"{expected.shape[1]}"
        )
    return _size(values - expected, zero=0.0) / reference.size


def observed_order(steps: Sequence[float], errors: Sequence[float], floor: float) -> float | None:
    """Slope of log(error) over log(step), by least squares on the three finest steps.

    It is an order only where the errors fall with the step, and the slopes between neighbours
    differ by no more than 0.5; else the steps are too large for one, or an error changes its sign.

    Parameters
    ----------
    steps : (n,) float
        Time steps or element sizes.
    errors : (n,) float
        Their relative errors. Those above 1 are no approximation, and are left out as are those
        below `floor` and those that are not finite.
    floor : float
        Smallest error that is told from zero.

    Returns
    -------
    float or None
        The order; None where there is none, and with fewer than three errors.
    """
    points = sorted((h, e) for h, e in zip(steps, errors, strict=True) if floor < e <= 1)[:3]
    if len(points) < 3:
        return None
    log_h, log_e = np.log(points).T
    slopes = np.diff(log_e) / np.diff(log_h)
    if slopes.min() <= 0 or np.ptp(slopes) > STEADY:
        return None
    return float(np.polyfit(log_h, log_e, 1)[0])


def _rows(what: str, found: Any, n: int) -> np.ndarray:
    """Values (n, k) of a number, for n = 1, or a history (n,) or (n, k)."""
    if np.iscomplexobj(found):
        raise SceneError(f"{what} is complex; give real and imaginary part as two columns")
    try:
        values = np.atleast_1d(np.asarray(found, dtype=float))
    except (TypeError, ValueError) as wrong:
        raise SceneError(f"{what} is {found!r:.40}, not a number or an array of them") from wrong
    if values.ndim > 2 or values.shape[-1] == 0:
        raise SceneError(f"{what} has the shape {values.shape}, but must have (n,) or (n, k)")
    if len(values) != n:
        raise SceneError(
            f"{what} has {len(values)} rows for {n} times; give a number, an array with "
            "a row for each time of the solution, or a pair of times and such an array"
        )
    return values.reshape(n, -1)


def _refuse_gaps(what: str, t: np.ndarray, values: np.ndarray) -> None:
    """Refuse a reference that is not a finite number at all times."""
    if (gaps := ~np.isfinite(values).all(axis=1)).any():
        raise SceneError(f"{what} is not a finite number at t = {t[gaps][0]:.4g} s")


def _size(values: np.ndarray, zero: float = 1.0) -> float:
    """Largest norm of a row; `zero` where it is 0."""
    return float(np.linalg.norm(values, axis=1).max()) or zero
