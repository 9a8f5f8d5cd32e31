"""Newton's method of PETSc for the increment of a step: Tv(y)^T r(g(y)) = 0 for the unknowns y."""

from __future__ import annotations

import itertools
from typing import Any

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.scene.joints import slides_at_start
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import LONGEST_TURN, NewtonOptions

from .form import StepForm
from .unknowns import Unknowns

# Unknowns from which on MUMPS is faster than PETSc's own factors.
_MANY = 20_000
_OPTIONS = {"snes_type": "newtonls", "snes_linesearch_type": "basic"}
_OPTIONS |= {"ksp_type": "preonly", "pc_type": "lu"}
_TOLERANCES = {"snes_rtol", "snes_atol", "snes_stol"}
_numbers = itertools.count()


class Newton:
    """Finds the increments of steps by SNES for the loop of the engine.

    That one has the state, and all that follows from an increment: rates, work, forces of joints,
    records.
    """

    def __init__(
        self, form: StepForm, loop: CompiledLoop, newton: NewtonOptions, options: dict[str, Any]
    ):
        self.form, self._loop, self._newton = form, loop, newton
        #: Iterations in the last step; all forces (size,) in the last of them.
        self.iterations, self.forces = 0, np.zeros(loop.model.size)
        #: Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self.natural: np.ndarray | None = None
        model, problem = loop.model, loop.problem
        self._model, self._reduction, self._rates = model, model.reduction, model.scheme.rates
        self._c, self._constants, n = problem.c, problem.constants, model.size
        self._convergence, columns = problem.ffi.new("Convergence *"), self._reduction.columns
        self._judge = problem.library.fx_judge
        self._D, self._z, self._r, self._f = problem.results(D=n, z=columns, r=n, f=n)
        self._judged = list(problem.results(reduced=columns, step=columns, correction=n))
        self._force, _, self._strains = problem.given()
        # End of the last step [s], and forces of added terms in it.
        self._before: tuple[float, Any] = (np.nan, None)
        self._steepness, self._shortened, self._residual = 0.0, False, np.empty(0)
        self._reduction.begin(np.zeros(n), slides_at_start(model.scene))
        #: Unknowns and solver of the last step.
        self.unknowns, self.snes = Unknowns(form), PETSc.SNES().create(form.grid.comm)
        self._set_options(options)
        self._set_functions()
        loop.find_by(self._find)

    def _find(self, dt: float) -> int:
        """The increment of a sub-step, from the state in the memory of C, and into it."""
        p, model, reduction, free = self._c, self._model, self._reduction, self._reduction.free
        # The end less the start differs from dt by round-off, which would count as work.
        loads = Interval(p.ratio_before, p.ratio)
        interval = loads if self._rates.at_rest else Interval(p.t, p.t + dt, dt)
        self._start = state = self._loop.state(p.t)
        self._interval = interval
        reduction.begin(state.q, state.slides)
        if self.natural is not None:
            self._strains[:] = self.natural.ravel()
        natural = self._strains.reshape(model.natural.shape) if model.natural else None
        self.form.begin(interval, state, natural)
        self._y, self._driven = self._z[:free].copy(), self._z[free : free + reduction.driven]
        if not np.array_equal(reduction.independent, self.unknowns.independent):
            self.unknowns = Unknowns(self.form)
            self.snes.reset()
            self._set_functions()
        unknowns = self.unknowns
        x = unknowns.A.createVecRight()
        x.array[:] = unknowns.own(self._y[unknowns.independent])
        p.tried, self._failure = 0, self._constants.NO_CONVERGENCE
        self.snes.solve(None, x)
        self.iterations = self.snes.getIterationNumber()
        p.iterations += self.iterations
        PETSc.garbage_cleanup(self.form.grid.comm)  # petsc4py 3.18 keeps what nothing refers to
        if self.snes.getConvergedReason() < 0:
            return self._failure
        if not np.array_equal(self._y[unknowns.independent], y := unknowns.all(x)):
            self._evaluate(y)  # a line search came back
        self._z[:free], self._r[:], self._f[:] = self._y, self.forces, self._internal
        p.work -= self._mean(p.t, dt) @ self._path
        return self._constants.OK

    def _mean(self, t: float, dt: float) -> np.ndarray:
        """Forces of added terms (size,) in mid-step, from those at levels of steps."""
        level, (end, before) = self._rates.level, self._before
        self._before = t + dt, self._added
        if level == 0.5 or not np.isclose(end, t, rtol=1e-12, atol=1e-9 * abs(dt)):
            return self._added
        return self._added + (0.5 - level) * (self._added - before)

    def _evaluate(self, y: np.ndarray) -> None:
        """Find all forces (size,) at the unknowns; nan where these give no configuration."""
        model, rates, state = self._model, self._rates, self._start
        self._y[self.unknowns.independent] = y
        D = self._D[:] = self._reduction.expand(self._y, self._driven)
        if not abs(D[model.turns]).max() <= self._newton.max_turn:
            closed = np.isfinite(D).all()
            self._failure = self._constants.TURNED_TOO_FAR if closed else self._constants.OPEN_LOOP
            self.forces = np.full(model.size, np.nan)
            return
        self._path, self._slope = rates.work_increment(D, model.turns)
        self._internal, self._added = self.form.residual(D)
        r = self.forces = self._internal + self._added - self._force
        if not rates.at_rest:
            r += self.form.mass @ self._acceleration(D, state, self._interval.length)
        model.points.add_force(D, r)

    def _acceleration(self, D: np.ndarray, state: State, dt: float) -> np.ndarray:
        """Nodal accelerations (size,), and their derivatives by the increment."""
        if not (rules := self._model.nodal_rules):
            a, self._steepness = self._rates.acceleration(self._path, state.v, state.a, dt)
            return a
        past = state.q - (state.q if state.q_previous is None else state.q_previous)
        nodes = self._model.mesh.dofs
        rows = [x[nodes] for x in (D, state.v, state.a, past)] + [np.full((len(nodes), 1), dt)]
        values = rules[self._c.sub_step % len(rules)].in_rows(np.hstack(rows))
        self._by_increment = values[:, 3:12].reshape(-1, 3, 3)
        return values[:, :3].ravel()

    def assemble(self) -> PETSc.Mat:
        """The reduced tangent where forces were found last."""
        model, unknowns, others = self._model, self.unknowns, np.zeros(self.form.pattern.nnz)
        mass, more = self.form.mass, None
        if model.nodal_rules:
            nodes = np.arange(len(self._by_increment) + 1)
            blocks = self._by_increment, nodes[:-1], nodes
            more = mass @ scipy.sparse.bsr_matrix(blocks, mass.shape).tocsr()
        elif not self._rates.at_rest:
            others += mass.data * (self._steepness * self._slope)[mass.indices]
        model.points.add_tangent(others)
        if model.points.members is not None:
            of_members = model.points.members.tangent()
            more = of_members if more is None else more + of_members
        unknowns.assemble(others, more, self._y, self._driven, self.forces)
        return unknowns.A

    # -- SNES --------------------------------------------------------------------------------------

    def _set_functions(self) -> None:
        self.snes.setFunction(self._F, self.unknowns.A.createVecLeft())
        self.snes.setJacobian(lambda *_: self.assemble(), self.unknowns.A)

    def _set_options(self, options: dict[str, Any]) -> None:
        """Set PETSc's options, which have a prefix of this solver for a moment."""
        self.snes.setLineSearchPreCheck(self._shorten)
        if not _TOLERANCES & options.keys():
            self.snes.setConvergenceTest(self._converged)
        given = _OPTIONS | {"snes_max_it": self._newton.max_iterations}
        if self.form.grid.comm.size > 1 or self.unknowns.size > _MANY:
            given["pc_factor_mat_solver_type"] = "mumps"
        database, prefix = PETSc.Options(), f"fx_beam_{next(_numbers)}_"
        for name, value in (given | options).items():
            database[prefix + name] = value
        self.snes.setOptionsPrefix(prefix)
        self.snes.setFromOptions()
        for name in given | options:
            database.delValue(prefix + name)

    def _F(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        unknowns = self.unknowns
        self._evaluate(unknowns.all(x))
        b.array[:] = unknowns.own(unknowns.projected(self.forces))

    def _shorten(self, x: PETSc.Vec, correction: PETSc.Vec) -> bool:
        """Let a correction turn no node further than `LONGEST_TURN`."""
        motion = self.unknowns.spread(self.unknowns.all(correction))
        turn = abs(motion[self._model.turns]).max(initial=0.0)
        self._shortened = bool(turn > LONGEST_TURN)
        if self._shortened:
            correction.scale(LONGEST_TURN / turn)
        return self._shortened

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: Any) -> int | None:
        reasons, unknowns = PETSc.SNES.ConvergedReason, self.unknowns
        before, self._residual = self._residual, unknowns.all(snes.getFunction()[0]).copy()
        if not np.isfinite(norms[2]):
            return reasons.DIVERGED_FNORM_NAN
        if iteration == 0:
            return None
        reduced, step, correction = self._judged
        reduced[:] = step[:] = 0.0
        reduced[unknowns.independent] = before
        step[unknowns.independent] = change = unknowns.all(snes.getSolutionUpdate())
        correction[:], self._f[:] = unknowns.spread(change), self._internal
        if self._judge(self._c, self._convergence, iteration, self._shortened):
            return reasons.CONVERGED_SNORM_RELATIVE
        return None if iteration < self._newton.max_iterations else reasons.DIVERGED_MAX_IT
