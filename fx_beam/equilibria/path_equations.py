"""The equations of an equilibrium path, their bordered factors, and small motions about it."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, eigs

from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import Interval
from fx_beam.results.state import ARRAYS, NUMBERS, State
from fx_beam.scene.beam import lagrange
from fx_beam.step.constrained_matrix import ConstrainedMatrix, Symmetry, UndampedModes
from fx_beam.step.equations import Residual
from fx_beam.step.sparse_lu import LU, NONE, Pattern, null_vectors, pivoted_lu
from fx_beam.step.stepper import LoadLoop, StepFailed

# -- Factors of the equations of a path, bordered by a row and by the column of the load factor -
# At a limit point the tangent K is singular. But K + b e e^T is not, where the unit vector e is
# that of the unknown that moves most along the path. With its factors
#
#     [K + b e e^T  c  -b e] [x]   [f]
#     [n^T          d    0 ] [l] = [g]
#     [e^T          0   -1 ] [w]   [0]
#
# gives the solution x, l of the bordered system, and its determinant with the opposite sign.


class BorderedLU:
    """Factors of bordered matrices of one pattern, for unknowns of sizes `unit` (free,).

    The pattern (n, n) may have rows of auxiliary unknowns and loops behind the unknowns, where
    right sides are zero; `dependent` and `forces` are as in `LU`.
    """

    def __init__(
        self,
        pattern: Pattern,
        unit: np.ndarray,
        dependent: np.ndarray | None = None,
        forces: np.ndarray = NONE,
    ):
        indptr, indices = pattern
        n, self._free, self._unit = len(indptr) - 1, len(unit), unit
        self._matrix = csr_matrix((np.zeros(len(indices)), indices, indptr), (n, n))
        rows = np.repeat(np.arange(n), np.diff(indptr))
        #: Places of the diagonal of the unknowns.
        self._diagonal = np.flatnonzero((rows == indices) & (rows < len(unit)))
        if self._free:
            self._lu = LU(pattern, dependent, forces)
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


# -- The equations of an equilibrium path, on which the load factor is one more unknown ---------
# With the residual R of the unknowns y at the load factor l, a tangent (y', l') of the path
# solves
#
#     dR/dy y' + dR/dl l' = 0,    and bordered by a row n:   n . (y', l') = 1.
#
# Bordered by the tangent itself, the determinant changes its sign at a bifurcation, but not at a
# limit point, nor at a corner: where a point begins to flow, dR/dy changes by a matrix of rank
# one along the normal of its yield surface, and this leaves the tangent's component across that
# surface.


# Change of the load factor by which derivatives are found as differences.
_APART = 1e-5


@dataclass
class Tangent:
    """Unit tangent of the path: of the unknowns, of all degrees of freedom, of the load factor."""

    y: np.ndarray
    D: np.ndarray
    load: float
    #: Sign of the determinant of the equations' derivative bordered by the tangent.
    sense: float = 1.0

    def __neg__(self) -> Tangent:
        return Tangent(-self.y, -self.D, -self.load, -self.sense)


class PathEquations:
    """The equations R(y, l) = 0 of a step in its unknowns y (free,) and the load factor l.

    The inner product of increments is that of load factors plus the mean over the nodes, in units.
    """

    def __init__(self, loop: LoadLoop):
        self.loop, self.model = loop, loop.model
        self._reduction = self.model.reduction
        #: Forces (free,) that hold the start besides its loads, and fade as those of now rise.
        self.held = np.zeros(self._reduction.free)
        #: Weights (size,) of the degrees of freedom in the inner product.
        self.weight = 1 / (self.model.units.nodes**2 * len(self.model.mesh.turns))

    @cached_property
    def bordered(self) -> BorderedLU:
        """The factors of the last tangent."""
        reduction = self._reduction
        return self._bordered(reduction.tangent.pattern, reduction.auxiliaries.dependent)

    def _bordered(
        self, pattern: Pattern, dependent: np.ndarray | None, forces: np.ndarray = NONE
    ) -> BorderedLU:
        unit = self.model.units.unknowns[self._reduction.independent]
        return BorderedLU(pattern, unit, dependent, forces)

    def set_start(self, start: State) -> None:
        """Set the state at the start of a step. No time passes for internal variables."""
        self._start = start
        self.loop.equations.set_start(Interval(start.t, start.t), start)

    def expand(self, y: np.ndarray, load: float) -> np.ndarray:
        """Increment D (size,) of all degrees of freedom by increments y and l."""
        return self._reduction.increment(y, self._driven(load))

    def _driven(self, load: float) -> np.ndarray:
        forcing = self.loop.forcing
        return forcing.positions(self._start.t + load) - forcing.current(self._start)

    def spread(self, dy: np.ndarray, dload: float) -> np.ndarray:
        """Small change dD (size,) of all degrees of freedom: T (dy, dl)."""
        reduction = self._reduction
        return reduction.maps.to_nodes(reduction.in_columns(dy, dload * self.loop.forcing.goal))

    def balance(self, y: np.ndarray, load: float) -> tuple[Residual, np.ndarray, np.ndarray]:
        """R(y, l), and the derivatives by l of forces (size,) at nodes, and (free,) of R."""
        model, forcing, reduction = self.model, self.loop.forcing, self._reduction
        if (
            model.forms.has_added
            or model.data.natural
            or (model.scene.joints and forcing.goal.any())
        ):
            # Driven motion rotates the joints, and with them the directions of their forces.
            load_slopes, column = self._differences(y, load, _APART)
            balance = self._evaluate(y, load)
        else:
            balance = self._evaluate(y, load)
            moved = self.spread(np.zeros_like(y), 1.0)
            load_slopes = self.loop.equations.change(moved) - forcing.rise
            if forcing.turning is not None:
                load_slopes -= forcing.turning.force(self._start.q + balance.D)
            column = reduction.maps.reduced_force(load_slopes)
            column -= reduction.maps.reduced_force(np.zeros_like(load_slopes))
        balance.residual[: len(y)] -= (1 - self._start.t - load) * self.held
        return balance, load_slopes, column[: reduction.free] + self.held

    def _differences(self, y: np.ndarray, load: float, apart: float) -> list[np.ndarray]:
        """Derivatives by l of forces (size,) and of the residual, from values at l +- apart."""
        numbers, ends = self.model.points.inputs.copy(), []
        for side in (apart, -apart):
            balance = self._evaluate(y.copy(), load + side)
            ends.append((balance.r.copy(), balance.residual.copy()))
        self.model.points.inputs[:] = numbers  # laws remember iterations, not what is beside them
        return [(ahead - back) / (2 * apart) for ahead, back in zip(*ends, strict=True)]

    def disturbance(self, apart: float) -> np.ndarray:
        """Derivative (free,) of R by l in the start, from values at l +- apart."""
        y = np.zeros(self._reduction.free)
        return self._differences(y, 0.0, apart)[1][: len(y)] + self.held

    def _evaluate(self, y: np.ndarray, load: float) -> Residual:
        factor = self._start.t + load
        self.loop.equations.end_at(factor)
        return self.loop.equations.evaluate(y, self._driven(load), self.loop.forcing.dead(factor))

    def solve(
        self, column: np.ndarray, normal: Tangent, residual: np.ndarray, last: float
    ) -> tuple[np.ndarray, float]:
        """Changes (dy, dl) with K dy + column dl = residual and <normal, (dy, dl)> = last.

        K is the tangent of the last balance.
        """
        reduction, free, equations = self._reduction, self._reduction.free, self.loop.equations
        independent, moved = reduction.independent, slice(free, free + reduction.driven)
        couplings = self.model.couplings
        if couplings.closures or couplings.sliding or self.model.points.members is not None:
            # Its sparsity may have changed.
            extended = equations.extended()
            A, places = _with_diagonal(extended.system, len(independent)), extended.places
            A.sort_indices()
            self.bordered = self._bordered((A.indptr, A.indices), places.dependent, places.closing)
            values = A.data
        else:
            values = equations.values
        goal = self.loop.forcing.goal
        row = reduction.maps.transpose_to_nodes(self.weight * normal.D)
        corner = normal.load + row[moved] @ goal
        if not np.isfinite(values).all():  # against an infinite stiffness nothing moves
            nowhere = np.full(self.model.size, np.nan)
            raise StepFailed("singular", "a stiffness is not finite", nowhere)
        self.bordered.factorise(values, column[independent], row[independent], corner)
        dy, dload = self.bordered.solve(np.append(residual[independent], last))
        w = np.zeros(reduction.columns)
        w[independent], w[moved] = dy, dload * goal
        return reduction.maps.with_dependent(w)[:free], dload

    def tangent(self, y: np.ndarray, load: float, previous: Tangent) -> Tangent:
        """Unit tangent after increments, in the direction of a previous one."""
        _, _, column = self.balance(y, load)
        dy, dload = self.solve(column, previous, 0 * y, 1.0)
        D = self.spread(dy, dload)
        length = self.length(D, dload)
        if not np.isfinite(length):
            raise StepFailed("singular", "the bordered tangent is singular", D)
        return Tangent(dy / length, D / length, dload / length, self.bordered.sign)

    def with_the_load(self, y: np.ndarray, load: float) -> Tangent:
        """Unit tangent after increments, in the direction of rising load."""
        return self.tangent(y, load, Tangent(0 * y, np.zeros(self.model.size), 1.0))

    # -- Measures of increments -------------------------------------------------------------------

    def along(self, tangent: Tangent, D: np.ndarray, load: float) -> float:
        """Inner product of a tangent and an increment."""
        return float(tangent.D @ (self.weight * D)) + tangent.load * load

    def length(self, D: np.ndarray, load: float) -> float:
        """Length of an increment."""
        return float(np.sqrt(D @ (self.weight * D) + load**2))

    def size(self, D: np.ndarray) -> float:
        """Root mean square of an increment D (size,) over the nodes, in units of the scene."""
        scaled = D / self.model.units.nodes
        return math.sqrt(scaled @ scaled / len(self.model.mesh.turns))

    def is_still(self, D: np.ndarray) -> bool:
        """Whether an increment D (size,) is zero within the tolerance of Newton's method."""
        return self.size(D) <= self.loop.failures.options.tolerance


def between(states: list[State], points: np.ndarray, place: float) -> State:
    """The state at a place on the path, by polynomials through states at other points of it."""
    (weights,), values = lagrange(points, np.array([place])), dict[str, object]()
    for name in (*ARRAYS, *NUMBERS, "motors"):
        parts = [getattr(state, name) for state in states]
        if parts[0] is not None:
            values[name] = sum(w * part for w, part in zip(weights, parts, strict=True))
    values["t"] = float(values["t"])  # type: ignore[arg-type]
    return replace(states[0], **values, unstable_modes=None, negative_pivots=None)  # type: ignore[arg-type]


def _with_diagonal(A: csr_matrix, count: int) -> csr_matrix:
    """A matrix with places for the diagonal of its first rows, also where it is exactly zero."""
    entries, diagonal = A.tocoo(), np.arange(count)
    places = np.append(entries.row, diagonal), np.append(entries.col, diagonal)
    return csr_matrix((np.append(entries.data, np.zeros(count)), places), A.shape)


# -- Stiffness of small motions about the equilibria of a path, and how many of them grow -------
# Where all forces have a potential, Sylvester's inertia of the tangent counts them, from the
# factors of the step. They belong to the last iteration of Newton's method, whose error is below
# its tolerance.


# Number of the lowest modes that may grow where forces follow the motion; with so few unknowns the
# matrices are full.
_LOWEST, _FULL = 12, 100
# Change of a tangent that is singular, relative to its largest stiffness.
_SHIFT = 1e-12
# Part of a stiffness that is a rounding error.
_ROUND_OFF = 1e-15
# Part of a square of a frequency beside the real axis that is a rounding error.
_BESIDE = 1e-6


class Growing(NamedTuple):
    """Numbers of modes that grow, vibrating and without vibrating."""

    vibrating: int
    diverging: int


class SmallMotions:
    """Small motions about equilibria of a model, reduced to the unknowns."""

    def __init__(self, loop: LoadLoop):
        self._loop, self.model = loop, loop.model
        self._pattern: Pattern = np.empty(0), np.empty(0)

    @property
    def unit(self) -> np.ndarray:
        """Sizes (n,) of unit unknowns."""
        return self.model.units.unknowns[self.model.reduction.independent]

    def stiffness(self, state: State) -> csr_matrix:
        """The tangent (n, n) of an equilibrium without flow."""
        return self.extended(state).matrix

    def extended(self, state: State) -> ConstrainedMatrix:
        """The tangent of an equilibrium, in long trees with auxiliary unknowns."""
        self._loop.balance(state, state.t)
        return self._loop.equations.extended()

    def coupling(self) -> csr_matrix:
        """T (size, n): motions of all nodes by the unknowns, in the last state."""
        return self.model.reduction.maps.coupling()[:, self.model.reduction.independent]

    def at_nodes(self, state: State, vectors: np.ndarray) -> np.ndarray:
        """Motions (size, m) of all nodes by vectors (n, m) of unknowns, in a state."""
        self.extended(state)  # the couplings are then those of this state
        motion = self.model.reduction.maps.motion
        return np.column_stack([motion(vector) for vector in vectors.T])

    def symmetric(self, K: csr_matrix) -> bool:
        """Whether the forces of a state have a potential."""
        return not K.nnz or self._symmetric((K.indptr, K.indices), K.data)

    def _symmetric(self, pattern: Pattern, values: np.ndarray) -> bool:
        if not all(map(np.array_equal, self._pattern, pattern)):
            indptr, indices = self._pattern = pattern[0].copy(), pattern[1].copy()
            sliding = bool(self.model.couplings.sliding)
            self._symmetry = Symmetry(self._pattern, self.unit, sliding)
        return self._symmetry.holds(values)

    # -- Forces with a potential ------------------------------------------------------------------

    def note(self, state: State, factors: LoadLoop | BorderedLU) -> None:
        """Set the numbers of negative pivots and unstable modes by the factors of a step."""
        model, reduction = self.model, self.model.reduction
        # Auxiliary unknowns, loops, sliders and members that may touch make them those of another
        # matrix than the tangent.
        rows = model.couplings.unknown_count
        if not rows == reduction.free == len(reduction.independent):
            return
        members = model.points.members
        if model.couplings.sliding or (members is not None and members.are_near):
            return
        state.negative_pivots = factors.negative_eigenvalues()
        if not model.kinks.potential:
            if not self._symmetric(reduction.tangent.pattern, factors.values):
                return
        state.unstable_modes = state.negative_pivots

    def count(self, state: State, old: State) -> int | None:
        """Number of modes that grow about a state after an old one; None if it is not known."""
        if state.unstable_modes is None and not self.model.kinks.flowed(old, state):
            try:
                state.unstable_modes = sum(self.growing(state))
            except ValueError:
                return None
        return state.unstable_modes

    def count_again(self, old: State, new: State) -> tuple[int | None, int | None]:
        """Numbers of modes that grow before and after a step, whose pivots may be round-off."""
        if not self.model.kinks.flowed(old, new):
            for state in (old, new):
                if state.unstable_modes:
                    with suppress(ValueError):
                        state.unstable_modes = sum(self.growing(state, tolerance=_ROUND_OFF))
        return old.unstable_modes, new.unstable_modes

    def growing(self, state: State, K: csr_matrix | None = None, tolerance: float = 0.0) -> Growing:
        """Modes that grow about a state; an eigenvalue of the tangent that is zero does not.

        Symmetric tangents are those of stiffnesses that are larger by a `tolerance`.
        """
        extended = self.extended(state) if K is None else ConstrainedMatrix.plain(K)
        if not (free := extended.free):
            return Growing(0, 0)
        A, sliding = extended.alone, bool(self.model.couplings.sliding)
        if extended.is_plain or not Symmetry.of(A, extended.units(self.model), sliding):
            if not self.symmetric(K := extended.matrix):
                pairs, real_squares = pairs_and_others(self.squares(state, K))
                return Growing(len(pairs), int((real_squares < 0).sum()))
            extended = ConstrainedMatrix.plain(K)
        system, metric = extended.system, self.unit**-2.0
        metric = scipy.sparse.diags(np.append(metric, np.zeros(system.shape[0] - free)))
        diagonal = abs(system.diagonal()[:free])
        most = (diagonal * self.unit**2).max() or 1.0
        if tolerance:
            others = np.zeros(system.shape[0] - free)
            system = (system + scipy.sparse.diags(np.append(tolerance * diagonal, others))).tocsr()
        for shift in (0.0, _SHIFT * most):  # if a pivot, or an eigenvalue, is zero
            shifted = (system + shift * metric).tocsr() if shift else system
            shifted.sort_indices()
            lu = extended.factors((shifted.indptr, shifted.indices))
            if lu.factorise(shifted.data):
                return Growing(0, extended.negative_eigenvalues(lu))
        raise ValueError(f"unstable_modes: the tangent at load factor {state.t:g} is singular")

    def lowest(self, K: csr_matrix, n: int) -> tuple[np.ndarray, np.ndarray]:
        """The n lowest eigenvalues of a tangent in unit unknowns, and vectors (unknowns, n)."""
        symmetric = ConstrainedMatrix.plain(((K + K.T) / 2).tocsr())
        metric = ConstrainedMatrix.plain(scipy.sparse.diags(self.unit**-2.0).tocsr())
        modes = UndampedModes(symmetric, metric)
        roots, _, vectors = modes.lowest(min(n, K.shape[0]))
        return np.sign(roots) * roots**2, vectors

    def vanishing(self, K: csr_matrix, multiplicity: int, unstable: int) -> np.ndarray:
        """Vectors (unknowns, multiplicity) of eigenvalues next to zero, of so many `unstable`."""
        values, vectors = self.lowest(K, unstable + 1)
        return vectors[:, np.sort(np.argsort(abs(values))[:multiplicity])]

    # -- Forces that follow the motion ------------------------------------------------------------

    def _mass(self) -> csr_matrix:
        """The mass (n, n), in the last state."""
        T = self.coupling()
        return (T.T @ self.model.masses.matrix @ T).tocsr()

    def squares(self, state: State, K: csr_matrix | None = None) -> np.ndarray:
        """Squares of the angular frequencies of the lowest modes without damping, complex."""
        K = self.stiffness(state) if K is None else K
        M = self._mass()
        if not M.data.any():
            raise ValueError(
                "unstable_modes: where forces follow the motion, stability depends on masses. Give "
                "a section rhoA, or add masses"
            )
        inverse = pivoted_lu(K)
        if K.shape[0] <= _FULL:
            values = np.linalg.eigvals(inverse.solve(M.toarray()))
        else:
            compliance = LinearOperator(K.shape, lambda x: inverse.solve(M @ x), dtype=float)
            start = np.ones(K.shape[0])
            values = eigs(compliance, _LOWEST, v0=start, return_eigenvectors=False)
        values = values[np.argsort(-abs(values), kind="stable")][:_LOWEST]
        return 1 / values[abs(values) > 1e-12 * abs(values[0])].astype(complex)

    def shapes(self, state: State, square: float, multiplicity: int) -> np.ndarray:
        """Unit shapes (unknowns, multiplicity) of motions with the square of a frequency."""
        unit, K = scipy.sparse.diags(self.unit), self.stiffness(state)
        _, right = null_vectors(unit @ (K - square * self._mass()) @ unit, multiplicity)
        return unit @ right


def pairs_and_others(squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Complex squares of frequencies, one of each pair, and real ones.

    Pairs are vibrations that grow; the nearest to the real axis is first.
    """
    sines = squares.imag / abs(squares)
    pairs = np.flatnonzero(sines > _BESIDE)
    order = pairs[np.argsort(sines[pairs], kind="stable")]
    return squares[order], squares.real[abs(sines) <= _BESIDE]
