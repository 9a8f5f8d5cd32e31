"""Linear systems of Newton's method, on PETSc."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from fx_beam.coupling.index_reduction import Reduction
from fx_beam.coupling.tied_order import tied_fill_in
from fx_beam.kept import kept
from fx_beam.model.equations import Equations

# Up to this half bandwidth a matrix is factorised as a band.
_NARROW = 50


def petsc(what: str) -> Any:
    """The module PETSc of petsc4py. If it is missing, a RuntimeError says `what` needs it."""
    if find_spec("petsc4py") is None:
        raise RuntimeError(
            f"{what} needs PETSc, which is not installed. Install petsc4py (Debian's "
            "python3-petsc4py), or use fx_beam.simulate with the compiled loop, which runs without"
        )
    from petsc4py import PETSc

    return PETSc


@kept
def _bandwidth(indptr: np.ndarray, indices: np.ndarray) -> int:
    """Half bandwidth of a sparse matrix in reverse Cuthill-McKee order."""
    n = len(indptr) - 1
    if not n:
        return 0  # SciPy finds no order of nothing
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee(graph, symmetric_mode=False)] = np.arange(n)
    return int(abs(order[np.repeat(np.arange(n), np.diff(indptr))] - order[indices]).max(initial=0))


class LinearSolver:
    """LU factorisation of the reduced tangent; its sparsity pattern is constant."""

    def __init__(self, reduction: Reduction):
        PETSc = petsc("a step in Python")
        indptr, indices = reduction.pattern
        n = len(indptr) - 1
        self._filled = np.zeros(len(indices))
        #: Position of each unknown of the linear system, and place of each value.
        self._position, self._from = np.arange(n), np.arange(len(indices))
        if tied := reduction.dependent.size > 0:
            found = _tied(indptr, indices, reduction.dependent)
            self._position, indptr, indices, self._from = found
        indptr, indices = (part.astype(PETSc.IntType) for part in (indptr, indices))
        self._values = np.zeros(len(indices))
        # PETSc uses these arrays directly, without copies.
        self._matrix = PETSc.Mat().createAIJWithArrays(
            (n, n), (indptr, indices, self._values), comm=PETSc.COMM_SELF
        )
        self._b, self._x = np.zeros(n), np.zeros(n)
        self._vectors = tuple(
            PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF) for array in (self._b, self._x)
        )
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.LU)
        kinds = PETSc.Mat.OrderingType
        # Chains have a narrow band; in frames nested dissection leaves far less fill-in.
        if tied:
            pc.setFactorOrdering(kinds.NATURAL)
        else:
            pc.setFactorOrdering(kinds.RCM if _bandwidth(indptr, indices) < _NARROW else kinds.ND)
        # PETSc's default refuses pivots below 2e-14, which depends on the units of the scene.
        pc.setFactorPivot(zeropivot=0.0)
        self._ksp.setOperators(self._matrix)

    def solve(self, equations: Equations, r: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Solution (free,) for the reduced tangent; not finite if it is singular."""
        equations.fill_tangent(r, self._filled)
        np.take(self._filled, self._from, out=self._values)
        self._matrix.stateIncrease()
        own = self._position[: len(b)]
        borders = equations.model.reduction.borders()
        if borders is None:
            return self._solved(own, b)[own]
        columns, rows = borders
        x, forced = self._solved(own, b), [self._solved(self._position, c) for c in columns]
        rows = rows[:, np.argsort(self._position)]
        forces = np.linalg.solve(rows @ np.transpose(forced), rows @ x)
        return (x - forces @ forced)[own]

    def _solved(self, places: np.ndarray, b: np.ndarray) -> np.ndarray:
        self._b[:] = 0.0
        self._b[places] = b
        self._ksp.solve(*self._vectors)
        return self._x.copy()


@kept
def _tied(indptr: np.ndarray, indices: np.ndarray, dependent: np.ndarray) -> tuple[np.ndarray, ...]:
    """Positions (n,) for unknowns of ties, with the rows in this order and where they are from."""
    n = len(indptr) - 1
    of = np.arange(1, len(indices) + 1)
    matrix = scipy.sparse.csr_matrix((of, indices, indptr), (n, n))
    graph = (matrix + matrix.T + scipy.sparse.identity(n)).tocsr()
    position, _, _ = tied_fill_in(graph, np.ones(n, int), dependent)
    order = np.argsort(position)
    matrix = matrix[order][:, order].tocsr()
    matrix.sort_indices()
    return position, matrix.indptr, matrix.indices, matrix.data - 1
