"""LU factors of sparse matrices, in C."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import SuperLU, splu

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.content_cache import shallow_copy
from fx_beam.fem.sparsity import Pattern

from .lu_layout import NONE, factors_of

# Change of a singular matrix, relative to its largest entry.
_SHIFT = 1e-13
# Iterations for null vectors, each of which makes other vectors far smaller.
_ITERATIONS = 5


def pivoted_lu(matrix: Any) -> SuperLU:
    """Factors by SciPy of a sparse matrix whose pattern is symmetric, also a complex one.

    Rows are exchanged where a pivot is small. RuntimeError if it is exactly singular.
    """
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)


def null_vectors(matrix: Any, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Left and right vectors (n, count) of the least singular values, by inverse iteration.

    The matrix is one in unit unknowns, nearly singular, or exactly.
    """
    try:
        lu = pivoted_lu(matrix)
    except RuntimeError:
        shift = _SHIFT * abs(matrix.data).max()
        lu = pivoted_lu(matrix + shift * identity(matrix.shape[0]))
    right = np.random.default_rng(0).standard_normal((matrix.shape[0], count))
    for _ in range(_ITERATIONS):
        left = np.linalg.qr(lu.solve(right, "T"))[0]
        right = np.linalg.qr(lu.solve(left))[0]
    return left, right


class LU:
    """Factors in sparse rows (lu_layout.py) without exchange of rows, for a pattern.

    With auxiliary unknowns and loops, `dependent` and `forces` are as in `factors_of`.
    """

    def __init__(
        self, pattern: Pattern, dependent: np.ndarray | None = None, forces: np.ndarray = NONE
    ):
        files = "sparse_lu.h", "sparse_rows.h"
        ffi, self._library = c_library.open_library("factors of sparse matrices", *files)
        self._ffi, layout = ffi, factors_of(*pattern, dependent, forces)
        self._rows = ffi.new("SparseRows *")
        # Of each unknown; none without unknowns.
        self._diagonals = layout.rows.get("diagonal", layout.order)[layout.order]
        self._structs = Structs(ffi)
        self._factors = np.empty(layout.size)
        self._structs.set(self._rows, **layout.rows, factors=self._factors)
        self._place, self._order = self._ints(layout.at), self._ints(layout.order)
        #: Solutions that cost as much as a factorisation.
        self.worth = layout.worth
        self._double = ffi.typeof("double[]")

    def empty(self) -> LU:
        """Factors for the same pattern, of a matrix to come."""
        other = shallow_copy(self)
        other._factors = np.empty(len(self._factors))
        other._rows = self._ffi.new("SparseRows *", self._rows[0])
        other._rows.factors = self._doubles(other._factors)
        return other

    def _ints(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer("int[]", np.asarray(values, np.int32, "C"))

    def _doubles(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer(self._double, values)

    def factorise(self, values: np.ndarray) -> bool:
        """By elimination without exchange of rows."""
        pointer = self._doubles(np.asarray(values, float, "C"))
        return bool(self._library.fx_factorise(self._rows, len(self._place), self._place, pointer))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """By substitution."""
        b, x = np.asarray(b, float, "C"), np.empty(len(b))
        self._library.fx_solve(self._rows, self._order, self._doubles(b), self._doubles(x))
        return x

    @property
    def pivots(self) -> np.ndarray:
        """Inverses of the pivots of all unknowns."""
        return self._factors[self._diagonals]

    def negative_pivots(self) -> int:
        """Their number: of a symmetric matrix, that of its negative eigenvalues."""
        return int((self.pivots < 0).sum())
