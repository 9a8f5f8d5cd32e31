"""One step at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

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


class SingleSteps(Protocol):
    """Tries single steps from a state that stays where it is: in C, or on several processes."""

    @property
    def now(self) -> Any:
        """The present state: its arrays by the names in `State`."""

    @property
    def completed(self) -> int:
        """Number of steps to it, by which one knows whether a step is taken."""

    def load(self, state: State, number: int) -> None:
        """Begin with a state after some steps."""

    def state(self, t: float) -> State:
        """The present state and its past."""

    def take(self, number: int, t0: float, t1: float, recorder: Rows) -> bool:
        """Whether a step succeeds; otherwise the state is that before it."""

    def count(self, taken: int) -> None:
        """Add what was counted in some steps to the statistics."""


class SingleStepper:
    """Takes single steps; those that fail, and those in parts, by the `Stepper`.

    An interrupt may come anywhere: a step is taken or not.
    """

    def __init__(self, stepper: Stepper, steps: SingleSteps):
        self._stepper, self._halving = stepper, stepper.halving
        #: What tries the steps, and has the present state.
        self.steps = steps
        #: Number of steps that the statistics have.
        self._counted = 0
        #: While a step is taken in parts: the last state, and the number of steps to it.
        self._last: tuple[State, int] | None = None

    def load(self, state: State, grid: Grid) -> None:
        """Begin from a state."""
        #: Times of the ends of steps.
        self.grid = grid
        self._load(state, 0)

    def go_on_from(self, state: State) -> None:
        """Go on from another form of the present state."""
        self._last = state, self.number
        self.settle()

    def _load(self, state: State, number: int) -> None:
        """Return to a state and the number of steps to it."""
        self._stepper.load(state)
        self.steps.load(state, number)
        self._counted = number
        self._last = None

    @property
    def number(self) -> int:
        """Number of steps since `load`."""
        return self.steps.completed

    def state(self) -> State:
        """The present state, with all on which the next step depends."""
        state = self.steps.state(self.grid(self.number))
        return replace(state, parts=self._halving.memory)

    def settle(self) -> int:
        """Return to the last state, if a step was begun in parts; gives the number of steps."""
        if self._last is not None:
            self._load(*self._last)
        return self.number

    def take(self, number: int, t0: float, t1: float, recorder: Rows) -> None:
        """Take a step from t0 to t1 [s]. After an error or an interrupt, call `settle`."""
        if self._halving.times or not self.steps.take(number, t0, t1, recorder):
            stepper = self._stepper
            self.count()
            before = self.state()
            self._last = before, number - 1
            after = stepper.advance(before, np.array([t1]), number, recorder)
            memory = self._halving.memory
            self._last = replace(after, parts=memory, past=stepper.integrator.past), number
            self.settle()

    def count(self) -> None:
        """Add what was counted to the statistics."""
        taken = self.number - self._counted
        self._stepper.stats.steps += taken
        self.steps.count(taken)
        self._counted += taken
