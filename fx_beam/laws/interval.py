"""An interval of time, or of the load factor in statics, and what a step over it starts from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_NONE, _ZERO, _ONE = np.empty(0), np.zeros(1), np.ones(1)


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

    def at(self, level: float) -> float:
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


class StepStart(NamedTuple):
    """Configuration, rates and memory at the start of a step."""

    #: Displacements and rotations q (size,), rates v and accelerations a; v and a may be left out
    #: if nothing depends on them.
    q: np.ndarray
    v: np.ndarray = _NONE
    a: np.ndarray = _NONE
    #: Start of the last step, q by default, and `Step.memory`.
    q_previous: np.ndarray | None = None
    memory: float = 0.0
    #: Internal variables (cells, degree, width) of beams.
    internal: np.ndarray | None = None
    #: Slides and their rates (joints,), zero by default, and internal variables of springs.
    slides: np.ndarray = _NONE
    slide_rates: np.ndarray = _NONE
    spring_internal: np.ndarray | None = None
    #: Parameters (n,) at the scheme's level, where they are not functions of time.
    parameters: np.ndarray | None = None
    #: Natural strains (cells, degree, 3) at the start and at the end of the step, if there are any.
    natural: tuple[np.ndarray, np.ndarray] | None = None

    def batch(self, t: float, length: float, D: np.ndarray, parameters: np.ndarray) -> StepBatch:
        """The one step from here with an increment D (size,) and the values of `parameters`."""
        natural, natural_end = self.natural or (None, None)
        return StepBatch(
            t=np.array([t]),
            dt=np.array([length]),
            D=_row(D),
            q=_row(self.q),
            v=_row(self.v),
            a=_row(self.a),
            q_previous=_row(self.q if self.q_previous is None else self.q_previous),
            internal=_row(self.internal),
            natural=_row(natural),
            natural_end=_row(natural_end),
            memory=np.array([self.memory]),
            parameters=_row(parameters),
        )


def _row(values: np.ndarray | None) -> np.ndarray:
    """The one row (1, n) of a batch; empty for nothing."""
    return _NONE if values is None or not values.size else values.reshape(1, -1)


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

    @classmethod
    def at_rest(cls, q: np.ndarray, **more: np.ndarray) -> StepBatch:
        """One step in which q (size,) does not move."""
        return cls(_ZERO, _ONE, q=q[None], **more)

    @property
    def fields(self) -> tuple[np.ndarray, ...]:
        """Fields, numbered as the kinds of coefficients in problem.h."""
        return self[2:10]
