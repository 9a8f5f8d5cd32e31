"""Data of the sections for the forms: one constant, or values at Gauss points of every cell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section
from fx_beam.scene.structure import OtherStructureError
from fx_beam.validation import all_of

from . import dolfinx_api
from .mesh import Mesh

#: What a form must know of its data: number of Gauss points (0: constant) and shape of a value.
DataShape = tuple[int, tuple[int, ...]]


class Data(NamedTuple):
    """Data of all beams: one value, or values (cells, points, ...) at the Gauss points."""

    points: int
    values: np.ndarray

    @property
    def shape(self) -> DataShape:
        """What a form must know of the data."""
        return self.points, self.values.shape[2 if self.points else 0 :]

    def by_cells(self, cells: int) -> Data:
        """The same data as values of each cell."""
        if self.points:
            return self
        return Data(1, np.broadcast_to(self.values, (cells, 1, *self.values.shape)))

    def on(self, mesh: Mesh):
        """dolfinx's constant or function with the data."""
        if not self.points:
            return dolfinx_api.constant(mesh.mesh, self.values)
        return dolfinx_api.at_gauss_points(mesh.mesh, self.values)


class FilledField:
    """dolfinx's constant or function with data; others of the same shape may replace them."""

    def __init__(self, data: Data, mesh: Mesh):
        self.data, self.on_mesh = data, data.on(mesh)
        # Reading it from dolfinx takes longer than all else in `refill`.
        self._constant = None if data.points else self.on_mesh.value

    def refill(self, data: Data) -> bool:
        """Set the data, and whether they differ; OtherStructureError if they have another shape."""
        known = self.data
        if data.points != known.points or data.values.shape != known.values.shape:
            raise OtherStructureError("data of beams that were equal differ, or conversely")
        if all_of(data.values == known.values):
            return False
        self.data = data
        if self._constant is None:
            dolfinx_api.set_at_gauss_points(self.on_mesh, data.values)
        else:
            self._constant[...] = data.values
        return True


def refill(fields: Mapping[str, FilledField], data: Mapping[str, Data]) -> list[str]:
    """Set the data of some fields by name; the names of those that differ.

    OtherStructureError if there are others.
    """
    if list(fields) != list(data):
        raise OtherStructureError("beams have other kinds of data")
    return [name for name, field in fields.items() if field.refill(data[name])]


def section_data(mesh: Mesh, scene: Scene, names: tuple[str, ...], points: int) -> Data:
    """Section data, a vector or a scalar: one constant, cell by cell, or along the beams.

    Data that vary are evaluated at so many Gauss points. The SceneError for an invalid value names
    its beam and its fraction.
    """
    sections = [beam.section for beam in scene.beams]
    constants = {id(section): section.constants(names) for section in distinct(sections)}
    if None not in constants.values():
        if len(constants) == 1:
            return Data(0, np.array(*constants.values()))
        return cell_data(mesh, np.array([constants[id(section)] for section in sections]))
    gauss = dolfinx_api.gauss_points(points)
    values: list[np.ndarray] = []
    for beam in scene.beams:
        fractions = arc_lengths(beam, gauss) / beam.length
        try:
            own = [beam.section.values(name, fractions) for name in names]
        except SceneError as error:
            raise SceneError(f"beam {beam.name!r}: {error}") from None
        values.append(np.stack(own, axis=-1) if len(names) > 1 else own[0])
    of_cell = np.empty((len(mesh.beam_of_cell), *values[0].shape[1:]))
    for cells, rows in zip(mesh.cells, values, strict=True):
        of_cell[cells] = rows
    return Data(points, of_cell)


def distinct(sections: Iterable[Section]) -> list[Section]:
    """Each section once: beams of a frame share a few."""
    return list({id(section): section for section in sections}.values())


def cell_data(mesh: Mesh, rows: np.ndarray) -> Data:
    """Data (beams, ...): one constant if all beams have the same, else cell by cell."""
    if (rows == rows[0]).all():
        return Data(0, rows[0])
    return Data(1, rows[mesh.beam_of_cell][:, None])


def on_beam(mesh: Mesh, scene: Scene, beam: Beam) -> Data:
    """Indicator of a beam: 1 on it, 0 on the others."""
    inside = np.arange(len(scene.beams)) == scene.beams.index(beam)
    return cell_data(mesh, inside.astype(float))
