"""The equilibrium path of a scene up to its full load, by steps of the load factor."""

from __future__ import annotations

from fx_beam.errors import StepError
from fx_beam.results.state import State
from fx_beam.step.step_failures import StepFailed

from .load_steps import EASY_DEVIATION, LoadStepper

# The step is doubled at most at this number of corrections.
_EASY_ITERATIONS = 10
# Growth of the displacement per load, relative to the first step, that indicates a limit point.
_SOFTENING = 4.0


def raise_load(stepper: LoadStepper, states: list[State]) -> None:
    """Append the states from the last one up to load factor 1; StepError after all cuts.

    A step is halved if it fails, and doubled after an easy one; `load_steps` limits its length. One
    that starts or ends at a bifurcation goes over it.
    """
    longest = stride = 2**stepper.options.max_cuts
    # Load factors are multiples of 1/count.
    count = stepper.options.load_steps * longest
    place = round(states[-1].t * stepper.options.load_steps) * longest
    while place < count:
        end = place + min(stride, longest - place % longest)
        goal = end / count
        stepper.may_be_cut = stride > 1
        stepper.hold_between(place / count, goal)
        try:
            states.append(stepper.step(states[-1], goal))
        except StepFailed as failure:
            if stride == 1:
                place = min(end + 1, count)
                if not _stepped_over(stepper, states, place / count):
                    raise _error(stepper, states[-1], goal, failure) from failure
                continue
            stepper.stats.halvings += 1
            stride //= 2
            continue
        place = end
        easy = stepper.deviation <= EASY_DEVIATION and stepper.iterations <= _EASY_ITERATIONS
        if easy and 2 * stride <= longest and place % (2 * stride) == 0:
            stride *= 2


def _stepped_over(stepper: LoadStepper, states: list[State], goal: float) -> bool:
    """Whether a step from the last state but one to a goal replaces the last one.

    A state at a bifurcation has no definite tangent from which to go on.
    """
    if len(states) < 2:
        return False
    stepper.hold_between(states[-2].t, goal)
    try:
        states[-2:] = states[-2], stepper.step(states[-2], goal)
    except StepFailed:
        return False
    return True


def _error(stepper: LoadStepper, state: State, goal: float, failure: StepFailed) -> StepError:
    response, most = stepper.response, stepper.options.max_cuts
    message = f"the step from load factor {state.t:.6g} to {goal:.6g} failed"
    advice = (
        'If the path has a limit point there, use continuation="arc-length". Otherwise try '
        "more steps or cuts (max_cuts), and check the units of loads and stiffnesses"
    )
    if len(response) == 2 and response[1] > _SOFTENING * response[0]:
        advice = (
            f"The displacement per load is {response[1] / response[0]:.3g} times that of the first "
            'step, which indicates a limit point. Use continuation="arc-length" to pass it'
        )
    if stepper.model.couplings.sliding:
        advice += (
            ". A node that slides on a slack cable moves far under a small load: find its place by "
            "a simulation with dampers. Elements longer than sqrt(EI / N), with the axial force N, "
            "hold it as friction would"
        )
    return stepper.loop.failures.error(message, most, state, failure, advice)
