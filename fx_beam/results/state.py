"""The system at one time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

#: Forces of a state that are means over the step so far, where the scheme has them at mid-step.
FORCES = "constraint_forces", "joint_forces", "contact_forces"

_Renumbering = Callable[[np.ndarray], np.ndarray]


@dataclass
class Past:
    """The last configurations; the next increment is predicted from them."""

    #: Times (m,) since the configurations before the last one [s], the latest first.
    ages: np.ndarray
    #: Orders of extrapolation, one for each sub-step of the scheme; 0 for no prediction.
    orders: np.ndarray
    #: Divided differences (m, size) of the configurations, from order 1 on.
    differences: np.ndarray
    #: The same (m, joints) for the slides of the joints [m].
    slides: np.ndarray


@dataclass
class State:
    """The system at one time, and what the next step needs from the last one."""

    t: float
    #: Displacements and rotations, rates, accelerations, each (size,).
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    #: Slides of the joints (joints,), and motion of the motors since the start (motors,) [m, rad].
    slides: np.ndarray
    motors: np.ndarray
    #: In the step so far: forces of driven and fixed columns, of the joints on their nodes b
    #: (joints, 3) and of obstacles (contacts, 2); of added virtual works (size,) in its last part
    #: [N, N m].
    constraint_forces: np.ndarray | None = None
    joint_forces: np.ndarray | None = None
    contact_forces: np.ndarray | None = None
    added_forces: np.ndarray | None = None
    #: Work and dissipated energy since the start [J].
    work: float = 0.0
    dissipated: float = 0.0
    #: Part of it that the scheme took, and energy that the scheme holds for the next step [J].
    numerical: float = 0.0
    algorithmic: float = 0.0
    #: The configuration (size,) at the start of the step that ended here, and its length [s]; only
    #: for schemes that need them.
    before: np.ndarray | None = None
    length: float = 0.0
    #: Internal variables (cells, degree, width) at the Gauss points; None without any.
    internal: np.ndarray | None = None
    #: Internal variables (width,) of the springs of joints, in their order; None without any.
    spring_internal: np.ndarray | None = None
    #: Memory of `Halving` (5,): the number of parts of the next steps. Set at the end of a run.
    parts: np.ndarray | None = None
    #: Set at the end of a run: the past, and the values of the inputs in the scene's order.
    past: Past | None = None
    #: Rates of driven motions (driven,) at the end of a `Motion`, whose inputs are not known after.
    driven_rates: np.ndarray | None = None
    inputs: np.ndarray | None = None

    def renumbered(self, change: _Renumbering, change_cells: _Renumbering) -> State:
        """The state in another numbering of degrees of freedom and of cells."""
        added, before = (
            None if vector is None else change(vector)
            for vector in (self.added_forces, self.before)
        )
        past = self.past
        if past is not None and len(past.differences):
            past = replace(past, differences=np.array([change(D) for D in past.differences]))
        q, v, a = (change(vector) for vector in (self.q, self.v, self.a))
        inside = None if self.internal is None else change_cells(self.internal)
        new = replace(self, q=q, v=v, a=a, added_forces=added, before=before, past=past)
        return replace(new, internal=inside)

    def memory(self, length: float) -> float:
        """`Step.memory` of a step of this length [s] from here."""
        return min(1.0, length / self.length) if self.length else 0.0
