"""The weak form of a step of all beams of a scene, on a mesh of dolfinx."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import ufl
from dolfinx import fem

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError, require
from fx_beam.fem.beam_data import Kind, section_data
from fx_beam.fem.weak_form import WeakForm
from fx_beam.laws.interval import Interval
from fx_beam.laws.kinematics import Step
from fx_beam.laws.schemes import Scheme
from fx_beam.results.state import State
from fx_beam.scene.law import Law
from fx_beam.step.model import Model

from .grid import Grid
from .symbols import DolfinxSymbols
from .versions import compiled, is_empty

Resultants = Callable[[Step, Law], Any]


class StepForm:
    """The weak form of a step, its Functions, and what is assembled of it.

    Vectors of a scene (size,) have all its degrees of freedom on each process.
    """

    def __init__(self, model: Model, comm: MPI.Comm):
        if model.forms.beams is None:
            raise SceneError("fenicsx: the scene has no beams, of which a mesh could be made")
        self.model, self.beams = model, model.forms.beams
        self.grid = grid = Grid(model.scene, model.mesh, self.beams.kind.degree, comm)
        self._symbols = DolfinxSymbols(grid.mesh, grid.tagged(self.beams.data.tags))
        #: Sparsity (size, size) of the tangent of all forces.
        self.pattern = model.forms.stiffness.copy()
        self.pattern.data[:] = 0.0
        self._local = PETSc.Mat().createAIJ(
            self.pattern.shape, csr=csr_of(self.pattern), comm=MPI.COMM_SELF
        )
        self._write(self.beams.kind)
        #: Mass (eqs 19 to 21) of beams and lumped masses, with the sparsity of `pattern`.
        self.mass = self._assembled_mass()

    def _write(self, kind: Kind) -> None:
        """Write the forms, and make their Functions."""
        grid, written = self.grid, WeakForm(kind, self._symbols)
        self._fields = fields = written.fields
        #: The step in UFL, whose fields are Functions and Constants; N, Q and M of each material.
        self.step, self.resultants = written.laws.step, written.laws.resultants
        self._internal, self._parameters = written.symbols.internal, written.symbols.parameters
        #: Space of displacements (2) and rotation (1).
        self.V = fields.start.function_space
        #: Number in the scene of each degree of freedom of V, and of the space of increments. The
        #: latter is discontinuous if nodal rotations are components: then numbers repeat.
        spaces = self.V, fields.increment.function_space
        dofs = self.model.mesh.unknowns.dofs
        self.V_numbers, self.increment_numbers = (grid.numbers(space, dofs) for space in spaces)
        self._glue = glue(self.increment_numbers)
        #: State at the end of the last step, its rates, and accelerations.
        self.q, self.v, self.a = (fem.Function(self.V, name=name) for name in "qva")
        displacements, self._of_u = self.V.sub(0).collapse()
        #: Displacement, on a space of its own.
        self.u = fem.Function(displacements, name="u")
        named = written.symbols.named_data
        if fields.coordinate is not None:
            named["coordinate"] = fields.coordinate
        for name, symbol in named.items():
            grid.fill(symbol, np.asarray(self.beams.data.values[name], dtype=float))
        forms = written.of_step().forms
        # Terms of the residual without inertia, and terms of a user. Each is assembled by itself:
        # FFCx 0.5 confuses quadrature rules.
        self._terms = [forms[name] for name in ("internal forces", "drag") if name in forms]
        self._added: list[ufl.Form] = []
        # By id, with the term: while it lives no other object gets its id.
        self._compiled: dict[int, tuple[ufl.Form, Any, Any]] = {}
        ends = {fields.start: self.q, fields.natural[0]: fields.natural[1]}
        if self._internal is not None:
            self._internal_end = fem.Function(self._internal.function_space)
            ends[self._internal] = self._internal_end
        self._energy = compiled(ufl.replace(forms["strain energy"], ends))
        #: Whether the resultants of the scene are replaced.
        self.replaced = False

    # -- The state ---------------------------------------------------------------------------------

    def begin(self, interval: Interval, state: State, natural: np.ndarray | None) -> None:
        """Set the start of a step, and natural strains (cells, degree, 3) at its end."""
        fields, rates = self._fields, self.model.scheme.rates
        fields.time.value = interval.at(rates.level)
        fields.dt.value = 1.0 if rates.at_rest else interval.length
        fields.load_factor.value = interval.end if rates.at_rest else 1.0
        fields.load_increment.value = interval.length
        fields.memory.value = state.memory(interval.length)
        q_previous = state.q if state.q_previous is None else state.q_previous
        functions = fields.start, *fields.start_rates, fields.q_previous
        for function, x in zip(functions, (state.q, state.v, state.a, q_previous), strict=True):
            function.x.array[:] = x[self.V_numbers]
        for function, strains in zip(fields.natural, (state.natural, natural), strict=True):
            if strains is not None:
                self.grid.fill(function, strains)
        if state.internal is not None:
            self.grid.fill(self._internal, state.internal)
        self._use(self.model.forms.parameters.values)

    def _use(self, parameters: np.ndarray | None) -> None:
        """Have values (n,) of all parameters of the scene."""
        if self._parameters is not None and parameters is not None:
            self._parameters.value[:] = parameters[self.beams.data.parameters]

    def end(self, state: State) -> None:
        """Set the end of a step."""
        for function, x in zip((self.q, self.v, self.a), (state.q, state.v, state.a), strict=True):
            function.x.array[:] = x[self.V_numbers]
        self.u.x.array[:] = self.q.x.array[self._of_u]
        if state.internal is not None:
            self.grid.fill(self._internal_end, state.internal)
        if state.natural is not None:
            self.grid.fill(self._fields.natural[1], state.natural)
        self._use(state.parameters)

    # -- What a user changes -----------------------------------------------------------------------

    def add(self, term: ufl.Form) -> None:
        """Add a term to the residual, if it is one."""
        expected = "a form, such as c * problem.measure()"
        require(isinstance(term, ufl.Form), "fenicsx: add: term", term, expected)
        linear = "fenicsx: add: the term must be linear in step.virtual_u and step.virtual_psi"
        domain = self.grid.mesh.ufl_domain()
        if any(other.ufl_id() != domain.ufl_id() for other in term.ufl_domains()):
            raise SceneError(
                "fenicsx: add: the term is an integral over another mesh. Use problem.measure(), "
                "or a measure with domain=problem.mesh"
            )
        if [*term.arguments()] != [self._fields.test]:
            other_arguments = ", ".join(str(u) for u in term.arguments() if u != self._fields.test)
            raise SceneError(f"{linear} of problem.step; it has {other_arguments or 'neither'}")
        lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(term)
        arities = ufl.algorithms.check_arities
        try:
            for integral in lowered.integrals():
                arities.check_integrand_arity(integral.integrand(), (self._fields.test,))
        except (ValueError, arities.ArityMismatch) as error:  # the first of products of both
            raise SceneError(f"{linear}, not {str(term)[:200]}") from error
        self._added.append(term)

    def replace_resultants(self, resultants: Resultants, strain_energy: Callable | None) -> None:
        """Replace the resultants, with the stored energy per length at the end, or None."""
        kind = self.beams.kind
        scheme = Scheme(kind.scheme.name, resultants, kind.scheme.rates)
        self._write(kind._replace(scheme=scheme))
        self.replaced, self._energy = True, None
        if strain_energy is not None:
            density = strain_energy(*self.step.strains0) * self.grid.measure(None, None)
            ends = {self._fields.start: self.q, self._fields.natural[0]: self._fields.natural[1]}
            self._energy = compiled(ufl.replace(density, ends))

    @property
    def has_further(self) -> bool:
        """Whether there are forces that the scene does not have."""
        return self.replaced or bool(self._added)

    @property
    def F(self) -> ufl.Form:
        """The residual without inertia."""
        first, *rest = [*self._terms, *self._added]
        return sum(rest, first)

    @property
    def J(self) -> ufl.Form:
        """dF/dD, the derivative of the residual by the increment."""
        return ufl.derivative(self.F, self._fields.increment, self._fields.trial)

    # -- Assembly ----------------------------------------------------------------------------------

    def _forms_of(self, term: ufl.Form) -> tuple[Any, Any]:
        """A term and its derivative by the increment, compiled; None for a zero derivative."""
        if id(term) not in self._compiled:
            tangent = ufl.derivative(term, self._fields.increment, self._fields.trial)
            compiled_tangent = None if is_empty(tangent) else compiled(tangent)
            self._compiled[id(term)] = term, compiled(term), compiled_tangent
        return self._compiled[id(term)][1:]

    def residual(self, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces and drag (size,) at increments D (size,), and added terms."""
        self._fields.increment.x.array[:] = D[self.increment_numbers]
        forces = np.zeros((2, self.model.size))
        for out, terms in zip(forces, (self._terms, self._added), strict=True):
            if not terms:
                continue
            b = np.zeros(len(self.increment_numbers))
            for term in terms:
                fem.assemble_vector(b, self._forms_of(term)[0])
            out[:] = np.bincount(self.increment_numbers, b, len(D))
        internal, added = self.grid.total(forces)
        return internal, added

    def add_tangent(self, matrix: PETSc.Mat, numbers: PETSc.LGMap) -> None:
        """Add the tangent to a matrix; `numbers` are rows of the increments."""
        matrix.setLGMap(numbers, numbers)
        for term in (*self._terms, *self._added):
            tangent = self._forms_of(term)[1]
            if tangent is not None:
                fem.petsc.assemble_matrix(matrix, tangent)
        matrix.assemble()

    def tangent(self) -> np.ndarray:
        """Values of the tangent in `pattern`, of the elements of this process."""
        self._local.zeroEntries()
        self.add_tangent(self._local, self._glue)
        return self._local.getValuesCSR()[2]

    def _assembled_mass(self) -> scipy.sparse.csr_matrix:
        model, grid, points = self.model, self.grid, self.grid.degree + 1
        data = np.asarray(section_data(model.mesh, model.scene, ("rhoA", "rhoI"), points), float)
        density = self._fields.data((data.shape[1], (2,)))
        grid.fill(density, data)
        pairs = (ufl.split(make(self.V)) for make in (ufl.TrialFunction, ufl.TestFunction))
        (u, psi), (virtual_u, virtual_psi) = pairs
        translation = density[0] * ufl.dot(u, virtual_u)
        form = (translation + density[1] * psi * virtual_psi) * self._fields.measure(points)
        numbers = glue(self.V_numbers)
        self._local.setLGMap(numbers, numbers)
        fem.petsc.assemble_matrix(self._local, compiled(form))
        self._local.assemble()
        mass = self.pattern.copy()
        mass.data[:] = grid.total(self._local.getValuesCSR()[2].copy())
        lumped = np.zeros(model.size)
        for node, m, inertia in model.scene.masses:
            lumped[model.mesh.dofs[node]] += float(m), float(m), float(inertia)
        mass.data[model.masses.places.diagonal] += lumped
        return mass

    def strain_energy(self) -> float:
        """Stored energy of beams [J] at the end of the step; nan where it is not known."""
        if self._energy is None:
            return np.nan
        return float(self.grid.comm.allreduce(fem.assemble_scalar(self._energy)))


def glue(numbers: np.ndarray) -> PETSc.LGMap:
    """A map from degrees of freedom to their numbers in a matrix; -1 for none."""
    return PETSc.LGMap().create(numbers, comm=MPI.COMM_SELF)


def csr_of(matrix: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of a matrix, as PETSc takes them."""
    matrix.sort_indices()
    indptr, indices = (np.asarray(row, PETSc.IntType) for row in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data
