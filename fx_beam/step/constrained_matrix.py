"""Matrices of the unknowns, sparse with what long trees and loops add, and their modes."""

from __future__ import annotations

import bisect
import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu

from fx_beam.content_cache import cached_property
from fx_beam.coupling.dependent_columns import nested_solution
from fx_beam.coupling.reduction import Reduction
from fx_beam.errors import SceneError

from .sparse_lu import LU, NONE, Pattern, pivoted_lu

if TYPE_CHECKING:
    from .model import Model


# -- The linear system without what slides on beams, which borders it (c/bordering_rows.h) ------


def without_border(
    A: scipy.sparse.csr_matrix, entries: scipy.sparse.coo_matrix, border: dict[str, Any]
) -> scipy.sparse.csr_matrix:
    """The system (n, n) of A (n, n) and the `entries` (n + m, n + m) of what borders it.

    Columns of sliding nodes, and forces on them, are eliminated: the pivots of the `border` (tables
    of tables.h) are 1 or -1, and what is left couples slides with the nodes near to them.
    """
    n, size = A.shape[0], entries.shape[0]
    A = scipy.sparse.csr_matrix(A)
    A.resize((size, size))
    # What borders A though it is no column of a node comes to its place among the unknowns.
    place, last_places = np.arange(size), n + border["bordered_row"]
    place[border["bordered_unknown"]], place[last_places] = last_places, border["bordered_unknown"]
    system = (A + entries).tocsr()[place][:, place]
    equations = system[n + border["pivot"]]
    pivots = equations[:, n:].diagonal()
    equations = scipy.sparse.diags(1 / pivots) @ equations
    # A node depends on those that carry its beam, a force on columns.
    nested = scipy.sparse.identity(size - n) - equations[:, n:]
    solution = nested_solution(nested.tocsr(), equations[:, :n])
    return (system[:n, :n] - system[:n, n:] @ solution).tocsr()


# -- Rounding errors of a stiffness matrix in soft directions, as in the bending of thin beams --


_log = logging.getLogger("fx_beam")

# A warning tells of rounding errors whose bound is above this part of x^T K x. In bending of thin
# beams the errors are about a tenth of the bound.
_FEW_DIGITS = 0.05


def warn_of_rounding(
    K: scipy.sparse.csr_matrix, vectors: np.ndarray, what: str, lost: bool = False
) -> None:
    """Warn if K has few digits in the directions of vectors x (n, m), or if they are `lost`."""
    size = abs(vectors)
    errors = np.finfo(float).eps * np.sum(size * (abs(K) @ size), axis=0)
    stiffness = abs(np.sum(vectors.conj() * (K @ vectors), axis=0))
    shares = np.divide(errors, stiffness, out=np.zeros(len(errors)), where=stiffness > 0)
    share = 1.0 if lost else shares.max(initial=0.0)
    if share > _FEW_DIGITS:
        _log.warning(
            "%s few correct digits, if any: rounding errors may be %.0e of the stiffness. Beams "
            "are far stiffer in tension or shear than in bending, or have very many elements. Take "
            "fewer elements, or smaller EA and GA",
            *(what, min(share, 1.0)),
        )


# -- Matrices of the unknowns: full in long trees and loops, but sparse with what these add -----


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
    #: Number of closures of loops, each with an unknown d and a force F that acts on it.
    closures: int = 0
    #: Numbers of all unknowns before they were put in this order.
    order: np.ndarray = field(default_factory=lambda: NONE)

    @property
    def first(self) -> np.ndarray:
        """Rows of the equations of auxiliary unknowns, and columns of these."""
        return np.arange(self.free, self.size - 2 * self.closures, 2)

    @property
    def closing(self) -> np.ndarray:
        """Rows and columns of d."""
        return np.arange(self.size - 2 * self.closures, self.size - self.closures)

    @property
    def forces(self) -> np.ndarray:
        """Rows of the equations of loops, and columns of their forces F."""
        return self.closing + self.closures

    @property
    def rows(self) -> np.ndarray:
        """Rows of the balance of forces on x, u and d."""
        return np.concatenate([np.arange(self.free), self.first + 1, self.closing])

    @property
    def columns(self) -> np.ndarray:
        """Columns of x, u and d."""
        return np.concatenate([np.arange(self.free), self.first, self.closing])


# Largest number of corrections of a solution, and the relative size of one that is round-off.
_CORRECTIONS = 5
_CORRECT = 1e-12


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
        independent, closing = reduction.independent, reduction.closing
        auxiliaries, forces = np.split(np.arange(free, size), [size - free - len(closing)])
        order = np.concatenate([independent, auxiliaries, closing, forces])
        dependent = None if dependent is None else np.argsort(order)[dependent]
        places = UnknownPlaces(size, len(independent), dependent, len(closing), order)
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
        return LU(pattern, self.places.dependent, self.places.closing)

    def negative_eigenvalues(self, factors: LU) -> int:
        """Number of negative eigenvalues of a symmetric T^T A T, by its `factors`.

        By Sylvester's law of inertia. Each force F adds one to those of the system.
        """
        pivots = factors.pivots
        forces = self.places.closures
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

    def is_symmetric(self, unit: np.ndarray, sliding: bool = False) -> bool:
        """Whether A is symmetric, or T^T A T; sizes `unit` (n,) and `sliding` as for `Symmetry`."""
        return Symmetry.of(self.alone, unit, sliding) or (
            not self.is_plain and Symmetry.of(self.matrix, unit[: self.free], sliding)
        )

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
        x = self._factors.solve(sides, trans)
        if self.is_plain:
            return x
        # Rounding errors add up along a tower of loops: 1e-4 of 4000 without these corrections.
        A = self.system if trans == "N" else self.system.T
        for _ in range(_CORRECTIONS):
            correction = self._factors.solve(sides - A @ x, trans)
            x += correction
            change, size = (abs(y[: self.free]).max(axis=0) for y in (correction, x))
            if (change <= _CORRECT * size).all():
                break
        return x[: self.free]


def _solved(factors: SuperLU, sides: np.ndarray, trans: str = "N") -> np.ndarray:
    """Solution by real factors, also of complex sides."""
    if not np.iscomplexobj(sides):
        return factors.solve(sides, trans)
    return factors.solve(sides.real.copy(), trans) + 1j * factors.solve(sides.imag.copy(), trans)


# -- The pencil K - x M of a stiffness and a mass: eigenvalues are counted, vectors found -------


# Largest error of a vector in its iteration.
_EXACT = 1e-12
# Share of a vector that is left of it where a basis is complete: more than its rounding errors.
_ROUNDING = 1e-10
# An eigenvalue far above the largest, which is of order 1.
_FAR = 1e6
# Number of vectors after which the errors of eigenvectors are looked at again; with more unknowns
# than the second number after each, as a vector takes longer than the look.
_MORE, _LARGE = 10, 30_000
# Number of vectors, besides four for each mode, after which a nearer shift is taken, and its least
# distance from the lowest eigenvalue, relative to it.
_PATIENCE, _NEAR = 80, 1e-9


class Pencil:
    """K - x M of `ConstrainedMatrix` matrices: its factors have one sparsity, whatever x.

    Stiffnesses and eigenvalues are of order 1. Other unknowns of the system have vectors as well;
    `massive` are those with mass.
    """

    def __init__(self, K: ConstrainedMatrix, M: ConstrainedMatrix, massive: np.ndarray):
        #: Both matrices of the unknowns (size, size).
        self.K, self.M = K.alone, M.alone
        self._free, self._massive = K.free, massive
        # Orthonormal motions (size, few) that have no mass.
        self._massless = np.empty((len(massive), 0))
        # Also entries that are zero belong to it: whole nodes are factorised faster.
        counted = (A.with_data(np.arange(1, A.system.nnz + 1)).system for A in (K, M))
        (k, m), count = counted, K.system.nnz + 1
        numbered = k + count * m
        numbered.sort_indices()
        of_M, of_K = np.divmod(numbered.data, count)
        self._values = [np.append(0.0, A.system.data)[i] for A, i in ((K, of_K), (M, of_M))]
        self._rows, self._columns = K.places.rows, K.places.columns
        self._extended, self._lu = K, K.factors((numbered.indptr, numbered.indices))
        # The x of the last factors, and whether no pivot is zero.
        self._last = np.nan, False

    def _factorise(self, x: float) -> bool:
        if self._last[0] != x:
            K, M = self._values
            self._last = x, self._lu.factorise(K - x * M)
        return self._last[1]

    def below(self, x: float) -> int:
        """Number of eigenvalues below x: negative pivots of K - x M, by Sylvester's law of inertia.

        -1 if a pivot is zero: x is an eigenvalue.
        """
        return self._extended.negative_eigenvalues(self._lu) if self._factorise(x) else -1

    def set_finite(self, finite: int) -> None:
        """Find motions without mass of unknowns that have mass, such as turns in a sleeve.

        The number of eigenvalues that are `finite` tells how many there are.
        """
        massive = int(self._massive[: self._free].sum())
        size = max(0, massive - finite), len(self._massive)
        if size[0] and not self._factorise(-_FAR):
            raise _failure()
        x = np.random.default_rng(0).standard_normal(size)
        for _ in range(2):  # each makes other motions smaller by 1 / _FAR
            x = np.array([self._solved(self.K @ vector) for vector in x]).reshape(size)
        self._massless = np.linalg.qr((self._massive * x).T)[0]

    def nearest(
        self, n: int, shift: float, deflated: np.ndarray, most: float = np.inf
    ) -> np.ndarray:
        """Eigenvectors (size, n or fewer) nearest to a shift, except the deflated ones.

        By Lanczos' method for the inverse of K - shift M, in the inner product of M, with vectors
        that are all made orthogonal to one another. No vectors if it takes more than `most`.
        """
        if not self._factorise(shift):
            raise _failure()
        size, first = deflated.shape
        more = _MORE if size <= _LARGE else 1
        basis = np.concatenate([self._bounded(deflated).T, np.empty((2 * n + 20, size))])
        # Other starts each time: those before have no part in a copy that was missed.
        starts = np.random.default_rng(first)
        diagonal, off_diagonal, m = list[float](), list[float](), first
        x, new = self._inverse(starts.standard_normal(size)), True
        whole = self._length(x)
        while True:
            x, force, left = self._orthogonal(x, basis[:m])
            if not np.isfinite(left) or m > size:
                raise _failure()
            complete = left <= _ROUNDING * whole
            if complete or not (new or (m - first) % more):
                # Eigenvalues and vectors of a tridiagonal matrix, from its lower half.
                values, parts = np.linalg.eigh(np.diag(diagonal) + np.diag(off_diagonal[1:], -1))
                lowest = np.argsort(-abs(values))[:n]
                errors = left * abs(parts[-1:, lowest])
                if new or (len(lowest) == n and (errors <= _EXACT * abs(values[lowest])).all()):
                    break
                if complete:  # the other copies are found from another start
                    x, new = self._inverse(starts.standard_normal(size)), True
                    whole = self._length(x)
                    continue
            if m - first >= most:
                return np.empty((size, 0))
            if m == len(basis):
                basis = np.concatenate([basis, np.empty((n + 20, size))])
            off_diagonal.append(0.0 if new else left)
            basis[m], force = x / left, force / left
            # Without its parts along the last two vectors one projection is mostly enough.
            x = self._solved(force)
            diagonal.append(float(x @ force))
            x -= diagonal[-1] * basis[m]
            if not new:
                x -= left * basis[m - 1]
            whole, new = np.hypot(diagonal[-1], off_diagonal[-1]), False
            m += 1
        if not len(lowest):
            raise _failure()
        vectors = parts[:, lowest].T @ basis[first:m]
        return np.column_stack([self._inverse(vector) for vector in vectors])

    def _orthogonal(self, x: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """The part of x that is orthogonal to vectors (m, size), M times it, and its length.

        Once more while less than half is left, with rounding errors of what was longer.
        """
        before, force = np.inf, self.M @ x
        left = float(np.sqrt(abs(x @ force)))
        while left < 0.5 * before:
            x = self._bounded(x - (basis @ force) @ basis)
            force = self.M @ x
            before, left = left, float(np.sqrt(abs(x @ force)))
        return x, force, left

    def _bounded(self, x: np.ndarray) -> np.ndarray:
        """Vectors without motions that have no mass, which rounding errors would let grow."""
        x = (self._massive * x.T).T
        return x - self._massless @ (self._massless.T @ x) if self._massless.size else x

    def _inverse(self, x: np.ndarray) -> np.ndarray:
        return self._solved(self.M @ x)

    def _solved(self, forces: np.ndarray) -> np.ndarray:
        sides = np.zeros(len(self._rows) * 2 - self._free)
        sides[self._rows] = forces
        return self._lu.solve(sides)[self._columns]

    def _length(self, x: np.ndarray) -> float:
        return float(np.sqrt(abs(x @ (self.M @ x))))

    def ritz_vectors(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rayleigh quotients in the span of vectors, their rounding errors, vectors of mass 1."""
        K, M = self.K @ vectors, self.M @ vectors
        combined = scipy.linalg.eigh(vectors.T @ K, vectors.T @ M)[1]
        vectors, K, M = vectors @ combined, K @ combined, M @ combined
        masses = np.einsum("ij,ij->j", vectors, M)
        values = np.einsum("ij,ij->j", vectors, K) / masses
        vectors /= np.sqrt(masses)
        sizes = np.einsum("ij,ij->j", abs(vectors), abs(self.K) @ abs(vectors))
        # Of the sum, and of the vectors: the latter counts where nothing else has stiffness.
        eps = np.finfo(float).eps
        return values, 2 * eps * sizes + (10 * eps) ** 2 * (vectors**2).sum(axis=0), vectors


def _failure() -> RuntimeError:
    return RuntimeError(
        "modes: no mode was found. Try fewer modes, and check the units of stiffnesses and masses: "
        "very different magnitudes are lost in rounding errors"
    )


# -- Modes of K x = omega^2 M x -----------------------------------------------------------------


# Smaller stiffnesses have few digits, which processors lose; they are none.
_TINY = 1e-290
# Largest difference of two entries across the diagonal, relative to the largest ones of their rows.
_ACROSS = 1e-12


class Symmetry:
    """Whether sparse matrices of one pattern are symmetric, by sizes of unit unknowns (n,)."""

    def __init__(self, pattern: Pattern, unit: np.ndarray, sliding: bool):
        indptr, columns = pattern
        n = len(indptr) - 1
        rows = np.repeat(np.arange(n), np.diff(indptr))
        numbers = np.arange(1, len(columns) + 1)
        numbered = scipy.sparse.csr_matrix((numbers, columns, indptr), (n, n))
        # The entry across the diagonal from each: -1 where the pattern has none.
        across = numbered[columns, rows] if len(columns) else columns  # of none SciPy has a matrix
        self._mirrored = np.asarray(across).ravel() - 1
        self._rows, self._columns, self._starts = rows, columns, indptr[:-1]
        self._units = unit[rows] * unit[columns]
        # With nodes that slide on beams entries are differences of others that may be far larger.
        self._sliding = sliding

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_matrix, unit: np.ndarray, sliding: bool) -> bool:
        """Whether one matrix is symmetric."""
        return cls((matrix.indptr, matrix.indices), unit, sliding).holds(matrix.data)

    def holds(self, values: np.ndarray) -> bool:
        """Whether the matrix with these values is symmetric up to rounding errors."""
        gaps = abs(values - np.append(values, 0.0)[self._mirrored])
        if not gaps.any():
            return True
        sizes, gaps = abs(values * self._units), gaps * self._units
        largest = np.sqrt(np.maximum.reduceat(np.append(sizes, 0.0), self._starts))
        if self._sliding:
            largest[:] = largest.max()
        return bool((gaps <= _ACROSS * largest[self._rows] * largest[self._columns]).all())


class UndampedModes:
    """Modes of stiffness K and mass M.

    Factors of K - x M have one sparsity, whatever x: they count eigenvalues and give vectors. Other
    unknowns of the system have vectors as well; `massive` are the unknowns (free,) with mass.
    """

    def __init__(
        self, K: ConstrainedMatrix, M: ConstrainedMatrix, massive: np.ndarray | None = None
    ):
        K = K.with_data(K.system.data * (abs(K.system.data) > _TINY))
        k, m, free = abs(K.alone.diagonal()), M.alone.diagonal(), K.free
        self._free, heavy = free, m > 0
        massive = heavy if massive is None else np.append(massive, m[free:] >= 0)
        ratios = k[heavy] / m[heavy]
        # Scaled so that stiffnesses are of order 1 and eigenvalues below 1.
        self._unit = unit = ratios.max() or 1.0
        sizes = k + unit * m
        sizes[free:][sizes[free:] == 0] = sizes.max()  # what nothing but others follows
        self._scale = sizes**-0.5
        K, M = K.scaled(self._scale), M.scaled(self._scale)
        self._pencil = Pencil(K, M.with_data(unit * M.system.data), massive)
        # Smaller eigenvalues are rounding errors, even in the softest direction.
        soft = ratios.min(where=ratios > 1e-20 * unit, initial=unit)
        self._least = 1e4 * np.finfo(float).eps * (soft / unit)

    def lowest(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lowest angular frequencies (n,), which are rigid (n,), and vectors (free, n).

        Frequencies are zero for rigid modes and negative for unstable ones. Modal masses are 1.
        """
        values, rounding, vectors = self._in_slices(n)
        vectors = np.sqrt(self._unit) * (self._scale[:, None] * vectors)[: self._free]
        values, rigid = self._unit * values, abs(values) <= rounding
        return np.where(rigid, 0.0, np.sign(values) * np.sqrt(abs(values))), rigid, vectors

    def count_below(self, square: float) -> int:
        """Number of modes with omega^2 below a value; -1 if the value is an omega^2."""
        return self._pencil.below(square / self._unit)

    def _in_slices(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lowest eigenvalues, their rounding errors, and vectors, by slices of four decades."""
        # Each slice has its own shift, since eigenvalues far below a shift are lost to rounding
        # errors. Sylvester's law counts what is missing. A Krylov space may lack copies of multiple
        # eigenvalues; they are found after deflation of the others.
        pencil = self._pencil
        count = functools.cache(pencil.below)
        sizes = 10.0 ** np.arange(np.log10(self._least), 4, 0.25)  # candidates for their bounds
        levels = _levels(count, sizes)

        finite = count(levels[-1])  # the others are infinite, for motions without mass
        n = min(n, finite)
        pencil.set_finite(finite)
        least = levels[levels > 0][0]
        if count(least) == 0:
            all_of_them = self._at_once(n, levels[levels > 0], count)
            if all_of_them is not None:
                return all_of_them
        last = levels[bisect.bisect_left(levels, n, key=count)]
        values, rounding, vectors = np.empty(0), np.empty(0), np.empty((len(self._scale), 0))

        def missing(x):
            """Number of eigenvalues below x, and not beside it, that are not found yet."""
            return count(x) - (values - rounding <= x + 1e-8 * abs(x)).sum()

        while missing(last) > 0:
            noise = rounding.max(initial=least)
            highest = np.sort(values)[n - 1 : n]  # none while there are fewer
            if any(missing(x - 2e-8 * abs(x) - 2 * noise) <= 0 for x in highest):
                break  # only its copies are missing, and those above
            bottom = levels[bisect.bisect_left(levels, 1, key=missing)]
            top = min(last, max(1e4 * bottom, 1e-4 * bottom, noise))
            shift = -max(top, -10 * bottom, 10 * noise)  # below the slice, not an eigenvalue
            new = pencil.nearest(min(max(missing(top), 1), 2 * n), shift, vectors)
            new -= vectors @ (vectors.T @ (pencil.M @ new))  # orthogonal to the slices below
            squares, errors, new = pencil.ritz_vectors(new)
            # Vectors above the slice took the place of copies that are not found yet.
            is_here = squares <= max(top + 1e-8 * abs(top), squares[0])
            values = np.append(values, squares[is_here])
            rounding = np.append(rounding, errors[is_here])
            vectors = np.column_stack([vectors, new[:, is_here]])
        order = np.argsort(values)[:n]
        return values[order], rounding[order], vectors[:, order]

    def _at_once(self, n: int, levels: np.ndarray, count: Callable[[float], int]):
        """Results of `_in_slices` if all eigenvalues lie within four decades; otherwise None.

        No eigenvalue lies below the first of the positive `levels`.
        """
        none = np.empty((len(self._scale), 0))
        new = self._pencil.nearest(n, -levels[0], none, _PATIENCE + 4 * n)
        if not new.size:  # many are near to each other, compared with their distance from zero
            k = bisect.bisect_left(levels, 1, key=count)
            low, high = levels[k - 1], levels[k]
            while high - low > _NEAR * high and count(high) > 2 * n:
                middle = (low + high) / 2
                low, high = (middle, high) if count(middle) == 0 else (low, middle)
            new = self._pencil.nearest(n, low, none)
        squares, errors, new = self._pencil.ritz_vectors(new)
        if len(squares) < n or (squares <= errors).any() or squares[-1] > 1e4 * squares[0]:
            return None
        bound = (1 - 1e-8) * squares[-1]  # the last one may have copies
        complete = self._pencil.below(bound) == (squares < bound).sum()
        return (squares, errors, new) if complete else None


def _levels(count: Callable[[float], int], sizes: np.ndarray) -> np.ndarray:
    """Slice bounds of both signs and these sizes, above the rounding error."""
    if count(sizes[-1]) < 1:
        raise SceneError("modes: a part moves freely and has no mass. Give it mass or a support")
    # The rounding error of a rigid mode of a stiff part may be large compared with a soft part.
    least = next((k for k, x in enumerate(sizes) if min(count(x), count(-x)) >= 0), -1)
    if count(-sizes[least]) != 0 and count(-sizes[-1]) != 0:
        raise SceneError(
            "modes: the state is unstable in a motion without mass, so its growth rate is infinite."
            " Give this part mass, or use a state with less load"
        )
    return np.concatenate([-sizes[least:][::-1], sizes[least:]])
