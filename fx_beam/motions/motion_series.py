"""Motions one after the other, each of which has the memory of the last if only numbers differ."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from fx_beam.results.solution import Solution
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.outputs import check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.model import data_of

from .initial_state import end_of
from .options import Options
from .prepared import MotionSetup, prepare
from .run import Run
from .surroundings import call_with_arrays, warn_of_equal_work

if TYPE_CHECKING:
    from fx_beam.step.tape import Tape


def simulated(scene: Scene, options: Options, start: Solution | None = None) -> Solution:
    """The motion of a scene, from its reference configuration or the end of a solution."""
    run = begun(scene, options, start)
    return run.take_steps(run.solution)


class MotionSeries:
    """Motions of a response, one after the other, in the same memory if only numbers differ.

    With a `memory` [bytes] for tapes.
    """

    def __init__(self, memory: float):
        self._memory = memory
        #: The prepared scene of the last motion, and whether something may read that later.
        self.prepared: MotionSetup | None = None
        self.is_kept = False
        # What has the numbers of other scenes.
        self._alike: MotionSetup | None = None
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        self.tape: Tape | None = None

    def begun(
        self, scene: Scene, options: Options, start: Solution | None = None, old: Run | None = None
    ) -> Run:
        """A run that is to take its steps; it may overwrite the rows of an `old` one."""
        return begun(scene, options, start, self, old)

    def prepare(self, scene: Scene, options: Options) -> MotionSetup:
        """A prepared scene: the last one with other numbers, if the structure is the same."""
        last, self.prepared, reason = self.prepared, None, ""
        if last is not None:
            try:
                if self.is_kept:
                    last.model.structure.check(scene)
                elif not options.scheme.built_in:
                    raise OtherStructureError(
                        "the scheme has functions of your own, which may have changed"
                    )
                else:
                    last.restart(scene, options)
                    self.prepared = last
                    return last
            except OtherStructureError as other:
                reason = str(other)
        self._alike, self.is_kept = None, False
        self.prepared = new = prepare(scene, options, owned=True)
        new.stats.setup_reason = new.stats.setup_reason and (reason or new.stats.setup_reason)
        return new

    def alike(self, scene: Scene, options: Options) -> MotionSetup:
        """Prepared model of another scene of the structure of the last one, beside it."""
        assert self.prepared is not None
        if self._alike is not None:
            try:
                self._alike.restart(scene, options)
            except OtherStructureError:  # its joints may lie elsewhere
                self._alike = None
            else:
                return self._alike
        data_of(self.prepared.model, scene)  # which says how the structure differs
        self._alike = prepare(scene, options, owned=True)
        return self._alike

    def begin_tape(self, prepared: MotionSetup) -> None:
        """Have a tape for the run of what was prepared, if runs are taped."""
        problem = prepared.loop.problem
        if not self.tapes:
            self.tape = None
        elif self.tape is None or self.tape.problem is not problem:
            from fx_beam.step.tape import Tape

            self.tape = Tape(problem, self._memory)
        else:
            self.tape.clear()
        prepared.loop.tape = self.tape


def begun(
    scene: Scene,
    options: Options,
    start: Solution | None = None,
    series: MotionSeries | None = None,
    old: Run | None = None,
) -> Run:
    """A run that is to take its steps, alone or in a series."""
    clock = time.perf_counter()
    if start is not None or (old is not None and old.options is not options):
        old = None
    t0 = 0.0 if start is None else end_of(start).t
    plan = options.plan(t0, start is not None) if old is None else old.plan
    if options.until:
        check_outputs(scene, options.outputs or {}, f"{options.what}: outputs")
    call_with_arrays(scene)
    connected = with_functions(scene, options.inputs, f"{options.what}: inputs")
    warn_of_equal_work()
    prepared = (prepare if series is None else series.prepare)(connected, options)
    run = Run(prepared, scene, start, plan, series is not None, old)
    if series is not None:
        series.begin_tape(prepared)
    prepared.stats.setup_seconds = time.perf_counter() - clock
    return run
