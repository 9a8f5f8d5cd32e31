"""A run whose steps are controlled by their local errors."""

from __future__ import annotations

from copy import copy
from typing import Protocol

import numpy as np

from fx_beam.errors import Failure, StepError
from fx_beam.results.audit import Stats
from fx_beam.results.state import Past, State

from .local_error import AVERAGED, order_and_constant
from .newton import StepFailed
from .recorder import Recorder, Rows, Unrecorded
from .single_step import SingleStep
from .step_control import StepControl
from .stepper import Attempt

# Steps that are prepared at once: at first, after a change of their length, and at most.
_FIRST_BLOCK, _LARGEST_BLOCK = 16, 1024
# Trials of a first length.
_TRIALS = 40


class Integrator(Protocol):
    """Takes the steps: `Stepper` or `CompiledLoop`."""

    past: Past

    def forget_errors(self) -> None:
        """Do not compare the next steps with those before."""

    def attempt(
        self, state: State, ends: np.ndarray, first: int, recorder: Rows, control: StepControl
    ) -> Attempt:
        """Take steps of equal length."""

    def failure(self, state: State, t1: float) -> StepFailed:
        """Why a step to t1 [s] fails."""


class AdaptiveRun:
    """Takes steps from one break, where loads have a kink or jump, to the next.

    After each break, trial steps find the first length.
    """

    def __init__(
        self,
        integrator: Integrator,
        single: SingleStep,
        recorder: Recorder,
        control: StepControl,
        breaks: list[float],
        max_halvings: int,
        search: bool,
    ):
        self._integrator, self._single, self._recorder = integrator, single, recorder
        self._control, self._breaks, self._max_halvings = control, breaks, max_halvings
        #: Whether a larger first length than that of the control is looked for.
        self._search = search
        self._order, _ = order_and_constant(single.model.scheme)
        self._started = False
        self._next, self._block, self._halvings = 0, _FIRST_BLOCK, 0

    @property
    def _stats(self) -> Stats:
        return self._single.stats

    def advance(self, state: State) -> None:
        """Take some steps from a state, at most up to the next break."""
        control, stats, recorder = self._control, self._stats, self._recorder
        until = self._breaks[self._next]
        if not self._started:
            self._start(state, until)
        ends = control.ends(state.t, until, self._block)
        first, dt = stats.steps + 1, float(ends[0]) - state.t
        last = self._next == len(self._breaks) - 1
        recorder.plan(first, ends, last and ends[-1] == until)
        found = self._integrator.attempt(state, ends, first, recorder, control)
        if found.taken:
            self._halvings = 0
        length = control.length
        if found.failed:
            self._fail(found.state, dt)
        elif found.ratio is not None and found.ratio > 1:
            stats.rejected += 1
            control.reject(dt, found.ratio)
        else:
            control.succeed(dt, found.before, found.ratio)
        if control.too_short:
            raise self._too_short(found.state.t)
        kept = control.length == length and found.taken == len(ends)
        self._block = min(2 * self._block, _LARGEST_BLOCK) if kept else _FIRST_BLOCK
        if found.state.t == until:
            self._next, self._started = self._next + 1, False

    def _start(self, state: State, until: float) -> None:
        """Find the first length by trial steps, which are not part of the run."""
        integrator, control, stats = self._integrator, self._control, self._stats
        number = self._order + AVERAGED
        longest = (until - state.t) / number
        for _ in range(_TRIALS):
            dt = min(control.length, longest)
            past, counts, now = integrator.past, copy(vars(stats)), state
            counts["ended_by"] = dict(stats.ended_by)
            integrator.forget_errors()
            ratio, failed = None, False
            try:
                while ratio is None and not failed:
                    number = round((now.t - state.t) / dt)
                    ends = state.t + dt * np.arange(number + 1, self._order + AVERAGED + 1)
                    found = integrator.attempt(now, ends, 1, Unrecorded(), control)
                    now, ratio, failed = found.state, found.ratio, found.failed
            finally:
                integrator.past = past
                vars(stats).update(counts)
            stats.rejected += self._order + AVERAGED
            if failed:
                self._fail(state, dt)
                continue
            # Only the first length may be far too small; at breaks a trial is lost time.
            search = self._search and stats.steps == 0
            self._halvings = 0
            if ratio is not None and ratio > 1:
                # Longer trials may reach a contact that shorter ones do not: do not try them again.
                longest = min(longest, dt / 2)
            if not control.retry(dt, ratio or 0.0, longest if search else dt):
                break
            if control.too_short:
                raise self._too_short(state.t)
        integrator.forget_errors()
        self._started, self._block = True, _FIRST_BLOCK

    def _fail(self, state: State, dt: float) -> None:
        """Halve the steps after a failure of Newton's method; StepError if this is not allowed."""
        if self._halvings == self._max_halvings:
            failure = self._integrator.failure(state, state.t + dt)
            raise self._single.error(
                f"the step from t = {state.t:.6g} to {state.t + dt:.6g} failed",
                self._halvings,
                state,
                failure,
                "Check the units of loads, velocities and stiffnesses, or try another scheme",
            ) from failure
        self._halvings += 1
        self._stats.halvings += 1
        self._control.fail(dt)

    def _too_short(self, t: float) -> StepError:
        return StepError(
            Failure(
                "too short",
                f"{self._stats.scheme}: at t = {t:.6g} the tolerance asks for steps of "
                f"{self._control.length:.3g} s",
                t,
                advice="If a load jumps there, give its time in `breaks`. Otherwise try a larger "
                "tolerance",
            )
        )
