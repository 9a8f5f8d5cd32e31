"""The fields of a step in UFL, on no particular mesh: forms of them fit all meshes of a kind."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np

from fx_beam.dual import dual_array, floats
from fx_beam.errors import SceneError, any_of, refuse_fields_in
from fx_beam.laws.kinematics import Step
from fx_beam.laws.rates import UpdateRule
from fx_beam.laws.resultants import Nodes, lagrange
from fx_beam.scene.beam import Beam, arc_lengths, gauss_rule
from fx_beam.scene.loads import PARTS_OF_DRAG, damping_of
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section, values_along
from fx_beam.symbolic import ufl

from . import elements
from .mesh import Mesh

#: Names of nodal fields: the first changes in every iteration, the others in every step.
NODAL = "increment", "start", "velocity", "acceleration", "q_previous"
#: Of natural strains at the Gauss points, at the start and at the end of the step.
NATURAL = "natural", "natural_end"
#: Of numbers of a step.
CONSTANTS = "time", "dt", "load_factor", "load_increment", "memory"
#: What a form must know of data (cells, points, ...): number of points, and shape of a value.
DataShape = tuple[int, tuple[int, ...]]


def section_data(mesh: Mesh, scene: Any, names: tuple[str, ...], points: int) -> Any:
    """Section data (cells, n, ...), vectors or scalars: n is 1 if they are constant on each beam.

    Data that vary are evaluated at so many Gauss points. The SceneError for an invalid value names
    its beam and its fraction.
    """
    sections = [beam.section for beam in scene.beams]
    constants = {id(section): section.constants(names) for section in distinct(sections)}
    if None not in constants.values():
        of_beams = dual_array([constants[id(section)] for section in sections])
        return of_beams[mesh.beam_of_cell][:, None]
    gauss, _ = gauss_rule(points)
    values: list[np.ndarray] = []
    for beam in scene.beams:
        fractions = arc_lengths(beam, gauss) / beam.length
        try:
            section, arrays = beam.section, scene.array_calls
            of_beam = [values_along(section, name, fractions, arrays) for name in names]
        except SceneError as error:
            raise SceneError(f"beam {beam.name!r}: {error}") from None
        values.append(np.stack(of_beam, axis=-1) if len(names) > 1 else of_beam[0])
    return np.concatenate(values)


def data_of_beams(scene: Scene, mesh: Mesh, at_rest: bool) -> dict[str, Any]:
    """Stiffnesses of the quadratic law, retardation times and drag, if there are any.

    Data (cells, points, ...) by name, with slopes of the scene.
    """
    data: dict[str, Any] = {}
    if not scene.beams:
        return data
    degree, sections = scene.beams[0].degree, distinct(beam.section for beam in scene.beams)
    if any(section.strain_energy is None for section in sections):
        data["stiffness"] = section_data(mesh, scene, ("EA", "GA", "EI"), degree)
    if at_rest:
        return data
    alpha, tau = damping_of(scene)
    if tau > 0 or any(section.damped for section in sections):
        data["retardation"] = section_data(mesh, scene, ("retardation",), degree) + tau
    if scene.drags:
        data |= drag_data(mesh, scene)
    if alpha > 0:
        density = section_data(mesh, scene, ("rhoA", "rhoI"), degree + 1)
        for i, name in enumerate(("drag linear", "drag rotation")):
            if any_of(floats(density[..., i])):
                data[name] = alpha * density[..., i] + data.get(name, 0.0)
    return data


def distinct(sections: Iterable[Section]) -> list[Section]:
    """Each section once: beams of a frame share a few."""
    return list({id(section): section for section in sections}.values())


def drag_data(mesh: Mesh, scene: Scene) -> dict[str, Any]:
    """Coefficients (cells, 1, ...) of `drag_work`, those that there are, behind "drag "."""
    rows: dict[str, list[Any]] = {}
    on_beams = ((drag, drag.target) for drag in scene.drags if isinstance(drag.target, Beam))
    for drag, beam in on_beams:
        for name in PARTS_OF_DRAG:
            value = getattr(drag, name)
            if value.any():
                key = f"drag {name}" if len(value) == 1 else f"drag {name} along and across"
                of_beams = rows.setdefault(key, [np.zeros(len(value)) for _ in scene.beams])
                i = scene.beams.index(beam)
                of_beams[i] = of_beams[i] + dual_array(value)
    of_cells = {name: dual_array(of_beams)[mesh.beam_of_cell] for name, of_beams in rows.items()}
    return {name: array[:, None] if "across" in name else array for name, array in of_cells.items()}


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
        self.coordinate: Any = None
        if nodal:
            self.coordinate = symbols.coefficient(symbols.coordinate_space())
        unknowns = symbols.beam_space(degree, nodal)
        #: Increments of displacements and rotations.
        self.increment = symbols.coefficient(unknowns)
        self.test, self.trial = ufl.TestFunction(unknowns), ufl.TrialFunction(unknowns)

    @property
    def names(self) -> dict[Any, str]:
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

    def data(self, shape: DataShape):
        """UFL's symbol for data of beams."""
        return self.symbols.data(*shape)

    def constants(self, count: int):
        """UFL's symbol for so many numbers."""
        return self.symbols.constant(count)

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
            nodes = Nodes(Dpsi, virtual_psi, shape, self.degree / h * slope)
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
