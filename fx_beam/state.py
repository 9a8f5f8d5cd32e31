"""The system at one time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np


@dataclass
class State:
    """The system at one time, and what the next step needs of the last one.

    Parameters
    ----------
    t : float
        Time [s].
    q, v, a : (size,) float
        Displacements and rotations, rates and accelerations.
    slides : (joints,) float
        Slides of the joints [m].
    motors : (motors,) float
        What the motors have moved since the start [m, rad].
    held, added : float array or None
        Generalised forces of driven and fixed columns, and forces (size,) of the added virtual
        works, in the step that ended here.
    joint_forces : (joints, 3) float
        Forces and moments of the joints on their nodes b in that step [N, N m].
    work : float
        Work done since the start [J].
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    slides: np.ndarray
    motors: np.ndarray
    held: np.ndarray | None = None
    added: np.ndarray | None = None
    joint_forces: np.ndarray | None = None
    work: float = 0.0

    def renumbered(self, change: Callable[[np.ndarray], np.ndarray]) -> State:
        """The same in another numbering.

        Parameters
        ----------
        change : callable
            Gives a vector over all degrees of freedom in that numbering.

        Returns
        -------
        State
            The state, with its vectors changed.
        """
        added = None if self.added is None else change(self.added)
        return replace(self, q=change(self.q), v=change(self.v), a=change(self.a), added=added)
