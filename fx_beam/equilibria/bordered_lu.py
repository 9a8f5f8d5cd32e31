"""Factors of the equations of a path, bordered by a row and by the column of the load factor.

At a limit point the tangent K is singular. But K + b e e^T is not, where the unit vector e is that
of the unknown that moves most along the path. With its factors

    [K + b e e^T  c  -b e] [x]   [f]
    [n^T          d    0 ] [l] = [g]
    [e^T          0   -1 ] [w]   [0]

gives the solution x, l of the bordered system, and its determinant with the opposite sign.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.step.sparse_lu import LU, Pattern


class BorderedLU:
    """Factors of bordered matrices of one pattern, for unknowns of sizes `unit` (free,).

    The pattern (n, n) may have auxiliary rows behind the unknowns, where right sides are zero;
    `dependent` of `Reduction` says what follows from them.
    """

    def __init__(self, pattern: Pattern, unit: np.ndarray, dependent: np.ndarray | None = None):
        indptr, indices = pattern
        n, self._free, self._unit = len(indptr) - 1, len(unit), unit
        self._matrix = csr_matrix((np.zeros(len(indices)), indices, indptr), (n, n))
        rows = np.repeat(np.arange(n), np.diff(indptr))
        #: Places of the diagonal of the unknowns.
        self._diagonal = np.flatnonzero((rows == indices) & (rows < len(unit)))
        if self._free:
            self._lu = LU(pattern, dependent)
        #: Sign of the determinant.
        self.sign = 0.0

    @property
    def values(self) -> np.ndarray:
        """Values of the last K, in its pattern."""
        return self._matrix.data

    def factorise(
        self, values: np.ndarray, column: np.ndarray, row: np.ndarray, corner: float
    ) -> None:
        """Factorise a matrix bordered by a column and a row (free,), and their corner."""
        self._corner, self._regular = corner, True
        if not self._free:
            self.sign = float(np.sign(corner))
            return
        self._matrix.data = values
        diagonal, n = values[self._diagonal], self._matrix.shape[0]
        self._most = most = int(np.argmax(abs(row * self._unit)))
        # The amount of this unknown is one of two numbers in a small system; its pivots are alike.
        self._size = unit = self._unit[most]
        largest = abs(diagonal * self._unit**2).max() / unit**2
        # A negative one changes its sign: with its size alone it would vanish.
        added = max(diagonal[most], -2 * diagonal[most]) or largest or 1.0
        changed = values.copy()
        changed[self._diagonal[most]] += added
        self._regular = self._lu.factorise(changed)
        if not self._regular:
            self.sign = 0.0
            return
        self._column, self._row, change = np.zeros((3, n))
        self._column[: self._free], self._row[: self._free] = column, row
        change[most] = -added * unit
        self._forced = np.array([self._lu.solve(self._column), self._lu.solve(change)])
        rows = np.array([self._forced @ self._row, self._forced[:, most] / unit])
        self._small = np.diag([corner, -1.0]) - rows
        negative = self._lu.negative_pivots() % 2
        self.sign = float(np.sign(np.linalg.det(self._small))) * (1 if negative else -1)

    def negative_eigenvalues(self) -> int | None:
        """Number of negative eigenvalues of the last K; None if it is singular.

        K must be symmetric. An eigenvalue of K + b e e^T that K has below zero: det K is
        det(K + b e e^T) (1 - e . (K + b e e^T)^-1 b e).
        """
        if not self._free:
            return 0
        if not self._regular:
            return None
        return self._lu.negative_pivots() + int(self._small[1, 1] > 0)

    def solve(self, b: np.ndarray) -> tuple[np.ndarray, float]:
        """Solution x (free,) and l for a right side b (free + 1,).

        Not finite if the bordered matrix is singular.
        """
        if not self._free:
            return b[:-1], b[-1] / self._corner
        if not self._regular:
            return np.full(self._free, np.nan), np.nan
        right = np.zeros_like(self._column)
        right[: self._free] = b[:-1]
        x, load = self._once(right, b[-1])
        # Again, for the rounding errors of an elimination without exchange of rows.
        rest = right - self._matrix @ x - load * self._column
        correction, load_correction = self._once(rest, b[-1] - self._row @ x - self._corner * load)
        return (x + correction)[: self._free], load + load_correction

    def _once(self, right: np.ndarray, last: float) -> tuple[np.ndarray, float]:
        x = self._lu.solve(right)
        rest = np.array([last - self._row @ x, -x[self._most] / self._size])
        try:
            parts = np.linalg.solve(self._small, rest)
        except np.linalg.LinAlgError:
            # At a bifurcation of a straight path the equations have solutions; the shortest one.
            parts = np.linalg.lstsq(self._small, rest, rcond=None)[0]
            if not np.allclose(self._small @ parts, rest, rtol=1e-12, atol=0.0):
                parts = np.full(2, np.nan)
        return x - parts @ self._forced, float(parts[0])
