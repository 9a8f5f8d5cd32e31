"""A motion to its end: its record, its steps, and the solution of their rows."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import TypeVar

import numpy as np

from fx_beam.errors import StepError, any_of, warn_once
from fx_beam.laws.resultants import Decaying
from fx_beam.laws.schemes import Scheme, order_and_constant
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.inputs import values_at
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch
from fx_beam.step import full_turns
from fx_beam.step.forcing import Forcing
from fx_beam.step.interrupts import NOTHING, ctrl_c_waits
from fx_beam.step.model import fact, led_dofs
from fx_beam.step.recorded_histories import RecordedHistories, driven_increments
from fx_beam.step.recorder import Recorder
from fx_beam.step.substeps import LARGE_TURN

from .contact_check import warn_of_long_elements, warn_of_places, warn_of_sharp_bends
from .evaluation import solution_of
from .options import StepPlan
from .prepared import MotionSetup
from .progress import attach, failure_of, progress_bar

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
# How much faster than before and after a driven motion moves where it jumps; what is no motion, in
# sizes of the scene or rad.
_AT_ONCE, _NO_MOTION = 10.0, 1e-10


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


def warn_of_jumps(scheme: Scheme, forcing: Forcing, recorder: Recorder) -> None:
    """Warn of a driven motion that jumps and moves what joints hold, by Newmark's family.

    It is one that moves ten times as fast as in the step before and in the next one.
    """
    arrays, rows, model = recorder.arrays, recorder.rows, forcing.model
    if scheme.rates.mean_based or not forcing.functions or rows < 4:
        return
    entries, held = (
        model.couplings.all_entries,
        model.couplings.free + np.arange(len(forcing.names)),
    )
    others = entries.column[~np.isin(entries.row, fact(model, led_dofs))]
    passes_on = np.isin(held, others) | bool(model.couplings.auxiliaries)
    moved = abs(driven_increments(model, arrays["q"][:rows], arrays["slides"][:rows]))
    beside = moved[1:].copy()
    np.maximum(beside[1:], moved[:-2], out=beside[1:])
    jumps = moved[:-1] > np.maximum(_AT_ONCE * beside, _NO_MOTION * model.mesh.size)
    jumps &= passes_on
    if jumps.any():
        step, column = np.argwhere(jumps)[0]
        _log.warning(
            "simulate: %s jumps in the step to t = %.6g. With %s, rates and accelerations of "
            "masses that joints couple to it, and forces there, are wrong from then on; "
            "displacements are right. Let it move over many steps, or take EnergyMomentum",
            *(forcing.names[column], recorder.t[step + 1], scheme.name),
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
            from .row_files import RowFiles

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
            from .adaptive_run import AdaptiveRun

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
        from .ending import Ending

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
            if self.options.dt is not None and recorder.rows == self.prepared.stats.steps + 1:
                warn_of_jumps(self.options.scheme, self.prepared.forcing, recorder)
            warn_of_places(solution, self._scene.joints, self._scene.forces_between)
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
