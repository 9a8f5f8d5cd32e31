"""Joints of a node that slides along a flexible beam, and the axis of the beam as its path."""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import SceneError, as_float, require

from .beam import Beam, Node, reference_positions
from .coordinate import Coordinate, Damper, Friction, Spring, Stop, checked_coordinate
from .joints import GROUND, Joint, JointKinematics, NodalMotion, new_joint

# -- The axis of a beam as a smooth path: weights of its nodes at an arc length -----------------


# Two straight pieces meet in a corner if their directions differ by more than this angle [rad].
_STRAIGHT = 1e-6
# Cubic functions on [0, 1] with slope 1 at one end, and zero value and slope otherwise.
_SLOPES = np.array([[0.0, 1.0, -2.0, 1.0], [0.0, 0.0, -1.0, 1.0]])


# Axes of the beams that live, by ids of these.
_axes: dict[int, BeamAxis] = {}


def axis_of(beam: Beam) -> BeamAxis:
    """The axis of a beam, made once for all that slides on it."""
    if (axis := _axes.get(id(beam))) is None:
        axis = _axes[id(beam)] = BeamAxis(beam)
        weakref.finalize(beam, _axes.pop, id(beam), None)
    return axis


class BeamAxis:
    """The axis of a beam, phi(s) = sum N_a(s) phi_a over its nodes, with a continuous tangent.

    The position is that of the finite elements where these meet, and between if neighbours have
    the same tangent there. Elsewhere cubics correct both, so that the tangent at the end
    of an element is the mean of the two, weighted so that it is exact for a parabola. Corners of a
    polyline stay corners.
    """

    #: Elements of a window: a step may go from an element to the second next one, and each of them
    #: needs its neighbours.
    WINDOW = 5

    def __init__(self, beam: Beam):
        self.s, p = beam.s, beam.degree
        self.degree, self.h = p, np.diff(beam.s)
        #: Arc length [m].
        self.length = beam.length
        elements = len(self.h)
        #: Reference positions (nodes, 2) of all nodes in order [m].
        self.X = reference_positions(beam)
        #: Identities of the nodes of the beam, and of those that carry it.
        self.node_ids = frozenset(map(id, (*beam.nodes, *beam.carriers)))
        #: Elements and nodes of a window.
        self.window = min(elements, self.WINDOW)
        self.width = p * self.window + 1
        #: Number of borders between elements that a step may pass.
        self.most = 2 if elements > self.WINDOW else elements
        #: Whether the elements i and i + 1 meet in a corner of a polyline, (elements - 1,).
        self.corners = np.zeros(elements - 1, dtype=bool)
        if beam.inner is None:
            chords = np.diff(self.X[::p], axis=0)
            turns = np.angle(_complex(chords[1:]) / _complex(chords[:-1]))
            self.corners = np.abs(turns) > _STRAIGHT
        #: Coefficients (elements, 3 p + 1, 4) for the nodes of an element and of both neighbours.
        self.coefficients = _polynomials(p, self.h, self.corners)
        nodes = np.clip(self._nodes(np.arange(elements)), 0, len(self) - 1)
        cubics = np.einsum("eak,eax->ekx", self.coefficients, self.X[nodes])
        #: The reference path by its elements.
        self.cubics = CubicPath(self.s, cubics)
        nodes = np.arange(len(self))
        e = np.minimum(nodes // p, elements - 1)
        tangents = self._over(self.X[None], e, (nodes - p * e) / p, 1)
        #: Angles (nodes,) of the reference tangent at the nodes, without jumps [rad].
        self.angles = np.unwrap(np.angle(_complex(tangents)))

    def __len__(self):
        return len(self.X)

    def corner_near(self, s: float) -> np.ndarray | None:
        """Position (2,) of a corner within a hundredth of an element from an arc length [m]."""
        inner, h = self.s[1:-1], np.minimum(self.h[1:], self.h[:-1])
        corners = np.flatnonzero(self.corners & (abs(inner - s) <= 0.01 * h))
        return self.X[self.degree * (corners[0] + 1)] if corners.size else None

    @property
    def numbers(self) -> np.ndarray:
        """All numbers on which it depends."""
        return np.concatenate([self.s, self.X.ravel(), self.coefficients.ravel(), self.angles])

    def element(self, s):
        """Element at an arc length, or several; the first or last one beyond the ends."""
        return np.clip(np.searchsorted(self.s, s, "right") - 1, 0, len(self.h) - 1)

    def position(self, s: float, order: int = 0) -> np.ndarray:
        """Reference position (2,) at an arc length [m], or its derivative."""
        return self.over(self.X[None], np.array([s]), order)[0]

    def over(self, values: np.ndarray, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Values (n, ...), or derivatives, at arc lengths s (n,), from `values` (n, nodes, ...)."""
        e = self.element(s)
        return self._over(values, e, (s - self.s[e]) / self.h[e], order)

    def _over(self, values: np.ndarray, e: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
        """Values, or derivatives by s, at coordinates x (n,) in elements e (n,)."""
        nodes = np.clip(self._nodes(e), 0, len(self) - 1)  # others have the weight 0
        index = nodes.reshape(*nodes.shape, *[1] * (values.ndim - 2))
        local = np.take_along_axis(values, index, 1)
        return np.einsum("na,na...->n...", self._weights(e, x, order), local)

    def _nodes(self, e: np.ndarray) -> np.ndarray:
        """Nodes (n, 3 p + 1) of elements and their neighbours, also where there is none."""
        return self.degree * (e[:, None] - 1) + np.arange(3 * self.degree + 1)

    def _weights(self, e: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
        """Weights (n, 3 p + 1) of nodes at coordinates x (n,) in elements, or derivatives by s."""
        ones = np.ones_like(x)
        powers = (ones, x, x * x, x * x * x), (0 * x, ones, 2 * x, 3 * x * x)
        weights = np.einsum("nak,nk->na", self.coefficients[e], np.column_stack(powers[order]))
        return weights / self.h[e][:, None] ** order

    def nearest_over(self, positions: np.ndarray, points: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Arc lengths (n,) nearest to points (n, 2), from ones near by, for nodes (n, nodes, 2)."""
        for _ in range(3):  # the method of Gauss and Newton
            arm, tangent = points - self.over(positions, s), self.over(positions, s, 1)
            s = s + np.sum(arm * tangent, axis=1) / np.sum(tangent**2, axis=1)
        return s


class CubicPath:
    """A path whose pieces are cubics (n, 4, 2), from arc lengths s[i] to s[i + 1]."""

    def __init__(self, s: np.ndarray, cubics: np.ndarray):
        self._s, self._cubics = s, cubics
        # Three places (n, 3, 2) of each piece, and the distance from these within which it is: the
        # next place is at most a quarter of the largest slope away.
        self._places = np.array([0.0, 0.5, 1.0])[:, None] ** np.arange(4) @ cubics
        self._reach = np.linalg.norm(cubics[:, 1:], axis=2) @ [0.25, 0.5, 0.75]
        # Numbers of the first pieces of groups, and circles round the places of each group.
        size = math.isqrt(len(cubics) - 1) + 1
        self._starts = np.arange(0, len(cubics) + size, size)
        groups = np.split(self._places, self._starts[1:-1])
        self._centres = np.array([places.mean(axis=(0, 1)) for places in groups])
        pairs = zip(groups, self._centres, strict=True)
        self._radii = np.array([np.linalg.norm(x - centre, axis=2).max() for x, centre in pairs])

    def nearest(self, point: np.ndarray) -> tuple[float, float]:
        """Arc length of the nearest point of the path, and the distance to it [m]."""
        near = self._near(point)
        distances = np.linalg.norm(self._places[near] - point, axis=2).min(axis=1)
        most = distances.min() * (1 + 1e-6) + 1e-12 * self._s[-1]
        arcs, gaps, within = [], [], []
        for piece in near[distances - self._reach[near] <= most]:
            x, gap = _nearest_on_cubic(self._cubics[piece] - [point, *np.zeros((3, 2))])
            start, end = self._s[piece : piece + 2]
            arcs.append(np.where(x < 1, start + (end - start) * x, end))
            gaps.append(gap)
            within.append((x > 0) & (x < 1))
        s, gap = np.concatenate(arcs), np.concatenate(gaps)
        is_farther = gap > gap.min() + 1e-15 * self._s[-1]
        best = np.lexsort((s, np.concatenate(within), is_farther))[0]  # ends of pieces come first
        return float(s[best]), float(gap[best])

    def _near(self, point: np.ndarray) -> np.ndarray:
        """Numbers of the pieces that may be the nearest ones, in order: those of near groups."""
        far = np.linalg.norm(self._centres - point, axis=1)
        most = (far + self._radii).min() * (1 + 1e-6) + 1e-12 * self._s[-1] + self._reach.max()
        groups = np.flatnonzero(far - self._radii <= most)
        pieces = (self._starts[groups, None] + np.arange(self._starts[1])).ravel()
        return pieces[pieces < len(self._reach)]


def _nearest_on_cubic(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places x in [0, 1] where the length of a cubic (4, 2) may be least, ends first; lengths."""
    slopes = np.arange(1, 4)[:, None] * coefficients[1:]
    # The square of the distance is a polynomial of degree 6.
    square = np.sum([np.convolve(part, part) for part in coefficients.T], axis=0)
    x = np.roots(np.arange(6, 0, -1) * square[:0:-1])
    powers = np.clip(x.real[abs(x.imag) < 1e-3], 0, 1)[:, None] ** np.arange(4)
    # A step of Gauss and Newton takes away what round-off has left.
    arm, tangent = powers @ coefficients, powers[:, :3] @ slopes
    x = powers[:, 1] - np.sum(arm * tangent, axis=1) / np.sum(tangent**2, axis=1)
    x = np.concatenate([[0.0, 1.0], np.clip(x, 0, 1)])
    return x, np.hypot(*(x[:, None] ** np.arange(4) @ coefficients).T)


def _polynomials(p: int, h: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Coefficients of cubics over elements of the lengths h (n,) and the degree p."""
    n = len(h)
    shapes = np.zeros((p + 1, 4))  # coefficients of 1, x, x^2, x^3
    fractions = np.arange(p + 1) / p
    shapes[:, : p + 1] = np.linalg.inv(fractions[:, None] ** np.arange(p + 1)).T
    begin, end = shapes[:, 1], shapes @ np.arange(4)
    coefficients = np.zeros((n, 3 * p + 1, 4))
    coefficients[:, p : 2 * p + 1] = shapes
    for i in np.flatnonzero(~corner):
        # Tangents by the nodes of both elements: their jump, taken up by one or the other.
        jump = np.zeros(2 * p + 1)
        jump[p:] += begin / h[i + 1]
        jump[: p + 1] -= end / h[i]
        share = h[i] / (h[i] + h[i + 1])
        left, right = share * h[i] * jump, -(1 - share) * h[i + 1] * jump
        coefficients[i, p:] += np.outer(left, _SLOPES[1])
        coefficients[i + 1, : 2 * p + 1] += np.outer(right, _SLOPES[0])
    return coefficients


def _complex(vectors: np.ndarray) -> np.ndarray:
    return vectors[:, 0] + 1j * vectors[:, 1]


# -- Joints of a node that slides along a flexible beam -----------------------------------------


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

    The node lies on the axis of the beam, which is smoothed where elements meet, and belongs to
    another beam or to a body. The forces on node and beam are opposite, so that momenta are
    conserved, and do no work. `JointMotion.slide` is the arc length from the start of the beam [m].
    If the node reaches an end of the beam, the run ends with a `StepError` of the kind "off the
    end".

    Parameters
    ----------
    beam : Beam
        The beam along which the node slides.
    node : Node
        The node that slides, of another beam or of a body. It must lie on the beam at the start.
        With `GROUND`, or with a node that is supported or driven already, the beam slides through a
        guide at this place: the joint then has a node b of its own, which a rigid joint holds
        there.
    fraction : float, optional
        Position of the node at the start, as a fraction of the length of the beam; by default the
        nearest point of the beam. Needed where the beam crosses itself, and on the ground.
    spring, damper : Spring, Damper, optional
        On the arc length. The `rest` of the spring is an arc length.
    motor : callable or Input, optional
        ``motor(t)``, the change of the arc length since the start [m]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the arc length. `Coulomb` friction follows the force across the beam.
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
        The beam along which the node slides, without corners.
    node : Node
        The node that slides, of another beam or of a body. It must lie on the beam at the start.
        With `GROUND`, or with a node that is supported or driven already, the beam slides through a
        guide at this place: the joint then has a node b of its own, which a rigid joint holds
        there.
    fraction : float, optional
        Position of the node at the start, as a fraction of the length of the beam; by default the
        nearest point of the beam.
    spring, damper : Spring, Damper, optional
        On the arc length.
    motor : callable or Input, optional
        ``motor(t)``, the change of the arc length since the start [m]; zero at t = 0.
    friction : SmoothFriction or Coulomb, optional
        On the arc length. `Coulomb` friction follows the force across the beam.
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
    if id(node) in axis_of(beam).node_ids:
        raise SceneError(f"{kind}: {node} belongs to beam {beam.name!r}; take one of another beam")
    if fraction is not None:
        ok = 0 <= as_float(fraction) <= 1
        require(ok, f"{kind}: fraction", fraction, "a number from 0 to 1")
        fraction = as_float(fraction)
    parts = {"slide": slide, "rotation": rotation, "beam": beam, "fraction": fraction}
    return new_joint(SlidingJoint, kind, beam.nodes[0], node, (0.0, 0.0), **parts)
