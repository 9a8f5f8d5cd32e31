"""Time steps on several processes: each evaluates its part, and PETSc solves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fx_beam.laws.interval import Interval
from fx_beam.results.audit import Stats
from fx_beam.results.state import FORCES, Past, State
from fx_beam.step.events import switched
from fx_beam.step.forcing import Forcing
from fx_beam.step.interrupts import uninterrupted
from fx_beam.step.inverted_sections import InversionCheck
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions, StepFailed
from fx_beam.step.recorder import Recorder, Rows
from fx_beam.step.single_step import SingleStep
from fx_beam.step.steps_result import Steps, StepsResult
from fx_beam.step.substeps import LARGE_TURN

from .local_error import LocalError
from .predictor import Predictor
from .team import Team
from .whole import share


class LateInputs:
    """Functions of time are evaluated in each step."""

    def after(self, steps: int) -> LateInputs:
        """Nothing is known of later steps either."""
        return self


class TeamLoop:
    """Tries one step after the other; in the place of `CompiledLoop`."""

    def __init__(
        self, team: Team, model: Model, forcing: Forcing, options: NewtonOptions, stats: Stats
    ):
        self.model, self.stats = model, stats
        self._inversion = InversionCheck(model, stats)
        self._errors: LocalError | None = None
        #: Takes single steps.
        self.single = SingleStep(model, forcing, options, stats)
        self.predictor = self.single.newton.predictor = Predictor(model)
        share(team, self.single)
        stats.solver = f"PETSc on {team.size} processes"

    @property
    def past(self) -> Past:
        """The last configurations, from which the next increment is predicted."""
        return self.predictor.past

    @past.setter
    def past(self, past: Past | None) -> None:
        self.predictor.past = past

    def forget_past(self) -> None:
        """Predict nothing in the next step."""
        self.predictor.forget()

    def forget_errors(self) -> None:
        """Do not compare the next steps with those before."""
        self._errors = LocalError(self.model)

    def record_start(self, state: State, recorder: Recorder) -> None:
        """Record the state at the start of a run."""
        recorder.record(0, state)

    def inputs(self, t: float, ends: np.ndarray) -> LateInputs:
        """Nothing yet."""
        return LateInputs()

    def take(
        self,
        state: State,
        ends: np.ndarray,
        inputs: LateInputs,
        steps: Steps,
        recorder: Rows,
        count: Callable[[StepsResult], None],
    ) -> StepsResult:
        """Take the first of some steps or parts, if it succeeds."""
        step, control = Interval(state.t, float(ends[0])), steps.control
        errors, predictor, stats = self._errors, self.predictor, self.stats
        prediction, memory = predictor.memory, None if errors is None else errors.memory
        counted = stats.newton_iterations, dict(stats.ended_by)
        try:
            starts, new = self._take(state, step)
        except StepFailed:
            return StepsResult(state, 0, failed=True)
        result = StepsResult(new, 1)
        if steps.watch:
            switches, first = self._switches(state, starts, new), self.model.switches(state)
            result = result._replace(switches=switches, switched=switched(first, switches))
        if control is not None:
            assert errors is not None
            factors = control.factors(step.length)
            result = result._replace(ratio=errors.add(new.q - state.q, step.length, *factors))
        if result.switched or (result.ratio or 0.0) > 1:
            predictor.memory = prediction
            if errors is not None and memory is not None:
                errors.memory = memory
            stats.newton_iterations, stats.ended_by = counted
            return result._replace(state=state, taken=0)
        with uninterrupted:
            self._count(state, new, steps.parts)
            self._average(state, new, steps.done)
            recorder.store_starts(steps.first, starts, new, (steps.done, steps.parts))
            if steps.done + 1 == steps.parts:
                recorder.record(steps.first, new)
            count(result)
        return result

    def _switches(self, start: State, starts: list[State], end: State) -> np.ndarray:
        """Values at the end of a step, or of its first sub-step in which one changes its sign."""
        first = self.model.switches(start)
        for state in (*starts[1:], end):
            switches = self.model.switches(state)
            if switched(first, switches):
                break
        return switches

    def _take(self, state: State, step: Interval) -> tuple[list[State], State]:
        """States at the starts of all sub-steps of the scheme in a step, and at their end."""
        fractions, predictor = self.model.scheme.fractions, self.predictor
        prediction = predictor.memory
        try:
            states, solves = self.single.through(state, step)
        except BaseException:
            predictor.memory = prediction
            raise
        for solve in solves:
            self.stats.add_solve(solve.iterations, solve.ended_by)
        *starts, end = states
        if len(fractions) > 1:  # means over the step, as for a scheme without sub-steps
            if self.model.nodal_rules is None:
                end.a = (end.v - state.v) / step.length
            for name in FORCES:
                parts = [getattr(sub_step, name) for sub_step in states[1:]]
                if parts[0] is not None:
                    setattr(end, name, np.tensordot(fractions, parts, 1))
        return starts, end

    def _average(self, start: State, end: State, done: int) -> None:
        """Make forces of a part means over the step so far, of which some parts are done."""
        rates = self.model.scheme.rates
        if not done or rates.level != 0.5:
            return
        for name in (*FORCES, "a") if rates.by_mean else FORCES:
            now = getattr(end, name)
            if now is not None:
                before = getattr(start, name)
                setattr(end, name, before + (now - before) / (done + 1))

    def _count(self, start: State, end: State, parts: int) -> None:
        """Count a step or one of its parts that succeeded, and what is wrong with its end."""
        self.stats.substeps += 1
        # Damping may give energy in the sub-step that goes back in time. Beyond rounding: damping
        # at rest takes next to nothing.
        given = start.dissipated - end.dissipated
        several = len(self.model.scheme.fractions) > 1
        self.stats.amplified += several and given > 1e-14 * abs(start.dissipated)
        if parts > 1:
            turn = abs(end.q - start.q)[self.model.turns].max()
            self.stats.too_large += int(turn * parts > LARGE_TURN)
        self._inversion.check(end.t, end.q)


class TeamSingleSteps:
    """Tries single steps from the present state; compare `single_steps`.

    An interrupt may come anywhere: whether a step is taken changes by one assignment.
    """

    def __init__(self, loop: TeamLoop):
        self._loop = loop

    def load(self, state: State, number: int) -> None:
        """Begin with a state after some steps."""
        self._loop.past = state.past
        self._last = replace(state, past=self._loop.past), number

    @property
    def now(self) -> State:
        """The present state."""
        return self._last[0]

    @property
    def completed(self) -> int:
        """Number of steps to it."""
        return self._last[1]

    def state(self, t: float) -> State:
        """The present state, with its past."""
        return self.now

    def take(self, number: int, t0: float, t1: float, recorder: Rows) -> bool:
        """Whether a step succeeds; otherwise the state is that before it."""
        loop = self._loop
        loop.past = self.now.past  # also where a step was broken off

        def advance(result: StepsResult) -> None:
            self._last = replace(result.state, past=loop.past), number

        steps, inputs = Steps(number), LateInputs()
        return not loop.take(self.now, np.array([t1]), inputs, steps, recorder, advance).failed

    def count(self, taken: int) -> None:
        """All is counted."""
