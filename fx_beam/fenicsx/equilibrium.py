"""Equilibria at rising loads, whose load steps PETSc takes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.errors import require, warn_once
from fx_beam.laws.interval import Interval
from fx_beam.laws.schemes import Equilibrium as AtRest
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.initial_state import drawn_state
from fx_beam.motions.motion_setup import check_scene, stats_of
from fx_beam.motions.progress import attach, failure_of
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.stepper import LoadLoop, StepFailed, StepSolution

from .reduced_equations import PetscOptions
from .steps import DolfinxSteps, FieldModes, ReplacedRows, TrialStep, eigenpairs, modes_of
from .versions import DolfinxMesh

# Unknowns up to which all eigenvalues are found at once.
_FEW = 200
# Part of the largest entry by which entries of a symmetric tangent differ.
_SYMMETRIC = 1e-9


class Equilibrium(DolfinxSteps):
    """A scene as a static problem of dolfinx: equilibria at rising load factors.

    As `Problem`, but for inertia: all loads are multiplied by the load factor. A step goes where
    Newton's method leads: `unstable_modes` tells whether that is stable. `fx_beam.static` follows
    paths through limit points, and finds critical points.

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
        Processes that share the mesh and the matrices; by default this one alone.

    mesh : dolfinx.mesh.Mesh, optional
        The mesh of `beams_of`, to be that of the problem: if all beams are its cells, undivided and
        rigid where they meet. By default the problem makes one.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane: all elements of all beams. At joints vertices coincide.
    cell_tags : dolfinx.mesh.MeshTags
        Number of the beam of each cell, in the order of ``scene.beams``.
    cell_map : (cells,) int array
        The same as an array: of beams of `beams_of` the cell of its mesh.
    V : dolfinx function space
        Mixed space of displacement (2) and rotation.
    increment, start : dolfinx.fem.Function
        Displacement and rotation: their increment over the step, by which F is derived, and their
        start [m, rad].
    test, trial : ufl arguments
        Test function of F, and trial function of J.
    step : Step
        Fields of a step, as `Scene.add_virtual_work` and `Scheme` have them.
    resultants : list of ufl expressions
        N, Q and M of a step, a vector (3,) for each material [N, N, N m].
    u : dolfinx.fem.Function
        Displacement at the end of the last step, for files and pictures [m].
    q, v, a : dolfinx.fem.Function
        Displacement and rotation at the end of the last step, in `V`, their rates, and
        accelerations [m, rad].
    snes : PETSc.SNES
        PETSc's nonlinear solver; `replace_resultants` makes a new one.
    system : System
        Residual, matrices and maps of all degrees of freedom of the scene.

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
        """Begin a load step whose unknowns you find, as `Problem.begin` does.

        Along an arc length the load factor is one more unknown: begin anew at each, with the same
        y, as the step starts at the last equilibrium until `TrialStep.accept`.

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
        """Derivative of the residual by the load factor, where it was found last.

        Returns
        -------
        PETSc.Vec
            Minus the loads on the unknowns, and what else has the load factor: driven motions,
            natural strains, followers and added terms.
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
            ``update(equilibrium)`` is called after each step, before its row is recorded, as in
            `Problem.run`.

        Returns
        -------
        Solution
            As `fx_beam.static` gives it, with `Solution.unstable_modes`, but without critical
            points. Its first row is the start; at load factor 0 an equilibrium without loads, such
            as that of springs under tension.

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
            result = solution_of(recorder, self._stats, lambda: end, stability=counts)
            return rows.in_solution(result)

        try:
            for step, factor in enumerate(factors):
                self.advance(factor)
                self._loads.record(self._state, recorder)
                modes.append(self.unstable_modes())
                self._lose(rows.follow(partial(update, self) if update and step else None))
                if step and after is not None:
                    after(self)
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
        return solution()

    def unstable_modes(self) -> int | None:
        """Number of small motions that grow about the last equilibrium.

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

        By SLEPc, about zero: K x = omega^2 M x with the reduced tangent and mass.

        Parameters
        ----------
        n : int
            How many.

        Returns
        -------
        (n,) complex array
            Those nearest to zero, by their real parts [1/s^2]; negative ones belong to instability.

        Raises
        ------
        SceneError
            Without SLEPc (Debian's python3-slepc4py), or without mass.
        """
        pairs = eigenpairs(self._equations, self._equations.tangent(), n)
        return np.array([square for square, _ in pairs])

    def modes(self, n: int = 4) -> FieldModes:
        """Small undamped motions about the last equilibrium, by SLEPc.

        Parameters
        ----------
        n : int
            How many, from the lowest frequency on.

        Returns
        -------
        named tuple
            ``frequencies`` (n,) [Hz], and ``functions``, of which each has displacement and
            rotation in `V`, with modal mass 1.

        Raises
        ------
        SceneError
            Where a motion grows, without SLEPc, and without mass.
        """
        return modes_of(self._equations, self._equations.tangent(), n)
