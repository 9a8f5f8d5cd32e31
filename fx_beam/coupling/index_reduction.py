"""From all degrees of freedom to the unknowns: supports, and joints without multipliers.

The nodal vector x is a function g of the columns z, unknowns first, with T = dg/dz. Virtual
displacements are Tv times those of the columns (`virtual_map`). Newton's method solves
Tv^T r(g(z)) = 0; the tangent is Tv^T K T + (dTv/dz)^T r.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_by_content


class AuxiliaryTables(NamedTuple):
    """Auxiliaries for the compiled loop, by the names in problem.h."""

    values: dict[str, Any]
    #: Entries of the reduced tangent, -1 for none; those that are 1.
    entries: dict[str, np.ndarray]
    ones: np.ndarray


class Tables(NamedTuple):
    """Couplings for the compiled loop: dictionaries of arrays of equal length."""

    #: Entries of T and Tv: row, column, value (0 is the constant 1) and sign.
    entries: dict
    #: Joints that depend on the motion: offset, axis, sign (x, y), carrier (-1: ground),
    #: slide_column (-1: none) and number.
    joints: dict
    #: Degrees of freedom (dof) that follow through joint j: through is 2 j for x and 2 j + 1 for y.
    followers: dict
    #: Entries of the full tangent that are added to reduced ones as they are: to and source.
    direct: dict
    #: Entries that are multiplied by entries of Tv (virtual) and T (value): also with a sign.
    coupled: dict
    #: Geometric stiffness, the derivatives of Tv: to, joint, kind and sign.
    geometric: dict
    #: Derivatives of the forces of springs and dampers: to, of, side and sign.
    restoring: dict
    auxiliaries: AuxiliaryTables | None


class LoopTables(NamedTuple):
    """Closed loops for the compiled loop, by the names in problem.h."""

    values: dict[str, Any]
    #: Entries of the reduced tangent.
    entries: dict[str, np.ndarray]


class Reduction(Protocol):
    """Unknowns of a scene, and the reduction of vectors and matrices to them."""

    #: Number of unknowns, of driven columns (prescribed, motors), and of all with the fixed ones.
    free: int
    driven: int
    columns: int
    #: Unknowns (2, m) of auxiliary unknowns in it, and those on which they depend.
    dependent: np.ndarray
    #: Why no step can begin here; empty if it can.
    singularity: str
    #: Number of forces that close loops, which are unknowns of the compiled loop behind the others.
    forces: int

    @property
    def factored(self) -> tuple[np.ndarray, np.ndarray]:
        """Sparsity (indptr, indices) of the linear system in compressed rows.

        Of the unknowns, and of what is behind them; nodes that slide on beams border it.
        """

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all, but for those that close loops."""

    def moves_alone(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) equals one of some degrees of freedom (size,).

        So far as it is known.
        """

    def begin(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step: displacements and rotations, and slides."""

    def choose(self, y: np.ndarray, driven: np.ndarray) -> None:
        """Choose the unknowns that close loops by the configuration after increments."""

    def expand(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Increment of all degrees of freedom from increments of unknowns and driven columns: g.

        Unknowns that close loops are corrected in y.
        """

    def completion(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) that gives all rates from those of independent columns."""

    def completed(self, z: np.ndarray) -> np.ndarray:
        """All rates from those of independent columns: completion() z."""

    def spread(self, z: np.ndarray) -> np.ndarray:
        """Small change of all degrees of freedom from a small change of all columns: T z."""

    def coupling(self) -> scipy.sparse.csr_matrix:
        """The matrix T (size, columns) of `spread`."""

    def project(self, r: np.ndarray) -> np.ndarray:
        """Generalised forces of all columns: Tv^T r, with springs and dampers."""

    def fault(self, arcs: Sequence[tuple[float, float]] = ()) -> tuple[str, str] | None:
        """Kind and reason of a step in which a node leaves the beam on which it slides; or None."""

    def axes(self) -> list[tuple[int, np.ndarray]]:
        """Of each node that slides on a beam its joint, and the axis (2,) there in the step."""

    def bordering_rows(self) -> np.ndarray | None:
        """Gv and G (2, closures, unknowns) of loops that border the linear system; or None."""

    def loop_tables(self) -> LoopTables | None:
        """The closed loops as lists of numbers, for the compiled loop; None without any."""

    def tables(self) -> Tables:
        """The coupling as lists of numbers, for the compiled loop."""

    def joint_tables(self) -> dict:
        """`Tables.joints`."""

    def reduced(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """What a matrix A of any sparsity adds to the one of `fill`: Tv^T A T."""

    def system(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the linear system for all columns and auxiliaries; -1 for none."""


class WithoutLoops:
    """A reduction in which no joint closes a loop."""

    free: int
    columns: int
    dependent = np.empty((2, 0), int)
    singularity = ""
    forces = 0

    @functools.cached_property
    def independent(self) -> np.ndarray:
        """All unknowns."""
        return np.arange(self.free)

    def choose(self, y: np.ndarray, driven: np.ndarray) -> None:
        """None closes a loop."""

    def completion(self) -> scipy.sparse.csr_matrix:
        """The identity."""
        return scipy.sparse.identity(self.columns, format="csr")

    def completed(self, z: np.ndarray) -> np.ndarray:
        """The rates as they are."""
        return z

    def bordering_rows(self) -> np.ndarray | None:
        """None."""
        return None

    def loop_tables(self) -> LoopTables | None:
        """No loops."""
        return None


class IndexReduction(WithoutLoops):
    """Supports and joints that only make degrees of freedom equal: a numbering.

    `column` (size,) is the column of each degree of freedom; `matrix` has the full sparsity.
    """

    def __init__(self, column: np.ndarray, free: int, driven: int, columns: int, matrix):
        self._column = column
        self.free, self.driven, self.columns = free, driven, columns
        self._z = np.zeros(columns)
        self._full = matrix.indptr, matrix.indices
        self._dofs = _sums_of_dofs(column)

    @property
    def factored(self):
        """Sparsity of the reduced matrix."""
        return self._reduced[0]

    @functools.cached_property
    def _reduced(self) -> tuple[tuple[np.ndarray, np.ndarray], _Sums]:
        """Sparsity of the reduced matrix, and the sums; not made where others have the tangent."""
        return _sums_of_entries(self._column, *self._full, self.free)

    @functools.cached_property
    def diagonal(self) -> np.ndarray:
        """Indices of the diagonal in the values of the reduced matrix."""
        indptr, indices = self.factored
        return np.flatnonzero(np.repeat(np.arange(self.free), np.diff(indptr)) == indices)

    def begin(self, q, slides) -> None:
        """Nothing depends on the step."""

    def moves_alone(self, dofs):
        """Every unknown equals its degrees of freedom."""
        return np.bincount(self._column[dofs], minlength=self.columns)[: self.free] > 0

    def expand(self, y, driven):
        """Increment of all degrees of freedom."""
        z = self._z
        z[: self.free] = y
        z[self.free : self.free + self.driven] = driven
        return z[self._column]

    def spread(self, z):
        """Small change of all degrees of freedom."""
        return z[self._column]

    def coupling(self):
        """Matrix with a 1 in each row."""
        size = len(self._column)
        entries = np.ones(size), self._column, np.arange(size + 1)
        return scipy.sparse.csr_matrix(entries, (size, self.columns))

    def project(self, r):
        """Sums over equal degrees of freedom."""
        out = np.empty(self.columns)
        self._dofs.of(r, out)
        return out

    def fault(self, arcs=()):
        """None: no node slides on a beam."""
        return None

    def axes(self):
        """None."""
        return []

    def system(self):
        """Rows and columns of the unknowns; -1 for other columns."""
        numbers = np.where(np.arange(self.columns) < self.free, np.arange(self.columns), -1)
        return numbers, numbers

    def reduced(self, matrix):
        """Sums over equal degrees of freedom."""
        T = self.coupling()[:, : self.free]
        return (T.T @ matrix @ T).tocsr()

    def fill(self, values, r, out) -> None:
        """Sums over equal degrees of freedom."""
        self._reduced[1].of(values, out)

    def joint_tables(self):
        """None depends on the motion."""
        none, pairs = np.empty(0, int), np.empty((0, 2))
        return {
            "offset": pairs,
            "axis": pairs,
            "sign": pairs,
            "carrier": none,
            "slide_column": none,
            "number": none,
            "track": none,
        }

    def tables(self):
        """Columns, and sums of entries."""
        none = np.empty(0, int)
        size = len(self._column)
        to, source = self._reduced[1].pairs()
        return Tables(
            entries={
                "row": np.arange(size),
                "column": self._column,
                "value": np.zeros(size, int),
                "sign": np.ones(size),
            },
            joints=self.joint_tables(),
            followers={"dof": none, "through": none},
            direct={"to": to, "source": source},
            coupled={"to": none, "source": none, "virtual": none, "value": none, "sign": none},
            geometric={"to": none, "joint": none, "kind": none, "sign": none},
            restoring={"to": none, "of": none},
            auxiliaries=None,
        )


class _Sums:
    """Sums of vector entries with the same target: one indexed copy, and a few additional terms."""

    def __init__(self, target: np.ndarray, source: np.ndarray | None = None):
        source = np.arange(len(target)) if source is None else source
        _, first = np.unique(target, return_index=True)
        self._first = source[first]
        self._more: list[tuple[np.ndarray, np.ndarray]] = []
        left = np.setdiff1d(np.arange(len(target)), first)
        while len(left):  # once for each additional node on a pin
            _, i = np.unique(target[left], return_index=True)
            self._more.append((target[left[i]], source[left[i]]))
            left = np.delete(left, i)

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Targets and sources of all entries."""
        first = np.arange(len(self._first)), self._first
        targets, sources = zip(first, *self._more, strict=True)
        return np.concatenate(targets), np.concatenate(sources)

    def of(self, values: np.ndarray, out: np.ndarray) -> None:
        """Write the sums to `out`."""
        np.take(values, self._first, out=out, mode="clip")  # others would take a buffer
        for target, source in self._more:
            out[target] += values[source]


@cached_by_content
def _sums_of_dofs(column: np.ndarray) -> _Sums:
    """Sums over equal degrees of freedom."""
    return _Sums(column)


@cached_by_content
def _sums_of_entries(
    column: np.ndarray, indptr: np.ndarray, indices: np.ndarray, free: int
) -> tuple[tuple[np.ndarray, np.ndarray], _Sums]:
    """Pattern of the reduced tangent, and the sums over its entries."""
    row, col = np.repeat(column, np.diff(indptr)), column[indices]
    inside = np.flatnonzero((row < free) & (col < free))
    pattern, position = sparsity(row[inside], col[inside], free)
    return pattern, _Sums(position, inside)


@cached_by_content
def sparsity(rows: np.ndarray, columns: np.ndarray, n: int):
    """Compressed rows of the given pairs, and the position of each pair in them."""
    keys, position = np.unique(rows * n + columns, return_inverse=True)
    counts = np.bincount(keys // n, minlength=n)
    indptr = np.concatenate(([0], np.cumsum(counts)))
    return (indptr.astype(np.int32), (keys % n).astype(np.int32)), position
