"""Linear systems of Newton's method."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import SuperLU

from fx_beam.coupling.index_reduction import Reduction

from .equations import Equations
from .kept_factors import KeptFactors
from .sparse_lu import LU, pivoted_lu, sparse_lu

# Factors are kept if making them costs as much as so many solutions.
_LEAST_WORTH = 6
# A pivot relative to the largest one that is zero but for round-off.
_ROUND_OFF = 1e-14


class LinearSolver:
    """LU factorisation of the reduced tangent, whose sparsity is constant."""

    #: Error of a solution relative to it; nothing beside that of Newton's method.
    error = 0.0

    def __init__(self, reduction: Reduction):
        if reduction.free:  # else there is nothing to solve
            dependent = reduction.dependent if reduction.dependent.size else None
            self._lu = sparse_lu(reduction.pattern, dependent)
            #: None with auxiliary unknowns, or where new factors are cheap.
            self._kept = None
            if self._lu.worth >= _LEAST_WORTH and dependent is None:
                self._kept = KeptFactors(reduction.pattern, self._lu)
        self._pattern = reduction.pattern
        #: Whether rows were exchanged in the last factors, whose pivots tell no signs.
        self._exchanged = False
        #: Whether the last tangent was singular.
        self.singular = False
        #: Values of the last tangent.
        self.values = np.zeros(len(reduction.pattern[1]))
        self._size = len(reduction.pattern[0]) - 1

    def negative_eigenvalues(self) -> int | None:
        """Their number, of the last tangent, which must be symmetric; None if its factors are old.

        By Sylvester's law of inertia: the pivots without exchange of rows have their signs.
        """
        if not self._size:
            return 0
        if self._exchanged or not (self._kept is None or self._kept.new):
            return None
        return self._lu.negative_pivots()

    def solve(
        self, equations: Equations, r: np.ndarray, b: np.ndarray, energy: float = 0.0
    ) -> np.ndarray:
        """Solution (free,) for the reduced tangent; not finite if it is singular.

        As exact as it can be, whatever the energy of a step. Without a right side it is zero also
        then, as at a bifurcation of a straight path.
        """
        self._exchanged = self.singular = False
        if not (free := len(b)):
            return b
        changes = equations.model.points.members is not None
        if not changes:
            equations.fill_tangent(r, self.values)
            if self._kept is not None:
                x = self._kept.solve(self.values, b)
                if np.isfinite(x).all():
                    return x
        factors = self._changing(equations.system(r)) if changes else self._constant()
        if factors is None:
            self.singular = True
            return np.full(free, np.nan) if b.any() else np.zeros(free)
        if self._size > free:  # forces of auxiliary unknowns and bordering rows
            b = np.concatenate([b, np.zeros(self._size - free)])
        x = factors.solve(b)
        bordering_rows = equations.model.reduction.bordering_rows()
        if bordering_rows is not None:
            columns, rows = bordering_rows
            forced = np.array([factors.solve(column) for column in columns])
            x -= np.linalg.solve(rows @ forced.T, rows @ x) @ forced
        return x[:free]

    def _constant(self) -> LU | SuperLU | None:
        """Factors of the present values; None if they are singular."""
        if self._lu.factorise(self.values):
            return self._lu
        # A pivot of a regular matrix that is not positive definite may be zero.
        self._exchanged = True
        indptr, indices = self._pattern
        factors = self._changing(csr_matrix((self.values, indices, indptr)))
        pivots = abs(factors.U.diagonal()) if factors is not None else np.zeros(1)
        return factors if pivots.min() > _ROUND_OFF * pivots.max() else None

    @staticmethod
    def _changing(tangent: csr_matrix) -> SuperLU | None:
        """The same of a matrix whose sparsity may have changed."""
        try:
            return pivoted_lu(tangent)
        except RuntimeError:  # exactly singular
            return None
