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
from fx_beam.fem.weak_form import WeakForm, check_linear
from fx_beam.laws.interval import Interval
from fx_beam.laws.kinematics import Step
from fx_beam.laws.rates import NewmarkRates
from fx_beam.laws.resultants import Resultants as StepResultants
from fx_beam.laws.written import Formulas, Paper
from fx_beam.results.state import State
from fx_beam.scene.law import Law
from fx_beam.step.model import Model

from . import versions
from .meshes import BeamMesh

# -- The symbols of the weak form as dolfinx has them: spaces, Functions and Constants on a mesh


class NamedConstant(fem.Constant):
    """A Constant whose name is seen where a form is printed."""

    name = ""

    def __str__(self) -> str:
        return self.name


#: What has values on a mesh.
Symbol = fem.Function | fem.Constant


class DolfinxSymbols(Symbols):
    """Makes the symbols of forms on a mesh; the tags of cells number materials."""

    def __init__(self, grid: BeamMesh):
        super().__init__(grid.mesh.ufl_domain())
        self._grid = grid

    def space(self, element: versions.Element) -> fem.FunctionSpace:
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
        return super().measure(points)(subdomain_data=self._grid.materials)


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
        self.led = fem.Function(self.V, name="driven_acceleration")
        #: What takes the place of each symbol of the start in a form of the end.
        self.ends = {fields.start: self.q, fields.natural[0]: fields.natural[1]}
        self._internal_end: fem.Function | None = None
        symbols = [*self.named, *state, self.led]
        if self._internal is not None:
            self._internal_end = fem.Function(self._internal.function_space, name="internal_end")
            self.ends[self._internal] = self._internal_end
            symbols.append(self._internal_end)
        # Symbols with their values, in memory of dolfinx, and as bytes as they were set last.
        self._known: dict[int, tuple[Symbol, np.ndarray, bytes]] = {}
        for symbol in symbols:
            values = symbol.x.array if isinstance(symbol, fem.Function) else symbol.value
            self._known[id(symbol)] = symbol, values, values.tobytes()
        named = data.named_data
        if fields.coordinate is not None:
            named["coordinate"] = fields.coordinate
        for name, symbol in named.items():
            self._set_cells(symbol, np.asarray(grid.beams.data.values[name], dtype=float))

    def _set(self, symbol: Symbol, values: ArrayLike) -> None:
        """Set a Function by its array, or a Constant, whose values no user may change."""
        _, array, _ = self._known[id(symbol)]
        array[...] = values
        self._known[id(symbol)] = symbol, array, array.tobytes()

    def _set_nodes(self, function: fem.Function, values: np.ndarray) -> None:
        """Set a Function on V by values (size,)."""
        self._set(function, values[self.V_numbers])

    def _set_cells(self, function: fem.Function | None, values: np.ndarray | None) -> None:
        """Set a Function by values (cells, ...), if there are both."""
        if function is not None and values is not None:
            self._set(function, self._grid.in_space(function.function_space, values))

    def _set_parameters(self, parameters: np.ndarray | None) -> None:
        """Set the values (n,) of all parameters of the scene."""
        if self._parameters is not None and parameters is not None:
            self._set(self._parameters, parameters[self._grid.beams.data.parameters])

    def set_start(self, interval: Interval, state: State, natural: np.ndarray | None) -> None:
        """Set the start of a step, and natural strains (cells, degree, 3) at its end."""
        fields, rates = self.symbols, self._rates
        length, factor = interval.length, interval.end if rates.at_rest else 1.0
        numbers = interval.time_at(rates.level), 1.0 if rates.at_rest else length, factor, length
        for name, number in zip(CONSTANTS, (*numbers, state.memory(length)), strict=True):
            self._set(getattr(fields, name), number)
        before = state.q if state.q_previous is None else state.q_previous
        nodal = fields.start, fields.q_previous, *fields.start_rates
        for function, values in zip(nodal, (state.q, before, state.v, state.a), strict=True):
            self._set_nodes(function, values)
        for function, strains in zip(fields.natural, (state.natural, natural), strict=True):
            self._set_cells(function, strains)
        self._set_cells(self._internal, state.internal)
        self._set_parameters(self._scene_parameters.values)

    def set_increment(self, D: np.ndarray) -> None:
        """Set the increments (size,) of the step."""
        self._set(self.symbols.increment, D[self.increment_numbers])

    def lead(self, accelerations: np.ndarray) -> None:
        """Set the accelerations (size,) beside those of the rule."""
        self._set_nodes(self.led, accelerations)

    def set_load(self, factor: float, natural: np.ndarray | None) -> None:
        """Set load factor and natural strains at the end of a load step."""
        self._set(self.symbols.load_factor, factor)
        self._set_cells(self.symbols.natural[1], natural)

    def end(self, state: State) -> None:
        """Set the end of a step."""
        for function, values in zip(self.state, (state.q, state.v, state.a), strict=False):
            self._set_nodes(function, values)
        self._set(self.u, self.q.x.array[self._u_dofs])
        self._set_cells(self._internal_end, state.internal)
        self._set_cells(self.symbols.natural[1], state.natural)
        self._set_parameters(state.parameters)

    def refuse_writes(self) -> None:
        """Refuse values that a user has written into symbols, which no step would read."""
        for symbol, values, known in self._known.values():
            if values.tobytes() != known:  # which are the same also where they are not finite
                raise SceneError(
                    f"fenicsx: what was written into {symbol.name} of the problem would be lost. "
                    "Give a state of your own to set_state(q=, v=), unknowns to begin(), a length "
                    "to advance(dt), and Functions of your own to add and replace_resultants"
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


# -- The weak form of a step of all beams of a scene, on a mesh of dolfinx ----------------------


Resultants = Callable[[Step, Law], StepResultants]
#: Stored energy per length of axial strain, shear strain and curvature.
StrainEnergy = Callable[[Expr, Expr, Expr], Expr]
_log = logging.getLogger("fx_beam")
# Works and losses of a step that belong to the resultants of the scene.
_COUNTED = {"lost energy", "scheme's loss", "work of natural strains"}


class ResidualTerm:
    """A term of the residual, compiled with its tangent when a step first needs it."""

    def __init__(self, form: ufl.Form, fields: DolfinxFields):
        self.form, self._fields = form, fields

    @functools.cached_property
    def compiled(self) -> list[versions.CompiledForm | None]:
        """Forms of dolfinx: the term, and its derivative by the increment; None for zero."""
        symbols = self._fields.symbols
        tangent = ufl.derivative(self.form, symbols.increment, symbols.trial)
        return [
            None if versions.is_empty(form) else versions.compiled(form)
            for form in (self.form, tangent)
        ]


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
        written = WeakForm(kind, DolfinxSymbols(grid))
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
        self.terms = [ResidualTerm(forms[name], self.fields) for name in names]
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
            None if form is None else versions.compiled(ufl.replace(form, self.fields.ends))
            for form in (energy, lost)
        )

    @property
    def parts(self) -> list[ufl.Form]:
        """Forms of the scene and of a user, whose sum is the residual without inertia."""
        return [self.grid.over_beams(term.form) for term in (*self.terms, *self.added)]

    @property
    def F(self) -> ufl.Form:
        """The residual without inertia."""
        first, *others = self.parts
        form = sum(others, first)
        if versions.confuses_rules(form):
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
        density.name = "rhoA_rhoI"
        density.x.array[:] = self.grid.in_space(density.function_space, np.asarray(data, float))
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
            self._energy = versions.compiled(ufl.replace(energy, at_end))
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
        if foreign or not all(
            versions.fits(part.subdomain_data(), mesh) for part in form.integrals()
        ):
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
        for part in term.integrals():
            check_linear(part.integrand(), test, linear)
        return ResidualTerm(form, self.fields)

    def check(self, name: str, *parts: Expr | ufl.Form) -> None:
        """Refuse symbols of another mesh, of a form before, and symbols without values."""
        mesh, unknown = self.grid.mesh.ufl_domain(), set(parts) - self._checked
        for symbol in (terminal for part in unknown for terminal in versions.terminals(part)):
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

    def _integral(self, form: versions.CompiledForm) -> float:
        return float(self.grid.comm.allreduce(fem.assemble_scalar(form)))
