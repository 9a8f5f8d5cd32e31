"""Motions of scenes of parameters: their outputs, and derivatives of their numbers."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from fx_beam.dual import Dual, floats
from fx_beam.equilibria.statics import path_of
from fx_beam.errors import SceneError, any_of
from fx_beam.motions.initial_state import rates_with_slopes
from fx_beam.motions.motion_series import MotionSeries
from fx_beam.motions.numbers import numbers_in_steps, numbers_of_state, observed_numbers_of
from fx_beam.motions.options import Options
from fx_beam.motions.prepared import MotionSetup
from fx_beam.motions.run import Run
from fx_beam.results.records import stats_unchanged
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.measured import Measured
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model, fact, massless_dofs
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import Analysis
from .observation import rates_at
from .output_kinds import needs_of
from .output_values import node_keys, recorded, row_values
from .parametrised import Parametrised
from .row_output import Needs
from .static_derivatives import StaticDerivatives, why_not

# Length of the step that tells the accelerations at the start, relative to the others: its mean
# loads are those just after the start, which accelerations have.
_INSTANT = 2e-12


class MotionAnalysis(Analysis):
    """Motions one after the other, the last of which is on a tape if outputs have derivatives."""

    def __init__(
        self,
        options: Options,
        start: Solution | Callable[[Scene], Solution] | None,
        memory: float,
        parameters: Parametrised,
    ):
        super().__init__(parameters)
        self._options, self._record, self._start = options, options.record, start
        self.inputs = options.inputs
        # Several processes have no derivatives.
        self._series = MotionSeries(memory)
        self._tape_derivatives: TapeDerivatives | None = None
        # Outputs of the last run that are no functions, and where they are if all are of nodes.
        self._measured: list[Measured] = []
        self._keys: list = []
        # The last run whose rows only this object has.
        self._last_run: Run | None = None

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times and outputs for parameters."""
        # Functions of the user's, which have read a scene before, may take plain floats alone.
        plain = callable(self._start) or any(map(callable, self.outputs.values()))
        run: Run = self.parameters.scenes.serve(x, self._begun, not plain)
        try:
            rows = run.take_steps(lambda: self._rows_of(run) or run.solution())
        except BaseException:
            self._series.is_kept = True  # by the error, which has a solution
            raise
        self.parameters.stats = run.prepared.stats
        if self._series.tape is not None:
            self._series.tape.last = run.prepared.loop.state.read()
        if isinstance(rows, Solution):
            self.t, y = rows.t, self.read(rows)
            recorder = weakref.ref(run.recorder)
            del run, rows
            # A function of the user may have kept the solution, which then reads the record.
            self._series.is_kept = recorder() is not None
            return self.t, y
        self._last_run, self.t = run, run.recorder.t
        return self.t.copy(), rows

    def _begun(self, x: Any) -> Run:
        """A run of the scene of x that is to take its steps."""
        scene = self.parameters.build_and_keep(x)
        if not (keys := node_keys(self.outputs)) or keys != self._keys:
            self._set_outputs(keys)
        start, old, self._last_run = self._start_of(scene), self._last_run, None
        return self._series.begun(scene, self._options, start, old)

    def _set_outputs(self, keys: list) -> None:
        """Measure the outputs of the scene, and record what they need."""
        record, last = self._record, self._options.record
        self._keys, self._measured = keys, (measured := self.measured)
        if len(measured) == len(self.outputs):  # functions may read all
            record = recorded(record, last, measured)
        if record is not last:
            self._options = replace(self._options, record=record)
        self._series.tapes = bool(measured)

    def _rows_of(self, run: Run) -> dict[str, np.ndarray]:
        """The outputs from the rows of a run; empty if these are not all, or places need a look."""
        options, model = self._options, run.prepared.model
        looks = self.parameters.scene.contacts or model.kinks.has_contact
        looks = looks or len(self._measured) < len(self.outputs)  # functions of the solution
        if looks or options.tolerance is not None or options.record.times is not None:
            return {}
        y = {}
        for name, measured in zip(self.outputs, self._measured, strict=True):
            if (rows := row_values(model, run.recorder, measured)) is None:
                return {}
            y[name] = rows
        return y

    def _start_of(self, scene: Scene) -> Solution | None:
        self.path = None
        if not callable(self._start):
            return self._start
        clock, solution = perf_counter(), self._start(scene)
        path = path_of(solution, scene)
        if path is not None and path.began >= clock:
            self.path = path
        return solution

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """As of `Analysis`."""
        series = self._series
        prepared, tape = series.prepared, series.tape
        if prepared is None or tape is None:
            raise SceneError(
                f"Response.{method}: the steps of this motion were not compiled "
                f"({self.parameters.stats.solver}), and have no derivatives"
            )
        loop = prepared.loop
        assert loop is not None  # only it has a tape
        if self._tape_derivatives is None or self._tape_derivatives.problem is not loop.problem:
            way = "JVP" if method == "jacobian" else "VJP"
            self._tape_derivatives = TapeDerivatives(loop.problem, way)
        return prepared.model, tape, self._tape_derivatives

    def changes(self) -> dict[str, np.ndarray]:
        """As of `Analysis`."""
        tape, start = self._series.tape, None
        assert tape is not None  # `followed` comes first
        # Without derivatives of the equilibrium before, differences compute it for other x.
        if self.path is not None and not why_not(self.path):
            derivatives = self.parameters.derivatives
            lines = [measured for measured in self.measured if measured.law_quantity == "pull"]
            start = StaticDerivatives(self.path).change_of_end(derivatives, "Response", lines)
        first = self._options.dt if self._options.tolerance is None else tape.times.first_length
        accelerations = self._accelerations_by_x(first)
        numbers_of = functools.partial(self._numbers_of, tape, first, start, accelerations)
        return self.parameters.derivatives(numbers_of)

    @property
    def _needs(self) -> Needs:
        """Needs of the outputs in the last motion."""
        assert self._series.prepared is not None  # `followed` comes first
        return needs_of(self._series.prepared.model, self.measured)

    def _accelerations_by_x(self, first: float) -> np.ndarray | None:
        """Changes (m, size) of those at the start, by a very short step; None if not from rest."""
        (model, _, derivatives), prepared = self.tape_of_last_run("vjp"), self._series.prepared
        moving = model.scene.velocities, model.couplings.driven, self._start is not None
        other_steps = self._options.tolerance is not None or len(model.scheme.fractions) > 1
        # Round-off of the rates of natural strains would be large in such a step.
        unfit = any(moving) or other_steps or model.data.natural
        if unfit or not self._needs.start:
            return None
        assert prepared is not None  # it has the model
        tape, short = Tape(derivatives.problem), _INSTANT * first
        with stats_unchanged(prepared.stats):
            state = prepared.first_state(short, None, accelerations=False)
            if prepared.stepper.trial(state, state.t + short, tape=tape).state is None:
                return None  # such a step may fail with unknowns that have no mass
        numbers_of = functools.partial(self._numbers_of_steps, tape, short, None, False)
        changes = self.parameters.derivatives(lambda scene, change: numbers_of(scene, change)[2])
        rates = derivatives.jvp(tape, changes, np.ones(1, int))["v"][0]
        return np.where(fact(model, massless_dofs), 2, 1) * rates / short  # those are means

    def _numbers_of_steps(
        self, tape: Tape, first: float, start: Any, at_start: bool, scene: Scene, change: Any
    ) -> tuple[MotionSetup, State, dict[str, Any]]:
        """Another scene, prepared, with its first state; numbers of the steps and of this state."""
        base, t0 = self.parameters.scene, tape.times.starts
        other = prepared_for(self._series, self._options, base, scene, change)
        model, t1 = other.model, tape.times.ends
        data = model.data
        if start is None:
            start_state = self._start_of(scene)
            if isinstance(change, Dual) and other.smooths_start(start_state):
                raise TypeError("a start that is found by a step has no slopes")
            state = other.first_state(first, start_state, at_start)
        else:
            state = other.state_from(start.equilibrium_at(data, floats(change)), first, at_start)
        numbers: dict[str, Any] = numbers_in_steps(model, data, state, t0, t1)
        if self._start is None and isinstance(change, Dual):
            if model.data.natural:
                numbers["natural"] = model.data.natural.numbers_at(state.t)
            numbers["v"] = rates_with_slopes(
                model, other.forcing, state, first, numbers, change.count
            )
        if start is not None and isinstance(change, Dual):
            for name, values in numbers_of_state(data, start.equilibrium_at(data, change)).items():
                if isinstance(values, Dual):
                    numbers[name] = Dual(floats(numbers[name]), values.slopes)
        return other, state, numbers

    def _numbers_of(
        self, tape: Tape, first: float, start: Any, a_by_x: Any, scene: Scene, change: Any
    ) -> dict[str, Any]:
        """Numbers of steps and state for another scene, and of outputs that have rates.

        Accelerations have the changes `a_by_x` (m, size) as their slopes.
        """
        needs = self._needs
        other, state, numbers = self._numbers_of_steps(
            tape, first, start, needs.start, scene, change
        )
        if not needs.rates:
            return numbers
        if not any_of(floats(change)):
            self.start_accelerations = floats(state.a)
        rates = rates_at(tape, np.arange(len(tape) + 1))
        numbers |= observed_numbers_of(other.model, other.model.data, state, *rates, needs.start)
        if a_by_x is not None and isinstance(change, Dual):
            # Nodes without mass have none by definition, but those that others carry.
            has = ~fact(other.model, massless_dofs) | (state.a != 0)
            numbers["a"] = Dual(state.a, a_by_x.T * has[:, None])
        return numbers


def prepared_for(
    series: MotionSeries, options: Options, base: Scene, scene: Scene, change: Any
) -> MotionSetup:
    """Prepared motion as of a base, with the numbers of another scene, but no loop.

    Of the base it is that of the motion, if it has slopes.
    """
    # Without slopes it may be a scene that all calls share, with other numbers since.
    if scene is base and isinstance(change, Dual) and (last := series.prepared):
        return last
    return series.alike(with_functions(scene, options.inputs, "Response: inputs"), options)
