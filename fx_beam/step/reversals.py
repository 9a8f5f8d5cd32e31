"""Reversals of slip in a few steps, whose times have derivatives of their own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fx_beam.fem.point_forces import Bristle

# Steps between slip to one side and to the other one, from which on those of the steps are right.
_FEW = 16
# Slip, relative to the stretch of the spring in the step and to all slip, that is round-off.
_OF_STRETCH, _OF_SLIP = 1e-6, 1e-12
# Stretch [m or rad] at which friction is at its limit, whatever the increment of the step.
_FAR = 1e20
# In its place the derivative of the spring's stretch carries that of the time, so much smaller that
# outputs do not see it.
_SMALL = 1e-30
_OPEN = 2


class Reversal(NamedTuple):
    """Friction whose slip reverses after a sub-step, and again has a side in a later one."""

    bristle: Bristle
    last: int
    next: int
    #: Its side before, and its acceleration.
    side: int
    rate: float
    acceleration: float
    #: Force that limits the friction of a joint, as the mean of both sub-steps.
    force: float


def reversals_in(
    bristle: Bristle, stretch: np.ndarray, slip: np.ndarray, force: np.ndarray, lengths: np.ndarray
) -> Iterator[Reversal]:
    """Reversals in few sub-steps: internal variables (n + 1,) at their ends, forces (n,)."""
    slips = np.diff(slip)
    least = _OF_STRETCH * abs(np.diff(stretch)) + _OF_SLIP * abs(slip).max(initial=0.0)
    sides = np.where(abs(slips) > least, np.sign(slips), 0).astype(int)
    sides[(slip[1:] == 0) & (stretch[1:] == 0)] = _OPEN
    known = np.flatnonzero(sides)
    a, b = known[:-1], known[1:]
    found = _reverses(sides, a, b)
    for last, then in zip(a[found].tolist(), b[found].tolist(), strict=True):
        before, rate = slips[last - 1 : last + 1] / lengths[last - 1 : last + 1]
        acceleration = 2 * (rate - before) / lengths[last - 1 : last + 1].sum()
        if acceleration * sides[last] < 0:
            mean = (force[last] + force[then]) / 2
            yield Reversal(bristle, last, then, int(sides[last]), rate, acceleration, mean)


def _reverses(sides: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether slip reverses between sub-steps a and b, and has its side in another one around."""
    after = np.minimum(b + 1, len(sides) - 1)
    turns = (sides[a] == -sides[b]) & (b - a <= _FEW) & (a > 0)
    return turns & (sides[a - 1] == sides[a]) & (sides[after] == sides[b])


def rows_of(reversals: list[Reversal], lengths: np.ndarray) -> dict[str, Any]:
    """Members of the C struct Derivatives for a run of sub-steps."""
    rows = list[tuple[int, dict[str, Any]]]()
    for of in reversals:
        place, before, last = of.bristle.place, *lengths[of.last - 1 : of.last + 1]
        leads = -_SMALL / of.acceleration
        part = min(-of.rate / of.acceleration / last, 1.5)
        on = 2 * part * last / (before + last)
        rows.append((of.last - 1, {"place": place, "leads": -leads * on / before}))
        rows.append((of.last, {"place": place, "leads": leads * (1 + on) / last, "keeps": 1.0}))
        inside = range(of.last + 1, max(of.last + 2, of.next))
        for k in inside:
            row = {"place": place, "stretch": _FAR * of.side, "force": of.force, "keeps": 1.0}
            if k == inside[len(inside) // 2]:
                row |= {"pushes": 2 * of.bristle.mu / lengths[k] / _SMALL, "keeps": 0.0}
            if len(inside) == 1:
                row["share"] = 2 * part - 2
            rows.append((k, row))
    rows.sort(key=lambda row: row[0])
    starts = np.searchsorted([k for k, _ in rows], np.arange(len(lengths) + 1))
    return {"reversal_start": starts, "reversal": [row for _, row in rows]}
