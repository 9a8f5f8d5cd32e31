"""The weak form of one step in UFL, compiled for all scenes of a kind."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import ufl

from fx_beam.errors import SceneError
from fx_beam.mechanics.decaying import DecayingResultants
from fx_beam.mechanics.kinematics import arc_derivative, director
from fx_beam.mechanics.resultants import ExactResultants
from fx_beam.mechanics.schemes import Scheme
from fx_beam.scene.law import Energy, Law, quadratic_law
from fx_beam.scene.loads import VirtualWork
from fx_beam.validation import fields_in, refuse_fields

from . import dolfinx_api
from .dolfinx_api import CompiledForm
from .fields import Fields
from .section_fields import Place
from .virtual_works import added_virtual_work


class WeakForm:
    """Internal forces, tangent and energies of beams for a scheme, on no particular mesh.

    `energies` are the different stored energies of the sections, None for the quadratic one, whose
    stiffnesses are in `place`; several ones are numbered as subdomains. Each virtual work comes
    with the place of its indicator.
    """

    def __init__(
        self,
        fields: Fields,
        scheme: Scheme,
        energies: Sequence[Energy | None],
        place: Place | None,
        works: Sequence[tuple[VirtualWork, Place]] = (),
    ):
        self.fields, self.scheme = fields, scheme
        #: Stiffnesses (EA, GA, EI) of the quadratic law.
        self.stiffness = None if place is None else fields.data(place)
        #: Where each virtual work acts: 1 there, 0 elsewhere.
        self.indicators = [fields.data(place) for _, place in works]
        self._laws = [
            quadratic_law(self.stiffness) if energy is None else Law(energy, quadratic=False)
            for energy in energies
        ]
        self._build_resultants()
        self._build_residual()
        self.added: CompiledForm | None = None
        if works:
            self._add([work for work, _ in works])
        self._compile()

    def _build_resultants(self) -> None:
        """The step, and the resultants of each law."""
        what = f"rates of {self.scheme.name}"
        self.step = self.fields.step(self.scheme.rates, what)
        found = [self.scheme.resultants(self.step, law) for law in self._laws]
        exact = ExactResultants, DecayingResultants
        if self.step.degree > 1 and any(isinstance(r, exact) for r in found):
            self.fields = self.fields.with_nodal_rotations
            self.step = self.fields.step(self.scheme.rates, what)
            found = [self.scheme.resultants(self.step, law) for law in self._laws]
        self._of_laws = found
        #: N, Q and M of each law.
        self.resultants = [ufl.as_vector((r.N, r.Q, r.M)) for r in found]

    def _build_residual(self) -> None:
        dx = self.fields.measure(self.fields.degree)
        self._residual: Any = 0
        self._stored: Any = 0
        #: Energy that the scheme takes in a step, and that it holds for the next one.
        self._lost: Any = 0
        self._held: Any = 0
        for tag, (law, r) in enumerate(zip(self._laws, self._of_laws, strict=True)):
            dx_law = dx(tag) if len(self._laws) > 1 else dx
            self._residual += r.virtual_work(self.step) * dx_law
            self._stored += law.energy(*self.step.strains0) * dx_law
            if isinstance(r, DecayingResultants):
                self._lost += r.loss * dx_law
                self._held += 0 if r.held is None else r.held * dx_law
        self._refuse_fields()

    def _refuse_fields(self) -> None:
        # UFL extracts those of the form anyway, and caches them.
        found = [*self._residual.coefficients(), *self._residual.constants()]
        found += [field for r in self._of_laws for field in fields_in(r.M)]
        known = [*self.fields.known, *(field for law in self._laws for field in law.data)]
        refuse_fields(found, f"resultants of {self.scheme.name}", known)

    def _add(self, works: Sequence[VirtualWork]) -> None:
        """Add the virtual works of further forces."""
        per_length = added_virtual_work(works, self.indicators, self.step, self.fields)
        added = per_length * self.fields.measure(self.fields.degree)
        try:
            self.added = dolfinx_api.compile_form(added, "added virtual work")
        except dolfinx_api.REFUSALS as error:
            raise SceneError(
                f"the added virtual work does not compile: {error}. Simplify its expressions"
            ) from error
        self._residual -= added

    def _compile(self) -> None:
        fields, residual = self.fields, self._residual
        self.force = dolfinx_api.compile_form(residual, "internal forces")
        tangent = ufl.derivative(residual, fields.increment, fields.trial)
        self.tangent = dolfinx_api.compile_form(tangent, "tangent")
        self.energy = dolfinx_api.compile_form(self._stored, "strain energy")
        #: Compiled, if the scheme has them.
        self.lost, self.held = (
            dolfinx_api.compile_form(energy, name) if energy else None
            for energy, name in ((self._lost, "scheme's loss"), (self._held, "scheme's energy"))
        )
        #: Whether the forces depend on the start of the last step.
        self.needs_before = fields.before in residual.coefficients()
        if self.needs_before and len(self.scheme.fractions) > 1:
            raise SceneError(
                f"{self.scheme.name}: its resultants depend on the last step, so that it cannot "
                "have sub-steps. Use fractions=(1.0,)"
            )
        #: Whether the forces depend on rates at the start of a step.
        self.needs_rates = any(rate in residual.coefficients() for rate in fields.start_rates)
        moves = self.needs_rates or fields.dt in residual.constants()
        found = [part for r in self.resultants for part in fields_in(r)] if moves else []
        #: Whether the resultants depend on rates at the start of a step, and on any rates.
        self.resultants_need_rates = any(rate in found for rate in fields.start_rates)
        self.resultants_move = self.resultants_need_rates or fields.dt in found

    @property
    def facing(self):
        """t . phi' of eq. 4 at the start of the step: 1 and the axial strain."""
        return 1 + self.step.strains0[0]


def weak_form(
    fields: Fields,
    scheme: Scheme,
    energies: Sequence[Energy | None],
    place: Place | None,
    works: Sequence[tuple[VirtualWork, Place]],
) -> WeakForm:
    """The weak form of a kind of scene, kept if all its functions are those of this package.

    Functions of the user are asked again: the data that they use may have changed.
    """
    if scheme.built_in and not works and energies == [None]:
        return _kept(fields, scheme, place)
    return WeakForm(fields, scheme, energies, place, works)


@functools.lru_cache(maxsize=32)
def _kept(fields: Fields, scheme: Scheme, place: Place | None) -> WeakForm:
    return WeakForm(fields, scheme, [None], place)


@functools.cache
def sections_facing_backwards(fields: Fields) -> CompiledForm:
    """A functional of the start of a step, positive where t . phi' > 0 (eq. 4) is violated."""
    # The derivative along the element's own coordinate has the same sign and is cheaper.
    X = fields.jacobian
    u0, psi0 = ufl.split(fields.start)
    along = ufl.dot(director(psi0, X), X + arc_derivative(u0, X))
    backwards = (abs(along) - along) * fields.measure(fields.degree)
    return dolfinx_api.compile_form(backwards, "sections facing backwards")
