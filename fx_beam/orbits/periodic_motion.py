"""A motion that repeats itself, with what its neighbours do."""

from __future__ import annotations

import numpy as np

from fx_beam.results.vibrations import PeriodicMotion

from .closing import Closed
from .shooting import Shooting

# Multipliers that are larger than 1 by less are round-off.
_NEUTRAL = 1e-5


def multipliers_of(closed: Closed) -> np.ndarray:
    """Multipliers (n,), largest first, of what steps resolve.

    Without changes that turn by more than a quarter in the first step, as those that alternate.
    """
    own = closed.by.own
    unit = closed.by.matrix[own]
    values, vectors = np.linalg.eig(np.linalg.solve(unit, closed.monodromy[own]))
    after = np.linalg.solve(unit, closed.first_step[own]) @ vectors
    along = np.real(np.einsum("ij,ij->j", vectors.conj(), after))
    slow = values[(along > 0) | (abs(values) < _NEUTRAL)]
    return slow[np.lexsort((-slow.imag, -abs(slow)))]


def instability_of(multipliers: np.ndarray, trivial: int) -> str:
    """How a motion is unstable, by the largest multiplier; empty if it is stable.

    Some multipliers are `trivial`: 1 for shifts in time, and for the energy of a family.
    """
    others = np.delete(multipliers, np.argsort(abs(multipliers - 1))[:trivial])
    growing = others[abs(others) > 1 + _NEUTRAL]
    if not len(growing):
        return ""
    largest = growing[np.argmax(abs(growing))]
    if abs(largest.imag) > _NEUTRAL:
        return "Neimark-Sacker"
    return "fold" if largest.real > 0 else "period doubling"


# Losses in a period that are round-off, relative to the energy of the motion.
_NO_LOSS = 1e-12


def motion_of(shooting: Shooting, closed: Closed, free: bool) -> PeriodicMotion:
    """What users get of a periodic motion."""
    period = closed.period
    energy, multipliers = shooting.energy(period.start), multipliers_of(closed)
    conserves = period.lost <= _NO_LOSS * max(1.0, abs(energy))
    return PeriodicMotion(
        float(period.length),
        energy,
        multipliers,
        instability_of(multipliers, free * (1 + conserves)),
        float(period.error),
        closed.iterations,
        lambda: shooting.solution(period),
    )
