"""The weak form of one step in UFL, its fields, and its derivatives, for all scenes of a kind."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError, fields_in, refuse_fields, refuse_fields_in, require
from fx_beam.laws.kinematics import Step, arc_derivative, director
from fx_beam.laws.rates import UpdateRule
from fx_beam.laws.resultants import (
    DecayingResultants,
    ExactResultants,
    NodeRotations,
    actuation,
    drag_loss,
    drag_work,
    lagrange,
    viscous,
    viscous_loss,
)
from fx_beam.scene.beam import gauss_rule
from fx_beam.scene.law import (
    Energy,
    InternalVariables,
    Law,
    evolution_loss,
    evolved,
    functions_of_energy,
    law_of_step,
    own_law,
    quadratic_law,
)
from fx_beam.scene.loads import VirtualWork
from fx_beam.scene.parameters import names_of, parameters_in, parameters_of, replaced
from fx_beam.symbolic import Expr, Form, Written, ufl

from . import elements
from .beam_data import CONSTANTS, LOSSES, NATURAL, NODAL, Kind, StepFacts

# -- The fields of a step in UFL, on no particular mesh: forms of them fit all meshes of a kind -


class Fields:
    """Fields of beams of one degree, on straight elements or on elements of that degree.

    With `nodal` the rotations of the unknowns are those at the nodes of the element.
    """

    def __init__(self, degree: int, symbols: elements.Symbols, nodal: bool):
        self.degree, self.symbols = degree, symbols
        self._domain, space = symbols.domain, symbols.beam_space(degree)
        #: Displacements and rotations at the start of the step.
        self.start = symbols.coefficient(space)
        #: Velocity and acceleration at the start of the step.
        self.start_rates = tuple(symbols.coefficient(space) for _ in range(2))
        self.time, self.dt, self.load_factor = (symbols.constant() for _ in range(3))
        #: Increment of the load factor in statics.
        self.load_increment = symbols.constant()
        #: Displacements and rotations at the start of the last step, and `Step.memory`.
        self.q_previous, self.memory = symbols.coefficient(space), symbols.constant()
        #: Natural strains at the Gauss points, at the start and at the end of the step.
        self.natural = tuple(symbols.coefficient(self.internal(3)) for _ in range(2))
        #: Coordinate on each cell, from 0 to the degree, of nodal rotations.
        self.coordinate: Expr = None
        if nodal:
            self.coordinate = symbols.coefficient(symbols.space(elements.lagrange(1, broken=True)))
        unknowns = symbols.beam_space(degree, nodal)
        #: Increments of displacements and rotations.
        self.increment = symbols.coefficient(unknowns)
        self.test, self.trial = ufl.TestFunction(unknowns), ufl.TrialFunction(unknowns)

    @property
    def names(self) -> dict[Expr, str]:
        """Names of all fields, of which forms may consist."""
        moving = self.increment, self.start, *self.start_rates, self.q_previous
        names = dict(zip((*moving, *self.natural), NODAL + NATURAL, strict=True))
        names |= {getattr(self, name): name for name in CONSTANTS}
        return names if self.coordinate is None else {**names, self.coordinate: "coordinate"}

    @property
    def jacobian(self):
        """Derivative (2,) of the position along the element's own coordinate."""
        J = ufl.Jacobian(self._domain)
        return ufl.as_vector((J[0, 0], J[1, 0]))

    @property
    def coordinates(self) -> tuple[Any, Any]:
        """The reference positions, and the space of their changes."""
        element = self._domain.ufl_coordinate_element()
        return ufl.SpatialCoordinate(self._domain), ufl.FunctionSpace(self._domain, element)

    def internal(self, width: int):
        """UFL's space of so many internal variables at the Gauss points."""
        return self.symbols.gauss_space(self.degree, width)

    def measure(self, points: int):
        """Measure of the members, by a Gauss rule of so many points."""
        return self.symbols.measure(points)

    def step(self, rates: UpdateRule, name: str, natural: bool = False) -> Step:
        """A step with its rates, those of a scheme; errors call them by a `name`.

        With `natural` it has natural strains.
        """
        # Tangent vector from the Jacobian; each form has a single quadrature rule.
        J = self.jacobian
        h = ufl.sqrt(J[0] ** 2 + J[1] ** 2)
        (u0, psi0), (Du, Dpsi) = ufl.split(self.start), ufl.split(self.increment)
        virtual_u, virtual_psi = ufl.split(self.test)
        nodes = None
        if self.coordinate is not None:
            shape, slope = lagrange(self.coordinate, self.degree)
            nodes = NodeRotations(Dpsi, virtual_psi, shape, self.degree / h * slope)
            Dpsi, virtual_psi = ufl.dot(shape, Dpsi), ufl.dot(shape, virtual_psi)
        v0, a0 = (ufl.split(rate) for rate in self.start_rates)
        u_before, psi_before = ufl.split(self.q_previous)
        v, omega = rates.fields(Du, Dpsi, v0, a0, self.dt)
        refuse_fields_in(ufl.as_vector((*v, omega)), name, self.names)
        return Step(
            u0=u0,
            psi0=psi0,
            Du=Du,
            Dpsi=Dpsi,
            u=u0 + rates.level * Du,
            psi=psi0 + rates.level * Dpsi,
            v=v,
            omega=omega,
            virtual_u=virtual_u,
            virtual_psi=virtual_psi,
            X=ufl.SpatialCoordinate(self._domain),
            t0=ufl.as_vector((J[0] / h, J[1] / h)),
            h=h,
            degree=self.degree,
            t=self.time,
            dt=self.dt,
            load_factor=self.load_factor,
            nodes=nodes,
            u_before=u_before,
            psi_before=psi_before,
            memory=self.memory,
            **(dict(zip(("natural0", "natural1"), self.natural, strict=True)) if natural else {}),
        )


@functools.cache  # three degrees, straight and curved
def fields_of(degree: int, curved: bool) -> tuple[Fields, Fields]:
    """The fields, without and with nodal rotations, the same for all scenes of a kind.

    Both are older than all data: UFL orders fields by age, and finds a compiled form only if their
    order does not depend on the forms before it.
    """
    symbols = elements.Symbols(elements.domain(degree if curved else 1))
    return Fields(degree, symbols, nodal=False), Fields(degree, symbols, nodal=True)


class FormSymbols:
    """Symbols of a kind of forms besides the fields: data, parameters and internal variables."""

    def __init__(self, kind: Kind, fields: Fields):
        #: Data of beams by name: (EA, GA, EI) of the quadratic law, retardation times, and drag.
        self.data = {name: fields.symbols.data(*shape) for name, shape in kind.data}
        self.times = self.data.get("retardation")
        drag_names = [name for name in self.data if name.startswith("drag ")]
        #: Coefficients of the drag.
        self.drag = {name.removeprefix("drag "): self.data[name] for name in drag_names}
        #: Where each virtual work acts: 1 there, 0 elsewhere.
        self.indicators = [fields.symbols.data(1) for _ in kind.works]
        energy_parameters = parameters_of(
            function
            for material in kind.materials
            for function in functions_of_energy(*material, 3)
        )
        #: Names of the parameters in stored energies, and of all.
        self.energy_names = names_of(energy_parameters)
        work_parameters = []
        if kind.works:
            from fx_beam.scene.ufl_symbols import STEP

            work_parameters = parameters_in(*(work.of(STEP, "virtual work") for work in kind.works))
        self.names = names_of([*energy_parameters, *kind.scheme.parameters, *work_parameters])
        #: Their values (n,), None without any, and those by name.
        self.parameters: Expr = None
        if self.names:
            self.parameters = fields.symbols.constant(len(self.names))
        self.by_name = {name: self.parameters[i] for i, name in enumerate(self.names)}
        #: Number of internal variables at a Gauss point, and their values at the step's start.
        self.width = max(len(internal.names) if internal else 0 for _, internal in kind.materials)
        self.internal: Expr = None
        if self.width:
            self.internal = fields.symbols.coefficient(fields.internal(self.width))

    @property
    def named_data(self) -> dict[str, Expr]:
        """Data of beams and indicators by name."""
        return self.data | {f"indicator {i}": field for i, field in enumerate(self.indicators)}

    def with_values(self, energy: Energy) -> Energy:
        """A stored energy with the values of its parameters."""
        return lambda *arguments: replaced(energy(*arguments), self.by_name)


def check_linear(integrand: Expr, test: Expr, expected: str) -> None:
    """SceneError that says what is `expected` if an integrand is not linear in a test function."""
    lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering
    arities = ufl.algorithms.check_arities
    try:
        arities.check_integrand_arity(lowered(integrand), (test,))
    except (Exception, arities.ArityMismatch) as error:  # which is not always an Exception
        raise SceneError(f"{expected}; {error}") from error


# -- The weak form of one step in UFL, compiled for all scenes of a kind ------------------------


class StepLaws:
    """The step of a kind of forms, and the resultants of each law in it."""

    def __init__(self, kind: Kind, symbols: elements.Symbols | None = None):
        self._kind = kind
        if symbols is None:
            self.fields, nodal = fields_of(kind.degree, kind.curved)
        else:
            self.fields, nodal = (Fields(kind.degree, symbols, nodal) for nodal in (False, True))
        #: What forms consist of besides the fields.
        self.symbols = FormSymbols(kind, self.fields)
        resultants = self._step_resultants()
        all_resultants = [r for parts in resultants for r in parts]
        exact = self.step.degree > 1 and any(isinstance(r, ExactResultants) for r in all_resultants)
        if exact or (kind.scheme.rates.mean_based and "rotation" in self.symbols.drag):
            self.fields = nodal
            resultants = self._step_resultants()
        #: Resultants of each law: those of the scheme, and the viscous ones.
        self.parts = resultants
        #: N, Q and M of each law.
        self.resultants = [
            ufl.as_vector([sum(getattr(r, name) for r in parts) for name in "NQM"])
            for parts in resultants
        ]

    @property
    def measures(self) -> list[Any]:
        """Measure of the beams of each law."""
        dx, count = self.fields.measure(self.fields.degree), len(self.laws)
        return [dx(tag) for tag in range(count)] if count > 1 else [dx]

    def _step_resultants(self) -> list[list[Any]]:
        """The resultants of each law in a step of the present fields."""
        name = f"rates of {self._kind.scheme.name}"
        self.step = self.fields.step(self._kind.scheme.rates, name, self._kind.natural)
        if own_strains := self._kind.scheme.strains:
            self.step = replace(self.step, own_strains=own_strains)
        #: Internal variables of each law that has some, as `evolved` gives them.
        self.evolution = [self._evolved(variables) for _, variables in self._kind.materials]
        #: The laws themselves.
        self.laws = [
            self._law(energy, evolution)
            for (energy, _), evolution in zip(self._kind.materials, self.evolution, strict=True)
        ]
        scheme: Any = self._kind.scheme
        scheme_resultants = scheme.resultants
        if scheme.parameters:
            scheme_resultants = replace(
                scheme_resultants, damping=replaced(scheme_resultants.damping, self.symbols.by_name)
            )
        symbols, level = self.symbols, self._kind.scheme.rates.level
        resultants: list[list[Any]] = [[scheme_resultants(self.step, law)] for law in self.laws]
        for (law_resultants,) in resultants:
            name = f"{self._kind.scheme.name}: what resultants(step, law) gives"
            require(hasattr(law_resultants, "N"), name, law_resultants, "fx_beam.Resultants")
        if symbols.times is not None:
            if scheme.strains is not None:
                raise SceneError(
                    f"{scheme.name}: it has strains of its own, of which viscous forces are not "
                    "known. Leave out `retardation`, `rayleigh` and `damping_ratio`"
                )
            for law, parts in zip(self.laws, resultants, strict=True):
                parts.append(viscous(self.step, law, symbols.times, level))
        return resultants

    def _evolved(self, variables: InternalVariables | None) -> tuple[Expr, ...] | None:
        if variables is None:
            return None
        old = ufl.as_vector([self.symbols.internal[i] for i in range(len(variables.names))])
        at_rest = self._kind.scheme.rates.at_rest
        dt = self.fields.load_increment if at_rest else self.fields.dt
        expressions = evolved(variables, old, self.step.strains0, self.step.strains1, dt, at_rest)
        return tuple(replaced(expression, self.symbols.by_name) for expression in expressions)

    def _law(self, energy: Energy | None, evolution: tuple[Expr, ...] | None) -> Law:
        if energy is None:
            return quadratic_law(self.symbols.data["stiffness"])
        energy = self.symbols.with_values(energy)
        return own_law(energy) if evolution is None else law_of_step(energy, *evolution[:2])


def internal_work(laws: StepLaws) -> Form:
    """Virtual work of the resultants along all beams (eqs 15 to 17), the residual of a step."""
    return sum(
        r.virtual_work(laws.step) * dx
        for parts, dx in zip(laws.parts, laws.measures, strict=True)
        for r in parts
    )


class WeakForm:
    """Internal forces, tangent and energies of beams for a scheme, in UFL.

    On the symbols of all scenes of a kind, or on given ones, as of a mesh: then functions of a user
    may have further ones.
    """

    def __init__(self, kind: Kind, symbols: elements.Symbols | None = None):
        self.kind, self._open = kind, symbols is not None
        #: The step, and the resultants in it.
        self.laws = laws = StepLaws(kind, symbols)
        self.fields, self.symbols = laws.fields, laws.symbols
        self._residual = internal_work(laws)
        self._build_energies()
        self._refuse_fields()
        #: Names of all symbols.
        self.named = {
            **self.fields.names,
            **{self.symbols.parameters: "parameters", self.symbols.internal: "internal"},
            **{symbol: name for name, symbol in self.symbols.named_data.items()},
        }
        self._added: Form = 0
        if kind.works:
            self._add(kind.works)

    def _build_energies(self) -> None:
        laws, step = self.laws, self.laws.step
        groups = zip(laws.parts, laws.measures, strict=True)
        parts = [(r, dx) for resultants, dx in groups for r in resultants]
        #: Work of natural strains that change.
        self._actuation = sum(actuation(step, r) * dx for r, dx in parts if self.kind.natural)

        def of_scheme(name: str) -> Form:
            decaying = [(r, dx) for r, dx in parts if isinstance(r, DecayingResultants)]
            densities = [(getattr(r, name), dx) for r, dx in decaying]
            return sum(density * dx for density, dx in densities if density is not None)

        self._held_before = of_scheme("held_before")
        pairs = [*zip(laws.laws, laws.measures, strict=True)]
        energy = self.kind.scheme.energy or (lambda law, *strains: law.energy(*strains))
        stored = sum(energy(law.start, *step.strains0) * dx for law, dx in pairs)
        lost = sum(loss * dx for n, (_, dx) in enumerate(pairs) for loss in self._losses_of(n))
        full = self.fields.measure(self.fields.degree + 1)  # exact for products of two fields
        #: Apart, as FFCx confuses two rules in one form if one of them has a single point.
        drag: list[Form] = [
            quantity(step, self.symbols.drag) * full if self.symbols.drag else 0
            for quantity in (drag_work, drag_loss)
        ]
        self._drag_work, lost_to_drag = drag
        #: Energies by name: stored, what the scheme holds for the next step, and `LOSSES`.
        self._energies = {"strain energy": stored, "scheme's energy": of_scheme("held")}
        losses = lost, of_scheme("loss"), lost_to_drag
        self._energies |= dict(zip(LOSSES, losses, strict=True))

    def _losses_of(self, number: int) -> Iterator[Expr]:
        """Energies per length that the material of a law loses in a step."""
        laws, step, (energy, internal) = self.laws, self.laws.step, self.kind.materials[number]
        if energy is not None and internal is not None:
            strains = step.strains0, step.strains1
            arguments = self.symbols.with_values(energy), internal.level, laws.evolution[number]
            yield evolution_loss(*arguments, strains, self.kind.scheme.rates.at_rest)
        if self.symbols.times is not None:
            yield viscous_loss(step, laws.laws[number], self.symbols.times)

    def _refuse_fields(self) -> None:
        if self._open:
            return
        name = f"resultants of {self.kind.scheme.name}"
        allowed = [
            *self.fields.names,
            *self.symbols.data.values(),
            self.symbols.internal,
            self.symbols.parameters,
        ]
        # UFL extracts those of the form anyway, and caches them.
        stored = (
            self._energies["strain energy"] if self.kind.scheme.has_own_energy else ufl.Form([])
        )
        for form in (self._residual, stored):
            refuse_fields([*form.coefficients(), *form.constants()], name, allowed)
        for law_resultants in self.laws.resultants:
            refuse_fields_in(law_resultants, name, allowed)

    def _add(self, works: Sequence[VirtualWork]) -> None:
        """Add the virtual works of further forces."""
        density: Expr = 0
        for number, (work, support) in enumerate(
            zip(works, self.symbols.indicators, strict=True), start=1
        ):
            term = self._checked_work(work, f"virtual work {number}")
            density += term if work.beam is None else term * support
        self._added = density * self.fields.measure(self.fields.degree)
        self._residual -= self._added

    def _checked_work(self, work: VirtualWork, name: str) -> Expr:
        """A virtual work per length in UFL; SceneError if it is none."""
        # Nothing moves in a load step: the work is that of the forces at its end.
        step = self.laws.step.at_its_end if self.kind.scheme.rates.at_rest else self.laws.step
        if self.kind.held:  # derivatives by the motion are sought, not by increments
            step = step.in_an_instant
        test, term = self.fields.test, replaced(work.of(step, name), self.symbols.by_name)
        if not self._open:
            refuse_fields_in(term, name, [*self.fields.names, self.symbols.parameters])
        expected = f"{name}: the result must be a scalar UFL expression linear in step.virtual_u "
        expected += "and step.virtual_psi"
        if term.ufl_shape != () or ufl.algorithms.extract_arguments(term) != [test]:
            raise SceneError(f"{expected}, not {term}")
        check_linear(term, test, expected)
        return term

    def step_forms(self) -> Written:
        """Forms of a step, those that there are."""
        fields, residual, drag = self.fields, self._residual, self._drag_work
        forms = {
            "internal forces": residual,
            "tangent": ufl.derivative(residual, fields.increment, fields.trial),
            "added virtual work": self._added,
            "drag": drag,
            "tangent of drag": ufl.derivative(drag, fields.increment, fields.trial) if drag else 0,
            "inverted sections": _inverted_sections(fields),
            **self._energies,
            # With the parameters of the step.
            "scheme's energy at the start": self._held_before if self.symbols.energy_names else 0,
            "work of natural strains": self._actuation,
            # Increments at the Gauss points, each times its weight.
            "internal variables": self._increments() if self.symbols.width else 0,
        }
        present = {name: form for name, form in forms.items() if form}
        facts = {"step": self._facts()._asdict(), "spaces": {"internal variables": ["internal"]}}
        return Written(
            present, self.named, facts | {"own work": True} if self._has_own_work else facts
        )

    @property
    def _has_own_work(self) -> bool:
        """Whether the virtual work of resultants is that of a user's class."""
        parts = (r for resultants in self.laws.parts for r in resultants)
        return any(not type(r).virtual_work.__module__.startswith("fx_beam.") for r in parts)

    def _facts(self) -> StepFacts:
        fields, residual = self.fields, self._residual
        forces = [
            *residual.coefficients(),
            *(self._drag_work.coefficients() if self.symbols.drag else ()),
        ]
        used = [part for r in self.laws.resultants for part in fields_in(r)]
        resultants_need_rates = any(rate in used for rate in fields.start_rates)
        return StepFacts(
            needs_previous=fields.q_previous in residual.coefficients(),
            needs_rates=any(rate in forces for rate in fields.start_rates),
            resultants_need_rates=resultants_need_rates,
            resultants_move=resultants_need_rates or fields.dt in used,
            width=self.symbols.width,
            names=self.symbols.names,
            energy_names=self.symbols.energy_names,
        )

    def _increments(self) -> Form:
        grown = [x and x[1] - x[0] for x in self.laws.evolution]
        return self._at_points(grown, ufl.TestFunction(self.fields.internal(self.symbols.width)))

    def _at_points(self, vectors: Sequence[Expr], test: Expr) -> Form:
        """Vectors of the laws, None for none, at the Gauss points, each times its weight."""
        form = 0
        for values, dx in zip(vectors, self.laws.measures, strict=True):
            if values is not None:
                form += sum(values[i] * test[i] for i in range(len(values))) / self.laws.step.h * dx
        return form

    def resultants_at_points(self) -> Written:
        """N, Q and M of each law at the Gauss points."""
        return self._expressions("resultants", self.laws.resultants)

    def normal_stretch(self) -> Written:
        """t . phi' of eq. 4 at the start of the step, 1 and the axial strain, there."""
        step = replace(self.laws.step, own_strains=None)
        return self._expressions("normal stretch", [1 + step.total_strains0[0]])

    def _expressions(self, name: str, expressions: Sequence[Expr]) -> Written:
        points = gauss_rule(self.fields.degree)[0][:, None]
        numbered = enumerate(expressions, start=1)
        return Written({f"{name} {k}": (e, points) for k, e in numbered}, self.named)


def _inverted_sections(fields: Fields) -> Form:
    """A functional of the start of a step, positive where t . phi' > 0 (eq. 4) is violated."""
    # The derivative along the element's own coordinate has the same sign and is cheaper.
    X = fields.jacobian
    u0, psi0 = ufl.split(fields.start)
    stretch = ufl.dot(director(psi0, X), X + arc_derivative(u0, X))
    return (abs(stretch) - stretch) * fields.measure(fields.degree)


# -- Derivatives of a step's energies, resultants, and of the work of its forces on given weights


class DerivedForm(WeakForm):
    """Quantities of a step, and their derivatives by all that they depend on."""

    def __init__(self, kind: Kind):
        super().__init__(kind)
        self._works: dict[str, tuple[list[Expr], Form, dict[str, Form]]] = {}
        #: Zero, added to the parameters of each element.
        self._more: Expr = None
        if self.symbols.parameters is not None:
            self._more = self.fields.symbols.data(1, self.symbols.parameters.ufl_shape)
            self.named[self._more] = "more"

    def derivatives(self, name: str) -> Written:
        """Derivatives of an energy, or of "resultants", by name.

        The latter are at the Gauss points, each times the weight of its point.
        """
        if name == "resultants":
            quantity = self._at_points(
                self.laws.resultants, ufl.TestFunction(self.fields.internal(3))
            )
        else:
            quantity = self._energies[name]
        forms = self._derived(quantity)[1]
        tests = ["resultants"] * (name == "resultants")
        return Written(forms, self.named, {"spaces": {x: [*tests, x] for x in forms}})

    def _work(self, forces: str) -> tuple[list[Expr], Form, dict[str, Form]]:
        """Weights w, the work w.f of "internal forces" or "drag" f, and its derivatives by name.

        With internal variables, their increments times further weights are added.
        """
        if forces in self._works:
            return self._works[forces]
        forms = {self.fields.test: self._drag_work if forces == "drag" else self._residual}
        if self.symbols.width and forces != "drag":
            forms[ufl.TestFunction(self.fields.internal(self.symbols.width))] = self._increments()
        make = self.fields.symbols.coefficient
        weights = {test: make(test.ufl_function_space()) for test in forms}
        self.named |= {weight: f"weight {k}" for k, weight in enumerate(weights.values())}
        work = sum(ufl.replace(form, {test: weights[test]}) for test, form in forms.items())
        self._works[forces] = [*weights.values()], *self._derived(work)
        return self._works[forces]

    def work(self, forces: str) -> Written:
        """Names of the derivatives of the work on weights, as a fact."""
        return Written({}, {}, {"derivatives": [*self._work(forces)[2]]})

    def slopes(self, forces: str, *names: str) -> Written:
        """The work itself, as "work 0", and derivatives by these names and by each weight."""
        weights, work, derivatives = self._work(forces)
        slopes, spaces = {"work 0": work}, dict[str, list[str]]()
        for name in names:
            for number, weight in enumerate(weights):
                slope = ufl.derivative(derivatives[name], weight)
                if not _is_empty(slope):
                    slopes[f"{name} {number}"] = slope
                    spaces[f"{name} {number}"] = [name, f"weight {number}"]
        return Written(slopes, self.named, {"spaces": spaces})

    def _derived(self, quantity: Form) -> tuple[Form, dict[str, Form]]:
        """A quantity, with `more` parameters, and its derivatives that are not zero, by name."""
        fields = self.fields
        if self.symbols.parameters is not None:
            quantity = ufl.replace(
                quantity, {self.symbols.parameters: self.symbols.parameters + self._more}
            )
        symbols = {name: symbol for symbol, name in self.named.items()}
        nodal = "increment", "start", "q_previous"
        names = *nodal, "internal", *NATURAL, *self.symbols.data
        used = {name: symbols.get(name) for name in names} | {"parameters": self._more}
        used = {name: field for name, field in used.items() if field in quantity.coefficients()}
        forms = {name: ufl.derivative(quantity, field) for name, field in used.items()}
        X, position_space = fields.coordinates
        argument = ufl.Argument(position_space, len(quantity.arguments()))
        forms["coordinates"] = ufl.derivative(quantity, X, argument)
        return quantity, {name: form for name, form in forms.items() if not _is_empty(form)}


def _is_empty(form: Form) -> bool:
    """Whether a form is zero once its derivatives are taken."""
    return ufl.algorithms.expand_derivatives(form).empty()
