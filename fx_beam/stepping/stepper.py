"""Time steps in Python: with PETSc the reference, and the fallback of the compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import StepError
from fx_beam.mechanics.interval import Interval, divided
from fx_beam.mechanics.rates import MidPointRates
from fx_beam.model.model import Model
from fx_beam.results.audit import Stats
from fx_beam.results.state import FORCES, Past, State

from .events import switched
from .forcing import Forcing
from .interrupts import uninterrupted
from .inverted_sections import InversionCheck
from .local_error import LocalError
from .newton import NewtonOptions, StepFailed
from .recorder import Rows
from .single_step import SingleStep
from .step_control import StepControl
from .substeps import LARGE_TURN, Halving


class Attempt(NamedTuple):
    """What came of steps of equal length whose local errors are controlled."""

    #: State at the end of the steps that succeeded, and their number.
    state: State
    taken: int
    #: Ratios of error and limit in the last step but one and in the last one, if they are known.
    before: float | None = None
    ratio: float | None = None
    #: Whether Newton's method failed in the step after them; a ratio above 1 rejects the last step.
    failed: bool = False
    #: Whether a contact or a law switches in the step after them.
    switched: bool = False


class Trial(NamedTuple):
    """A step that is not part of a run."""

    #: State at its end; None if it fails, and perhaps where something switches in it.
    state: State | None = None
    #: `Model.switches` at its end, or after the first of its sub-steps in which one changes its
    #: sign; None if it fails.
    switches: np.ndarray | None = None


class Stepper:
    """Takes time steps; a step that fails is halved."""

    def __init__(
        self, model: Model, forcing: Forcing, options: NewtonOptions, stats: Stats, halving: Halving
    ):
        self.model, self.forcing, self.stats = model, forcing, stats
        self.single = SingleStep(model, forcing, options, stats)
        self.halving = halving
        self.inversion = InversionCheck(model, stats)
        self._errors: LocalError | None = None

    @property
    def past(self) -> Past:
        """The last configurations, from which the next increment is predicted."""
        return self.single.newton.predictor.past

    @past.setter
    def past(self, past: Past | None) -> None:
        self.single.newton.predictor.past = past

    def march(self, state: State, times: np.ndarray, first: int, recorder: Rows) -> State:
        """State at the last of `times`, the ends of steps from number `first` on.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        for number, t in enumerate(map(float, times), start=first):
            step = Interval(state.t, t)
            while state.t < t:
                state = self.part(state, step, number, recorder)
        return state

    def part(self, state: State, step: Interval, number: int, recorder: Rows) -> State:
        """State after the next successful sub-step of a step and its number.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        before, predictor = state, self.single.newton.predictor
        while True:
            part = Interval(before.t, float(self.halving.ends(np.array(step[:2]))[0]))
            try:
                starts, state = self._take(before, part)
            except StepFailed as failure:
                predictor.forget()
                if not self.halving.fail():
                    raise self._error(before, part, failure) from failure
                self.stats.halvings += 1
                continue
            parts = self.halving.parts
            with uninterrupted:
                self._count(before, state)
                if parts > 1:
                    turn = abs(state.q - before.q)[self.model.turns].max()
                    self.stats.too_large += int(turn * parts > LARGE_TURN)
                self._average(before, state, self.halving.done)
                recorder.keep(number, starts, state, (self.halving.done, parts))
                if self.halving.take(1):
                    recorder.record(number, state)
                    self.stats.steps += 1
                if self.halving.parts != parts:
                    # Where steps fail, predictions from steps of another length lead astray.
                    predictor.forget()
                recorder.end = state
            return state

    # -- Steps whose local errors are controlled --------------------------------------------------

    def forget_errors(self) -> None:
        """Do not compare the next steps with those before, for example after a jump of a load."""
        self._errors = LocalError(self.model)

    def trial(self, state: State, t1: float, watch: bool = False) -> Trial:
        """One step to t1 [s] that is not part of the run; with `watch` also its switches."""
        predictor = self.single.newton.predictor
        prediction = predictor.memory
        try:
            starts, end = self._take(state, Interval(state.t, t1))
            return Trial(end, self._switches(state, starts, end) if watch else None)
        except StepFailed:
            return Trial()
        finally:
            predictor.memory = prediction

    def _switches(self, start: State, starts: list[State], end: State) -> np.ndarray:
        first = self.model.switches(start)
        for state in (*starts[1:], end):
            found = self.model.switches(state)
            if switched(first, found):
                break
        return found

    def attempt(
        self,
        state: State,
        ends: np.ndarray,
        first: int,
        recorder: Rows,
        control: StepControl,
        watch: bool = False,
    ) -> Attempt:
        """Take the first of some steps of equal length, number `first`, if its error is small.

        With `watch` it is not taken if a contact or a law switches in it.
        """
        errors, predictor, stats = self._errors, self.single.newton.predictor, self.stats
        assert errors is not None
        step = Interval(state.t, float(ends[0]))
        memory, prediction = errors.memory, predictor.memory
        counted = stats.newton_iterations, dict(stats.ended_by)
        try:
            starts, new = self._take(state, step)
        except StepFailed:
            return Attempt(state, 0, failed=True)
        sides = self.model.switches(state) if watch else np.empty(0)
        event = len(sides) > 0 and switched(sides, self._switches(state, starts, new))
        ratio = errors.add(new.q - state.q, step.length, *control.factors(step.length))
        if event or (ratio is not None and ratio > 1):
            predictor.memory, errors.memory = prediction, memory
            stats.newton_iterations, stats.ended_by = counted
            return Attempt(state, 0, ratio=ratio, switched=event)
        with uninterrupted:
            self._count(state, new)
            recorder.keep(first, starts, new)
            recorder.record(first, new)
            stats.steps += 1
            recorder.end = new
        return Attempt(new, 1, ratio=ratio)

    def failure(self, state: State, t1: float) -> StepFailed:
        """Why Newton's method fails in a step to t1 [s]."""
        try:
            self._take(state, Interval(state.t, t1))
        except StepFailed as failure:
            return failure
        return StepFailed("no convergence", "no convergence", np.zeros(self.model.size), [])

    # -- Steps of all kinds -----------------------------------------------------------------------

    def _take(self, state: State, step: Interval) -> tuple[list[State], State]:
        """States at the starts of all sub-steps of the scheme in a step, and at their end."""
        fractions, predictor = self.model.scheme.fractions, self.single.newton.predictor
        states, solves, prediction = [state], [], predictor.memory
        t0, t1 = np.array(step[:2])[:, None]
        grid = zip(*divided(t0, t1, fractions), strict=True)
        try:
            for self.single.equations.sub_step, ends in enumerate(grid):
                new, solve = self.single.take(states[-1], Interval(*map(float, ends)))
                states.append(new)
                solves.append(solve)
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
        held = isinstance(rates, MidPointRates) and self.model.nodal_rules is None
        for name in (*FORCES, "a") if held else FORCES:
            now = getattr(end, name)
            if now is not None:
                before = getattr(start, name)
                setattr(end, name, before + (now - before) / (done + 1))

    def _count(self, start: State, end: State) -> None:
        """Count a step that succeeded, and what is wrong with its end."""
        self.stats.substeps += 1
        # Damping may give energy in the sub-step that goes back in time. Beyond rounding: damping
        # at rest takes next to nothing.
        given = start.dissipated - end.dissipated
        several = len(self.model.scheme.fractions) > 1
        self.stats.amplified += several and given > 1e-14 * abs(start.dissipated)
        self.inversion.check(end.t, end.q)

    def _error(self, start: State, step: Interval, failure: StepFailed) -> StepError:
        halvings = self.halving.most
        advice = (
            f"Try a smaller dt{'' if halvings else ' or max_halvings > 0'}. If this does not help, "
            "check the units of loads, velocities and stiffnesses, or try another scheme"
        )
        if failure.kind == "off the end":
            advice = (
                "The steps before are kept. Use a longer beam, an earlier t_end, or a stop on the "
                "slide that turns the node back"
            )
        if self.model.reduction.singularity:
            advice = (
                "Its velocity does not take it out of there. Let it not come to rest in this "
                "position, or let a member yield: a beam in place of a body"
            )
        what = f"the step from t = {step.start:.6g} to {step.end:.6g} failed"
        return self.single.error(what, halvings, start, failure, advice)
