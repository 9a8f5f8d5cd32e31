"""The unknowns of supports and joints in PETSc."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from .assembly import Assembly, csr_of


class Unknowns:
    """Independent unknowns y (n,), shared by the processes, with the maps T and Tv."""

    def __init__(self, assembly: Assembly):
        self.comm, self._reduction = assembly.grid.comm, assembly.model.reduction
        #: Numbers (n,) of y among all unknowns of the scene.
        self.independent = self._reduction.independent
        self.size = len(self.independent)
        self._share(np.unique(self.T[np.unique(assembly.fields.increment_numbers)].indices))
        #: The reduced tangent.
        self.A = self.matrix(scipy.sparse.identity(self.size, format="csr"))
        self._pattern = np.empty(0), np.empty(0)

    def _share(self, touched: np.ndarray) -> None:
        """Number the unknowns in PETSc: the first process whose elements touch one has it."""
        comm, owner = self.comm, np.full(self.size, self.comm.size, dtype=np.int32)
        owner[touched] = comm.rank
        comm.Allreduce(MPI.IN_PLACE, owner, MPI.MIN)
        owner[owner == comm.size] = 0  # of nodes without beams
        self._order = np.argsort(owner, kind="stable")
        self._numbers = np.argsort(self._order)
        self._counts = np.bincount(owner, minlength=comm.size)
        first = int(self._counts[: comm.rank].sum())
        self._own = self._order[first : first + self._counts[comm.rank]]

    # -- Vectors -----------------------------------------------------------------------------------

    def own(self, y: np.ndarray) -> np.ndarray:
        """The part of this process of values (n,)."""
        return y[self._own]

    def all(self, x: PETSc.Vec) -> np.ndarray:
        """All values (n,) of a vector, on each process."""
        if self.comm.size == 1:
            return x.array_r
        values = np.empty(self.size)
        self.comm.Allgatherv(x.array_r, [values, self._counts])
        return values[self._numbers]

    def to_nodes(self, y: np.ndarray) -> np.ndarray:
        """Small motion (size,) of all degrees of freedom: T y, with T of the last unknowns."""
        return self._reduction.maps.motion(y)

    # -- Matrices ----------------------------------------------------------------------------------

    @property
    def T(self) -> scipy.sparse.csr_matrix:
        """Motion (size, n) of all degrees of freedom by the unknowns, at the last ones."""
        return self._reduction.maps.coupling()[:, self.independent]

    @property
    def Tv(self) -> scipy.sparse.csr_matrix:
        """Virtual motion (size, n) of all degrees of freedom by the unknowns, at the last ones."""
        return self._reduction.maps.coupling(virtual=True)[:, self.independent]

    def matrix(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix (n, n); each process has the rows of its unknowns."""
        sizes = ((len(self._own), self.size),) * 2
        return PETSc.Mat().createAIJ(sizes, csr=csr_of(self._rows(matrix)), comm=self.comm)

    def _rows(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        return matrix if self.comm.size == 1 else matrix[self._own][:, self._order]

    def assemble(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """The reduced tangent in PETSc."""
        return self.set_values(*csr_of(self._rows(matrix)))

    def set_values(self, indptr: np.ndarray, indices: np.ndarray, values: np.ndarray) -> PETSc.Mat:
        """The reduced tangent in PETSc, from compressed rows of this process."""
        same = all(map(np.array_equal, self._pattern, (indptr, indices)))
        if same and self.comm.size == 1:
            self.A.setValuesCSR(*self._pattern, values)
        else:
            self._pattern = indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType)
            self.A.setPreallocationCSR((*self._pattern, values))
        self.A.assemble()
        return self.A
