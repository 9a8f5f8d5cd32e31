"""Periodic motions by Newton's method, with a damping that fades (Levenberg and Marquardt)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg

from fx_beam.errors import SceneError, StepError
from fx_beam.results.state import State
from fx_beam.step.newton import newton

from .shooting import Period, Shooting
from .variables import Directions

_log = logging.getLogger("fx_beam")

# The damping at the begin, its factors after a success and a failure, and the largest one.
_DAMPED, _LESS, _MORE, _LARGEST = 0.1, 0.1, 10.0, 1e6
# Singular values of the equations that are round-off, relative to the largest.
_ROUNDING = 1e-13
# Growth of changes in a period above which they say nothing about the next state.
_USEFUL = 1e9
# Gaps that are round-off, in units of the scene.
_LOST = 1e-14
#: Gaps, relative to the motion, that are round-off if they have not halved in so many iterations.
ROUND_OFF, _IDLE = 1e-6, 4
# Largest change of the parameter's logarithm in an iteration.
_FAR = 3.0


class Condition(NamedTuple):
    """An equation besides the gap of the period: where a motion begins, or its energy."""

    #: What a motion misses.
    error: Callable[[Period], float]
    #: Derivatives (n + 1,) of it by the directions at the start, and by the parameter's logarithm.
    slopes: Callable[[Period, Directions], np.ndarray]


class Closed(NamedTuple):
    """A periodic motion, and its equations."""

    period: Period
    directions: Directions
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


def _on_its_way(period: Period, directions: Directions) -> np.ndarray:
    row = np.append(period.way @ directions.matrix, 0.0)
    return row / np.linalg.norm(row)


#: That the state does not change along the motion, which only shifts a free motion in time.
NO_SHIFT = Condition(lambda period: 0.0, _on_its_way)


def plane(
    shooting: Shooting,
    scale: np.ndarray,
    normal: np.ndarray,
    place: np.ndarray | float = 0.0,
    parameter: float = 1.0,
) -> Condition:
    """Condition for a start in a plane through the rows of a place, over scales, and a parameter.

    The last entry of its normal (rows + 1,) is for the parameter's logarithm.
    """

    def error(period: Period) -> float:
        rows = (shooting.variables.rows_of(period.start) - place) / scale
        return float(normal @ np.append(rows, np.log(period.parameter / parameter)))

    def slopes(period: Period, directions: Directions) -> np.ndarray:
        rows = directions.matrix * (directions.scale / scale)[:, None]
        return np.append(normal[:-1] @ rows, normal[-1])

    return Condition(error, slopes)


def turning_point(shooting: Shooting, goal: Period) -> Condition:
    """Condition for a start where the speed turns: at rest, if the motion returns on its way.

    The direction of the acceleration there is that of the motion it should be like.
    """
    way = np.where(shooting.variables.are_rates, goal.way, 0.0) / np.linalg.norm(goal.way)
    return plane(shooting, shooting.variables.scales(goal.start, goal.length), np.append(way, 0.0))


def _with_equations(
    shooting: Shooting, period: Period, phase: Condition | None, varies: bool
) -> Closed:
    directions = shooting.variables.directions(period.start, period.length)
    slopes = shooting.slopes(directions.changes, period)
    growth = abs(slopes[0]).max()
    if growth > _USEFUL:
        raise SceneError(
            f"{shooting.what}: changes of the state grow {growth:.1e} times in a period: the "
            "motion is chaotic, or strikes. Give the scene damping, or take another start"
        )
    column = shooting.parameter_slope(period) if varies else np.zeros(len(period.gap))
    matrix = np.column_stack([slopes[0] - directions.matrix, column])
    # What is remembered and does not change, such as plastic strain, is no unknown.
    independent = directions.independent
    constant = (independent >= shooting.variables.movable) & ~matrix[independent].any(axis=1)
    matrix[:, np.flatnonzero(constant)] = 0.0
    if phase is not None:
        matrix = np.vstack([matrix, phase.slopes(period, directions)])
    return Closed(period, directions, *slopes, matrix)


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
    most: int = 39,
    damping: float = _DAMPED,
) -> Closed:
    """The periodic motion near a state; free motions need a `phase`, where they begin.

    The parameter `varies`, or is held. Near the motion no `damping` is needed. NotClosed if there
    is none, or StepError.
    """
    search = _Search(shooting, phase, conditions, varies, damping)
    period = shooting.run(start, parameter)
    search.accept(period, search.error_of(period))
    search.best = search.error
    iterations, ended_by = 0, "increment"
    if search.error > search.allowed:
        iterations, ended_by = newton(search.correct, 1.0, most)
    if not ended_by:
        raise search.failure()
    left_over = search.error if search.error > search.allowed else 0.0
    return search.closed._replace(iterations=iterations, left_over=left_over)


@dataclass
class _Search:
    """Newton's method from motion to motion. A damping grows where a correction does not help."""

    shooting: Shooting
    phase: Condition | None
    conditions: tuple[Condition, ...]
    varies: bool
    damping: float
    #: Number of corrections, the least error, and corrections since it was last halved.
    tries: int = 0
    best: float = np.inf
    idle: int = 0

    def accept(self, period: Period, error: float) -> None:
        """Go on from a motion over a period, with its error."""
        #: How far the ends of the motion are apart, relative to its size, and what is allowed.
        self.period, self.error = period, error
        self.allowed = max(self.shooting.options.tolerance, _LOST / period.size)
        #: The motion with its equations.
        self.closed = _with_equations(self.shooting, period, self.phase, self.varies)

    def _missing(self, period: Period) -> np.ndarray:
        """The gap of a motion, and how far it is from the conditions."""
        conditions = self.conditions if self.phase is None else (self.phase, *self.conditions)
        return np.append(period.gap, [condition.error(period) for condition in conditions])

    def error_of(self, period: Period) -> float:
        """How far the ends of a motion are apart, relative to it; NotClosed if it comes to rest."""
        missing = float(np.linalg.norm(self._missing(period)))
        if not period.moves or not np.isfinite(missing):
            raise NotClosed(
                f"{self.shooting.what}: the scene is at rest, or comes to rest. Start from a "
                "motion that goes on"
            )
        return missing / period.size

    def correct(self) -> tuple[float, bool]:
        """The least error so far, over what is allowed, and whether round-off leaves it."""
        shooting, period, directions = self.shooting, self.period, self.closed.directions
        self.tries += 1
        rows = [condition.slopes(period, directions) for condition in self.conditions]
        solve = _damped(np.vstack([self.closed.equations, *rows]), self.damping)
        step = solve(self._missing(period))
        try:
            if abs(step[-1]) > _FAR:
                raise NotClosed("the period changes too much")
            start = shooting.variables.moved(period.start, directions, step[:-1])
            new = shooting.run(start, period.parameter * np.exp(step[-1]))
            error, rest = self.error_of(new), solve(self._missing(new))
            # In stiff scenes the gap may grow on the way to a solution, what is left of steps not.
            better = bool(np.linalg.norm(rest) < np.linalg.norm(step))
        except (StepError, NotClosed):
            better = False
        if better:
            self.accept(new, error)
            self.damping *= _LESS
        else:
            self.damping = _MORE * max(self.damping, 1e-8)
        if self.damping > _LARGEST:
            raise self.failure()
        halved = self.error < self.best / 2
        self.best, self.idle = (self.error, 0) if halved else (self.best, self.idle + 1)
        size = self.error if self.error <= self.allowed else self.best
        return size / self.allowed, self.idle >= _IDLE and self.error < ROUND_OFF

    def failure(self) -> NotClosed:
        """Error of a search that found no periodic motion."""
        advice = ""
        if self.error < 1e-3:
            tolerance = f"{2 * self.error:.0e}"
            advice = f". If that is near enough, as with round-off, give tolerance = {tolerance}"
        return NotClosed(
            f"{self.shooting.what}: no periodic motion was found in {self.tries} iterations: the "
            f"state after a period is still {self.error:.1e} of the motion away from that "
            f"before{advice}"
        )


def least_squares(matrix: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The shortest x (n, ...) with the least matrix x - sides, where round-off is zero."""
    return scipy.linalg.lstsq(matrix, sides, _ROUNDING, lapack_driver="gelsy")[0]


def _damped(matrix: np.ndarray, damping: float) -> Callable[[np.ndarray], np.ndarray]:
    """Gives the step for a gap."""
    n = matrix.shape[1]
    damped = np.vstack([matrix, damping * np.eye(n)])

    def solve(gap: np.ndarray) -> np.ndarray:
        return least_squares(damped, np.append(-gap, np.zeros(n)))

    return solve


def warn_of_round_off(shooting: Shooting, left_over: Sequence[float]) -> None:
    """Warn once of motions whose gap round-off leaves larger than allowed; others have 0."""
    if count := np.count_nonzero(left_over):
        among = f". So it is in {count} of {len(left_over)} motions" * (len(left_over) > 1)
        _log.warning(
            "%s: round-off leaves the state after a period %.1e of the motion away from that "
            "before, where tolerance = %g; a larger tolerance says that this will do%s",
            *(shooting.what, max(left_over), shooting.options.tolerance, among),
        )
