"""The parts in which steps of a time grid are taken where they fail as a whole."""

from __future__ import annotations

import numpy as np

# Parts that succeed before they are doubled again, and at most, where doubling them was in vain.
_PATIENCE, _MOST_PATIENCE = 2, 64
# Turn of a node per step of the grid [rad] from which on a step that must be taken in parts is too
# large for the motion. Whole, it misses an angle x of a turn by x^3 / 12, one part in fifty here:
# whether it is halved is then seen in the motion, and what decides it may be rounding. At smaller
# turns it makes no visible difference.
LARGE_TURN = 0.5


#: Halvings after which parts of a step vanish beside the time.
MOST_HALVINGS = 50


class Halving:
    """Steps of a time grid in parts, halved where one fails and doubled where enough succeed.

    The size that works is remembered, so that not every step fails anew at a larger one.
    """

    def __init__(self, most: int):
        self.most = most
        self.times = self.done = 0
        self._patience, self._succeeded, self._doubled = _PATIENCE, 0, False

    def memory(self, dt: float) -> np.ndarray:
        """What decides about the parts of the next steps, to go on with later (5,).

        The step's length dt [s], how often it is halved, and the counts for when to double parts.
        """
        return np.array([dt, self.times, self._patience, self._succeeded, self._doubled], float)

    def resume(self, memory: np.ndarray | None, dt: float) -> None:
        """Go on with the memory of another run, if its steps are as long."""
        if memory is None or abs(memory[0] - dt) > 1e-6 * dt or memory[1] > self.most:
            return
        self.times, self._patience, self._succeeded = map(int, memory[1:4])
        self._doubled = bool(memory[4])

    @property
    def parts(self) -> int:
        """Number of parts of a step."""
        return 2**self.times

    def ends(self, grid: np.ndarray) -> np.ndarray:
        """Ends (m,) of the next parts, until they may be doubled [s].

        `grid` (n,) is the start of the present step, and the ends of it and of those that follow.
        """
        number = max(1, self._needed - self._succeeded)
        number += (self.done + number) % 2
        parts = self.done + np.arange(1, number + 1)
        step, part = np.divmod(parts[parts <= (len(grid) - 1) * self.parts], self.parts)
        lengths = np.append(np.diff(grid), 0.0)
        return grid[step] + lengths[step] * part / self.parts

    def take(self, number: int) -> int:
        """Count parts in a row that succeeded, and give the number of steps completed with them."""
        steps, self.done = divmod(self.done + number, self.parts)
        if number:
            self._patience, self._doubled = self._needed, False
        self._succeeded += number
        if self.times and self._succeeded >= self._patience and self.done % 2 == 0:
            self.times, self.done = self.times - 1, self.done // 2
            self._succeeded, self._doubled = 0, True
        return steps

    @property
    def _needed(self) -> int:
        """Parts that must succeed: fewer once parts that were doubled do."""
        return max(_PATIENCE, self._patience // 2) if self._doubled else self._patience

    def fail(self) -> bool:
        """Halve what is left of a step, and say whether that is allowed."""
        if self.times == self.most:
            return False
        if self._doubled:
            self._patience, self._doubled = min(2 * self._patience, _MOST_PATIENCE), False
        self.times, self.done = self.times + 1, 2 * self.done
        self._succeeded = 0
        return True
