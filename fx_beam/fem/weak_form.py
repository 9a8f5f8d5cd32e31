"""The weak form of one step in UFL, compiled for all scenes of a kind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError, fields_in, refuse_fields, refuse_fields_in, require
from fx_beam.laws.kinematics import arc_derivative, director
from fx_beam.laws.resultants import (
    DecayingResultants,
    ExactResultants,
    actuation,
    drag_loss,
    drag_work,
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
    law_of_step,
    own_law,
    quadratic_law,
)
from fx_beam.scene.loads import VirtualWork
from fx_beam.scene.parameters import replaced
from fx_beam.symbolic import Expr, Form, Written, ufl

from . import elements
from .beam_data import LOSSES, Kind, StepFacts
from .fields import Fields, FormSymbols, fields_of


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
        lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering
        arities = ufl.algorithms.check_arities
        try:
            arities.check_integrand_arity(lowered(term), (test,))
        except (Exception, arities.ArityMismatch) as error:  # which is not always an Exception
            raise SceneError(f"{expected}; {error}") from error
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
        return Written(present, self.named, facts)

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
