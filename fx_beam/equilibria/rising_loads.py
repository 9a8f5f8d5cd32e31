"""The equilibrium path of a scene up to its full load, by steps of the load factor."""

from __future__ import annotations

from fx_beam.errors import StepError
from fx_beam.results.state import State
from fx_beam.step.step_failures import StepFailed

from .continuation import follow
from .load_steps import EASY_DEVIATION, LoadStepper

# The step is doubled at most at this number of corrections.
_EASY_ITERATIONS = 10
# Growth of the displacement per load, relative to the first step, that indicates a limit point.
_SOFTENING = 4.0


class RisingLoads:
    """Appends the states on a path from the last one to load factor 1.

    Load factors are multiples of 1/count. A step is halved if it fails, and doubled after an easy
    one; `load_steps` limits its length.
    """

    def __init__(self, stepper: LoadStepper, states: list[State]):
        self._stepper, self._states, self._options = stepper, states, stepper.options
        self._longest = 2**self._options.max_cuts
        self._count = self._options.load_steps * self._longest

    def run(self) -> None:
        """Append the states; StepError if a step fails after all cuts."""
        place = round(self._states[-1].t * self._options.load_steps) * self._longest
        steps = follow(place, self._longest, self._advance, self._shorter, (StepFailed,))
        while place < self._count:
            place = next(steps)

    def _advance(self, place: int, stride: int) -> tuple[int, int]:
        """The multiple at the end of a step, and the length of the next one."""
        stepper, goal = self._stepper, (place + stride) / self._count
        stepper.may_be_cut = stride > 1
        stepper.hold_between(place / self._count, goal)
        self._states.append(stepper.step(self._states[-1], goal))
        place += stride
        easy = stepper.deviation <= EASY_DEVIATION and stepper.iterations <= _EASY_ITERATIONS
        longer = easy and 2 * stride <= self._longest and place % (2 * stride) == 0
        return place, 2 * stride if longer else stride

    def _shorter(self, place: int, stride: int, failure: Exception) -> int:
        """Length of a step in place of one that has failed."""
        assert isinstance(failure, StepFailed)
        if stride == 1:
            raise self._error((place + stride) / self._count, failure) from failure
        self._stepper.stats.halvings += 1
        return stride // 2

    def _error(self, goal: float, failure: StepFailed) -> StepError:
        stepper, state, response = self._stepper, self._states[-1], self._stepper.response
        message = f"the step from load factor {state.t:.6g} to {goal:.6g} failed"
        advice = (
            'If the path has a limit point there, use continuation="arc-length". Otherwise try '
            "more steps, and check the units of loads and stiffnesses"
        )
        if len(response) == 2 and response[1] > _SOFTENING * response[0]:
            advice = (
                f"The displacement per load is {response[1] / response[0]:.3g} "
                "times that of the first step, which indicates a limit point. Use "
                'continuation="arc-length" to pass it'
            )
        if stepper.model.couplings.sliding:
            advice += (
                ". A node that slides on a slack cable moves far under a small load: find its "
                "place by a simulation with dampers. Elements longer than sqrt(EI / N), with the "
                "axial force N, hold it as friction would"
            )
        return stepper.loop.failures.error(message, self._options.max_cuts, state, failure, advice)
