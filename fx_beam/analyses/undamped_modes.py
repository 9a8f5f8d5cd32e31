"""Modes of K x = omega^2 M x, by SLEPc."""

from __future__ import annotations

import bisect
import functools
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import scipy.linalg
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.errors import SceneError
from fx_beam.stepping.linear_solver import petsc


def lowest(K, M, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest angular frequencies (n,), which are rigid (n,), and vectors (size, n).

    Frequencies are zero for rigid modes and negative for unstable ones. Modal masses are 1.
    """
    massive = M.diagonal() > 0
    ratios = abs(K.diagonal()[massive]) / M.diagonal()[massive]
    # Scaled so that stiffnesses are of order 1 and eigenvalues below 1.
    unit = ratios.max() or 1.0
    scale = scipy.sparse.diags((abs(K.diagonal()) + unit * M.diagonal()) ** -0.5)
    K, M = scale @ K @ scale, unit * scale @ M @ scale
    # Smaller eigenvalues are rounding errors, even in the softest direction.
    least = 1e4 * np.finfo(float).eps * ratios.min(where=ratios > 1e-20 * unit, initial=unit) / unit
    values, rounding, vectors = _in_slices(K, M, n, 10.0 ** np.arange(np.log10(least), 4, 0.25))
    vectors = np.sqrt(unit) * (scale @ vectors)
    vectors *= np.sign(vectors[abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    values, rigid = unit * values, abs(values) <= rounding
    return np.where(rigid, 0.0, np.sign(values) * np.sqrt(abs(values))), rigid, vectors


def _in_slices(K, M, n: int, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same by slices of four decades from below; `sizes` are candidates for slice bounds."""
    # Each slice has its own shift, since eigenvalues far below a shift are lost to rounding errors.
    # A slice is complete when it has as many eigenvalues as Sylvester's law counts. A Krylov space
    # may lack copies of multiple eigenvalues; they are found after deflation of the others.
    pencil = (K + 1j * M).tocsc()  # both in one sparsity
    below = functools.cache(functools.partial(_below, pencil.real, pencil.data))
    levels = _levels(below, sizes)

    def reach(k):
        return levels[bisect.bisect_left(levels, k, hi=len(levels) - 1, key=below)]

    n = min(n, below(levels[-1]))  # the others are infinite, for unknowns without mass
    last = reach(n)
    values: np.ndarray = np.empty(0)
    rounding, vectors = values, np.empty((K.shape[0], 0))
    while (found := len(values)) < max(n, below(last)):
        bottom, noise = reach(found + 1), rounding.max(initial=levels[levels > 0][0])
        top = min(last, max(1e4 * bottom, 1e-4 * bottom, noise))
        shift = -max(top, -10 * bottom, 10 * noise)  # below the slice, not an eigenvalue
        new = _nearest(K, M, max(below(top) - found, 1), shift, vectors)
        # Rayleigh-Ritz method, orthogonal to the slices below.
        new -= vectors @ (vectors.T @ (M @ new))
        new = new @ scipy.linalg.eigh(new.T @ (K @ new), new.T @ (M @ new))[1]
        squares, errors = _quotients(K, M, new)
        # Vectors above the slice took the place of copies that are not found yet.
        inside = squares <= max(top + 1e-8 * abs(top), squares[0])
        values, rounding = np.append(values, squares[inside]), np.append(rounding, errors[inside])
        vectors = np.column_stack([vectors, new[:, inside]])
    order = np.argsort(values)[:n]
    return values[order], rounding[order], vectors[:, order]


def _levels(below: Callable[[float], int], sizes: np.ndarray) -> np.ndarray:
    """Slice bounds of both signs and these sizes, above the rounding error."""
    if below(sizes[-1]) < 1:
        raise SceneError(
            "modes: a part of the scene moves freely and has no mass. Give it mass or a support"
        )
    if below(-sizes[-1]) != 0:
        raise SceneError(
            "modes: the state is unstable in a motion without mass, so its growth rate is infinite."
            " Give this part mass, or use a state with less load"
        )
    # The rounding error of a rigid mode of a stiff part may be large compared with a soft part.
    least = next(k for k, x in enumerate(sizes) if min(below(x), below(-x)) >= 0)
    return np.concatenate([-sizes[least:][::-1], sizes[least:]])


def _quotients(K, M, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rayleigh quotients of vectors and their rounding errors; scales vectors to modal mass 1."""
    vectors /= np.sqrt(np.einsum("ij,ij->j", vectors, M @ vectors))
    values = np.einsum("ij,ij->j", vectors, K @ vectors)
    sizes = np.einsum("ij,ij->j", abs(vectors), abs(K) @ abs(vectors))
    # Of the sum, and of the vectors: the latter counts where nothing else has stiffness.
    eps = np.finfo(float).eps
    return values, 2 * eps * sizes + (10 * eps) ** 2 * (vectors**2).sum(axis=0)


def _below(shifted: scipy.sparse.csc_matrix, pencil: np.ndarray, x: float) -> int:
    """Number of eigenvalues below x: negative pivots of K - x M, by Sylvester's law of inertia.

    The pencil has the entries of K + i M, in the sparsity of the shifted matrix, which is set here.
    -1 if a pivot is zero: x is an eigenvalue.
    """
    shifted.data = pencil.real - x * pencil.imag
    try:
        factors = splu(
            shifted,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return -1
    return int((factors.U.diagonal() < 0).sum())


def _nearest(K, M, n: int, shift: float, deflated: np.ndarray) -> np.ndarray:
    """Eigenvectors (size, n or fewer) nearest to a shift, except the deflated ones."""
    PETSc = petsc("fx_beam.modes")
    if find_spec("slepc4py") is None:
        raise RuntimeError("fx_beam.modes needs SLEPc. Install Debian's python3-slepc4py")
    from slepc4py import SLEPc

    def handed_over(matrix):
        rows = matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType)
        return PETSc.Mat().createAIJ(matrix.shape, csr=(*rows, matrix.data), comm=PETSc.COMM_SELF)

    # A tiny mass for massless unknowns, so that no vector has zero norm.
    trace = scipy.sparse.diags(1e-20 * (M.diagonal() == 0))
    # Both in one sparsity: SLEPc's shift fails where the mass has entries that the stiffness lacks.
    pencil = (K + 1j * (M + trace)).tocsr()
    A, B = handed_over(pencil.real), handed_over(pencil.imag)
    solver = SLEPc.EPS().create(PETSc.COMM_SELF)
    solver.setOperators(A, B)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setDimensions(n, min(K.shape[0], 2 * n + 20))
    solver.setTolerances(1e-12, 1000)
    solver.setTarget(shift)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.setDeflationSpace(
        [PETSc.Vec().createWithArray(x, comm=PETSc.COMM_SELF) for x in deflated.T.copy()]
    )
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    # Pivots of a slender beam in bending are small relative to its axial stiffness, but not zero.
    transform.getKSP().setType(PETSc.KSP.Type.PREONLY)
    factorisation = transform.getKSP().getPC()
    factorisation.setType(PETSc.PC.Type.LU)
    factorisation.setFactorPivot(zeropivot=1e-100)
    try:
        solver.solve()
        found = min(solver.getConverged(), n)
    except PETSc.Error as error:
        raise _failure(f"failed ({error})") from error
    if found == 0:
        raise _failure("found no mode")
    vectors, x = np.empty((K.shape[0], found)), A.createVecLeft()
    for k in range(found):
        solver.getEigenvector(k, x)
        vectors[:, k] = x.array
    return vectors


def _failure(what: str) -> RuntimeError:
    return RuntimeError(
        f"modes: SLEPc {what}. Try fewer modes, and check the units of stiffnesses and masses: "
        "SLEPc may fail for very different magnitudes"
    )
