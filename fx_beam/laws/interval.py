"""An interval of time, or of the load factor in statics, and what a step over it starts from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_NONE = np.empty(0)


class Interval(NamedTuple):
    """The times that one step covers [s], in statics from one load factor to the next.

    Sub-steps that go back in time end before they start.
    """

    start: float
    end: float
    #: Length, if it is not end - start: for an instant, or where the last digits count.
    own_length: float | None = None

    @property
    def length(self) -> float:
        """End minus start."""
        return self.end - self.start if self.own_length is None else self.own_length

    def time_at(self, level: float) -> float:
        """Time at a level of the step: 0 is its start, 1 its end."""
        return self.start + level * (self.end - self.start)


#: Length of a step that tells forces at rates, relative to a step of the motion; or the motion in
#: it, relative to the size of the scene. In a shorter one strains of round-off have large rates.
INSTANT = 1e-5


def instant(t: float, length: float) -> Interval:
    """An interval with all forces at the time t [s], and a length by which rates are found."""
    return Interval(t, t, length)


def divided(
    t0: np.ndarray, t1: np.ndarray, fractions: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends (n * m,) of the m sub-steps of each step from t0 to t1 (n,)."""
    if len(fractions) == 1:
        return t0, t1
    inner = t0[:, None] + (t1 - t0)[:, None] * np.cumsum(fractions)[:-1]
    ends = np.column_stack([t0, inner, t1])
    return ends[:, :-1].ravel(), ends[:, 1:].ravel()


def just_inside(t0, t1):
    """Starts and ends of steps, moved inwards by round-off: times at which loads are evaluated.

    A load that jumps between two steps then counts in the correct step, despite round-off. Steps of
    zero length are not changed.
    """
    inset = np.maximum(1e-12 * abs(t1 - t0), 4 * np.spacing(t1)) * np.sign(t1 - t0)
    return t0 + inset, t1 - inset


class Rest(NamedTuple):
    """Of equilibria: the time [s] of their loads, and the load factors (n,) of rows."""

    time: float
    factors: np.ndarray


class StepBatch(NamedTuple):
    """Completed steps, or parts of halved ones, one a row; what nothing depends on is left out."""

    #: Times (n,) at the scheme's level, and lengths [s].
    t: np.ndarray
    dt: np.ndarray
    #: Increments D and starts q (n, size), rates v and a at the start, starts of the last steps.
    D: np.ndarray = _NONE
    q: np.ndarray = _NONE
    v: np.ndarray = _NONE
    a: np.ndarray = _NONE
    q_previous: np.ndarray = _NONE
    #: Internal variables and natural strains at the start, natural strains at the end (n, k).
    internal: np.ndarray = _NONE
    natural: np.ndarray = _NONE
    natural_end: np.ndarray = _NONE
    #: `Step.memory` (n,).
    memory: np.ndarray = _NONE
    #: Parameters (n, k) at the scheme's level, where they are not functions of time.
    parameters: np.ndarray = _NONE
    #: Load factors (n,) in statics.
    load_factor: np.ndarray = _NONE
    #: Internal variables (n, width) of springs and slides (n, joints) at the start; increments.
    spring_internal: np.ndarray = _NONE
    slides: np.ndarray = _NONE
    slide_increments: np.ndarray = _NONE
    #: Rates (n, joints) of the slides at the start.
    slide_rates: np.ndarray = _NONE

    @classmethod
    def single(cls, t: float, dt: float, **arrays: np.ndarray | None) -> StepBatch:
        """One step, for arrays of any shape; None is for those that there are not."""
        present = {name: x for name, x in arrays.items() if x is not None and x.size}
        rows = {name: x.reshape(1, -1) if x.ndim else x.reshape(1) for name, x in present.items()}
        return cls(np.array([t]), np.array([dt]), **rows)

    @classmethod
    def at_rest(cls, q: np.ndarray, **arrays: np.ndarray | None) -> StepBatch:
        """One step in which q (size,) does not move."""
        return cls.single(0.0, 1.0, q=q, **arrays)

    def with_natural(self, first: np.ndarray, last: np.ndarray) -> StepBatch:
        """One step with natural strains (cells, degree, 3) at its start and end."""
        return self._replace(natural=first.reshape(1, -1), natural_end=last.reshape(1, -1))
