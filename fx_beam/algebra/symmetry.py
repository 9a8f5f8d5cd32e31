"""Whether sparse matrices of one pattern are symmetric."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from .sparse_lu import Pattern

# Largest difference of two entries across the diagonal, relative to the largest ones of their rows.
_ROUNDING = 1e-12


class Symmetry:
    """Compares entries across the diagonal; `unit` (n,) are the sizes of unit unknowns."""

    def __init__(self, pattern: Pattern, unit: np.ndarray):
        indptr, indices = pattern
        n = len(indptr) - 1
        numbered = csr_matrix((np.arange(1, len(indices) + 1), indices, indptr), (n, n))
        other = numbered.T.tocsr()
        other.sort_indices()
        self._other = other.data[np.argsort(np.argsort(_keys(indptr, indices)))] - 1
        rows = np.repeat(np.arange(n), np.diff(indptr))
        self._starts, self._rows, self._columns = indptr[:-1], rows, indices
        self._unit = unit[rows] * unit[indices]

    def holds(self, values: np.ndarray) -> bool:
        """Whether the matrix with these values is symmetric up to rounding errors."""
        work = values * self._unit
        largest = np.sqrt(np.maximum.reduceat(abs(work), self._starts))
        gaps = abs(work - work[self._other])
        return bool((gaps <= _ROUNDING * largest[self._rows] * largest[self._columns]).all())


def _keys(indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Numbers of entries that rise by row and column."""
    n = len(indptr) - 1
    return np.repeat(np.arange(n, dtype=np.int64), np.diff(indptr)) * n + indices
