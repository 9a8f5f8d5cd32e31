"""Accelerations for a mass matrix that need not be regular."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

# Largest error of the scaled forces of accelerations, relative to them, and most iterations for it.
_EXACT, _MOST = 1e-14, 300


def acceleration_of(mass, force: np.ndarray) -> np.ndarray:
    """Accelerations (n,) under generalised forces (n,); zero where there is no mass.

    If several unknowns move one mass, they are the accelerations of least norm.
    """
    a = np.zeros(len(force))
    diagonal = mass.diagonal()
    moving = np.flatnonzero(diagonal > 0)
    if len(moving):
        scale = diagonal[moving] ** -0.5
        b = scale * force[moving]
        if isinstance(mass, np.ndarray):
            scaled = scale[:, None] * mass[np.ix_(moving, moving)] * scale
            solution = _solve_dense(scaled, b)
        else:
            S = scipy.sparse.diags(scale)
            scaled = (S @ mass.tocsr()[moving][:, moving] @ S).tocsc()
            solution = _solve_sparse(scaled, b)
        if solution is None:
            full = scaled if isinstance(scaled, np.ndarray) else scaled.toarray()
            solution = np.linalg.lstsq(full, b, rcond=1e-10)[0]
        a[moving] = scale * solution
    return a


def iterated_acceleration(
    times: Callable[[np.ndarray], np.ndarray], diagonal: np.ndarray, force: np.ndarray
) -> np.ndarray | None:
    """The same for a mass matrix as a product; None if conjugate gradients do not find them.

    Scaled by its diagonal, the mass of a mesh has a condition number below ten.
    """
    scale = np.zeros(len(force))
    scale[diagonal > 0] = diagonal[diagonal > 0] ** -0.5
    x, r = np.zeros(len(force)), scale * force
    d, size = r, r @ r
    least = _EXACT**2 * size
    for _ in range(_MOST):
        if size <= least:
            return scale * x
        image = scale * times(scale * d)
        if (moved := d @ image) <= _EXACT * (d @ d):  # nothing that has mass
            return None
        part = size / moved
        x, r = x + part * d, r - part * image
        size, before = r @ r, size
        d = r + size / before * d
    return None


def _solve_dense(A: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Solution for a positive definite matrix; None if it is singular."""
    try:
        pivots = np.linalg.cholesky(A).diagonal() ** 2
    except np.linalg.LinAlgError:
        return None
    return None if pivots.min() < 1e-10 else np.linalg.solve(A, b)


def _solve_sparse(A: scipy.sparse.csc_matrix, b: np.ndarray) -> np.ndarray | None:
    """The same for a sparse matrix."""
    A.eliminate_zeros()  # the masses have the stiffness' pattern
    try:
        factors = scipy.sparse.linalg.splu(A, "MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:
        return None
    return None if abs(factors.U.diagonal()).min() < 1e-10 else factors.solve(b)
