"""Times at which equal steps end."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Grid:
    """Ends of steps of the length dt [s], counted from a state; number `first` is its own."""

    origin: float
    first: int
    dt: float

    def __call__(self, number):
        """Time at the end of a step [s]; step 0 is the start."""
        return self.origin + (self.first + number) * self.dt


def rounding_of(*times: float) -> float:
    """Largest rounding error of the difference of two times [s]."""
    return 4 * math.ulp(max(map(abs, times)))


def grid_from(t: float, dt: float) -> Grid:
    """Ends of steps from t [s] on: where a motion from zero has them, if t is one of them.

    So a motion in parts has the times of a motion as a whole, to the last digit.
    """
    number = round(t / dt)
    on_grid = abs(number * dt - t) <= rounding_of(t)
    return Grid(0.0, number, dt) if on_grid else Grid(t, 0, dt)
