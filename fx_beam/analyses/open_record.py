"""The record of a motion whose end is open."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.results.state import State
from fx_beam.stepping.recorder import Record, Recorder, Rows, Unrecorded

# Steps for which room is made at once.
_ROWS = 1024


class OpenRecord:
    """Rows of steps from a state on; there may be none. `times` gives those of their ends."""

    def __init__(
        self,
        model: Model,
        record: Record | None,
        state: State,
        times: Callable[[np.ndarray], np.ndarray],
    ):
        self.recorder: Rows = Unrecorded()
        self._times, self._planned, self._turned = times, 0, 0
        if record is not None:
            self.recorder = Recorder(model, np.array([state.t]), record)
            self.recorder.record(0, state)

    def make_room(self, step: int) -> None:
        """Make room for a row of a step; the first one has the number 1."""
        if step > self._planned and isinstance(self.recorder, Recorder):
            self._planned = step + _ROWS - 1
            ends = self._times(np.arange(step, self._planned + 1))
            self.recorder.plan(step, ends, last=False)

    def add_turns(self, turns: np.ndarray) -> None:
        """Add the full turns (size,) [rad] that are missing in the last rows."""
        if isinstance(self.recorder, Recorder):
            self.recorder.add_turns(self._turned, turns)
            self._turned = self.recorder.rows

    def complete(self, turns: np.ndarray) -> Recorder:
        """The recorder, with full turns in all rows; SceneError without one."""
        if not isinstance(self.recorder, Recorder):
            raise SceneError(
                "Motion.solution: nothing was recorded. Create the motion with record=fb.Record()"
            )
        self.add_turns(turns)
        return self.recorder
