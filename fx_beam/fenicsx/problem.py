"""A motion, and equilibria at rising loads, whose steps PETSc takes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from fx_beam.errors import SceneError, positive, require, warn_once
from fx_beam.fem.forms import StepForces
from fx_beam.laws.interval import INSTANT, Interval
from fx_beam.laws.schemes import Equilibrium as AtRest, Scheme
from fx_beam.motions.contact_check import check_ropes
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.initial_state import Starts, drawn_state
from fx_beam.motions.motion_setup import MotionSetup, Options, check_scene, grid_from, stats_of
from fx_beam.motions.progress import attach, failure_of
from fx_beam.motions.run import warn_of_parts, warn_of_rounding
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorded_rows import slides_near
from fx_beam.step.recorder import NullRecorder, Record, Recorder
from fx_beam.step.stepper import LoadLoop, StepFailed, StepSolution

from .reduced_equations import PetscOptions
from .steps import DolfinxSteps, FieldModes, ReplacedRows, TrialStep, eigenpairs, modes_of
from .versions import DolfinxMesh


class Problem(DolfinxSteps):
    """A scene as a variational problem of dolfinx, whose steps in time PETSc takes.

    The weak form is that of the engine, with Functions and Constants of dolfinx as its symbols.
    Supports and joints give all displacements and rotations as a function g(y) of fewer unknowns y,
    as in a multi-point constraint: Newton's method solves Tv(y)^T r(g(y)) = 0, with the residual r
    and the virtual motions Tv (see `System`). dolfinx assembles the beams, and PETSc solves. The
    engine computes masses, forces at points, g and Tv, and then rates, work and records.

    Parameters
    ----------
    scene : Scene
        The scene, with at least one beam.
    scheme : Scheme, optional
        Time scheme, by default `EnergyMomentum`; a `Scheme` of your own may have other rules for
        nodal rates.
    dt : float
        Length of a step [s].
    petsc_options : dict, optional
        Options of SNES, KSP and PC, without a prefix, such as ``{"pc_factor_mat_solver_type":
        "mumps"}``. With ``snes_rtol``, ``snes_atol`` or ``snes_stol`` PETSc's own test of
        convergence takes the place of that of `NewtonOptions`.
    newton : NewtonOptions, optional
        Convergence criteria.
    max_halvings : int
        How often a step that fails may be halved; by default never.
    comm : MPI.Comm, optional
        Processes that share the mesh and the matrices; each process has the whole scene and all of
        its states. By default this process alone.
    mesh : dolfinx.mesh.Mesh, optional
        The mesh that was given to `beams_of`, if the problem shall use this mesh: all beams are
        then its cells, with ``elements=1`` and rigid joints. By default the problem makes a mesh.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane: all elements of all beams. At joints vertices coincide.
    cell_tags : dolfinx.mesh.MeshTags
        Number of the beam of each cell, in the order of ``scene.beams``.
    cell_map : (cells,) int array
        The same numbers as an array. After `beams_of` they are the cells of the mesh given there.
    V : dolfinx function space
        Mixed space of displacement (2) and rotation.
    increment, start : dolfinx.fem.Function
        Increments of displacement and rotation over the step, by which F is differentiated, and
        their values at its start [m, rad].
    test, trial : ufl arguments
        Test function of F, and trial function of J.
    step : Step
        Fields of a step, as `Scene.add_virtual_work` and `Scheme` have them.
    resultants : list of ufl expressions
        N, Q and M of a step, a vector (3,) for each material [N, N, N m].
    u : dolfinx.fem.Function
        Displacement at the end of the last step, for files and pictures [m].
    q, v, a : dolfinx.fem.Function
        Displacement and rotation [m, rad], velocity and spin [m/s, rad/s], and accelerations
        [m/s^2, rad/s^2] at the end of the last step, in `V`.
    snes : PETSc.SNES
        PETSc's nonlinear solver; `replace_resultants` makes a new one.
    system : System
        Residual, matrices, and the maps by which supports and joints act.

    Raises
    ------
    SceneError
        For a scene without beams.

    Examples
    --------
    >>> import fx_beam as fb
    >>> from fx_beam import fenicsx
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=0.01)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
    >>> scene.clamp(beam.start)
    >>> problem = fenicsx.Problem(scene, dt=0.01)
    >>> solution = problem.run(0.1)
    >>> engine = fb.simulate(scene, dt=0.01, t_end=0.1)
    >>> bool(abs(solution.q - engine.q).max() < 1e-12)
    True
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme | None = None,
        *,
        dt: float,
        petsc_options: PetscOptions | None = None,
        newton: NewtonOptions | None = None,
        max_halvings: int = 0,
        comm: MPI.Comm = MPI.COMM_SELF,
        mesh: DolfinxMesh | None = None,
    ):
        check_scene(scene, "fenicsx.Problem")
        options = Options(
            what="fenicsx.Problem",
            dt=positive(dt, "dt"),
            scheme=scheme,
            newton=newton,
            max_halvings=max_halvings,
        )
        self._prepared = prepared = MotionSetup(Model(scene, options.scheme), options)
        super().__init__(prepared.loop, options.newton, petsc_options, comm, mesh)
        #: Length of a step [s].
        self.dt: float = options.dt
        prepared.stats.solver = "PETSc"
        self._set(prepared.first_state(self.dt, None), starts=True)

    def _set(self, state: State, starts: bool = False) -> None:
        """Be in a state; terms that are added at a start change its accelerations."""
        self._state, self._starts = state, starts
        self._form.fields.end(state)

    @property
    def t(self) -> float:
        """Time at the end of the last step [s]."""
        return self._state.t

    # -- Steps -------------------------------------------------------------------------------------

    def advance(self, dt: float | None = None) -> None:
        """Take a step.

        Parameters
        ----------
        dt : float, optional
            Its length [s], by default `dt` of the problem.

        Raises
        ------
        StepError
            If Newton's method fails; then all is as before.
        """
        self._advance(self._end_of_step(dt), 1, NullRecorder())

    def begin(self, dt: float | None = None) -> AbstractContextManager[TrialStep]:
        """Begin a step whose unknowns you compute, in a block ``with problem.begin() as step``.

        This is for a Newton's method, a line search, or any other method of your own; joints hold
        as in other steps. If the block ends without `TrialStep.accept`, the problem is as before
        it.

        Parameters
        ----------
        dt : float, optional
            Its length [s], by default `dt` of the problem.

        Returns
        -------
        context manager
            Of a `TrialStep`.

        Raises
        ------
        SceneError
            For schemes with sub-steps.
        """
        if len(self._prepared.loop.model.scheme.fractions) > 1:
            raise SceneError("fenicsx: begin: the scheme has sub-steps. Use one of order 2")
        end = self._end_of_step(dt)
        take = partial(self._advance, end, 1, NullRecorder())
        return self._trial(partial(self._begin, end), take)

    def _end_of_step(self, dt: float | None) -> float:
        length = self.dt if dt is None else positive(dt, "dt")
        return float(grid_from(self.t, length)(1))

    def _begin(self, end: float) -> None:
        """Begin a step that does not end."""
        self._get_ready()
        self._prepared.stepper.trial(self._state, end)

    def _get_ready(self) -> None:
        if self._starts and self._form.has_further:
            self._accelerate()
        self._starts = False
        self._form.fields.refuse_writes()
        self._equations.find_natural_strains()

    def _advance(self, end: float, number: int, recorder: Recorder | NullRecorder) -> None:
        self._get_ready()
        stepper, state = self._prepared.stepper, self._prepared.loop.state
        state.load(self._state)
        stepper.advance(np.array([end]), number, recorder)
        self._set(state.read())

    def _accelerate(self) -> None:
        """Accelerations at the start by all forces, also by terms that only these forms have."""
        model, forcing = self._equations.model, self._prepared.forcing
        starts = Starts(model, forcing, self.dt, further=self._further)
        found = starts.resumed(self._state, same_scheme=False)
        kept = {name: getattr(found, name) for name in ("a", "driven_forces", "added_forces")}
        self._state = self._state.changed(**kept)
        self._form.fields.end(self._state)

    def _further(
        self, interval: Interval, state: State, D: np.ndarray, forces: StepForces
    ) -> np.ndarray:
        """Forces (size,) that the engine does not have."""
        self._form.fields.set_start(interval, state, state.natural)
        internal, added = self._equations.assembly.residual(D)
        self._equations.start_with(state.t, added)
        if not self._form.replaced:
            return added
        return internal + added - forces.of_beams(D)

    def run(
        self,
        t_end: float,
        after: Callable[[Problem], object] | None = None,
        record: Record | None = None,
        update: Callable[[Problem], object] | None = None,
    ) -> Solution:
        """Take steps to a time.

        Parameters
        ----------
        t_end : float
            Time at the end [s].
        after : callable, optional
            ``after(problem)`` is called after each step, to solve another problem on `mesh`, to set
            Constants and Functions, or to write files.
        record : Record, optional
            What to record, by default every step.
        update : callable, optional
            ``update(problem)`` is called after each step, before its row is recorded. There set the
            Functions of `replace_resultants` that belong to the end of the step, such as a damage:
            the strain energy of the row is computed with the new values, N, Q and M with those of
            the step.

        Returns
        -------
        Solution
            As of `fx_beam.simulate`, which can start from it.

        Raises
        ------
        StepError
            If a step fails. The attribute `solution` of this exception, and of any other, has all
            steps before.
        """
        options = Options(what="run", dt=self.dt, t_end=t_end, record=record)
        times = options.plan(self.t, goes_on=True).times
        prepared, stats = self._prepared, self._prepared.stats
        recorder = Recorder(self._equations.model, times, options.record)
        rows = ReplacedRows(self._equations.assembly, recorder)
        self._get_ready()
        prepared.stepper.begin_rows(self._state, recorder)
        self._hold_in_an_instant()
        rows.follow()

        def solution() -> Solution:
            past, parts = self._prepared.loop.state.past, prepared.stepper.halving.state
            end = self._state.changed(past=past, parts=parts)
            return rows.in_solution(solution_of(recorder, stats, lambda: end))

        try:
            for number, end in enumerate(times[1:].tolist(), start=1):
                self._advance(end, number, recorder)
                lost = rows.follow(update and partial(update, self))
                self._lose(lost)
                if after is not None:
                    after(self)
            result = solution()
            check_ropes(result, self._equations.model.scene)
        except BaseException as error:
            prepared.stepper.return_to(recorder.end, recorder)
            stats.failure = failure_of(error, self.t)
            attach(error, solution)
            raise
        warn_of_parts(stats, self.dt)
        warn_of_rounding(stats)
        return result

    def modes(self, n: int = 4) -> FieldModes:
        """Vibration modes about the present configuration, as if at rest and undamped, by SLEPc.

        Parameters
        ----------
        n : int
            Number of modes, from the lowest frequency on.

        Returns
        -------
        named tuple
            ``frequencies`` (n,) [Hz], and ``functions``: displacement and rotation of each mode, in
            `V`, with modal mass 1.

        Raises
        ------
        SceneError
            If a small motion grows; with internal variables, and with terms, forms, resultants or a
            scheme of your own, whose stiffness is not known: use `Equilibrium.modes`. Also without
            SLEPc, or for a scene without mass.
        """
        equations, state = self._equations, self._state
        model, scheme = equations.model, equations.model.scheme
        varies = state.internal is not None or model.points.width
        if varies or self._form.has_further or not scheme.built_in or model.forms.keeps_previous:
            raise SceneError(
                "fenicsx: modes: with internal variables, friction, and terms, resultants or a "
                "scheme of your own or with losses, the stiffness is not known in a motion. Use "
                "Equilibrium.modes"
            )
        return modes_of(equations, equations.stiffness(state), n)

    def _hold_in_an_instant(self) -> None:
        """Have the step of an instant in the fields: replaced resultants may depend on rates."""
        if self._form.replaced:
            length, state = INSTANT * self.dt, self._state
            start = state.changed(q=state.q - 0.5 * length * state.v)
            self._form.fields.set_start(Interval(self.t, self.t, length), start, start.natural)
            self._equations.assembly.residual(length * start.v)

    def set_state(
        self, q: fem.Function | ArrayLike | None = None, v: fem.Function | ArrayLike | None = None
    ) -> None:
        """Set displacements and rates; internal variables and other memory begin anew.

        Supports and joints hold: displacements that they prescribe or lead are computed from the
        other entries of q, and the rates are those closest to v, in the norm of the mass, that
        joints allow. Use this method to change the state: values written into the Functions `q` and
        `v` are not read, and the next step refuses them.

        Parameters
        ----------
        q : Function in `V`, or (nodes, 3) float, optional
            Displacement and rotation of each node [m, rad], by default the present ones.
        v : Function in `V`, or (nodes, 3) float, optional
            Rates [m/s, rad/s], by default zero.

        Raises
        ------
        SceneError
            For another shape or space, values that are not finite, and loops that do not close.
        """
        now, model, fields = self._state, self._equations.model, self._form.fields
        wanted = now.q if q is None else fields.in_scene(q, now.q, "q")
        rates = fields.in_scene(np.zeros(now.v.shape) if v is None else v, 0 * now.v, "v")
        model.reduction.set_start(now.q, now.slides)
        slid = slides_near(model, wanted[None], now.slides[None])[0] - now.slides
        y = model.couplings.unknowns(wanted - now.q, slid)
        D = model.reduction.increment(y, np.zeros(model.reduction.driven))
        if not np.isfinite(D).all():
            raise SceneError("fenicsx: set_state: a loop of joints cannot be closed near this q")
        slides = now.slides + model.couplings.free_slides(y, len(slid))
        kept = {name: getattr(now, name) for name in ("t", "motors", "natural", "parameters")}
        start = drawn_state(model).changed(q=now.q + D, slides=slides, fitted=rates, **kept)
        self._set(self._prepared.state_from(start, self.dt), starts=True)

    def start_from(self, solution: Solution, row: int = -1) -> None:
        """Continue from a solution of `run`, `fx_beam.simulate` or `fx_beam.static`.

        Parameters
        ----------
        solution : Solution
            A solution of a scene with the same members.
        row : int
            The row from which to continue. Rows before the last one are refused with internal
            variables, and with schemes that need data of the step before.

        Raises
        ------
        SceneError
            If it does not fit the scene.
        """
        model, last = self._equations.model, len(solution.t) - 1
        state = self._prepared.first_state(self.dt, solution)
        if row not in (-1, last):
            if model.kinks.flows or model.forms.keeps_previous or solution.stats.static:
                raise SceneError(
                    "fenicsx: start_from: only the last row of this solution has all that the next "
                    "step needs. Leave out `row`"
                )
            names = "q", "v", "a", "slides"
            arrays = {name: getattr(solution, name)[row].ravel().copy() for name in names}
            state = state.changed(
                t=float(solution.t[row]), past=None, q_previous=None, work=0.0, **arrays
            )
            state = state.changed(constraint_forces=None, joint_forces=None, dissipated=0.0)
            state = state.changed(length=0.0, driven_forces=None)
            state = Starts(model, self._prepared.forcing, self.dt).resumed(state, same_scheme=True)
            self._prepared.stepper.load(state)
        self._set(state)


# -- Equilibria at rising loads, whose load steps PETSc takes -------------------------------------


# Unknowns up to which all eigenvalues are found at once.
_FEW = 200
# Part of the largest entry by which entries of a symmetric tangent differ.
_SYMMETRIC = 1e-9


class Equilibrium(DolfinxSteps):
    """A scene as a static problem of dolfinx: equilibria at rising load factors.

    As `Problem`, without inertia and with all loads multiplied by the load factor. A step ends at
    the equilibrium that Newton's method finds: `unstable_modes` tells whether it is stable.
    `fx_beam.static` follows paths through limit points, and finds critical points.

    Parameters
    ----------
    scene : Scene
        The scene, with at least one beam.
    t : float
        Time at which functions of time are evaluated [s].
    petsc_options : dict, optional
        Options of SNES, KSP and PC, without a prefix.
    newton : NewtonOptions, optional
        Convergence criteria.
    comm : MPI.Comm, optional
        Processes that share the mesh and the matrices; by default this process alone.
    mesh : dolfinx.mesh.Mesh, optional
        The mesh that was given to `beams_of`, if the problem shall use this mesh: all beams are
        then its cells, with ``elements=1`` and rigid joints. By default the problem makes a mesh.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane: all elements of all beams. At joints vertices coincide.
    cell_tags : dolfinx.mesh.MeshTags
        Number of the beam of each cell, in the order of ``scene.beams``.
    cell_map : (cells,) int array
        The same numbers as an array. After `beams_of` they are the cells of the mesh given there.
    V : dolfinx function space
        Mixed space of displacement (2) and rotation.
    increment, start : dolfinx.fem.Function
        Increments of displacement and rotation over the step, by which F is differentiated, and
        their values at its start [m, rad].
    test, trial : ufl arguments
        Test function of F, and trial function of J.
    step : Step
        Fields of a step, as `Scene.add_virtual_work` and `Scheme` have them.
    resultants : list of ufl expressions
        N, Q and M of a step, a vector (3,) for each material [N, N, N m].
    u : dolfinx.fem.Function
        Displacement at the end of the last step, for files and pictures [m].
    q, v, a : dolfinx.fem.Function
        Displacement and rotation [m, rad], velocity and spin [m/s, rad/s], and accelerations
        [m/s^2, rad/s^2] at the end of the last step, in `V`.
    snes : PETSc.SNES
        PETSc's nonlinear solver; `replace_resultants` makes a new one.
    system : System
        Residual, matrices, and the maps by which supports and joints act.

    Raises
    ------
    SceneError
        For a scene without beams, or one that its supports do not hold.

    Examples
    --------
    >>> import fx_beam as fb
    >>> from fx_beam import fenicsx
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (0, -1.0))
    >>> solution = fenicsx.Equilibrium(scene).run(load_steps=4)
    >>> bool(abs(solution.q[-1] - fb.static(scene, load_steps=4).q[-1]).max() < 1e-12)
    True
    """

    def __init__(
        self,
        scene: Scene,
        *,
        t: float = 0.0,
        petsc_options: PetscOptions | None = None,
        newton: NewtonOptions | None = None,
        comm: MPI.Comm = MPI.COMM_SELF,
        mesh: DolfinxMesh | None = None,
    ):
        check_scene(scene, "fenicsx.Equilibrium")
        model, newton = Model(scene, AtRest()), newton or NewtonOptions()
        self._stats = stats_of(model, solver="PETSc", static=True)
        self._forcing = LoadForcing(model, float(t))
        loop = LoadLoop(self._forcing, newton, self._stats)
        super().__init__(loop, newton, petsc_options, comm, mesh)
        self._loads = loop
        self._state = drawn_state(model)
        self._form.fields.end(self._state)

    @property
    def load_factor(self) -> float:
        """Load factor at the end of the last step."""
        return self._state.t

    def advance(self, load_factor: float) -> None:
        """Take a load step.

        Parameters
        ----------
        load_factor : float
            Load factor at its end.

        Raises
        ------
        StepError
            If Newton's method fails; then all is as before.
        """
        start, advice = self._state, "Try more load steps, or other petsc_options"
        try:
            self._state, step = self._step(load_factor)
        except StepFailed as failure:
            message = f"the step from load factor {start.t:.6g} to {load_factor:.6g} failed"
            raise self._loads.failures.error(message, 0, start, failure, advice) from failure
        self._stats.add_solve(self.snes.getIterationNumber(), step.ended_by)
        self._stats.steps += 1
        self._form.fields.end(self._state)

    def _step(self, load_factor: float) -> tuple[State, StepSolution]:
        require(np.isfinite(load_factor), "load_factor", load_factor, "a finite number")
        self._form.fields.refuse_writes()
        self._equations.find_natural_strains()
        return self._loads.step(self._state, Interval(self._state.t, float(load_factor)))

    def begin(self, load_factor: float) -> AbstractContextManager[TrialStep]:
        """Begin a load step whose unknowns you compute, as `Problem.begin` does.

        In an arc-length method the load factor is one more unknown. Begin a new step for each value
        of it, with the same y: until `TrialStep.accept` each of these steps starts at the last
        equilibrium.

        Parameters
        ----------
        load_factor : float
            Load factor at its end.

        Returns
        -------
        context manager
            Of a `TrialStep`.
        """

        def prepare() -> None:
            with suppress(StepFailed):
                self._step(load_factor)

        take = partial(self.advance, load_factor)
        return self._trial(prepare, take)

    def load_derivative(self) -> PETSc.Vec:
        """Derivative of the residual by the load factor, at the last evaluation.

        Returns
        -------
        PETSc.Vec
            Minus the loads on the unknowns, with driven motions, natural strains, follower forces
            and added terms that depend on the load factor.
        """
        vector = self._equations.unknowns.A.createVecLeft()
        vector.array[:] = self._equations.unknowns.own(self._equations.load_slope(self._forcing))
        return vector

    def run(
        self,
        load_steps: int = 10,
        after: Callable[[Equilibrium], object] | None = None,
        update: Callable[[Equilibrium], object] | None = None,
    ) -> Solution:
        """Take equal load steps from the present load factor to 1.

        Parameters
        ----------
        load_steps : int
            Their number.
        after : callable, optional
            ``after(equilibrium)`` is called after each step.
        update : callable, optional
            ``update(equilibrium)`` is called after each step, before the row of the step is
            recorded, as in `Problem.run`.

        Returns
        -------
        Solution
            As of `fx_beam.static`, with `Solution.unstable_modes`, but without critical points. The
            first row is the start: at load factor 0 the equilibrium without loads, in which springs
            may be under tension.

        Raises
        ------
        StepError
            If a step fails. Its attribute `solution` has all steps before it.
        """
        expected, ok = "a number from 1 on", isinstance(load_steps, int) and load_steps > 0
        require(ok, "load_steps", load_steps, expected)
        factors = np.linspace(self.load_factor, 1.0, load_steps + 1)
        recorder, modes = Recorder(self._equations.model, factors, Record()), list[int | None]()
        rows = ReplacedRows(self._equations.assembly, recorder)

        def solution() -> Solution:
            loads, last = self._forcing.dead(self.load_factor), self._state
            if self._equations.model.forms.has_added:
                loads = loads + last.added_forces
            end = replace(last, t=self._forcing.time, loads=loads, length=0.0)
            counts = {} if None in modes else {"unstable_modes": np.array(modes[: recorder.rows])}
            path = solution_of(recorder, self._stats, lambda: end, stability=counts)
            return rows.in_solution(path)

        try:
            for step, factor in enumerate(factors):
                self.advance(factor)
                self._loads.record(self._state, recorder)
                modes.append(self.unstable_modes())
                self._lose(rows.follow(partial(update, self) if update and step else None))
                if step and after is not None:
                    after(self)
            result = solution()
            check_ropes(result, self._equations.model.scene)
        except BaseException as error:
            self._stats.failure = failure_of(error, self.load_factor)
            if recorder.rows:
                attach(error, solution)
            raise
        if modes[-1]:
            warn_once(
                f"fenicsx.Equilibrium: the equilibrium at load factor {self.load_factor:g} is "
                f"unstable: {modes[-1]} modes grow. Use fx_beam.static, which finds where the path "
                "becomes unstable"
            )
        return result

    def unstable_modes(self) -> int | None:
        """Number of small motions about the last equilibrium that grow.

        Returns
        -------
        int or None
            Eigenvalues of the reduced tangent with negative real parts; None where they are not
            known: on several processes, and with many unknowns whose forces have no potential.
        """
        if self.mesh.comm.size > 1:
            return None
        indptr, indices, data = self._equations.tangent().getValuesCSR()
        A = scipy.sparse.csr_matrix((data, indices, indptr), (len(indptr) - 1,) * 2)
        if A.shape[0] <= _FEW:
            return int((np.linalg.eigvals(A.toarray()).real < 0).sum())
        if abs(A - A.T).max() > _SYMMETRIC * abs(A).max():
            return None
        # Sylvester's law of inertia: without row interchanges pivots have the signs of eigenvalues.
        options = {"SymmetricMode": True, "Equil": False}
        factors = splu(A.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        return int((factors.U.diagonal() < 0).sum())

    def eigenvalues(self, n: int = 4) -> np.ndarray:
        """Lowest squares of circular frequencies of small motions about the last equilibrium.

        Of K x = omega^2 M x with the tangent K and the mass M of the unknowns, by SLEPc.

        Parameters
        ----------
        n : int
            Number of eigenvalues.

        Returns
        -------
        (n,) complex array
            The n eigenvalues omega^2 closest to zero, in the order of their real parts [1/s^2]; a
            negative real part means instability.

        Raises
        ------
        SceneError
            Without SLEPc (Debian's python3-slepc4py), or without mass.
        """
        pairs = eigenpairs(self._equations, self._equations.tangent(), n)
        return np.array([square for square, _ in pairs])

    def modes(self, n: int = 4) -> FieldModes:
        """Vibration modes about the last equilibrium, without damping, by SLEPc.

        Parameters
        ----------
        n : int
            Number of modes, from the lowest frequency on.

        Returns
        -------
        named tuple
            ``frequencies`` (n,) [Hz], and ``functions``: displacement and rotation of each mode, in
            `V`, with modal mass 1.

        Raises
        ------
        SceneError
            If a small motion grows, without SLEPc, or for a scene without mass.
        """
        return modes_of(self._equations, self._equations.tangent(), n)
