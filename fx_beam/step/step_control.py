"""Control of the length of steps by their local errors.

The local error of the mid-point rule is dt^3 q''' / 12, that of a composition of order 4 made of
it dt^5 q''''' / 80 times the sum of the fifth powers of its fractions (exactly so for a linear
oscillation). In terms of differences it is a fraction of the increment that a polynomial through
the last configurations does not predict. This is a divided difference of order p + 1, multiplied by
the times since the last p + 1 configurations: so a jump is not missed, however short the step.

Displacements are small in vibrations that are too fast for the steps, velocities and accelerations
are not: so the estimate does not use them.
"""

from __future__ import annotations

import math

import numpy as np

from fx_beam.laws.schemes import order_and_constant
from fx_beam.scene.functions import Accelerogram

from .model import Model

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
