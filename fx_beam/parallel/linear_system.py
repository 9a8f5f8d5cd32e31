"""The linear system of all processes, solved by PETSc."""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

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
# Of Newton's corrections, as in reused_factors.h and newton.h: errors relative to what the method
# leaves, and bounds of them relative to the correction.
_SHARE, _LARGEST, _LEAST = 0.1, 1e-3, 1e-12
#: Unknowns in a block, those of a node: blocks are factorised and substituted twice as fast.
BLOCK = 3
#: Options of the two kinds: overlapping parts with factors of each, or factors of the whole. With
#: an overlap of 8 nodes, about as far as a wave runs in a step, half as many iterations as with 2.
#: Solutions with a Schwarz preconditioner are as exact as Newton's method needs them, unless the
#: user sets "ksp_rtol", the error of a solution relative to it, in the preconditioner's norm.
KINDS = {
    "Schwarz": {
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
# What solves, by the type of PETSc's preconditioner.
_NAMES = {"asm": "Schwarz", "lu": "MUMPS"}


class Solved(NamedTuple):
    """Solution of a linear system."""

    #: Own unknowns; not finite if the system cannot be solved.
    x: np.ndarray
    #: How it was solved, in how many iterations.
    kind: str
    iterations: int
    #: Its size in the preconditioner's norm, and its error relative to it.
    size: float
    error: float


class LinearSystem:
    """GMRES on the exact tangent, preconditioned by that of an earlier one.

    The tangent is the sum of those of the parts, which stay where they are. Unknowns have places in
    blocks; `counts` are the numbers of places of all processes, `negligible` is an error of an
    unknown.
    """

    def __init__(self, counts: np.ndarray, kind: str, negligible: float):
        PETSc = petsc()
        here, first = int(counts[world().rank]), int(counts[: world().rank].sum())
        self._places = np.arange(first, first + here)
        #: How it is solved.
        self.kind = kind
        self._sizes = here, int(counts.sum())
        self._comm = PETSc.COMM_WORLD
        # Empty until all processes make them at once.
        self._b, self._x, self._ksp = PETSc.Vec(), PETSc.Vec(), PETSc.KSP()
        self._matrix, self._assembled = PETSc.Mat(), PETSc.Mat()
        self._accuracy = Accuracy(negligible * math.sqrt(counts.sum()))
        #: Norms of the first and the last residual in the last call, and its iterations.
        self._first = self._rest = 0.0
        self._last = 0
        #: Iterations for each decade with the preconditioner when it was new, 0 without one.
        self._new = 0.0

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
        keys, at = np.unique(keys, return_inverse=True)
        starts = np.searchsorted(keys, n * np.arange(n + 1))
        #: Values, of which those of empty places stay; positions of the part's, and of the others.
        self._entries = np.zeros(len(keys))
        self._entries[at[len(at) - len(empty) :]] = 1.0
        self._at: np.ndarray | slice = at[: len(rows)]
        self._at_more = at[len(rows) : len(at) - len(empty)]
        if (np.diff(self._at, prepend=-1) == 1).all():
            self._at = slice(len(rows))
        self._diagonal = np.flatnonzero(keys // n == keys % n)
        self._rows = tuple(part.astype(PETSc.IntType) for part in (starts, keys % n))
        map_ = PETSc.LGMap().create(numbers.astype(PETSc.IntType), comm=self._comm)
        # PETSc uses these arrays directly, without copies.
        arrays = *self._rows, self._entries
        self._own = PETSc.Mat().createAIJWithArrays((n, n), arrays, comm=PETSc.COMM_SELF)
        for old in (self._matrix, self._b, self._x):
            old.destroy()
        self._matrix = PETSc.Mat().createIS(
            (self._sizes, self._sizes), lgmapr=map_, lgmapc=map_, comm=self._comm
        )
        self._matrix.setISLocalMat(self._own)
        self._x, self._b = self._matrix.createVecs()
        self._new = 0

    def begin(self) -> None:
        """Before the first correction of a step."""
        self._accuracy.begin()

    def solve(
        self, values: np.ndarray, more: np.ndarray, b: np.ndarray, least: float = np.inf
    ) -> Solved:
        """Own unknowns, for values of the part and of the other entries; all processes at once.

        `least` is an error of all unknowns whose energy is negligible.
        """
        self._least = least
        self._entries[self._at_more] = 0.0
        self._entries[self._at] = values
        np.add.at(self._entries, self._at_more, more)
        # First of all: processes wait for each other, and signals arrive.
        still_good = self._still_serves()
        self._own.stateIncrease()
        self._matrix.assemble()
        self._b.setArray(b)
        if not ((still_good and self._run()) or self._renewed()):
            self._new = 0.0
            return Solved(np.full(self._sizes[0], np.nan), self._name, self._last, 0.0, np.inf)
        self._accuracy.note(self._first, self._rest)
        error = self._rest / self._first if self._first else 0.0
        return Solved(self._x.getArray().copy(), self._name, self._last, self._first, error)

    def _renewed(self) -> bool:
        """Whether a new preconditioner solves the system."""
        for kind in dict.fromkeys([self.kind, "MUMPS"]):
            self.kind = kind
            self._precondition()
            if self._run() and (self._last <= _MOST or kind == "MUMPS"):
                self._new = self._last / max(self._decades, 1.0)
                return True
        return False

    def _still_serves(self) -> bool:
        """Whether the last preconditioner still serves."""
        alike = False
        if self._new and self._last <= _WORN * self._new * self._decades + _MORE:
            now, was = abs(self._entries[self._diagonal]), abs(self._was)
            alike = bool(((now <= _CHANGED * was) & (was <= _CHANGED * now)).all())
        return world().allreduce(int(alike)) == world().size

    @property
    def _name(self) -> str:
        """How systems are solved now."""
        kind = self._ksp.getPC().getType()
        return _NAMES.get(kind, kind)

    def _run(self) -> bool:
        """Whether GMRES finds the solution."""
        self._released("KSPSolve", self._ksp, self._b, self._x)
        self._last = max(self._ksp.getIterationNumber(), 1)
        return self._ksp.getConvergedReason() > 0

    def _judge(self, ksp: Any, iteration: int, norm: float) -> Any:
        """Whether a residual, in the preconditioner's norm, is small enough."""
        if not iteration:
            self._first = norm
        self._rest = norm
        reasons = petsc().KSP.ConvergedReason
        if not math.isfinite(norm):
            return reasons.DIVERGED_NANORINF
        wanted = ksp.rtol * self._first
        if self._is_free:
            wanted = self._accuracy.allowed(self._first, self._least)
        return reasons.CONVERGED_RTOL if norm <= wanted else reasons.ITERATING

    @property
    def _decades(self) -> float:
        """By how many powers of ten the residual fell in the last call."""
        return math.log10(self._first / self._rest) if self._rest else 16.0

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
        self._ksp.destroy()
        self._assembled.destroy()
        options, defaults = PETSc.Options(_PREFIX), KINDS[self.kind]
        self._was = self._entries[self._diagonal]
        self._assembled = self._sum_of_parts()
        self._ksp = ksp = PETSc.KSP().create(self._comm)
        ours = {n: value for n, value in defaults.items() if not options.hasName(n)}
        for name, value in ours.items():
            options.setValue(name, value)
        ksp.setOptionsPrefix(_PREFIX)
        ksp.setType("gmres")
        ksp.setGMRESRestart(_MOST)
        ksp.setTolerances(atol=0.0, divtol=1e30, max_it=2 * _MOST)
        ksp.setOperators(self._matrix, self._assembled)
        ksp.setFromOptions()
        self._is_free = self.kind == "Schwarz" and not options.hasName("ksp_rtol")
        ksp.setConvergenceTest(self._judge)
        self._released("KSPSetUp", ksp)
        if self.kind == "Schwarz":
            self._released("KSPSetUpOnBlocks", ksp)
        ksp.getPC().setReusePreconditioner(True)
        for name in ours:
            options.delValue(name)

    def _sum_of_parts(self) -> Any:
        """The tangent as one matrix, of which each process has its rows."""
        PETSc = petsc()
        matrix = PETSc.Mat()
        self._matrix.convert("aij", matrix)
        if self.kind != "Schwarz":
            return matrix
        # In blocks: PETSc's own conversion takes a time like the square of their number.
        starts, columns, values = matrix.getValuesCSR()
        matrix.destroy()
        rows = scipy.sparse.csr_matrix((values, columns, starts), self._sizes)
        rows = rows.tobsr((BLOCK, BLOCK))
        parts = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
        return PETSc.Mat().createBAIJ([self._sizes] * 2, BLOCK, csr=parts, comm=self._comm)

    def destroy(self) -> None:
        """Free PETSc's objects; all processes at once."""
        for thing in (self._ksp, self._assembled, self._matrix, self._b, self._x):
            thing.destroy()


class Accuracy:
    """Bounds of the errors of corrections, by the quadratic convergence of this step and the last.

    `least` is an error that is negligible anyway, in the norm of the corrections.
    """

    def __init__(self, least: float):
        self._least = least
        self._slowest = 0.0
        self.begin()

    def begin(self) -> None:
        """Before the first correction of a step."""
        self._slowest_before, self._slowest = self._slowest, 0.0
        #: Size of the last correction, and its error.
        self._last, self._left = np.inf, 0.0

    def allowed(self, size: float, least: float) -> float:
        """Error that the next correction may have, for its size.

        `least` is one whose energy is negligible.
        """
        quadratic = _SHARE * max(self._slowest, self._slowest_before) * size
        floor = min(_SHARE * self._least, least)
        return max(floor, min(_LARGEST, max(quadratic, _LEAST)) * size)

    def note(self, size: float, error: float) -> None:
        """After a correction of some size with an error, which the next one corrects as well."""
        if 100 * self._left < size < self._last < np.inf:
            self._slowest = max(self._slowest, size / self._last**2)
        self._last, self._left = size, error
