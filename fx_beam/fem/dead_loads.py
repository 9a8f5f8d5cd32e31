"""The dead loads of a scene as one nodal vector over time."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import ufl

import numpy as np
import scipy.sparse

from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.loads import Load, label
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.validation import Constant, evaluate, series, vector

from . import dolfinx_api
from .beam_forms import BeamForms
from .dolfinx_api import CompiledForm
from .fields import Fields
from .mesh import Mesh
from .section_fields import Data, DataShape, on_beam


class Loads:
    """Nodal vector of all dead loads, F(t) = sum of constant columns times functions of time."""

    def __init__(self, scene: Scene, mesh: Mesh, beams: BeamForms | None):
        self._mesh, self._beams = mesh, beams
        #: Nodal forces of unit components of each load, as a matrix (size, n).
        self.columns = self._read(scene)

    def _read(self, scene: Scene) -> scipy.sparse.csc_matrix:
        self._scene = scene
        self._loads = [load for load in scene.loads if not load.follower]
        #: Degrees of freedom and nodal forces of a unit of each component of each load.
        dofs, forces = [np.empty(0, dtype=int)], [np.empty(0)]
        for load in self._loads:
            if isinstance(load.target, Beam):
                assert self._beams is not None  # the load is on one
                columns = self._line_load(self._beams, load.target, load.along)
                own = [np.flatnonzero(column) for column in columns]
                dofs += own
                forces += [column[at] for column, at in zip(columns, own, strict=True)]
            else:
                at = self._mesh.dofs[load.target.number][
                    slice(2) if load.kind == "force" else slice(2, 3)
                ]
                dofs += list(at[:, None])
                forces += [np.ones(1)] * len(at)
        starts = np.cumsum([len(part) for part in dofs])
        parts = np.concatenate(forces), np.concatenate(dofs), starts
        return scipy.sparse.csc_matrix(parts, (self._mesh.dofs.size, len(dofs) - 1))

    def refill(self, scene: Scene) -> None:
        """Set the loads to those of a scene of the same structure, whose mesh is set.

        OtherStructureError if they act on other degrees of freedom.
        """
        if not any(isinstance(load.target, Beam) for load in self._loads):
            self._loads = [load for load in scene.loads if not load.follower]
            return
        columns = self._read(scene)
        for name in ("indptr", "indices"):
            if not np.array_equal(getattr(columns, name), getattr(self.columns, name)):
                raise OtherStructureError("loads act on other degrees of freedom")
        self.columns = columns

    def _line_load(self, beams: BeamForms, beam: Beam, along: Callable | None) -> np.ndarray:
        """Nodal forces (2, size) of a unit line load along x and y, or (1, size) of one along s."""
        mesh, fields = self._mesh, beams.fields.plain
        if along is None:
            data, directions = on_beam(mesh, self._scene, beam), np.eye(2)
        else:
            values = self._at_gauss_points(beam, along, fields.full_rule)
            data, directions = Data(fields.full_rule, values), np.ones((1, 2))
        compiled, density, direction = _line_load_form(fields, data.shape)
        unit = dolfinx_api.constant(mesh.mesh, np.zeros(2))
        form = beams.bind(compiled, {density: data.on(mesh), direction: unit})
        columns = np.zeros((len(directions), mesh.dofs.size))
        for column, unit.value in zip(columns, directions, strict=True):
            dolfinx_api.assemble_vector(column[: mesh.in_beams], form)
        return columns

    def _at_gauss_points(self, beam: Beam, along: Callable, rule: int) -> np.ndarray:
        """A line load (cells, points, 2) where it is integrated [N/m]."""
        s = arc_lengths(beam, dolfinx_api.gauss_points(rule))
        force = np.zeros((len(self._mesh.beam_of_cell), s.shape[1], 2))
        what = f"line load on {label(beam)}"
        force[self._mesh.cells[self._scene.beams.index(beam)]] = [
            [vector(along(at), 2, f"{what} at s = {at:g}") for at in row] for row in s
        ]
        return force

    @property
    def constant(self) -> bool:
        """Whether all loads are constant in time."""
        return all(isinstance(load.value, Constant) for load in self._loads)

    def at(self, t: float) -> np.ndarray:
        """Nodal forces (size,) [N, N m] at the time t [s]; StepError if a function fails."""
        return self.columns @ np.concatenate(
            [np.empty(0), *(evaluate(load.value, t, str(load)) for load in self._loads)]
        )

    def series(self, times: np.ndarray) -> np.ndarray:
        """Factors (m, n) of the columns at m times [s]; StepError if a function fails."""
        values = [series(load.value, times, str(load)) for load in self._loads]
        return np.hstack([np.empty((len(times), 0)), *values])


def columns_of(load: Load) -> int:
    """Number of columns of a load."""
    return 1 if load.kind == "moment" or load.along is not None else 2


@functools.cache
def _line_load_form(fields: Fields, shape: DataShape) -> tuple[CompiledForm, Any, Any]:
    """Form of a line load: a scalar density times a direction, or a vector.

    Also the symbols of the density and of the direction.
    """
    density, direction = fields.data(shape), fields.data((0, (2,)))
    *_, virtual_u, _ = fields.trial_and_test()
    is_vector = bool(shape[1])
    force = density if is_vector else density * direction
    form = ufl.dot(force, virtual_u) * fields.measure(fields.full_rule)
    return dolfinx_api.compile_form(form, "line load"), density, direction
