"""LU factors of sparse matrices by PETSc: the reference."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.fem.mpi import petsc

from .lu_layout import in_sparse_rows
from .sparse_lu import Pattern


class PetscLU:
    """Factors in the order of `lu_layout`."""

    worth = 0

    def __init__(self, pattern: Pattern, dependent: np.ndarray | None = None):
        PETSc = petsc()
        indptr, indices = pattern
        n = len(indptr) - 1
        self._position = in_sparse_rows(indptr, indices, dependent).order
        order = np.argsort(self._position)
        numbered = csr_matrix((np.arange(1, len(indices) + 1), indices, indptr), (n, n))
        numbered = numbered[order][:, order].tocsr()
        numbered.sort_indices()
        self._from, self._values = numbered.data - 1, np.zeros(len(indices))
        rows = (part.astype(PETSc.IntType) for part in (numbered.indptr, numbered.indices))
        # PETSc uses these arrays directly, without copies.
        self._matrix = PETSc.Mat().createAIJWithArrays(
            (n, n), (*rows, self._values), comm=PETSc.COMM_SELF
        )
        self._b, self._x = np.zeros(n), np.zeros(n)
        self._vectors = tuple(
            PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF) for array in (self._b, self._x)
        )
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorOrdering(PETSc.Mat.OrderingType.NATURAL)
        # PETSc's default refuses pivots below 2e-14, which depends on the units of the scene.
        pc.setFactorPivot(zeropivot=0.0)
        self._ksp.setOperators(self._matrix)

    def factorise(self, values: np.ndarray) -> bool:
        """Take the values; the next solution makes the factors, not finite if it is singular."""
        np.take(values, self._from, out=self._values)
        self._matrix.stateIncrease()
        return True

    def solve(self, b: np.ndarray) -> np.ndarray:
        """By substitution."""
        self._b[self._position] = b
        self._ksp.solve(*self._vectors)
        return self._x[self._position]

    def negative_pivots(self) -> None:
        """PETSc does not tell."""
