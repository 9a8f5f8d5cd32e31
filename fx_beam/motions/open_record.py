"""The record of a motion whose end is open."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.step.model import Model
from fx_beam.step.recorder import NullRecorder, Record, Recorder, Rows

# Steps for which room is made at once.
_ROWS = 1024


class OpenRecord:
    """Rows of steps from a state on; there may be none. `times` gives those of their ends.

    Full turns (size,) [rad] are missing in the state.
    """

    def __init__(
        self,
        model: Model,
        record: Record | None,
        state: State,
        turns: np.ndarray,
        times: Callable[[np.ndarray], np.ndarray],
    ):
        self.recorder: Rows = NullRecorder()
        self._times, self._planned = times, 0
        if record is not None:
            self.recorder = Recorder(model, np.array([state.t]), record)
            self.miss(turns)
            self.recorder.record(0, state)

    def make_room(self, step: int) -> None:
        """Make room for a row of a step; the first one has the number 1."""
        if step > self._planned and isinstance(self.recorder, Recorder):
            last = step + _ROWS - 1
            self.recorder.plan(step, self._times(np.arange(step, last + 1)), last=False)
            self._planned = last

    def truncate(self, steps: int) -> None:
        """Have the rows of some steps; what was begun after them is forgotten."""
        self.recorder.truncate(1 + steps // self.recorder.every)

    def miss(self, turns: np.ndarray) -> None:
        """Note that full turns (size,) [rad] are missing in the rows from here on."""
        if isinstance(self.recorder, Recorder):
            self.recorder.turns[self.recorder.rows] = turns.copy()

    def complete(self) -> Recorder:
        """The recorder; SceneError without one."""
        if not isinstance(self.recorder, Recorder):
            raise SceneError(
                "Motion.solution: nothing was recorded. Create the motion with record=fb.Record()"
            )
        return self.recorder
