"""One step at a time in C, where the state stays between the steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fx_beam.fem.dead_loads import places_of
from fx_beam.results.state import State
from fx_beam.stepping.held_inputs import Hold, Ramp
from fx_beam.stepping.recorder import Recorder, Rows, Unrecorded
from fx_beam.stepping.stepper import Stepper
from fx_beam.validation import Constant

from .loop import CompiledLoop, StepInputs

# Steps whose functions of time are evaluated at once.
_BLOCK = 64


class CompiledStride:
    """Takes single steps of the length dt [s]; compare `stepping.stride.Stride`.

    Steps that fail, and those that are taken in parts, are left to the loop.
    """

    def __init__(self, loop: CompiledLoop, stepper: Stepper, dt: float, forces: bool):
        self._loop, self._stepper, self._dt = loop, stepper, dt
        problem = loop.problem
        self._p, self._run = problem.c, problem.library.fx_run
        if forces:
            problem.c.keeps_joint_forces = True
        self._unrecorded = loop.c_record(Unrecorded(), 1, 1)
        arrays = problem.state_arrays
        #: The present state: arrays of C.
        self.now = SimpleNamespace(
            **{name: arrays[name] for name in ("q", "v", "a", "constraint_forces")},
            slides=arrays["slide"],
            joint_forces=arrays["joint_forces"].reshape(-1, 3),
        )
        self._taken = 0
        #: Rows of a recorder for C, and the number of the plan to which they belong.
        self._rows, self._plan = self._unrecorded, -1
        self._build_inputs()

    def _build_inputs(self) -> None:
        """Arrays of the loads and driven motions of a step, with views for those that are held."""
        model, p = self._loop.model, self._p
        forcing, steps = self._stepper.forcing, p.sub_steps
        thrusts = 0 if model.forms.followers is None else len(model.forms.followers.dofs)
        self._inputs = StepInputs(
            np.zeros((steps, 2, p.loads)),
            np.zeros((steps, p.driven)),
            np.zeros((steps, thrusts, 2)),
        )
        self._c_inputs = self._loop.c_inputs(self._inputs)
        loads, driven, thrust = self._inputs[:3]
        #: Places of held loads and of driven motions.
        self._holds, self._ramps = [], []
        #: Whether other functions change in time.
        self._varies = False
        for function, place in (*_places(model.scene, loads, thrust),):
            if isinstance(function, Hold):
                self._holds.append((function, place))
            elif not isinstance(function, Constant):
                self._varies = True
        for i, function in enumerate(forcing.functions):
            if isinstance(function, Ramp):
                self._ramps.append((function, driven[:, i]))
            else:
                self._varies = True
        self._parts = np.cumsum(model.scheme.fractions)
        self._parts[-1] = 1.0
        self._known = StepInputs(*np.empty((3, 0, 2)))
        self._next = 0
        if not self._varies:
            self._fill(self._loop.inputs(0.0, np.array([self._dt])), 0)

    def load(self, state: State) -> None:
        """Begin from a state."""
        self._loop.load(state)
        self._loop.forget_past()
        self._loop.past = state.past
        self._stepper.halving.resume(state.parts)
        self._t = state.t
        self._forget_inputs()

    def _forget_inputs(self) -> None:
        """Evaluate functions of time anew: those that are known are of other steps."""
        self._known, self._next = self._known.after(len(self._known.driven)), 0

    def state(self) -> State:
        """The present state, with all on which the next step depends."""
        parts = self._stepper.halving.memory
        return replace(self._loop.state(self._t), parts=parts, past=self._loop.past)

    def take(self, t1: float, number: int, recorder: Rows) -> None:
        """Take step `number` up to t1 [s]. After an error the state is that before it."""
        if self._stepper.halving.times or not self._succeeds(t1, number, recorder):
            self.count()
            before = self.state()
            try:
                after = self._loop.march(before, np.array([t1]), number, recorder)
            except BaseException:
                self.load(before)
                raise
            self._loop.load(after)
            self._forget_inputs()
        self._t = t1

    def _succeeds(self, t1: float, number: int, recorder: Rows) -> bool:
        """Whether a whole step succeeds in C; otherwise the state is that before it."""
        p, to = self._p, self._unrecorded
        if self._varies:
            self._evaluate(t1)
        for hold, place in self._holds:
            place[...] = hold.value
        for ramp, place in self._ramps:
            place[...] = ramp.start + (ramp.end - ramp.start) * self._parts
        recorded = number % recorder.every == 0
        if recorded:
            assert isinstance(recorder, Recorder)  # the other one takes no row
            to = self._rows_of(recorder)
            to.first = number
        p.t = self._t
        if not self._run(p, 1, t1 - self._t, self._c_inputs, to):
            return False
        self._taken += 1
        if recorded:
            recorder.add(1, to.starts)
        if p.inside_out:
            self.count()
        return True

    def _rows_of(self, recorder: Recorder):
        """The record of C, from the recorder's next row on."""
        if recorder.plans != self._plan:
            room = len(recorder.arrays["energies"]) - recorder.rows
            self._rows = self._loop.c_record(recorder, 1, room)
            self._plan = recorder.plans
            self._first = recorder.rows
        self._rows.rows = recorder.rows - self._first
        self._rows.starts, self._rows.complete = recorder.starts, recorder.complete
        return self._rows

    def _evaluate(self, t1: float) -> None:
        """Evaluate the functions of time for this step; for some steps at once."""
        if self._next * self._p.sub_steps >= len(self._known.driven):
            ends = t1 + self._dt * np.arange(_BLOCK)
            self._known, self._next = self._loop.inputs(self._t, ends), 0
            if not len(self._known.driven) and self._known.error is not None:
                raise self._known.error
        self._fill(self._known, self._next)
        self._next += 1

    def _fill(self, inputs: StepInputs, step: int) -> None:
        """Copy the inputs of the sub-steps of one step."""
        own = slice(step * self._p.sub_steps, (step + 1) * self._p.sub_steps)
        for target, source in zip(self._inputs[:3], inputs[:3], strict=True):
            target[...] = source[own].reshape(target.shape)

    def count(self) -> None:
        """Add what C has counted to the statistics."""
        self._stepper.stats.steps += self._taken
        self._loop.count(self._taken)
        self._taken = 0


def _places(scene, loads: np.ndarray, thrust: np.ndarray) -> Iterator[tuple]:
    """The functions of all loads, each with its place in the arrays of a step."""
    column = turning = 0
    for load in scene.loads:
        if load.follower:
            yield load.value, thrust[:, turning]
            turning += 1
        else:
            width = places_of(load)
            yield load.value, loads[:, :, column : column + width]
            column += width
