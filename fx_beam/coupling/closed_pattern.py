"""The sparsity of a tangent in which loops are closed."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .index_reduction import sparsity


class ClosedPattern:
    """A sparsity with the products that loops of some unknowns add."""

    def __init__(self, pattern: tuple[np.ndarray, np.ndarray], loop: np.ndarray):
        indptr, indices = pattern
        self._n = n = len(indptr) - 1
        A = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
        full = scipy.sparse.lil_matrix((n, n))
        full.setdiag(1.0)
        full[np.ix_(loop, loop)] = 1.0
        full = full.tocsr()
        closed = (full.T @ A @ full + full).tocoo()
        self.pattern, _ = sparsity(closed.row, closed.col, n)
        rows = np.repeat(np.arange(n), np.diff(self.pattern[0]))
        #: Numbers of the entries in increasing order: row times unknowns plus column.
        self._keys = rows * n + self.pattern[1]
        #: Unknowns with entries of the loops.
        self.near = np.unique(self.pattern[1][np.isin(rows, loop)])
        #: Positions of the entries of the given pattern.
        self.open_entries = self.at(np.repeat(np.arange(n), np.diff(indptr)), indices)

    def at(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Places of entries."""
        return np.searchsorted(self._keys, rows * self._n + columns)
