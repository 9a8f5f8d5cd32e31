"""Data that forms of beams depend on and read: kind, numbers of a scene, fields on its mesh."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.content_cache import shallow_copy
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, any_of
from fx_beam.laws.interval import StepBatch
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam, arc_lengths, gauss_rule
from fx_beam.scene.law import Energy, InternalVariables
from fx_beam.scene.loads import PARTS_OF_DRAG, VirtualWork, damping_of
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section, values_along
from fx_beam.scene.structure import OtherStructureError

from .compiled_forms import CompiledForm, Field, MeshTerm, Space
from .functions_of_time import LoadedBeams, ParameterValues
from .mesh import Mesh

#: Names of nodal fields: the first changes in every iteration, the others in every step.
NODAL = "increment", "start", "velocity", "acceleration", "q_previous"
#: Of natural strains at the Gauss points, at the start and at the end of the step.
NATURAL = "natural", "natural_end"
#: Of numbers of a step.
CONSTANTS = "time", "dt", "load_factor", "load_increment", "memory"
#: What a form must know of data (cells, points, ...): number of points, and shape of a value.
DataShape = tuple[int, tuple[int, ...]]


#: Energies that material, scheme and drag take in a step.
LOSSES = "lost energy", "scheme's loss", "loss to drag"
#: Stored energy of a section, None for the quadratic one, and its internal variables.
Material = tuple[Energy | None, InternalVariables | None]


class Kind(NamedTuple):
    """Key of the forms of a step on no particular mesh: degree, scheme, laws, and kinds of data.

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
    """Facts of the forms of a step: which arrays they read."""

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
    energy_names: list[str]


def section_data(
    mesh: Mesh, scene: Scene | LoadedBeams, names: tuple[str, ...], points: int
) -> MaybeDual:
    """Section data (cells, n, ...), vectors or scalars: n is 1 if they are constant on each beam.

    Data that vary are evaluated at so many Gauss points. The SceneError for an invalid value names
    its beam and its fraction.
    """
    sections = [beam.section for beam in scene.beams]
    constants = {id(section): section.constants(names) for section in distinct(sections)}
    if None not in constants.values():
        beam_rows = dual_array([constants[id(section)] for section in sections])
        return beam_rows[mesh.beam_of_cell][:, None]
    gauss, _ = gauss_rule(points)
    values: list[MaybeDual] = []
    for beam in scene.beams:
        fractions = arc_lengths(beam, gauss) / beam.length
        try:
            section, arrays = beam.section, scene.array_calls
            arrays_along = [values_along(section, name, fractions, arrays) for name in names]
        except SceneError as error:
            raise SceneError(f"beam {beam.name!r}: {error}") from None
        values.append(np.stack(arrays_along, axis=-1) if len(names) > 1 else arrays_along[0])
    return np.concatenate(values)


def data_of_beams(scene: Scene, mesh: Mesh, at_rest: bool) -> dict[str, MaybeDual]:
    """Stiffnesses of the quadratic law, retardation times and drag, if there are any.

    Data (cells, points, ...) by name, with slopes of the scene.
    """
    data: dict[str, MaybeDual] = {}
    if not scene.beams:
        return data
    sections = distinct([beam.section for beam in scene.beams])
    degree = scene.beams[0].degree
    if any([section.strain_energy is None for section in sections]):
        data["stiffness"] = section_data(mesh, scene, ("EA", "GA", "EI"), degree)
    if at_rest:
        return data
    alpha, tau = damping_of(scene)
    if tau > 0 or any([section.retardation != 0.0 and section.damped for section in sections]):
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


def drag_data(mesh: Mesh, scene: Scene) -> dict[str, MaybeDual]:
    """Coefficients (cells, 1, ...) of `drag_work`, those that there are, behind "drag "."""
    rows: dict[str, list[MaybeDual]] = {}
    beam_drags = ((drag, drag.target) for drag in scene.drags if isinstance(drag.target, Beam))
    for drag, beam in beam_drags:
        for name in PARTS_OF_DRAG:
            value = getattr(drag, name)
            if value.any():
                key = f"drag {name}" if len(value) == 1 else f"drag {name} along and across"
                if (beam_rows := rows.get(key)) is None:
                    beam_rows = rows[key] = [np.zeros(len(value)) for _ in scene.beams]
                i = scene.beams.number_of(beam.name)
                beam_rows[i] = beam_rows[i] + dual_array(value)
    cell_rows = {name: dual_array(beam_rows)[mesh.beam_of_cell] for name, beam_rows in rows.items()}
    return {
        name: array[:, None] if "across" in name else array for name, array in cell_rows.items()
    }


class BeamData:
    """Fields and arrays by their names in forms; `tags` (cells,) are the numbers of materials."""

    def __init__(
        self,
        scene: Scene,
        mesh: Mesh,
        kind: Kind,
        facts: StepFacts,
        numbers: Mapping[str, MaybeDual],
        tags: np.ndarray,
        parameters: ParameterValues,
    ):
        self.mesh, self.tags, self._numbers = mesh, tags, {*numbers}
        self._degree, self._parameters = (degree := kind.degree), parameters
        #: Indices of the parameters in the forms among all, and the number of all.
        self.parameters, self.parameter_count = parameters.indices(facts.names), len(parameters)
        named: dict[str, Any] = {name: np.zeros(()) for name in CONSTANTS}
        named["dt"][...] = named["load_factor"][...] = 1.0
        named["parameters"] = np.zeros(len(facts.names))
        named |= {
            name: Field(mesh.space(values.shape[1], math.prod(values.shape[2:])))
            for name, values in numbers.items()
        }
        if facts.width:
            named["internal"] = Field(mesh.space(degree, facts.width))
        if kind.natural:
            named |= {name: Field(mesh.space(degree, 3)) for name in NATURAL}
        # Weights of forces and of increments of internal variables, and changes of parameters, by
        # which derivatives are taken: they are zero.
        named |= {name: Field(mesh.unknowns, none=True) for name in (*NODAL, "weight 0")}
        if facts.width:
            named["weight 1"] = Field(named["internal"].space)
        if facts.names:
            named["more"] = Field(mesh.space(1, len(facts.names)))
        coordinate = named["coordinate"] = Field(mesh.space(2))
        coordinate.array.reshape(-1, 2)[:] = 0.0, degree
        for i, work in enumerate(scene.virtual_works):
            indicator = named[f"indicator {i}"] = Field(mesh.space(1))
            indicator.array[:] = work.beam is None
            if work.beam is not None:
                cells = mesh.cells[scene.beams.number_of(work.beam.name)]
                indicator.array[cells[slice(*work.elements)]] = True
        #: Fields and arrays by name.
        self.named = named
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in tables.h; None is missing.
        self.moving: list[Any] = [named.get(name) for name in (*NODAL, "internal", *NATURAL)]
        self.set_numbers(numbers)

    def set_numbers(self, numbers: Mapping[str, MaybeDual]) -> None:
        """Set the data (cells, points, ...) of sections and of drag."""
        for name, values in numbers.items():
            self.named[name].array[:] = floats(values).ravel()

    def on(
        self, mesh: Mesh, parameters: ParameterValues, numbers: Mapping[str, MaybeDual]
    ) -> BeamData:
        """The data of another scene with this structure."""
        other = shallow_copy(self)
        other.mesh, other._parameters = mesh, parameters
        other.named = named = dict(self.named)
        for name in (*CONSTANTS, "parameters"):
            named[name] = self.named[name].copy()
        for name in numbers:
            named[name] = Field(self.named[name].space)
        other.set_numbers(numbers)
        return other

    @property
    def spaces(self) -> dict[str, Space]:
        """Spaces of fields, and of numbers by which derivatives are taken, by name."""
        fields = {name: x for name, x in self.named.items() if isinstance(x, Field)}
        spaces = {name: field.space for name, field in fields.items()}
        spaces["coordinates"] = self.mesh.positions
        spaces["resultants"] = self.mesh.space(self._degree, 3)
        if "more" in spaces:
            spaces["parameters"] = spaces["more"]
        return spaces

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Values (cells, width) of what is constant over steps, by name."""
        names = [n for n in self.named if n in self._numbers or n.startswith(("coord", "indic"))]
        return {name: self.named[name].array.reshape(len(self.tags), -1) for name in names}

    def term(self, form: CompiledForm, spaces: Sequence[Space] = ()) -> MeshTerm:
        """A form or an expression on the mesh, with arguments in some spaces."""
        return MeshTerm(form, self.mesh, self.named, spaces, self.tags, self.moving)

    def read(self, steps: StepBatch) -> StepBatch:
        """Steps with the parameters of the forms alone."""
        values = steps.parameters
        if not self.parameters:
            return steps if not values.size else steps._replace(parameters=values[:, :0])
        if not values.size:
            values = floats(self._parameters.at_times(steps.t))
        return steps._replace(parameters=values[:, self.parameters])


def check_shapes(kind: Kind, numbers: Mapping[str, MaybeDual]) -> None:
    """OtherStructureError if data of sections and of drag are of another kind."""
    if kind.data == (shapes := shapes_of(numbers)):
        return
    if [name for name, _ in kind.data] != [name for name, _ in shapes]:
        raise OtherStructureError("beams have other kinds of data")
    raise OtherStructureError("data of beams that were constant vary, or conversely")


def shapes_of(numbers: Mapping[str, MaybeDual]) -> tuple:
    """Numbers of points of data (cells, points, ...), and shapes of values, by name."""
    return tuple([(name, (x.shape[1], x.shape[2:])) for name, x in numbers.items()])
