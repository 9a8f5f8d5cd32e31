"""Friction of forces at points, as its reversals are looked for: springs, and smooth signs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Bristle(NamedTuple):
    """The spring of friction that sticks."""

    #: Place of its stretch among all internal variables of forces at points; then comes the slip,
    #: and in a joint, if it follows its force, this force.
    place: int
    mu: float
    follows: bool


class SmoothSign(NamedTuple):
    """Friction with the smooth sign of a rate: below the speed it is viscous."""

    speed: float
    #: The joint of its slide, or -1 and degrees of freedom, -1 for the ground.
    slide: int
    dofs: Sequence[int]
    #: From the first to the second node in the reference, if it is on their distance.
    arm: np.ndarray
    #: What of the scene it belongs to, as text.
    owner: str

    def coordinate(self, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Its coordinate (n,) in configurations (n, ...): a slide, an angle or a distance."""
        if self.slide >= 0:
            return slides[:, self.slide]
        a, b = np.split(np.where(np.array(self.dofs) < 0, 0.0, q[:, self.dofs]), 2, axis=1)
        return np.hypot(*(b - a + self.arm).T) if len(self.dofs) > 2 else (b - a)[:, 0]
