"""Rates of nodes that joints couple, v = T w, and the equations T^T W T w = b for the unknowns."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam.coupling.index_reduction import IndexReduction
from fx_beam.coupling.joint_reduction import JointReduction

from .mass_solver import acceleration_of, iterated_acceleration
from .model import Model

# Up to so many rows matrices are arrays: an operation on sparse ones costs 0.1 ms.
_SMALL = 200
# Up to so many rows products of arrays are faster than those of a sparse matrix and an array.
_TINY = 40
# From so many unknowns on a mass matrix is not factorised.
_LARGE = 5000
# Largest error of a solution, relative to the right side, that tells a singular matrix.
_SINGULAR = 1e-6


class CoupledRates(Protocol):
    """Rates in the configuration in which the reduction is."""

    def spread(self, w: np.ndarray) -> np.ndarray:
        """T w (size,) for rates of columns."""

    def gather(self, r: np.ndarray) -> np.ndarray:
        """T^T r (columns,) for forces on nodes."""

    def nearest(
        self, weight: scipy.sparse.spmatrix | np.ndarray, missing: np.ndarray
    ) -> np.ndarray:
        """Rates of the independent unknowns nearest to v (size,) in the norm of a weight.

        One of displacements and one of rotations may be given as a diagonal (size,).
        """

    def accelerations(self, mass: scipy.sparse.spmatrix, force: np.ndarray) -> np.ndarray:
        """Accelerations (free,) under generalised forces (free,), as `acceleration_of`."""


def coupled_rates(model: Model) -> CoupledRates:
    """The rates of a model, by the matrix T, or along its trees if they are long."""
    reduction = model.reduction
    if (
        isinstance(reduction, JointReduction)
        and len(reduction.auxiliaries)
        and reduction.sliders is None
    ):
        return AuxiliaryRates(reduction)
    return EqualRates(model) if isinstance(reduction, IndexReduction) else RatesByMatrix(reduction)


class EqualRates:
    """Coupled rates of equal degrees of freedom: sums over them."""

    def __init__(self, model: Model):
        assert isinstance(model.reduction, IndexReduction)
        self._model, self._reduction = model, model.reduction
        self.spread = self._reduction.spread

    def gather(self, r):
        """T^T r."""
        return self._reduction.project(r)

    def nearest(self, weight, missing):
        """Means over equal degrees of freedom, whose weights are equal as well."""
        reduction = self._reduction
        if isinstance(weight, np.ndarray):
            return (reduction.project(missing) / reduction.counts)[: reduction.free]
        return RatesByMatrix(reduction).nearest(weight, missing)

    def accelerations(self, mass, force):
        """By the reduced mass; its factors have the pattern of the tangent."""
        reduction = self._reduction
        if reduction.free > _LARGE and (a := self._iterated(mass, force)) is not None:
            return a
        values = np.empty(len(reduction.pattern[1]))
        reduction.fill(mass.data, force, values)
        if reduction.free and (values[reduction.diagonal] > 0).all():
            lu = self._model.factors_of_mass
            if lu.factorise(values):
                return lu.solve(force)
        return RatesByMatrix(reduction).accelerations(mass, force)

    def _iterated(self, mass, force):
        """The same without factors, which would need more memory than all else."""
        free = self._reduction.free
        w = np.zeros(self._reduction.columns)

        def times(a):
            w[:free] = a
            return self.gather(mass @ self.spread(w))[:free]

        return iterated_acceleration(times, self.gather(mass.diagonal())[:free], force)


class RatesByMatrix:
    """Coupled rates by the matrix T."""

    def __init__(self, reduction: Any):
        self._free, self._independent = reduction.free, reduction.independent
        T = reduction.coupling()
        self._T = T.toarray() if T.shape[0] <= _SMALL else T

    def spread(self, w):
        """T w."""
        return self._T @ w

    def gather(self, r):
        """T^T r."""
        return self._T.T @ r

    def nearest(self, weight, missing):
        """By the normal equations."""
        if isinstance(weight, np.ndarray):
            weight = scipy.sparse.diags(weight)
        T = self._T[:, self._independent]
        right, normal = T.T @ (weight @ missing), T.T @ weight @ T
        if isinstance(normal, np.ndarray):
            return np.linalg.solve(normal, right)
        return scipy.sparse.linalg.spsolve(normal.tocsc(), right)

    def accelerations(self, mass, force):
        """By the reduced mass."""
        return acceleration_of(self._reduced(mass)[: self._free, : self._free], force)

    def _reduced(self, mass):
        """T^T M T, an array if it is small."""
        T = self._T
        if not isinstance(T, np.ndarray):
            return T.T @ mass @ T
        if T.shape[0] > _TINY:
            return (T.T @ (mass.T @ T)).T
        return T.T @ mass.toarray() @ T


class AuxiliaryRates:
    """Coupled rates by sums over the trees, and the equations as a system with auxiliaries."""

    def __init__(self, reduction: JointReduction):
        self._reduction = reduction
        self.spread, self.gather = reduction.spread, reduction.gather

    def nearest(self, weight, missing):
        """By the system with auxiliary unknowns."""
        reduction = self._reduction
        if isinstance(weight, np.ndarray):
            weight = scipy.sparse.diags(weight)
        right = self.gather(weight @ missing)[: reduction.free]
        return self._solved(reduction.normal(weight), right)[reduction.independent]

    def accelerations(self, mass, force):
        """The same, without unknowns that move no mass and no loop."""
        reduction, n = self._reduction, self._reduction.free
        still = ~reduction.moves(mass.diagonal() > 0)
        matrix = reduction.normal(mass)
        kept = np.append(~still, np.ones(matrix.shape[0] - n, dtype=bool))
        matrix = scipy.sparse.diags(kept.astype(float)) @ matrix + scipy.sparse.diags(1.0 * ~kept)
        force = np.where(still, 0.0, force)
        try:
            a = self._solved(matrix.tocsc(), force)
        except RuntimeError:  # exactly singular
            a = np.full(n, np.nan)
        w = np.append(a, np.zeros(reduction.columns - n))
        error = self.gather(mass @ self.spread(w))[:n] - force
        if abs(error).max() <= _SINGULAR * abs(force).max(initial=0.0):
            return a
        return RatesByMatrix(reduction).accelerations(mass, force)

    def _solved(self, matrix, right: np.ndarray) -> np.ndarray:
        if (bordering_rows := self._reduction.bordering_rows()) is not None:
            columns, rows = (scipy.sparse.csr_matrix(part) for part in bordering_rows)
            matrix = scipy.sparse.bmat([[matrix, columns.T], [rows, None]], format="csc")
        b = np.zeros(matrix.shape[0])
        b[: len(right)] = right
        return scipy.sparse.linalg.splu(matrix).solve(b)[: len(right)]
