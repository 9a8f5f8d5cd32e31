"""Degrees of freedom x = A z as linear functions of columns z, with equations C z = 0."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.content_cache import cached_property
from fx_beam.fem.sparsity import starts_of

# A sum is zero but for rounding errors at this part of the sizes of its terms.
_CANCELLED = 1e-12


class ColumnMap:
    """x = A z, where the equations C z = 0 give the `dependent` columns.

    `weights` are the entries of A: rows, columns and values. C is an array, or in compressed rows.
    Where it is `nested`, an equation has -1 for its own dependent column, and others of those
    before it. Dependent columns are not finite if C z = 0 does not determine them.
    """

    def __init__(
        self,
        weights: tuple[np.ndarray, np.ndarray, np.ndarray],
        shape: tuple[int, int],
        C: scipy.sparse.csr_matrix | np.ndarray,
        dependent: np.ndarray,
        nested: bool = False,
    ):
        self._weights, self.shape, self._dependent = weights, shape, dependent
        #: C without the dependent columns.
        self._C: Any = None
        #: What dependent columns have of those before them, if C is sparse and nested.
        self._nested: Any = None
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
                if nested:
                    self._nested = C[:, dependent] + scipy.sparse.identity(len(dependent))
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

    def transposed(self, r: np.ndarray, column_forces: np.ndarray) -> np.ndarray:
        """A^T r + `column_forces`; those on dependent columns are passed on to the others."""
        row, column, values = self._weights
        out = np.bincount(column, values * r[row], self.shape[1]) + column_forces
        if len(self._dependent):
            out -= self._C.T @ self._solve(out[self._dependent], "T")
            out[self._dependent] = 0.0
        return out

    @cached_property
    def dependence_matrix(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) of `with_dependent`."""
        independent = np.setdiff1d(np.arange(self.shape[1]), self._dependent)
        entries = np.ones(len(independent)), (independent, independent)
        if self._nested is not None:
            ratios = nested_solution(self._nested, self._C).tocoo()
            places = self._dependent[ratios.row], ratios.col
            matrix = scipy.sparse.csr_matrix((ratios.data, places), (self.shape[1],) * 2)
            return matrix + scipy.sparse.csr_matrix(entries, matrix.shape)
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
    def matrix(self) -> scipy.sparse.csr_matrix:
        """The matrix from z to x."""
        row, column, values = self._weights
        A = scipy.sparse.csr_matrix((values, (row, column)), self.shape)
        return A @ self.dependence_matrix if len(self._dependent) else A

    @property
    def array(self) -> np.ndarray:
        """Array (rows, columns) of the matrix, for a small scene, which takes far less time."""
        if len(self._dependent):
            return self.matrix.toarray()
        row, column, values = self._weights
        places = row * self.shape[1] + column
        return np.bincount(places, values, math.prod(self.shape)).reshape(self.shape)


def nested_solution(
    N: scipy.sparse.csr_matrix, b: scipy.sparse.csr_matrix
) -> scipy.sparse.csr_matrix:
    """x (n, m) = N x + b, where N (n, n) is triangular in some order, with zero diagonal."""
    x = term = b
    N.eliminate_zeros()
    while term.nnz:
        term = N @ term
        term.eliminate_zeros()
        x = x + term
    return x


def without_dependent(
    weights: scipy.sparse.csr_matrix, C: scipy.sparse.csr_matrix, dependent: np.ndarray
) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
    """B (n, columns) of independent columns, and Y (n, dependent), with W z = B z + Y C z.

    An equation has dependent columns of those before it only. What cancels is no entry: the
    difference of two nodes far down in a tree has entries of the way between them.
    """
    number = np.full(C.shape[1], -1)
    number[dependent] = np.arange(len(dependent))
    number_of, equations = number.tolist(), [dict(equation) for equation in _rows(C)]
    pivots = [equation.pop(k) for equation, k in zip(equations, dependent.tolist(), strict=True)]
    left, multipliers = list[dict[int, float]](), list[dict[int, float]]()
    for terms in _rows(weights):
        value, size, used = dict[int, float](), dict[int, float](), dict[int, float]()
        waiting = list[tuple[int, int]]()  # the last one is the next
        while True:
            for column, x in terms:
                if column not in value and number_of[column] >= 0:
                    heapq.heappush(waiting, (-number_of[column], column))
                value[column] = value.get(column, 0.0) + x
                size[column] = size.get(column, 0.0) + abs(x)
            if not waiting:
                break
            (k, column), terms = heapq.heappop(waiting), []
            if abs(x := value.pop(column)) > _CANCELLED * size[column]:
                used[-k] = y = x / pivots[-k]
                terms = [(other, -y * part) for other, part in equations[-k].items()]
        left.append({k: x for k, x in value.items() if abs(x) > _CANCELLED * size[k]})
        multipliers.append(used)
    return _matrix(left, C.shape[1]), _matrix(multipliers, len(dependent))


def _rows(matrix: scipy.sparse.csr_matrix) -> Iterator[list[tuple[int, float]]]:
    """Columns and values of each row."""
    entries = [*zip(matrix.indices.tolist(), matrix.data.tolist(), strict=True)]
    return (entries[begin:end] for begin, end in pairwise(matrix.indptr.tolist()))


def _matrix(rows: list[dict[int, float]], columns: int) -> scipy.sparse.csr_matrix:
    indices, values = ([x for row in rows for x in part(row)] for part in (dict.keys, dict.values))
    shape = len(rows), columns
    matrix = scipy.sparse.csr_matrix((values, indices, starts_of([*map(len, rows)])), shape)
    matrix.sort_indices()
    return matrix
