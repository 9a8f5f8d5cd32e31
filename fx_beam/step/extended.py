"""Matrices of the unknowns: full in long trees and loops, but sparse with what these add."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu

from fx_beam.content_cache import cached_property
from fx_beam.coupling.reduction import Reduction

from .lu_layout import NONE
from .sparse_lu import LU, Pattern, pivoted_lu

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
class UnknownPlaces:
    """Where unknowns x, auxiliary ones u with forces h, and those that close loops d with F are.

    They are in this order; an auxiliary unknown and its force are beside each other.
    """

    size: int
    free: int
    #: `Reduction.dependent`; None without auxiliary unknowns.
    dependent: np.ndarray | None = None
    #: Unknowns (closures,) on which the forces F act; and numbers of all, and of d, before.
    acts_on: np.ndarray = field(default_factory=lambda: NONE)
    order: np.ndarray = field(default_factory=lambda: NONE)

    @property
    def first(self) -> np.ndarray:
        """Rows of the equations of auxiliary unknowns, and columns of these."""
        return np.arange(self.free, self.size - 2 * len(self.acts_on), 2)

    @property
    def closing(self) -> np.ndarray:
        """Rows and columns of d."""
        return np.arange(self.size)[-2 * len(self.acts_on) : -len(self.acts_on) or 0]

    @property
    def forces(self) -> np.ndarray:
        """Rows of the equations of loops, and columns of their forces F."""
        return self.closing + len(self.acts_on)

    @property
    def rows(self) -> np.ndarray:
        """Rows of the balance of forces on x, u and d."""
        return np.concatenate([np.arange(self.free), self.first + 1, self.closing])

    @property
    def columns(self) -> np.ndarray:
        """Columns of x, u and d."""
        return np.concatenate([np.arange(self.free), self.first, self.closing])


@dataclass(frozen=True, eq=False)
class ConstrainedMatrix:
    """T^T A T (free, free), by a sparse `system` in which other unknowns are as well.

    S (x, u, h, d, F) = (b, 0, 0, 0, 0) gives T^T A T x = b.
    """

    system: scipy.sparse.csr_matrix
    places: UnknownPlaces

    @classmethod
    def plain(cls, matrix: scipy.sparse.csr_matrix) -> ConstrainedMatrix:
        """A matrix in which no other unknowns are."""
        return cls(matrix, UnknownPlaces(matrix.shape[0], matrix.shape[0]))

    @classmethod
    def of(cls, system: scipy.sparse.csr_matrix, reduction: Reduction) -> ConstrainedMatrix:
        """Extended matrix of a linear system."""
        dependent, free, size = reduction.auxiliaries.dependent, reduction.free, system.shape[0]
        if reduction.loops is None:
            return cls(system, UnknownPlaces(size, free, dependent))
        forces = np.arange(size)[-len(reduction.forces) :]
        auxiliaries = np.arange(free, forces[0])
        order = np.concatenate([reduction.independent, auxiliaries, reduction.following, forces])
        place = np.argsort(order)
        acts_on = np.where(reduction.forces < 0, -1, place[reduction.forces])
        dependent = None if dependent is None else place[dependent]
        places = UnknownPlaces(size, len(reduction.independent), dependent, acts_on, order)
        return cls(system[order][:, order], places)

    @property
    def free(self) -> int:
        """Number of unknowns x."""
        return self.places.free

    @property
    def is_plain(self) -> bool:
        """Whether no other unknowns are in the system."""
        return self.free == self.system.shape[0]

    def weighted(self, weight: scipy.sparse.csr_matrix, reduction: Reduction) -> ConstrainedMatrix:
        """T^T W T of the same kind."""
        if not self.is_plain:
            equations, weights = self.system, reduction.maps.reduced(weight)
            equations = equations - self.without_equations.system
            if len(order := self.places.order):
                weights = weights[order][:, order]
            return replace(self, system=(equations + weights).tocsr())
        T = reduction.maps.coupling()[:, reduction.independent]
        return replace(self, system=(T.T @ weight @ T).tocsr())

    def units(self, model: Model) -> np.ndarray:
        """Sizes (n,) of unit unknowns x, u and d."""
        unit, independent = model.units.unknowns, model.reduction.independent
        if self.is_plain:
            return unit[independent]
        auxiliary = model.units.nodes[[other.dof for other in model.couplings.auxiliaries]]
        closing = unit[self.places.order[self.places.closing]]
        return np.concatenate([unit[independent], auxiliary, closing])

    @property
    def alone(self) -> scipy.sparse.csr_matrix:
        """A of x, u and d, without the equations between them."""
        if self.is_plain:
            return self.system
        return self.system[self.places.rows][:, self.places.columns]

    def factors(self, pattern: Pattern) -> LU:
        """Factors of such systems, without exchange of rows."""
        return LU(pattern, self.places.dependent, self.places.acts_on)

    def negative_eigenvalues(self, factors: LU) -> int:
        """Number of negative eigenvalues of a symmetric T^T A T, by its `factors`.

        By Sylvester's law of inertia. Each force F adds one to those of the system.
        """
        pivots = factors.pivots
        forces = len(self.places.acts_on)
        first_force = len(pivots) - 2 * forces
        return int((pivots[: self.free] < 0).sum() + (pivots[first_force:] < 0).sum() - forces)

    def with_data(self, data: np.ndarray) -> ConstrainedMatrix:
        """Matrix with other entries, which SciPy may sort."""
        parts = data, self.system.indices, self.system.indptr
        matrix = scipy.sparse.csr_matrix(parts, self.system.shape, copy=True)
        return replace(self, system=matrix)

    def only(self, selected: np.ndarray) -> ConstrainedMatrix:
        """A of some of x, u and d (n,), without equations."""
        row, column = np.zeros((2, self.system.shape[0]))
        row[self.places.rows] = column[self.places.columns] = selected
        parts = scipy.sparse.diags(row) @ self.system @ scipy.sparse.diags(column)
        return replace(self, system=parts.tocsr())

    @property
    def without_equations(self) -> ConstrainedMatrix:
        """A of x, u and d alone."""
        return self if self.is_plain else self.only(np.ones(len(self.places.rows)))

    def scaled(self, scale: np.ndarray) -> ConstrainedMatrix:
        """Matrix for x, u and d of other units; zeros stay."""
        row, column = np.ones((2, self.system.shape[0]))
        places, first = self.places, self.places.first
        row[places.rows] = column[places.columns] = scale
        auxiliary, closing = np.split(1 / scale[self.free :], [len(first)])
        row[first] = column[first + 1] = auxiliary
        row[places.forces] = column[places.forces] = closing
        rows = np.repeat(np.arange(len(row)), np.diff(self.system.indptr))
        return self.with_data(self.system.data * row[rows] * column[self.system.indices])

    @property
    def symmetric(self) -> ConstrainedMatrix:
        """The symmetric part of A, with the equations between x, u and d."""
        mirrored, first = np.arange(self.system.shape[0]), self.places.first
        mirrored[first], mirrored[first + 1] = first + 1, first
        matrix, other = self.system, self.system.T.tocsr()[mirrored][:, mirrored]
        for part in (matrix, other):
            part.sort_indices()
        if all(map(np.array_equal, *((A.indptr, A.indices) for A in (matrix, other)))):
            return self.with_data((matrix.data + other.data) / 2)  # entries that are zero stay
        return replace(self, system=((matrix + other) / 2).tocsr())

    @property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """T^T A T itself."""
        return schur_complement(self.system, np.arange(self.free))

    def __add__(self, other: ConstrainedMatrix) -> ConstrainedMatrix:
        return replace(self, system=(self.system + other.system).tocsr())

    @cached_property
    def _equations(self) -> tuple[SuperLU, scipy.sparse.csr_matrix]:
        """Factors of the equations of u and d, and their columns of x."""
        rows = np.append(self.places.first, self.places.forces)
        equations = self.system[rows].tocsc()
        followers = np.append(self.places.first, self.places.closing)
        return splu(equations[:, followers]), equations[:, : self.free].tocsr()

    def spread(self, x: np.ndarray) -> np.ndarray:
        """Small changes (n, ...) of x, u and d, which follow x (free, ...)."""
        if self.is_plain:
            return x
        factors, equations = self._equations
        return np.concatenate([x, -_solved(factors, equations @ x)])

    def collected(self, forces: np.ndarray) -> np.ndarray:
        """Forces (free, ...) on x of those (n, ...) on x, u and d."""
        if self.is_plain:
            return forces
        factors, equations = self._equations
        passed_on = equations.T @ _solved(factors, forces[self.free :], "T")
        return forces[: self.free] - passed_on

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        """T^T A T x (free, n)."""
        return self.collected(self.alone @ self.spread(x))

    @cached_property
    def _factors(self) -> SuperLU:
        return pivoted_lu(self.system) if self.is_plain else splu(self.system.tocsc())

    def solve(self, forces: np.ndarray, trans: str = "N") -> np.ndarray:
        """x (free, ...) for forces (free, ...), or with "T" of the transposed matrix.

        RuntimeError if it is singular.
        """
        zeros = np.zeros((self.system.shape[0] - self.free, *forces.shape[1:]))
        sides = np.concatenate([forces, zeros]).astype(np.result_type(self.system.dtype, forces))
        return self._factors.solve(sides, trans)[: self.free]


def _solved(factors: SuperLU, sides: np.ndarray, trans: str = "N") -> np.ndarray:
    """Solution by real factors, also of complex sides."""
    if not np.iscomplexobj(sides):
        return factors.solve(sides, trans)
    return factors.solve(sides.real.copy(), trans) + 1j * factors.solve(sides.imag.copy(), trans)
