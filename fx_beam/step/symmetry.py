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
        numbered.sort_indices()
        other = numbered.T.tocsr()
        rows = np.repeat(np.arange(n), np.diff(indptr))
        above = rows < numbered.indices
        #: Entries above the diagonal, and those across from them.
        self._above, self._below = numbered.data[above] - 1, other.data[above] - 1
        self._starts, self._rows, self._columns = indptr[:-1], rows[above], numbered.indices[above]
        self._units, self._unit = unit[rows] * unit[indices], unit

    def holds(self, values: np.ndarray) -> bool:
        """Whether the matrix with these values is symmetric up to rounding errors."""
        gaps = abs(values[self._above] - values[self._below])
        if not gaps.any():
            return True
        sizes = abs(values * self._units)
        if (gaps * self._units[self._above] > _ROUNDING * sizes.max()).any():
            return False  # whatever the largest ones of their rows are
        largest = np.sqrt(np.maximum.reduceat(sizes, self._starts))
        largest /= self._unit
        return bool((gaps <= _ROUNDING * largest[self._rows] * largest[self._columns]).all())
