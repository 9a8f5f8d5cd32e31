"""Lengths of steps: divided where they fail, and chosen by events and local errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError, any_of
from fx_beam.laws.schemes import order_and_constant
from fx_beam.scene.functions import Accelerogram

from .model import Model

# -- Sub-steps: steps of a time grid are divided if they fail as a whole ------------------------


# Number of successful sub-steps before their length is doubled; it grows up to the second value if
# doubling fails.
_SUCCESSES, _MOST_SUCCESSES = 2, 64
# Rotation of a node per step of the grid [rad] from which on a divided step is too large for the
# motion. A whole step with a rotation x has the error x^3 / 12, here 2 % of x: the motion then
# depends on whether the step is halved, and rounding errors may decide this. For smaller rotations
# the difference is not visible.
LARGE_TURN = 0.5


#: With more halvings a sub-step would be smaller than the rounding error of the time.
MOST_HALVINGS = 50


class Halving:
    """Controls the length of sub-steps: halved after a failure, doubled after some successes.

    The length is kept from step to step, so that not every step first fails with a larger one.
    """

    def __init__(self, most: int, dt: float | None = None):
        self.most = most
        #: Length of whole steps [s]; None where they have no common one.
        self.dt = dt
        self.times = self.done = 0
        self._required, self._succeeded, self._doubled = _SUCCESSES, 0, False

    @property
    def state(self) -> np.ndarray | None:
        """State (5,) of the control, from which another run can continue.

        It has the length of whole steps [s], the number of halvings, and the counts for doubling.
        """
        if self.dt is None:
            return None
        counts = self.times, self._required, self._succeeded, self._doubled
        return np.array([self.dt, *counts], float)

    def resume(self, state: np.ndarray | None) -> None:
        """Continue with the state of another run, if its steps have the same length."""
        self.done = 0
        if state is None or self.dt is None or state[1] > self.most:
            return
        if abs(state[0] - self.dt) > 1e-6 * self.dt:
            return
        self.times, self._required, self._succeeded = map(int, state[1:4])
        self._doubled = bool(state[4])

    @property
    def parts(self) -> int:
        """Number of sub-steps of a step."""
        return 2**self.times

    def ends(self, grid: np.ndarray) -> np.ndarray:
        """Ends (m,) [s] of the next sub-steps, up to where their length may be doubled.

        `grid` (n,) has the start of the current step, its end, and the ends of the next steps.
        """
        number = max(1, self._required_now - self._succeeded)
        number += (self.done + number) % 2
        parts = self.done + np.arange(1, number + 1)
        step, part = np.divmod(parts[parts <= (len(grid) - 1) * self.parts], self.parts)
        lengths = np.append(np.diff(grid), 0.0)
        return grid[step] + lengths[step] * part / self.parts

    def count_done(self, number: int) -> int:
        """Count successful sub-steps; returns the number of steps that they complete."""
        steps, self.done = divmod(self.done + number, self.parts)
        if number:
            self._required, self._doubled = self._required_now, False
        self._succeeded += number
        if self.times and self._succeeded >= self._required and self.done % 2 == 0:
            self.times, self.done = self.times - 1, self.done // 2
            self._succeeded, self._doubled = 0, True
        return steps

    @property
    def _required_now(self) -> int:
        """Successes before doubling; their number is halved after a successful doubling."""
        return max(_SUCCESSES, self._required // 2) if self._doubled else self._required

    def fail(self) -> bool:
        """Halve the sub-steps after a failure; False if this is no longer allowed."""
        if self.times == self.most:
            return False
        if self._doubled:
            self._required, self._doubled = min(2 * self._required, _MOST_SUCCESSES), False
        self.times, self.done = self.times + 1, 2 * self.done
        self._succeeded = 0
        return True


# -- Times of the sub-steps of a run, and the whole steps to which they belong ------------------


class WholeSteps(NamedTuple):
    """Some whole steps of a run, with all parts and sub-steps."""

    #: Numbers (n,) of the sub-steps with which they begin, and lengths [s]; 0 for the start itself.
    starts: np.ndarray
    lengths: np.ndarray
    #: Numbers (k,) of all their sub-steps, the steps to which they belong, and their shares.
    sub_steps: np.ndarray
    of: np.ndarray
    shares: np.ndarray


class Times(NamedTuple):
    """Starts, ends and lengths of sub-steps [s], and whether a whole step begins with each.

    Some sub-steps of schemes of order 4 go back in time.
    """

    starts: np.ndarray
    ends: np.ndarray
    lengths: np.ndarray
    begins: np.ndarray
    #: Number of sub-steps of a whole step, or of a part of one that was halved.
    sub_step_count: int = 1

    def steps_to(self, boundaries: np.ndarray) -> WholeSteps:
        """The steps that end before some sub-steps."""
        begins = np.flatnonzero(self.begins)
        last = np.searchsorted(begins, np.maximum(boundaries - 1, 0), side="right") - 1
        starts = np.minimum(begins[last], boundaries)
        counts = boundaries - starts
        rows = np.repeat(np.arange(len(boundaries)), counts)
        sub_steps = np.arange(counts.sum()) + np.repeat(boundaries - counts.cumsum(), counts)
        part_lengths = self.lengths[sub_steps]
        lengths, shares = np.bincount(rows, part_lengths, len(boundaries)), np.ones(len(rows))
        np.divide(part_lengths, lengths[rows], out=shares, where=counts[rows] > 1)
        return WholeSteps(starts, lengths, sub_steps, rows, shares)

    @property
    def first_length(self) -> float:
        """Length of the first step [s]."""
        begins = np.flatnonzero(self.begins)
        return float(self.lengths[: begins[1] if len(begins) > 1 else None].sum())

    def boundaries(self, times: np.ndarray) -> np.ndarray:
        """Numbers of sub-steps before the ends of steps at times (n,) [s].

        SceneError if the tape has a gap, or if a time is inside a step.
        """
        whole = slice(None, None, self.sub_step_count)
        ends = self.ends[self.sub_step_count - 1 :: self.sub_step_count]
        grid = np.concatenate([self.starts[:1], ends])
        least = abs(self.lengths).min(initial=np.inf)
        if any_of(gaps := abs(self.starts[whole] - grid[:-1]) > 1e-3 * least):
            raise SceneError(
                f"the step after t = {grid[:-1][gaps][0]:.6g} failed in the compiled loop, so "
                "that there is no derivative. Try a smaller dt"
            )
        rows = ((grid[1:] + grid[:-1]) / 2).searchsorted(times)
        if any_of(misses := abs(grid[rows] - times) > 1e-3 * least):
            raise SceneError(
                f"the row at t = {times[misses][0]:.6g} is inside a step, and has no derivative. "
                "Record at ends of steps: with a tolerance, give the times as `breaks` too"
            )
        return self.sub_step_count * rows


# -- Where within a step a contact or stop opens or closes, or the law of a spring switches -----


# How close behind the event the end of a step lies, relative to the step in which it was noticed.
_CLOSE = 1e-5
# Largest number of trials.
_TRIALS = 60


def switched(earlier: np.ndarray, later: np.ndarray) -> bool:
    """Whether one of some values has changed its sign."""
    return bool(((earlier < 0) != (later < 0)).any())


def end_behind_event(
    first: np.ndarray, values: Callable[[float], np.ndarray | None], t0: float, t1: float
) -> float | None:
    """End of a step [s] just behind the first change of a sign in a longer one from t0 to t1.

    `first` are the values at the start; `values` gives those after a step to a time, or where one
    of its sub-steps has changed a sign, and None if the step fails. Then the result is None.
    """
    current = values(t1)
    if current is None or not switched(first, current):
        return None
    # The motion is smooth up to the event; a stiff contact bends it behind.
    known_points, end, close = [(t0, first)], t1, _CLOSE * (t1 - t0)
    changing, last = (first < 0) != (current < 0), np.inf
    for _ in range(_TRIALS):
        start = known_points[-1][0]
        if end - start < 2 * close:
            break
        t = _zero([(time, value[changing]) for time, value in known_points]) + close / 2
        if len(known_points) > 2 and abs(t - end) < close / 4:  # just behind the event, as it seems
            t = end - close
        if not start < t < end - close / 4 or t == last:
            t = (start + end) / 2
        current, last = values(t), t
        if current is None:
            return None
        if switched(first, current):
            changing |= (first < 0) != (current < 0)
            end = t
        else:
            known_points = [*known_points[-2:], (t, current)]
    return end


def _zero(points: list[tuple[float, np.ndarray]]) -> float:
    """Time of the next zero of the parabolas through values at times; inf without one."""
    times, values = map(np.array, zip(*points, strict=True))
    if len(times) < 2:
        return np.inf
    unit = times[-1] - times[0]
    zeros = [
        root.real
        for column in values.T
        for root in np.roots(np.polyfit((times - times[-1]) / unit, column, len(times) - 1))
        if abs(root.imag) < 1e-6 and root.real > 0
    ]
    return times[-1] + unit * min(zeros, default=np.inf)


# -- Control of the length of steps by their local errors ---------------------------------------
# The local error of the mid-point rule is dt^3 q''' / 12, that of a composition of order 4 made
# of it dt^5 q''''' / 80 times the sum of the fifth powers of its fractions (exactly so for a
# linear oscillation). In terms of differences it is a fraction of the increment that a polynomial
# through the last configurations does not predict. This is a divided difference of order p + 1,
# multiplied by the times since the last p + 1 configurations: so a jump is not missed, however
# short the step.
#
# Displacements are small in vibrations that are too fast for the steps, velocities and
# accelerations are not: so the estimate does not use them.


#: Differences that are averaged with the weights 1/4, 1/2, 1/4.
AVERAGED = 3
# Largest single local error, relative to the tolerance.
_SINGLE = 0.5
# Local error where accelerations have a kink, as a fraction of what is not predicted: measured with
# balls that bounce on one-sided springs. The same of what is not predicted in steps that are too
# coarse for the small error of order 4, as at the pericentre of orbits.
_KINKED, _COARSE = 0.25, 0.1
# Largest effect of an event within a step, relative to the tolerance.
_EVENT = 0.01
# Reference for the error of a step: a motion that takes 7 / tolerance^(1/order) steps.
_REFERENCE = 0.15
# Desired ratio of the error to what is allowed; between the two others the length is kept.
_DESIRED, _LOWEST, _HIGHEST = 0.5, 0.2, 0.7
# Gains of the controller (PI: Soderlind 2002, doi 10.1023/A:1021160023092).
_INTEGRAL, _PROPORTIONAL = 0.6, 0.3
# Shortest step, relative to the whole time.
_SHORTEST = 1e-10
# Growth after which first steps are tried again with a larger length, and its largest value.
_GROWTH, _MOST_GROWTH = 3.0, 20.0


class StepControl:
    """The length of steps; it changes in few, fixed ratios, so that most steps have equal lengths.

    A smooth part of the local errors adds up from step to step. It may be

        tolerance * sqrt(dt / T) * sqrt(0.15 tolerance^(1/order)),

    the geometric mean of two rules: error per time (the errors of all steps of the time T add up to
    the tolerance) and error per step (the fewest steps for the sum of the errors).
    """

    def __init__(self, model: Model, tolerance: float, span: float, longest: float):
        if not model.scheme.rates.mean_based:  # only means over steps see all samples of a record
            records = (x for _, x in model.data.loads.functions if isinstance(x, Accelerogram))
            longest = min([longest, *(record.spacing for record in records)])
        self._tolerance, self._span, self._longest = tolerance, span, longest
        #: Order of the scheme.
        self.order, self._constant = order_and_constant(model.scheme)
        # The same for single differences; these are of lower order where there may be kinks.
        bent = model.kinks.unseen and self.order > 2
        self._single = max(self._constant, _KINKED) if bent else self._constant
        # The same for those of steps that are too coarse.
        self._coarse = _COARSE if self.order > 2 else 0.0
        #: The ratio of error and limit grows with this power of the length.
        self._power = self.order + 0.5
        #: Length of the next steps [s].
        self.length = min(span / 1000, longest)
        #: Ratio in the last step; 0 if it is not known.
        self._last_ratio = 0.0

    def factors(self, dt: float) -> tuple[float, float, float]:
        """Factors that make ratios of error and limit of averaged and of single differences.

        And of single ones where steps are too coarse for their order.
        """
        share = _REFERENCE * self._tolerance ** (1 / self.order) * dt / self._span
        limit, single = self._tolerance * math.sqrt(share), _SINGLE * self._tolerance
        return self._constant / limit, self._single / single, self._coarse / single

    def band(self, dt: float) -> tuple[float, float]:
        """Ratios between which steps of length dt [s] are kept.

        They are made longer only after two steps with lower ratios.
        """
        shortened = dt < (1 - 1e-6) * self.length
        longest = dt > (1 - 1e-6) * self._longest
        return 0.0 if shortened or longest else _LOWEST, _HIGHEST

    def ends(self, t: float, t_end: float, most: int) -> tuple[np.ndarray, float]:
        """Ends (n,) and length [s] of the next equal steps, up to a time that they must meet."""
        number = (t_end - t) / self.length
        if number > 3:
            return t + self.length * np.arange(1, min(int(number) - 1, most + 1)), self.length
        steps = max(1, math.ceil(number - 1e-6))
        ends = t + (t_end - t) * np.arange(1, steps + 1) / steps
        ends[-1] = t_end
        return ends, (t_end - t) / steps

    def restart(self, length: float) -> None:
        """Start with a length [s], without a memory of steps before."""
        self.length, self._last_ratio = min(length, self._longest), 0.0

    def succeed(self, dt: float, last_ratio: float | None, ratio: float | None) -> None:
        """Choose the length after steps of length dt, from the last two ratios."""
        if ratio is None:
            return
        last_ratio = self._last_ratio if last_ratio is None else last_ratio
        low, high = self.band(dt)
        if ratio > high or max(ratio, last_ratio) < low:
            distance = self._distance(ratio)
            rise = distance - self._distance(last_ratio) if last_ratio else 0.0
            change = _INTEGRAL * distance + _PROPORTIONAL * rise
            levels = min(max(round(abs(change)), 1), self.order)
            self._change(-levels if ratio > high else levels)
        self._last_ratio = ratio

    def reject(self, dt: float, ratio: float) -> None:
        """Shorten the steps after one of length dt with a ratio above 1."""
        self.length, self._last_ratio = dt, ratio
        self._change(-min(math.ceil(self._distance(ratio)), 3 * self.order))

    def matters(self, difference: float) -> bool:
        """Whether an event may not be passed that moves the end of a step, relative to the size."""
        return difference > _EVENT * self._tolerance

    def retry(self, dt: float, ratio: float, longest: float) -> bool:
        """Choose the first length from the ratio of trial steps; whether to try again with it.

        It is at most `at_most` [s].
        """
        factor = (_DESIRED / max(ratio, 1e-12)) ** (1 / self._power)
        longer = dt < (1 - 1e-6) * min(longest, self._longest)
        if ratio <= 1 and not (longer and factor > _GROWTH):
            self.restart(dt * min(factor, 1.0))
            return False
        self.restart(min(dt * min(max(factor, 1 / _MOST_GROWTH), _MOST_GROWTH), longest))
        return True

    @property
    def too_short(self) -> bool:
        """Whether the steps are shorter than any motion needs."""
        return self.length < _SHORTEST * self._span

    def _distance(self, ratio: float) -> float:
        return math.log2(max(ratio, 1e-12) / _DESIRED)

    def _change(self, levels: int) -> None:
        """Change the length by levels, each of which changes the ratio by a factor of two."""
        self.length = min(self.length * 2 ** (levels / self._power), self._longest)
