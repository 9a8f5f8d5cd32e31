"""Joints of a node that slides along a flexible beam."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import SceneError, as_float, require

from .beam import Beam, Node
from .beam_axis import BeamAxis, axis_of
from .coordinate import Coordinate, Damper, Friction, Spring, Stop, checked_coordinate
from .joints import GROUND, Joint, JointKinematics, NodalMotion, new_joint


@dataclass(frozen=True, eq=False)
class SlidingJoint(Joint):
    """Node b on the axis of a beam; created by `Slider` and `Sleeve`.

    Its slide is the arc length from the start of the beam [m].
    """

    beam: Beam = None  # type: ignore[assignment]
    fraction: float | None = None

    def __str__(self):
        number = "" if self.number < 0 else f"joint {self.number}, "
        return f"{number}{self.kind} of {self.b} on beam {self.beam.name!r}"

    @property
    def is_selection(self) -> bool:
        """False: the displacement of b depends on several nodes."""
        return False

    @property
    def carried(self) -> list[tuple[str, int, int]]:
        """Keys of the components of b that depend on the beam: "carried", node, component."""
        return [("carried", self.b.number, i) for i in range(3 if self.turns_together else 2)]

    @property
    def kinematics(self) -> SlidingKinematics:
        """Gap, angle and rates of the joint, from the motion of the beam and the node."""
        return SlidingKinematics(self)

    @property
    def path(self) -> BeamAxis:
        """The axis of the beam."""
        return axis_of(self.beam)

    def start(self) -> tuple[float, float]:
        """Arc length at the start, and distance of the node from the beam there [m]."""
        return self._start

    @cached_property
    def _start(self) -> tuple[float, float]:
        position = np.array([self.b.x, self.b.y])
        if self.fraction is None:
            return self.path.cubics.nearest(position)
        s = self.fraction * self.path.length
        return s, float(np.hypot(*(self.path.position(s) - position)))

    @property
    def arm(self) -> np.ndarray:
        """From the start of the beam to the node, in the reference configuration (2,) [m]."""
        return np.array([self.b.x - self.a.x, self.b.y - self.a.y])

    @property
    def direction(self) -> np.ndarray:
        """Unit tangent of the beam at the node, in the reference configuration (2,)."""
        tangent = self.path.position(self.start()[0], 1)
        return tangent / np.hypot(*tangent)

    def turn(self, psi: np.ndarray, s: np.ndarray | float) -> np.ndarray:
        """Rotation (n,) of a sleeve at arc lengths s (n,), for rotations psi (n, nodes) [rad]."""
        path = self.path
        return path.over(psi + path.angles, np.atleast_1d(s)) - self.place_at_rest[2]

    @property
    def place_at_rest(self) -> np.ndarray:
        """Reference position of the node [m], and angle of the beam there (3,)."""
        angle = self.path.over(self.path.angles[None], np.array([self.start()[0]]))
        return np.array([self.b.x, self.b.y, angle[0]])

    def place_of_guide(self) -> tuple[float, float]:
        """Position of a guide [m]: of b, or for a guide on the ground at the fraction."""
        if self.b is not GROUND or self.fraction is None:
            return self.b.x, self.b.y
        x, y = self.path.position(self.fraction * self.path.length)
        return float(x), float(y)


class SlidingKinematics(JointKinematics):
    """A joint whose node b has a place on a beam."""

    def _misplaced(self, gap: float) -> str:
        """Error in the place of a node that is not on the beam."""
        joint, path = self.joint, self.joint.path
        s, least = path.cubics.nearest(np.array([joint.b.x, joint.b.y]))
        x, y = path.position(s)
        place = hint = distance_text = ""
        if joint.fraction is not None:
            place, distance_text = f" at the fraction {joint.fraction:g}", f", {least:.4g} away"
        if joint.beam.inner is not None:
            hint = (
                ". On a curve the axis is that of the elements, which is near the curve, and "
                "nearer with more elements or a higher degree"
            )
        return (
            f"the node is not on the axis of the beam{place}, but {gap:.4g} away{hint}. The "
            f"nearest point of the axis is ({x:.12g}, {y:.12g}), at the fraction "
            f"{s / path.length:.6g} of its length{distance_text}. Move the node there"
        )

    def check_start(self, size: float) -> None:
        """Refuse what no joint may have, and corners under a sleeve."""
        super().check_start(size)
        joint = self.joint
        if joint.turns_together and joint.path.corners.any():
            raise SceneError(
                f"{joint}: the beam has corners, at which the rotation of a sleeve would jump. Use "
                "an fx_beam.spline or arc for the beam, or a Slider"
            )

    def parting(self, motion: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From b to its place on the beam: components x and y (n,) [m]."""
        joint, (x, y, _) = self.joint, motion.node("q", self.joint.b)
        position = joint.path.over(self._positions(motion), slide).T
        return position[0] - joint.b.x - x, position[1] - joint.b.y - y

    def angle(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rotation (n,) of the node relative to the beam where it is, since the start [rad]."""
        rotations = motion.beam("q", self.joint.beam)[..., 2]
        return motion.node("q", self.joint.b)[2] - self.joint.turn(rotations, slide)

    def spin(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the angle [rad/s]."""
        path, beam = self.joint.path, self.joint.beam
        turning = path.over(motion.beam("v", beam)[..., 2], slide)
        bend = path.over(motion.beam("q", beam)[..., 2] + path.angles, slide, 1)
        return motion.node("v", self.joint.b)[2] - turning - bend * self.rate(motion, slide)

    def rate(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the arc length [m/s], from the velocities of node and beam."""
        velocity, tangent = self._seen(motion, slide)
        return np.sum(velocity * tangent, axis=1) / np.sum(tangent**2, axis=1)

    def parting_rate(self, motion: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (2, n) of the node as the beam sees it, and the direction (2, n) of the beam."""
        velocity, tangent = self._seen(motion, slide)
        return velocity.T, tangent.T / np.hypot(*tangent.T)

    def slide(self, motion: NodalMotion, guess: np.ndarray) -> np.ndarray:
        """Arc length (n,) nearest to the node [m], from one near by."""
        x, y, _ = motion.node("q", self.joint.b)
        node = np.column_stack([self.joint.b.x + x, self.joint.b.y + y])
        return self.joint.path.nearest_over(self._positions(motion), node, guess)

    def _positions(self, motion: NodalMotion) -> np.ndarray:
        return motion.beam("q", self.joint.beam)[..., :2] + self.joint.path.X

    def _seen(self, motion: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (n, 2) of the node relative to the beam at its place, and slope phi' there."""
        path = self.joint.path
        velocities = path.over(motion.beam("v", self.joint.beam)[..., :2], slide)
        velocity = np.column_stack([*motion.node("v", self.joint.b)[:2]]) - velocities
        return velocity, path.over(self._positions(motion), slide, 1)


def corner_advice(joints: Iterable[Joint], slides: np.ndarray) -> str:
    """Advice on a node that slides through a corner of a beam; empty if none does."""
    for joint in sliding_joints(joints):
        if (corner := joint.path.corner_near(slides[joint.number])) is not None:
            return (
                f"{joint} is at a corner of its beam, at ({corner[0]:g}, {corner[1]:g}) in the "
                "reference configuration: the direction of the beam jumps there, and the forces on "
                "the node have no balance. Round the corner by an fx_beam.spline or arc"
            )
    return ""


def Slider(
    beam: Beam,
    node: Node,
    fraction: float | None = None,
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    friction: Friction | None = None,
    stop: Stop | tuple | None = None,
) -> SlidingJoint:
    """A node that slides along a flexible beam, over all of its elements; it rotates freely.

    The node lies on the axis of the beam, which is made smooth where elements meet. It is a node of
    another beam or of a body. Node and beam have opposite forces, so that momenta are conserved,
    and these forces do no work. `JointMotion.slide` is the arc length from the start of the beam
    [m]. If the node reaches an end of the beam, the run ends with a `StepError` of the kind "off
    the end".

    Parameters
    ----------
    beam : Beam
        The beam that guides.
    node : Node
        The node that slides, of another beam or of a body. It must lie on the beam at the start.
        On `GROUND`, or on a node that is supported or driven already, the beam slides through a
        guide: the joint has a node b of its own there, which a rigid joint holds.
    fraction : float, optional
        Its place at the start, as a fraction of the beam's length; by default the nearest point.
        Needed where the beam crosses itself, and on the ground.
    spring, damper : Spring, Damper, optional
        On the arc length. The `rest` of the spring is an arc length.
    motor : callable or Input, optional
        ``motor(t)``, the change of the arc length since the start [m]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the arc length. That of Coulomb follows the force across the beam.
    stop : Stop or (lower, upper, stiffness), optional
        On the arc length [m, N/m], before an end of the beam is reached; a limit may be None.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Raises
    ------
    SceneError
        For a node that belongs to the beam, a fraction that is not between 0 and 1, or the ground
        without a fraction.
        `Scene.add_joint` refuses a node that is not on the beam.

    Examples
    --------
    A mass that moves over a bridge at 2 m/s.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -10))
    >>> section = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0)
    >>> bridge = scene.add_beam([(0, 0), (4, 0)], section, elements=8)
    >>> scene.pin(bridge.start)
    >>> scene.fix(bridge.end, "y")
    >>> car = scene.add_body((0, 0), mass=3.0, inertia=0.1)
    >>> mass = scene.add_joint(fb.Slider(bridge, car.centre, motor=lambda t: 2 * t))
    >>> scene.set_velocity(car.centre, (2.0, 0.0))
    >>> solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    >>> round(float(solution.joint(mass).slide[-1]), 9)
    2.0
    """
    slide = checked_coordinate("motor of a slider", spring, damper, motor, friction, stop)
    return _sliding("Slider", beam, node, fraction, slide, Coordinate())


def Sleeve(
    beam: Beam,
    node: Node,
    fraction: float | None = None,
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    friction: Friction | None = None,
    stop: Stop | tuple | None = None,
) -> SlidingJoint:
    """A node that slides along a flexible beam and turns with it.

    As `Slider`, but the node also rotates with the section of the beam at its present position, and
    with the reference tangent of a curved beam.

    Parameters
    ----------
    beam : Beam
        The beam that guides; it has no corners.
    node : Node
        The node that slides, of another beam or of a body. It must lie on the beam at the start.
        On `GROUND`, or on a node that is supported or driven already, the beam slides through a
        guide: the joint has a node b of its own there, which a rigid joint holds.
    fraction : float, optional
        Its place at the start, as a fraction of the beam's length; by default the nearest point.
    spring, damper : Spring, Damper, optional
        On the arc length.
    motor : callable or Input, optional
        ``motor(t)``, the change of the arc length since the start [m]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the arc length. That of Coulomb follows the force across the beam.
    stop : Stop or (lower, upper, stiffness), optional
        On the arc length [m, N/m], before an end of the beam is reached; a limit may be None.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Raises
    ------
    SceneError
        As `Slider`.

    Examples
    --------
    A rod that a motor moves along a fixed quarter of a circle turns by 90 degrees.

    >>> import math, fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)
    >>> quarter = fb.arc((1, 0), (0.6, 0.8), (0, 1))
    >>> wire = scene.add_beam(quarter, section, elements=8, degree=2)
    >>> for node in wire.nodes:
    ...     scene.clamp(node)
    >>> rod = scene.add_beam([(1, 0), (1.5, 0)], section, degree=2)
    >>> sleeve = scene.add_joint(fb.Sleeve(wire, rod.start, motor=lambda t: math.pi / 2 * t**2))
    >>> solution = fb.simulate(scene, dt=0.02, t_end=1.0)
    >>> round(math.degrees(solution.rotation(rod.start)[-1]), 1)
    90.0
    """
    slide = checked_coordinate("motor of a sleeve", spring, damper, motor, friction, stop)
    return _sliding("Sleeve", beam, node, fraction, slide, None)


def sliding_joints(joints: Iterable[Joint]) -> list[SlidingJoint]:
    """Joints of nodes that slide on beams."""
    return [joint for joint in joints if isinstance(joint, SlidingJoint)]


def _sliding(kind, beam, node, fraction, slide, rotation) -> SlidingJoint:
    if not isinstance(beam, Beam):
        raise SceneError(f"{kind}: {beam!r} is not a beam; give the beam that guides the node")
    expected = "given: a guide on the ground needs its place at the start, a fraction of the beam"
    require(node is not GROUND or fraction is not None, f"{kind}: fraction", fraction, expected)
    if id(node) in map(id, (*beam.nodes, *beam.carriers)):
        raise SceneError(f"{kind}: {node} belongs to beam {beam.name!r}; take one of another beam")
    if fraction is not None:
        ok = 0 <= as_float(fraction) <= 1
        require(ok, f"{kind}: fraction", fraction, "a number from 0 to 1")
        fraction = as_float(fraction)
    parts = {"slide": slide, "rotation": rotation, "beam": beam, "fraction": fraction}
    return new_joint(SlidingJoint, kind, beam.nodes[0], node, (0.0, 0.0), **parts)
