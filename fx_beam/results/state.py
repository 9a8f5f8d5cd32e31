"""The system at one time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np


@dataclass
class Past:
    """The last increments, from which the next one is foretold.

    Parameters
    ----------
    length : float
        Length of the steps, or parts of steps, that they were taken in [s].
    foretelling : int
        How many of the differences would have foretold the last increment best.
    increments : (m, size) float
        Backward differences of the increments, from order 0 on.
    slides : (m, joints) float
        The same of the slides of the joints [m].
    """

    length: float
    foretelling: int
    increments: np.ndarray
    slides: np.ndarray


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
    work, dissipated : float
        Work done since the start [J].
    parts : (5,) float, optional
        What decides in how many parts the next steps are taken, as `Halving` has it; known at the
        end of a run.
    past : Past, optional
        What the next increment is foretold from; known at the end of a run.
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
    dissipated: float = 0.0
    parts: np.ndarray | None = None
    past: Past | None = None

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
        past = self.past
        if past is not None and len(past.increments):
            past = replace(past, increments=np.array([change(D) for D in past.increments]))
        q, v, a = (change(vector) for vector in (self.q, self.v, self.a))
        return replace(self, q=q, v=v, a=a, added=added, past=past)
