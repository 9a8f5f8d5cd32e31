"""One step at a time, in Python: the fallback of compiled/stride.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fx_beam.results.state import State

from .recorder import Rows
from .stepper import Stepper


class Stride:
    """Takes single steps."""

    #: The present state.
    now: State

    def __init__(self, stepper: Stepper):
        self._stepper = stepper

    def load(self, state: State) -> None:
        """Begin from a state."""
        self.now, self._stepper.past = state, state.past
        self._stepper.halving.resume(state.parts)

    def state(self) -> State:
        """The present state, with all on which the next step depends."""
        stepper = self._stepper
        return replace(self.now, parts=stepper.halving.memory, past=stepper.past)

    def take(self, t1: float, number: int, recorder: Rows) -> None:
        """Take step `number` up to t1 [s]. After an error the state is that before it."""
        before = self.state()
        try:
            self.now = self._stepper.march(before, np.array([t1]), number, recorder)
        except BaseException:
            self.load(before)
            raise

    def count(self) -> None:
        """Nothing is left to be counted."""
