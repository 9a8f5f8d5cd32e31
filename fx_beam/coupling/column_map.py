"""Degrees of freedom as linear functions of columns, some of which depend on others."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.content_cache import cached_property


class ColumnMap:
    """x = A z, where the columns d depend on others and on each other: z_d = B z, in no circle."""

    def __init__(
        self,
        weights: tuple[np.ndarray, np.ndarray, np.ndarray],
        shape: tuple[int, int],
        B: scipy.sparse.csr_matrix | np.ndarray | None,
        dependent: np.ndarray,
    ):
        #: Entries of A: rows, columns and values.
        self._weights, self._shape, self._dependent = weights, shape, dependent
        if B is None:
            return
        if isinstance(B, np.ndarray):
            self._B: Any = B.copy()
            self._B[:, dependent] = 0.0
            inverse = np.linalg.inv(np.eye(len(dependent)) - B[:, dependent])
            self._solve = lambda x, side="N": (inverse if side == "N" else inverse.T) @ x
        else:
            self._B = B.copy()
            self._B.data[np.isin(self._B.indices, dependent)] = 0.0
            coupled = scipy.sparse.identity(len(dependent)) - B[:, dependent]
            self._solve = splu(coupled.tocsc(), "NATURAL", diag_pivot_thresh=0.0).solve

    def __matmul__(self, z: np.ndarray) -> np.ndarray:
        """A z, for the other columns in z."""
        if len(self._dependent):
            z = z.copy()
            z[self._dependent] = self._solve(self._B @ z)
        row, column, values = self._weights
        return np.bincount(row, values * z[column], self._shape[0])

    @cached_property
    def _A(self) -> scipy.sparse.csr_matrix:
        row, column, values = self._weights
        return scipy.sparse.csr_matrix((values, (row, column)), self._shape)

    def collected(self, r: np.ndarray, on_columns: np.ndarray) -> np.ndarray:
        """A^T r and the given forces on columns, with what dependent columns pass on to others."""
        row, column, values = self._weights
        out = np.bincount(column, values * r[row], self._shape[1]) + on_columns
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
        on = np.flatnonzero(passed.any(axis=1))
        of_some = (
            passed[on] if isinstance(self._B, np.ndarray) else scipy.sparse.csr_matrix(passed[on])
        )
        more, given = scipy.sparse.coo_matrix(of_some @ self._B), rows.tocoo()
        others = ~np.isin(given.col, self._dependent)
        data = np.append(given.data[others], more.data)
        at = np.append(given.row[others], on[more.row]), np.append(given.col[others], more.col)
        return scipy.sparse.csr_matrix((data, at), rows.shape), passed

    @property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """The matrix from z to x."""
        return self.collected_rows(self._A)[0]
