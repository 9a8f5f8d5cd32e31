"""Floquet multipliers of a periodic motion, and what they say about its stability."""

from __future__ import annotations

import numpy as np

from .closing import Closed

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
