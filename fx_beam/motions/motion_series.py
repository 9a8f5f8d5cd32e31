"""Motions one after the other, each of which has the model of the last if only numbers differ."""

from __future__ import annotations

import functools
import time
import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fx_beam.array_calls import ArrayCalls
from fx_beam.results.audit import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.inputs import values_at, with_functions
from fx_beam.scene.outputs import check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.recorder import Recorder
from fx_beam.step.tape import LIMIT, Tape

from .contact_check import warn_of_places
from .evaluation import solution_of
from .options import Options
from .prepared import Prepared
from .run import Run, warn_of_damping
from .surroundings import SMALL, waiting_team, warn_of_equal_work
from .transferred_state import end_of


class _Plan(NamedTuple):
    """A motion whose steps C takes at once: what is asked, their ends, and a recorder of them."""

    options: Options
    ends: np.ndarray
    recorder: Recorder


class MotionSeries:
    """Simulates scenes. `Response` and each worker of a sweep own one, `simulate` has recent ones.

    With `reads_at_once` solutions are read before anything else happens; `alone` motions are not
    divided among processes. A `brief` one keeps small scenes only, and no plans.
    """

    def __init__(
        self,
        memory: float = LIMIT,
        reads_at_once: bool = False,
        alone: bool = False,
        brief: bool = False,
    ):
        self._reads_at_once, self._alone, self._memory = reads_at_once, alone, memory
        self._brief = brief
        #: The prepared scene of the last motion, for the next one; None while a motion has it.
        self.prepared: Prepared | None = None
        self._plan: _Plan | None = None
        # The last solution, as long as it is in use: it reads the model.
        self._solution: Callable[[], Any] = lambda: None
        #: Why the last scene was prepared anew; empty if it was not.
        self.reason = ""
        #: What is known of the functions of its scenes.
        self.calls = ArrayCalls()
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        self.tape: Tape | None = None

    def motion(self, scene: Scene, options: Options, start: Solution | None = None) -> Solution:
        """The motion of a scene, from its reference configuration or the end of a solution."""
        if start is None and self.repeats(options):
            solution = self._repeated(scene)
            if solution is not None:
                return solution
        grid = options.grid(0.0 if start is None else end_of(start).t, start is not None)
        if options.until:
            check_outputs(scene, options.outputs or {}, f"{options.what}: outputs")
        connected = with_functions(scene, options.inputs, f"{options.what}: inputs")
        warn_of_equal_work()
        clock = time.perf_counter()
        prepared = self.prepare(connected, options)
        run = Run(prepared, scene, start, grid, self._keep, self._reads_at_once)
        self._begin_tape(prepared)
        prepared.stats.setup_seconds = time.perf_counter() - clock
        prepared.stats.setup_reason = self.reason
        return run.complete()

    @property
    def is_free(self) -> bool:
        """Whether it has a prepared scene that no solution needs."""
        return self.prepared is not None and self._solution() is None

    def prepare(self, scene: Scene, options: Options) -> Prepared:
        """A prepared scene, which others may take for their motions once it is given back."""
        self._plan, last = None, self.prepared
        if last is not None and not options.scheme.built_in:
            self._leave("the scheme has functions of your own, which may have changed")
        elif last is not None and (options.scheme, options.newton) != (
            last.options.scheme,
            last.options.newton,
        ):
            self._leave("another scheme, or other options")
        prepared = self._refilled(scene, options)
        if prepared is None:
            prepared = Prepared(scene, options, None if self._alone else waiting_team(scene))
        return prepared

    def _refilled(self, scene: Scene, options: Options) -> Prepared | None:
        """The last prepared scene with the numbers of another; None if this needs its own."""
        if self.prepared is not None and self._solution() is not None:
            self._leave("the last solution is still in use")
        prepared, self.prepared = self.prepared, None
        if prepared is None:
            self.reason = self.reason or "the first scene"
            return None
        try:
            prepared.refill(scene, options)
        except OtherStructureError as other:
            self.reason = str(other)
            return None
        self.reason = ""
        return prepared

    def _leave(self, reason: str) -> None:
        """Prepare the next scene anew, for a reason."""
        self.prepared, self.reason = None, reason

    def _begin_tape(self, prepared: Prepared) -> None:
        self.tape = None
        if (loop := prepared.loop) is not None:
            loop.tape = self.tape = Tape(loop.problem, self._memory) if self.tapes else None

    def _keep(self, run: Run, solution: Solution) -> None:
        """Keep what a run was made with. As long as its solution lives, this needs it."""
        prepared = run.prepared
        if self._brief and (prepared.loop is None or prepared.model.size > SMALL):
            return
        self.prepared, self._solution = prepared, weakref.ref(solution.resultants_of_beam)
        if run.is_repeatable and not self._brief:
            self._plan = _Plan(run.prepared.options, run.times[1:], run.recorder.again())

    # -- Motions whose steps are taken at once ---------------------------------------------------

    def repeats(self, options: Options) -> bool:
        """Whether the last motion was asked for by the same options, and C took it at once."""
        plan = self._plan
        return plan is not None and options.is_plain and options == plan.options

    def _repeated(self, scene: Scene) -> Solution | None:
        """The planned motion for another scene; None if it has another structure, or fails."""
        plan = self._plan
        assert plan is not None  # `repeats` says so
        recorder = plan.recorder.again()
        prepared = self._at_once(scene, plan, recorder)
        if prepared is None or prepared.loop is None:
            return None
        loop, halving = prepared.loop, prepared.stepper.halving

        def end() -> State:
            held, state = values_at(scene, None, 0.0), loop.state(plan.options.t_end)
            return state.changed(parts=halving.memory, past=loop.past, inputs=held)

        solution = solution_of(
            *(prepared.model, recorder, prepared.stats, end),
            ended=True,
            scene_stays=self._reads_at_once,
        )
        self._solution = weakref.ref(solution.resultants_of_beam)
        if plan.options.record.motion:
            warn_of_places(solution, scene.joints)
        return solution

    def rows(self, scene: Scene) -> tuple[Stats, Recorder, Callable[[], State]] | None:
        """Statistics of the same, its record, whose rows the next motion overwrites, and its end.

        The end is that of the loop, until this takes other steps.
        """
        plan = self._plan
        assert plan is not None  # `repeats` says so
        plan.recorder.restart()
        prepared = self._at_once(scene, plan, plan.recorder)
        if prepared is None or prepared.loop is None:
            return None
        end = functools.partial(prepared.loop.state, plan.options.t_end)
        return prepared.stats, plan.recorder, end

    def _at_once(self, scene: Scene, plan: _Plan, recorder: Recorder) -> Prepared | None:
        """What has taken all steps by one call of C, without what only others need."""
        clock, dt = time.perf_counter(), float(plan.ends[0])
        prepared = self._refilled(scene, plan.options)
        if prepared is None:
            return None
        self.prepared, loop = prepared, prepared.loop
        if prepared.model is not recorder.model or loop is None:
            return None  # differences of a derivative left another one
        stats, state = prepared.stats, prepared.recorded_state(recorder, dt, None)
        self._begin_tape(prepared)
        began = time.perf_counter()
        stats.setup_seconds = began - clock
        if not loop.run(state, plan.ends, recorder):
            return None
        stats.steps += prepared.stepper.halving.take(len(plan.ends))
        stats.seconds = time.perf_counter() - began
        warn_of_damping(stats, dt)
        return prepared
