"""A run whose steps are controlled by their local errors."""

from __future__ import annotations

import math

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import Failure, SceneError, StepError
from fx_beam.results.state import FORCES, State
from fx_beam.step.events import end_behind_event
from fx_beam.step.loop import StepsResult
from fx_beam.step.recorder import NullRecorder, Recorder, Rows
from fx_beam.step.state_values import energy_of
from fx_beam.step.step_control import AVERAGED, StepControl
from fx_beam.step.stepper import Stepper, Trial

from .initial_state import Starts
from .options import StepPlan

# Steps that are prepared at once: at first, after a change of their length, and at most.
_FIRST_BLOCK, _LARGEST_BLOCK = 16, 1024
# Trials of a first length.
_TRIALS = 40
# Distance from a break, relative to the whole time, and by how much a driven motion that jumps
# there differs on both sides, in units of the scene.
_BESIDE, _LEAST_JUMP = 1e-12, 1e-9
# Length of a step in which what is driven moves at once, relative to the whole time: as a fraction
# of the tolerance, and at least.
_MOVED, _LEAST_MOVED = 1e-2, 1e-9
# Shortest steps for a short contact, relative to the whole time.
_LEAST = 1e-8
# What may help where Newton's method fails.
_ADVICE = "Check the units of loads, velocities and stiffnesses, or try another scheme"


class AdaptiveRun:
    """Takes steps from one break, where loads have a kink or jump, to the next.

    After each break, trial steps find the first length.
    """

    def __init__(self, stepper: Stepper, recorder: Recorder, plan: StepPlan, single: bool = False):
        self._stepper, self._recorder, self._stats = stepper, recorder, stepper.stats
        self._state = stepper.loop.state
        self._control = StepControl(stepper.model, plan.tolerance, plan.span, plan.longest)
        self._control.restart(plan.first)
        self._plan = plan
        # The local error of a scheme of order 2 is right also where accelerations have a kink.
        self._watch = self._control.order > 2
        #: Whether functions of time move the kinks of laws.
        self._kinks_move = self._watch and stepper.model.forms.parameters.vary
        #: Times at which steps end [s], and those of them behind which driven motions jump.
        self._breaks, self._jumps = self._with_jumps(self._state.t, plan)
        if self._jumps and (single or stepper.loop.tape is not None):
            raise SceneError(
                f"tolerance: a prescribed motion or a motor jumps at t = {self._jumps[0]:.6g}, "
                "where there are no derivatives and no conditions (until). Give dt in place of the "
                "tolerance, or a short ramp"
            )
        self._started = self._follows_event = False
        #: Whether each call takes a single step.
        self._single = single
        self._next, self._block, self._halvings = 0, _FIRST_BLOCK, 0
        #: Ends of steps at which a contact or a law has switched [s].
        self.events: list[float] = []

    def _with_jumps(self, t: float, plan: StepPlan) -> tuple[list[float], list[float]]:
        """Breaks, which are just before the jumps of driven motions, and the times of these."""
        inset = [_BESIDE * plan.span + 4 * math.ulp(b) for b in plan.breaks]
        ends = [b - by for b, by in zip(plan.breaks, inset, strict=True)]
        behind = [b + by for b, by in zip(plan.breaks, inset, strict=True)]
        times = np.array([[t, *ends[:-1]], [t + _BESIDE * plan.span, *behind[:-1]]])
        forcing, model = self._stepper.loop.forcing, self._stepper.model
        driven = floats(forcing.series(times.ravel())).reshape(*times.shape, -1)
        size = np.append(model.units.nodes[model.prescribed], np.full(len(model.data.motors), 1.0))
        is_jump = (abs(driven[1] - driven[0]) > _LEAST_JUMP * size).any(axis=1)
        breaks = np.where(is_jump[1:], ends[:-1], plan.breaks[:-1]).tolist()
        return [*breaks, plan.breaks[-1]], times[0, is_jump].tolist()

    def _jump(self) -> None:
        """Move at once what is driven; masses have the rates before, but for what dampers do.

        By a very short step, whose rates do not stay; it has no row.
        """
        stepper, old = self._stepper, self._state.read()
        model, plan = stepper.model, self._plan
        t1 = old.t + max(_MOVED * plan.tolerance, _LEAST_MOVED) * plan.span
        moved = stepper.trial(old, t1).state
        if moved is None:
            raise stepper.error(t1, _ADVICE)
        moved = moved.changed(fitted=moved.v, **{name: getattr(old, name) for name in FORCES})
        new = Starts(model, stepper.loop.forcing, self._control.length).initial(moved)
        supplied = energy_of(model, new) - energy_of(model, old)
        for part in ("dissipated", "numerical", "algorithmic"):
            supplied += getattr(new, part) - getattr(old, part)
        stepper.load(new.changed(work=old.work + supplied))
        stepper.mark(self._recorder)

    def advance(self) -> None:
        """Take some steps, at most up to the next break."""
        control, stats, recorder = self._control, self._stats, self._recorder
        until = self._breaks[self._next]
        if not self._started:
            self._start(until)
        ends, dt = control.ends(self._state.t, until, self._block)
        if self._single:
            ends = ends[:1]
        first = stats.steps + 1
        last = self._next == len(self._breaks) - 1
        recorder.plan(first, ends, last and ends[-1] == until)
        result = self._try_steps(ends, dt, first, recorder)
        if self._watch and (result.switched or (result.ratio or 0.0) > 1):
            result, dt = self._up_to_event(result, float(ends[result.taken]))
        if result.taken:
            self._halvings = 0
        length = control.length
        if result.failed:
            self._fail(dt)
        elif result.ratio is not None and result.ratio > 1:
            stats.rejected += 1
            control.reject(dt, result.ratio)
        else:
            control.succeed(dt, result.last_ratio, result.ratio)
        if control.too_short:
            raise self._too_short()
        unchanged = control.length == length and result.taken == len(ends)
        self._block = min(2 * self._block, _LARGEST_BLOCK) if unchanged else _FIRST_BLOCK
        if self._state.t == until:
            self._next, self._started = self._next + 1, False

    def _try_steps(self, ends: np.ndarray, dt: float, first: int, recorder: Rows) -> StepsResult:
        """Take steps of the length dt [s], up to where something switches that matters."""
        stepper, control = self._stepper, self._control
        result = stepper.try_steps(ends, dt, first, recorder, control, self._watch)
        if not result.switched:
            return result
        next_one = ends[result.taken : result.taken + 1]
        if self._matters(self._state.read(), float(next_one[0])):
            return result
        step = stepper.try_steps(next_one, dt, first + result.taken, recorder, control)
        return step._replace(taken=result.taken + step.taken)

    @property
    def _least(self) -> float:
        """Segments of motion between events are not divided further [s]."""
        return _LEAST * self._plan.span

    def _matters(self, state: State, t1: float) -> bool:
        """Whether a step to t1 [s] and two of half its length end in different configurations."""
        whole = self._trial(state, t1).state
        middle = self._trial(state, (state.t + t1) / 2).state
        halves = middle and self._trial(middle, t1).state
        if whole is None or halves is None:
            return True
        model = self._stepper.model
        difference = (whole.q - halves.q) / model.units.errors(model.scene)
        x, y, turn = abs(difference.reshape(-1, 3)).T
        return self._control.matters(float(np.maximum(np.hypot(x, y), turn).max()))

    def _harmless(self, state: State, t1: float) -> float:
        """End of a step that an event at its start or end does not disturb: t1 [s], or earlier.

        In a step all forces have the values of parameters at one time, but kinks move with them.
        """
        while self._kinks_move and t1 - state.t > self._least and self._matters(state, t1):
            t1 = (state.t + t1) / 2
        return t1

    def _trial(self, state: State, t1: float, watch: bool = False) -> Trial:
        """A step that is not part of the run; it is counted as rejected."""
        trial = self._stepper.trial(state, t1, watch)
        self._stats.rejected += 1
        return trial

    def _up_to_event(self, result: StepsResult, t1: float) -> tuple[StepsResult, float]:
        """Take a step up to where a contact or a law switches before t1 [s], or to t1.

        Also the length of the step that was tried [s].
        """
        stepper, recorder, stats = self._stepper, self._recorder, self._stats
        state = self._state.read()
        first = stepper.model.kinks.switches(state)
        if not len(first):
            return result, t1 - state.t
        end = end_behind_event(first, lambda t: self._trial(state, t, True).switches, state.t, t1)
        if end is None:
            if not result.switched:
                return result, t1 - state.t
            end = t1
        end = self._harmless(state, end)
        number = stats.steps + 1
        recorder.plan(number, np.array([end]), end == self._breaks[-1])
        step = stepper.try_steps(np.array([end]), end - state.t, number, recorder, self._control)
        if step.taken:
            self.events.append(end)
            self._started, self._follows_event = False, True
        return step._replace(taken=result.taken + step.taken), end - state.t

    def _start(self, until: float) -> None:
        """Find the first length by trial steps, which are not part of the run."""
        if self._state.t in self._jumps:
            self._jump()
        state, control, stats = self._state.read(), self._control, self._stats
        number = control.order + AVERAGED
        longest = (until - state.t) / number
        if self._follows_event:
            control.restart(self._harmless(state, state.t + min(control.length, longest)) - state.t)
            self._follows_event = False
        for _ in range(_TRIALS):
            dt = min(control.length, longest)
            ratio, failed = None, False
            with self._stepper.unchanged():
                self._state.forget_errors()
                while ratio is None and not failed:
                    number = round((self._state.t - state.t) / dt)
                    ends = state.t + dt * np.arange(number + 1, control.order + AVERAGED + 1)
                    result = self._try_steps(ends, dt, 1, NullRecorder())
                    ratio, failed = result.ratio, result.failed
                    if result.switched:
                        break
                reached = self._state.t
            stats.rejected += control.order + AVERAGED
            if failed:
                self._fail(dt)
                continue
            if result.switched and dt > self._least:
                # Fewer steps would have no error that is known up to there.
                steps_taken = round((reached - state.t) / dt)
                control.restart(dt * min((steps_taken + 0.5) / (control.order + AVERAGED + 1), 0.5))
                longest = min(longest, control.length)
                continue
            # Only the first length may be far too small; at breaks a trial is lost time.
            search = self._plan.search and stats.steps == 0
            self._halvings = 0
            if ratio is not None and ratio > 1:
                # Longer trials may reach a contact that shorter ones do not: do not try them again.
                longest = min(longest, dt / 2)
            if not control.retry(dt, ratio or 0.0, longest if search else dt):
                break
            if control.too_short:
                raise self._too_short()
        self._state.forget_errors()
        self._started, self._block = True, _FIRST_BLOCK

    def _fail(self, dt: float) -> None:
        """Halve the steps after a failure of Newton's method; StepError if this is not allowed."""
        if self._halvings == self._stepper.halving.most:
            raise self._stepper.error(self._state.t + dt, _ADVICE)
        self._halvings += 1
        self._stats.halvings += 1
        self._control.restart(dt / 2)

    def _too_short(self) -> StepError:
        t = self._state.t
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
