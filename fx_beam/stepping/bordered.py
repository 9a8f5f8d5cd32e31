"""The tangent of the equations, bordered by a column and a row: factors, and their determinant."""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from scipy.sparse.csgraph import connected_components


class Bordering:
    """Borders matrices of one pattern; `unit` (free,) are the sizes of unit unknowns.

    The pattern may have more rows, behind those of the unknowns: they are zero on the right side.
    """

    def __init__(self, pattern: tuple[np.ndarray, np.ndarray], unit: np.ndarray):
        indptr, indices = pattern
        n = len(indptr) - 1
        self._free, self._unit = len(unit), np.append(unit, np.ones(n - len(unit)))
        each, last = np.arange(n), np.full(n, n)
        rows = np.concatenate([np.repeat(each, np.diff(indptr)), each, last, [n]])
        columns = np.concatenate([indices, last, each, [n]])
        self._inner = rows[: len(indices)], columns[: len(indices)]
        rows, columns = rows.astype(np.int32), columns.astype(np.int32)
        #: The order of the entries by columns; then their rows, and where each column starts.
        self._order = order = np.lexsort((rows, columns))
        ends = np.arange(n + 2, dtype=np.int32)
        self._by_columns = rows[order], np.searchsorted(columns[order], ends).astype(np.int32)

    def factors(
        self, values: np.ndarray, column: np.ndarray, row: np.ndarray, corner: float
    ) -> BorderedFactors:
        """Factors of a matrix bordered by a column and a row (free,), and their corner."""
        # Scaled by the units of the scene: the pivots do not depend on the user's units.
        unit, (at_row, at_column) = self._unit, self._inner
        n, zero = len(unit), np.zeros(len(unit) - self._free)
        column, row = np.append(column, zero), np.append(row, zero)
        values = values * unit[at_row] * unit[at_column]
        size = abs(values).max(initial=0.0) or 1.0
        parts = values / size, unit * column / size, row * unit, [corner]
        entries = np.concatenate(parts)[self._order], *self._by_columns
        matrix = scipy.sparse.csc_matrix(entries, (n + 1, n + 1))
        return BorderedFactors(matrix, unit[: self._free], size)


class BorderedFactors:
    """Factors of a bordered matrix; of an exactly singular one the solution is not finite."""

    def __init__(self, matrix: scipy.sparse.csc_matrix, unit: np.ndarray, size: float):
        self._unit, self._size = unit, size
        try:
            self._lu = scipy.sparse.linalg.splu(matrix)
        except RuntimeError:  # exactly singular
            self._lu = None

    def solve(self, b: np.ndarray) -> tuple[np.ndarray, float]:
        """Solution (free,) and that of the border, for a right side (free + 1,)."""
        free, unit = len(self._unit), self._unit
        if self._lu is None:
            return np.full(free, np.nan), np.nan
        right = np.zeros(self._lu.shape[0])
        right[:free], right[-1] = unit * b[:free] / self._size, b[free]
        x = self._lu.solve(right)
        return unit * x[:free], float(x[-1])

    @functools.cached_property
    def sign(self) -> float:
        """Sign of the determinant."""
        if self._lu is None:
            return 0.0
        sign = np.prod(np.sign(self._lu.U.diagonal()))
        return float(sign * _parity(self._lu.perm_r) * _parity(self._lu.perm_c))


def _parity(order: np.ndarray) -> int:
    """1 for an even permutation, -1 for an odd one."""
    n = len(order)
    graph = scipy.sparse.csr_matrix((np.ones(n), order, np.arange(n + 1)), (n, n))
    cycles, _ = connected_components(graph)
    return 1 if (n - cycles) % 2 == 0 else -1
