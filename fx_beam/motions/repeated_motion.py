"""A motion whose steps are taken at once, for each of many scenes that differ in numbers only."""

from __future__ import annotations

import time

import numpy as np

from fx_beam.results.audit import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.inputs import values_at
from fx_beam.scene.scene import Scene
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.substeps import Halving

from .evaluation import solution_of
from .kept_setup import KeptSetup
from .run_setup import RunSetup
from .step_warnings import warn_of_damping


class RepeatedMotion:
    """The plan of a motion without options that may change: its steps, and what is recorded.

    All that `simulate` does only for other options, for steps that fail and for long runs is left
    out; what is computed is the same, but for the rounding of functions that take arrays.
    """

    def __init__(
        self,
        options: tuple,
        times: np.ndarray,
        record: Record,
        recorder: Recorder,
        most_halvings: int,
    ):
        self._options, self._kinds = options, [*map(type, options)]
        #: What is recorded.
        self.record = record
        self._ends, self._recorder = times[1:], recorder.again()
        self._most_halvings = most_halvings

    def serves(self, options: tuple) -> bool:
        """Whether a motion has the same options."""
        return [*map(type, options)] == self._kinds and options == self._options

    def of(self, scene: Scene, kept: KeptSetup) -> Solution | None:
        """The motion of a scene; None if it has another structure, or if a step fails."""
        recorder, halving = self._recorder.again(), self._halving
        setup = self._run(scene, kept, recorder, halving)
        if setup is None:
            return None
        loop, t_end = setup.stepper.integrator, float(self._ends[-1])
        assert isinstance(loop, CompiledLoop)  # as before

        def end() -> State:
            state, held = loop.state(t_end), values_at(scene, None, 0.0)
            return state.changed(parts=halving.memory, past=loop.past, inputs=held)

        stats, stays = setup.stats, kept.reads_at_once
        found = solution_of(setup.model, recorder, stats, end, ended=True, scene_stays=stays)
        kept.keep(setup, found)
        return found

    def rows(self, scene: Scene, kept: KeptSetup) -> tuple[Stats, Recorder] | None:
        """Statistics of the same, and its record, whose rows the next motion overwrites."""
        recorder = self._recorder
        recorder.restart()
        setup = self._run(scene, kept, recorder, self._halving)
        if setup is None:
            return None
        kept.put_back(setup)
        return setup.stats, recorder

    @property
    def _halving(self) -> Halving:
        return Halving(self._most_halvings, float(self._ends[0]))

    def _run(
        self, scene: Scene, kept: KeptSetup, recorder: Recorder, halving: Halving
    ) -> RunSetup | None:
        clock, dt = time.perf_counter(), float(self._ends[0])
        setup = kept.refilled(scene, halving)
        if setup is None:
            return None
        if setup.model is not recorder.model:  # differences of a derivative left another one
            kept.put_back(setup)
            return None
        loop, model, stats = setup.stepper.integrator, setup.model, setup.stats
        assert isinstance(loop, CompiledLoop)  # as before
        rates, late = self.record.rates, model.finds_accelerations_later
        state = setup.first_state(dt, None, accelerations=rates and not late)
        if rates and late:
            recorder.late_accelerations = setup.late_accelerations(state, dt)
        kept.begin(setup)
        began = time.perf_counter()
        stats.setup_seconds = began - clock
        if not loop.run(state, self._ends, recorder):
            kept.put_back(setup)
            return None
        stats.steps += halving.take(len(self._ends))
        stats.seconds = time.perf_counter() - began
        warn_of_damping(stats, dt)
        return setup
