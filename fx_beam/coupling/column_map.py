"""Degrees of freedom as linear functions of columns, some of which depend on others."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu


class ColumnMap:
    """x = A z, where the columns d depend on others and on each other: z_d = B z, in no circle."""

    def __init__(
        self, A: scipy.sparse.csr_matrix, B: scipy.sparse.csr_matrix, dependent: np.ndarray
    ):
        self._A, self._dependent = A, dependent
        others = np.ones(A.shape[1])
        others[dependent] = 0.0
        self._others = scipy.sparse.diags(others)
        self._B = (B @ self._others).tocsr()
        if len(dependent):
            coupled = scipy.sparse.identity(len(dependent)) - B[:, dependent]
            self._solve = splu(coupled.tocsc(), "NATURAL", diag_pivot_thresh=0.0).solve

    def __matmul__(self, z: np.ndarray) -> np.ndarray:
        """A z, for the other columns in z."""
        if len(self._dependent):
            z = self._others @ z
            z[self._dependent] = self._solve(self._B @ z)
        return self._A @ z

    def collected(self, r: np.ndarray, on_columns: np.ndarray) -> np.ndarray:
        """A^T r and the given forces on columns, with what dependent columns pass on to others."""
        out = self._A.T @ r + on_columns
        if len(self._dependent):
            out[self._dependent] = self._solve(out[self._dependent], "T")
            out += self._B.T @ out[self._dependent]
        return out

    def collected_rows(
        self, rows: scipy.sparse.csr_matrix
    ) -> tuple[scipy.sparse.csr_matrix, np.ndarray]:
        """Derivatives (n, columns) by the other columns from those by all; what is passed on.

        The latter (n, dependent) are the derivatives by dependent columns.
        """
        if not len(self._dependent):
            return rows, np.zeros((rows.shape[0], 0))
        passed = self._solve(rows[:, self._dependent].T.toarray(), "T").T
        by_others = rows @ self._others + scipy.sparse.csr_matrix(passed) @ self._B
        return by_others.tocsr(), passed

    @property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """The matrix from z to x."""
        return self.collected_rows(self._A)[0]
