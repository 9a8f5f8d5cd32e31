"""Newton's method of PETSc for the unknowns y of joints and supports: Tv(y)^T r(g(y)) = 0."""

from __future__ import annotations

import itertools
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from fx_beam.fem.mesh import rotation_of
from fx_beam.laws.interval import Interval
from fx_beam.scene.joints import GROUND
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import LONGEST_TURN, NewtonOptions

from .form import StepForm, csr_of

# Corrections that no longer decrease below this are round-off, in units of the scene.
_STALLED = 1e-6
# Part of a unit for differences of the maps of joints.
_PART = 1e-6
# Unknowns from which on MUMPS is faster than PETSc's own factors.
_MANY = 20_000
_OPTIONS = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",
    "ksp_type": "preonly",
    "pc_type": "lu",
}
# Degrees of freedom up to which matrices are arrays: operations on small arrays are quick.
_SMALL = 200
_TOLERANCES = {"snes_rtol", "snes_atol", "snes_stol"}
_numbers = itertools.count()


class Numbering:
    """Numbers of unknowns in PETSc: each process has those that only its cells touch, and others.

    `touched` are those (n,) that cells of this process touch.
    """

    def __init__(self, comm: MPI.Comm, size: int, touched: np.ndarray):
        self._comm, owner = comm, np.full(size, comm.size, dtype=np.int32)
        owner[touched] = comm.rank
        comm.Allreduce(MPI.IN_PLACE, owner, MPI.MIN)
        owner[owner == comm.size] = 0
        order = np.argsort(owner, kind="stable")
        #: Number in PETSc of each.
        self.numbers = np.empty(size, dtype=PETSc.IntType)
        self.numbers[order] = np.arange(size)
        self._counts = np.bincount(owner, minlength=comm.size)
        first = int(self._counts[: comm.rank].sum())
        #: Those of this process, in PETSc's order.
        self.own = order[first : first + self._counts[comm.rank]]
        self._order = order

    def matrix(self, pattern: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix (n, n) of a pattern, of which each process has its rows."""
        sizes = (len(self.own), len(self.numbers)), (len(self.own), len(self.numbers))
        return PETSc.Mat().createAIJ(sizes, csr=csr_of(self.rows(pattern)), comm=self._comm)

    def rows(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The rows of this process, in PETSc's order of rows and columns."""
        return matrix if self._comm.size == 1 else matrix[self.own][:, self._order].tocsr()

    def all(self, x: PETSc.Vec) -> np.ndarray:
        """All values of a vector on each process, in the order of the scene."""
        if self._comm.size == 1:
            return x.array_r
        values = np.empty(len(self.numbers))
        self._comm.Allgatherv(x.array_r, [values, self._counts])
        return values[self.numbers]


class Sums:
    """A sparse matrix (n, n) of sums of values; those whose row or column is n are left out."""

    def __init__(self, rows: np.ndarray, columns: np.ndarray, n: int):
        keys = np.where((rows < n) & (columns < n), rows * n + columns, n * n)
        places, self._place = np.unique(keys, return_inverse=True)
        places = places[places < n * n]
        self._n, self._indices = n, (places % n).astype(PETSc.IntType)
        self._indptr = np.searchsorted(places, n * np.arange(n + 1)).astype(PETSc.IntType)

    def matrix(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """The matrix, of values in the order of rows and columns."""
        count = len(self._indices)
        data = np.bincount(self._place, values, count)[:count]
        return scipy.sparse.csr_matrix((data, self._indices, self._indptr), (self._n, self._n))


class Newton:
    """Finds the increments of steps by SNES, for the loop of the engine.

    That one has the state, and all that is known from an increment: rates, work, forces of joints,
    records.
    """

    def __init__(
        self, form: StepForm, loop: CompiledLoop, newton: NewtonOptions, options: dict[str, Any]
    ):
        self.form, self.model, self._options = form, loop.model, options
        self._newton, self._loop, self._comm = newton, loop, form.comm
        self.reduction, self._rates = loop.model.reduction, loop.model.scheme.rates
        #: Solver of the last step; None before the first one.
        self.snes: PETSc.SNES | None = None
        #: Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self.natural: np.ndarray | None = None
        p, n = loop.problem, loop.model.size
        self._c = p.c
        results = p.results(z=self.reduction.columns, r=n, f=n, D=n)
        self._z, self._r, self._f, self._D = results
        self._force, _, self._strains = p.given()
        #: Directly in the numbers of unknowns: supports and joints only make unknowns equal.
        self._members = loop.model.points.members
        special = self._rates.of_user or self._members is not None
        self._direct = self.reduction.equates and not special
        self._independent = np.empty(0, dtype=int)
        self._pattern = form._pattern
        # End of the last step [s], and forces of added terms in it.
        self._before: tuple[float, Any] = (np.nan, None)
        loop.find_by(self._find)

    # -- A step ------------------------------------------------------------------------------------

    def _find(self, dt: float) -> int:
        """The increment of a sub-step, from the state in the memory of C, and into it."""
        model, loop, free = self.model, self._loop, self.reduction.free
        p, at_rest = self._c, self._rates.at_rest
        state = self.state = loop.state(p.t)
        interval = Interval(p.ratio_before, p.ratio) if at_rest else Interval(p.t, p.t + dt)
        self.interval = interval
        self.reduction.begin(state.q, state.slides)
        if self.natural is not None:
            self._strains[:] = self.natural.ravel()
        natural = self._strains.reshape(model.natural.shape) if model.natural else None
        self.form._begin(interval, state, natural)
        self._y, self._driven = self._z[:free].copy(), self._z[free : free + self.reduction.driven]
        if self.snes is None or not np.array_equal(self.reduction.independent, self._independent):
            self._create_solver()
        x = self._A.createVecRight()
        x.array[:] = self._y[self._independent][self._unknowns.own]
        self._last, p.tried = np.inf, 0
        self._failure = loop.problem.constants.NO_CONVERGENCE
        assert self.snes is not None
        self.snes.solve(None, x)
        self.iterations = self.snes.getIterationNumber()
        p.iterations += self.iterations
        PETSc.garbage_cleanup(self._comm)  # petsc4py 3.18 keeps what nothing refers to
        if self.snes.getConvergedReason() < 0:
            return self._failure
        if not np.array_equal(self._y[self._independent], y := self._unknowns.all(x)):
            self._forces(y)  # a line search came back
        self._z[:free], self._r[:], self._f[:] = self._y, self.r, self._internal
        p.work -= self._mean(p.t, dt) @ self._path
        return 0

    def _mean(self, t: float, dt: float) -> np.ndarray:
        """Forces of added terms (size,) in the middle of the step, from those at levels of steps."""
        level, (end, before) = self._rates.level, self._before
        self._before = t + dt, self.added
        if level == 0.5 or not np.isclose(end, t, rtol=1e-12, atol=1e-9 * abs(dt)):
            return self.added
        return self.added + (0.5 - level) * (self.added - before)

    def _forces(self, x: np.ndarray) -> np.ndarray:
        """All forces r (size,) at the unknowns."""
        model, rates, state, dt = self.model, self._rates, self.state, self.interval.length
        self._y[self._independent] = x
        D = self.reduction.expand(self._y, self._driven)
        if not abs(D[model.turns]).max() <= self._newton.max_turn:
            constants, closed = self._loop.problem.constants, np.isfinite(D).all()
            self._failure = constants.TURNED_TOO_FAR if closed else constants.OPEN_LOOP
            self._D[:] = D
            self.r = np.full(model.size, np.nan)
            return self.r
        self._path, self._slope = rates.work_increment(D, model.turns)
        self._internal, self.added = self.form._residual(D)
        r = self.r = self._internal + self.added - self._force
        if not rates.at_rest:
            r += self.form.mass @ self._acceleration(D, state, dt)
        model.points.add_force(D, r)
        return r

    def _acceleration(self, D: np.ndarray, state: Any, dt: float) -> np.ndarray:
        rules = self.model.nodal_rules
        if not rules:
            given = self._path, state.v, state.a, dt
            acceleration, self._steepness = self._rates.acceleration(*given)
            return acceleration
        past = state.q - (state.q if state.q_previous is None else state.q_previous)
        nodes = self.model.mesh.dofs
        of_nodes = (x[nodes] for x in (D, state.v, state.a, past))
        given = np.hstack([*of_nodes, np.full((len(nodes), 1), dt)])
        values = rules[self._c.sub_step % len(rules)].in_rows(given)
        self._by_increment = values[:, 3:12].reshape(-1, 3, 3)
        return values[:, :3].ravel()

    # -- About the last state ----------------------------------------------------------------------

    def reduced(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """Tv^T A T (n, n) of a matrix of all degrees of freedom, in the order of unknowns."""
        return (self.Tv.T @ matrix @ self.T).tocsr()

    def tangent(self) -> scipy.sparse.csr_matrix:
        """The reduced tangent (n, n) at the last unknowns, on one process."""
        indptr, indices, data = self.assembled().getValuesCSR()
        return scipy.sparse.csr_matrix((data, indices, indptr), (len(indptr) - 1,) * 2)

    def assembled(self) -> PETSc.Mat:
        """The same as PETSc has it."""
        self._J(self.snes, None, self._A, self._A)
        return self._A

    def shared(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix of unknowns, of which each process has its rows."""
        return self._unknowns.matrix(matrix)

    # -- PETSc's solver ----------------------------------------------------------------------------

    def _create_solver(self) -> None:
        self._independent = independent = self.reduction.independent
        n, touched = len(independent), np.unique(self.form._of_D)
        if self._direct:
            columns = self.reduction.couplings.column
            self._at = at = np.where(columns < self.reduction.free, columns, n)
            touched = np.unique(at[touched])
            self._unknowns = Numbering(self._comm, n, touched[touched < n])
            numbers = np.append(self._unknowns.numbers, -1).astype(PETSc.IntType)[at]
            self._map = PETSc.LGMap().create(numbers[self.form._of_D], comm=MPI.COMM_SELF)
            K = self._pattern.tocoo()
            self._sums = Sums(at[K.row], at[K.col], n)
            pattern = self._sums.matrix(np.zeros(K.nnz))
        else:
            self._moving = self._which_turn()
            T = self.T
            self._unknowns = Numbering(self._comm, n, np.unique(T[touched].indices))
            pattern = scipy.sparse.identity(n, format="csr")
        self._A = self._unknowns.matrix(pattern)
        self.snes = snes = PETSc.SNES().create(self._comm)
        snes.setFunction(self._F, self._A.createVecLeft())
        snes.setJacobian(self._J, self._A)
        snes.setLineSearchPreCheck(self._shorten)
        if not _TOLERANCES & self._options.keys():
            snes.setConvergenceTest(self._converged)
        options, prefix = PETSc.Options(), f"fx_beam_{next(_numbers)}_"
        defaults = _OPTIONS | {"snes_max_it": self._newton.max_iterations}
        if self._comm.size > 1 or n > _MANY:
            defaults["pc_factor_mat_solver_type"] = "mumps"
        snes.setOptionsPrefix(prefix)
        for name, value in (defaults | self._options).items():
            options[prefix + name] = value
        snes.setFromOptions()
        for name in defaults | self._options:
            options.delValue(prefix + name)

    @property
    def T(self) -> scipy.sparse.csr_matrix:
        """Motion (size, n) of all degrees of freedom by independent unknowns, at the last ones."""
        return self._map_of_joints(virtual=False)

    @property
    def Tv(self) -> scipy.sparse.csr_matrix:
        """Virtual motion (size, n) likewise: forces on unknowns are Tv^T r."""
        return self._map_of_joints(virtual=True)

    def _map_of_joints(self, virtual: bool) -> scipy.sparse.csr_matrix:
        every = self.reduction.coupling(virtual=virtual)
        return every[:, self._independent]

    def _F(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        r = self._forces(self._unknowns.all(x))
        if self._direct:
            on_unknowns = np.bincount(self._at, r)[: len(self._independent)]
        else:
            on_unknowns = self.reduction.project(r)[self._independent]
        b.array[:] = on_unknowns[self._unknowns.own]

    def _J(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """The tangent where `_F` was evaluated last."""
        (self._assemble if self._direct else self._reduce)(P)

    def _other_tangent(self) -> np.ndarray:
        """Tangent of inertia and of forces at points, in the pattern of the scene."""
        values = np.zeros(self._pattern.nnz)
        if not self._rates.at_rest:
            values += self.form.mass.data * (self._steepness * self._slope)[self._pattern.indices]
        self.model.points.add_tangent(values)
        return values

    def _assemble(self, P: PETSc.Mat) -> None:
        """By dolfinx, in the numbers of unknowns."""
        P.zeroEntries()
        self.form._add_tangent(P, self._map)
        others = self._unknowns.rows(self._sums.matrix(self._other_tangent()))
        P.setValuesCSR(*csr_of(others), addv=True)
        P.assemble()

    def _reduce(self, P: PETSc.Mat) -> None:
        """Tv^T K T + (dTv/dy)^T r, by products of the maps of joints."""
        K = self._pattern.copy()
        K.data[:] = self.form._tangent()
        if self._comm.rank == 0:  # what all have is added once
            if self.model.nodal_rules:
                K = K + self._inertia_by_rules()
            else:
                K.data += self._other_tangent()
            if self._members is not None:
                K = K + self._members.tangent()
        Tv, K, self._T = (self._quick(matrix) for matrix in (self.Tv, K, self.T))
        A = scipy.sparse.csr_matrix(Tv.T @ K @ self._T)
        if self._comm.size > 1:
            A = sum(self._comm.allgather(A))
        if len(self._moving):
            A = A + self._by_turning()
        P.setPreallocationCSR(csr_of(self._unknowns.rows(A.tocsr())))
        P.assemble()

    def _quick(self, matrix: scipy.sparse.csr_matrix) -> Any:
        return matrix.toarray() if self.model.size <= _SMALL else matrix

    def _inertia_by_rules(self) -> scipy.sparse.csr_matrix:
        """Derivative (size, size) of forces of inertia by increments, with rules of a user."""
        size, nodes = self.model.size, np.arange(len(self._by_increment) + 1)
        blocks = self._by_increment, nodes[:-1], nodes
        return self.form.mass @ scipy.sparse.bsr_matrix(blocks, (size, size)).tocsr()

    def _by_turning(self) -> scipy.sparse.csr_matrix:
        """(dTv/dy)^T r, and slopes of forces on slides, by central differences of the map."""
        reduction, n = self.reduction, len(self._independent)
        columns = np.zeros((n, len(self._moving)))
        for column, i in zip(columns.T, self._moving, strict=True):
            unknown = self._independent[i]
            h = _PART * self.model.unit_of_unknowns[unknown]
            for sign in (1, -1):
                y = self._y.copy()
                y[unknown] += sign * h
                reduction.expand(y, self._driven)
                column += sign / (2 * h) * reduction.project(self.r)[self._independent]
        reduction.expand(self._y, self._driven)
        starts = len(self._moving) * np.arange(n + 1)
        entries = columns.ravel(), np.tile(self._moving, n), starts
        return scipy.sparse.csr_matrix(entries, (n, n))

    def _which_turn(self) -> np.ndarray:
        """Unknowns that turn arms of joints, close loops, move beams with sliders, or slide."""
        couplings, points = self.reduction.couplings, self.model.points
        T = self.reduction.coupling(closed=False)
        dofs = [rotation_of(joint.a) for joint in couplings.moving if joint.a is not GROUND]
        for joint in couplings.sliding:
            nodes = self.model.mesh.nodes_of(self.model.scene, joint.beam)
            dofs += self.model.mesh.dofs[nodes].ravel().tolist()
        turning = np.zeros(T.shape[1], dtype=bool)
        turning[T[dofs].indices] = True
        turning[[*couplings.slides.values()]] = True
        turning[points.columns] = True
        if (loops := self.reduction.loops) is not None:
            turning[loops.unknowns] = True
        return np.flatnonzero(turning[self._independent])

    def _shorten(self, x: PETSc.Vec, correction: PETSc.Vec) -> bool:
        """Let a correction turn no node further than `LONGEST_TURN`."""
        y = self._unknowns.all(correction)
        if self._direct:
            D = np.append(y, 0.0)[self._at[self.model.turns]]
        else:
            D = (self._T @ y)[self.model.turns]
        turn = abs(D).max(initial=0.0)
        if too_long := bool(turn > LONGEST_TURN):
            correction.scale(LONGEST_TURN / turn)
        return too_long

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: Any) -> int | None:
        reasons = PETSc.SNES.ConvergedReason
        if not np.isfinite(norms[2]):
            return reasons.DIVERGED_FNORM_NAN
        if iteration == 0:
            return None
        unit = self.model.unit_of_unknowns[self._independent]
        correction = self._unknowns.all(snes.getSolutionUpdate())
        size, last = abs(correction / unit).max(initial=0.0), self._last
        self._last, p = size, self._c
        p.corrections[p.tried % len(p.corrections)] = size
        p.tried += 1
        if size <= self._newton.tolerance or _STALLED >= size > 0.5 * last:
            return reasons.CONVERGED_SNORM_RELATIVE
        return None if iteration < self._newton.max_iterations else reasons.DIVERGED_MAX_IT
