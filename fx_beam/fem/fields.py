"""The fields of a step in UFL, on no particular mesh: forms of them fit all meshes of a kind."""

from __future__ import annotations

import functools
from typing import Any

from fx_beam.errors import refuse_fields_in
from fx_beam.laws.kinematics import Step
from fx_beam.laws.rates import UpdateRule
from fx_beam.laws.resultants import NodeRotations, lagrange
from fx_beam.scene.law import Energy, functions_of_energy
from fx_beam.scene.parameters import names_of, parameters_in, parameters_of, replaced
from fx_beam.symbolic import Expr, ufl

from . import elements
from .beam_data import CONSTANTS, NATURAL, NODAL, Kind


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
            self.coordinate = symbols.coefficient(symbols.coordinate_space())
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
            from fx_beam.scene.symbols import STEP

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
