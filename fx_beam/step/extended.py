"""Matrices of the unknowns: full in long trees of joints, but sparse with auxiliary unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu

from fx_beam.content_cache import cached_property
from fx_beam.coupling.reduction import Reduction

from .sparse_lu import pivoted_lu

if TYPE_CHECKING:
    from .model import Model


def schur_complement(A: scipy.sparse.csr_matrix, chosen: np.ndarray) -> scipy.sparse.csr_matrix:
    """A system reduced to `chosen` unknowns; not finite if it is singular."""
    rest = np.setdiff1d(np.arange(A.shape[0]), chosen)
    if not len(rest):
        return A
    rows, columns = A[chosen], A[:, chosen]
    try:
        eliminated = splu(A[rest][:, rest].tocsc()).solve(columns[rest].toarray())
    except RuntimeError:  # it is singular
        eliminated = np.full((len(rest), len(chosen)), np.nan)
    reduced = rows[:, chosen] - rows[:, rest] @ scipy.sparse.csr_matrix(eliminated)
    return reduced.tocsc().tocsr()  # whose columns are in order


@dataclass(frozen=True, eq=False)
class Extended:
    """T^T A T (free, free), by a sparse `system` in which auxiliary unknowns u are as well.

    It is that of `Couplings.system`: S (x, u, h) = (b, 0, 0) gives T^T A T x = b.
    """

    system: Any
    free: int
    #: `Reduction.dependent`; None without auxiliary unknowns.
    dependent: np.ndarray | None = None

    @classmethod
    def of(cls, system: scipy.sparse.csr_matrix, reduction: Reduction) -> Extended:
        """That of a linear system; with loops or nodes on beams the full matrix."""
        if reduction.loops is None and not reduction.couplings.sliding:
            return cls(system, reduction.free, reduction.dependent)
        unknowns = reduction.independent
        return cls(schur_complement(system, unknowns), len(unknowns))

    def weighted(self, weight: scipy.sparse.csr_matrix, reduction: Reduction) -> Extended:
        """T^T W T of the same kind."""
        if self.dependent is not None:
            equations = self.system - self.only(np.ones(len(self.rows))).system
            return replace(self, system=(equations + reduction.reduced(weight)).tocsr())
        T = reduction.coupling()[:, reduction.independent]
        return replace(self, system=(T.T @ weight @ T).tocsr())

    def units(self, model: Model) -> np.ndarray:
        """Sizes (n,) of unit unknowns x and u."""
        unit = model.unit_of_unknowns[model.reduction.independent]
        if self.dependent is None:
            return unit
        return np.append(unit, model.unit[[other.dof for other in model.couplings.auxiliaries]])

    @property
    def _first(self) -> np.ndarray:
        """Rows of the equations of auxiliary unknowns, and columns of these."""
        return np.arange(self.free, self.system.shape[0], 2)

    @property
    def rows(self) -> np.ndarray:
        """Rows of the balance of forces on x and on u."""
        return np.append(np.arange(self.free), self._first + 1)

    @property
    def columns(self) -> np.ndarray:
        """Columns of x and u."""
        return np.append(np.arange(self.free), self._first)

    @property
    def alone(self) -> scipy.sparse.csr_matrix:
        """A of x and u, without the equations between them."""
        if self.dependent is None:
            return self.system
        return self.system[self.rows][:, self.columns]

    def with_data(self, data: np.ndarray) -> Extended:
        """The same with other entries; SciPy may sort them."""
        parts = data, self.system.indices, self.system.indptr
        matrix = scipy.sparse.csr_matrix(parts, self.system.shape, copy=True)
        return replace(self, system=matrix)

    def only(self, selected: np.ndarray) -> Extended:
        """A of some of x and u (n,), without equations."""
        row, column = np.zeros((2, self.system.shape[0]))
        row[self.rows] = column[self.columns] = selected
        parts = scipy.sparse.diags(row) @ self.system @ scipy.sparse.diags(column)
        return replace(self, system=parts.tocsr())

    def scaled(self, scale: np.ndarray) -> Extended:
        """The same for x and u of other units; zeros stay."""
        row, column = np.ones((2, self.system.shape[0]))
        row[self.rows] = column[self.columns] = scale
        row[self._first] = column[self._first + 1] = 1 / scale[self.free :]
        rows = np.repeat(np.arange(len(row)), np.diff(self.system.indptr))
        return self.with_data(self.system.data * row[rows] * column[self.system.indices])

    @property
    def symmetric(self) -> Extended:
        """The symmetric part of A, with the equations between x and u."""
        across = np.arange(self.system.shape[0])
        across[self._first], across[self._first + 1] = self._first + 1, self._first
        matrix, other = self.system, self.system.T.tocsr()[across][:, across]
        for part in (matrix, other):
            part.sort_indices()
        if all(map(np.array_equal, *((A.indptr, A.indices) for A in (matrix, other)))):
            return self.with_data((matrix.data + other.data) / 2)  # entries that are zero stay
        return replace(self, system=((matrix + other) / 2).tocsr())

    @property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """T^T A T itself."""
        return schur_complement(self.system, np.arange(self.free))

    def __add__(self, other: Extended) -> Extended:
        return replace(self, system=(self.system + other.system).tocsr())

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        """T^T A T x (free, n)."""
        S, free = self.system, self.free
        if self.dependent is None:
            return S @ x
        followed = splu(S[free:, free:].tocsc()).solve(S[free:, :free] @ x)
        return S[:free, :free] @ x - S[:free, free:] @ followed

    @cached_property
    def _factors(self) -> SuperLU:
        return pivoted_lu(self.system) if self.dependent is None else splu(self.system.tocsc())

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """x (free, ...) for forces (free, ...); RuntimeError if it is singular."""
        zeros = np.zeros((self.system.shape[0] - self.free, *forces.shape[1:]))
        return self._factors.solve(np.concatenate([forces, zeros]))[: self.free]
