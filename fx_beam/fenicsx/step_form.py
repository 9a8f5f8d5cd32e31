"""The weak form of a step of all beams of a scene, its symbols and fields, on a dolfinx mesh."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, require, warn_once
from fx_beam.fem.beam_data import CONSTANTS, section_data
from fx_beam.fem.elements import Symbols
from fx_beam.fem.weak_form import WeakForm
from fx_beam.laws.interval import Interval
from fx_beam.laws.kinematics import Step
from fx_beam.laws.rates import NewmarkRates
from fx_beam.laws.resultants import Resultants as StepResultants
from fx_beam.laws.written import Formulas, Paper
from fx_beam.results.state import State
from fx_beam.scene.law import Law
from fx_beam.step.model import Model

from .meshes import BeamMesh
from .versions import (
    CompiledForm,
    Element,
    MeshTags,
    compiled,
    confuses_rules,
    fits,
    is_empty,
    terminals,
)

# -- The symbols of the weak form as dolfinx has them: spaces, Functions and Constants on a mesh


class NamedConstant(fem.Constant):
    """A Constant whose name is seen where a form is printed."""

    name = ""

    def __str__(self) -> str:
        return self.name


class DolfinxSymbols(Symbols):
    """Makes the symbols of forms on a mesh; the tags of cells number materials."""

    def __init__(self, grid: BeamMesh, materials: MeshTags):
        super().__init__(grid.mesh.ufl_domain())
        self._grid, self._materials = grid, materials

    def space(self, element: Element) -> fem.FunctionSpace:
        """A function space, one for each element."""
        return self._grid.space(element)

    def coefficient(self, space: fem.FunctionSpace) -> fem.Function:
        """A Function."""
        return fem.Function(space)

    def constant(self, *shape: int) -> fem.Constant:
        """A Constant."""
        return NamedConstant(self._grid.mesh, np.zeros(shape))

    def measure(self, points: int) -> ufl.Measure:
        """Measure of the beams; its subdomains are materials."""
        return super().measure(points)(subdomain_data=self._materials)


# -- Functions and Constants of a step on a mesh of dolfinx, with their values of a scene -------


class DolfinxFields:
    """Fields of a step: its start, its increment, and the state q, v, a at its end.

    Arrays (size,) have all degrees of freedom of a scene, on each process.
    """

    def __init__(
        self, written: WeakForm, model: Model, grid: BeamMesh, state: list[fem.Function] | None
    ):
        fields, data = written.fields, written.symbols
        #: Names of the Functions and Constants of the form.
        self.named = {symbol: name for symbol, name in written.named.items() if symbol is not None}
        for symbol, name in self.named.items():
            symbol.name = name.replace(" ", "_")  # FFCx 0.5 takes it into C
        self._grid, self._rates = grid, model.scheme.rates
        self._scene_parameters = model.forms.parameters
        #: Start, increment and arguments of forms: Functions and Constants.
        self.symbols = fields
        #: The step in UFL; N, Q and M of each material.
        self.step: Step = written.laws.step
        self.resultants: list[Expr] = written.laws.resultants
        #: Space of displacements (2) and rotation (1).
        self.V = fields.start.function_space
        #: Number in the scene of each degree of freedom of V, and of the space of increments. The
        #: latter is discontinuous if nodal rotations are components: then numbers repeat.
        spaces, dofs = (self.V, fields.increment.function_space), model.mesh.unknowns.dofs
        self.V_numbers, self.increment_numbers = (grid.numbers(space, dofs) for space in spaces)
        displacements, self._u_dofs = self.V.sub(0).collapse()
        if state is None:
            state = [fem.Function(self.V, name=name) for name in "qva"]
            state.append(fem.Function(displacements, name="u"))
        #: State at the end of the last step, its rates, accelerations, and the displacement alone.
        self.state = state
        self.q, self.v, self.a, self.u = self.state
        self._internal, self._parameters = data.internal, data.parameters
        #: Accelerations beside those of the rule, of what driven motions alone move.
        self.led = fem.Function(self.V)
        # Values of Constants of the step, and q (size,) at its start, as they were set last.
        self._step_numbers = dict.fromkeys(CONSTANTS, 0.0)
        self._start_q = np.zeros(model.size)
        # Values of the increment where forces were found last.
        self._increment = fields.increment.x.array.copy()
        #: What takes the place of each symbol of the start in a form of the end.
        self.ends = {fields.start: self.q, fields.natural[0]: fields.natural[1]}
        if self._internal is not None:
            self._internal_end = fem.Function(self._internal.function_space)
            self.ends[self._internal] = self._internal_end
        named = data.named_data
        if fields.coordinate is not None:
            named["coordinate"] = fields.coordinate
        for name, symbol in named.items():
            grid.fill(symbol, np.asarray(grid.beams.data.values[name], dtype=float))

    def set_start(self, interval: Interval, state: State, natural: np.ndarray | None) -> None:
        """Set the start of a step, and natural strains (cells, degree, 3) at its end."""
        fields, rates = self.symbols, self._rates
        length, factor = interval.length, interval.end if rates.at_rest else 1.0
        self._set_numbers(time=interval.time_at(rates.level), dt=1.0 if rates.at_rest else length)
        self._set_numbers(load_factor=factor, load_increment=length, memory=state.memory(length))
        self._start_q = state.q
        v, a = fields.start_rates
        q_previous = state.q if state.q_previous is None else state.q_previous
        self._fill_nodes(fields.start, state.q)
        self._fill_nodes(fields.q_previous, q_previous)
        self._fill_nodes(v, state.v)
        self._fill_nodes(a, state.a)
        for function, strains in zip(fields.natural, (state.natural, natural), strict=True):
            if strains is not None:
                self._grid.fill(function, strains)
        if state.internal is not None:
            self._grid.fill(self._internal, state.internal)
        self._set_parameters(self._scene_parameters.values)

    def set_increment(self, D: np.ndarray) -> None:
        """Set the increments (size,) of the step."""
        self._increment = D[self.increment_numbers]
        self.symbols.increment.x.array[:] = self._increment

    def lead(self, accelerations: np.ndarray) -> None:
        """Set the accelerations (size,) beside those of the rule."""
        self._fill_nodes(self.led, accelerations)

    def set_load(self, factor: float, natural: np.ndarray | None) -> None:
        """Set load factor and natural strains at the end of a load step."""
        self._set_numbers(load_factor=factor)
        if natural is not None:
            self._grid.fill(self.symbols.natural[1], natural)

    def end(self, state: State) -> None:
        """Set the end of a step."""
        self._fill_nodes(self.q, state.q)
        self._fill_nodes(self.v, state.v)
        self._fill_nodes(self.a, state.a)
        self.u.x.array[:] = self.q.x.array[self._u_dofs]
        if state.internal is not None:
            self._grid.fill(self._internal_end, state.internal)
        if state.natural is not None:
            self._grid.fill(self.symbols.natural[1], state.natural)
        self._set_parameters(state.parameters)

    def _set_numbers(self, **values: float) -> None:
        """Set Constants of a step."""
        self._step_numbers |= values
        for name, value in values.items():
            getattr(self.symbols, name).value = value

    def refuse_writes(self, state: State) -> None:
        """Refuse values that a user has written into fields, which no step would read."""
        functions = (*self.state, self.symbols.start, self.symbols.increment)
        values = [x[self.V_numbers] for x in (state.q, state.v, state.a, state.q, self._start_q)]
        values[3] = values[3][self._u_dofs]
        values.append(self._increment)
        # Bytes are the same also where values are not finite.
        written = [
            f"problem.{function.name}"
            for function, known in zip(functions, values, strict=True)
            if function.x.array.tobytes() != known.tobytes()
        ]
        for name, number in self._step_numbers.items():
            if getattr(self.symbols, name).value != number:
                written.append(f"the Constant {name} of the step")
        if written:
            raise SceneError(
                f"fenicsx: what was written into {written[0]} would be lost. Give a state of your "
                "own to Problem.set_state(q=, v=), unknowns to begin(), and a length to advance(dt)"
            )

    def in_scene(
        self, values: fem.Function | ArrayLike, others: np.ndarray, name: str
    ) -> np.ndarray:
        """Values (size,) of a Function in V, with `others` at nodes without beams, or of rows."""
        expected = "finite: a Function in problem.V, or an array (nodes, 3)"
        if isinstance(values, fem.Function):
            require(values.function_space == self.V, f"set_state: {name}", values, expected)
            sums = np.zeros((2, len(others)))
            np.add.at(sums[0], self.V_numbers, values.x.array)
            np.add.at(sums[1], self.V_numbers, 1.0)
            total, count = self._grid.total(sums)
            result = np.where(count > 0, total / np.maximum(count, 1.0), others)
        else:
            result = np.asarray(values, dtype=float).ravel()
        ok = result.shape == others.shape and np.isfinite(result).all()
        require(ok, f"set_state: {name}", values, expected)
        return result

    def _fill_nodes(self, function: fem.Function, values: np.ndarray) -> None:
        """Set a Function on V by values (size,)."""
        function.x.array[:] = values[self.V_numbers]

    def _set_parameters(self, parameters: np.ndarray | None) -> None:
        """Have values (n,) of all parameters of the scene."""
        if self._parameters is not None and parameters is not None:
            self._parameters.value[:] = parameters[self._grid.beams.data.parameters]


# -- The weak form of a step of all beams of a scene, on a mesh of dolfinx ----------------------


Resultants = Callable[[Step, Law], StepResultants]
#: Stored energy per length of axial strain, shear strain and curvature.
StrainEnergy = Callable[[Expr, Expr, Expr], Expr]
_log = logging.getLogger("fx_beam")
# Works and losses of a step that belong to the resultants of the scene.
_COUNTED = {"lost energy", "scheme's loss", "work of natural strains"}


class ResidualTerm:
    """A term of the residual, compiled with its tangent when a step first needs it."""

    def __init__(self, form: ufl.Form, fields: DolfinxFields, over_beams: ufl.Form | None = None):
        self.form, self._fields = form, fields
        #: The same form, of which subdomains are beams.
        self.over_beams = over_beams or form

    @functools.cached_property
    def compiled(self) -> list[CompiledForm | None]:
        """Forms of dolfinx: the term, and its derivative by the increment; None for zero."""
        symbols = self._fields.symbols
        tangent = ufl.derivative(self.form, symbols.increment, symbols.trial)
        return [None if is_empty(form) else compiled(form) for form in (self.form, tangent)]


class StepForm:
    """The residual F of a step without inertia, as terms, and the stored energy.

    `resultants` and `strain_energy` may take the place of those of the scene, and of a form
    `before`.
    """

    def __init__(
        self,
        model: Model,
        grid: BeamMesh,
        before: StepForm | None = None,
        resultants: Resultants | None = None,
        strain_energy: StrainEnergy | None = None,
        dissipation: StrainEnergy | None = None,
    ):
        kind, scheme = grid.beams.kind, grid.beams.kind.scheme
        self.grid = grid
        #: Whether the resultants of the scene are replaced.
        self.replaced = resultants is not None
        if resultants is not None:
            kind = kind._replace(scheme=replace(scheme, resultants=resultants))
        #: Resultants of the step; None where a form has their place.
        self._resultants: Any = kind.scheme.resultants
        written = WeakForm(kind, DolfinxSymbols(grid, grid.tagged(grid.beams.data.tags)))
        state = before.fields.state if before else None
        self.fields: DolfinxFields = DolfinxFields(written, model, grid, state)
        # What was checked, which takes a while, and symbols that steps no longer set.
        self._checked: set[Expr | ufl.Form] = set()
        self._dead: set[Expr] = before._dead | {*before.fields.named} if before else set()
        forms = written.step_forms().forms
        #: Losses and works of the scene's own resultants, which the engine counts.
        self._counted: set[str] = before._counted if before else _COUNTED & forms.keys()
        if self.replaced:
            self._refuse_counted("replace_resultants", {"scheme's loss"})
            if "work of natural strains" in self._counted:
                _log.warning(
                    "fenicsx: replace_resultants: the work of natural strains that change, in "
                    "Energy.work, is by the resultants of the scene, not by these"
                )
        names = [name for name in ("internal forces", "drag") if name in forms]
        #: Terms of the scene, and of a user. Each is assembled by itself: FFCx 0.5 confuses
        #: quadrature rules.
        self.terms = [
            ResidualTerm(forms[name], self.fields, grid.of_materials(forms[name])) for name in names
        ]
        self.added: list[ResidualTerm] = []
        #: Natural strains (3,) at the end of a step in UFL, by a user.
        self.natural: Expr | None = before.natural if before else None
        strains, dx = self.fields.step.strains0, grid.measure(None, None)
        none = fem.Constant(grid.mesh, 0.0)  # an energy of zero is a form, too
        energy, lost = (f and (f(*strains) + none) * dx for f in (strain_energy, dissipation))
        if self.replaced:
            self.check("replace_resultants", *(term.form for term in self.terms))
            self.check("replace_resultants", *self.fields.resultants, *filter(None, [energy, lost]))
            self.check("natural_strains", *filter(None, [self.natural]))
        else:
            energy = forms["strain energy"]
        self._energy, self._lost = (
            None if form is None else compiled(ufl.replace(form, self.fields.ends))
            for form in (energy, lost)
        )

    @property
    def parts(self) -> list[ufl.Form]:
        """Forms of the scene and of a user, whose sum is the residual without inertia."""
        return [term.over_beams for term in (*self.terms, *self.added)]

    @property
    def F(self) -> ufl.Form:
        """The residual without inertia."""
        first, *others = self.parts
        form = sum(others, first)
        if confuses_rules(form):
            warn_once(
                "fenicsx: F has several Gauss rules, one with a single point. FFCx 0.5 confuses "
                "them in one form, which may be wrong: assemble problem.parts one by one"
            )
        return form

    @property
    def J(self) -> ufl.Form:
        """dF/dD, the derivative of the residual by the increment."""
        symbols = self.fields.symbols
        return ufl.derivative(self.F, symbols.increment, symbols.trial)

    def inertia(self, model: Model) -> ufl.Form:
        """Inertia of beams, if rates are Newmark's (eqs 19 to 21)."""
        rates, symbols = model.scheme.rates, self.fields.symbols
        if not isinstance(rates, NewmarkRates):
            raise SceneError(
                f"fenicsx: F_inertia: accelerations of {model.scheme.name} are nodal, and no field "
                "in UFL. Use system.M times nodal accelerations, or a scheme of Newmark's family"
            )
        points = self.grid.degree + 1
        data = section_data(model.mesh, model.scene, ("rhoA", "rhoI"), points)
        density = symbols.symbols.data(data.shape[1], (2,))
        self.grid.fill(density, np.asarray(data, float))
        v0, a0 = symbols.start_rates
        a = rates.acceleration(symbols.increment, v0, a0, symbols.dt)[0] + self.fields.led
        factors, test = (density[0], density[0], density[1]), symbols.test
        work = sum(factor * a[i] * test[i] for i, factor in enumerate(factors))
        return work * self.grid.measure(None, points)

    def written(self, style: str) -> Formulas:
        """Resultants and terms as on paper."""
        paper = Paper()
        paper.name_step(self.fields.step)
        if self._resultants is not None:
            for energy, _ in self.grid.beams.kind.materials:
                paper.add(self._resultants, quadratic=energy is None)
        whole = [] if self._resultants is not None else self.terms[:1]
        for term in (*whole, *self.added):
            densities = (part.integrand() for part in term.form.integrals())
            paper.lines += [("delta_W", density) for density in densities]
        return paper.in_style(style)

    @property
    def has_further(self) -> bool:
        """Whether there are forces that the scene does not have."""
        return self.replaced or bool(self.added)

    def _refuse_counted(self, name: str, forms: set[str]) -> None:
        if counted := sorted(self._counted & forms):
            raise SceneError(
                f"fenicsx: {name}: the scene or its scheme has {' and '.join(counted)}, which "
                "would be counted without a force. Leave them out, and write them in UFL"
            )

    def replace_work(self, F: ufl.Form, energy: ufl.Form | None) -> None:
        """Have another virtual work of the beams, and their stored energy at the end of a step."""
        self._refuse_counted("replace_form", _COUNTED)
        term = self.term("replace_form", F)
        if energy is not None:
            name, increment = "fenicsx: replace_form: energy", self.fields.symbols.increment
            energy = self._integral_of("replace_form: energy", energy)
            require(not energy.arguments(), name, energy, "a form without test functions")
            at_end = self.fields.ends | {increment: fem.Function(increment.function_space)}
            self._energy = compiled(ufl.replace(energy, at_end))
        else:
            self._energy = None
        self.terms[0], self._resultants, self._lost, self.replaced = term, None, None, True
        self.fields.resultants = [ufl.as_vector(3 * [fem.Constant(self.grid.mesh, np.nan)])]

    def _integral_of(self, name: str, form: ufl.Form) -> ufl.Form:
        """A form of a user with its derivatives written out, if it is one on the mesh."""
        expected = "a form, such as c * problem.measure()"
        require(isinstance(form, ufl.Form), f"fenicsx: {name}", form, expected)
        form, mesh = ufl.algorithms.expand_derivatives(form), self.grid.mesh
        foreign = {domain.ufl_id() for domain in form.ufl_domains()} - {mesh.ufl_domain().ufl_id()}
        if foreign or not all(fits(part.subdomain_data(), mesh) for part in form.integrals()):
            raise SceneError(
                f"fenicsx: {name}: it is an integral over another mesh. Use problem.measure(), "
                "or a measure with domain=problem.mesh"
            )
        self.check(name, form)
        return form

    def term(self, name: str, form: ufl.Form) -> ResidualTerm:
        """A term of the residual by a user, if it is one."""
        test, term = self.fields.symbols.test, self._integral_of(name, form)
        linear = f"fenicsx: {name}: it must be linear in step.virtual_u and step.virtual_psi"
        if [*term.arguments()] != [test]:
            other_arguments = ", ".join(str(u) for u in term.arguments() if u != test)
            raise SceneError(f"{linear} of problem.step; it has {other_arguments or 'neither'}")
        lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(term)
        arities = ufl.algorithms.check_arities
        try:
            for integral in lowered.integrals():
                arities.check_integrand_arity(integral.integrand(), (test,))
        except (ValueError, arities.ArityMismatch) as error:  # the first of products of both
            raise SceneError(f"{linear}, not {str(term)[:200]}") from error
        return ResidualTerm(form, self.fields)

    def check(self, name: str, *parts: Expr | ufl.Form) -> None:
        """Refuse symbols of another mesh, of a form before, and symbols without values."""
        mesh, unknown = self.grid.mesh.ufl_domain(), set(parts) - self._checked
        for symbol in (terminal for part in unknown for terminal in terminals(part)):
            domains = ufl.domain.extract_domains(symbol)
            if any(domain.ufl_id() != mesh.ufl_id() for domain in domains):
                raise SceneError(
                    f"fenicsx: {name}: {symbol} is on another mesh than problem.mesh, which has "
                    "all beams of the scene. Make Functions and Constants on problem.mesh"
                )
            if symbol in self._dead:
                raise SceneError(
                    f"fenicsx: {name}: {symbol} belongs to the step before replace_resultants. "
                    "Take problem.step anew after it"
                )
            is_number = isinstance(symbol, ufl.Coefficient | ufl.Constant)
            if is_number and not isinstance(symbol, fem.Function | fem.Constant):
                raise SceneError(
                    f"fenicsx: {name}: {symbol} has no values. Use Function and Constant of "
                    "dolfinx.fem"
                )
        self._checked |= unknown

    def strain_energy(self) -> float:
        """Stored energy of beams [J] at the end of the step; nan where it is not known."""
        return np.nan if self._energy is None else self._integral(self._energy)

    def dissipated(self) -> float:
        """Energy [J] that replaced resultants have lost in the step, as a user says."""
        return 0.0 if self._lost is None else self._integral(self._lost)

    def _integral(self, form: CompiledForm) -> float:
        return float(self.grid.comm.allreduce(fem.assemble_scalar(form)))
