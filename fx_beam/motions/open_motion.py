"""A motion whose end is open: its state, inputs and record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.parallel.team_loop import TeamLoop, TeamSingleSteps
from fx_beam.results.state import State
from fx_beam.step.held_inputs import HeldInputs
from fx_beam.step.recorder import Record
from fx_beam.step.single_stepper import Grid, SingleStepper, SingleSteps
from fx_beam.step.single_steps import CompiledSingleSteps

from .measurement import FittedState
from .open_record import OpenRecord
from .prepared import Prepared
from .snapshot import Snapshot

# Steps between two counts of full turns, as in `simulate`.
_TURNS = 1000


class OpenMotion:
    """Takes steps of the length dt [s]. State, time, inputs and record agree after all interrupts.

    What changes several of them first says how it is completed or undone; `settle` does so.
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
        steps: SingleSteps
        if prepared.loop is not None:
            steps = CompiledSingleSteps(prepared.loop, dt, forces)
        else:
            assert isinstance(prepared.stepper.integrator, TeamLoop)
            steps = TeamSingleSteps(prepared.stepper.integrator)
        self.stepper = SingleStepper(prepared.stepper, steps)
        #: The present state as it is shown.
        self.now = FittedState(prepared.model, prepared.forcing, self.stepper)

    def begin(self, state: State, removed: np.ndarray, grid: Grid) -> None:
        """Begin to step and to record from a state, in which full turns are missing."""
        counter = self._prepared.turn_counter
        turns = counter.turns_of(state)
        state = counter.without(turns, state)
        counter.removed[:] = removed + turns
        self.stepper.load(state, grid)
        self.now.begin(state)
        self.rows = OpenRecord(self._prepared.model, self._record, state, counter.removed, grid)
        #: Present time [s].
        self.t = grid(0)

    def settle(self) -> None:
        """Complete or undo what an interrupt has broken off."""
        if self._pending is not None:
            mend, arguments = self._pending
            mend(*arguments)  # which may be interrupted, and called again
            self._pending = None

    def step(self, inputs: Mapping[str, Any]) -> None:
        """Take a step with some new inputs."""
        if self._pending is not None:
            self.settle()
        held, stepper, rows = self.held, self.stepper, self.rows
        number, given = stepper.number + 1, held.checked(inputs)
        t0, t1 = self.t, stepper.grid(number)
        rows.make_room(number)
        self._pending = self._end_step, (number, t0, t1, held.values)
        self.now.leave()
        held.set(given)
        held.begin(t0, t1)
        stepper.take(number, t0, t1, rows.recorder)
        self._end_step(number, t0, t1, {})
        self._pending = None
        if number % _TURNS == 0:
            self._count_turns()

    def _end_step(self, number: int, t0: float, t1: float, before: Mapping[str, Any]) -> None:
        """End a step, whether it was taken or not; otherwise with the inputs before it."""
        taken = self.stepper.settle()
        if taken == number:
            self.held.arrive()
            self.t = t1
        else:
            self.held.set(before)
            self.t = t0
        self.rows.truncate(taken)

    def _count_turns(self) -> None:
        """Count full turns separately, so that they do not add to rounding errors."""
        counter, state = self._prepared.turn_counter, self.stepper.state()
        turns = counter.turns_of(state)
        if turns.any():
            state, removed = counter.without(turns, state), counter.removed + turns
            self._pending = self._turn_back, (state, removed)
            self.settle()

    def _turn_back(self, state: State, removed: np.ndarray) -> None:
        """Go on from the present state without its full turns; `removed` are all that miss."""
        self._prepared.turn_counter.removed[:] = removed
        self.rows.miss(removed)
        self.stepper.go_on_from(state)

    def end(self) -> State:
        """The present state, with all on which the next step depends."""
        self.settle()
        state = self._prepared.turn_counter.with_turns(self.now.state())
        return replace(state, inputs=self.held.all)

    def snapshot(self) -> Snapshot:
        """The present state, to return to."""
        self.settle()
        stepper = self.stepper
        state = replace(self.now.state(), inputs=self.held.all)
        turns, dofs = self._prepared.turn_counter.removed.copy(), self._prepared.model.mesh.dofs
        step = stepper.grid.origin, stepper.grid.first + stepper.number
        return Snapshot(self.t, state, step, turns, dofs)

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same scene."""
        self.settle()
        self.stepper.count()
        self._pending = self._return_to, (snapshot,)
        self.settle()

    def _return_to(self, snapshot: Snapshot) -> None:
        state = snapshot.state
        self._prepared.forcing.hold(state)
        self.held.resume(self._prepared.forcing, state, state.inputs)
        self.begin(state, snapshot.turns, Grid(*snapshot.step, self._dt))
