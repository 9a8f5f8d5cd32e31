"""K + s C + s^2 M of small motions: sparse, also in long trees and loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse

from fx_beam.step.extended import ConstrainedMatrix

# Random vectors of which sizes of diagonals are estimated.
_SAMPLES = 8


class Weighted:
    """E^T A E (free, free) of a sparse A (n, n), where y = E x is all that follows unknowns x."""

    def __init__(self, A: scipy.sparse.csr_matrix, stiffness: ConstrainedMatrix):
        self.A, self._stiffness = A, stiffness

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return self._stiffness.collected(self.A @ self._stiffness.spread(x))

    def __abs__(self) -> Weighted:
        return Weighted(abs(self.A), self._stiffness)

    def diagonal(self) -> np.ndarray:
        """Diagonal (free,); where other unknowns follow an estimate, without signs."""
        diagonal = self.A.diagonal()
        if self._stiffness.is_plain:
            return diagonal
        random = np.random.default_rng(0).standard_normal((len(diagonal), _SAMPLES))
        roots = self._stiffness.collected(np.sqrt(abs(diagonal))[:, None] * random)
        return (roots**2).mean(axis=1)


class DampedPencil:
    """K + s C + s^2 M of unknowns; with `ConstrainedMatrix` matrices, C and M without equations."""

    def __init__(self, K: ConstrainedMatrix, C: ConstrainedMatrix, M: ConstrainedMatrix):
        self._stiffness = K
        self.K, self.C, self.M = (Weighted(part.alone, K) for part in (K, C, M))
        parts, n = [part.system.tocoo() for part in (K, C, M)], K.system.shape[0]
        places = [part.col.astype(np.int64) * n + part.row for part in parts]
        pattern = np.unique(np.concatenate(places))
        # The values of all three in the columns of a common pattern.
        self._values = np.zeros((3, len(pattern)))
        for values, part, place in zip(self._values, parts, places, strict=True):
            np.add.at(values, np.searchsorted(pattern, place), part.data)
        self._pattern = pattern % n, np.searchsorted(pattern // n, np.arange(n + 1))

    def matrix_at(self, s: complex) -> ConstrainedMatrix:
        """The matrix at a number s [1/s]."""
        values, shape = np.array([1, s, s**2]) @ self._values, self._stiffness.system.shape
        matrix = scipy.sparse.csc_matrix((values, *self._pattern), shape)
        return replace(self._stiffness, system=matrix)
