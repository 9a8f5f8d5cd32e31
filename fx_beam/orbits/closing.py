"""Periodic motions by Newton's method, with a damping that fades (Levenberg and Marquardt)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from fx_beam.errors import SceneError, StepError
from fx_beam.results.state import State

from .shooting import Period, Shooting
from .variables import Directions

_log = logging.getLogger("fx_beam")

# The damping at the begin, and its factors after a success and a failure.
_DAMPED, _LESS, _MORE = 0.1, 0.1, 10.0
#: Singular values of the equations that are round-off, relative to the largest.
ROUNDING = 1e-13
# Growth of changes in a period above which they say nothing about the next state.
_USEFUL = 1e9
# Gaps that are round-off, in units of the scene.
_LOST = 1e-14
#: Gaps, relative to the motion, that are round-off if they have not halved in so many iterations.
ROUND_OFF, _IDLE = 1e-6, 4
# Largest change of the parameter's logarithm in an iteration.
_FAR = 3.0


class Condition(NamedTuple):
    """An equation besides that of the period: where a motion begins, or which is wanted."""

    #: How far a motion is from it.
    error: Callable[[Period], float]
    #: Its derivatives (n + 1,) by the directions at its start, and by the parameter's logarithm.
    slopes: Callable[[Period, Directions], np.ndarray]


class Closed(NamedTuple):
    """A periodic motion, with the equations that found it."""

    period: Period
    by: Directions
    #: Derivatives (rows, n) of the states after a period and after one step.
    monodromy: np.ndarray
    first_step: np.ndarray
    #: Derivatives (rows, n + 1) of the gap, and of the phase of a free motion.
    equations: np.ndarray
    iterations: int = 0
    #: How far its ends are apart, relative to the motion, if round-off leaves more than allowed.
    left_over: float = 0.0


class NotClosed(RuntimeError):
    """No periodic motion was found."""


def _along(period: Period, by: Directions) -> np.ndarray:
    along = np.append(period.way @ by.matrix, 0.0)
    return along / np.linalg.norm(along)


#: That the state does not change along the motion, which only shifts a free motion in time.
NO_SHIFT = Condition(lambda period: 0.0, _along)


def plane(
    shooting: Shooting, scale: np.ndarray, along: np.ndarray, at: Any = 0.0, parameter: float = 1.0
) -> Condition:
    """That a motion begins in a plane through the rows `at`, over scales, and a parameter.

    It lies across the direction `along` (rows + 1,), whose last entry is for the parameter's
    logarithm.
    """

    def error(period: Period) -> float:
        rows = (shooting.variables.rows_of(period.start) - at) / scale
        return float(along @ np.append(rows, np.log(period.parameter / parameter)))

    def slopes(period: Period, by: Directions) -> np.ndarray:
        rows = by.matrix * (by.scale / scale)[:, None]
        return np.append(along[:-1] @ rows, along[-1])

    return Condition(error, slopes)


def turning_point(shooting: Shooting, like: Period) -> Condition:
    """That a motion begins where its speed turns, at rest for one that returns on its way.

    The accelerations at its start are about those of another motion.
    """
    way = np.where(shooting.variables.are_rates, like.way, 0.0) / np.linalg.norm(like.way)
    return plane(shooting, shooting.variables.scales(like.start, like.length), np.append(way, 0.0))


def _with_equations(
    shooting: Shooting, period: Period, phase: Condition | None, varies: bool
) -> Closed:
    by = shooting.variables.directions(period.start, period.length)
    slopes = shooting.slopes(by.changes, period)
    growth = abs(slopes[0]).max()
    if growth > _USEFUL:
        raise SceneError(
            f"{shooting.what}: changes of the state grow {growth:.1e} times in a period: the "
            "motion is chaotic, or strikes. Give the scene damping, or take another start"
        )
    of_parameter = shooting.by_parameter(period) if varies else np.zeros(len(period.gap))
    matrix = np.column_stack([slopes[0] - by.matrix, of_parameter])
    # What is remembered and does not change, such as plastic strain, is no unknown.
    constant = (by.independent >= shooting.variables.movable) & ~matrix[by.independent].any(axis=1)
    matrix[:, np.flatnonzero(constant)] = 0.0
    if phase is not None:
        matrix = np.vstack([matrix, phase.slopes(period, by)])
    return Closed(period, by, *slopes, matrix)


def at_rest(shooting: Shooting, start: State, parameter: float) -> Closed | None:
    """A scene that stays where it is over a period; None if it moves."""
    period = shooting.run(start, parameter)
    return None if period.moves else _with_equations(shooting, period, None, False)


def close(
    shooting: Shooting,
    start: State,
    parameter: float,
    phase: Condition | None,
    conditions: tuple[Condition, ...] = (),
    varies: bool = True,
    most: int = 40,
    damping: float = _DAMPED,
) -> Closed:
    """The periodic motion near a state; free motions need a `phase`, where they begin.

    The parameter `varies`, or is held. Near the motion no `damping` is needed. NotClosed if there
    is none, or StepError.
    """
    period, closed = shooting.run(start, parameter), None
    held = conditions if phase is None else (phase, *conditions)

    def errors(of: Period) -> np.ndarray:
        return np.array([c.error(of) for c in held])

    def cost(of: Period) -> float:
        missing = float(np.linalg.norm(np.append(of.gap, errors(of))))
        if not of.moves or not np.isfinite(missing):
            raise NotClosed(
                f"{shooting.what}: the scene is at rest, or comes to rest. Start from a motion "
                "that goes on"
            )
        return missing / of.size

    now, best, idle = cost(period), np.inf, 0
    for iteration in range(most):
        if closed is None:
            closed = _with_equations(shooting, period, phase, varies)
            rows = [c.slopes(period, closed.by) for c in conditions]
            matrix = np.vstack([closed.equations, *rows])
            gap = np.append(period.gap, errors(period))
        best, idle = (now, 0) if now < best / 2 else (best, idle + 1)
        small = now <= max(shooting.options.tolerance, _LOST / period.size)
        if small or (idle >= _IDLE and now < ROUND_OFF):
            return closed._replace(iterations=iteration, left_over=0.0 if small else now)
        solve = _damped(matrix, damping)
        step = solve(gap)
        try:
            if abs(step[-1]) > _FAR:
                raise NotClosed("the period changes too much")
            moved = shooting.variables.moved(period.start, closed.by, step[:-1])
            after = shooting.run(moved, period.parameter * np.exp(step[-1]))
            then = cost(after)
            left = solve(np.append(after.gap, errors(after)))
            # In stiff scenes the gap may grow on the way to a solution, what is left of steps not.
            better = bool(np.linalg.norm(left) < np.linalg.norm(step))
        except (StepError, NotClosed):
            better = False
        if better:
            period, now, closed, damping = after, then, None, _LESS * damping
        else:
            damping = _MORE * max(damping, 1e-8)
        if damping > 1e6:
            break
    advice = ""
    if now < 1e-3:
        advice = f". If that is near enough, as with round-off, give tolerance = {2 * now:.0e}"
    raise NotClosed(
        f"{shooting.what}: no periodic motion was found in {iteration + 1} iterations: the state "
        f"after a period is still {now:.1e} of the motion away from that before{advice}"
    )


def warn_of_round_off(shooting: Shooting, left_over: Sequence[float]) -> None:
    """Warn, once, of motions of which round-off leaves more than allowed; others have 0."""
    if count := np.count_nonzero(left_over):
        among = f". So it is in {count} of {len(left_over)} motions" * (len(left_over) > 1)
        _log.warning(
            "%s: round-off leaves the state after a period %.1e of the motion away from that "
            "before, where tolerance = %g; a larger tolerance says that this will do%s",
            *(shooting.what, max(left_over), shooting.options.tolerance, among),
        )


def _damped(matrix: np.ndarray, damping: float) -> Callable[[np.ndarray], np.ndarray]:
    """Gives the step for a gap."""
    n = matrix.shape[1]
    damped = np.vstack([matrix, damping * np.eye(n)])

    def solve(gap: np.ndarray) -> np.ndarray:
        right = np.append(-gap, np.zeros(n))
        return scipy.linalg.lstsq(damped, right, ROUNDING, lapack_driver="gelsy")[0]

    return solve
