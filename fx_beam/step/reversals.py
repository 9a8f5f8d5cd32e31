"""Reversals of slip in few steps, whose times have derivatives of their own (c/reversals.h)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fx_beam.fem.frictions import Bristle

from .tables import ProblemInC
from .tape import Tape

#: Sub-steps of a run that may have one.
LEAST_STEPS = 3
# Sub-steps from slip to one side to slip to the other one, above which their derivatives are right.
_FEW = 8
# Slip, relative to the stretch of the spring in the step and to all slip, that is round-off.
_OF_STRETCH, _OF_SLIP = 1e-6, 1e-12
# Of the sides of slip in a sub-step, that of contact which is open.
_OPEN = 2
# Stretch [m or rad] at which friction is at its limit, whatever the increment of the step.
_FAR = 1e20
# In the place of the stretch derivatives carry the time of the reversal, so much smaller that
# outputs do not see it.
_SMALL = 1e-30


class Reversal(NamedTuple):
    """Slip that reverses between two sub-steps, `last` and `next`."""

    bristle: Bristle
    last: int
    next: int
    #: Its sign before, and its rate and acceleration in the last sub-step.
    sign: int
    rate: float
    acceleration: float
    #: Force that limits the friction of a joint, as the mean of both sub-steps.
    force: float

    def rows(self, lengths: np.ndarray) -> Iterator[tuple[int, dict[str, object]]]:
        """Sub-steps with their members of the C struct Reversal.

        The slip rate at the reversal is extrapolated from the last two sub-steps with slip. Its
        change over the acceleration is that of the time, by which in the middle of the next ones
        the friction changes from one side to the other.
        """
        last, place = self.last, self.bristle.place
        previous, length = lengths[last - 1 : last + 1]
        part = min(-self.rate / self.acceleration / length, 1.5)  # of a sub-step, from its middle
        fraction, rate_time = 2 * part * length / (previous + length), -_SMALL / self.acceleration
        yield last - 1, {"place": place, "leads": -fraction * rate_time / previous}
        yield last, {"place": place, "leads": (1 + fraction) * rate_time / length, "keeps": 1.0}
        still = range(last + 1, max(last + 2, self.next))
        middle = still[len(still) // 2]
        for k in still:
            row: dict[str, object] = {
                "place": place,
                "stretch": _FAR * self.sign,
                "force": self.force,
            }
            row["share"] = 2 * part - 2 if len(still) == 1 else 0.0
            if k < middle:
                row["keeps"] = 1.0
            if k == middle:
                row["pushes"] = 2 * self.bristle.mu / lengths[k] / _SMALL
            yield k, row


def all_places(bristles: Sequence[Bristle]) -> np.ndarray:
    """Places (3 n,) of stretch, slip and the force that is followed, or the stretch again."""
    return np.ravel([(b.place, b.place + 1, b.place + 2 * b.follows) for b in bristles])


def histories_of(tape: Tape, problem: ProblemInC, places: np.ndarray) -> np.ndarray:
    """Internal variables (n + 1, places) of forces at points at all ends of sub-steps.

    If not all rows are kept the run is repeated for them.
    """
    values = np.empty((len(tape) + 1, len(places)))
    for part in tape.parts(problem):
        boundaries = np.arange(part.first, part.end + 1)
        states = tape.states(boundaries, "spring internal")
        values[boundaries] = states["spring internal"][:, places]
    return values


def reversal_rows(
    bristles: Sequence[Bristle], histories: np.ndarray, lengths: np.ndarray
) -> dict[str, object]:
    """Members of the C struct Derivatives, from `all_places` (n + 1, ...) over n sub-steps."""
    rows = [
        row
        for i, bristle in enumerate(bristles)
        for reversal in _reversals(bristle, histories[:, 3 * i : 3 * i + 3], lengths)
        for row in reversal.rows(lengths)
    ]
    rows.sort(key=lambda row: row[0])
    starts = np.searchsorted([k for k, _ in rows], np.arange(len(lengths) + 1))
    return {"reversal_start": starts, "reversal": [row for _, row in rows]}


def _reversals(bristle: Bristle, history: np.ndarray, dt: np.ndarray) -> Iterator[Reversal]:
    """The reversals of one spring, from its history (n + 1, 3) at the ends of sub-steps (n,)."""
    stretch, slip, force = history.T
    slips = np.diff(slip)
    least = _OF_STRETCH * abs(np.diff(stretch)) + _OF_SLIP * abs(slip).max()
    signs = np.where(abs(slips) > least, np.sign(slips), 0).astype(int)
    signs[(slip[1:] == 0) & (stretch[1:] == 0)] = _OPEN
    known = np.flatnonzero(signs)
    a, b = known[:-1], known[1:]
    turns = (signs[a] == -signs[b]) & (b - a <= _FEW) & (a > 0) & (signs[a - 1] == signs[a])
    for last, next_slip in zip(a[turns].tolist(), b[turns].tolist(), strict=True):
        previous, rate = slips[last - 1 : last + 1] / dt[last - 1 : last + 1]
        acceleration = 2 * (rate - previous) / (dt[last - 1] + dt[last])
        # At another place of a member slip begins anew, and has not come to rest before.
        if abs(rate) < -signs[last] * acceleration * dt[last] * (next_slip - last + 1):
            mean = (force[last] + force[next_slip]) / 2 if bristle.follows else 0.0
            yield Reversal(bristle, last, next_slip, int(signs[last]), rate, acceleration, mean)
