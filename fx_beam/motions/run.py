"""A motion to its end: its record, its steps, also controlled by errors, and its solution."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import TypeVar

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import Failure, SceneError, StepError, any_of, warn_once
from fx_beam.laws.resultants import Decaying
from fx_beam.laws.schemes import Scheme, order_and_constant
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import FORCES, State
from fx_beam.scene.functions import values_at
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch
from fx_beam.step import full_turns
from fx_beam.step.interrupts import NOTHING, ctrl_c_waits
from fx_beam.step.recorded_rows import RecordedHistories
from fx_beam.step.recorder import NullRecorder, Recorder, Rows
from fx_beam.step.state_vector import energy_of
from fx_beam.step.step_control import AVERAGED, LARGE_TURN, StepControl, end_behind_event
from fx_beam.step.stepper import Stepper, StepsResult, Trial

from .contact_check import warn_of_long_elements, warn_of_places, warn_of_sharp_bends
from .evaluation import RowFiles, solution_of
from .initial_state import Starts
from .motion_setup import MotionSetup, StepPlan
from .progress import attach, failure_of, progress_bar

# -- A motion to its end: its record, its steps, and the solution of their rows -----------------


_log = logging.getLogger("fx_beam")
_T = TypeVar("_T")
# Memory of this machine [GB].
_MEMORY = 1e-9 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")

#: Steps times degrees of freedom between two updates of the progress bar and checks for Ctrl-C.
_BLOCK = 500_000
# The progress bar counts the time of the simulation.
# Rounding errors, relative to the motion, that a run does not mention.
_FEW_DIGITS = 1e-8
_BAR = {"unit": "s", "bar_format": "{l_bar}{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}]"}
_IMPACTS = (
    "%s: losses at impacts (restitution below 1) change forces within a small part of a step of "
    "order 4. Errors are then far above a small tolerance, up to 70 times at 1e-4 and 1e-5. Use "
    "order=2 or dt_max"
)
# Signs of energies in their balance, in the order of `Energy`: not of the numerical part of losses.
_SIGNS = np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 0.0])
# Error of the balance, relative to the largest of the energies, from which it is named; and what
# round-off of all of them may be.
_LARGE, _ROUND_OFF = 1e-3, 1e-9


def warn_of_parts(stats: Stats, dt: float) -> None:
    """Warn if steps were divided, and if they are too large for the motion."""
    if not stats.halvings:
        return
    text = f"{stats.steps} steps took {stats.substeps} sub-steps, since some failed and were halved"
    if stats.too_large:
        text += (
            f". dt = {dt:g} is too large for this motion: in {stats.too_large} sub-steps a node "
            f"turned by more than {LARGE_TURN:g} rad per step, so the motion may depend on "
            "rounding errors. Try a smaller dt"
        )
    elif stats.unconverged:
        text += (
            f". In {stats.unconverged} of them Newton's method did not converge: the last digit of "
            "dt may decide where it does, and so which steps are halved. Compare the motion with "
            "that of a smaller dt"
        )
    warn_once(f"{stats.scheme}: {text}")


def warn_of_rounding(stats: Stats) -> None:
    """Warn if rounding errors leave few digits of the motion."""
    if stats.rounding > _FEW_DIGITS:
        warn_once(
            f"{stats.scheme}: rounding errors change the motion by about {stats.rounding:.1g} of "
            f"its size, or more where they grow; most in {stats.rounding_in}, which is very stiff "
            "for its mass. Give it more mass or less stiffness, or take it as massless or rigid"
        )


def warn_of_balance(scheme: Scheme, t: np.ndarray, energies: np.ndarray) -> None:
    """Warn of the first of the rows (n, 8) of energies that gain or lose much without a cause.

    Schemes that do not balance energy may lose some; what they gain is named.
    """
    errors = energies @ _SIGNS
    errors -= errors[0]
    if not scheme.balances_energy and not isinstance(scheme.resultants, Decaying):
        errors = np.maximum(errors, 0.0)
    largest = abs(errors).max()
    if not largest > _ROUND_OFF * abs(energies).max():
        return
    kinetic, strain, potential, work, springs, dissipated, *_ = energies.T
    parts = kinetic, strain + springs, potential - potential[0], work, dissipated
    size = max(abs(part).max() for part in parts)
    if largest > _LARGE * size:
        k = int(np.argmax(abs(errors) > _LARGE * size))
        _log.warning(
            "simulate: the energies do not balance: from t = %.6g on the motion %s energy without "
            "a cause, up to %.3g J; its energies are %.3g J. Take shorter steps or a tolerance; "
            "energy.balance_error shows where it happens",
            *(t[k], "gains" if errors[k] > 0 else "loses", largest, size),
        )


def warn_of_damping(stats: Stats, dt: float | None) -> None:
    """Warn if steps were refused whose sub-step back in time amplified the motion."""
    if stats.amplified:
        _log.warning(
            "%s: %d steps were halved, since damping would have added energy to the motion. One "
            "sub-step of the scheme goes back in time, and there damping amplifies. This happens "
            "if the damping rate is about 3 / dt%s. Another dt or order=2 may need fewer steps",
            *(stats.scheme, stats.amplified),
            "" if dt is None else f" = {3 / dt:.3g} /s",
        )


class Run:
    """The motion of a prepared scene by the steps of a grid, from its first state on.

    `scene` has its inputs still, and stays as it is until solutions are read if it `stays`. Rows
    are written over those of the `old` run on the same grid, which nothing needs.
    """

    def __init__(
        self,
        prepared: MotionSetup,
        scene: Scene,
        start: Solution | None,
        plan: StepPlan,
        stays: bool,
        old: Run | None = None,
    ):
        self.prepared, self._scene, self._stays = prepared, scene, stays
        self._watch = Watch(scene)
        #: What was asked for, and the steps by which it is found.
        self.options, self.plan = prepared.options, plan
        model, record = prepared.model, prepared.options.record
        has_file = record.file is not None
        if old is not None and old.recorder.model is model:
            recorder = old.recorder
            recorder.restart()
        else:
            times = plan.times[: 1 if has_file else None]
            row_size = 8e-9 * model.size * (record.motion + 2 * record.rates)
            size = len(times) / record.every * row_size
            if size > _MEMORY:
                warn_once(f"the record needs up to {size:.3g} GB. Use Record(every=...) for less")
            recorder = Recorder(model, times, record)
        self.recorder: Recorder = recorder
        self._files: RowFiles | None = None
        if has_file:
            self._files = RowFiles(prepared, recorder, record.file)
            prepared.stats.file = str(record.file)
        #: Times at which a contact or a law has switched [s].
        self._events: list[float] = []
        # Number of steps after which full turns are counted.
        self._next_count = 0
        state = prepared.recorded_state(recorder, plan.first, start, plan.tolerance > 0)
        prepared.stepper.begin_rows(state, recorder)

    def take_steps(self, finish: Callable[[], _T]) -> _T:
        """Take all steps; gives what `finish` does. Exceptions have the solution so far."""
        try:
            return self._take_steps(finish)
        finally:
            del self.recorder.end  # memory that solutions would hold

    def _take_steps(self, finish: Callable[[], _T]) -> _T:
        prepared, recorder, plan = self.prepared, self.recorder, self.plan
        options, stats, equal = prepared.options, prepared.stats, not plan.tolerance
        self._clock = time.perf_counter()
        try:
            advance, span = self._advance(), options.t_end - recorder.end.t
            # Another handler takes 20 us.
            blocks = not equal or options.until or len(plan.times) > self._most_steps()
            waits = ctrl_c_waits() if blocks else nullcontext(NOTHING)
            with progress_bar(span, options.progress, **_BAR) as bar, waits as whole:
                while (t := recorder.end.t) < options.t_end and not stats.until:
                    with whole:
                        self._count_turns()
                        advance()
                    if self._files is not None:
                        self._files.write_rows()
                        self._files.save(self._of_rows)
                    bar.update(recorder.end.t - t)
            self._watch.check_unchanged(options.what)
            if equal:
                warn_of_parts(stats, plan.first)
            warn_of_rounding(stats)
            warn_of_damping(stats, plan.first if equal else None)
            stats.seconds = time.perf_counter() - self._clock
            return finish()
        except BaseException as error:
            prepared.stepper.return_to(recorder.end, recorder)
            stats.steps = recorder.steps_to(recorder.end.t)
            stats.failure = failure_of(error, recorder.end.t)
            attach(error, self._solution)
            if self._knows_places and isinstance(error, StepError):
                warn_of_sharp_bends(error.solution)
            raise

    def _most_steps(self, most: int = full_turns.STEPS) -> int:
        """Number of steps that are taken at once."""
        return max(1, min(most, _BLOCK // self.prepared.model.size))

    def _advance(self) -> Callable[[], None]:
        """A function that takes the next steps."""
        prepared, recorder, options = self.prepared, self.recorder, self.prepared.options
        if not self.plan.tolerance:
            take_steps = self._steps_of_grid(1 if options.until else full_turns.STEPS)
        else:
            adaptive = AdaptiveRun(
                prepared.stepper, recorder, self.plan, single=bool(options.until)
            )
            take_steps, self._events = adaptive.advance, adaptive.events
            laws = prepared.model.points.laws
            loses = any(law.unilateral and law.loss for law in laws)  # at impacts
            if loses and order_and_constant(options.scheme)[0] > 2:
                _log.warning(_IMPACTS, prepared.stats.scheme)
        if not options.until:
            return take_steps
        from .measurement import Ending

        ending, kinks = Ending(prepared, recorder), [*options.breaks, recorder.end.t]
        return lambda: ending.advance(take_steps, kinks + self._events)

    def _steps_of_grid(self, most: int) -> Callable[[], None]:
        """A function that takes the next block of steps of the grid."""
        times, recorder, steps = self.plan.times, self.recorder, self._most_steps(most)

        def advance() -> None:
            first = self.prepared.stats.steps + 1
            left = full_turns.STEPS - (first - 1) % full_turns.STEPS
            ends = times[first : first + min(steps, left)]
            if recorder.grid.planned < first + len(ends):
                recorder.plan(first, ends, last=first + len(ends) == len(times))
            self.prepared.stepper.advance(ends, first, recorder)

        return advance

    def _count_turns(self) -> None:
        """Count full turns, after the same numbers of steps whatever the blocks."""
        prepared, steps = self.prepared, self.prepared.stats.steps
        if steps < self._next_count:
            return
        self._next_count = steps - steps % full_turns.STEPS + full_turns.STEPS
        if any_of(prepared.loop.state.arrays["q"]):
            prepared.stepper.count_turns(self.recorder)

    # -- The solution -----------------------------------------------------------------------------

    def solution(self) -> Solution:
        """The solution of all steps, with warnings of contact where its forces say little."""
        solution, recorder = self._solution(), self.recorder
        if self._files is None:
            energies = recorder.arrays["energies"][: recorder.rows]
            warn_of_balance(self.options.scheme, recorder.t[: recorder.rows], energies)
        if self._knows_places:
            warn_of_places(solution, self._scene)
            rows, t = self.recorder.rows, solution.t
            q = self.recorder.arrays["q"][:rows].reshape(rows, -1, 3)  # without a copy
            warn_of_long_elements(solution, t if len(t) == rows else self.recorder.t, q)
        return solution

    @property
    def _knows_places(self) -> bool:
        return self.options.record.motion and self._files is None

    def _solution(self) -> Solution:
        """The solution of the steps so far."""
        rows = None
        if self._files is not None:
            self._files.write_rows()
            self._files.save(self._of_rows, always=True)
            rows = self._files.histories() if self._files.has_rows else None
        return self._of_rows(rows)

    def _of_rows(self, rows: RecordedHistories | None) -> Solution:
        """The solution of all rows of the recorder, or of `rows`."""
        self._watch.check_unchanged(self.options.what)
        prepared, options = self.prepared, self.prepared.options
        prepared.stats.seconds = time.perf_counter() - self._clock
        input_values = values_at(self._scene, options.inputs, self.recorder.end.t)
        times = options.record.times
        state, removed = prepared.stepper.state(), prepared.turn_counter.removed

        def end() -> State:
            return full_turns.TurnCounter.without(-removed, state.changed(**input_values))

        return solution_of(
            *(self.recorder, prepared.stats, end),
            None if times is None else np.array(times, float),
            [*options.breaks, *self._events],
            ended=True,
            scene_stays=self._stays,
            stored=rows,
        )


# -- A run whose steps are controlled by their local errors -------------------------------------


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
