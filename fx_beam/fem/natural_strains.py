"""The natural strains of a scene at all Gauss points over time."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.scene.beam import arc_lengths
from fx_beam.scene.natural_strains import NAMES, NaturalStrain, StrainPart
from fx_beam.scene.place_functions import PlaceTimeFunction
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.validation import Constant, TimeFunction, evaluate, series, vector

from . import dolfinx_api
from .mesh import Mesh


class NaturalStrains:
    """Natural strains, E*(t) = sum of constant columns times functions of time."""

    def __init__(self, scene: Scene, mesh: Mesh):
        self._mesh = mesh
        degree = scene.beams[0].degree if scene.beams else 1
        #: Shape (cells, degree, 3) of the strains at the Gauss points.
        self.shape = len(mesh.beam_of_cell), degree, 3
        #: Strains of unit components, as a matrix (size, n).
        parts = self._read(scene)
        self.columns = scipy.sparse.csc_matrix(parts, (self.size, len(parts[2]) - 1))

    def _read(self, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, rows and starts of the columns."""
        self._strains = [*scene.natural_strains]
        #: Functions of time of the columns, each with what it is of.
        self._functions: list[tuple[TimeFunction, str]] = []
        values, rows, counts = [np.empty(0)], [np.empty(0, dtype=int)], [np.zeros(1, dtype=int)]
        for strain in self._strains:
            for name, part in strain.parts.items():
                own, at, count = self._columns(scene, strain, name, part)
                values.append(own)
                rows.append(at)
                counts.append(count)
        columns = np.cumsum([len(count) for count in counts]) - 1
        self._first: list[int] = columns[:-1].tolist()
        return np.concatenate(values), np.concatenate(rows), np.cumsum(np.concatenate(counts))

    def _columns(
        self, scene: Scene, strain: NaturalStrain, name: str, part: StrainPart
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, rows and lengths of the columns of a component, whose function is added."""
        beam, (_, degree, _) = strain.beam, self.shape
        cells = self._mesh.cells[scene.beams.index(beam)]
        points = degree * cells[:, None] + np.arange(degree)
        rows = 3 * points.ravel() + [*NAMES].index(name)
        places = (arc_lengths(beam, dolfinx_api.gauss_points(degree)) / beam.length).ravel()
        values, count = np.ones(len(rows)), np.array([len(rows)])
        what, function = f"{NAMES[name]} of beam {beam.name!r}", part.value
        if isinstance(function, PlaceTimeFunction):
            function, count = function.over(places), np.ones(len(rows), dtype=int)
        elif part.along is not None:
            along = [vector(part.along(f), 1, f"{what} at f = {f:g}") for f in places.tolist()]
            values = np.concatenate(along)
        self._functions.append((function, what))
        return values, rows, count

    def refill(self, scene: Scene) -> None:
        """Set the strains to those of a scene of the same structure."""
        if not self._strains and not scene.natural_strains:
            return
        values, rows, starts = self._read(scene)
        own = self.columns
        if not (np.array_equal(rows, own.indices) and np.array_equal(starts, own.indptr)):
            raise OtherStructureError("natural strains are of another kind")
        own.data = values

    def __bool__(self):
        return bool(self._strains)

    @property
    def size(self) -> int:
        """Number of strains at all Gauss points."""
        return int(np.prod(self.shape))

    @property
    def constant(self) -> bool:
        """Whether all strains are constant in time."""
        return all(isinstance(function, Constant) for function, _ in self._functions)

    @property
    def functions(self) -> list[tuple[int, TimeFunction]]:
        """The functions of time, each with the number of its first column."""
        return list(zip(self._first, (function for function, _ in self._functions), strict=True))

    def at(self, t: float) -> np.ndarray:
        """Strains (cells, degree, 3) at the time t [s]; StepError if a function fails."""
        values = [evaluate(function, t, what) for function, what in self._functions]
        return (self.columns @ np.concatenate([np.empty(0), *values])).reshape(self.shape)

    def series(self, times: np.ndarray) -> np.ndarray:
        """Factors (m, n) of the columns at m times [s]; StepError if a function fails."""
        values = [series(function, times, what) for function, what in self._functions]
        return np.hstack([np.empty((len(times), 0)), *values])
