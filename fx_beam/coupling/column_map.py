"""Degrees of freedom x = A z as linear functions of columns z, with equations C z = 0."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.content_cache import cached_property


class ColumnMap:
    """x = A z, where the equations C z = 0 give the `dependent` columns.

    `weights` are the entries of A: rows, columns and values. C is an array, or in compressed rows.
    Dependent columns are not finite if C z = 0 does not determine them.
    """

    def __init__(
        self,
        weights: tuple[np.ndarray, np.ndarray, np.ndarray],
        shape: tuple[int, int],
        C: scipy.sparse.csr_matrix | np.ndarray,
        dependent: np.ndarray,
    ):
        self._weights, self.shape, self._dependent = weights, shape, dependent
        #: C without the dependent columns.
        self._C: Any = None
        if not len(dependent):
            return
        independent = np.ones(shape[1])
        independent[dependent] = 0.0
        try:
            if isinstance(C, np.ndarray):
                inverse = np.linalg.inv(C[:, dependent])
                self._solve = lambda x, side="N": (inverse if side == "N" else inverse.T) @ x
                self._C = C * independent
            else:
                self._solve = splu(C[:, dependent].tocsc()).solve
                self._C = C @ scipy.sparse.diags(independent)
        except (np.linalg.LinAlgError, RuntimeError):  # it is singular
            self._C = np.full(C.shape, np.nan)
            self._solve = lambda x, side="N": np.full_like(x, np.nan)

    def with_dependent(self, z: np.ndarray) -> np.ndarray:
        """z (columns,) with its dependent entries computed from the others."""
        if len(self._dependent):
            z = z.copy()
            z[self._dependent] = -self._solve(self._C @ z)
        return z

    def __matmul__(self, z: np.ndarray) -> np.ndarray:
        """x = A z, for the independent entries of z."""
        row, column, values = self._weights
        return np.bincount(row, values * self.with_dependent(z)[column], self.shape[0])

    def transposed(self, r: np.ndarray, on_columns: np.ndarray) -> np.ndarray:
        """A^T r + forces `on_columns`; forces on dependent columns are passed on to the others."""
        row, column, values = self._weights
        out = np.bincount(column, values * r[row], self.shape[1]) + on_columns
        if len(self._dependent):
            out -= self._C.T @ self._solve(out[self._dependent], "T")
            out[self._dependent] = 0.0
        return out

    @cached_property
    def dependence_matrix(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) of `with_dependent`."""
        independent = np.setdiff1d(np.arange(self.shape[1]), self._dependent)
        entries = np.ones(len(independent)), (independent, independent)
        if len(self._dependent):
            # Of the independent columns few are in long loops.
            used = np.flatnonzero(abs(self._C).sum(axis=0))
            C = self._C[:, used]
            ratios = -self._solve(C if isinstance(C, np.ndarray) else C.toarray())
            k, column = np.nonzero(ratios)
            places = (
                np.append(independent, self._dependent[k]),
                np.append(independent, used[column]),
            )
            entries = np.append(entries[0], ratios[k, column]), places
        return scipy.sparse.csr_matrix(entries, (self.shape[1],) * 2)

    @cached_property
    def _A(self) -> scipy.sparse.csr_matrix:
        row, column, values = self._weights
        return scipy.sparse.csr_matrix((values, (row, column)), self.shape)

    @cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """The matrix from z to x."""
        return self._A @ self.dependence_matrix if len(self._dependent) else self._A

    def derivatives_by_dependent(self) -> np.ndarray:
        """dx/d(C z) (n, dependent): A_d C_d^-1 with the dependent columns of A and C."""
        if not len(self._dependent):
            return np.zeros((self.shape[0], 0))
        return self._solve(self._A[:, self._dependent].T.toarray(), "T").T
