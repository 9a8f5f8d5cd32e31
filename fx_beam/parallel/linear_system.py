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
#: Unknowns in a block, one block for a node: this makes factors and solutions twice as fast.
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
    #: Size of x in the preconditioner's norm, and error of x relative to this size.
    size: float
    error: float


class PartMatrix:
    """The tangent of one part as a matrix of PETSc, which uses its values without a copy.

    It has the unknowns of the part, entries between them, and (m, 2) `more` of the whole.
    Places without an unknown have a one on the diagonal.
    """

    def __init__(
        self,
        places: np.ndarray,
        unknowns: np.ndarray,
        rows: np.ndarray,
        columns: np.ndarray,
        added: np.ndarray,
    ):
        PETSc = petsc()
        numbers = np.concatenate([unknowns, np.setdiff1d(added, unknowns)])
        empty = np.setdiff1d(places, numbers)
        numbers = np.concatenate([numbers, empty])
        order, n = np.argsort(numbers), len(numbers)
        added = order[np.searchsorted(numbers, added, sorter=order)].reshape(-1, 2)
        diagonal = np.arange(n - len(empty), n) * (n + 1)
        keys = np.concatenate([rows * n + columns, added[:, 0] * n + added[:, 1], diagonal])
        keys, positions = np.unique(keys, return_inverse=True)
        starts = np.searchsorted(keys, n * np.arange(n + 1))
        self._values = np.zeros(len(keys))
        self._values[positions[len(positions) - len(empty) :]] = 1.0
        #: Positions of the part's values, and of the values of `added` entries.
        self._own: np.ndarray | slice = positions[: len(rows)]
        self._more = positions[len(rows) : len(positions) - len(empty)]
        if (np.diff(self._own, prepend=-1) == 1).all():
            self._own = slice(len(rows))
        self._diagonal = np.flatnonzero(keys // n == keys % n)
        self._rows = tuple(part.astype(PETSc.IntType) for part in (starts, keys % n))
        #: Numbers of the rows in the whole matrix.
        self.numbers = numbers.astype(PETSc.IntType)
        arrays = *self._rows, self._values
        #: The matrix in PETSc.
        self.matrix = PETSc.Mat().createAIJWithArrays((n, n), arrays, comm=PETSc.COMM_SELF)

    @property
    def diagonal(self) -> np.ndarray:
        """A copy of the diagonal (n,)."""
        return self._values[self._diagonal]

    def set(self, values: np.ndarray, added_values: np.ndarray) -> None:
        """Set the part's values, and the `added_values` of the other entries."""
        self._values[self._more] = 0.0
        self._values[self._own] = values
        np.add.at(self._values, self._more, added_values)


class Solver:
    """GMRES with the factors of an earlier tangent, as PETSc's options say."""

    def __init__(self, kind: str, accuracy: Accuracy):
        #: Kind of factors that is tried first, and its name with the user's options.
        self.kind, self.name = kind, ""
        self._accuracy = accuracy
        # Empty until all processes make them at once.
        self._ksp, self._assembled = petsc().KSP(), petsc().Mat()
        #: Norms of the first and the last residual, and iterations, of the last call.
        self.first = self.rest = 0.0
        self.iterations = 0
        self._least = np.inf

    @property
    def decades(self) -> float:
        """By how many powers of ten the residual fell in the last call."""
        return math.log10(self.first / self.rest) if self.rest else 16.0

    def run(self, b: Any, x: Any, least: float) -> bool:
        """Whether the solution is found; an error of the size `least` is negligible."""
        self._least = least
        _released("KSPSolve", self._ksp, b, x)
        self.iterations = max(self._ksp.getIterationNumber(), 1)
        return self._ksp.getConvergedReason() > 0

    def _judge(self, ksp: Any, iteration: int, norm: float) -> Any:
        """Whether a residual, in the preconditioner's norm, is small enough."""
        if not iteration:
            self.first = norm
        self.rest = norm
        reasons = petsc().KSP.ConvergedReason
        if not math.isfinite(norm):
            return reasons.DIVERGED_NANORINF
        allowed = ksp.rtol * self.first
        if self._is_free:
            allowed = self._accuracy.allowed(self.first, self._least)
        return reasons.CONVERGED_RTOL if norm <= allowed else reasons.ITERATING

    def factorise(self, matrix: Any) -> None:
        """Make new factors of a matrix."""
        PETSc = petsc()
        self.destroy()
        options, defaults = PETSc.Options(_PREFIX), KINDS[self.kind]
        self._assembled = _assembled(matrix, in_blocks=self.kind == "Schwarz")
        self._ksp = ksp = PETSc.KSP().create(PETSc.COMM_WORLD)
        applied = {n: value for n, value in defaults.items() if not options.hasName(n)}
        for name, value in applied.items():
            options.setValue(name, value)
        ksp.setOptionsPrefix(_PREFIX)
        ksp.setType("gmres")
        ksp.setGMRESRestart(_MOST)
        ksp.setTolerances(atol=0.0, divtol=1e30, max_it=2 * _MOST)
        ksp.setOperators(matrix, self._assembled)
        ksp.setFromOptions()
        self._is_free = self.kind == "Schwarz" and not options.hasName("ksp_rtol")
        ksp.setConvergenceTest(self._judge)
        _released("KSPSetUp", ksp)
        if self.kind == "Schwarz":
            _released("KSPSetUpOnBlocks", ksp)
        ksp.getPC().setReusePreconditioner(True)
        for name in applied:
            options.delValue(name)
        kind = ksp.getPC().getType()
        self.name = _NAMES.get(kind, kind)

    def destroy(self) -> None:
        """Free PETSc's objects; all processes at once."""
        self._ksp.destroy()
        self._assembled.destroy()


class LinearSystem:
    """The sum of the tangents of the parts, which stay where they are, solved by all at once.

    Unknowns have places in blocks; `counts` are the numbers of places of all processes,
    `negligible` is an error of an unknown.
    """

    def __init__(self, counts: np.ndarray, kind: str, negligible: float):
        PETSc = petsc()
        own_count, first = int(counts[world().rank]), int(counts[: world().rank].sum())
        self._places = np.arange(first, first + own_count)
        self._sizes = own_count, int(counts.sum())
        # Empty until all processes make them at once.
        self._b, self._x, self._matrix = PETSc.Vec(), PETSc.Vec(), PETSc.Mat()
        self._accuracy = Accuracy(negligible * math.sqrt(counts.sum()))
        self._solver = Solver(kind, self._accuracy)
        #: Iterations for each decade when the factors were new, 0 without factors; and the diagonal
        #: of the matrix that was factorised.
        self._new, self._factorised = 0.0, np.empty(0)

    def set_pattern(
        self, unknowns: np.ndarray, rows: np.ndarray, columns: np.ndarray, added: np.ndarray
    ) -> None:
        """Set numbers of unknowns, entries between them, and (m, 2) `added` entries of the whole.

        All processes at once.
        """
        PETSc, comm = petsc(), petsc().COMM_WORLD
        self._part = PartMatrix(self._places, unknowns, rows, columns, added)
        map_ = PETSc.LGMap().create(self._part.numbers, comm=comm)
        for old in (self._matrix, self._b, self._x):
            old.destroy()
        self._matrix = PETSc.Mat().createIS([self._sizes] * 2, lgmapr=map_, lgmapc=map_, comm=comm)
        self._matrix.setISLocalMat(self._part.matrix)
        self._x, self._b = self._matrix.createVecs()
        self._new = 0.0

    def begin(self) -> None:
        """Before the first correction of a step."""
        self._accuracy.begin()

    def solve(
        self, values: np.ndarray, added_values: np.ndarray, b: np.ndarray, least: float = np.inf
    ) -> Solved:
        """Unknowns of this process by values of entries and `added_values`; all processes at once.

        An error of the size `least` has a negligible energy.
        """
        self._part.set(values, added_values)
        # At first: processes wait for each other here, and signals arrive.
        still_good = self._still_serves()
        self._part.matrix.stateIncrease()
        self._matrix.assemble()
        self._b.setArray(b)
        solver = self._solver
        if not ((still_good and self._run(least)) or self._renewed(least)):
            self._new = 0.0
            none = np.full(self._sizes[0], np.nan)
            return Solved(none, solver.name, solver.iterations, 0.0, np.inf)
        self._accuracy.note(solver.first, solver.rest)
        error = solver.rest / solver.first if solver.first else 0.0
        x = self._x.getArray().copy()
        return Solved(x, solver.name, solver.iterations, solver.first, error)

    def _run(self, least: float) -> bool:
        return self._solver.run(self._b, self._x, least)

    def _renewed(self, least: float) -> bool:
        """Whether the system is solved with new factors."""
        solver = self._solver
        for kind in dict.fromkeys([solver.kind, "MUMPS"]):
            solver.kind = kind
            self._factorised = self._part.diagonal
            solver.factorise(self._matrix)
            if self._run(least) and (solver.iterations <= _MOST or kind == "MUMPS"):
                self._new = solver.iterations / max(solver.decades, 1.0)
                return True
        return False

    def _still_serves(self) -> bool:
        """Whether the last factors still serve, on all processes."""
        alike, solver = False, self._solver
        if self._new and solver.iterations <= _WORN * self._new * solver.decades + _MORE:
            new, old = abs(self._part.diagonal), abs(self._factorised)
            alike = bool(((new <= _CHANGED * old) & (old <= _CHANGED * new)).all())
        return world().allreduce(int(alike)) == world().size

    def destroy(self) -> None:
        """Free PETSc's objects; all processes at once."""
        self._solver.destroy()
        for petsc_object in (self._matrix, self._b, self._x):
            petsc_object.destroy()


def _assembled(matrix: Any, in_blocks: bool) -> Any:
    """The tangent as one matrix; each process has the rows of its places."""
    PETSc, rows = petsc(), petsc().Mat()
    matrix.convert("aij", rows)
    if not in_blocks:
        return rows
    # In blocks: PETSc's own conversion takes a time like the square of their number.
    starts, columns, values = rows.getValuesCSR()
    sizes = rows.getSizes()
    rows.destroy()
    blocks = scipy.sparse.csr_matrix((values, columns, starts), sizes[0]).tobsr((BLOCK, BLOCK))
    parts = blocks.indptr.astype(PETSc.IntType), blocks.indices.astype(PETSc.IntType), blocks.data
    return PETSc.Mat().createBAIJ(sizes, BLOCK, csr=parts, comm=PETSc.COMM_WORLD)


def _released(name: str, *objects: Any) -> None:
    """Call a function of PETSc and let signals arrive meanwhile: petsc4py keeps Python's lock.

    Here a process waits for another one, which may have been killed.
    """
    PETSc = petsc()
    function = ctypes.CDLL(PETSc.__file__)[name]
    if code := function(*(ctypes.c_void_p(petsc_object.handle) for petsc_object in objects)):
        raise PETSc.Error(code)


class Accuracy:
    """Bounds of the errors of corrections, by the quadratic convergence of this step and the last.

    An error of the size `least`, in the norm of the corrections, is always negligible.
    """

    def __init__(self, least: float):
        self._least = least
        self._slowest = 0.0
        self.begin()

    def begin(self) -> None:
        """Before the first correction of a step."""
        self._slowest_before, self._slowest = self._slowest, 0.0
        #: Size of the last correction, and the error in it.
        self._last, self._left = np.inf, 0.0

    def allowed(self, size: float, least: float) -> float:
        """Error that a correction of a size may have; one of the size `least` is negligible."""
        quadratic = _SHARE * max(self._slowest, self._slowest_before) * size
        floor = min(_SHARE * self._least, least)
        return max(floor, min(_LARGEST, max(quadratic, _LEAST)) * size)

    def note(self, size: float, error: float) -> None:
        """After a correction of some size with an error, which the next one corrects as well."""
        if 100 * self._left < size < self._last < np.inf:
            self._slowest = max(self._slowest, size / self._last**2)
        self._last, self._left = size, error
