"""The weak form of a step of all beams of a scene, on a mesh of dolfinx."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import ufl
from dolfinx import fem

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError, require
from fx_beam.fem import elements
from fx_beam.fem.fields import section_data
from fx_beam.fem.weak_form import Kind, WeakForm
from fx_beam.laws.interval import Interval
from fx_beam.laws.kinematics import Step
from fx_beam.laws.schemes import Scheme
from fx_beam.results.audit import BeamResultants
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node, arc_lengths, gauss_rule
from fx_beam.scene.law import Law
from fx_beam.step.model import Model
from fx_beam.step.recorder import Recorder

from .symbols import DolfinxSymbols
from .versions import (
    cell_dofs,
    cell_nodes,
    cell_vertices,
    compiled,
    count_cells,
    create_mesh,
    exterior_facets,
    function_space,
    is_empty,
    values_at,
)

if TYPE_CHECKING:
    from .newton import Newton

Resultants = Callable[[Step, Law], Any]


class StepForm:
    """The weak form of a step, its Functions, and what is assembled of it.

    Vectors of a scene (size,) have all its degrees of freedom on each process.
    """

    # Present state, and Newton's method, of those that take steps.
    _state: State
    _newton: Newton

    def __init__(self, model: Model, comm: MPI.Comm):
        if model.forms.beams is None:
            raise SceneError("fenicsx: the scene has no beams, of which a mesh could be made")
        self._model, self._nodes, self._beams = model, model.mesh, model.forms.beams
        #: The processes that share the mesh.
        self.comm = comm
        degree = self._beams.degree if self._nodes.curved else 1
        points = self._nodes.points.astype(np.int64)
        self.mesh = create_mesh(comm, points, self._nodes.X, elements.lagrange(degree, 2))
        # Number in the scene of each cell that this process has.
        self._cells = np.asarray(self.mesh.topology.original_cell_index)
        self._check_order()
        self._tags = self._tagged(1, self._nodes.beam_of_cell[self._cells])
        materials = self._tagged(1, self._beams.tags[self._cells])
        self._symbols = DolfinxSymbols(self.mesh, materials)
        self._pattern = pattern = model.forms.stiffness.copy()
        pattern.data[:] = 0.0
        self._local = local_matrix(pattern)
        # Natural strains of a user, and resultants (cells, points, 3) of rows that are replaced.
        self._natural: Any = None
        self._rows: list[np.ndarray] = []
        self._write(self._beams.kind)
        self.mass = self._assembled_mass()

    def _check_order(self) -> None:
        """Nodes of cells are where the scene has them, in its order."""
        points = self._nodes.points
        at = self.mesh.geometry.x[cell_nodes(self.mesh, points.shape[1]), :2]
        assert np.array_equal(at, self._nodes.X[points][self._cells])

    def _write(self, kind: Kind) -> None:
        """Write the forms, and make their Functions."""
        beams, form = self._beams, WeakForm(kind, self._symbols)
        self._fields = fields = form.fields
        #: The step in UFL; its fields are Functions and Constants of dolfinx.
        self.step = form.step
        #: N, Q and M, as one vector for each material.
        self.resultants = form.resultants
        self._internal, self._parameters = form.internal, form.parameters
        #: Space of displacements (2) and rotation (1).
        self.V = fields.start.function_space
        # Number in the scene of each degree of freedom of V, and of the space of increments: that
        # one is discontinuous where nodal rotations are components. Several may have one number.
        spaces = self.V, fields.increment.function_space
        self._of_V, self._of_D = (self._numbers(S, self._nodes.unknowns.dofs) for S in spaces)
        #: State at the end of the last step, its rates, and accelerations.
        self.q, self.v, self.a = (fem.Function(self.V, name=name) for name in "qva")
        displacements, self._of_u = self.V.sub(0).collapse()
        #: Displacement, on a space of its own, as files and pictures take it.
        self.u = fem.Function(displacements, name="u")
        for name, symbol in form.named_data.items():
            self._fill(symbol, np.asarray(beams.data[name], dtype=float))
        written = form.of_step().forms
        #: Terms of the residual, without inertia. Each is assembled by itself: FFCx 0.5 confuses
        #: quadrature rules.
        self.terms = [written[name] for name in ("internal forces", "drag") if name in written]
        self._own_terms = len(self.terms)
        # With the term itself, as a number of another object may come back.
        self._compiled: dict[int, tuple[ufl.Form, Any, Any]] = {}
        ends = {fields.start: self.q, fields.natural[0]: fields.natural[1]}
        if self._internal is not None:
            self._internal_end = fem.Function(self._internal.function_space)
            ends[self._internal] = self._internal_end
        self._energy = compiled(ufl.replace(written["strain energy"], ends))
        self._replaces = False

    # -- From the scene to Functions, and back -----------------------------------------------------

    def _tagged(self, dimension: int, tags: np.ndarray) -> Any:
        every = np.arange(len(tags), dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, dimension, every, tags.astype(np.int32))

    def _numbers(self, space: Any, of_cells: np.ndarray) -> np.ndarray:
        """The number that each degree of freedom of a space has in its cell (cells, width)."""
        dofs = cell_dofs(space)
        numbers = np.zeros(dofs.max(initial=-1) + 1, dtype=PETSc.IntType)
        numbers[dofs] = of_cells[self._cells]
        return numbers

    def _fill(self, function: fem.Function, of_cells: np.ndarray) -> None:
        """Set a Function by its values (cells, ...), cells in the scene's order."""
        values = of_cells.reshape(len(of_cells), -1)[self._cells]
        function.x.array[cell_dofs(function.function_space)] = values

    def _gathered(self, of_cells: np.ndarray) -> np.ndarray:
        """Values (cells, ...) of the cells that processes own, of all of them."""
        values = np.zeros((len(self._nodes.points), *of_cells.shape[1:]))
        values[self._cells[: len(of_cells)]] = of_cells
        return self._sum(values)

    def _sum(self, values: np.ndarray) -> np.ndarray:
        """The sum over all processes, in place."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, values)
        return values

    def _begin(self, interval: Interval, state: State, natural: np.ndarray | None) -> None:
        """Set the start of a step, and natural strains (cells, degree, 3) at its end."""
        fields, at_rest = self._fields, self._model.scheme.rates.at_rest
        fields.time.value = interval.at(self._model.scheme.rates.level)
        fields.dt.value = 1.0 if at_rest else interval.length
        fields.load_factor.value = interval.end if at_rest else 1.0
        fields.load_increment.value = interval.length
        fields.memory.value = state.memory(interval.length)
        q_previous = state.q if state.q_previous is None else state.q_previous
        functions = fields.start, *fields.start_rates, fields.q_previous
        for function, x in zip(functions, (state.q, state.v, state.a, q_previous), strict=True):
            function.x.array[:] = x[self._of_V]
        for function, strains in zip(fields.natural, (state.natural, natural), strict=True):
            if strains is not None:
                self._fill(function, strains)
        if self._internal is not None:
            self._fill(self._internal, state.internal)
        self._use(self._model.forms.parameters.values)

    def _use(self, parameters: np.ndarray | None) -> None:
        """Have values (n,) of all parameters of the scene."""
        if self._parameters is not None and parameters is not None:
            self._parameters.value[:] = parameters[self._beams.parameters]

    def _end(self, state: State) -> None:
        """Set the end of a step."""
        for function, x in zip((self.q, self.v, self.a), (state.q, state.v, state.a), strict=True):
            function.x.array[:] = x[self._of_V]
        self.u.x.array[:] = self.q.x.array[self._of_u]
        if self._internal is not None:
            self._fill(self._internal_end, state.internal)
        if state.natural is not None:
            self._fill(self._fields.natural[1], state.natural)
        self._use(state.parameters)

    # -- What a user adds and asks -----------------------------------------------------------------

    def measure(self, where: Beam | Node | None = None, points: int | None = None) -> ufl.Measure:
        """Measure of a beam, of all beams, or of a node at the end of beams.

        Parameters
        ----------
        where : Beam or Node, optional
            Over which beam to integrate, by default over all; or the node, of which the integral is
            the value there, once for each beam that ends in it.
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
            If the node is no end of the mesh.
        """
        if isinstance(where, Node):
            return self._measure_of_node(where)
        dx = elements.measure(self.mesh.ufl_domain(), points or self._beams.degree)
        dx = dx(subdomain_data=self._tags)
        return dx if where is None else dx(self._number_of(where))

    def _measure_of_node(self, node: Node) -> ufl.Measure:
        numbers = self._nodes.points[self._cells][:, :2]
        here = np.unique(cell_vertices(self.mesh)[numbers == node.number])
        exterior = exterior_facets(self.mesh)
        found = np.isin(here, exterior)
        if not self.comm.allreduce(int(found.any()), MPI.MAX):
            raise SceneError(
                f"fenicsx: {node} is no end of the mesh: integrals over single nodes are possible "
                "where one beam ends. Use scene.add_force for a force on another node"
            )
        facets = here[found].astype(np.int32)
        tags = dolfinx.mesh.meshtags(self.mesh, 0, facets, np.ones(len(facets), np.int32))
        return ufl.Measure("ds", domain=self.mesh.ufl_domain(), subdomain_data=tags)(1)

    def _number_of(self, beam: Beam) -> int:
        if beam not in self._model.scene.beams:
            raise SceneError(f"fenicsx: {beam} is no beam of this scene")
        return self._model.scene.beams.index(beam)

    def add(self, term: ufl.Form) -> None:
        """Add a term to the residual: virtual work against the motion.

        Parameters
        ----------
        term : ufl.Form
            An integral that is linear in ``step.virtual_u`` and ``step.virtual_psi``, on `mesh`. It
            may contain Functions and Constants of dolfinx, which are read anew in each iteration.

        Raises
        ------
        SceneError
            For what is no form of rank one in the test function of `step`, or on another mesh.

        Examples
        --------
        A spring foundation, whose stiffness is a Constant: ``problem.add(k * ufl.dot(step.u,
        step.virtual_u) * problem.measure())``.
        """
        require(
            isinstance(term, ufl.Form), "fenicsx: add: term", term, "a form: c * problem.measure()"
        )
        wanted = "fenicsx: add: the term must be linear in step.virtual_u and step.virtual_psi"
        if {domain.ufl_id() for domain in term.ufl_domains()} != {self.mesh.ufl_domain().ufl_id()}:
            raise SceneError(
                "fenicsx: add: the term is an integral over another mesh. Use problem.measure() or "
                "a measure with domain=problem.mesh"
            )
        if [*term.arguments()] != [self._fields.test]:
            others = [argument for argument in term.arguments() if argument != self._fields.test]
            has = f"it has {', '.join(map(str, others))}" if others else "it has neither"
            raise SceneError(f"{wanted} of problem.step; {has}")
        form = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(term)
        arities = ufl.algorithms.check_arities
        try:
            for integral in form.integrals():
                arities.check_integrand_arity(integral.integrand(), (self._fields.test,))
        except (ValueError, arities.ArityMismatch) as error:  # products of test functions
            raise SceneError(f"{wanted}, not {str(term)[:200]}") from error
        self.terms.append(term)

    def replace_resultants(self, resultants: Resultants, strain_energy: Callable | None = None):
        """Have other stress resultants than those of the scheme.

        The step and its Functions are new ones then, and terms that were added are gone: call it
        first.

        Parameters
        ----------
        resultants : callable
            ``resultants(step, law)`` gives the `fx_beam.Resultants` of a step, as in
            `fx_beam.Scheme`; it may have Functions and Constants on `mesh`.
        strain_energy : callable, optional
            ``strain_energy(eps, gamma, kappa)`` gives the stored energy [J/m] at the end of a step,
            for `energies` and for solutions. Without it they have nan.
        """
        kind = self._beams.kind
        scheme = Scheme(kind.scheme.name, resultants, kind.scheme.rates)
        self._write(kind._replace(scheme=scheme))
        self._replaces, self._energy = True, None
        if strain_energy is not None:
            start = self._fields.start
            density = strain_energy(*self.step.strains0) * self.measure()
            self._energy = compiled(ufl.replace(density, {start: self.q}))

    @property
    def F(self) -> ufl.Form:
        """The residual without inertia, whose rates are nodal, and without forces at points."""
        return sum(self.terms[1:], self.terms[0])

    @property
    def J(self) -> ufl.Form:
        """The derivative of `F` by the increment of the step, in which it is bilinear."""
        return ufl.derivative(self.F, self._fields.increment, self._fields.trial)

    @property
    def K(self) -> PETSc.Mat:
        """The tangent of the last iteration, of all degrees of freedom of the scene, as a copy.

        In the order of the scene: displacements (2) and rotation of each node. Without inertia,
        supports, and forces at points; those of joints are in `T` and `Tv`.
        """
        K = self._pattern.copy()
        K.data[:] = self._sum(self._tangent().copy())
        return self._shared(K)

    @property
    def M(self) -> PETSc.Mat:
        """The mass matrix of all degrees of freedom of the scene [kg, kg m^2], as a copy."""
        return self._shared(self.mass)

    def _shared(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix whose rows the processes share."""
        new = PETSc.Mat().create(self.comm)
        new.setSizes(matrix.shape)
        new.setType("aij")
        new.setUp()
        first, last = new.getOwnershipRange()
        rows = matrix[first:last]
        new.setPreallocationCSR(csr_of(rows))
        new.assemble()
        return new

    def at_points(self, expression: Any, points: np.ndarray | None = None) -> np.ndarray:
        """Values of an expression at points of all elements.

        Parameters
        ----------
        expression : ufl expression or list
            Or one for each material, as `resultants` are.
        points : (m,) float, optional
            Places in an element, from 0 to 1; by default the Gauss points of the internal forces.

        Returns
        -------
        (cells, m, ...) float array
            Values in the scene's order of elements: beam by beam, along each.
        """
        places = gauss_rule(self._beams.degree)[0] if points is None else np.asarray(points, float)
        of_materials = expression if isinstance(expression, list) else [expression]
        cells = self._cells[: count_cells(self.mesh)[0]]
        tags = self._beams.tags[cells] if len(of_materials) > 1 else 0 * cells
        values = np.empty((len(tags), len(places), *of_materials[0].ufl_shape))
        for tag, of_material in enumerate(of_materials):
            here = np.flatnonzero(tags == tag)
            values[here] = values_at(of_material, places[:, None], self.mesh, here)
        return self._gathered(values)

    def interpolate(self, expression: Any, name: str = "f") -> fem.Function:
        """An expression as a discontinuous Function, which has its values at the Gauss points.

        Parameters
        ----------
        expression : ufl expression or list
            Or one for each material, as `resultants` are.
        name : str
            The Function's name, in files.

        Returns
        -------
        dolfinx.fem.Function
            Of a degree less than the elements.
        """
        values, p, exponents = self.at_points(expression), self._beams.degree, None
        exponents = np.arange(p)
        places = [0.5] if p == 1 else [0.0, 1.0, *np.linspace(0, 1, p)[1:-1]]
        to_places = np.power.outer(places, exponents)
        to_places = to_places @ np.linalg.inv(np.power.outer(gauss_rule(p)[0], exponents))
        element = elements.lagrange(p - 1, *values.shape[2:], broken=True)
        function = fem.Function(function_space(self.mesh, element), name=name)
        self._fill(function, np.einsum("np,cp...->cn...", to_places, values))
        return function

    @property
    def snes(self) -> Any:
        """PETSc's SNES of the last step; None before the first one."""
        return self._newton.snes

    @property
    def T(self) -> Any:
        """Motion (size, n) of all degrees of freedom with the unknowns, in SciPy's rows."""
        return self._newton.T

    @property
    def Tv(self) -> Any:
        """Virtual motion (size, n) likewise: forces on the unknowns are Tv^T r."""
        return self._newton.Tv

    @property
    def iterations(self) -> int:
        """Iterations of Newton's method in the last step."""
        return self._newton.iterations

    @property
    def natural_strains(self) -> Any:
        """Axial strain, shear strain and curvature (3,) without stress, in UFL; None for none.

        They may contain Functions of fields that other problems compute on `mesh` between steps,
        such as a temperature. They are evaluated at the Gauss points before each step, and have the
        place of those of the scene, which needs some on a beam: ``scene.add_natural_strain(beam,
        axial=0.0)``. Their work is part of `Energy.work`.
        """
        return self._natural

    @natural_strains.setter
    def natural_strains(self, strains: Any) -> None:
        if not self._model.natural:
            raise SceneError(
                "fenicsx: natural_strains: the scene has none, so that its forms do not have them. "
                "Before the problem is made, call scene.add_natural_strain(beam, axial=0.0)"
            )
        self._natural = None if strains is None else ufl.as_vector(strains)

    def energies(self) -> dict[str, float]:
        """Energies at the end of the last step, assembled by dolfinx.

        Returns
        -------
        dict
            "kinetic", "strain" (of beams), "potential" and "springs" (all other stored energy) [J].
        """
        state, model = self._state, self._model
        return {
            "kinetic": float(state.v @ (self.mass @ state.v)) / 2,
            "strain": self._strain_energy(),
            "potential": 0.0 if model.weight is None else -float(model.weight @ state.q),
            "springs": float(model.points.energy(state.q, state.slides, state.spring_internal)),
        }

    def _find_natural_strains(self) -> None:
        """Have the natural strains of a user at the end of the next step."""
        if self._natural is not None:
            self._newton.natural = self.at_points(self._natural)

    def _replace_in_row(self, recorder: Recorder) -> None:
        """Have what follows from replaced resultants in the last row of a record."""
        if self._replaces:
            recorder.arrays["energies"][recorder.rows - 1, 1] = self._strain_energy()
            self._rows.append(self.at_points(self.resultants))

    def _with_replaced(self, solution: Solution) -> Solution:
        """The solution with replaced resultants."""
        if not self._replaces:
            return solution
        rows, scene, cells = np.array(self._rows), self._model.scene, self._nodes.cells
        of_beams = {beam.name: (beam, here) for beam, here in zip(scene.beams, cells, strict=True)}

        def of_beam(name: str) -> BeamResultants:
            beam, here = of_beams[name]
            N, Q, M = np.moveaxis(rows[:, here].reshape(len(rows), -1, 3), -1, 0)
            return BeamResultants(arc_lengths(beam, gauss_rule(beam.degree)[0]).ravel(), N, Q, M)

        solution.resultants_of_beam = of_beam
        return solution

    # -- Assembly ----------------------------------------------------------------------------------

    def _forms_of(self, term: ufl.Form) -> tuple[Any, Any]:
        """A term and its derivative by the increment, compiled; None for one that is zero."""
        if id(term) not in self._compiled:
            tangent = ufl.derivative(term, self._fields.increment, self._fields.trial)
            of_tangent = None if is_empty(tangent) else compiled(tangent)
            self._compiled[id(term)] = term, compiled(term), of_tangent
        return self._compiled[id(term)][1:]

    def _residual(self, D: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The terms (2, size) of the weak form and of the user at increments D (size,)."""
        size, out = self._model.size, []
        if D is not None:
            self._fields.increment.x.array[:] = D[self._of_D]
        for terms in (self.terms[: self._own_terms], self.terms[self._own_terms :]):
            b = np.zeros(len(self._of_D))
            for term in terms:
                fem.assemble_vector(b, self._forms_of(term)[0])
            out.append(np.bincount(self._of_D, b, size) if terms else np.zeros(size))
        own, added = self._sum(np.array(out)) if self.comm.size > 1 else out
        return own, added

    def _add_tangent(self, matrix: PETSc.Mat, numbers: Any) -> None:
        """Add the tangent to a matrix, at these numbers of degrees of freedom; -1 for none."""
        matrix.setLGMap(numbers, numbers)
        for term in self.terms:
            tangent = self._forms_of(term)[1]
            if tangent is not None:
                fem.petsc.assemble_matrix(matrix, tangent)
        matrix.assemble()

    def _tangent(self) -> np.ndarray:
        """Its values in the pattern of the scene, of the cells of this process."""
        self._local.zeroEntries()
        self._add_tangent(self._local, self._scene_map)
        return self._local.getValuesCSR()[2]

    @property
    def _scene_map(self) -> PETSc.LGMap:
        return PETSc.LGMap().create(self._of_D, comm=MPI.COMM_SELF)

    def _assembled_mass(self) -> scipy.sparse.csr_matrix:
        """Mass (eqs 19 to 21) of beams, with lumped masses, of all degrees of freedom."""
        scene, degree = self._model.scene, self._beams.degree
        names = "rhoA", "rhoI"
        data = np.asarray(section_data(self._nodes, scene, names, degree + 1), float)
        density = self._fields.data((data.shape[1], (2,)))
        self._fill(density, data)
        (u, psi), (v, virtual) = (
            ufl.split(f(self.V)) for f in (ufl.TrialFunction, ufl.TestFunction)
        )
        per_length = density[0] * ufl.dot(u, v) + density[1] * psi * virtual
        form, M = compiled(per_length * self._fields.measure(degree + 1)), self._local
        numbers = PETSc.LGMap().create(self._of_V, comm=MPI.COMM_SELF)
        M.setLGMap(numbers, numbers)
        fem.petsc.assemble_matrix(M, form)
        M.assemble()
        lumped = np.zeros(self._model.size)
        for node, m, inertia in scene.masses:
            lumped[self._nodes.dofs[node]] += float(m), float(m), float(inertia)
        mass = self._pattern.copy()
        mass.data[:] = self._sum(M.getValuesCSR()[2].copy())
        mass.data[self._model.masses.diagonal] += lumped
        return mass

    def _strain_energy(self) -> float:
        """Stored energy of beams [J] at the end of the step; nan where it is not known."""
        if self._energy is None:
            return np.nan
        return float(self.comm.allreduce(fem.assemble_scalar(self._energy)))


def csr_of(matrix: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of a matrix, as PETSc takes them."""
    matrix.sort_indices()
    indptr, indices = (part.astype(PETSc.IntType) for part in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data


def local_matrix(pattern: scipy.sparse.csr_matrix) -> PETSc.Mat:
    """A matrix of this process alone, of a pattern."""
    return PETSc.Mat().createAIJ(pattern.shape, csr=csr_of(pattern), comm=MPI.COMM_SELF)
