"""Form, fields, solver and replaced rows of a problem whose steps PETSc takes."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, all_of, require
from fx_beam.results.records import BeamResultants
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node, arc_lengths, gauss_rule
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Recorder
from fx_beam.step.stepper import CompiledLoop

from .meshes import BeamMesh
from .reduced_equations import Assembly, Newton, PetscOptions, ReducedEquations, System
from .step_form import Resultants, StepForm, StrainEnergy
from .versions import DolfinxMesh

# -- Resultants and strain energy of the rows of a solution, where a user has replaced them -----


# Place in a row of energies.
_STRAIN, _DISSIPATED = 1, 5


class ReplacedRows:
    """Resultants (cells, points, 3) at the rows of a record, if they are replaced."""

    def __init__(self, assembly: Assembly, recorder: Recorder):
        self._assembly, self._recorder = assembly, recorder
        self._rows: list[np.ndarray] = []

    def follow(self, update: Callable[[], object] | None = None) -> float:
        """Have resultants of the last step, and energies after an `update`, in a new row.

        Returns the energy that was lost in the step [J].
        """
        form, rows = self._assembly.form, self._recorder.rows
        is_new = form.replaced and rows > len(self._rows)
        if is_new:
            self._rows.append(form.grid.at_points(form.fields.resultants))
        if update is not None:
            update()
        lost = form.dissipated() if update is not None else 0.0
        if is_new:
            self._recorder.arrays["energies"][rows - 1, _STRAIN] = form.strain_energy()
            self._recorder.arrays["energies"][rows - 1, _DISSIPATED] += lost
        return lost

    def in_solution(self, solution: Solution) -> Solution:
        """The solution with the resultants of these rows."""
        if not self._assembly.form.replaced:
            return solution
        rows, model = np.array(self._rows), self._assembly.model
        pairs = zip(model.scene.beams, model.mesh.cells, strict=True)
        beams = {beam.name: (beam, cells) for beam, cells in pairs}

        def resultants(name: str) -> BeamResultants:
            beam, cells = beams[name]
            N, Q, M = np.moveaxis(rows[:, cells].reshape(len(rows), -1, 3), -1, 0)
            return BeamResultants(arc_lengths(beam, gauss_rule(beam.degree)[0]).ravel(), N, Q, M)

        solution.resultants_of_beam, solution.has_own_energy = resultants, True
        return solution


# -- A step whose unknowns a user finds: by Newton's method, a line search or an arc length -----


class TrialStep:
    """Residual and tangent of a step that has begun, at unknowns that you choose.

    `Problem.begin` and `Equilibrium.begin` make it. The unknowns y are increments over the step of
    the motions that supports and joints leave free.

    Parameters
    ----------
    newton : Newton
        The solver of the problem.
    equations : Equations
        The equations of the problem.
    advance : callable
        Takes the step.

    Attributes
    ----------
    y : PETSc.Vec
        Predicted unknowns at the end of the step, from which iterations may start.
    """

    def __init__(self, newton: Newton, equations: ReducedEquations, advance: Callable[[], None]):
        self._newton, self._equations, self._advance = newton, equations, advance
        self.y: PETSc.Vec = equations.unknowns.A.createVecRight()
        self.y.array[:] = equations.unknowns.own(equations.y)

    def residual(self, y: PETSc.Vec, out: PETSc.Vec) -> None:
        """Set a vector to the residual Tv^T r.

        Parameters
        ----------
        y : PETSc.Vec
            Unknowns.
        out : PETSc.Vec
            The residual [N, N m]; nan where joints cannot be closed, or nodes turn too far.
        """
        if self._newton.own is None:
            raise SceneError("fenicsx: begin: the step has ended. Begin another one")
        self._newton.residual(y, out)

    def tangent(self, y: PETSc.Vec) -> PETSc.Mat:
        """Derivative of the residual by the unknowns.

        Parameters
        ----------
        y : PETSc.Vec
            Unknowns at which joints can be closed.

        Returns
        -------
        PETSc.Mat
            The matrix of the problem, which the next call overwrites.
        """
        self.residual(y, y.duplicate())
        return self._equations.tangent()

    def accept(self, y: PETSc.Vec) -> None:
        """End the step at these unknowns, as a step of the problem.

        Parameters
        ----------
        y : PETSc.Vec
            The unknowns. The size of their residual is not checked.

        Raises
        ------
        StepError
            If joints cannot be closed at y; the problem is then as before.
        """
        self._newton.own = partial(self._newton.take, y)
        try:
            self._advance()
        finally:
            self._newton.own = None


# -- Small motions about a state, by SLEPc: K x = omega^2 M x with the reduced tangent and mass ---


class FieldModes(NamedTuple):
    """Undamped small motions, from the lowest frequency on."""

    #: Frequencies (n,) [Hz].
    frequencies: np.ndarray
    #: Displacement and rotation of each, in `V`, of modal mass 1.
    functions: list[fem.Function]


def modes_of(equations: ReducedEquations, K: PETSc.Mat, n: int) -> FieldModes:
    """The lowest modes; SceneError if there is one that grows."""
    pairs, fields, mass = eigenpairs(equations, K, n), equations.assembly.fields, equations.mass
    squares = np.array([square.real for square, _ in pairs])
    if (squares < -1e-9 * abs(squares).max(initial=0.0)).any():
        raise SceneError(
            f"fenicsx: modes: a motion grows, as omega^2 = {squares.min():.4g} 1/s^2: the state is "
            "no stable equilibrium. See Equilibrium.eigenvalues and unstable_modes"
        )
    functions = []
    for number, (_, x) in enumerate(pairs, start=1):
        motion = equations.unknowns.T @ x
        function = fem.Function(fields.V, name=f"mode_{number}")
        function.x.array[:] = (motion / np.sqrt(motion @ mass @ motion))[fields.V_numbers]
        functions.append(function)
    return FieldModes(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi), functions)


def eigenpairs(
    equations: ReducedEquations, K: PETSc.Mat, n: int
) -> list[tuple[complex, np.ndarray]]:
    """Squares of circular frequencies next to zero [1/s^2], rising, and unknowns (n,) of each."""
    if importlib.util.find_spec("slepc4py") is None:
        raise SceneError("fenicsx: eigenvalues need SLEPc: install Debian's python3-slepc4py")
    from slepc4py import SLEPc

    unknowns = equations.unknowns
    M = (unknowns.Tv.T @ equations.mass @ unknowns.T).tocsr()
    if not abs(M).sum():
        raise SceneError("fenicsx: eigenvalues: the scene has no mass. Give rhoA, or add_mass")
    solver = SLEPc.EPS().create(K.comm)
    solver.setOperators(K, unknowns.matrix(M))
    solver.setDimensions(n)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.setTarget(0.0)
    transform = solver.getST()
    transform.setType("sinvert")
    pc = transform.getKSP().getPC()
    pc.setType("lu")
    if K.comm.size > 1:
        pc.setFactorSolverType("mumps")
    solver.solve()
    x, pairs = K.createVecRight(), []
    for i in range(min(n, solver.getConverged())):
        pairs.append((solver.getEigenpair(i, x), unknowns.all(x).copy()))
    return sorted(pairs, key=lambda pair: (pair[0].real, pair[0].imag))


# -- Form, fields and solver of a problem whose steps PETSc takes -------------------------------


class DolfinxSteps:
    """A scene on a mesh of dolfinx, in a state; see `Problem` and `Equilibrium`."""

    # Present state.
    _state: State

    def __init__(
        self,
        loop: CompiledLoop,
        newton: NewtonOptions,
        petsc_options: PetscOptions | None,
        comm: MPI.Comm,
        mesh: DolfinxMesh | None,
    ):
        model, beams = loop.model, loop.model.forms.beams
        if beams is None:
            raise SceneError("fenicsx: the scene has no beams, of which a mesh could be made")
        self._options = newton, petsc_options or {}
        grid = BeamMesh(model.scene, model.mesh, beams, comm, mesh)
        self._set_form(StepForm(model, grid), loop)

    def _set_form(self, form: StepForm, loop: CompiledLoop) -> None:
        """Have a form with its fields, equations and solver."""
        newton, petsc_options = self._options
        self._form, fields = form, form.fields
        self._equations = ReducedEquations(Assembly(form, loop.model), loop, newton.max_turn)
        self.mesh, self.cell_tags = form.grid.mesh, form.grid.cell_tags
        self.cell_map = loop.model.mesh.beam_of_cell[form.grid.cells]
        self.system = System(self._equations)
        self._newton = Newton(self._equations, newton, petsc_options)
        self.snes = self._newton.snes
        self.V, self.step, self.resultants = fields.V, fields.step, fields.resultants
        self.increment, self.start = fields.symbols.increment, fields.symbols.start
        self.test, self.trial = fields.symbols.test, fields.symbols.trial
        self.u, self.q, self.v, self.a = fields.u, fields.q, fields.v, fields.a

    @contextmanager
    def _trial(
        self, prepare: Callable[[], object], take: Callable[[], None]
    ) -> Iterator[TrialStep]:
        """A step that `prepare` begins without an end, and that `take` takes if it is accepted."""
        self._newton.own = lambda dt: self._newton.none
        try:
            prepare()
            yield TrialStep(self._newton, self._equations, take)
        finally:
            self._newton.own = None

    def _lose(self, energy: float) -> None:
        """Have an energy [J] among those that are lost since the start."""
        self._state = self._state.changed(dissipated=self._state.dissipated + energy)

    # -- The form ----------------------------------------------------------------------------------

    def written(self, format: str = "text") -> str:
        """Write resultants and terms as on paper, as `Scheme.written` does.

        Parameters
        ----------
        format : {"text", "unicode", "latex"}
            As in `Scheme.written`.

        Returns
        -------
        str
            Lines of each material, and a line ``delta_W`` of each term that was added. Functions
            and Constants have their names, or values.
        """
        return self._form.written(format)

    @property
    def dx(self) -> ufl.Measure:
        """Measure of all beams: ``dx(i)`` is that of the beam ``scene.beams[i]``."""
        return self.measure()

    def measure(
        self, where: Beam | Sequence[Beam] | Node | None = None, points: int | None = None
    ) -> ufl.Measure:
        """Measure of beams, or of a node in which beams end.

        Parameters
        ----------
        where : Beam, list of Beams, or Node, optional
            The beams over which to integrate, by default all; or a node: the integral is then the
            value at this node, once for each beam that ends in it.
        points : int, optional
            Number of Gauss points of an element; by default that of the internal forces, which is
            the degree of the elements.

        Returns
        -------
        ufl.Measure
            ``dx`` or ``ds`` with its rule.

        Raises
        ------
        SceneError
            For what is not in the scene, and for a node inside beams.
        """
        return self._form.grid.measure(where, points)

    def add(self, term: ufl.Form) -> None:
        """Add a virtual work to the residual; a positive one acts against the motion.

        The work of the term is part of `Energy.work`. Constants and Functions in the term are read
        anew in each iteration. An elastic foundation with a Constant k as its stiffness:
        ``problem.add(k * ufl.dot(step.u, step.virtual_u) * problem.measure())``.

        Parameters
        ----------
        term : ufl.Form
            Integral over `mesh` that is linear in ``step.virtual_u`` and ``step.virtual_psi``.

        Raises
        ------
        SceneError
            For what is no such form, and for one on another mesh.
        """
        self._form.added.append(self._form.term("add", term))

    def replace_resultants(
        self,
        resultants: Resultants,
        strain_energy: StrainEnergy | None = None,
        dissipation: StrainEnergy | None = None,
    ) -> None:
        """Replace the stress resultants of the scene.

        Call this method first: it makes a new `step`, `snes` and `system`, and removes added terms.
        Expressions with fields of the old `step` are then refused.

        Parameters
        ----------
        resultants : callable
            ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, as in
            `Scheme`; they may contain Functions and Constants on `mesh`. `m` is the moment that
            does the virtual work, and `M` the one that solutions have: change both.
        strain_energy : callable, optional
            ``strain_energy(eps, gamma, kappa)`` gives the stored energy at the end of a step [J/m],
            for `energies` and for solutions; without it their strain energy is nan.
        dissipation : callable, optional
            ``dissipation(eps, gamma, kappa)`` gives the energy that is lost in a step of `run`
            [J/m], from the strains at the end of the step and from Functions. It is evaluated after
            `update`, and is part of `Energy.dissipated`.

        Notes
        -----
        In scenes with natural strains a warning says that their work, in `Energy.work`, is by the
        resultants of the scene.

        Raises
        ------
        SceneError
            For symbols on another mesh, of the old `step`, or without values; also in
            `natural_strains`. The problem is then as before.
        """
        loop = self._equations.loop
        form = StepForm(
            loop.model, self._form.grid, self._form, resultants, strain_energy, dissipation
        )
        self._set_form(form, loop)
        form.fields.end(self._state)

    def replace_form(self, F: ufl.Form, energy: ufl.Form | None = None) -> None:
        """Replace the virtual work of all beams by a form as a whole.

        Inertia, drag, loads, joints, forces at points and added terms remain those of the scene. N,
        Q and M of a solution are then nan, as the form does not define them.

        Parameters
        ----------
        F : ufl.Form
            Virtual work of the beams over `mesh`, linear in `test`. It may contain `start`,
            `increment`, fields of `step` that depend on these, and Functions and Constants on
            `mesh`. In a step of `Equilibrium` it may be ``ufl.derivative(Pi, problem.increment,
            problem.test)``.
        energy : ufl.Form, optional
            Stored energy Pi [J] at the end of the step, as a function of `start` and `increment`,
            for `energies` and for solutions; without it their strain energy is nan.

        Raises
        ------
        SceneError
            For anything that is no such form; in scenes with retardation, internal variables or
            natural strains, and with schemes that damp, as the form would not contain these
            effects. The problem is then as before.
        """
        self._form.replace_work(F, energy)
        self.resultants = self._form.fields.resultants

    @property
    def natural_strains(self) -> Expr | None:
        """Axial strain, shear strain and curvature (3,) without stress, in UFL; None for none.

        The expression may contain Functions that other problems compute on `mesh` between steps,
        such as a temperature. It is evaluated at the Gauss points before each step, as the value at
        the end of the step, and replaces the natural strains of the scene. The scene needs some
        natural strain for this: ``scene.add_natural_strain(beam, axial=0.0)``. The first step
        starts with the natural strains of the scene and ends with this expression. The work of
        changing natural strains is part of `Energy.work`.
        """
        return self._form.natural

    @natural_strains.setter
    def natural_strains(self, strains: Sequence[Expr | float] | None) -> None:
        if not self._equations.model.data.natural:
            raise SceneError(
                "fenicsx: natural_strains: the scene has none, so that its forms have none. Call "
                "scene.add_natural_strain(beam, axial=0.0) before the problem is made"
            )
        vector = None if strains is None else ufl.as_vector(strains)
        if vector is not None:
            expected = "three numbers or expressions in UFL"
            require(vector.ufl_shape == (3,), "fenicsx: natural_strains", vector, expected)
            self._form.check("natural_strains", vector)
        self._form.natural = vector

    @property
    def F(self) -> ufl.Form:
        """Residual of a step as a form, without inertia and forces at points.

        If terms that you add have other tags of cells than `cell_tags`, or another number of Gauss
        points, assemble the forms of `parts` one by one: two kinds of tags do not compile in one
        form, and FFCx 0.5 confuses several Gauss rules.
        """
        return self._form.F

    @property
    def parts(self) -> list[ufl.Form]:
        """Forms whose sum is F: internal forces, drag if there is any, and added terms."""
        return self._form.parts

    @property
    def F_inertia(self) -> ufl.Form:
        """Inertia of beams in a step, for schemes of Newmark's family.

        `F` plus this form minus `loads` is the residual of `system`, without lumped masses and
        forces at points. Assemble each form alone, as their Gauss rules differ. The inertia of
        other schemes is `System.M` times nodal accelerations and no form; reading this attribute is
        then a SceneError.
        """
        return self._form.inertia(self._equations.model)

    @property
    def loads(self) -> np.ndarray:
        """Dead loads and gravity (size,) in the last step, ordered as in `system` [N, N m]."""
        return self._equations.dead.copy()

    @property
    def J(self) -> ufl.Form:
        """Derivative of `F` by the increment of the step."""
        return self._form.J

    # -- Values ------------------------------------------------------------------------------------

    def at_points(
        self, expression: Expr | list[Expr], points: ArrayLike | None = None
    ) -> np.ndarray:
        """Values of an expression at points of all elements.

        Parameters
        ----------
        expression : ufl expression or list
            An expression of the last step, or a list with one for each material, as `resultants`
            is.
        points : (m,) float, optional
            Places in an element, from 0 to 1; by default the Gauss points of the internal forces.

        Returns
        -------
        (cells, m, ...) float array
            The values, beam by beam, and along each beam from its start.

        Raises
        ------
        SceneError
            For symbols on another mesh, of a step before `replace_resultants`, or without values;
            for a list whose length is not the number of materials, and for places outside elements.
        """
        parts = [*map(ufl.as_ufl, expression if isinstance(expression, list) else [expression])]
        ok = not isinstance(expression, list) or len(parts) == len(self.resultants)
        ok = ok and len({part.ufl_shape for part in parts}) == 1
        expected = "in UFL, or a list of equal shapes, one for each material as in `resultants`"
        require(ok, "fenicsx: expression", expression, expected)
        self._form.check("expression", *parts)
        if points is not None:
            ok = all_of(abs(np.asarray(points, float) - 0.5) <= 0.5)
            require(ok, "fenicsx: points", points, "numbers from 0 to 1")
        return self._form.grid.at_points(parts, points)

    def interpolate(self, expression: Expr | list[Expr], name: str = "f") -> fem.Function:
        """Interpolate an expression at the Gauss points, element by element.

        Parameters
        ----------
        expression : ufl expression or list
            As in `at_points`.
        name : str
            Name of the Function, in files.

        Returns
        -------
        dolfinx.fem.Function
            A discontinuous Function, of one degree less than the elements.
        """
        values = self.at_points(expression)
        expected = "a scalar or a vector"
        require(values.ndim < 4, "fenicsx: interpolate: expression", expression, expected)
        return self._form.grid.interpolated(values, name)

    def function(self, name: str, shape: tuple[int, ...] = ()) -> fem.Function:
        """Make a Function of zeros at the Gauss points, in the space of `interpolate`.

        Parameters
        ----------
        name : str
            Name of the Function, in files.
        shape : tuple, optional
            Shape of a value: a scalar, or (n,) of a vector.

        Returns
        -------
        dolfinx.fem.Function
            The Function, such as for internal variables of your own.
        """
        return self.interpolate(ufl.zero(*shape), name)

    def energies(self) -> dict[str, float]:
        """Energies at the end of the last step, assembled by dolfinx.

        Returns
        -------
        dict
            "kinetic", "strain" (of beams), "potential" and "springs" (all other stored energy) [J].
        """
        state, model = self._state, self._equations.model
        weight, mass = model.masses.weight, model.masses.matrix
        return {
            "kinetic": float(state.v @ (mass @ state.v)) / 2,
            "strain": self._form.strain_energy(),
            "potential": 0.0 if weight is None else -float(weight @ state.q),
            "springs": float(
                model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
            ),
        }
