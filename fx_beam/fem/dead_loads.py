"""The external dead loads of a scene as one vector in time."""

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

    Parameters
    ----------
    scene : Scene
        Its loads.
    mesh : Mesh
        Numbering of the degrees of freedom.
    line_load : callable
        ``line_load(beam, along)``, the columns (size, 2) of a unit line load, or (size, 1) of one
        that varies along its beam.

    Attributes
    ----------
    columns : (size, n) scipy.sparse.csc_matrix
        Nodal forces of a unit of each component of each load.
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
        self.columns = scipy.sparse.csc_matrix(np.hstack(columns))

    @property
    def constant(self) -> bool:
        """Whether no load changes with time."""
        return all(isinstance(load.value, Constant) for load in self._loads)

    def at(self, t: float) -> np.ndarray:
        """Nodal forces and moments at a time.

        Parameters
        ----------
        t : float
            Time [s].

        Returns
        -------
        (size,) float
            Forces [N] and moments [N m].

        Raises
        ------
        StepError
            If a function of time raises or gives a value that is not finite.
        """
        return self.columns @ np.concatenate(
            [np.empty(0), *(evaluate(load.value, t, str(load)) for load in self._loads)]
        )

    def series(self, times: np.ndarray) -> np.ndarray:
        """Components of the loads at several times.

        Parameters
        ----------
        times : (m,) float
            Times [s].

        Returns
        -------
        (m, n) float
            Factors of the columns [N, N m, N/m].

        Raises
        ------
        StepError
            If a function of time raises or gives a value that is not finite.
        """
        values = [series(load.value, times, str(load)) for load in self._loads]
        return np.hstack([np.empty((len(times), 0)), *values])


def just_inside(t0, t1):
    """Starts and ends of steps as loads see them.

    A load that jumps from one step to the next belongs to the one in which it acts, whichever way
    its function rounds.

    Parameters
    ----------
    t0, t1 : float or (n,) float
        Starts and ends of the steps [s].

    Returns
    -------
    tuple of two of the same
        Times a little later and a little earlier; a step of no length stays as it is.
    """
    inset = np.maximum(1e-12 * (t1 - t0), 4 * np.spacing(t1)) * (t1 != t0)
    return t0 + inset, t1 - inset
