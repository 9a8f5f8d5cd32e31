"""Solutions by the factors of an earlier matrix, where new ones cost as much as many solutions."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from .sparse_lu import LU, Pattern

# Largest error of a solution, relative to it.
_EXACT = 1e-7


class KeptFactors:
    """Keeps factors while they pay.

    Kept factors precondition the method of generalised conjugate residuals, as in kept_factors.h.
    """

    def __init__(self, pattern: Pattern, lu: LU):
        indptr, indices = pattern
        n = len(indptr) - 1
        self._lu, self._worth = lu, lu.worth
        self._matrix = csr_matrix((np.zeros(len(indices)), indices, indptr), (n, n))
        #: Solutions with these factors, and substitutions in all of them and in the last one.
        self._solved, self._all, self._last = 0, 0, 0
        self._present = False

    @property
    def new(self) -> bool:
        """Whether the factors are those of the last matrix."""
        return self._present and not self._solved

    def solve(self, values: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Solution (n,) for the matrix with these values; not finite if it is singular."""
        if self._present and self._last * self._solved <= self._worth + self._all:
            x = self._iterate(values, b)
            if x is not None:
                return x
        self._solved = self._all = self._last = 0
        self._present = self._lu.factorise(values)
        return self._lu.solve(b) if self._present else np.full(len(b), np.nan)

    def _iterate(self, values: np.ndarray, b: np.ndarray) -> np.ndarray | None:
        """Solution by kept factors; None if new ones would be faster."""
        self._matrix.data = values
        x, r = np.zeros(len(b)), b
        directions, images = list[np.ndarray](), list[np.ndarray]()
        error, first = np.inf, np.zeros(2)
        for count in range(1, self._worth + 1):
            d = self._lu.solve(r)
            sizes = np.sqrt([abs(r @ d), d @ d])
            if count == 1:
                first = sizes
            if not (np.isfinite(sizes).all() and first.all()):
                return None
            before, error = error, (sizes / first).max()
            if error <= _EXACT:
                self._solved, self._all, self._last = self._solved + 1, self._all + count, count
                return x + d
            # So many more at the rate of the last one.
            rest = np.log(error / _EXACT) / np.log(before / error) if error < before else np.inf
            if count > 1 and count + rest > self._worth:
                return None
            image = self._matrix @ d
            for old, its in zip(directions, images, strict=True):
                along = image @ its
                image, d = image - along * its, d - along * old
            size = np.linalg.norm(image)
            directions.append(d / size)
            images.append(image / size)
            part = images[-1] @ r
            x, r = x + part * directions[-1], r - part * images[-1]
        return None
