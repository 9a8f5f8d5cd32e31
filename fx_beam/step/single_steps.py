"""Single steps in C, where the state stays between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.errors import StepError
from fx_beam.results.state import State
from fx_beam.scene.inputs import InputSignal

from .loop import CompiledLoop
from .recorder import NullRecorder, Recorder, Rows
from .step_inputs import StepInputs, no_inputs

# Steps whose functions of time are evaluated at once.
_BLOCK = 64


class CompiledSingleSteps:
    """Tries single steps of the length dt [s] from the state in C."""

    def __init__(self, loop: CompiledLoop, dt: float):
        self._loop, self._dt = loop, dt
        problem = loop.problem
        self._p, self._run = problem.c, problem.library.fx_run
        self._no_limits = problem.ffi.NULL
        self._unrecorded = loop.records.next(NullRecorder(), 1)
        #: Rows of a recorder for C, and the recorder and its plan to which they belong.
        self._rows = self._unrecorded
        self._plan: tuple[Recorder | None, int] = None, -1
        self._build_inputs()

    def _build_inputs(self) -> None:
        """Arrays of the loads and driven motions of a step, with views for those that are held."""
        model, p = self._loop.model, self._p
        forcing, steps = self._loop.forcing, p.tables.scheme.sub_steps
        shapes = [(2, p.tables.loads.count), (p.tables.driven,), (len(model.points.followers), 2)]
        shapes += [(2, len(model.forms.parameters)), (len(model.data.natural.starts) - 1,)]
        arrays = [np.zeros((steps, *shape)) for shape in shapes]
        loads, driven, follower_force, parameters, natural = arrays
        self._inputs = StepInputs(loads, driven, follower_force, parameters, natural, steps)
        self._c_inputs = self._inputs.in_c(self._loop.problem.ffi)
        ends = np.cumsum(model.scheme.fractions)
        ends[-1] = 1.0
        starts, level = np.append(0.0, ends[:-1]), model.scheme.rates.level
        level_and_end = np.column_stack([starts + level * (ends - starts), ends])
        #: Inputs with their arrays, and the parts of the step that have passed there.
        self._live: list[tuple[InputSignal, np.ndarray, np.ndarray]] = []
        #: Whether other functions change in time.
        self._varies = False
        followers = [load.value for load in model.scene.loads if load.follower]
        data, varying = model.data, enumerate(model.forms.parameters.functions)
        views = [(signal, loads[:, :, columns], ends) for columns, signal in data.loads.functions]
        views += [(signal, follower_force[:, i], ends) for i, signal in enumerate(followers)]
        views += [(signal, driven[:, i], ends) for i, signal in enumerate(forcing.functions)]
        views += [(signal, parameters[:, :, i], level_and_end) for i, signal in varying]
        views += [(signal, natural[:, c.start], ends) for c, signal in data.natural.functions]
        for function, view, passed in views:
            if isinstance(function, InputSignal):
                self._live.append((function, view, passed))
            elif not function.is_constant:
                self._varies = True
        if not self._varies:
            self._fill(self._loop.inputs_ahead(0.0, np.array([self._dt])), 0)

    def load(self, state: State) -> None:
        """Begin with a state, and with step number 1."""
        self._known = no_inputs(1), 0
        self._loop.state.load(state)

    def take(self, number: int, t0: float, grid: Callable[..., np.ndarray], recorder: Rows) -> bool:
        """Whether a step from t0 [s] succeeds; otherwise the state is that before it.

        The grid has the ends of steps by their numbers.
        """
        p, record = self._p, self._unrecorded
        if self._varies:
            self._evaluate(t0, grid, number)
        for signal, view, passed in self._live:
            if signal.ramps:
                view[...] = signal.start + (signal.end - signal.start) * passed
            else:
                view[...] = signal.end
        recorded = number % recorder.grid.every == 0
        if recorded:
            assert isinstance(recorder, Recorder)  # the other one takes no row
            record = self._rows_of(recorder)
            record.first = number
        self._loop.state.present = None
        if not self._run(p, 1, t0, self._dt, self._c_inputs, self._no_limits, record):
            self._plan = None, -1  # parts of this step have the same record of C
            self._loop.check()
            return False
        if p.work.counts.inverted:
            self._loop.count()  # which warns
        return True

    def _rows_of(self, recorder: Recorder):
        """The record of C, from the recorder's next row on."""
        if (recorder, recorder.plans) != self._plan:
            room = len(recorder.arrays["energies"]) - recorder.rows
            self._rows = self._loop.records.next(recorder, room)
            self._plan = recorder, recorder.plans
        self._rows.rows = recorder.rows
        self._rows.starts = recorder.starts.count
        self._rows.complete = recorder.starts.before_row(recorder.rows)
        return self._rows

    def _evaluate(self, t0: float, grid: Callable[..., np.ndarray], number: int) -> None:
        """Evaluate the functions of time for a step and its number; for some steps at once."""
        known, first = self._known
        if (number - first) * self._p.tables.scheme.sub_steps >= len(known.driven):
            ends = grid(number + np.arange(_BLOCK))
            known, first = self._loop.inputs_ahead(t0, ends), number
            is_due = not (isinstance(known.error, StepError) and len(known.driven))
            if known.error is not None and is_due:
                raise known.error
            self._known = known, first
        self._fill(known, number - first)

    def _fill(self, inputs: StepInputs, step: int) -> None:
        """Copy the inputs of the sub-steps of one step."""
        sub_steps = slice(
            step * self._p.tables.scheme.sub_steps, (step + 1) * self._p.tables.scheme.sub_steps
        )
        for target, source in zip(self._inputs[:5], inputs[:5], strict=True):
            if source.size:
                target[...] = source[sub_steps].reshape(target.shape)
