"""The dead loads of a scene as one nodal vector over time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from fx_beam.scene.beam import Beam
from fx_beam.scene.scene import Scene
from fx_beam.validation import Constant, evaluate, series

from .mesh import Mesh


class Loads:
    """Nodal vector of all dead loads, F(t) = sum of constant columns times functions of time.

    ``line_load(beam, along)`` gives the columns (size, 2) of a unit line load, or (size, 1) of one
    that varies along its beam.
    """

    def __init__(self, scene: Scene, mesh: Mesh, line_load: Callable[..., np.ndarray]):
        self._loads = [load for load in scene.loads if not load.follower]
        columns = [np.zeros((mesh.dofs.size, 0))]
        for load in self._loads:
            if isinstance(load.target, Beam):
                columns.append(line_load(load.target, load.along))
                continue
            dofs = mesh.dofs[load.target.number]
            dofs = dofs[:2] if load.kind == "force" else dofs[2:]
            unit = np.zeros((mesh.dofs.size, len(dofs)))
            unit[dofs, range(len(dofs))] = 1.0
            columns.append(unit)
        #: Nodal forces (size, n) of a unit of each component of each load.
        self.columns = scipy.sparse.csc_matrix(np.hstack(columns))

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


def just_inside(t0, t1):
    """Starts and ends of steps, moved inwards by round-off: times at which loads are evaluated.

    A load that jumps between two steps then counts in the correct step, despite round-off. Steps of
    zero length are not changed.
    """
    inset = np.maximum(1e-12 * (t1 - t0), 4 * np.spacing(t1)) * (t1 != t0)
    return t0 + inset, t1 - inset
