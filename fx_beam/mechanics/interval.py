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


def just_inside(t0, t1):
    """Starts and ends of steps, moved inwards by round-off: times at which loads are evaluated.

    A load that jumps between two steps then counts in the correct step, despite round-off. Steps of
    zero length are not changed.
    """
    inset = np.maximum(1e-12 * (t1 - t0), 4 * np.spacing(t1)) * (t1 != t0)
    return t0 + inset, t1 - inset
