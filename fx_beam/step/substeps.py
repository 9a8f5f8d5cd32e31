"""Sub-steps: steps of a time grid are divided if they fail as a whole."""

from __future__ import annotations

import numpy as np

# Number of successful sub-steps before their length is doubled; it grows up to the second value if
# doubling fails.
_SUCCESSES, _MOST_SUCCESSES = 2, 64
# Rotation of a node per step of the grid [rad] from which on a divided step is too large for the
# motion. A whole step with a rotation x has the error x^3 / 12, here 2 % of x: the motion then
# depends on whether the step is halved, and rounding errors may decide this. For smaller rotations
# the difference is not visible.
LARGE_TURN = 0.5


#: With more halvings a sub-step would be smaller than the rounding error of the time.
MOST_HALVINGS = 50


class Halving:
    """Controls the length of sub-steps: halved after a failure, doubled after some successes.

    The length is kept from step to step, so that not every step first fails with a larger one.
    """

    def __init__(self, most: int, dt: float | None = None):
        self.most = most
        #: Length of whole steps [s]; None where they have no common one.
        self.dt = dt
        self.times = self.done = 0
        self._required, self._succeeded, self._doubled = _SUCCESSES, 0, False

    @property
    def state(self) -> np.ndarray | None:
        """State (5,) of the control, from which another run can continue.

        It has the length of whole steps [s], the number of halvings, and the counts for doubling.
        """
        if self.dt is None:
            return None
        counts = self.times, self._required, self._succeeded, self._doubled
        return np.array([self.dt, *counts], float)

    def resume(self, state: np.ndarray | None) -> None:
        """Continue with the state of another run, if its steps have the same length."""
        self.done = 0
        if state is None or self.dt is None or state[1] > self.most:
            return
        if abs(state[0] - self.dt) > 1e-6 * self.dt:
            return
        self.times, self._required, self._succeeded = map(int, state[1:4])
        self._doubled = bool(state[4])

    @property
    def parts(self) -> int:
        """Number of sub-steps of a step."""
        return 2**self.times

    def ends(self, grid: np.ndarray) -> np.ndarray:
        """Ends (m,) [s] of the next sub-steps, up to where their length may be doubled.

        `grid` (n,) has the start of the current step, its end, and the ends of the next steps.
        """
        number = max(1, self._required_now - self._succeeded)
        number += (self.done + number) % 2
        parts = self.done + np.arange(1, number + 1)
        step, part = np.divmod(parts[parts <= (len(grid) - 1) * self.parts], self.parts)
        lengths = np.append(np.diff(grid), 0.0)
        return grid[step] + lengths[step] * part / self.parts

    def count_done(self, number: int) -> int:
        """Count successful sub-steps; returns the number of steps that they complete."""
        steps, self.done = divmod(self.done + number, self.parts)
        if number:
            self._required, self._doubled = self._required_now, False
        self._succeeded += number
        if self.times and self._succeeded >= self._required and self.done % 2 == 0:
            self.times, self.done = self.times - 1, self.done // 2
            self._succeeded, self._doubled = 0, True
        return steps

    @property
    def _required_now(self) -> int:
        """Successes before doubling; their number is halved after a successful doubling."""
        return max(_SUCCESSES, self._required // 2) if self._doubled else self._required

    def fail(self) -> bool:
        """Halve the sub-steps after a failure; False if this is no longer allowed."""
        if self.times == self.most:
            return False
        if self._doubled:
            self._required, self._doubled = min(2 * self._required, _MOST_SUCCESSES), False
        self.times, self.done = self.times + 1, 2 * self.done
        self._succeeded = 0
        return True
