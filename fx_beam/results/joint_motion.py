"""What a joint does over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND, Joint


@dataclass(frozen=True, repr=False)
class JointMotion:
    """Coordinates, rates and forces of a joint over time; made by `Solution.joint`.

    Parameters
    ----------
    solution : Solution
        The solution.
    joint : Joint
        One of its joints.
    """

    solution: Any
    joint: Joint

    def __repr__(self):
        return f"<{self.joint} over {len(self.solution.t)} rows>"

    @property
    def angle(self) -> np.ndarray:
        """Rotation psi_b - psi_a of b relative to a since the reference configuration [rad]."""
        return self._of(self.joint.b, "q", 2) - self._of(self.joint.a, "q", 2)

    @property
    def slide(self) -> np.ndarray:
        """Distance (n,) along the axis from the joint's place on a to b [m]."""
        self._check(self.joint.axis is not None, "slide")
        return self.solution.slides[:, self.joint.number]

    @property
    def spin(self) -> np.ndarray:
        """Rate (n,) of the angle [rad/s]; at nodes without rotary inertia its mean over a step."""
        return self._of(self.joint.b, "v", 2) - self._of(self.joint.a, "v", 2)

    @property
    def rate(self) -> np.ndarray:
        """Rate (n,) of the slide [m/s] where the joint slides, else of the angle [rad/s]."""
        joint = self.joint
        if joint.axis is None:
            return self.spin
        # Along the axis: the velocity of b less that of its place on a, seen from a.
        x, y = (self._of(joint.b, "v", i) - self._of(joint.a, "v", i) for i in (0, 1))
        psi, spin = (self._of(joint.a, name, 2) for name in "qv")
        arm = joint.offset + self.slide[:, None] * joint.axis
        c, s = np.cos(psi), np.sin(psi)
        along = (c * x + s * y + spin * arm[:, 1]) * joint.axis[0]
        return along + (c * y - s * x - spin * arm[:, 0]) * joint.axis[1]

    @property
    def force(self) -> np.ndarray:
        """Force [N] and moment [N m] (n, 3) of the joint on its node b, at `Solution.t_level`."""
        return self.solution.joint_force(self.joint)

    @property
    def motor_force(self) -> np.ndarray:
        """Force [N] of the motor along the slide, or its moment [N m] on b, at `t_level`, (n,)."""
        driven = [part for part in (self.joint.slide, self.joint.rotation) if part and part.motor]
        self._check(bool(driven), "motor")
        forces = self.solution.recorded("motor_forces")
        return forces[:, self.joint.number]

    @property
    def motor_power(self) -> np.ndarray:
        """Mean power (n,) of the motor over the step that ends at t[k] [W]; 0 in row 0.

        Its sum over the steps, each times its length, is the motor's work: exactly for a slide,
        and to second order in the step for a rotation. In a step that was taken in parts the force
        is that of the last one. Needs a row for every step.
        """
        solution, force = self.solution, self.motor_force
        if len(solution.t) != solution.stats.steps + 1:
            raise ValueError("motor_power needs every step; simulate with record=Record(every=1)")
        slide = self.joint.slide
        place = self.slide if slide is not None and slide.motor else self.angle
        # The force in the middle of the step, from those at the scheme's level.
        before = np.concatenate([force[:2], force[1:-1]])[: len(force)]
        middle = force + (0.5 - solution.stats.level) * (force - before)
        power = np.zeros(len(force))
        power[1:] = middle[1:] * np.diff(place) / np.diff(solution.t)
        return power

    @property
    def gap(self) -> np.ndarray:
        """Distance (n,) of b from its place on a [m]; zero to rounding."""
        joint, X, q = self.joint, self.solution.X, self.solution.recorded("q")
        arm = np.broadcast_to(joint.offset, (len(q), 2))
        if joint.axis is not None:
            arm = arm + self.slide[:, None] * joint.axis
        psi = self._of(joint.a, "q", 2)
        c, s = np.cos(psi), np.sin(psi)
        place = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
        for node, sign in ((joint.a, 1), (joint.b, -1)):
            if node is not GROUND:
                place += sign * (X[node.number] + q[:, node.number, :2])
        if GROUND in (joint.a, joint.b):
            place -= place[0]
        return np.hypot(*place.T)

    def _of(self, node: Node, name: str, component: int) -> np.ndarray:
        """History (n,) of one component of a node; zero on the ground."""
        values = self.solution.recorded(name)
        return np.zeros(len(values)) if node is GROUND else values[:, node.number, component]

    def _check(self, there: bool, what: str) -> None:
        if not there:
            raise ValueError(f"{self.joint} has no {what}")
