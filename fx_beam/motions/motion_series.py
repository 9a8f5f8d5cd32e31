"""Motions one after the other, each of which has the model of the last if only numbers differ."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from fx_beam.results.solution import Solution
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.outputs import check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import ElsewhereError, OtherStructureError

from .initial_state import end_of
from .options import Options
from .prepared import Prepared
from .run import Run
from .surroundings import HELD, call_with_arrays, waiting_team, warn_of_equal_work

if TYPE_CHECKING:
    from fx_beam.step.tape import Tape


class MotionSeries:
    """Simulates scenes. `Response` and each worker of a sweep own one, `simulate` has recent ones.

    With a `memory` [bytes] for tapes, solutions are read before anything else happens, and motions
    are not divided among processes. A `brief` one keeps small scenes only.
    """

    def __init__(self, memory: float | None = None, brief: bool = False):
        self._memory, self._brief = memory, brief
        #: The prepared scene of the last motion, for the next one; None while a motion has it.
        self.prepared: Prepared | None = None
        #: Degrees of freedom of the last scene that was kept.
        self.size = 0
        # What has the numbers of other scenes.
        self._alike: Prepared | None = None
        # The last solution, as long as it is in use: it reads the model.
        self._solution: Callable[[], Any] = lambda: None
        #: Why the last scene was prepared anew; empty if it was not.
        self.reason = ""
        #: What is known of the functions of its scenes.
        self.array_calls = ArrayCalls()
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        self.tape: Tape | None = None

    def motion(self, scene: Scene, options: Options, start: Solution | None = None) -> Solution:
        """The motion of a scene, from its reference configuration or the end of a solution."""
        run = self.begun(scene, options, start)
        return run.take_steps(run.solution)

    def begun(
        self, scene: Scene, options: Options, start: Solution | None = None, over: Run | None = None
    ) -> Run:
        """A run that is to take its steps; it may overwrite the rows of another one."""
        clock = time.perf_counter()
        if start is not None or (over is not None and over.options != options):
            over = None
        t0 = 0.0 if start is None else end_of(start).t
        grid = options.grid(t0, start is not None) if over is None else over.grid
        if options.until:
            check_outputs(scene, options.outputs or {}, f"{options.what}: outputs")
        call_with_arrays(scene)
        connected = with_functions(scene, options.inputs, f"{options.what}: inputs")
        warn_of_equal_work()
        prepared = self.prepare(connected, options)
        run = Run(prepared, scene, start, grid, self.keep, self._memory is not None, over)
        self._begin_tape(prepared)
        prepared.stats.setup_seconds = time.perf_counter() - clock
        prepared.stats.setup_reason = self.reason
        return run

    @property
    def is_free(self) -> bool:
        """Whether it has a prepared scene that no solution needs."""
        return self.prepared is not None and self._solution() is None

    def prepare(self, scene: Scene, options: Options) -> Prepared:
        """A prepared scene, which others may take for their motions once it is given back."""
        last, self.prepared = self.prepared, None
        if last is not None:
            self.reason = self._reason_against(last, options)
            try:
                if not self.reason:
                    last.refill(scene, options)
                    return last
            except OtherStructureError as other:
                self.reason = str(other)
        self.reason, self._alike = self.reason or "the first scene", None
        return Prepared(scene, options, waiting_team(scene) if self._memory is None else None)

    def alike(self, scene: Scene, base: Scene, options: Options) -> Prepared:
        """The prepared `base` with the numbers of another scene; those of its loop stay."""
        self._alike = self._alike or Prepared(base, options)
        try:
            self._alike.refill_model(scene)
        except ElsewhereError:
            self._alike = Prepared(scene, options)
        return self._alike

    def _reason_against(self, last: Prepared, options: Options) -> str:
        """Why the last prepared scene cannot serve, besides its structure; empty if it can."""
        before = last.options
        if not options.scheme.built_in:
            return "the scheme has functions of your own, which may have changed"
        if (options.scheme, options.newton) != (before.scheme, before.newton):
            return "another scheme, or other options"
        return "" if self._solution() is None else "the last solution is still in use"

    def _begin_tape(self, prepared: Prepared) -> None:
        if (loop := prepared.loop) is None or not self.tapes:
            self.tape = None
        elif self.tape is None or self.tape.problem is not loop.problem:
            from fx_beam.step.tape import Tape

            self.tape = Tape(loop.problem, self._memory or 0.0)
        else:
            self.tape.clear()
        if loop is not None:
            loop.tape = self.tape

    def keep(self, prepared: Prepared, solution: Solution | None = None) -> None:
        """Keep what a run was made with. As long as its solution lives, this needs it."""
        if self._brief and (prepared.loop is None or prepared.model.size > HELD):
            return
        self.prepared, self._solution, self.size = prepared, lambda: None, prepared.model.size
        if solution is not None:
            self._solution = weakref.ref(solution.resultants_of_beam)
