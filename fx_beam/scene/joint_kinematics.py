"""Kinematics of joints: gap, angle and rates, from the motion of nodes and beams."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .beam import Beam, Node


class Track:
    """A straight line through the joint's offset, in the frame of a.

    Another joint has another one as its `track`: functions of its `axis` (2, ...) and of the slide,
    analytic in both, and the same as a `Track` of step/c/track.h, with its number there.
    """

    number = 0

    @staticmethod
    def place(axis: Any, slide: Any) -> tuple[Any, Any]:
        """Components of the way from the offset to b [m]."""
        return slide * axis[0], slide * axis[1]

    @staticmethod
    def tangent(axis: Any, slide: Any) -> tuple[Any, Any]:
        """Unit vector of the slide: the derivative of the place."""
        return axis[0] + 0 * slide, axis[1] + 0 * slide

    @staticmethod
    def nearest(axis: Any, x: Any, y: Any) -> Any:
        """Slide of the place that is nearest to a point (x, y), seen from the offset [m]."""
        return x * axis[0] + y * axis[1]


class NodalMotion(NamedTuple):
    """Motion over n rows: "q", displacements and rotations, or "v", their rates."""

    #: Components (3, n) of a node.
    of_node: Callable[[str, Node], np.ndarray]
    #: Those (n, nodes, 3) of the nodes of a beam, those inside its elements included.
    of_beam: Callable[[str, Beam], np.ndarray]


class JointKinematics:
    """A joint whose node b has a place on node a."""

    def __init__(self, joint):
        self.joint = joint

    def place_on_a(self, slide: Any) -> np.ndarray:
        """Components (2, ...) of the place of b in the frame of a, at slides (...) [m]."""
        (x, y), axis = self.joint.offset, self.joint.axis
        if axis is None:
            return np.array([x, y])
        along = self.joint.track.place(axis, slide)
        return np.array([x + along[0], y + along[1]])

    def tangent(self, slide: Any) -> np.ndarray:
        """Unit vectors (2, ...) of the slide in the frame of a; zero without a slide."""
        axis = self.joint.axis
        return np.zeros(2) if axis is None else np.array(self.joint.track.tangent(axis, slide))

    def slide_at(self, x: Any, y: Any) -> Any:
        """Slides (...) at components (...) of the place of b in the frame of a [m]."""
        (offset_x, offset_y), axis = self.joint.offset, self.joint.axis
        return 0.0 if axis is None else self.joint.track.nearest(axis, x - offset_x, y - offset_y)

    def parting(self, at: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From b to its place on a: components x and y (n,) [m]."""
        (X, Y), (x, y, _) = self.joint.apart, self._difference(at, "q")
        arm_x, arm_y = self._turned(at, self.place_on_a(slide))
        return arm_x - X - x, arm_y - Y - y

    def gap(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Distance (n,) of b from its place [m]; zero to round-off."""
        return np.hypot(*self.parting(at, slide))

    def angle(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rotation (n,) of b relative to a, or to its beam where it is, since the start [rad]."""
        return self._difference(at, "q")[2]

    def spin(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the angle [rad/s]."""
        return self._difference(at, "v")[2]

    def rate(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the slide [m/s] if the joint has one, else of the angle [rad/s]."""
        if self.joint.axis is None:
            return self.spin(at, slide)
        x, y, _ = self._difference(at, "v")
        psi, spin = (self._of(at, name, self.joint.a)[2] for name in "qv")
        return axial_rate(self.joint, slide, psi, spin, x, y)

    def parting_rate(self, at: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (2, n) of b as a sees it, and the direction (2, n) of the slide, or zero."""
        x, y, _ = self._difference(at, "v")
        spin = self._of(at, "v", self.joint.a)[2]
        arm_x, arm_y = self._turned(at, self.place_on_a(slide))
        velocity = np.array([x + spin * arm_y, y - spin * arm_x])
        # The ground's does not turn.
        along = np.reshape(self._turned(at, self.tangent(slide)), (2, -1))
        return velocity, np.broadcast_to(along, velocity.shape)

    def slide(self, at: NodalMotion, near: np.ndarray) -> np.ndarray:
        """The slide (n,) [m] in a motion, from one near by; that one for a joint without."""
        if self.joint.axis is None:
            return near
        (X, Y), (x, y, _) = self.joint.apart, self._difference(at, "q")
        psi = self._of(at, "q", self.joint.a)[2]
        c, s = np.cos(psi), np.sin(psi)
        return self.slide_at(c * (X + x) + s * (Y + y), c * (Y + y) - s * (X + x))

    def _of(self, at: NodalMotion, name: str, node: Node) -> Any:
        """Components of a node; zero on the ground."""
        return (0.0, 0.0, 0.0) if node.number < 0 else at.of_node(name, node)

    def _difference(self, at: NodalMotion, name: str) -> list[np.ndarray]:
        """Components (3,) of the motion of b less that of a."""
        a, b = (self._of(at, name, node) for node in (self.joint.a, self.joint.b))
        return [after - before for after, before in zip(b, a, strict=True)]

    def _turned(self, at: NodalMotion, arm) -> tuple[np.ndarray, np.ndarray]:
        """Components of a vector that rotates with a."""
        psi = self._of(at, "q", self.joint.a)[2]
        c, s = np.cos(psi), np.sin(psi)
        return c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]


class SlidingKinematics(JointKinematics):
    """A joint whose node b has a place on a beam."""

    def parting(self, at: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From b to its place on the beam: components x and y (n,) [m]."""
        joint, (x, y, _) = self.joint, at.of_node("q", self.joint.b)
        position = joint.path.over(self._positions(at), slide).T
        return position[0] - joint.b.x - x, position[1] - joint.b.y - y

    def angle(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rotation (n,) of the node relative to the beam where it is, since the start [rad]."""
        of_beam = at.of_beam("q", self.joint.beam)[..., 2]
        return at.of_node("q", self.joint.b)[2] - self.joint.turn(of_beam, slide)

    def spin(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the angle [rad/s]."""
        path, beam = self.joint.path, self.joint.beam
        turning = path.over(at.of_beam("v", beam)[..., 2], slide)
        bend = path.over(at.of_beam("q", beam)[..., 2] + path.angles(), slide, 1)
        return at.of_node("v", self.joint.b)[2] - turning - bend * self.rate(at, slide)

    def rate(self, at: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the arc length [m/s], from the velocities of node and beam."""
        apart, along = self._seen(at, slide)
        return np.sum(apart * along, axis=1) / np.sum(along**2, axis=1)

    def parting_rate(self, at: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (2, n) of the node as the beam sees it, and the direction (2, n) of the beam."""
        apart, along = self._seen(at, slide)
        return apart.T, along.T / np.hypot(*along.T)

    def slide(self, at: NodalMotion, near: np.ndarray) -> np.ndarray:
        """Arc length (n,) nearest to the node [m], from one near by."""
        x, y, _ = at.of_node("q", self.joint.b)
        node = np.column_stack([self.joint.b.x + x, self.joint.b.y + y])
        return self.joint.path.nearest_over(self._positions(at), node, near)

    def _positions(self, at: NodalMotion) -> np.ndarray:
        return at.of_beam("q", self.joint.beam)[..., :2] + self.joint.path.X

    def _seen(self, at: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (n, 2) of the node less that of the beam where it is, and the slope there."""
        path = self.joint.path
        of_beam = path.over(at.of_beam("v", self.joint.beam)[..., :2], slide)
        apart = np.column_stack([*at.of_node("v", self.joint.b)[:2]]) - of_beam
        return apart, path.over(self._positions(at), slide, 1)


def axial_rate(joint, slide, psi, spin, x, y):
    """Rate of a slide [m/s], for rotation and spin of a and the velocity (x, y) of b less a's."""
    place, along = joint.track.place(joint.axis, slide), joint.track.tangent(joint.axis, slide)
    c, s = np.cos(psi), np.sin(psi)
    # The velocity of b relative to its position on a, in the frame of a.
    seen_x = c * x + s * y + spin * (joint.offset[1] + place[1])
    seen_y = c * y - s * x - spin * (joint.offset[0] + place[0])
    return seen_x * along[0] + seen_y * along[1]
