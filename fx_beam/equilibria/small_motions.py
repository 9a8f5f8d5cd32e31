"""Stiffness of small motions about the equilibria of a path, and how many of them grow.

Where all forces have a potential, Sylvester's inertia of the tangent counts them, from the factors
of the step. They belong to the last iteration of Newton's method, whose error is below its
tolerance.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import LinearOperator, eigs

from fx_beam.results.state import State
from fx_beam.step.extended import ConstrainedMatrix
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.sparse_lu import Pattern, null_vectors, pivoted_lu
from fx_beam.step.undamped_modes import Symmetry, UndampedModes

from .bordered_lu import BorderedLU

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

    def stiffness(self, state: State) -> scipy.sparse.csr_matrix:
        """The tangent (n, n) of an equilibrium without flow."""
        return self.extended(state).matrix

    def extended(self, state: State) -> ConstrainedMatrix:
        """The tangent of an equilibrium, in long trees with auxiliary unknowns."""
        self._loop.balance(state, state.t)
        return self._loop.equations.extended()

    def coupling(self) -> scipy.sparse.csr_matrix:
        """T (size, n): motions of all nodes by the unknowns, in the last state."""
        return self.model.reduction.maps.coupling()[:, self.model.reduction.independent]

    def symmetric(self, K: scipy.sparse.csr_matrix) -> bool:
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

    def growing(
        self, state: State, K: scipy.sparse.csr_matrix | None = None, tolerance: float = 0.0
    ) -> Growing:
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

    def lowest(self, K: scipy.sparse.csr_matrix, n: int) -> tuple[np.ndarray, np.ndarray]:
        """The n lowest eigenvalues of a tangent in unit unknowns, and vectors (unknowns, n)."""
        symmetric = ConstrainedMatrix.plain(((K + K.T) / 2).tocsr())
        metric = ConstrainedMatrix.plain(scipy.sparse.diags(self.unit**-2.0).tocsr())
        modes = UndampedModes(symmetric, metric)
        roots, _, vectors = modes.lowest(min(n, K.shape[0]))
        return np.sign(roots) * roots**2, vectors

    def vanishing(self, K: scipy.sparse.csr_matrix, multiplicity: int, unstable: int) -> np.ndarray:
        """Vectors (unknowns, multiplicity) of eigenvalues next to zero, of so many `unstable`."""
        values, vectors = self.lowest(K, unstable + 1)
        return vectors[:, np.sort(np.argsort(abs(values))[:multiplicity])]

    # -- Forces that follow the motion ------------------------------------------------------------

    def _mass(self) -> scipy.sparse.csr_matrix:
        """The mass (n, n), in the last state."""
        T = self.coupling()
        return (T.T @ self.model.masses.matrix @ T).tocsr()

    def squares(self, state: State, K: scipy.sparse.csr_matrix | None = None) -> np.ndarray:
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
