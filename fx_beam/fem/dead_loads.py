"""The dead loads of a scene as one nodal vector over time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.loads import Load, label
from fx_beam.scene.place_functions import PlaceTimeFunction
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.validation import Constant, TimeFunction, evaluate, series, vector

from . import dolfinx_api
from .line_forces import line_forces
from .mesh import Mesh


class Loads:
    """Nodal vector of all dead loads, F(t) = sum of constant columns times functions of time."""

    def __init__(self, scene: Scene, mesh: Mesh):
        self._mesh = mesh
        #: Nodal forces of unit components of each load, as a matrix (size, n).
        parts = self._read(scene)
        self.columns = scipy.sparse.csc_matrix(parts, (mesh.dofs.size, len(parts[2]) - 1))

    def _read(self, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, rows and starts of the columns."""
        self._loads = [load for load in scene.loads if not load.follower]
        #: Functions of time of the columns, each with what it is of.
        self._functions: list[tuple[TimeFunction, str]] = []
        forces, dofs, counts = [np.empty(0)], [np.empty(0, dtype=int)], [np.zeros(1, dtype=int)]
        for load in self._loads:
            if isinstance(load.target, Beam):
                function, unit = self._line_load(scene, load, load.target)
                parts = unit.data, unit.indices, np.diff(unit.indptr)
            else:
                at = self._mesh.dofs[load.target.number]
                function, own = load.value, at[:2] if load.kind == "force" else at[2:]
                ones = np.ones(len(own))
                parts = ones, own, ones.astype(int)
            self._functions.append((function, str(load)))
            for of_all, part in zip((forces, dofs, counts), parts, strict=True):
                of_all.append(part)
        return np.concatenate(forces), np.concatenate(dofs), np.cumsum(np.concatenate(counts))

    def refill(self, scene: Scene) -> None:
        """Set the loads to those of a scene of the same structure, whose mesh is set.

        OtherStructureError if they act on other degrees of freedom.
        """
        if not self._loads and not scene.loads:
            return
        forces, dofs, starts = self._read(scene)
        own = self.columns
        if not (np.array_equal(dofs, own.indices) and np.array_equal(starts, own.indptr)):
            raise OtherStructureError("loads act on other degrees of freedom")
        own.data = forces

    def _line_load(
        self, scene: Scene, load: Load, beam: Beam
    ) -> tuple[TimeFunction, scipy.sparse.csc_matrix]:
        """The function of time of a line load, and nodal forces (size, n) of its unit components.

        These are loads at the Gauss points of the rule that integrates the interpolation exactly.
        """
        rule = beam.degree + 1
        unit = line_forces(self._mesh, scene.beams.index(beam), rule)
        places = arc_lengths(beam, dolfinx_api.gauss_points(rule)).ravel()
        if isinstance(load.value, PlaceTimeFunction):
            return load.value.over(places), unit
        if load.along is None:
            each = np.tile(np.eye(2), (len(places), 1))
        else:
            each = _along(load, load.along, places)[:, None]
        return load.value, scipy.sparse.csc_matrix(unit @ each)

    @property
    def constant(self) -> bool:
        """Whether all loads are constant in time."""
        return all(isinstance(load.value, Constant) for load in self._loads)

    def at(self, t: float) -> np.ndarray:
        """Nodal forces (size,) [N, N m] at the time t [s]; StepError if a function fails."""
        if not self._functions:
            return np.zeros(self.columns.shape[0])
        return self.columns @ np.concatenate(
            [np.empty(0), *(evaluate(function, t, what) for function, what in self._functions)]
        )

    def series(self, times: np.ndarray) -> np.ndarray:
        """Factors (m, n) of the columns at m times [s]; StepError if a function fails."""
        values = [series(function, times, what) for function, what in self._functions]
        return np.hstack([np.empty((len(times), 0)), *values])


def columns_of(load: Load) -> int:
    """Number of columns of a load."""
    if isinstance(load.target, Beam) and isinstance(load.value, PlaceTimeFunction):
        return 2 * load.target.elements * (load.target.degree + 1)
    return 1 if load.kind == "moment" or load.along is not None else 2


def _along(load: Load, along: Callable[[float], np.ndarray], places: np.ndarray) -> np.ndarray:
    """A line load (2 n,) at n arc lengths [N/m]."""
    what = f"line load on {label(load.target)}"
    return np.concatenate([vector(along(s), 2, f"{what} at s = {s:g}") for s in places.tolist()])
