"""Newton's method of PETSc for the increment of a step: Tv(y)^T r(g(y)) = 0 for the unknowns y."""

from __future__ import annotations

import itertools
from collections.abc import Callable, MutableSequence

from petsc4py import PETSc

import numpy as np

from fx_beam.step.newton import LONGEST_TURN, NewtonOptions

from .equations import NoConfigurationError, ReducedEquations

# Unknowns from which on MUMPS is faster than PETSc's own factors.
_MANY = 20_000
_OPTIONS = {"snes_type": "newtonls", "snes_linesearch_type": "basic"}
_OPTIONS |= {"ksp_type": "preonly", "pc_type": "lu"}
_TOLERANCES = {"snes_rtol", "snes_atol", "snes_stol"}
_numbers = itertools.count()
#: Options of PETSc by name, without a prefix.
PetscOptions = dict[str, str | float | None]


class Newton:
    """Finds the increments of steps by SNES for the loop of the engine.

    The engine has the state, and all that follows from an increment: rates, work, forces of joints,
    records.
    """

    def __init__(self, equations: ReducedEquations, newton: NewtonOptions, options: PetscOptions):
        self._equations, self._newton = equations, newton
        problem, n = equations.loop.problem, equations.model.size
        self._c, self._constants = problem.c, problem.constants
        columns = equations.model.reduction.columns
        self._judge = problem.library.fx_judge, problem.ffi.new("Convergence *")
        judged = problem.results(reduced=columns, step=columns, correction=n)
        self._reduced, self._step, self._correction = judged
        self._shortened, self._residual = False, np.empty(0)
        self._failure = self._constants.NO_CONVERGENCE
        #: What ends a sub-step that has begun, in the place of SNES, by its length.
        self.own: Callable[[float], int] | None = None
        #: Solver of the last step.
        self.snes = PETSc.SNES().create(equations.assembly.grid.comm)
        self._set_options(options)
        self._set_functions()
        equations.loop.find_by(self._find)

    def _find(self, dt: float, iterations: MutableSequence[int]) -> int:
        """The increment of a sub-step, from the state in the memory of C, and into it."""
        self._equations.begin_step(dt)
        if self._unknowns is not self._equations.unknowns:
            self.snes.reset()
            self._set_functions()
        return self.own(dt) if self.own else self._solve(dt, iterations)

    def stay(self, dt: float) -> int:
        """End no sub-step: all is there for one that a user takes."""
        return self._constants.NO_CONVERGENCE

    def take(self, y: PETSc.Vec, dt: float) -> int:
        """End a sub-step at unknowns y of a user."""
        self._failure, out = self._constants.NO_CONVERGENCE, y.duplicate()
        self.residual(y, out)
        if not np.isfinite(out.norm()):
            return self._failure
        self._equations.finish(dt)
        return self._constants.OK

    def _solve(self, dt: float, iterations: MutableSequence[int]) -> int:
        """The increment by SNES."""
        equations, unknowns = self._equations, self._equations.unknowns
        x = unknowns.A.createVecRight()
        x.array[:] = unknowns.own(equations.y)
        self._failure = self._constants.NO_CONVERGENCE
        self.snes.solve(None, x)
        iterations[0] = self.snes.getIterationNumber()
        PETSc.garbage_cleanup(self.snes.comm)  # petsc4py 3.18 keeps what nothing refers to
        reason = self.snes.getConvergedReason()
        if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            return self._constants.SINGULAR
        if reason < 0 and not self._at_round_off(x):
            return self._failure
        if not np.array_equal(equations.y, y := unknowns.all(x)):
            equations.evaluate(y)  # a line search came back
        equations.finish(dt)
        return self._constants.OK

    def _at_round_off(self, x: PETSc.Vec) -> bool:
        """Whether Newton's correction is within the tolerance: no search lowers such a residual."""
        correction, residual = x.duplicate(), x.duplicate()
        self.residual(x, residual)
        if not np.isfinite(residual.norm()):
            return False
        self.snes.ksp.setOperators(self._equations.tangent())
        self.snes.ksp.solve(residual, correction)
        unknowns, units = self._equations.unknowns, self._equations.model.units.nodes
        motion = unknowns.to_nodes(unknowns.all(correction))
        return bool(abs(motion / units).max(initial=0.0) <= self._newton.tolerance)

    # -- What SNES calls ---------------------------------------------------------------------------

    def _set_functions(self) -> None:
        self._unknowns = self._equations.unknowns
        A = self._unknowns.A
        self.snes.setFunction(lambda snes, x, b: self.residual(x, b), A.createVecLeft())
        self.snes.setJacobian(lambda *_: self._equations.tangent(), A)

    def _set_options(self, options: PetscOptions) -> None:
        """Set PETSc's options, which have a prefix of this solver for a moment."""
        self.snes.setLineSearchPreCheck(self._shorten)
        if not _TOLERANCES & options.keys():
            self.snes.setConvergenceTest(self._converged)
        values: PetscOptions = {**_OPTIONS}
        if "snes_type" not in options:  # another method has its own number
            values["snes_max_it"] = self._newton.max_iterations
        if self.snes.comm.size > 1 or self._equations.unknowns.size > _MANY:
            values["pc_factor_mat_solver_type"] = "mumps"
        database, prefix = PETSc.Options(), f"fx_beam_{next(_numbers)}_"
        for name, value in (values | options).items():
            database[prefix + name] = value
        self.snes.setOptionsPrefix(prefix)
        self.snes.setFromOptions()
        for name in values | options:
            database.delValue(prefix + name)

    def residual(self, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Set b to the residual at unknowns x; to nan where there is no configuration."""
        equations = self._equations
        unknowns = equations.unknowns
        try:
            equations.evaluate(unknowns.all(x))
        except NoConfigurationError as error:
            self._failure = error.failure
            b.array[:] = np.nan
            return
        if not np.isfinite(equations.forces).all():
            self._failure = self._constants.SINGULAR
        b.array[:] = unknowns.own(equations.residual)

    def _shorten(self, x: PETSc.Vec, correction: PETSc.Vec) -> bool:
        """Let a correction turn no node further than `LONGEST_TURN`."""
        unknowns = self._equations.unknowns
        motion = unknowns.to_nodes(unknowns.all(correction))
        turn = abs(motion[self._equations.model.mesh.turns]).max(initial=0.0)
        self._shortened = bool(turn > LONGEST_TURN)
        if self._shortened:
            correction.scale(LONGEST_TURN / turn)
        return self._shortened

    def _converged(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> int | None:
        """The engine's own judgement of an iteration."""
        reasons, unknowns = PETSc.SNES.ConvergedReason, self._equations.unknowns
        last_residual, self._residual = self._residual, unknowns.all(snes.getFunction()[0]).copy()
        if not np.isfinite(norms[2]):
            return reasons.DIVERGED_FNORM_NAN
        if iteration == 0:  # a line search or a trust region cannot lower a residual of zero
            return reasons.CONVERGED_FNORM_ABS if norms[2] == 0 else None
        change = unknowns.all(snes.getSolutionUpdate())
        self._reduced[:] = self._step[:] = 0.0
        self._reduced[unknowns.independent] = last_residual
        self._step[unknowns.independent] = change
        self._correction[:] = unknowns.to_nodes(change)
        self._equations.c_step.f[:] = self._equations.internal
        judge, convergence = self._judge
        if judge(self._c, convergence, iteration, self._shortened):
            return reasons.CONVERGED_SNORM_RELATIVE
        return None
