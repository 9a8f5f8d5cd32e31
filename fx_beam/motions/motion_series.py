"""Motions one after the other, each of which has the model of the last if only numbers differ."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from fx_beam.results.solution import Solution
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.outputs import check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.model import Model

from .initial_state import end_of
from .options import Options
from .prepared import Prepared
from .run import Run
from .set_ups import PROGRAMS, RECENT, SetUps, kind_of
from .surroundings import call_with_arrays, thread_series, warn_of_equal_work

if TYPE_CHECKING:
    from fx_beam.step.tape import Tape

_ALL = __import__("os").environ.get("FX_TRIAL_ALL") == "1"
T = TypeVar("T")


class MotionSeries:
    """Simulates scenes. `Response` and each worker of a sweep own one, with a cache of its own.

    With a `memory` [bytes] for tapes, solutions are read before anything else happens. In a cache
    that others share, scenes have kinds by their sizes.
    """

    def __init__(self, memory: float | None = None, cache: SetUps | None = None):
        self._memory, self._shares = memory, cache is not None
        self._cache = cache or SetUps(most=1)
        #: The prepared scene of the last motion.
        self.prepared: Prepared | None = None
        # What has the numbers of other scenes.
        self._alike: Prepared | None = None
        #: What is known of the functions of its scenes.
        self.array_calls = ArrayCalls()
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        self.tape: Tape | None = None

    def motion(self, scene: Scene, options: Options, start: Solution | None = None) -> Solution:
        """The motion of a scene, from its reference configuration or the end of a solution."""
        run = self.begun(scene, options, start)
        return self.finished(run, run.solution)

    def finished(self, run: Run, finish: Callable[[], T]) -> T:
        """Result of `finish` after all steps of a run, whose set-up then serves other scenes."""
        try:
            return run.take_steps(finish)
        finally:
            self.give_back(run.prepared)

    def begun(
        self, scene: Scene, options: Options, start: Solution | None = None, old: Run | None = None
    ) -> Run:
        """A run that is to take its steps; it may overwrite the rows of another one."""
        clock = time.perf_counter()
        if start is not None or (old is not None and old.options is not options):
            old = None
        t0 = 0.0 if start is None else end_of(start).t
        grid = options.grid(t0, start is not None) if old is None else old.grid
        if options.until:
            check_outputs(scene, options.outputs or {}, f"{options.what}: outputs")
        call_with_arrays(scene)
        connected = with_functions(scene, options.inputs, f"{options.what}: inputs")
        warn_of_equal_work()
        prepared = self.prepare(connected, options)
        try:
            with prepared.model.lock:
                run = Run(prepared, scene, start, grid, self._memory is not None, old)
                self._begin_tape(prepared)
        except BaseException:
            self.give_back(prepared)
            raise
        prepared.stats.setup_seconds = time.perf_counter() - clock
        return run

    def prepare(self, scene: Scene, options: Options) -> Prepared:
        """A prepared scene, which is to be given back."""
        self.prepared = None
        # In a cache of its own the last motion, whatever it was, says why it does not serve again.
        kind = "motion", options.scheme, options.newton
        model = None
        if (
            (self._shares or _ALL)
            and options.scheme.built_in
            and PROGRAMS.serves(of := kind_of(scene, *kind))
        ):
            found, reason = PROGRAMS.find(of, lambda known: Prepared.of(known, scene, options))
            if found is None:
                model = Model(scene, options.scheme)
                if (program := PROGRAMS.add(of, model)) is not None:
                    found = Prepared.of(program, scene, options)
                    reason = reason or "the first scene"
            if found is not None:
                found.stats.setup_reason, self.prepared = reason, found
                return found
        prepared, reason = self._cache.take(
            kind_of(scene, *kind) if self._shares else "motion",
            lambda last: last.bind(scene, options),
            lambda: Prepared(scene, options, model),
        )
        if reason:
            self._alike = None
        prepared.stats.setup_reason, self.prepared = reason, prepared
        return prepared

    def give_back(self, prepared: Prepared) -> None:
        """Let the next scene of its structure have what was prepared."""
        if prepared.model.program is None:
            self._cache.give_back(prepared)

    def alike(self, scene: Scene, options: Options) -> Prepared:
        """Prepared model of another scene of the structure of the last one, beside it."""
        with suppress(OtherStructureError):  # its joints may lie elsewhere
            if self._alike is not None:
                self._alike.bind(scene)
                return self._alike
        from fx_beam.step.numbers import data_of

        assert self.prepared is not None
        data_of(self.prepared.model, scene)  # which says how the structure differs
        self._alike = Prepared(scene, options)
        return self._alike

    def _begin_tape(self, prepared: Prepared) -> None:
        problem = prepared.loop.problem
        if not self.tapes:
            self.tape = None
        elif self.tape is None or self.tape.problem is not problem:
            from fx_beam.step.tape import Tape

            self.tape = Tape(problem, self._memory or 0.0)
        else:
            self.tape.clear()
        prepared.loop.tape = self.tape


def present_series() -> MotionSeries:
    """The series of a sweep's worker; elsewhere one that shares the recent set-ups."""
    return thread_series() or MotionSeries(cache=RECENT)
