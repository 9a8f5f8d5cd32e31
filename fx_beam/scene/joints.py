"""Joints between two nodes, or a node and the ground, as plain data, and their kinematics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np

from fx_beam.dual import dual_of, scene_number
from fx_beam.errors import IS_DATA, SceneError, real_array, require, shown, vector

from .beam import Beam, Node
from .coordinate import Coordinate, Coulomb, Damper, Friction, Spring, Stop, checked_coordinate
from .functions import Numbers, time_function
from .notebook import html_table

# Largest gap of a joint that is made at a solution, relative to the size of the scene.
_FITS = 1e-6
_MOVE_ZERO = ", or give the joint an offset=: its slide counts from there along the axis"


class _Ground(Node):
    """The fixed frame: a single object, also after copying and pickling."""

    def __reduce__(self):
        return "GROUND"

    def __str__(self):
        return "the ground"


#: The fixed frame; it may take the place of one node of a joint.
GROUND = _Ground(-1, math.nan, math.nan)


class Place(NamedTuple):
    """Where the nodes of a joint are when it is made, if not in the reference configuration."""

    #: From a to b in the reference configuration; to or from the joint's point on the ground [m].
    apart: tuple[float, float]
    slide: float
    #: Rotation of b relative to a [rad].
    turn: float


class Track:
    """A straight line through the joint's offset, in the frame of a.

    Another joint has another one as its `track`: functions of its `axis` (2, ...) and of the slide,
    analytic in both, and the same as a `Track` of step/c/track.h, with its number there.
    """

    number = 0

    @staticmethod
    def place(axis: np.ndarray, slide: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """Components of the way from the offset to b [m]."""
        return slide * axis[0], slide * axis[1]

    @staticmethod
    def tangent(axis: np.ndarray, slide: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """Unit vector of the slide: the derivative of the place."""
        return axis[0] + 0 * slide, axis[1] + 0 * slide

    @staticmethod
    def nearest(axis: np.ndarray, x: Numbers, y: Numbers) -> np.ndarray:
        """Slide of the place that is nearest to a point (x, y), seen from the offset [m]."""
        return x * axis[0] + y * axis[1]


@dataclass(frozen=True, eq=False)
class Joint:
    """Coupling of two nodes; created by `Rigid`, `Revolute`, `Prismatic` and `PinInSlot`.

    The position of b is phi_b = phi_a + R(psi_a) (offset + d axis), with the slide d. The rotation
    psi_b equals psi_a, or it is free.

    Parameters
    ----------
    kind : str
        Name of the kind.
    a, b : Node
        The nodes; one may be `GROUND`. The offset and the axis rotate with a.
    offset : (2,) float
        Vector from a to the joint, in the reference configuration [m].
    axis : (2,) float, optional
        Unit vector of the slide in the reference configuration.
    slide : Coordinate, optional
        Spring, damper, friction, stops and motor of the slide; None for a joint without slide.
    rotation : Coordinate, optional
        Spring, damper, ... of the relative rotation psi_b - psi_a; None where it is fixed.
    number : int
        Index in the joints of the scene.
    place : Place, optional
        Positions of the nodes when the joint is made, if not those of the reference configuration.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    >>> beams = [scene.add_beam([(1, 0), end], section, 1) for end in [(0, 0), (2, 0)]]
    >>> print(scene.add_joint(fb.Revolute(beams[0].start, beams[1].start)))
    joint 0, Revolute of node 0 at (1, 0) and node 2 at (1, 0)
    """

    kind: str
    a: Node
    b: Node
    offset: np.ndarray = field(metadata=IS_DATA)
    axis: np.ndarray | None = field(default=None, metadata=IS_DATA)
    slide: Coordinate | None = None
    rotation: Coordinate | None = None
    number: int = field(default=-1)
    place: Place | None = None

    #: The curve on which b is on a, over the slide.
    track: ClassVar[type[Track]] = Track

    def __repr__(self):
        return f"<{self}>"

    def _repr_html_(self):
        rows = {name: str(c) for name, c in self.coordinates.items()}
        return html_table(str(self), {"offset": str(self.offset)} | rows)

    def __str__(self):
        number = "" if self.number < 0 else f"joint {self.number}, "
        return f"{number}{self.kind} of {self.a} and {self.b}"

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """The free coordinates of the joint by name, "slide" and "rotation", with their laws."""
        parts = {"slide": self.slide, "rotation": self.rotation}
        return {name: part for name, part in parts.items() if part is not None}

    @property
    def driven(self) -> list[str]:
        """Names of the coordinates with a motor."""
        return [name for name, c in self.coordinates.items() if c.motor is not None]

    @property
    def turns_together(self) -> bool:
        """Whether b rotates with a, up to the angle of a motor."""
        return self.rotation is None or self.rotation.motor is not None

    @property
    def internal(self) -> tuple[str, ...]:
        """Names of the internal variables of springs: of the slide, then of the rotation."""
        springs = (c.spring for c in self.coordinates.values())
        return tuple(name for s in springs if s and s.internal for name in s.internal.names)

    @property
    def is_selection(self) -> bool:
        """Whether the displacements of a and b are equal."""
        return self.axis is None and not self.offset.any() and self.place is None

    @property
    def apart(self) -> np.ndarray:
        """From a to b in the reference configuration (2,) [m]; on the ground from where it fits."""
        if self.place is not None:
            return np.array(self.place.apart)
        if self.a is GROUND or self.b is GROUND:
            return self.offset
        return real_array([self.b.x - self.a.x, self.b.y - self.a.y])

    @property
    def arm(self) -> np.ndarray:
        """From a to b at the start, in the reference configuration (2,) [m]."""
        return self.kinematics.place_on_a(self.start()[0])

    @property
    def direction(self) -> np.ndarray | None:
        """Unit vector (2,) of the slide in the reference configuration; None without a slide."""
        return None if self.axis is None else self.kinematics.tangent(self.start()[0])

    @property
    def kinematics(self) -> JointKinematics:
        """Gap, angle and rates of the joint, from the motion of nodes."""
        return JointKinematics(self)

    @property
    def is_rigid(self) -> bool:
        """Whether b neither slides nor turns relative to a."""
        return not self.coordinates

    @property
    def on_beam(self) -> bool:
        """Whether b slides on a beam."""
        return self.slide is not None and self.axis is None

    def start(self) -> tuple[float, float]:
        """Slide and gap at the start.

        Returns
        -------
        slide : float
            Distance along the axis from the joint's position on a to b [m].
        gap : float
            Distance that is left [m]; it must be zero.
        """
        if self.place is not None:
            return self.place.slide, 0.0
        if self.a is GROUND or self.b is GROUND:
            return 0.0, 0.0  # the joint's point on the ground is its start position
        place = np.array([self.b.x - self.a.x, self.b.y - self.a.y])
        slide = float(self.kinematics.slide_at(*place))
        return slide, float(np.hypot(*(place - self.kinematics.place_on_a(slide))))


AnyJoint = TypeVar("AnyJoint", bound=Joint)


class NodalMotion(NamedTuple):
    """Motion over n rows: "q", displacements and rotations, or "v", their rates."""

    #: Components (3, n) of a node.
    node: Callable[[str, Node], np.ndarray]
    #: Components (n, nodes, 3) of all nodes of a beam, also inside elements.
    beam: Callable[[str, Beam], np.ndarray]


class JointKinematics:
    """A joint whose node b has a place on node a."""

    def __init__(self, joint):
        self.joint = joint

    def check_start(self, size: float) -> None:
        """Refuse nodes that do not fit, motors that do not start from zero, and closed stops.

        The size is that of the scene [m], with which distances are compared.
        """
        joint = self.joint
        slide, gap = joint.start()
        if gap > 1e-9 * size:
            raise SceneError(f"{joint}: {self._misplaced(gap)}")
        for name, coordinate in joint.coordinates.items():
            unit = size if name == "slide" else 1.0
            if coordinate.motor is not None:
                value = coordinate.motor(0.0)[0]
                if not abs(value) <= 1e-9 * unit:
                    raise SceneError(
                        f"{joint}: the motor of its {name} is {value:g} at t = 0; it must start "
                        "from 0. Subtract the start value. To begin elsewhere, let the motor be "
                        "there at a later time t, find the equilibrium by static(scene, t=t), and "
                        "start from this solution"
                    )
            if coordinate.stop is not None:
                start = slide if name == "slide" else 0.0
                advice = _MOVE_ZERO if start and joint.a is not GROUND else ""
                coordinate.stop.check_start(start, 1e-9 * unit, f"{joint}: its {name}", advice)

    def _misplaced(self, gap: float) -> str:
        """Error in the places of nodes that do not fit."""
        return (
            f"at the start there is a gap of {gap:.4g} between b and its position on a. Move the "
            "nodes, or give the joint an offset"
        )

    def place_on_a(self, slide: Numbers) -> np.ndarray:
        """Components (2, ...) of the place of b in the frame of a, at slides (...) [m]."""
        (x, y), axis = self.joint.offset, self.joint.axis
        if axis is None:
            return np.array([x, y])
        place = self.joint.track.place(axis, slide)
        return np.array([x + place[0], y + place[1]])

    def tangent(self, slide: Numbers) -> np.ndarray:
        """Unit vectors (2, ...) of the slide in the frame of a; zero without a slide."""
        axis = self.joint.axis
        return np.zeros(2) if axis is None else np.array(self.joint.track.tangent(axis, slide))

    def slide_at(self, x: Numbers, y: Numbers) -> np.ndarray:
        """Slides (...) at components (...) of the place of b in the frame of a [m]."""
        (offset_x, offset_y), axis = self.joint.offset, self.joint.axis
        if axis is None:
            return np.zeros(())
        return self.joint.track.nearest(axis, x - offset_x, y - offset_y)

    def parting(self, motion: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From b to its place on a: components x and y (n,) [m]."""
        (X, Y), (x, y, _) = self.joint.apart, self._difference(motion, "q")
        arm_x, arm_y = self._turned(motion, self.place_on_a(slide))
        return arm_x - X - x, arm_y - Y - y

    def gap(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Distance (n,) of b from its place [m]; zero to round-off."""
        return np.hypot(*self.parting(motion, slide))

    def angle(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rotation (n,) of b relative to a, or to its beam where it is, since the start [rad]."""
        return self._difference(motion, "q")[2]

    def spin(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the angle [rad/s]."""
        return self._difference(motion, "v")[2]

    def rate(self, motion: NodalMotion, slide: np.ndarray) -> np.ndarray:
        """Rate (n,) of the slide [m/s] if the joint has one, else of the angle [rad/s]."""
        joint = self.joint
        if joint.axis is None:
            return self.spin(motion, slide)
        x, y, _ = self._difference(motion, "v")
        psi, spin = (self._of(motion, name, joint.a)[2] for name in "qv")
        return axial_rate(joint.track, joint.offset, joint.axis, slide, psi, spin, x, y)

    def parting_rate(self, motion: NodalMotion, slide: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (2, n) of b as a sees it, and the direction (2, n) of the slide, or zero."""
        x, y, _ = self._difference(motion, "v")
        spin = self._of(motion, "v", self.joint.a)[2]
        arm_x, arm_y = self._turned(motion, self.place_on_a(slide))
        velocity = np.array([x + spin * arm_y, y - spin * arm_x])
        # The ground's does not turn.
        directions = np.reshape(self._turned(motion, self.tangent(slide)), (2, -1))
        return velocity, np.broadcast_to(directions, velocity.shape)

    def slide(self, motion: NodalMotion, guess: np.ndarray) -> np.ndarray:
        """The slide (n,) [m] in a motion, from one near by; that one for a joint without."""
        if self.joint.axis is None:
            return guess
        (X, Y), (x, y, _) = self.joint.apart, self._difference(motion, "q")
        return self.slide_at(*self._turned(motion, (X + x, Y + y), back=True))

    def _of(self, motion: NodalMotion, name: str, node: Node) -> np.ndarray:
        """Components of a node; zero on the ground."""
        return np.zeros(3) if node.number < 0 else motion.node(name, node)

    def _difference(self, motion: NodalMotion, name: str) -> list[np.ndarray]:
        """Components (3,) of the motion of b relative to a: x_b - x_a."""
        a, b = (self._of(motion, name, node) for node in (self.joint.a, self.joint.b))
        return [end - start for end, start in zip(b, a, strict=True)]

    def _turned(
        self, motion: NodalMotion, arm, back: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """R(psi_a) arm, or with `back` R(-psi_a) arm: the components as a sees them."""
        psi = self._of(motion, "q", self.joint.a)[2]
        c, s = np.cos(psi), np.sin(-psi if back else psi)
        return c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]


def axial_rate(track, offset, axis, slide, psi, spin, x, y):
    """Rate of a slide [m/s], for rotation and spin of a and the velocity (x, y) of b less a's.

    It is analytic in all numbers.
    """
    place, tangent = track.place(axis, slide), track.tangent(axis, slide)
    c, s = np.cos(psi), np.sin(psi)
    # The velocity of b relative to its position on a, in the frame of a.
    seen_x = c * x + s * y + spin * (offset[1] + place[1])
    seen_y = c * y - s * x - spin * (offset[0] + place[0])
    return seen_x * tangent[0] + seen_y * tangent[1]


def placed(joint: Joint, q_a: np.ndarray, q_b: np.ndarray, size: float) -> Joint:
    """The joint made where its nodes have moved by q (3,); SceneError if they do not fit.

    `size` is that of the scene [m]. A small gap is left to the offset.
    """
    if joint.driven:
        raise SceneError(f"{joint}: at a solution it cannot have a motor. Add it without, and lock")
    turn = float(q_b[2] - q_a[2]) if joint.turns_together else 0.0
    c, s = math.cos(q_a[2]), math.sin(q_a[2])
    if GROUND in (joint.a, joint.b):
        arm = np.array([[c, -s], [s, c]]) @ joint.offset
        apart = arm - q_b[:2] + q_a[:2]
        return replace(joint, place=Place((float(apart[0]), float(apart[1])), 0.0, turn))
    apart = np.array([joint.b.x - joint.a.x, joint.b.y - joint.a.y])
    position = np.array([[c, s], [-s, c]]) @ (apart + q_b[:2] - q_a[:2])
    slide = float(joint.kinematics.slide_at(*position))
    offset = position - (joint.kinematics.place_on_a(slide) - joint.offset)
    gap = float(np.hypot(*(offset - joint.offset)))
    if gap > _FITS * size:
        x, y = offset
        raise SceneError(
            f"{joint}: in this solution there is a gap of {gap:.4g} between b and its position on "
            f"a. Add it when they meet, or with offset=({x:.6g}, {y:.6g})"
        )
    for name, coordinate in joint.coordinates.items():
        if coordinate.stop is not None:
            value = slide if name == "slide" else float(q_b[2] - q_a[2])
            coordinate.stop.check_start(value, _FITS * size, f"{joint}: its {name}")
    offset.setflags(write=False)
    place = Place((float(apart[0]), float(apart[1])), slide, turn)
    return replace(joint, offset=offset, place=place)


def moved_by(solution, node: Node) -> np.ndarray:
    """Displacements and rotation (3,) of a node at the end of a solution; zero for new ones."""
    end, X = getattr(solution, "end", None), getattr(solution, "X", None)
    if end is None or X is None:
        raise SceneError(f"add_joint: at = {shown(solution)} must be a solution with a last state")
    number = node.number
    same_node = 0 <= number < len(X) and tuple(X[number]) == (node.x, node.y)
    return end.q[number] if same_node else np.zeros(3)


def Rigid(a: Node, b: Node, offset=(0.0, 0.0)) -> Joint:
    """Rigid joint: b moves and rotates with a.

    Parameters
    ----------
    a, b : Node
        The nodes; one may be `GROUND`.
    offset : (x, y)
        Vector from a to b in the reference configuration [m].

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    >>> lower = scene.add_beam([(0, 0), (1, 0)], section)
    >>> upper = scene.add_beam([(1, 0.5), (2, 0.5)], section)
    >>> scene.add_joint(fb.Rigid(lower.end, upper.start, offset=(0, 0.5))).kind
    'Rigid'
    """
    return new_joint(Joint, "Rigid", a, b, offset)


def Revolute(
    a: Node,
    b: Node,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    friction: Friction | None = None,
    stop: Stop | tuple | None = None,
) -> Joint:
    """Revolute joint (hinge): b keeps its position on a and rotates freely.

    Parameters
    ----------
    a, b : Node
        The nodes; one may be `GROUND`.
    offset : (x, y)
        Vector from a to the hinge in the reference configuration [m]; it rotates with a.
    spring, damper : Spring, Damper, optional
        On the relative rotation psi_b - psi_a.
    motor : callable or Input, optional
        ``motor(t)``, the relative rotation since the start [rad]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the relative rotation.
    stop : Stop or (lower, upper, stiffness), optional
        On the relative rotation [rad, N m/rad]; a limit may be None.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Examples
    --------
    A crank that a motor turns at a growing rate.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> crank = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    >>> hinge = scene.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=lambda t: t**2))
    >>> solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    >>> round(float(solution.joint(hinge).angle[-1]), 6)
    0.25
    """
    rotation = checked_coordinate(
        "motor of a revolute joint", spring, damper, motor, friction, stop
    )
    return new_joint(Joint, "Revolute", a, b, offset, rotation=rotation)


def Prismatic(
    a: Node,
    b: Node,
    axis,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    friction: Friction | None = None,
    stop: Stop | tuple | None = None,
) -> Joint:
    """Prismatic joint: b slides along an axis fixed to a, and rotates with a.

    Parameters
    ----------
    a, b : Node
        The nodes; a carries the guide. One may be `GROUND`.
    axis : (x, y)
        Direction of the guide in the reference configuration, of any length.
    offset : (x, y)
        Vector from a to a point of the guide in the reference configuration [m]; there the slide is
        zero. On the ground the slide is zero at the start of b.
    spring, damper : Spring, Damper, optional
        On the slide, which does not start at zero if the nodes are apart along the axis: `rest` is
        the slide at which the spring is free of force.
    motor : callable or Input, optional
        ``motor(t)``, the slide since the start [m]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the slide.
    stop : Stop or (lower, upper, stiffness), optional
        On the slide [m, N/m]; a limit may be None.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Examples
    --------
    A bar that falls along a vertical guide.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -10))
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    >>> guide = scene.add_joint(fb.Prismatic(fb.GROUND, bar.node(0), axis=(0, 1)))
    >>> solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    >>> round(float(solution.joint(guide).slide[-1]), 6)
    -1.25
    """
    slide = checked_coordinate("motor of a prismatic joint", spring, damper, motor, friction, stop)
    unit = direction(axis, "Prismatic: axis")
    return new_joint(Joint, "Prismatic", a, b, offset, unit, slide)


def PinInSlot(
    a: Node,
    b: Node,
    axis,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    hinge: Coordinate | None = None,
    friction: Friction | None = None,
    stop: Stop | tuple | None = None,
) -> Joint:
    """Pin in a slot: b slides along an axis fixed to a, and rotates freely.

    Parameters
    ----------
    a, b : Node
        The nodes; a carries the slot. One may be `GROUND`.
    axis : (x, y)
        Direction of the slot in the reference configuration, of any length.
    offset : (x, y)
        Vector from a to a point of the slot in the reference configuration [m]; there the slide is
        zero. On the ground the slide is zero at the start of b.
    spring, damper : Spring, Damper, optional
        On the slide.
    motor : callable or Input, optional
        ``motor(t)``, the slide since the start [m]; zero at t = 0.
    hinge : Coordinate, optional
        Spring, damper, friction, stops and motor of the relative rotation.
    friction : SmoothFriction or Coulomb, optional
        On the slide.
    stop : Stop or (lower, upper, stiffness), optional
        On the slide [m, N/m]; a limit may be None.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.

    Examples
    --------
    A roller support on an inclined plane.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3))
    >>> roller = scene.add_joint(fb.PinInSlot(fb.GROUND, beam.end, axis=(1, 1)))
    >>> roller.axis.round(3)
    array([0.707, 0.707])
    """
    slide = checked_coordinate("motor of a pin in slot", spring, damper, motor, friction, stop)
    hinge = Coordinate() if hinge is None else hinge
    require(isinstance(hinge, Coordinate), "PinInSlot: hinge", hinge, "an fx_beam.Coordinate")
    if hinge.motor is not None:
        hinge = replace(hinge, motor=time_function(hinge.motor, 1, "hinge of a pin in slot"))
    unit = direction(axis, "PinInSlot: axis")
    return new_joint(Joint, "PinInSlot", a, b, offset, unit, slide, hinge)


def direction(value, name: str) -> np.ndarray:
    """Unit vector (2,) in the direction of a vector; a unit vector stays, to the last digit."""
    components = vector(value, 2, name)
    length = np.hypot(*components)
    if length == 0:
        raise SceneError(f"{name} = {components} has no direction. Give a nonzero vector")
    if (dual := dual_of(components)) is not None:
        return scene_number(dual / np.hypot(*dual))
    unit = components / length if abs(length - 1) > 4e-16 else components
    unit.setflags(write=False)
    return unit


def new_joint(
    cls: type[AnyJoint], kind, a, b, offset, axis=None, slide=None, rotation=None, **extra
) -> AnyJoint:
    """A joint of a class, and what this has more; SceneError for nodes and laws that do not fit."""
    if slide is not None and isinstance(slide.friction, Coulomb) and slide.friction.radius:
        raise SceneError(f"{kind}: friction of a slide has no radius; omit it")
    friction = rotation.friction if rotation is not None else None
    if isinstance(friction, Coulomb) and friction.radius is None:
        raise SceneError(
            f"{kind}: friction of a rotation needs the radius of the pin, "
            "fx_beam.Coulomb(mu, stiffness, radius)"
        )
    for node in (a, b):
        if not isinstance(node, Node):
            raise SceneError(
                f"{kind}: {shown(node)} is not a node; take one of a beam, body.centre or "
                "body[name] of a body, or GROUND"
            )
    if a is b:
        raise SceneError(f"{kind}: both of its nodes are {a}. Give two different nodes")
    offset = vector(offset, 2, f"{kind}: offset")
    expected = f"zero, as the ground takes no offset: the joint is at the start position of {b}"
    require(a is not GROUND or not offset.any(), f"{kind}: offset", offset.tolist(), expected)
    joint = cls(kind, a, b, offset, axis, slide, rotation, **extra)
    if len(set(joint.internal)) < len(joint.internal):
        raise SceneError(
            f"{kind}: the springs of its slide and its rotation have internal variables of the "
            f"same name: {list(joint.internal)}. Give them different names"
        )
    return joint


@dataclass(frozen=True)
class JointKey:
    """A joint that a scene had; equal if it couples the same way."""

    number: int
    kind: str
    a: int
    b: int
    #: Names of its coordinates with a motor.
    motors: tuple[str, ...]
    #: Its offset and axis, where it was made if not in the reference, and the beam that carries b.
    place: tuple[float, ...]
    beam: str


@dataclass(frozen=True)
class Constraints:
    """The joints, supports and driven motions of a scene."""

    joints: tuple[JointKey, ...] = ()
    #: Numbers of nodes, and of components.
    fixed: tuple[tuple[int, int], ...] = ()
    driven: tuple[tuple[int, int], ...] = ()


def missing_joints(scene) -> list[int]:
    """Numbers of joints that were removed, or are not there yet."""
    present = {*joints_by_number(scene), *(gear.number for gear in scene.gears)}
    return sorted({*range(scene.joint_count)} - present)


def joints_by_number(scene) -> dict[int, Joint]:
    """The joints of a scene by their numbers; numbers of removed joints are missing."""
    return {joint.number: joint for joint in scene.joints}


def slides_at_start(scene) -> np.ndarray:
    """Slides (joint_count,) of the joints in the reference configuration [m]."""
    slides = np.zeros(scene.joint_count)
    for joint in scene.joints:
        if type(joint) is not Joint or joint.axis is not None or joint.place is not None:
            slides[joint.number] = joint.start()[0]
    return slides


def constraints_of(scene) -> Constraints:
    """The joints and supports of a scene, in order."""
    keys = [*map(key_of, scene.joints), *(gear.key for gear in scene.gears)]
    joints = tuple(sorted(keys, key=lambda key: key.number))
    return Constraints(joints, tuple(sorted(scene.fixed)), tuple(sorted(scene.prescribed)))


def coupling_of(joint: Joint) -> tuple:
    """Kind, nodes and place of a joint: of two joints with the same ones, one is enough."""
    key = key_of(joint)
    return key.kind, key.a, key.b, key.place, key.beam


def key_of(joint: Joint) -> JointKey:
    """Identifier of a joint in a scene that has changed."""
    place = joint.offset.tolist()
    if joint.axis is not None:
        place += joint.axis.tolist()
    if joint.place is not None:
        place += [*joint.place.apart, joint.place.turn]
    beam = getattr(getattr(joint, "beam", None), "name", "")
    a, b, motors = joint.a.number, joint.b.number, tuple(joint.driven)
    return JointKey(joint.number, joint.kind, a, b, motors, tuple(place), beam)
