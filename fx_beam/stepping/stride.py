"""One step at a time, in Python: the fallback of compiled/stride.py."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fx_beam.results.state import State

from .recorder import Rows
from .stepper import Stepper


@dataclass(frozen=True)
class Grid:
    """Ends of steps of the length dt [s], counted from a state; number `first` is its own."""

    origin: float
    first: int
    dt: float

    def __call__(self, number):
        """Time at the end of a step [s]; step 0 is the start."""
        return self.origin + (self.first + number) * self.dt


class Stride:
    """Takes single steps; the compiled counterpart is `CompiledStride`.

    An interrupt may come anywhere. Whether a step is taken then changes by one assignment.
    """

    def __init__(self, stepper: Stepper):
        self._stepper = stepper
        #: Whether the stepper may be between two states.
        self._under_way = False

    def load(self, state: State, grid: Grid) -> None:
        """Begin from a state."""
        stepper = self._stepper
        stepper.past = state.past
        stepper.halving.resume(state.parts)
        #: The last state, with all on which the next step depends, and the number of steps to it.
        self._last = replace(state, parts=stepper.halving.memory, past=stepper.past), 0
        #: Times of the ends of steps.
        self.grid = grid
        self._under_way = False

    @property
    def now(self) -> State:
        """The present state."""
        return self._last[0]

    @property
    def number(self) -> int:
        """Number of steps since `load`."""
        return self._last[1]

    def go_on_from(self, state: State) -> None:
        """Go on from another form of the present state."""
        self._last = state, self.number

    def state(self) -> State:
        """The present state, with all on which the next step depends."""
        return self.now

    def settle(self) -> int:
        """Return to the last state, if a step was broken off; gives the number of steps to it."""
        if self._under_way:
            self._stepper.past = self.now.past
            self._stepper.halving.resume(self.now.parts)
            self._under_way = False
        return self.number

    def take(self, number: int, t0: float, t1: float, recorder: Rows) -> None:
        """Take a step from t0 to t1 [s]. After an error or an interrupt, call `settle`."""
        stepper = self._stepper
        self._under_way = True
        new = stepper.march(self.now, np.array([t1]), number, recorder)
        new = replace(new, parts=stepper.halving.memory, past=stepper.past)
        self._last = new, number
        self._under_way = False

    def count(self) -> None:
        """Nothing is left to be counted."""
