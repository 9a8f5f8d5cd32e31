"""Coordinates, rates and forces of a joint over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import is_one_of, shown
from fx_beam.scene.joint_kinematics import NodalMotion
from fx_beam.scene.joints import Joint


@dataclass(frozen=True, repr=False)
class JointMotion:
    """Coordinates, rates and forces of a joint over time; created by `Solution.joint`.

    Parameters
    ----------
    solution : Solution
        The solution.
    joint : Joint
        One of its joints.

    Examples
    --------
    A bar that a motor pushes along a guide.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=2.0))
    >>> guide = fb.Prismatic(fb.GROUND, bar.start, axis=(0, 1), motor=lambda t: 3 * t**2)
    >>> guide = scene.add_joint(guide)
    >>> motion = fb.simulate(scene, dt=0.1, t_end=0.5).joint(guide)
    >>> round(float(motion.slide[-1]), 6), bool(motion.gap.max() < 1e-12)
    (0.75, True)
    """

    solution: Any
    joint: Joint

    def __repr__(self):
        return f"<{self.joint} over {len(self.solution.t)} rows>"

    @property
    def angle(self) -> np.ndarray:
        """Rotation psi_b - psi_a of b relative to a since the reference configuration [rad].

        Of a node that slides on a beam: relative to the beam where it is.
        """
        return self.joint.kinematics.angle(*self._motion)

    @property
    def slide(self) -> np.ndarray:
        """Distance (n,) along the axis from the joint's position on a to b [m].

        Of a node that slides on a beam: its arc length from the start of the beam.
        """
        self._check(self.joint.slide is not None, "slide")
        return self.solution.slides[:, self.joint.number]

    @property
    def spin(self) -> np.ndarray:
        """Rate (n,) of the angle [rad/s].

        At nodes without rotary inertia that move freely it is a mean over a step.
        """
        return self.joint.kinematics.spin(*self._motion)

    @property
    def rate(self) -> np.ndarray:
        """Rate (n,) of the slide [m/s] if the joint has one, else of the angle [rad/s]."""
        return self.joint.kinematics.rate(*self._motion)

    @property
    def force(self) -> np.ndarray:
        """Force [N] and moment [N m] (n, 3) of the joint on its node b, at `Solution.t_level`.

        Springs, dampers and motors are included.
        """
        return self.solution.recorded("joint_forces")[:, self.joint.number]

    @property
    def motor_force(self) -> np.ndarray:
        """Force (n,) [N] of the motor or lock, or its moment [N m] on b, at `t_level`."""
        forces = self.solution.recorded("motor_forces")[:, self.joint.number]
        self._check(bool(self.joint.driven or forces.any()), "motor")  # a latch may have locked it
        return forces

    @property
    def motor_power(self) -> np.ndarray:
        """Mean power (n,) of the motor over the step that ends at t[k] [W]; 0 in row 0.

        The sum of power times step length is the motor's work, to second order in the step. The
        work in `Solution.energy` is exact. A row for every step is required.
        """
        solution, force = self.solution, self.motor_force
        if len(solution.t) != solution.stats.steps + 1:
            raise ValueError("motor_power needs every step; simulate with record=Record(every=1)")
        place = self.slide if "slide" in self.joint.driven else self.angle
        # The force in the middle of the step, interpolated from those at the scheme's level.
        before = np.concatenate([force[:2], force[1:-1]])[: len(force)]
        middle = force + (0.5 - solution.stats.level) * (force - before)
        power = np.zeros(len(force))
        power[1:] = middle[1:] * np.diff(place) / np.diff(solution.t)
        return power

    def internal(self, variable: str) -> np.ndarray:
        """An internal variable of the joint's springs over time.

        Parameters
        ----------
        variable : str
            Name of one of the `InternalVariables` of a spring on the slide or the rotation.

        Returns
        -------
        (n,) float
            Its values at the times t.

        Raises
        ------
        ValueError
            If the motion was not recorded, or the joint has no such variable.
        """
        self.solution.recorded("q")  # internal variables are recorded with the motion
        known = self.solution.variables_of_joint.get(self.joint.number, {})
        if not is_one_of(variable, known):
            raise ValueError(
                f"{self.joint} has no internal variable {shown(variable)}; it has {list(known)}"
            )
        return known[variable]

    @property
    def gap(self) -> np.ndarray:
        """Distance (n,) of b from its position on a, or on its beam [m]; zero to round-off."""
        return self.joint.kinematics.gap(*self._motion)

    @property
    def _motion(self) -> tuple[NodalMotion, np.ndarray]:
        """Motion of the nodes, and the slide (n,)."""
        return motion_of(self.solution), self.solution.slides[:, self.joint.number]

    def _check(self, there: bool, what: str) -> None:
        if not there:
            raise ValueError(f"{self.joint} has no {what}")


def motion_of(solution: Any) -> NodalMotion:
    """Motion of the nodes and beams of a solution."""
    return NodalMotion(
        lambda name, node: solution.recorded(name)[:, node.number].T,
        lambda name, beam: solution.recorded(name)[:, solution.nodes_of_beam[beam.name]],
    )
