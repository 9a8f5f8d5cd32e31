"""How exact the corrections of Newton's method must be."""

from __future__ import annotations

import numpy as np

# As in kept_factors.h and newton.h: error of a correction relative to what Newton's method leaves,
# and bounds of it relative to the correction.
_SHARE, _MOST, _LEAST = 0.1, 1e-3, 1e-12


class Accuracy:
    """Bounds of the errors of corrections, by the quadratic convergence of this step and the last.

    `least` is an error that is negligible anyway, in the norm of the corrections.
    """

    def __init__(self, least: float):
        self._least = least
        self._slowest = 0.0
        self.begin()

    def begin(self) -> None:
        """Before the first correction of a step."""
        self._kept, self._slowest = self._slowest, 0.0
        #: Size of the last correction, and its error.
        self._last, self._left = np.inf, 0.0

    def allowed(self, size: float, least: float) -> float:
        """Error that the next correction may have, for its size.

        `least` is one whose energy is negligible.
        """
        quadratic = _SHARE * max(self._slowest, self._kept) * size
        floor = min(_SHARE * self._least, least)
        return max(floor, min(_MOST, max(quadratic, _LEAST)) * size)

    def note(self, size: float, error: float) -> None:
        """After a correction of some size with an error, which the next one corrects as well."""
        if 100 * self._left < size < self._last < np.inf:
            self._slowest = max(self._slowest, size / self._last**2)
        self._last, self._left = size, error
