"""The unknowns of supports and joints in PETSc, to which vectors and matrices are reduced."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from fx_beam.fem.mesh import rotation_of
from fx_beam.scene.joints import GROUND

from .assembly import Assembly, csr_of

# Part of a unit for differences of the maps of joints.
_PART = 1e-6
# Degrees of freedom up to which matrices are arrays: operations on small arrays are quick.
_SMALL = 200


class SharedUnknowns:
    """Independent unknowns y (n,), shared by the processes, with the maps T and Tv."""

    def __init__(self, assembly: Assembly):
        self._assembly, self._comm = assembly, assembly.grid.comm
        self._reduction = assembly.model.reduction
        #: Numbers (n,) of y among all unknowns of the scene.
        self.independent = self._reduction.independent
        self.size = len(self.independent)

    def _share(self, touched: np.ndarray) -> None:
        """Number the unknowns in PETSc: the first process whose elements touch one has it."""
        comm, owner = self._comm, np.full(self.size, self._comm.size, dtype=np.int32)
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
        if self._comm.size == 1:
            return x.array_r
        values = np.empty(self.size)
        self._comm.Allgatherv(x.array_r, [values, self._counts])
        return values[self._numbers]

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
        return PETSc.Mat().createAIJ(sizes, csr=csr_of(self._rows(matrix)), comm=self._comm)

    def _rows(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        return matrix if self._comm.size == 1 else matrix[self._own][:, self._order]


class EqualUnknowns(SharedUnknowns):
    """Unknowns of supports and joints that only make degrees of freedom equal.

    Entries of matrices are summed, without products.
    """

    def __init__(self, assembly: Assembly):
        super().__init__(assembly)
        columns, n = self._reduction.couplings.column, self.size
        #: Unknown of each degree of freedom of the scene; n for one that is held.
        self._unknown = np.where(columns < n, columns, n).astype(int)
        touched = np.unique(assembly.fields.increment_numbers)
        self._share(np.setdiff1d(self._unknown[touched], n))
        self._find_places()
        #: The reduced tangent.
        self.A = self.matrix(self._summed(assembly.pattern))

    def _find_places(self) -> None:
        """Find the place in the reduced matrix of each entry of the scene's."""
        K, n = self._assembly.pattern.tocoo(), self.size
        rows, columns = self._unknown[K.row], self._unknown[K.col]
        keys = np.where((rows < n) & (columns < n), rows.astype(int) * n + columns, n * n)
        places, self._place = np.unique(keys, return_inverse=True)
        places = places[places < n * n]
        starts = np.searchsorted(places, n * np.arange(n + 1))
        self._sparsity = tuple(part.astype(PETSc.IntType) for part in (places % n, starts))

    def _summed(self, K: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """Entries of the scene's matrix added in the reduced one (n, n)."""
        count = len(self._sparsity[0])
        data = np.bincount(self._place, K.data, count)[:count]
        return scipy.sparse.csr_matrix((data, *self._sparsity), (self.size, self.size))

    def to_nodes(self, y: np.ndarray) -> np.ndarray:
        """Small motion (size,) of all degrees of freedom: T y, with T of the last tangent."""
        return np.append(y, 0.0)[self._unknown]

    def reduced_force(self, r: np.ndarray) -> np.ndarray:
        """Forces on the unknowns: Tv^T r."""
        return np.bincount(self._unknown, r, self.size + 1)[: self.size]

    def assemble(
        self, K: scipy.sparse.csr_matrix, y: np.ndarray, driven: np.ndarray, r: np.ndarray
    ) -> None:
        """Set A = Tv^T K T + (dTv/dy)^T r at increments y and `driven`, where the forces are r."""
        self.A.setValuesCSR(*csr_of(self._rows(self._summed(K))))
        self.A.assemble()


class JointUnknowns(SharedUnknowns):
    """Unknowns of all joints: matrices are products with T and Tv, which each process has."""

    def __init__(self, assembly: Assembly):
        super().__init__(assembly)
        self._moving = self._which_turn()
        self._share(np.unique(self.T[np.unique(assembly.fields.increment_numbers)].indices))
        #: The reduced tangent.
        self.A = self.matrix(scipy.sparse.identity(self.size, format="csr"))

    def to_nodes(self, y: np.ndarray) -> np.ndarray:
        """Small motion (size,) of all degrees of freedom: T y, with T of the last tangent."""
        return self._T @ y

    def reduced_force(self, r: np.ndarray) -> np.ndarray:
        """Forces on the unknowns: Tv^T r."""
        return self._reduction.maps.reduced_force(r)[self.independent]

    def assemble(
        self, K: scipy.sparse.csr_matrix, y: np.ndarray, driven: np.ndarray, r: np.ndarray
    ) -> None:
        """Set A = Tv^T K T + (dTv/dy)^T r at increments y and `driven`, where the forces are r."""
        small = self._assembly.model.size <= _SMALL
        Tv, K, self._T = (A.toarray() if small else A for A in (self.Tv, K, self.T))
        A = scipy.sparse.csr_matrix(Tv.T @ K @ self._T)
        if len(self._moving):
            A = A + self._slopes_of_maps(y, driven, r)
        self.A.setPreallocationCSR(csr_of(self._rows(A.tocsr())))
        self.A.assemble()

    def _slopes_of_maps(
        self, y: np.ndarray, driven: np.ndarray, r: np.ndarray
    ) -> scipy.sparse.csr_matrix:
        """(dTv/dy)^T r (n, n), with slopes of forces on slides, by central differences."""
        n, moving = self.size, self._moving
        slopes, units = np.zeros((n, len(moving))), self._assembly.model.units.unknowns
        for slope, unknown in zip(slopes.T, self.independent[moving], strict=True):
            for step in (_PART * units[unknown], -_PART * units[unknown]):
                place = y.copy()
                place[unknown] += step
                self._reduction.increment(place, driven)
                slope += self.reduced_force(r) / (2 * step)
        self._reduction.increment(y, driven)
        entries = slopes.ravel(), np.tile(moving, n), len(moving) * np.arange(n + 1)
        return scipy.sparse.csr_matrix(entries, (n, n))

    def _which_turn(self) -> np.ndarray:
        """Unknowns that turn arms of joints, close loops, move beams with sliders, or slide."""
        couplings, mesh = self._reduction.couplings, self._assembly.model.mesh
        T, loops = self._reduction.maps.coupling(closed=False), self._reduction.loops
        dofs = [rotation_of(joint.a) for joint in couplings.arm_joints if joint.a is not GROUND]
        for joint in couplings.sliding:
            nodes = mesh.nodes_of(self._assembly.model.scene, joint.beam)
            dofs += mesh.dofs[nodes].ravel().tolist()
        turning = np.zeros(T.shape[1], dtype=bool)
        turning[T[dofs].indices] = True
        turning[[*couplings.slides.values(), *self._assembly.model.points.columns]] = True
        if loops is not None:
            turning[loops.unknowns] = True
        return np.flatnonzero(turning[self.independent])


Unknowns = EqualUnknowns | JointUnknowns


def unknowns_of(assembly: Assembly) -> Unknowns:
    """The unknowns for the joints' present independent ones."""
    model = assembly.model
    special = model.scheme.rates.user_defined or model.points.members is not None
    direct = model.reduction.couplings.is_selection and not special
    return EqualUnknowns(assembly) if direct else JointUnknowns(assembly)
