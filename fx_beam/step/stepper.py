"""Time steps: halved where they fail, counted, recorded, and as a whole where Ctrl-C comes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fx_beam.errors import StepError, any_of
from fx_beam.results.state import State

from .loop import CompiledLoop, Steps, StepsResult
from .recorder import NullRecorder, Rows
from .substeps import Halving

if TYPE_CHECKING:
    from .step_control import StepControl


# Difference of the lengths of equal steps, relative to them, besides the rounding of times.
_SAME = 1e-12


class Trial(NamedTuple):
    """A step that is not part of a run."""

    #: State at its end; None if it fails, or if something that is watched switches in it.
    state: State | None = None
    #: `Model.switches` at its end, or after the first of its sub-steps in which one changes its
    #: sign; None if it fails, or if they are not watched.
    switches: np.ndarray | None = None


class Stepper:
    """Takes time steps; a step that fails is halved."""

    def __init__(self, loop: CompiledLoop, halving: Halving):
        self.loop, self.halving = loop, halving
        self.model, self.stats = loop.model, loop.stats

    def load(self, state: State) -> None:
        """Begin with the past of a state, and with the parts of its steps."""
        self.loop.state.past = state.past
        self.halving.resume(state.parts)

    def advance(self, state: State, times: np.ndarray, first: int, recorder: Rows) -> State:
        """State at the last of `times`, the ends of steps from number `first` on.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        done = 0
        while done < len(times):
            number, dt = equal_steps(state.t, times[done:], self.halving.dt)
            state = self._equal(state, times[done : done + number], dt, first + done, recorder)
            done += number
        return state

    def _equal(
        self, state: State, times: np.ndarray, dt: float, first: int, recorder: Rows
    ) -> State:
        """State after steps of the length dt [s]."""
        loop, halving, stats, t0 = self.loop, self.halving, self.stats, state.t
        inputs, done = loop.inputs_ahead(t0, times), 0
        while done < len(times):
            ends, part_inputs, parts = times[done:], inputs, halving.parts
            if halving.times:
                ends = halving.ends(np.append(t0, times)[done:])
                part_inputs = loop.inputs_ahead(state.t, ends)
            steps_before = stats.steps
            steps = Steps(ends, dt / parts, part_inputs, first + done, halving.done, parts)
            result = loop.take(state, steps, recorder, self._completed)
            state, error, steps_done = result.state, result.error, stats.steps - steps_before
            done += steps_done
            if result.failed:
                loop.state.past = None
                if not halving.fail():
                    raise self.error(state, halving.ends(np.append(t0, times)[done:])[0])
                stats.halvings += 1
            if error is not None:
                raise error
            if done < len(times):
                inputs = inputs.after(steps_done)
        return state

    def _completed(self, count: int) -> int:
        """Number of whole steps that parts of steps complete, which are counted."""
        halving, times = self.halving, self.halving.times
        whole = halving.take(count)
        if halving.times != times:
            # Where steps fail, predictions from steps of another length lead astray.
            self.loop.state.past = None
        return whole

    # -- Steps whose local errors are controlled --------------------------------------------------

    def trial(self, state: State, t1: float, watch: bool = False, tape=None) -> Trial:
        """One step to t1 [s] that is not part of the run; with `watch` also its switches.

        It is counted as others are; see `stats_unchanged`.
        """
        loop, ends = self.loop, np.array([t1])
        inputs = loop.inputs_ahead(state.t, ends)
        steps, recorder = Steps(ends, t1 - state.t, inputs, 1, watch=watch), NullRecorder()
        recorder.tape = tape
        with loop.state.unchanged():
            result = loop.take(state, steps, recorder)
        return Trial(result.state if result.taken else None, result.switches)

    def try_steps(
        self,
        state: State,
        ends: np.ndarray,
        dt: float,
        first: int,
        recorder: Rows,
        control: StepControl,
        watch: bool = False,
    ) -> StepsResult:
        """Take steps of the length dt from number `first` on, as long as this length is right.

        With `watch` only up to where a contact or a law switches.
        """
        inputs = self.loop.inputs_ahead(state.t, ends)
        steps = Steps(ends, dt, inputs, first, control=control, watch=watch)
        result = self.loop.take(state, steps, recorder)
        if result.error is not None:
            raise result.error
        return result

    # -- Errors -----------------------------------------------------------------------------------

    def error(self, start: State, end: float, advice: str = "") -> StepError:
        """StepError for a step to a time [s] that fails after all halvings."""
        failure, halvings = self.loop.failure(start, end), self.halving.most
        advice = advice or self._advice(failure.kind)
        message = f"the step from t = {start.t:.6g} to {end:.6g} failed"
        error = self.loop.failures.error(message, halvings, start, failure, advice)
        error.__cause__ = failure
        return error

    def _advice(self, kind: str) -> str:
        if self.model.reduction.singularity:
            return (
                "Its velocity does not take it out of there. Let it not come to rest in this "
                "position, or let a member yield: a beam in place of a body"
            )
        if kind == "off the end":
            return (
                "The steps before are kept. Use a longer beam, an earlier t_end, or a stop on the "
                "slide that turns the node back"
            )
        advice = (
            f"Try a smaller dt{'' if self.halving.most else ' or max_halvings > 0'}. If this does "
            "not help, check the units of loads, velocities and stiffnesses, or try another scheme"
        )
        if kind == "large rotation":
            advice += (
                ". A moment on a node with almost no inertia, as of a controller, turns it this "
                "far as well: add_mass(node, 0.0, inertia=...)"
            )
        return advice


def equal_steps(t: float, times: np.ndarray, dt: float | None = None) -> tuple[int, float]:
    """Number of steps from t [s] on that have equal length, and this length [s].

    It is dt where they differ by the rounding of times only: so it is the same in all blocks.
    """
    first, last = float(times[0]) - t, float(times[-1])
    rounding = 4 * math.ulp(max(abs(t), abs(last))) + _SAME * first
    if is_known := dt is not None and abs(first - dt) <= rounding:
        first = dt
    different = abs(times[1:] - times[:-1] - first) > rounding
    number = 1 + int(np.argmax(different)) if any_of(different) else len(times)
    return number, first if is_known else (float(times[number - 1]) - t) / number
