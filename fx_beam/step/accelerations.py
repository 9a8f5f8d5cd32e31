"""Accelerations of nodes that joints couple, by T^T M T a = f for the unknowns."""

from __future__ import annotations

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


def accelerations(model: Model, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations (free,) under generalised forces (free,), and what is left of these.

    As `acceleration_of`, in the configuration in which the reduction is.
    """
    reduction, mass, a, gather = model.reduction, model.mass, None, None
    if isinstance(reduction, IndexReduction):
        a, gather = _of_equal(model, reduction, force), reduction.project
    elif isinstance(reduction, JointReduction) and reduction.sliders is None:
        if len(reduction.auxiliaries):
            a, gather = _with_auxiliaries(reduction, mass, force), reduction.gather
    if a is None or gather is None:
        T = reduction.coupling()
        T = T.toarray() if T.shape[0] <= _SMALL else T
        n, gather = reduction.free, T.T.__matmul__
        a = acceleration_of(_reduced(T, mass)[:n, :n], force)
    w = np.append(a, np.zeros(reduction.columns - reduction.free))
    return a, force - gather(mass @ reduction.spread(w))[: reduction.free]


def _of_equal(model: Model, reduction: IndexReduction, force: np.ndarray) -> np.ndarray | None:
    """By the reduced mass, whose factors have the pattern of the tangent; None if it is singular.

    Or without factors where they would need more memory than all else.
    """
    free, mass = reduction.free, model.mass
    w = np.zeros(reduction.columns)

    def times(a):
        w[:free] = a
        return reduction.project(mass @ reduction.spread(w))[:free]

    if free > _LARGE:
        diagonal = reduction.project(mass.diagonal())[:free]
        if (a := iterated_acceleration(times, diagonal, force)) is not None:
            return a
    values = np.empty(len(reduction.pattern[1]))
    reduction.fill(mass.data, force, values)
    lu = model.factors_of_mass
    regular = free and (values[reduction.diagonal] > 0).all() and lu.factorise(values)
    return lu.solve(force) if regular else None


def _with_auxiliaries(
    reduction: JointReduction, mass: scipy.sparse.csr_matrix, force: np.ndarray
) -> np.ndarray | None:
    """By the system with auxiliary unknowns, without unknowns that move no mass and no loop."""
    n, still = reduction.free, ~reduction.moves(mass.diagonal() > 0)
    matrix = reduction.normal(mass)
    kept = np.append(~still, np.ones(matrix.shape[0] - n, dtype=bool))
    matrix = scipy.sparse.diags(1.0 * kept) @ matrix + scipy.sparse.diags(1.0 * ~kept)
    if (bordering_rows := reduction.bordering_rows()) is not None:
        columns, rows = (scipy.sparse.csr_matrix(part) for part in bordering_rows)
        matrix = scipy.sparse.bmat([[matrix, columns.T], [rows, None]])
    b = np.zeros(matrix.shape[0])
    b[:n] = np.where(still, 0.0, force)
    try:
        a = scipy.sparse.linalg.splu(matrix.tocsc()).solve(b)[:n]
    except RuntimeError:  # exactly singular
        return None
    w = np.append(a, np.zeros(reduction.columns - n))
    error = reduction.gather(mass @ reduction.spread(w))[:n] - b[:n]
    return a if abs(error).max() <= _SINGULAR * abs(b).max(initial=0.0) else None


def _reduced(T, mass: scipy.sparse.csr_matrix):
    """T^T M T, an array if T is one."""
    if not isinstance(T, np.ndarray):
        return T.T @ mass @ T
    if T.shape[0] > _TINY:
        return (T.T @ (mass.T @ T)).T
    return T.T @ mass.toarray() @ T
