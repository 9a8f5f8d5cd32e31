"""Time steps from the state in C: halved where they fail, counted, recorded, and undone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fx_beam.errors import StepError, any_of
from fx_beam.results.records import stats_unchanged
from fx_beam.results.state import State

from .full_turns import TurnCounter
from .loop import CompiledLoop, EqualSteps, StepsResult
from .recorder import Mark, NullRecorder, Recorder, Rows
from .step_failures import OPEN, StepFailed
from .substeps import Halving

if TYPE_CHECKING:
    from .step_control import StepControl
    from .tape import Tape


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
    """Takes time steps from the state in C; a step that fails is halved.

    At the end of steps a single assignment makes a mark the `end` of their recorder.
    """

    def __init__(self, loop: CompiledLoop, halving: Halving, turn_counter: TurnCounter):
        self.loop, self.halving, self.turn_counter = loop, halving, turn_counter
        self.model, self.stats = loop.model, loop.stats

    # -- The state --------------------------------------------------------------------------------

    def load(self, state: State) -> None:
        """Begin with a state, its past, and the parts of its steps."""
        self.loop.state.load(state)
        self.loop.state.past = state.past
        self.halving.resume(state.parts)

    def state(self) -> State:
        """A copy of the state, with all on which the next step depends."""
        state = self.loop.state
        return state.read().changed(past=state.past, parts=self.halving.state)

    def begin_rows(self, state: State, recorder: Rows) -> None:
        """Begin the rows of a run with its first state."""
        if isinstance(recorder, Recorder):
            self.loop.record(state, recorder)
        self.mark(recorder)

    def mark(self, recorder: Rows) -> None:
        """Make the state the end of the last steps of a recorder."""
        state = self.loop.state
        halving, turns = dict(vars(self.halving)), self.turn_counter.removed
        recorder.end = Mark(state.t, state.copy(), halving, recorder.rows, turns)

    def return_to(self, mark: Mark, recorder: Rows) -> None:
        """Undo all steps after a mark."""
        self.loop.state.restore(mark.state)
        vars(self.halving).update(mark.halving)
        self.turn_counter.removed = mark.turns
        recorder.truncate(mark.rows)
        recorder.miss(mark.turns)
        recorder.end = mark

    def count_turns(self, recorder: Rows) -> None:
        """Take full turns out of the state, which rows miss from here on.

        Counted separately, they do not add to rounding errors.
        """
        counter, arrays = self.turn_counter, self.loop.state.arrays
        if not (turns := counter.turns_of(arrays["q"])).any():
            return
        for name in ("q", "q_previous"):
            if arrays[name].size:
                arrays[name][:] -= turns
        counter.removed = counter.removed + turns
        recorder.miss(counter.removed)
        self.mark(recorder)

    # -- Steps ------------------------------------------------------------------------------------

    def advance(self, times: np.ndarray, first: int, recorder: Rows) -> None:
        """Take steps that end at `times`, from number `first` on.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        done, state = 0, self.loop.state
        while done < len(times):
            number, dt = equal_steps(state.t, times[done:], self.halving.dt)
            self._equal(times[done : done + number], dt, first + done, recorder)
            done += number

    def _equal(self, times: np.ndarray, dt: float, first: int, recorder: Rows) -> None:
        """Take steps of the length dt [s]."""
        loop, halving, t0 = self.loop, self.halving, self.loop.state.t
        inputs, done = loop.inputs_ahead(t0, times), 0
        while done < len(times):
            ends, part_inputs, parts = times[done:], inputs, halving.parts
            if halving.times:
                ends = halving.ends(np.append(t0, times)[done:])
                part_inputs = loop.inputs_ahead(loop.state.t, ends)
            steps = EqualSteps(ends, dt / parts, part_inputs, first + done, halving.done, parts)
            count = loop.take_steps(steps, recorder)
            steps_done = self._completed(count, recorder) if count else 0
            done += steps_done
            if count < part_inputs.steps:
                loop.state.past = None
                if not halving.fail():
                    raise self.error(halving.ends(np.append(t0, times)[done:])[0])
                self.stats.halvings += 1
            elif part_inputs.error is not None:
                raise part_inputs.error
            if done < len(times):
                inputs = inputs.after(steps_done)

    def _completed(self, count: int, recorder: Rows) -> int:
        """Number of whole steps that parts of steps complete, which are counted."""
        halving, times = self.halving, self.halving.times
        whole = halving.count_done(count)
        if halving.times != times:
            # Where steps fail, predictions from steps of another length lead astray.
            self.loop.state.past = None
        self.stats.steps += whole
        self.mark(recorder)
        return whole

    # -- Steps whose local errors are controlled --------------------------------------------------

    @contextmanager
    def unchanged(self) -> Iterator[None]:
        """In this block steps are tried, after which state and statistics are as before."""
        with self.loop.state.unchanged(), stats_unchanged(self.stats):
            yield

    def trial(
        self, state: State, t1: float, watch: bool = False, tape: Tape | None = None
    ) -> Trial:
        """One step to t1 [s] that is not part of the run; with `watch` also its switches."""
        loop, ends, recorder = self.loop, np.array([t1]), NullRecorder()
        recorder.tape = tape
        with self.unchanged():
            loop.state.load(state)
            inputs = loop.inputs_ahead(state.t, ends)
            steps = EqualSteps(ends, t1 - state.t, inputs, 1, watch=watch)
            count = loop.take_steps(steps, recorder)
            switches = loop.result(steps, count).switches
            return Trial(loop.state.read() if count else None, switches)

    def try_steps(
        self,
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
        inputs = self.loop.inputs_ahead(self.loop.state.t, ends)
        steps = EqualSteps(ends, dt, inputs, first, control=control, watch=watch)
        count = self.loop.take_steps(steps, recorder)
        if count:
            self.stats.steps += count
            self.mark(recorder)
        if inputs.error is not None and count == inputs.steps:
            raise inputs.error
        return self.loop.result(steps, count)

    # -- Errors -----------------------------------------------------------------------------------

    def error(self, end: float, advice: str = "") -> StepError:
        """StepError for a step to a time [s] that fails after all halvings."""
        start, halvings = self.loop.state.read(), self.halving.most
        failure = self.loop.failure(start, end)
        advice = advice or self._advice(failure)
        message = f"the step from t = {start.t:.6g} to {end:.6g} failed"
        error = self.loop.failures.error(message, halvings, start, failure, advice)
        error.__cause__ = failure
        return error

    def _advice(self, failure: StepFailed) -> str:
        if self.model.reduction.singularity:
            return (
                "Its velocity does not take it out of there. Let it not come to rest in this "
                "position, or let a member yield: a beam in place of a body"
            )
        if failure.kind == "off the end":
            return (
                "The steps before are kept. Use a longer beam, an earlier t_end, or a stop on the "
                "slide that turns the node back"
            )
        if failure.reason == OPEN and self.model.couplings.driven:
            return (
                "A motor or a driven motion may lead it past a position where bodies are in line "
                "(a toggle), which no dt passes: let it turn back before, or drive another joint. "
                "Else try a smaller dt"
            )
        advice = (
            f"Try a smaller dt{'' if self.halving.most else ' or max_halvings > 0'}. If this does "
            "not help, check the units of loads, velocities and stiffnesses, or try another scheme"
        )
        if failure.kind == "large rotation":
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
    number = len(times)
    if number > 1 and any_of(different := abs(times[1:] - times[:-1] - first) > rounding):
        number = 1 + int(np.argmax(different))
    return number, first if is_known else (float(times[number - 1]) - t) / number
