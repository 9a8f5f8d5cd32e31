"""From all degrees of freedom to the unknowns: supports, and joints without multipliers.

The full vector x of nodal values is a function g of the columns z, the unknowns first. Newton's
method solves That^T r(g(z)) = 0; the tangent is That^T K T + (dThat/dz)^T r with T = dg/dz.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse


class Tables(NamedTuple):
    """Couplings as lists of numbers, each a dictionary of arrays of one length.

    Parameters
    ----------
    entries : dict
        row, column, value and sign of the entries of T and That; value 0 is the constant 1.
    joints : dict
        offset, axis, sign (in x and y), guide (-1: ground), slide_column (-1: none) and number of
        the joints that bend.
    followers : dict
        dof and through: degrees of freedom that follow through a joint, x through 2 j of joint j
        and y through 2 j + 1.
    plain : dict
        to and source: entries of the full tangent that are added to reduced ones.
    mixed : dict
        to, source, hat, value and sign: those that are multiplied by entries of That and T.
    second : dict
        to, joint, kind and sign of the derivatives of That.
    third : dict
        to, of, side and sign of the derivatives of the forces of springs and dampers.
    """

    entries: dict
    joints: dict
    followers: dict
    plain: dict
    mixed: dict
    second: dict
    third: dict


class Reduction(Protocol):
    """Unknowns of a scene, and how vectors and matrices are reduced to them.

    Attributes
    ----------
    free, driven, columns : int
        Number of unknowns, of driven columns (prescribed, motors), and of all with the fixed ones.
    pattern : (indptr, indices)
        Sparsity of the reduced matrix in compressed rows.
    """

    free: int
    driven: int
    columns: int
    pattern: tuple[np.ndarray, np.ndarray]

    def begin(self, q: np.ndarray, slides: np.ndarray, dt: float) -> None:
        """Set the start of a step: displacements and rotations, slides, and its length."""

    def expand(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Increment of all degrees of freedom for increments of the unknowns: g."""

    def spread(self, z: np.ndarray) -> np.ndarray:
        """Small change of all degrees of freedom for one of all columns: T z."""

    def coupling(self) -> scipy.sparse.csr_matrix:
        """The matrix T (size, columns) of `spread`."""

    def project(self, r: np.ndarray) -> np.ndarray:
        """Generalised forces at all columns: That^T r, with those of springs and dampers."""

    def guide_moments(self, r: np.ndarray) -> np.ndarray | None:
        """Moments of offset and sliding joints on the nodes that carry them, for forces r."""

    def tables(self) -> Tables:
        """The lists that all of this is made of, for the compiled loop."""

    def fill(self, values: np.ndarray, r: np.ndarray, out: np.ndarray) -> None:
        """Values of the reduced tangent for those of the full one and the forces at the nodes."""


class IndexReduction:
    """Supports and joints that make degrees of freedom equal: nothing but numbering.

    Parameters
    ----------
    column : (size,) int
        Column of each degree of freedom.
    free, driven, columns : int
        Numbers of columns.
    matrix : (size, size) sparse matrix
        Gives the sparsity of the full tangent.
    """

    def __init__(self, column: np.ndarray, free: int, driven: int, columns: int, matrix):
        self._column = column
        self.free, self.driven, self.columns = free, driven, columns
        self._z = np.zeros(columns)
        self._dofs = _Sums(column)
        rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        row, col = column[rows], column[matrix.indices]
        kept = np.flatnonzero((row < free) & (col < free))
        self.pattern, place = sparsity(row[kept], col[kept], free)
        self._entries = _Sums(place, kept)

    def begin(self, q, slides, dt) -> None:
        """Nothing depends on the step."""

    def expand(self, y, driven):
        """Increment of all degrees of freedom."""
        z = self._z
        z[: self.free] = y
        z[self.free : self.free + self.driven] = driven
        return z[self._column]

    def spread(self, z):
        """The same for a small change."""
        return z[self._column]

    def coupling(self):
        """Ones."""
        size = len(self._column)
        shape = (size, self.columns)
        return scipy.sparse.csr_matrix((np.ones(size), (np.arange(size), self._column)), shape)

    def project(self, r):
        """Sums over equal degrees of freedom."""
        out = np.empty(self.columns)
        self._dofs.of(r, out)
        return out

    def guide_moments(self, r):
        """None, as there are no levers."""
        return None

    def fill(self, values, r, out) -> None:
        """Sums over equal degrees of freedom."""
        self._entries.of(values, out)

    def tables(self):
        """Columns, and sums of entries."""
        none, pairs = np.empty(0, int), np.empty((0, 2))
        size = len(self._column)
        to, source = self._entries.pairs()
        return Tables(
            entries={
                "row": np.arange(size),
                "column": self._column,
                "value": np.zeros(size, int),
                "sign": np.ones(size),
            },
            joints={
                "offset": pairs,
                "axis": pairs,
                "sign": pairs,
                "guide": none,
                "slide_column": none,
                "number": none,
            },
            followers={"dof": none, "through": none},
            plain={"to": to, "source": source},
            mixed={"to": none, "source": none, "hat": none, "value": none, "sign": none},
            second={"to": none, "joint": none, "kind": none, "sign": none},
            third={"to": none, "of": none, "side": none, "sign": none},
        )


class _Sums:
    """Sums of the entries of a vector that share a place: a pick, and the few that come on top."""

    def __init__(self, place: np.ndarray, source: np.ndarray | None = None):
        source = np.arange(len(place)) if source is None else source
        _, first = np.unique(place, return_index=True)
        self._first = source[first]
        self._more: list[tuple[np.ndarray, np.ndarray]] = []
        left = np.setdiff1d(np.arange(len(place)), first)
        while len(left):  # once for every further node on a pin
            _, i = np.unique(place[left], return_index=True)
            self._more.append((place[left[i]], source[left[i]]))
            left = np.delete(left, i)

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Places and sources of all entries."""
        first = np.arange(len(self._first)), self._first
        places, sources = zip(first, *self._more, strict=True)
        return np.concatenate(places), np.concatenate(sources)

    def of(self, values: np.ndarray, out: np.ndarray) -> None:
        """Write the sums to `out`."""
        np.take(values, self._first, out=out)
        for place, source in self._more:
            out[place] += values[source]


def sparsity(rows: np.ndarray, columns: np.ndarray, n: int):
    """Compressed rows of the pairs given, and the place of each pair in them."""
    keys, place = np.unique(rows * n + columns, return_inverse=True)
    counts = np.bincount(keys // n, minlength=n)
    indptr = np.concatenate(([0], np.cumsum(counts)))
    return (indptr.astype(np.int32), (keys % n).astype(np.int32)), place
