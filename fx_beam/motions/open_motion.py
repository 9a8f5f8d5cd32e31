"""A motion whose end is open: its state, inputs and record, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.step.held_inputs import HeldInputs
from fx_beam.step.model import Model
from fx_beam.step.recorder import NullRecorder, Record, Recorder, Rows
from fx_beam.step.single_steps import CompiledSingleSteps

from .measurement import FittedState, Grid
from .prepared import Prepared

# Steps between two counts of full turns, as in `simulate`.
_TURNS = 1000
# Steps for whose rows room is made at once.
_ROWS = 1024


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Everything that the next steps of a motion depend on; made by `Motion.snapshot`.

    Parameters
    ----------
    t : float
        Its time [s].
    state : State
        The state, in the numbering of the model, for internal use.
    step : (float, int)
        Time at the start of the count of steps [s], and their number.
    turns : (size,) float
        Full turns that are counted separately [rad].
    dofs : (n_node, 3) int
        The numbering of the model.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
    >>> arm = scene.add_beam([(0, 0), (1, 0)], section)
    >>> fb.Motion(scene, dt=0.1).snapshot().t
    0.0
    """

    t: float
    state: State
    step: tuple[float, int]
    turns: np.ndarray
    dofs: np.ndarray

    def check(self, model: Model, inputs: int) -> None:
        """Refuse the snapshot for another model.

        Parameters
        ----------
        model : Model
            The model of a motion.
        inputs : int
            Number of values of its inputs.

        Raises
        ------
        SceneError
            If nodes, joints, motors or inputs differ.
        """
        state = self.state
        given = 0 if state.inputs is None else len(state.inputs)
        theirs = len(state.slides), len(state.motors), given
        ours = model.scene.joint_count, len(model.motors), inputs
        if not np.array_equal(self.dofs, model.mesh.dofs) or ours != theirs:
            raise SceneError(
                "Motion.restore: the snapshot is of another scene. Its nodes, joints, motors and "
                "inputs must be the same"
            )


class OpenMotion:
    """Takes steps of the length dt [s]. State, time, inputs and record agree after all interrupts.

    What changes several of them first says how it is completed or undone; `settle` does so. Steps
    that fail, and those in parts, are taken by the `Stepper`.
    """

    def __init__(
        self,
        prepared: Prepared,
        held: HeldInputs,
        dt: float,
        record: Record | None,
        forces: bool,
    ):
        self._prepared, self._dt, self._record = prepared, dt, record
        #: What completes or undoes what an interrupt may have broken off, and its arguments.
        self._pending: tuple[Callable[..., None], tuple] | None = None
        self.held = held
        #: What tries the steps, and has the present state.
        self._steps = CompiledSingleSteps(prepared.stepper.integrator, dt, forces)
        #: The present state as it is shown.
        self.shown = FittedState(prepared.model, prepared.forcing, self)

    def begin(self, state: State, removed: np.ndarray, grid: Grid) -> None:
        """Begin to step and to record from a state, in which full turns are missing."""
        counter, model = self._prepared.turn_counter, self._prepared.model
        turns = counter.turns_of(state)
        state = counter.without(turns, state)
        counter.removed[:] = removed + turns
        #: Times of the ends of steps.
        self.grid = grid
        self._load(state, 0)
        self.shown.begin(state)
        recorder: Rows = NullRecorder()
        planned = math.inf
        if self._record is not None:
            recorder, planned = Recorder(model, np.array([state.t]), self._record), 0
            recorder.miss(counter.removed)
            recorder.record(0, state)
        #: The rows of the steps, and the number of those for which they have room.
        self.recorder: Rows = recorder
        self._planned: float = planned
        #: Present time [s].
        self.t = grid(0)

    def _load(self, state: State, number: int) -> None:
        """Return to a state and the number of steps to it."""
        self._prepared.stepper.load(state)
        self._steps.load(state, number)
        #: Number of steps that the statistics have.
        self._counted = number
        #: While a step is taken in parts: the last state, and the number of steps to it.
        self._last: tuple[State, int] | None = None

    def settle(self) -> None:
        """Complete or undo what an interrupt has broken off."""
        if self._pending is not None:
            mend, arguments = self._pending
            mend(*arguments)  # which may be interrupted, and called again
            self._pending = None

    # -- Steps --------------------------------------------------------------------------------

    def step(self, inputs: Mapping[str, Any]) -> None:
        """Take a step with some new inputs."""
        if self._pending is not None:
            self.settle()
        held, number = self.held, self.number + 1
        checked, t0, t1 = held.checked(inputs), self.t, self.grid(number)
        if number > self._planned:
            ends = self.grid(np.arange(number, number + _ROWS))
            self.recorder.plan(number, ends, last=False)
            self._planned = number + _ROWS - 1
        self._pending = self._end_step, (number, t0, t1, held.values)
        self.shown.leave()
        held.set(checked)
        held.begin(t0, t1)
        self._take(number, t0, t1)
        self._end_step(number, t0, t1, {})
        self._pending = None
        if number % _TURNS == 0:
            self._count_turns()

    def _take(self, number: int, t0: float, t1: float) -> None:
        """Take a step from t0 to t1 [s]; one that fails, or is one of parts, by the stepper."""
        stepper = self._prepared.stepper
        if stepper.halving.times or not self._steps.take(number, t0, t1, self.recorder):
            self.count()
            start = self.state()
            self._last = start, number - 1
            end = stepper.advance(start, np.array([t1]), number, self.recorder)
            past, parts = stepper.integrator.past, stepper.halving.memory
            self._last = replace(end, parts=parts, past=past), number

    def _end_step(self, number: int, t0: float, t1: float, inputs: Mapping[str, Any]) -> None:
        """End a step, whether it was taken or not; if not, with the inputs that it began with."""
        if self._last is not None:
            self._load(*self._last)
        done = self.number == number
        if done:
            self.held.arrive()
        else:
            self.held.set(inputs)
        self.t = t1 if done else t0
        self.recorder.truncate(1 + self.number // self.recorder.every)

    def _count_turns(self) -> None:
        """Count full turns separately, so that they do not add to rounding errors."""
        counter, state = self._prepared.turn_counter, self.state()
        turns = counter.turns_of(state)
        if turns.any():
            without = counter.without(turns, state), self.number
            self._pending = self._turn_back, (*without, counter.removed + turns)
            self.settle()

    def _turn_back(self, state: State, number: int, removed: np.ndarray) -> None:
        """Go on from the present state without its full turns; `removed` are all that miss."""
        self._prepared.turn_counter.removed[:] = removed
        self.recorder.miss(removed)
        self._load(state, number)

    def count(self) -> None:
        """Add what was counted to the statistics."""
        steps = self.number - self._counted
        self._prepared.stats.steps += steps
        self._steps.count(steps)
        self._counted += steps

    # -- The present state ----------------------------------------------------------------------

    @property
    def number(self) -> int:
        """Number of steps since `begin`."""
        return self._steps.completed

    @property
    def present(self) -> Any:
        """The present state: its arrays by the names in `State`, with the rates of steps."""
        return self._steps.now

    def state(self) -> State:
        """The same, with all on which the next step depends."""
        state = self._steps.state(self.grid(self.number))
        return replace(state, parts=self._prepared.stepper.halving.memory)

    def end(self) -> State:
        """The same as it is shown, with its full turns."""
        self.settle()
        state = self._prepared.turn_counter.with_turns(self.shown.state())
        return replace(state, inputs=self.held.all)

    def snapshot(self) -> Snapshot:
        """The present state, to return to."""
        self.settle()
        state = replace(self.shown.state(), inputs=self.held.all)
        turns, dofs = self._prepared.turn_counter.removed.copy(), self._prepared.model.mesh.dofs
        step = self.grid.origin, self.grid.first + self.number
        return Snapshot(self.t, state, step, turns, dofs)

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same scene."""
        self.settle()
        self.count()
        self._pending = self._return_to, (snapshot,)
        self.settle()

    def _return_to(self, snapshot: Snapshot) -> None:
        state = snapshot.state
        self._prepared.forcing.hold(state)
        self.held.resume(self._prepared.forcing, state, state.inputs)
        self.begin(state, snapshot.turns, Grid(*snapshot.step, self._dt))
