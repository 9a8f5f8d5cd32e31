"""A sparse Jacobian of many configurations: the same entries of each, and numbers in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse

# Step in the imaginary direction.
_STEP = 1e-100


def slope(law: Callable[[np.ndarray], Any], given: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Derivative of an analytic law in a direction, exact to round-off."""
    return np.imag(law(given + _STEP * 1j * direction)) / _STEP


class RowJacobian:
    """A sparse matrix of n configurations, with some rows and columns of each: entries to add up.

    There are more columns that all have in `common`.
    """

    def __init__(self, n: int, rows: int, columns: int, common: int = 0):
        self._n, self._rows, self._columns, self._common = n, rows, columns, common
        none = np.empty(0, dtype=int)
        self._parts = [(none, none, np.empty((n, 0)))]
        self._others: list[scipy.sparse.csr_matrix] = []

    @property
    def _shape(self) -> tuple[int, int]:
        return self._n * self._rows, self._n * self._columns + self._common

    def put(self, to: Any, of: Any, values: np.ndarray) -> None:
        """Add values (n, ...) in rows `to` and columns `of` (...), if these are not negative."""
        to, of, pattern = np.broadcast_arrays(to, of, values[0])
        values = np.broadcast_to(values, (self._n, *pattern.shape))
        there = (to >= 0) & (of >= 0) & values.any(axis=0)
        self._parts.append((to[there], of[there], values[:, there]))

    def put_common(self, to: np.ndarray, first: int, values: scipy.sparse.csr_matrix) -> None:
        """Add values (n k, ...) in rows (k,), in common columns from one on."""
        of = values.tocoo()
        each, row = np.divmod(of.row, len(to))
        places = to[row] + self._rows * each, of.col + first + self._columns * (self._n - 1)
        self._others.append(scipy.sparse.csr_matrix((of.data, places), self._shape))

    @property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """With the columns in common behind those of the configurations."""
        to, of, values = (np.concatenate(part, axis=-1) for part in zip(*self._parts, strict=True))
        order, each = np.argsort(to, kind="stable"), np.arange(self._n)[:, None]
        of, own = of[order], of[order] < self._columns
        indices = np.where(own, of + self._columns * each, of + self._columns * (self._n - 1))
        ends = np.bincount(to, minlength=self._rows).cumsum() + len(to) * each
        entries = values[:, order].ravel(), indices.ravel(), np.append(0, ends)
        return sum(self._others, scipy.sparse.csr_matrix(entries, self._shape))


def behind(first: int, of: np.ndarray) -> np.ndarray:
    """Numbers from a first one on; those that are negative are -1."""
    return np.where(of < 0, -1, first + of)


def times(matrix: scipy.sparse.csr_matrix, x: np.ndarray, common: Any = ()) -> np.ndarray:
    """Products (n, m, rows) with x (n, m, columns), and with those in common (columns, m)."""
    n, m, _ = x.shape
    flat = np.vstack([x.swapaxes(1, 2).reshape(-1, m), *common])
    return (matrix @ flat).reshape(n, -1, m).swapaxes(1, 2)
