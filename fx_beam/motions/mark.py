"""A mark of a run: the end of a step, to which the run can return."""

from __future__ import annotations

from typing import Any, NamedTuple

from fx_beam.step.recorder import Rows
from fx_beam.step.state_vector import StateCopy
from fx_beam.step.stepper import Stepper


class Mark(NamedTuple):
    """Copies of the state in C, of the control of halving, and of the number of rows."""

    state: StateCopy
    halving: dict[str, Any]
    rows: int

    @classmethod
    def of(cls, stepper: Stepper, recorder: Rows) -> Mark:
        """A mark of the present state."""
        return cls(stepper.loop.state.copy(), dict(vars(stepper.halving)), recorder.rows)

    def restore(self, stepper: Stepper, recorder: Rows) -> None:
        """Return to the mark."""
        stepper.loop.state.restore(self.state)
        vars(stepper.halving).update(self.halving)
        recorder.truncate(self.rows)
