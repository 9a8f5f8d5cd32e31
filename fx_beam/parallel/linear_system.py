"""The linear system of all processes, solved by PETSc."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from fx_beam.fem.mpi import petsc, world

# Prefix of PETSc's options: PETSC_OPTIONS="-fx_beam_pc_asm_overlap 4".
_PREFIX = "fx_beam_"
# Iterations beyond which a new preconditioner of a kind is given up for factors of all.
_MOST = 80
# A kept preconditioner is made anew when it needs so many times the iterations of a new one, and
# some more.
_WORN, _MORE = 2, 6
# Change of an entry of a part's diagonal, as by steps of another length, after which residuals in
# the norm of a kept preconditioner say little about the solution.
_CHANGED = 1e4
#: Unknowns in a block, those of a node: blocks are factorised and substituted twice as fast.
BLOCK = 3
#: Options of the two kinds: overlapping parts with factors of each, or factors of the whole. With
#: an overlap of 8 nodes, about as far as a wave runs in a step, half as many iterations as with 2.
#: "ksp_rtol" is the largest error of a solution, relative to it, in the preconditioner's norm.
KINDS = {
    "Schwarz": {
        "ksp_rtol": "1e-7",
        "pc_type": "asm",
        "pc_asm_overlap": "8",
        "sub_ksp_type": "preonly",
        "sub_pc_type": "lu",
        "sub_pc_factor_mat_ordering_type": "nd",
    },
    "MUMPS": {
        "ksp_rtol": "1e-12",
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": "60",
    },
}


class LinearSystem:
    """GMRES on the exact tangent, preconditioned by that of an earlier one.

    The tangent is the sum of those of the parts, which stay where they are. Unknowns have places in
    blocks; `counts` are the numbers of places of all processes.
    """

    def __init__(self, counts: np.ndarray, kind: str):
        PETSc = petsc()
        own, first = int(counts[world().rank]), int(counts[: world().rank].sum())
        self._places = np.arange(first, first + own)
        #: How it is solved.
        self.kind = kind
        self._sizes = own, int(counts.sum())
        self._comm = PETSc.COMM_WORLD
        self._b = PETSc.Vec().createMPI(self._sizes, comm=self._comm)
        self._x = self._b.duplicate()
        self._matrix: Any = None
        self._assembled: Any = None
        self._ksp: Any = None
        #: Iterations with the preconditioner when it was new, 0 without one; and in the last call.
        self._new = self._last = 0

    def set_pattern(
        self, numbers: np.ndarray, rows: np.ndarray, columns: np.ndarray, more: np.ndarray
    ) -> None:
        """Set the unknowns of this part, its entries between them, and (m, 2) more of the whole.

        All processes at once.
        """
        PETSc = petsc()
        numbers = np.concatenate([numbers, np.setdiff1d(more, numbers)])
        empty = np.setdiff1d(self._places, numbers)
        numbers = np.concatenate([numbers, empty])
        order, n = np.argsort(numbers), len(numbers)
        more = order[np.searchsorted(numbers, more, sorter=order)].reshape(-1, 2)
        ones = np.arange(n - len(empty), n) * (n + 1)
        keys = np.concatenate([rows * n + columns, more[:, 0] * n + more[:, 1], ones])
        keys, self._at = np.unique(keys, return_inverse=True)
        #: Values of empty places.
        self._ones = np.ones(len(empty))
        starts = np.searchsorted(keys, n * np.arange(n + 1))
        self._entries = np.zeros(len(keys))
        self._diagonal = np.flatnonzero(keys // n == keys % n)
        self._rows = tuple(part.astype(PETSc.IntType) for part in (starts, keys % n))
        map_ = PETSc.LGMap().create(numbers.astype(PETSc.IntType), comm=self._comm)
        # PETSc uses these arrays directly, without copies.
        self._own = PETSc.Mat().createAIJWithArrays(
            (n, n), (*self._rows, self._entries), comm=PETSc.COMM_SELF
        )
        if self._matrix is not None:
            self._matrix.destroy()
        self._matrix = PETSc.Mat().createIS(
            (self._sizes, self._sizes), lgmapr=map_, lgmapc=map_, comm=self._comm
        )
        self._matrix.setISLocalMat(self._own)
        self._new = 0

    def solve(
        self, values: np.ndarray, more: np.ndarray, b: np.ndarray
    ) -> tuple[np.ndarray, str, int]:
        """Own unknowns, for values of the part and of the other entries; all processes at once.

        Not finite if the system cannot be solved. Also how it was solved, in how many iterations.
        """
        values = np.concatenate([values, more, self._ones])
        self._entries[:] = np.bincount(self._at, values, len(self._entries))
        kept = self._is_kept()  # first of all: processes wait for each other, and signals arrive
        self._own.stateIncrease()
        self._matrix.assemble()
        self._b.setArray(b)
        if not ((kept and self._run()) or self._renewed()):
            self._new = 0
            return np.full(self._sizes[0], np.nan), self.kind, self._last
        return self._x.getArray().copy(), self.kind, self._last

    def _renewed(self) -> bool:
        """Whether a new preconditioner solves the system."""
        for kind in dict.fromkeys([self.kind, "MUMPS"]):
            self.kind = kind
            self._precondition()
            if self._run() and (self._last <= _MOST or kind == "MUMPS"):
                self._new = self._last
                return True
        return False

    def _is_kept(self) -> bool:
        """Whether the last preconditioner still serves."""
        alike = False
        if self._new and self._last <= _WORN * self._new + _MORE:
            now, was = abs(self._entries[self._diagonal]), abs(self._was)
            alike = bool(((now <= _CHANGED * was) & (was <= _CHANGED * now)).all())
        return world().allreduce(int(alike)) == world().size

    def _run(self) -> bool:
        """Whether GMRES finds the solution."""
        self._released("KSPSolve", self._ksp, self._b, self._x)
        self._last = max(self._ksp.getIterationNumber(), 1)
        return self._ksp.getConvergedReason() > 0

    @staticmethod
    def _released(name: str, *objects: Any) -> None:
        """Call a function of PETSc and let signals arrive meanwhile: petsc4py keeps Python's lock.

        Here a process waits for another one, which may have been killed.
        """
        PETSc = petsc()
        function = ctypes.CDLL(PETSc.__file__)[name]
        if code := function(*(ctypes.c_void_p(one.handle) for one in objects)):
            raise PETSc.Error(code)

    def _precondition(self) -> None:
        """Make the preconditioner of the present tangent."""
        PETSc = petsc()
        if self._ksp is not None:
            self._ksp.destroy()
            self._assembled.destroy()
        self._assembled = PETSc.Mat()
        self._matrix.convert("aij", self._assembled)
        if self.kind == "Schwarz":
            self._assembled.setBlockSize(BLOCK)
            self._assembled.convert("baij")
        self._was = self._entries[self._diagonal]
        self._ksp = ksp = PETSc.KSP().create(self._comm)
        options = PETSc.Options(_PREFIX)
        ours = {n: value for n, value in KINDS[self.kind].items() if not options.hasName(n)}
        for name, value in ours.items():
            options.setValue(name, value)
        ksp.setOptionsPrefix(_PREFIX)
        ksp.setType("gmres")
        ksp.setGMRESRestart(_MOST)
        ksp.setTolerances(atol=0.0, divtol=1e30, max_it=2 * _MOST)
        ksp.setOperators(self._matrix, self._assembled)
        ksp.setFromOptions()
        self._released("KSPSetUp", ksp)
        if self.kind == "Schwarz":
            self._released("KSPSetUpOnBlocks", ksp)
        ksp.getPC().setReusePreconditioner(True)
        for name in ours:
            options.delValue(name)

    def destroy(self) -> None:
        """Free PETSc's objects; all processes at once."""
        for thing in (self._ksp, self._assembled, self._matrix, self._b, self._x):
            if thing is not None:
                thing.destroy()
