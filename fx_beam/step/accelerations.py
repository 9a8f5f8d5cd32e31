"""Accelerations of nodes that joints couple, by T^T M T a = f for the unknowns."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from .model import Model, fact
from .sparse_lu import LU

# Up to so many rows matrices are arrays: an operation on sparse ones costs 0.1 ms.
_SMALL = 200
# From so many unknowns on a mass matrix is not factorised.
_LARGE = 5000
# Largest error of a solution, relative to the right side, that tells a singular matrix.
_SINGULAR = 1e-6
# Largest error of the scaled forces of accelerations, relative to them, and most iterations for it.
_EXACT, _MOST = 1e-14, 300
# Masses relative to the largest, in sizes of unit unknowns, that a lever of round-off gives.
_NO_MASS = 1e-26


def accelerations(model: Model, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations a (free,) under generalised forces f (free,), and the rest f - M a.

    As `acceleration_of`, in the configuration in which the reduction is.
    """
    reduction, n, a = model.reduction, model.reduction.free, None
    if reduction.couplings.is_selection:
        a = _of_equal(model, force)
    elif not reduction.couplings.sliding and len(reduction.auxiliaries):
        a = _with_auxiliaries(model, force)
    if a is None:
        T = reduction.maps.coupling_array() if model.size <= _SMALL else reduction.maps.coupling()
        M, unit = (T.T @ (model.masses.matrix @ T))[:n, :n], model.units.unknowns
        a = acceleration_of(M, force, unit)
    return a, force - _inertia(model, a)


def _inertia(model: Model, a: np.ndarray) -> np.ndarray:
    """Generalised forces (free,) of accelerations of the unknowns (free,)."""
    reduction = model.reduction
    node_forces = model.masses.matrix @ reduction.maps.to_nodes(reduction.in_columns(a))
    return reduction.maps.transpose_to_nodes(node_forces)[: reduction.free]


def _of_equal(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By the reduced mass, whose factors have the pattern of the tangent; None if it is singular.

    Or without factors where they would need more memory than all else.
    """
    free = model.reduction.free
    if free > _LARGE and (a := _iterated(model, force)) is not None:
        return a
    tangent = model.reduction.tangent
    (indptr, indices), direct = tangent.pattern, tangent.direct
    values = np.bincount(direct["to"], model.masses.matrix.data[direct["from"]], len(indices))
    diagonal = values[np.repeat(np.arange(free), np.diff(indptr)) == indices]
    has_mass = free and (diagonal > 0).all()
    factors = fact(model, _factors).empty()
    return factors.solve(force) if has_mass and factors.factorise(values) else None


def _with_auxiliaries(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By the system with auxiliary unknowns, without unknowns that move no mass and no loop."""
    n, still = model.reduction.free, ~model.reduction.maps.moves(model.masses.matrix.diagonal() > 0)
    matrix = model.reduction.maps.normal(model.masses.matrix)
    moving = np.append(~still, np.ones(matrix.shape[0] - n, dtype=bool))
    matrix = scipy.sparse.diags(1.0 * moving) @ matrix + scipy.sparse.diags(1.0 * ~moving)
    b = np.zeros(matrix.shape[0])
    b[:n] = np.where(still, 0.0, force)
    try:
        a = scipy.sparse.linalg.splu(matrix.tocsc()).solve(b)[:n]
    except RuntimeError:  # exactly singular
        return None
    error = _inertia(model, a) - b[:n]
    return a if abs(error).max(initial=0.0) <= _SINGULAR * abs(b).max(initial=0.0) else None


def have_mass(masses: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Flags (n,) of the unknowns that have mass, by their masses and sizes of unit unknowns."""
    sizes = masses * unit**2
    return sizes > _NO_MASS * sizes.max(initial=0.0)


def acceleration_of(mass, force: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Accelerations (n,) under generalised forces (n,); zero where masses are none but round-off.

    If several unknowns move one mass, they are the accelerations of least norm.
    """
    a, diagonal, solution = np.zeros(len(force)), mass.diagonal(), None
    moving = np.flatnonzero(have_mass(diagonal, unit))
    if not len(moving):
        return a
    scale = diagonal[moving] ** -0.5
    b = scale * force[moving]
    if isinstance(mass, np.ndarray):
        scaled = scale[:, None] * mass[np.ix_(moving, moving)] * scale
    else:
        S = scipy.sparse.diags(scale)
        scaled = (S @ mass.tocsr()[moving][:, moving] @ S).tocsc()
        solution = _solve_sparse(scaled, b)
    if solution is None:
        full = scaled if isinstance(scaled, np.ndarray) else scaled.toarray()
        options = {"lapack_driver": "gelsy", "check_finite": False}  # a step says what is not
        solution = scipy.linalg.lstsq(full, b, 1e-10, **options)[0]
    a[moving] = scale * solution
    return a


def _iterated(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By products with the mass; None if conjugate gradients do not find them.

    Scaled by its diagonal, the mass of a mesh has a condition number below ten.
    """
    diagonal = model.reduction.maps.transpose_to_nodes(model.masses.matrix.diagonal())[: len(force)]
    scale = np.zeros(len(force))
    scale[diagonal > 0] = diagonal[diagonal > 0] ** -0.5
    x, r = np.zeros(len(force)), scale * force
    d, size = r, r @ r
    least = _EXACT**2 * size
    for _ in range(_MOST):
        if size <= least:
            return scale * x
        image = scale * _inertia(model, scale * d)
        if (moved := d @ image) <= _EXACT * (d @ d):  # nothing that has mass
            return None
        part = size / moved
        x, r = x + part * d, r - part * image
        size, last_size = r @ r, size
        d = r + size / last_size * d
    return None


def _solve_sparse(A: scipy.sparse.csc_matrix, b: np.ndarray) -> np.ndarray | None:
    """Solution for a positive definite matrix; None if it is singular."""
    A.eliminate_zeros()  # the masses have the stiffness' pattern
    try:
        factors = scipy.sparse.linalg.splu(A, "MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:
        return None
    return None if abs(factors.U.diagonal()).min() < 1e-10 else factors.solve(b)


def _factors(model: Model) -> LU:
    """Factors for matrices of the reduced pattern, in which the mass of unknowns is one."""
    return LU(model.reduction.tangent.pattern)
