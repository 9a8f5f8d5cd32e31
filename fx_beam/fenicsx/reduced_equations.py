"""Vectors and matrices of a step, assembled by dolfinx and reduced to the unknowns, and solved."""

from __future__ import annotations

import itertools
from collections.abc import Callable, MutableSequence
from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, instant
from fx_beam.results.state import State
from fx_beam.scene.joints import slides_at_start
from fx_beam.step.equations import Equations as EngineEquations
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model, fact, led_dofs
from fx_beam.step.newton import LONGEST_TURN, NewtonOptions
from fx_beam.step.stepper import CompiledLoop

from .step_form import StepForm

# -- Vectors and matrices of a form in the numbers of a scene, as dolfinx assembles them --------


class Assembly:
    """Forces (size,) and their tangent (size, size) of all degrees of freedom."""

    def __init__(self, form: StepForm, model: Model):
        self.form, self.fields, self.grid, self.model = form, form.fields, form.grid, model
        pattern = model.forms.stiffness.astype(float)
        self._local = PETSc.Mat().createAIJ(pattern.shape, csr=csr_of(pattern), comm=MPI.COMM_SELF)
        numbers = PETSc.LGMap().create(self.fields.increment_numbers, comm=MPI.COMM_SELF)
        self._local.setLGMap(numbers, numbers)

    def residual(self, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces and drag (size,) at increments D (size,), and added terms."""
        numbers = self.fields.increment_numbers
        self.fields.set_increment(D)
        forces = np.zeros((2, len(D)))
        for out, terms in zip(forces, (self.form.terms, self.form.added), strict=True):
            b = np.zeros(len(numbers))
            for form, _ in (term.compiled for term in terms):
                if form is not None:
                    fem.assemble_vector(b, form)
            out[:] = np.bincount(numbers, b, len(D))
        internal, added = self.grid.total(forces)
        return internal, added

    def tangent(self) -> np.ndarray:
        """Entries of the tangent (size, size), in the sparsity of all forces."""
        forms = (term.compiled[1] for term in (*self.form.terms, *self.form.added))
        self._local.zeroEntries()
        for form in forms:
            if form is not None:
                fem.petsc.assemble_matrix(self._local, form)
        self._local.assemble()
        return self.grid.total(self._local.getValuesCSR()[2])


def csr_of(matrix: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of a matrix, as PETSc takes them."""
    matrix.sort_indices()
    indptr, indices = (np.asarray(row, PETSc.IntType) for row in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data


# -- The unknowns of supports and joints in PETSc -----------------------------------------------


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
        return PETSc.Mat().createAIJ(sizes, csr=csr_of(self.rows(matrix)), comm=self.comm)

    def rows(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The rows of a matrix (n, n) that this process has, in the numbers of PETSc."""
        return matrix if self.comm.size == 1 else matrix[self._own][:, self._order]

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


# -- Forces of a step and their tangent for the unknowns y: Tv(y)^T r(g(y)) and its derivative --


# Change of the load factor by which derivatives are found as differences.
_APART = 1e-5
# Length [s] of a step in which inertia and dampers give no forces.
_SLOW = 1e12


class NoConfigurationError(Exception):
    """No configuration belongs to the unknowns; `failure` is its code in C."""

    def __init__(self, failure: int):
        super().__init__(failure)
        self.failure = failure


class ReducedEquations:
    """Forces r (size,) of a step at unknowns, and their tangent.

    dolfinx has those of beams; masses, points, joints and the reduction are the engine's.
    """

    def __init__(self, assembly: Assembly, loop: CompiledLoop, max_turn: float):
        self.assembly, self.loop, self.model = assembly, loop, loop.model
        self._max_turn = max_turn
        n, problem, reduction = loop.model.size, loop.problem, loop.model.reduction
        sizes = {"D": n, "z": reduction.columns, "r": n, "f": n}
        # In C: increments (size,), unknowns (columns,), all forces (size,), and internal ones.
        self._D, self._z, self._r, self.internal_in_c = problem.results(**sizes)
        #: In C: dead forces (size,) at the level of the step, natural strains at its end, flat.
        self.dead, _, self._natural_in_c = problem.given()
        # Forces of beams, and entries of their tangent, as the engine's equations take them.
        self._beam_forces, self._tangent = np.zeros(n), np.zeros(loop.model.forms.stiffness.nnz)
        self._engine = EngineEquations(loop.model, loop.forcing.time)
        #: All forces (size,), internal ones, and those of added terms, where they were found last.
        self.forces, self.internal, self._added = np.zeros((3, n))
        # Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self._natural: np.ndarray | None = None
        # Load factors or times of the last step; None before the first.
        self._interval: Interval | None = None
        # End of the last step [s], and forces (size,) of added terms there.
        self._last_end = np.nan, np.zeros(n)
        reduction.set_start(np.zeros(n), slides_at_start(loop.model.scene))
        #: Unknowns of the last step.
        self.unknowns = Unknowns(assembly)

    def find_natural_strains(self) -> None:
        """Have the natural strains of a user at the end of the next step."""
        form = self.assembly.form
        if form.natural is not None:
            self._natural = form.grid.at_points([form.natural])

    def begin_step(self, dt: float) -> None:
        """Begin a sub-step at the state in C."""
        reduction, strains = self.model.reduction, self.model.data.natural
        # The end less the start differs from dt by round-off, which would count as work.
        interval, start = self.loop.interval(dt), self.loop.state.read()
        if self._natural is not None:
            self._natural_in_c[:] = self._natural.ravel()
        natural = self._natural_in_c.reshape(strains.shape) if strains else None
        self._begin(interval, start, natural)
        self._y = self._z[: reduction.free].copy()
        self._driven = self._z[reduction.free :][: reduction.driven]

    def _begin(self, interval: Interval, start: State, natural: np.ndarray | None) -> None:
        self._interval, self._length, self._start = interval, interval.length, start
        sub_step = self.loop.problem.c.work.run.sub_step
        values = self.model.forms.parameters.values.copy()  # C has those at the level of the step
        self._engine.set_start(interval, start.changed(parameters=values))
        self._engine.take_beams(self._beam_forces, self._tangent, sub_step)
        self.assembly.fields.set_start(interval, start, natural)
        if not np.array_equal(self.model.reduction.independent, self.unknowns.independent):
            self.unknowns = Unknowns(self.assembly)

    @property
    def y(self) -> np.ndarray:
        """Independent unknowns (n,) where forces were found last, or at the start."""
        return self._y[self.unknowns.independent]

    def evaluate(self, y: np.ndarray) -> None:
        """Find all forces (size,) at the unknowns.

        Raises
        ------
        NoConfigurationError
            For loops that do not close, and for nodes that turn too far.
        """
        model = self.model
        self._y[self.unknowns.independent] = y
        D = self._D[:] = model.reduction.increment(self._y, self._driven)
        if not abs(D[model.mesh.turns]).max() <= self._max_turn:
            constants, failure = self.loop.problem.constants, "TURNED_TOO_FAR"
            if not np.isfinite(D).all():
                failure = "OPEN_LOOP" if np.isfinite(y).all() else "NO_CONVERGENCE"
            raise NoConfigurationError(getattr(constants, failure))
        self.internal, self._added = self.assembly.residual(D)
        self._beam_forces[:], self._tangent[:] = self.internal + self._added, 0.0
        self._balance()

    def _balance(self) -> None:
        balance = self._engine.evaluate(self._y, self._driven, self.dead)
        self.forces = balance.r.copy()
        #: Forces (n,) on the unknowns, Tv^T r.
        self.residual = balance.residual[self.unknowns.independent]
        if len(led := fact(self.model, led_dofs)):
            start, beside = self._start, np.zeros(self.model.size)
            steps = self._D[led], start.v[led], start.a[led]
            rule = self.model.scheme.rates.acceleration(*steps, self._length)[0]
            beside[led] = self._engine.acceleration[led] - rule
            self.assembly.fields.lead(beside)

    def tangent(self) -> PETSc.Mat:
        """The reduced tangent where forces were found last."""
        self._tangent[:] = self.assembly.tangent()
        self._balance()
        reduction, couplings = self.model.reduction, self.model.couplings
        others = couplings.sliding or couplings.closures or couplings.auxiliaries
        if others or self.model.points.members is not None or self.unknowns.comm.size > 1:
            rows = self.unknowns.rows(self._engine.tangent())
            return self.unknowns.set_values(*csr_of(rows))
        return self.unknowns.set_values(*reduction.tangent.pattern, self._engine.values)

    @property
    def mass(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (size, size) of beams and lumped masses."""
        return self.model.masses.matrix

    def stiffness(self, state: State) -> PETSc.Mat:
        """The reduced tangent for slow motions about a state, of a scheme of the package."""
        model, interval = self.model, instant(state.t, _SLOW)
        still = state.changed(v=0 * state.v, a=0 * state.a)
        self._begin(interval, still, state.natural)
        self._y, self._driven = np.zeros(model.reduction.free), np.zeros(model.reduction.driven)
        self.evaluate(self.y)
        K = self.tangent().copy()
        K.scale(1 / model.scheme.rates.level)
        return K

    def load_slope(self, forcing: LoadForcing) -> np.ndarray:
        """Derivative (n,) of the reduced residual by the load factor, in statics."""
        if self._interval is None:
            raise SceneError("fenicsx: load_derivative: no residual was found yet. Begin a step")
        end, inputs, sides = self._interval.end, self.model.points.inputs.copy(), []
        for factor in (end + _APART, end - _APART, end):
            self.assembly.fields.set_load(factor, forcing.natural(factor))
            self._engine.end_at(factor)
            self._driven = forcing.positions(factor) - forcing.current(self._start)
            self.dead[:] = forcing.dead(factor)
            self.evaluate(self.y)
            sides.append(self.residual.copy())
        self.model.points.inputs[:] = inputs  # laws remember iterations, not what is beside them
        return (sides[0] - sides[1]) / (2 * _APART)

    def finish(self, dt: float) -> None:
        """Hand the increment, its forces and the work of added terms over to the engine."""
        model, state = self.model, self.loop.problem.c.work.state
        self._z[: model.reduction.free] = self._y
        self._r[:], self.internal_in_c[:] = self.forces, self.internal
        path, _ = model.scheme.rates.work_increment(self._D, model.mesh.turns)
        state.work -= self._mean_added(state.t, dt) @ path

    def start_with(self, t: float, added: np.ndarray) -> None:
        """Have forces of added terms (size,) at the start of the next step [s]."""
        self._last_end = t, added

    def _mean_added(self, t: float, dt: float) -> np.ndarray:
        """Mean forces (size,) of added terms in a step, from those at its level and its start."""
        level, (end, start) = self.model.scheme.rates.level, self._last_end
        is_next = np.isclose(end, t, rtol=1e-12, atol=1e-9 * abs(dt))
        late = level > 0.5  # else errors would grow
        part = (self._added - start) / (level if late else 1.0) if is_next else 0.0 * start
        self._last_end = t + dt, self._added + late * (1 - level) * part
        return self._added + (0.5 - level) * part


# -- Newton's method of PETSc for the increment of a step: Tv(y)^T r(g(y)) = 0 for the unknowns y


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
        #: Code of a step that finds no increment.
        self.none = self._failure = self._constants.NO_CONVERGENCE
        #: What ends a sub-step that has begun, in the place of SNES, by its length.
        self.own: Callable[[float], int] | None = None
        #: Solver of the last step.
        self.snes = PETSc.SNES().create(equations.assembly.grid.comm)
        self._set_options(options)
        # As errors name it.
        own = replace(newton, max_iterations=self.snes.getTolerances()[3])
        problem.kind = problem.kind._replace(newton=own)
        self._set_functions()
        equations.loop.find_by(self._find)

    def _find(self, dt: float, iterations: MutableSequence[int]) -> int:
        """The increment of a sub-step, from the state in the memory of C, and into it."""
        self._equations.begin_step(dt)
        if self._unknowns is not self._equations.unknowns:
            self.snes.reset()
            self._set_functions()
        return self.own(dt) if self.own else self._solve(dt, iterations)

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
        self._equations.internal_in_c[:] = self._equations.internal
        judge, convergence = self._judge
        if judge(self._c, convergence, iteration, self._shortened):
            return reasons.CONVERGED_SNORM_RELATIVE
        return None


# -- The equations of all degrees of freedom of a scene, and what supports and joints leave -----


class System:
    """The system of all degrees of freedom of a scene, and the maps of supports and joints.

    The degrees of freedom are displacement (2) and rotation of each node, node by node. Supports
    and joints make them functions of n unknowns y: Newton's method solves ``Tv.T r = 0``. Below,
    ``size`` is the number of degrees of freedom.

    Parameters
    ----------
    equations : Equations
        The equations of a problem, which makes its `system` itself.
    """

    def __init__(self, equations: ReducedEquations):
        self._equations, self._assembly = equations, equations.assembly

    @property
    def dofs(self) -> np.ndarray:
        """Row in `T`, `Tv`, `K` and `M` of each degree of freedom of `V`."""
        return self._assembly.fields.V_numbers

    @property
    def residual(self) -> np.ndarray:
        """All forces r (size,) of the last iteration, with inertia [N, N m].

        At the end of a step Tv^T r is zero, and r is the forces of supports and joints.
        """
        return self._equations.forces

    @property
    def K(self) -> PETSc.Mat:
        """Derivative of `F` in the last iteration, as a copy."""
        K = self._assembly.model.forms.stiffness
        matrix = scipy.sparse.csr_matrix((self._assembly.tangent(), K.indices, K.indptr), K.shape)
        return self._distributed(matrix)

    @property
    def M(self) -> PETSc.Mat:
        """Mass matrix of beams and lumped masses, as a copy [kg, kg m^2]."""
        return self._distributed(self._equations.model.masses.matrix)

    @property
    def T(self) -> scipy.sparse.csr_matrix:
        """Matrix (size, n) of small motions dq = T dy by small changes of the unknowns."""
        return self._equations.unknowns.T

    @property
    def Tv(self) -> scipy.sparse.csr_matrix:
        """Matrix (size, n) of virtual motions; the forces on the unknowns are Tv^T r."""
        return self._equations.unknowns.Tv

    def _distributed(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix whose rows the processes share."""
        comm, size = self._assembly.grid.comm, matrix.shape[0]
        first, end = PETSc.Vec().createMPI(size, comm=comm).getOwnershipRange()
        return PETSc.Mat().createAIJ(
            ((end - first, size),) * 2, csr=csr_of(matrix[first:end]), comm=comm
        )
