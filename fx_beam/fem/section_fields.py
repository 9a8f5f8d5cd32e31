"""Data of the sections for the forms: one constant, or values at Gauss points of every cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.scene import Scene

from . import dolfinx_api
from .mesh import Mesh

#: What a form must know of its data: number of Gauss points (0: constant) and shape of a value.
Place = tuple[int, tuple[int, ...]]


class Data(NamedTuple):
    """Data of all beams: one value, or values (cells, points, ...) at the Gauss points."""

    points: int
    values: np.ndarray

    @property
    def place(self) -> Place:
        """What a form must know of the data."""
        return self.points, self.values.shape[2 if self.points else 0 :]

    def on(self, mesh: Mesh):
        """dolfinx's constant or function with the data."""
        if not self.points:
            return dolfinx_api.constant(mesh.mesh, self.values)
        return dolfinx_api.at_gauss_points(mesh.mesh, self.values)


def section_data(mesh: Mesh, scene: Scene, names: tuple[str, ...], points: int) -> Data:
    """Section data, a vector or a scalar: one constant, cell by cell, or along the beams.

    Data that vary are evaluated at so many Gauss points. The SceneError for an invalid value names
    its beam and its fraction.
    """
    varies = any(beam.section.varies(name) for beam in scene.beams for name in names)
    gauss = dolfinx_api.gauss_points(points)
    values: list[np.ndarray] = []
    known: dict[int, np.ndarray] = {}
    for beam in scene.beams:
        # Constant data need one value, which other beams of the same section share.
        if not varies and id(beam.section) in known:
            values.append(known[id(beam.section)])
            continue
        fractions = arc_lengths(beam, gauss) / beam.length if varies else np.array([[0.5]])
        try:
            own = [beam.section.values(name, fractions) for name in names]
        except SceneError as error:
            raise SceneError(f"beam {beam.name!r}: {error}") from None
        values.append(np.stack(own, axis=-1) if len(names) > 1 else own[0])
        known[id(beam.section)] = values[-1]
    if not varies:
        return cell_data(mesh, np.concatenate(values)[:, 0])
    of_cell = np.empty((len(mesh.beam_of_cell), *values[0].shape[1:]))
    for cells, of_beam in zip(mesh.cells, values, strict=True):
        of_cell[cells] = of_beam
    return Data(points, of_cell)


def cell_data(mesh: Mesh, rows: np.ndarray) -> Data:
    """Data (beams, ...): one constant if all beams have the same, else cell by cell."""
    if (rows == rows[0]).all():
        return Data(0, rows[0])
    return Data(1, rows[mesh.beam_of_cell][:, None])


def on_beam(mesh: Mesh, scene: Scene, beam: Beam) -> Data:
    """Indicator of a beam: 1 on it, 0 on the others."""
    inside = np.arange(len(scene.beams)) == scene.beams.index(beam)
    return cell_data(mesh, inside.astype(float))
