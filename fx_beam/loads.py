"""The external dead loads of a scene as one vector in time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .beam import Beam
from .mesh import Mesh
from .scene import Scene
from .values import Constant, evaluate


class Loads:
    """Nodal vector of all dead loads, F(t) = sum of constant columns times f(t).

    Parameters
    ----------
    scene : Scene
        Its loads.
    mesh : Mesh
        Numbering of the degrees of freedom.
    line_load : callable
        ``line_load(beam)``, the columns (size, 2) of a unit line load.
    """

    def __init__(self, scene: Scene, mesh: Mesh, line_load: Callable[..., np.ndarray]):
        self._loads = [load for load in scene.loads if not load.follower]
        self._zero = np.zeros(mesh.dofs.size)
        columns = []
        for load in self._loads:
            if isinstance(load.target, Beam):
                columns.append(line_load(load.target))
                continue
            dofs = mesh.dofs[load.target.number]
            dofs = dofs[:2] if load.kind == "force" else dofs[2:]
            unit = np.zeros((mesh.dofs.size, len(dofs)))
            unit[dofs, range(len(dofs))] = 1.0
            columns.append(unit)
        self._columns = np.hstack(columns) if columns else None

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
        if self._columns is None:
            return self._zero
        return self._columns @ np.concatenate(
            [evaluate(load.value, t, str(load)) for load in self._loads]
        )


def just_inside(t0: float, t1: float) -> tuple[float, float]:
    """Start and end of a step as loads see them.

    A load that jumps from one step to the next belongs to the one in which it acts, whichever way
    its function rounds.

    Parameters
    ----------
    t0, t1 : float
        Start and end of the step [s].

    Returns
    -------
    tuple of float
        Times a little later and a little earlier; a step of no length stays as it is.
    """
    if t0 == t1:
        return t0, t1
    inset = max(1e-12 * (t1 - t0), 4 * np.spacing(t1))
    return t0 + inset, t1 - inset
