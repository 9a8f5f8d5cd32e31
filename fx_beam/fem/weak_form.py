"""The weak form of one step in UFL, compiled for all scenes of a kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

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
from fx_beam.laws.schemes import Scheme
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
from fx_beam.symbolic import Written, ufl

from . import elements
from .fields import DataShape, Fields, fields_of

#: Energies that material, scheme and drag take in a step.
LOSSES = "lost energy", "scheme's loss", "loss to drag"
#: Stored energy of a section, None for the quadratic one, and its internal variables.
Material = tuple[Energy | None, InternalVariables | None]


class Kind(NamedTuple):
    """What forms of a step depend on, on no particular mesh.

    `materials` are those of the sections, numbered as subdomains if there are several. Data are
    known by their shapes: "stiffness" of the quadratic energy, "retardation" times, coefficients of
    the drag. With `natural` there are natural strains. Virtual works that are `held` are those of
    an instant.
    """

    degree: int
    curved: bool
    scheme: Scheme
    materials: tuple[Material, ...]
    works: tuple[VirtualWork, ...]
    natural: bool
    data: tuple[tuple[str, DataShape], ...]
    held: bool

    @property
    def key(self) -> tuple | None:
        """An identifier if all functions are those of this package, else None."""
        if not self.scheme.built_in or self.works or self.materials != (_ELASTIC,):
            return None
        return (*self[:2], self.scheme.key, *self[5:])


_ELASTIC: Material = (None, None)


class StepFacts(NamedTuple):
    """What the users of the forms of a step must know of them."""

    #: Whether the forces depend on the start of the last step, and on rates at the start of a step.
    needs_previous: bool
    needs_rates: bool
    #: Whether the resultants depend on rates at the start of a step, and on any rates.
    resultants_need_rates: bool
    resultants_move: bool
    #: Number of internal variables at a Gauss point.
    width: int
    #: Names of all parameters, and of those in stored energies.
    names: list[str]
    names_in_energies: list[str]


class WeakForm:
    """Internal forces, tangent and energies of beams for a scheme, in UFL.

    On the symbols of all scenes of a kind, or on given ones, as of a mesh: then functions of a user
    may have further ones.
    """

    def __init__(self, kind: Kind, symbols: elements.Symbols | None = None):
        scheme, materials, works = kind.scheme, kind.materials, kind.works
        self.scheme, self._open = scheme, symbols is not None
        if symbols is None:
            self.fields, self._nodal = fields_of(kind.degree, kind.curved)
        else:
            self.fields, self._nodal = (
                Fields(kind.degree, symbols, nodal) for nodal in (False, True)
            )
        fields = self.fields
        self.has_natural, self._held = kind.natural, kind.held
        #: Data of beams by name: (EA, GA, EI) of the quadratic law, retardation times, and drag.
        self.data = {name: fields.data(shape) for name, shape in kind.data}
        self.times = self.data.get("retardation")
        of_drag = [name for name in self.data if name.startswith("drag ")]
        self._drag = {name.removeprefix("drag "): self.data[name] for name in of_drag}
        #: Where each virtual work acts: 1 there, 0 elsewhere.
        self.indicators = [fields.data((1, ())) for _ in works]
        self._materials = materials
        of_energies = parameters_of(
            function for material in materials for function in functions_of_energy(*material, 3)
        )
        #: Names of the parameters in stored energies, and of all.
        self.names_in_energies = names_of(of_energies)
        of_works = []
        if works:
            from fx_beam.scene.symbols import STEP

            of_works = parameters_in(*(work.of(STEP, "virtual work") for work in works))
        self.names = names_of([*of_energies, *scheme.parameters, *of_works])
        #: Their values (n,), None without any, and those by name.
        self.parameters: Any = None
        if self.names:
            self.parameters = fields.constants(len(self.names))
        self._by_name: dict[str, Any] = {
            name: self.parameters[i] for i, name in enumerate(self.names)
        }
        #: Number of internal variables at a Gauss point, and their values at the step's start.
        self.width = max(len(internal.names) if internal else 0 for _, internal in materials)
        self.internal: Any = None
        if self.width:
            self.internal = fields.symbols.coefficient(fields.internal(self.width))
        self._build_resultants()
        self._build_residual()
        #: Names of all symbols.
        self.named = {
            **self.fields.names,
            **{self.parameters: "parameters", self.internal: "internal"},
            **{symbol: name for name, symbol in self.data.items()},
            **{symbol: f"indicator {i}" for i, symbol in enumerate(self.indicators)},
        }
        #: Those that data of beams have, by name.
        self.named_data = dict(self.data)
        self.named_data |= {f"indicator {i}": field for i, field in enumerate(self.indicators)}
        if self.fields.coordinate is not None:
            self.named_data["coordinate"] = self.fields.coordinate
        self._added: Any = 0
        if works:
            self._add(works)

    def _build_resultants(self) -> None:
        """The step, and the resultants of each law."""
        resultants = self._of_step()
        all_resultants = [r for parts in resultants for r in parts]
        exact = self.step.degree > 1 and any(isinstance(r, ExactResultants) for r in all_resultants)
        if exact or (self.scheme.rates.mean_based and "rotation" in self._drag):
            self.fields = self._nodal
            resultants = self._of_step()
        #: Resultants of each law: those of the scheme, and the viscous ones.
        self._of_laws = resultants
        #: N, Q and M of each law.
        self.resultants = [
            ufl.as_vector([sum(getattr(r, name) for r in parts) for name in "NQM"])
            for parts in resultants
        ]

    def _of_step(self) -> list[list[Any]]:
        """The resultants of each law in a step of the present fields."""
        name = f"rates of {self.scheme.name}"
        self.step = self.fields.step(self.scheme.rates, name, self.has_natural)
        #: Internal variables of each law that has some, as `evolved` gives them.
        self._evolution = [self._evolved(variables) for _, variables in self._materials]
        self._laws = [
            self._law(energy, of_step)
            for (energy, _), of_step in zip(self._materials, self._evolution, strict=True)
        ]
        of_scheme: Any = self.scheme.resultants
        if self.scheme.parameters:
            of_scheme = replace(of_scheme, damping=replaced(of_scheme.damping, self._by_name))
        resultants: list[list[Any]] = [[of_scheme(self.step, law)] for law in self._laws]
        for (of_law,) in resultants:
            name = f"{self.scheme.name}: what resultants(step, law) gives"
            require(hasattr(of_law, "N"), name, of_law, "fx_beam.Resultants")
        if self.times is not None:
            for law, parts in zip(self._laws, resultants, strict=True):
                parts.append(viscous(self.step, law, self.times, self.scheme.rates.level))
        return resultants

    def _evolved(self, variables: InternalVariables | None) -> tuple[Any, ...] | None:
        if variables is None:
            return None
        old = ufl.as_vector([self.internal[i] for i in range(len(variables.names))])
        at_rest = self.scheme.rates.at_rest
        dt = self.fields.load_increment if at_rest else self.fields.dt
        of_step = evolved(variables, old, self.step.strains0, self.step.strains1, dt, at_rest)
        return tuple(replaced(expression, self._by_name) for expression in of_step)

    def _with_values(self, energy: Energy) -> Energy:
        """A stored energy with the values of its parameters."""
        return lambda *arguments: replaced(energy(*arguments), self._by_name)

    def _law(self, energy: Energy | None, of_step: tuple[Any, ...] | None) -> Law:
        if energy is None:
            return quadratic_law(self.data["stiffness"])
        energy = self._with_values(energy)
        return own_law(energy) if of_step is None else law_of_step(energy, *of_step[:2])

    def _build_residual(self) -> None:
        dx = self.fields.measure(self.fields.degree)
        none: Any = 0
        #: The last is the work of natural strains that change.
        self._residual = self._held_before = self._actuation = none
        stored = lost = of_scheme = scheme_energy = none
        for tag, (law, parts) in enumerate(zip(self._laws, self._of_laws, strict=True)):
            dx_law = dx(tag) if len(self._laws) > 1 else dx
            for r in parts:
                self._residual += r.virtual_work(self.step) * dx_law
                if self.has_natural:
                    self._actuation += actuation(self.step, r) * dx_law
                if isinstance(r, DecayingResultants):
                    of_scheme += r.loss * dx_law
                    scheme_energy += 0 if r.held is None else r.held * dx_law
                    self._held_before += 0 if r.held_before is None else r.held_before * dx_law
            stored += law.start.energy(*self.step.strains0) * dx_law
            (energy, internal), of_step = self._materials[tag], self._evolution[tag]
            if energy is not None and internal is not None:
                strains = self.step.strains0, self.step.strains1
                arguments = self._with_values(energy), internal.level, of_step, strains
                lost += evolution_loss(*arguments, self.scheme.rates.at_rest) * dx_law
            if self.times is not None:
                lost += viscous_loss(self.step, law, self.times) * dx_law
        full = self.fields.measure(self.fields.degree + 1)  # exact for products of two fields
        #: Apart, as FFCx confuses two rules in one form if one of them has a single point.
        self._of_drag, lost_to_drag = (
            quantity(self.step, self._drag) * full if self._drag else none
            for quantity in (drag_work, drag_loss)
        )
        #: Energies by name: stored, what the scheme holds for the next step, and `LOSSES`.
        self._energies = {"strain energy": stored, "scheme's energy": scheme_energy}
        self._energies |= dict(zip(LOSSES, (lost, of_scheme, lost_to_drag), strict=True))
        self._refuse_fields()

    def _refuse_fields(self) -> None:
        if self._open:
            return
        name = f"resultants of {self.scheme.name}"
        known = [*self.fields.names, *self.data.values(), self.internal, self.parameters]
        # UFL extracts those of the form anyway, and caches them.
        refuse_fields([*self._residual.coefficients(), *self._residual.constants()], name, known)
        for of_law in self.resultants:
            refuse_fields_in(of_law, name, known)

    def _add(self, works: Sequence[VirtualWork]) -> None:
        """Add the virtual works of further forces."""
        per_length: Any = 0
        for number, (work, support) in enumerate(zip(works, self.indicators, strict=True), start=1):
            term = self._checked_work(work, f"virtual work {number}")
            per_length += term if work.beam is None else term * support
        self._added = per_length * self.fields.measure(self.fields.degree)
        self._residual -= self._added

    def _checked_work(self, work: VirtualWork, name: str) -> Any:
        """A virtual work per length in UFL; SceneError if it is none."""
        # Nothing moves in a load step: the work is that of the forces at its end.
        step = self.step.at_its_end if self.scheme.rates.at_rest else self.step
        if self._held:  # derivatives by the motion are sought, not by increments
            step = step.in_an_instant
        test, term = self.fields.test, replaced(work.of(step, name), self._by_name)
        if not self._open:
            refuse_fields_in(term, name, [*self.fields.names, self.parameters])
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

    def of_step(self) -> Written:
        """Forms of a step, those that there are."""
        fields, residual, drag = self.fields, self._residual, self._of_drag
        forms = {
            "internal forces": residual,
            "tangent": ufl.derivative(residual, fields.increment, fields.trial),
            "added virtual work": self._added,
            "drag": drag,
            "tangent of drag": ufl.derivative(drag, fields.increment, fields.trial) if drag else 0,
            "inverted sections": _inverted_sections(fields),
            **self._energies,
            # With the parameters of the step.
            "scheme's energy at the start": self._held_before if self.names_in_energies else 0,
            "work of natural strains": self._actuation,
            # Increments at the Gauss points, each times its weight.
            "internal variables": self._increments() if self.width else 0,
        }
        present = {name: form for name, form in forms.items() if form}
        return Written(present, self.named, self._facts()._asdict())

    def _facts(self) -> StepFacts:
        fields, residual = self.fields, self._residual
        forces = [*residual.coefficients(), *(self._of_drag.coefficients() if self._drag else ())]
        used = [part for r in self.resultants for part in fields_in(r)]
        resultants_need_rates = any(rate in used for rate in fields.start_rates)
        return StepFacts(
            needs_previous=fields.q_previous in residual.coefficients(),
            needs_rates=any(rate in forces for rate in fields.start_rates),
            resultants_need_rates=resultants_need_rates,
            resultants_move=resultants_need_rates or fields.dt in used,
            width=self.width,
            names=self.names,
            names_in_energies=self.names_in_energies,
        )

    def _increments(self) -> Any:
        grown = [of_step and of_step[1] - of_step[0] for of_step in self._evolution]
        return self._at_points(grown, ufl.TestFunction(self.fields.internal(self.width)))

    def _at_points(self, of_laws: Sequence[Any], test: Any) -> Any:
        """Vectors of the laws, None for none, at the Gauss points, each times its weight."""
        dx, form = self.fields.measure(self.fields.degree), 0
        for tag, values in enumerate(of_laws):
            if values is not None:
                per_length = sum(values[i] * test[i] for i in range(len(values))) / self.step.h
                form += per_length * (dx(tag) if len(of_laws) > 1 else dx)
        return form

    def of_points(self) -> Written:
        """N, Q and M of each law at the Gauss points."""
        return self._expressions("resultants", self.resultants)

    def normal_stretch(self) -> Written:
        """t . phi' of eq. 4 at the start of the step, 1 and the axial strain, there."""
        return self._expressions("normal stretch", [1 + self.step.total_strains0[0]])

    def _expressions(self, name: str, expressions: Sequence[Any]) -> Written:
        points = gauss_rule(self.fields.degree)[0][:, None]
        numbered = enumerate(expressions, start=1)
        return Written({f"{name} {k}": (e, points) for k, e in numbered}, self.named)


def _inverted_sections(fields: Fields) -> Any:
    """A functional of the start of a step, positive where t . phi' > 0 (eq. 4) is violated."""
    # The derivative along the element's own coordinate has the same sign and is cheaper.
    X = fields.jacobian
    u0, psi0 = ufl.split(fields.start)
    along = ufl.dot(director(psi0, X), X + arc_derivative(u0, X))
    return (abs(along) - along) * fields.measure(fields.degree)
