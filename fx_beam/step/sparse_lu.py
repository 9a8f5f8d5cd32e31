"""LU factors of sparse matrices, in C; without a C compiler by SciPy."""

from __future__ import annotations

import functools
import logging
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import SuperLU, splu

from fx_beam import c_library
from fx_beam.structs import Structs

from .lu_layout import in_sparse_rows

_log = logging.getLogger("fx_beam")
Pattern = tuple[np.ndarray, np.ndarray]


class LU(Protocol):
    """Factors of matrices of one pattern."""

    #: Solutions that cost as much as a factorisation; 0 if it is unknown.
    worth: int

    def factorise(self, values: np.ndarray) -> bool:
        """Factorise the matrix with these values; returns whether it is regular."""

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solution (n,) for a right side (n,)."""

    def negative_pivots(self) -> int | None:
        """Their number, of a symmetric matrix that of negative eigenvalues; None if unknown."""


def sparse_lu(pattern: Pattern, dependent: np.ndarray | None = None) -> CompiledLU | ScipyLU:
    """Factors without exchange of rows for a pattern (indptr, indices).

    With ties, `dependent` is that of `Reduction`.
    """
    try:
        ffi, library = _library()
    except c_library.CannotBuild as error:
        _log.debug("factors by SciPy: %s", error)
        return ScipyLU(pattern)
    return CompiledLU(ffi, library, pattern, dependent)


def pivoted_lu(matrix: Any) -> SuperLU:
    """Factors by SciPy of a sparse matrix whose pattern is symmetric, also a complex one.

    Rows are exchanged where a pivot is small. RuntimeError if it is exactly singular.
    """
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)


@functools.cache
def _library() -> tuple[Any, Any]:
    return c_library.open_library("factors of sparse matrices", "lu.c", "lu.h")


class CompiledLU:
    """Factors in sparse rows (lu_layout.py), by lu.c."""

    def __init__(self, ffi: Any, library: Any, pattern: Pattern, dependent: np.ndarray | None):
        self._ffi, self._library = ffi, library
        layout = in_sparse_rows(*pattern, dependent)
        self._rows, self._diagonals = ffi.new("SparseRows *"), layout.diagonals
        self._structs = Structs(ffi, c_library.declarations("lu.h"))
        self._structs.set(self._rows, **layout.rows())
        self._at, self._order = self._ints(layout.at), self._ints(layout.order)
        #: Solutions that cost as much as a factorisation.
        self.worth = layout.worth
        self._double = ffi.typeof("double[]")
        self._entries, self._factors = len(layout.at), np.empty(layout.size)
        self._at_factors = self._doubles(self._factors)

    def _ints(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer("int[]", np.asarray(values, np.int32, "C"))

    def _doubles(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer(self._double, values)

    def factorise(self, values: np.ndarray) -> bool:
        """By elimination without exchange of rows."""
        values, factorise = np.asarray(values, float, "C"), self._library.fx_factorise
        given = self._entries, self._at, self._doubles(values)
        return bool(factorise(self._rows, *given, self._at_factors))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """By substitution."""
        b, x = np.asarray(b, float, "C"), np.empty(len(b))
        given = self._order, self._at_factors, self._doubles(b)
        self._library.fx_solve(self._rows, *given, self._doubles(x))
        return x

    def negative_pivots(self) -> int:
        """Their number: of a symmetric matrix, that of its negative eigenvalues."""
        return int((self._factors[self._diagonals] < 0).sum())


class ScipyLU:
    """Factors by SuperLU."""

    def __init__(self, pattern: Pattern):
        indptr, indices = pattern
        self.worth, n = 0, len(indptr) - 1
        numbered = csr_matrix((np.arange(len(indices)), indices, indptr), (n, n)).tocsc()
        self._from, self._matrix = numbered.data, numbered.astype(float)

    def factorise(self, values: np.ndarray) -> bool:
        """By columns; rows are exchanged where a pivot is zero only."""
        self._matrix.data = values[self._from]
        options = {"SymmetricMode": True}
        try:
            self._lu = splu(
                self._matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
            )
        except RuntimeError:  # exactly singular
            return False
        return True

    def solve(self, b: np.ndarray) -> np.ndarray:
        """By substitution."""
        return self._lu.solve(b)

    def negative_pivots(self) -> int:
        """Their number."""
        return int((self._lu.U.diagonal() < 0).sum())
