"""An interval of time, or of the load factor in statics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Interval(NamedTuple):
    """What one step covers [s], in statics from one load factor to the next."""

    start: float
    end: float

    @property
    def length(self) -> float:
        """End minus start."""
        return self.end - self.start

    def at(self, level: float) -> float:
        """Time at a level: 0 is the start, 1 the end."""
        return self.start + level * self.length


def just_inside(t0, t1):
    """Starts and ends of steps as loads see them: a little later, and a little earlier.

    A load that jumps from one step to the next belongs to the one in which it acts, whichever way
    its function rounds. A step of no length stays as it is.
    """
    inset = np.maximum(1e-12 * (t1 - t0), 4 * np.spacing(t1)) * (t1 != t0)
    return t0 + inset, t1 - inset
