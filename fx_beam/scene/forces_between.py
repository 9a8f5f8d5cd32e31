"""Forces along lines, of ropes over pulleys, and of springs to the ground, as plain data."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from fx_beam import errors
from fx_beam.dual import dual_array, floats, scene_number
from fx_beam.errors import IS_DATA, SceneError, is_one_of, real, real_array, require, vector
from fx_beam.symbolic import Expr, ufl

from .beam import Beam, Node, position_of
from .contacts import points_of
from .coordinate import Coordinate, Coulomb, Damper, SmoothFriction, Spring, Stop, functions_of
from .functions import TimeValue
from .notebook import html_table
from .parameters import is_parameter, value_of

if TYPE_CHECKING:
    from .ufl_symbols import Parameter


# -- Forces along lines: between two points, and of ropes over several, as plain data -----------


#: A point as users give it.
Point = Node | Sequence[float] | np.ndarray
#: ``force(distance, rate, t)`` in UFL.
Pull = Callable[[Expr, Expr, Expr], Expr]


def _given_pull(pull: Parameter, *arguments: Expr) -> Parameter:
    """A pull that is a number or an input [N]."""
    return pull


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A place to which a force or a rope is fixed, or over which a rope runs."""

    position: np.ndarray = field(metadata=IS_DATA)

    def __str__(self):
        return "({:g}, {:g})".format(*self.position)


@dataclass(frozen=True, eq=False)
class ForceBetween:
    """A force along the line between two points, or a rope over several points.

    Created by `Scene.add_force_between` and `Scene.add_rope`.

    Parameters
    ----------
    points : tuple of Node or FixedPoint
        The points of the line in order: nodes and places.
    on : Coordinate
        Spring, damper, friction and stops on the distance, or on the length of the rope.
    force : callable, optional
        ``force(distance, rate, t)``, a pull [N].
    number : int
        Index in the scene's forces between points.
    own : tuple of str
        Names of parameters that belong to this force only.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, -2), mass=1.0, inertia=0.1, name="ball").centre
    >>> print(scene.add_force_between(ball, (0, 0), spring=fb.Spring(100.0, rest=2.0)))
    force 0, between node 0 at (0, -2) and (0, 0)
    """

    points: tuple[Node | FixedPoint, ...]
    on: Coordinate
    force: Pull | None = field(default=None, metadata=IS_DATA)
    number: int = -1
    own: tuple[str, ...] = ()
    #: Whether it acts between its target and the ground, along a direction.
    to_ground: ClassVar[bool] = False
    #: Whether it holds the nodes of a beam.
    is_bed: ClassVar[bool] = False
    #: Kinds of the points of a rope over pulleys; empty for others.
    kinds: ClassVar[str] = ""

    @property
    def has_pulleys(self) -> bool:
        """Whether it is a rope over pulleys between its ends, which it may leave."""
        return any(kind in "NF" for kind in self.kinds[1:-1])

    def __repr__(self):
        return f"<{self}>"

    def _repr_html_(self):
        rows = {"laws": str(self.on)} if self.on.acts else {}
        if self.force is not None:
            rows["force"] = "a function" if callable(self.force) else str(self.force)
        return html_table(str(self), rows)

    def __str__(self):
        number = "" if self.number < 0 else f"force {self.number}, "
        if len(self.points) == 2:
            return f"{number}between {self.a} and {self.points[1]}"
        return f"{number}over {', '.join(map(str, self.points))}"

    @property
    def a(self) -> Node | np.ndarray:
        """The first point: a node or a position (2,) [m]."""
        return _node_or_position(self.points[0])

    @property
    def b(self) -> Node | np.ndarray:
        """The last point: a node or a position (2,) [m]."""
        return _node_or_position(self.points[-1])

    @property
    def nodes(self) -> tuple[int, ...]:
        """Numbers of the nodes in order; -1 for a fixed point."""
        return tuple(p.number if isinstance(p, Node) else -1 for p in self.points)

    @property
    def apart(self) -> np.ndarray:
        """Vectors (points - 1, 2) from each point to the next one, at the start [m]."""
        positions = [position_of(_node_or_position(point)) for point in self.points]
        return real_array([[y[0] - x[0], y[1] - x[1]] for x, y in itertools.pairwise(positions)])

    def straight(self, ways: np.ndarray) -> np.ndarray:
        """Straight parts of the line.

        Parameters
        ----------
        ways : (n - 1, 2) float
            Vectors from each point to the next one [m].

        Returns
        -------
        (n - 1, 2) float
            Vectors of the straight parts [m].
        """
        return ways

    @property
    def geometry(self) -> list[float]:
        """Numbers of its length: vectors from each point to the next one; of circles more."""
        return [component for way in self.apart for component in way]

    def vectors(self, numbers: Any, moved: Sequence) -> list[tuple]:
        """Vectors from each point to the next one.

        Parameters
        ----------
        numbers, moved : sequence
            As of `length`.

        Returns
        -------
        list of (x, y)
            Their components [m].
        """
        return [(numbers[2 * i] + x, numbers[2 * i + 1] + y) for i, (x, y) in enumerate(moved)]

    def length(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> Any:
        """The sum of distances, or of free spans and arcs.

        Parameters
        ----------
        numbers : sequence of float
            Those of `geometry`, which may have slopes.
        moved : sequence of (x, y)
            Changes of the vectors from each point to the next one [m]; components (...) may have
            slopes.
        turned : (first, last)
            Rotations of drums at both ends [rad].
        counted : (..., points - 1) float, optional
            Half turns that the spans of a rope over pulleys have turned [rad].

        Returns
        -------
        (...) float
            The length [m].
        """
        return sum(np.hypot(x, y) for x, y in self.vectors(numbers, moved))

    def rate(self, numbers: Any, moved: Sequence, rates: Sequence, spins: Sequence) -> Any:
        """Rate of the length.

        Parameters
        ----------
        numbers, moved : sequence
            As of `length`.
        rates : sequence of (x, y)
            Rates of the vectors from each point to the next one [m/s].
        spins : (first, last)
            Spins of drums at both ends [rad/s].

        Returns
        -------
        (...) float
            The rate [m/s].
        """
        pairs = zip(self.vectors(numbers, moved), rates, strict=True)
        return sum((x * vx + y * vy) / np.hypot(x, y) for (x, y), (vx, vy) in pairs)

    @property
    def length_at_start(self) -> float:
        """Distance of the points, or the sum of those along a rope, at the start [m]."""
        return math.fsum(math.hypot(*way) for way in self.apart)

    @property
    def drawn_length(self) -> float:
        """The length at the start, with the slopes that it has [m]."""
        moved = [(0.0, 0.0)] * (len(self.points) - 1)
        return scene_number(self.length(dual_array(self.geometry), moved, (0.0, 0.0)))

    @property
    def functions(self) -> list[tuple[str, Expr]]:
        """Expressions of the user's functions, by kind."""
        functions = [*functions_of(self.on)]
        if self.force is not None:
            from .ufl_symbols import SCALARS

            functions.append(("force", ufl.as_ufl(self.force(*SCALARS[:3]))))
        return functions


def _node_or_position(point: Node | FixedPoint) -> Node | np.ndarray:
    return point if isinstance(point, Node) else point.position


@dataclass(frozen=True)
class RopeSpring(Spring):
    """A linear spring that only pulls, from a length on; both numbers are parameters."""

    slope: Any = field(default=None, metadata=IS_DATA)
    length: Any = field(default=None, metadata=IS_DATA)


def parameter_of_length(length: Any, number: int) -> str:
    """Name of the parameter that is the length of a rope."""
    return length.name if is_parameter(length) else f"length of rope {number}"


def rope_spring(spring, length: TimeValue, number: int) -> tuple[RopeSpring, tuple[str, ...]]:
    """A spring that only pulls, from a length on, and names of parameters made for it.

    SceneError if no linear spring is given.
    """
    from .ufl_symbols import Parameter

    ok = isinstance(spring, Spring) and spring.stiffness > 0
    ok = ok and spring.strain_energy is None and spring.rest == 0
    expected = "a linear fx_beam.Spring(k) without a rest, as the rope has a length"
    require(ok, f"rope {number}: spring", spring, expected)
    k = Parameter(f"stiffness of rope {number}", spring.stiffness)
    names: tuple[str, ...] = (k.name,)
    if not is_parameter(length):
        length = Parameter(parameter_of_length(length, number), length)
        names = (*names, length.name)

    def energy(x):
        return ufl.conditional(ufl.gt(x, length), k / 2 * (x - length) ** 2, 0.0)

    return RopeSpring(strain_energy=energy, slope=k, length=length), names


def _with_rope(
    laws: Coordinate, force: object, length: TimeValue | None, number: int
) -> tuple[Coordinate, tuple[str, ...]]:
    """Laws with the spring of a rope of a length, and names of parameters made for it.

    An upper stop with a damper or friction, and no spring or force, is a rope: else they would push
    where it is slack. SceneError if it has a loss of its own.
    """
    stop, resists = laws.stop, laws.damper or laws.friction
    is_alone = length is None and laws.spring is None and force is None
    if is_alone and resists and stop is not None and stop.lower is None:
        if stop.restitution < 1:
            raise SceneError(
                f"force {number}: its stop has restitution = {stop.restitution!r}, and there is a "
                "damper or friction, which acts while a rope is taut. Give one of them"
            )
        laws, length = replace(laws, spring=Spring(stop.stiffness), stop=None), stop.upper
    if length is None:
        return laws, ()
    spring, names = rope_spring(laws.spring, length, number)
    return replace(laws, spring=spring), names


def checked_force(
    scene, points: Sequence, coordinate: Coordinate, force, length=None, make=ForceBetween
) -> ForceBetween:
    """A new force of a scene; SceneError if a law is not finite at the start."""
    number, size = scene.force_count, scene.nodes.size
    coordinate, names = _with_rope(coordinate, force, length, number)
    if force is not None and not callable(force):
        from .ufl_symbols import Parameter

        name = f"force {number} between points"
        force, names = functools.partial(_given_pull, Parameter(name, force)), (*names, name)
    new = make(_points(points), coordinate, force, number, names)
    if min(math.hypot(*way) for way in new.apart) <= 1e-12 * size:
        raise SceneError(f"{new}: the points are at the same place, so that no direction is known")
    distance = new.length_at_start
    if not (coordinate.acts or force is not None):
        raise SceneError(f"{new}: give a spring, damper, friction, stop or force")
    if isinstance(coordinate.friction, Coulomb):
        raise SceneError(
            f"{new}: fx_beam.Coulomb needs a normal force, which a force between two points has "
            "not. Use fx_beam.SmoothFriction"
        )
    check_at_start(new, distance, 1e-9 * size, "the distance")
    if force is not None:
        _check(force, (distance, 0.0, 0.0), new, "force(distance, rate, t)")
    return new


def check_at_start(force: ForceBetween, place: float, tolerance: float, name: str) -> None:
    """SceneError if a force starts beyond a stop, or its stored energy is not finite there."""
    stop, spring = force.on.stop, force.on.spring
    if stop is not None:
        stop.check_start(place, tolerance, f"{force}: {name}")
    if spring is not None and spring.strain_energy is not None and not spring.internal:
        _check(spring.strain_energy, (place - spring.rest,), force, "strain_energy(x)")


def _points(points: Sequence) -> tuple[Node | FixedPoint, ...]:
    """Nodes and fixed points; SceneError for anything else."""
    name = "force between points: b, a node or a fixed point,"
    if len(points) > 2:
        name = "rope: a point, a node or a fixed one,"
    return tuple(p if isinstance(p, Node) else FixedPoint(vector(p, 2, name)) for p in points)


def _check(function: Callable, arguments: tuple[float, ...], part: ForceBetween, call: str) -> None:
    """Refuse a function that is no scalar UFL expression, or not finite at the start."""
    value = value_of(function, arguments, f"{part}: {call}")
    if isinstance(value, complex) or not math.isfinite(value):
        raise SceneError(f"{part}: {call} is {value} at the start, at {arguments[0]:.6g}")


# -- Pulleys with a radius, and ropes over them, as plain data ----------------------------------


# Points on an arc of a picture.
_DRAWN = 17


@dataclass(frozen=True, eq=False)
class Pulley:
    r"""A circle on which a rope lies: a pulley, or at an end of the rope a drum.

    For `Scene.add_rope`. Between two points of the rope a pulley turns freely and has no friction,
    so that the tension is the same on both sides. At an end of the rope the circle is a drum, which
    turns with its node: the rope is wound on it and does not slip. A drum at which one rope ends
    and another one begins is a pulley with inertia, on which the rope does not slip.

    Parameters
    ----------
    at : Node or (x, y)
        The centre: a node of a body or beam, or a fixed position [m].
    radius : float
        Radius R to the middle of the rope [m].
    side : {"left", "right"}
        Side of the rope on which the centre is, looking along the rope from its first point. A rope
        turns to the left around a pulley on its left.

    Raises
    ------
    SceneError
        For a radius that is not positive, or an unknown side.

    Examples
    --------
    Atwood's machine with a pulley of 0.2 m radius, that turns freely.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> loads = [scene.add_body((x, -1), mass=m).centre for x, m in ((-0.2, 1.0), (0.2, 1.5))]
    >>> for load in loads:
    ...     scene.fix(load, "x", "rotation")
    >>> points = [loads[0], fb.Pulley((0, 0), 0.2, side="right"), loads[1]]
    >>> rope = scene.add_rope(points, spring=fb.Spring(1e6))
    >>> print(f"{rope.length_at_start:.4f} m")  # 2 + 0.2 pi
    2.6283 m
    """

    at: Point
    radius: float = real("positive")
    side: str = "left"

    def __post_init__(self):
        errors.check_fields(self)
        require(is_one_of(self.side, ("left", "right")), "Pulley: side", self.side, "left or right")


@dataclass(frozen=True, eq=False, repr=False)
class RopeOverPulleys(ForceBetween):
    """A rope over points of which some are circles; created by `Scene.add_rope`.

    The points are the centres.
    """

    #: Of each point: n for a node, f for a fixed one, N and F for pulleys there, D for a drum.
    kinds: str = ""  # type: ignore[misc]
    #: Radii (n,), positive for a centre on the left of the rope, 0 for points [m].
    radii: np.ndarray = field(default_factory=lambda: np.zeros(0), metadata=IS_DATA)

    def __post_init__(self):
        for i, (way, step) in enumerate(zip(self.apart, self.steps, strict=True)):
            if not math.hypot(*way) > abs(step):
                raise SceneError(
                    f"{self}: points {i} and {i + 1} are {math.hypot(*way):.4g} apart, and the "
                    f"rope has no tangent to both circles. Move them more than {abs(step):.4g} "
                    "apart, or give the other side"
                )
        _ = self.turns  # which says what the rope does not touch

    @property
    def steps(self) -> np.ndarray:
        """Differences (n - 1,) of the radii of neighbours [m]."""
        radii = dual_array(self.radii)
        return scene_number(radii[:-1] - radii[1:])

    def spans(self, ways: Any) -> tuple[Any, Any]:
        """Lengths (n - 1, ...) of the free spans [m], and angles from the centres' lines to them.

        `ways` (n - 1, 2, ...) are the vectors from each centre to the next one [m].
        """
        far = np.hypot(ways[:, 0], ways[:, 1])
        steps = dual_array(self.steps).reshape(-1, *[1] * (far.ndim - 1))
        return np.sqrt(far * far - steps * steps), np.arcsin(steps / far)

    def straight(self, ways: np.ndarray) -> np.ndarray:
        """Vectors (n - 1, 2) of the free spans for those between centres [m]."""
        spans, leans = self.spans(ways)
        ratio, c, s = spans / np.hypot(*ways.T), np.cos(leans), np.sin(leans)
        x, y = ways.T
        return np.stack([ratio * (c * x - s * y), ratio * (s * x + c * y)], axis=1)

    @property
    def turns(self) -> np.ndarray:
        """Angles (n,) of the arcs where the length has no part of drums; less those of `spans`."""
        ways = dual_array(self.apart)
        _, leans = self.spans(ways)
        turns = [0.0 - leans[0]]
        for i, (way, next_way) in enumerate(itertools.pairwise(ways), start=1):
            cross = way[0] * next_way[1] - way[1] * next_way[0]
            turn = np.arctan2(cross, way[0] * next_way[0] + way[1] * next_way[1])
            turns.append(turn + self._full_turns(i, turn + leans[i] - leans[i - 1]))
        return real_array([*turns, leans[-1]])

    def _full_turns(self, i: int, turn: Any) -> float:
        """Full turns [rad] that make an arc positive on its side; SceneError if none touches."""
        radius = float(self.radii[i])
        if not radius:
            return 0.0
        arc = float(floats(turn)) * math.copysign(1.0, radius)
        wrap = arc % (2 * math.pi)
        if wrap > 1.5 * math.pi:
            side = "left" if radius > 0 else "right"
            raise SceneError(
                f"{self}: the rope passes the pulley at point {i} on its other side, or does not "
                f"touch it: with side={side!r} its arc would be {arc - 2 * math.pi * (arc > 0):.3g}"
                " rad. Give the other side, or move the pulley"
            )
        return math.copysign(wrap - arc, radius) if abs(wrap - arc) > 1e-9 else 0.0

    @property
    def numbers(self) -> list[float]:
        """Ways between centres, and of each circle the radius and the arc at the start."""
        circles = [i for i, kind in enumerate(self.kinds) if kind in "NFD"]
        circle_numbers = [x for i in circles for x in (self.radii[i], self.turns[i])]
        return [*(x for way in self.apart for x in way), *circle_numbers]

    @property
    def length_at_start(self) -> float:
        """Free spans and arcs at the start, without what is wound on drums [m]."""
        spans, leans = self.spans(self.apart)
        bent = (self.turns * self.radii).sum() + (self.steps * leans).sum()
        return float(floats(spans.sum() + bent))

    @property
    def drums(self) -> list[tuple[int, float]]:
        """Numbers of the nodes of drums, and how much rope their rotations let in [m/rad]."""
        ends = (0, -self.radii[0]), (-1, self.radii[-1])
        return [(self.nodes[i], float(r)) for i, r in ends if self.kinds[i] == "D"]

    @property
    def geometry(self) -> list[float]:
        """Ways between centres, then radii (n,) and arcs (n,) at the start."""
        return [*super().geometry, *self.radii, *self.turns]

    def _circles(self, numbers: Any) -> tuple[Any, Any, Any]:
        """Radii (n,), their steps (n - 1,) and arcs (n,) at the start, of numbers."""
        n = len(self.points)
        radii, turns = numbers[-2 * n : -n], numbers[-n:]
        return radii, radii[:-1] - radii[1:], turns

    def arcs(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> list:
        """Angles (n,) about each centre to the left, of drums since the start [rad].

        `counted` (..., n - 1) are half turns of the spans [rad], from which their angles are less
        than one; None for none.
        """
        _, steps, turns = self._circles(numbers)
        angles, leans = [], []
        for i, (x, y) in enumerate(self.vectors(numbers, moved)):
            X, Y = numbers[2 * i], numbers[2 * i + 1]
            half = 0.0 if counted is None else np.pi * np.round(counted[..., i] / np.pi)
            sign = np.cos(half)  # of the direction from which the angle is measured
            cross, along = sign * (X * y - Y * x), sign * (X * x + Y * y)
            angles.append(half + np.arctan2(cross, along))
            leans.append(np.arcsin(steps[i] / np.hypot(x, y)))
        arcs = [angles[0] + leans[0] - turned[0]]
        for i, (old, new) in enumerate(itertools.pairwise(angles)):
            arcs.append(new - old + leans[i + 1] - leans[i])
        arcs.append(turned[1] - angles[-1] - leans[-1])
        return [arc + turns[i] for i, arc in enumerate(arcs)]

    def length(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> Any:
        """Sum of free spans and arcs [m], with half turns as of `arcs`."""
        radii, steps, _ = self._circles(numbers)
        ways = zip(self.vectors(numbers, moved), steps, strict=True)
        arcs = enumerate(self.arcs(numbers, moved, turned, counted))
        spans = sum(np.sqrt(x * x + y * y - step * step) for (x, y), step in ways)
        return spans + sum(radii[i] * arc for i, arc in arcs if self.radii[i])

    def rate(self, numbers: Any, moved: Sequence, rates: Sequence, spins: Sequence) -> Any:
        """Rate of the length [m/s]."""
        radii, steps, _ = self._circles(numbers)
        total = radii[-1] * spins[1] - radii[0] * spins[0]
        for (x, y), (vx, vy), step in zip(self.vectors(numbers, moved), rates, steps, strict=True):
            square = x * x + y * y
            span = np.sqrt(square - step * step)
            total = total + ((span * x - step * y) * vx + (step * x + span * y) * vy) / square
        return total

    def outline(self, centres: np.ndarray) -> np.ndarray:
        """Points (..., m, 2) along the rope for centres (n, ..., 2)."""
        ways = np.moveaxis(np.diff(centres, axis=0), -1, 1)
        _, leans = self.spans(ways)
        angles = np.arctan2(ways[:, 1], ways[:, 0]) + leans
        points = []
        for i, radius in enumerate(self.radii.tolist()):
            first_angle, last_angle = angles[max(i - 1, 0)], angles[min(i, len(angles) - 1)]
            arc = np.copysign((last_angle - first_angle) * np.sign(radius) % (2 * np.pi), radius)
            if i in (0, len(angles)):
                arc = 2 * np.pi  # a drum is a circle
            for share in np.linspace(0, 1, _DRAWN if radius else 1):
                angle = first_angle + share * arc
                arm = radius * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
                points.append(centres[i] + arm)
        return np.stack(points, axis=-2)


def rope_parts(points: Sequence[Point | Pulley]) -> tuple[list[Point], str, np.ndarray]:
    """Centres of points and pulleys of a rope, and the rest of a `RopeOverPulleys`."""
    centres, kinds, radii = list[Point](), "", list[float]()
    for i, point in enumerate(points):
        centre = point.at if isinstance(point, Pulley) else point
        radius = 0.0
        if isinstance(point, Pulley):
            radius = point.radius if point.side == "left" else -point.radius
        kind = "n" if isinstance(centre, Node) else "f"
        if radius:
            is_at_end = i in (0, len(points) - 1) and kind == "n"
            kind = "D" if is_at_end else kind.upper()
        centres.append(centre)
        kinds += kind
        radii.append(radius)
    return centres, kinds, real_array(radii)


# -- Holds of nodes and beams by the ground: springs, dampers, friction, stops and beds ---------


@dataclass(frozen=True, eq=False, repr=False)
class GroundSpring(ForceBetween):
    """A spring, damper, friction and stops between a node or a beam and the ground.

    Created by `Scene.add_spring` and `Scene.add_bed`. It acts on the displacement along one
    direction, or on the rotation of a node. On a beam all laws are per length.

    Parameters
    ----------
    points : tuple of Node
        The node, or the nodes of the beam.
    on : Coordinate
        Spring, damper, friction and stops on the displacement or rotation.
    force : callable, optional
        None: the laws are those of `on`.
    number : int
        Index in the scene's forces between points.
    own : tuple of str
        Names of parameters that belong to this force only.
    target : Node or Beam
        The node or beam that is held.
    direction : (2,) float or None
        Direction of the displacement: of a node along x and y, of a beam along its axis and to the
        left of it; None for the rotation.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=0.1, name="ball").centre
    >>> print(scene.add_spring(ball, y=fb.Spring(100.0)).y)
    force 0, between node 0 at (0, 0) and the ground along (0, 1)
    """

    to_ground: ClassVar[bool] = True
    target: Node | Beam = None  # type: ignore[assignment]
    direction: np.ndarray | None = field(default=None, metadata=IS_DATA)

    @property
    def is_bed(self) -> bool:  # type: ignore[override]
        """Whether it holds the nodes of a beam."""
        return isinstance(self.target, Beam)

    @property
    def geometry(self) -> list[float]:
        """Its direction; nothing for a rotation."""
        return [] if self.direction is None else [*self.direction]

    def __str__(self):
        number = "" if self.number < 0 else f"force {self.number}, "
        way = "against rotation"
        if self.direction is not None:
            way = "along ({:.4g}, {:.4g})".format(*self.direction)
            if isinstance(self.target, Beam):
                way = "along it" if self.direction[0] else "across it"
                return f"{number}bed of beam {self.target.name!r} {way}"
        return f"{number}between {self.target} and the ground {way}"

    def ways(self, positions: np.ndarray) -> np.ndarray:
        """Directions of the displacements of the nodes.

        Parameters
        ----------
        positions : (n, 2) float
            Reference positions of the nodes [m].

        Returns
        -------
        (n, 2) float array
            Unit vectors.
        """
        assert self.direction is not None
        if isinstance(self.target, Node):
            return self.direction[None]
        padded = np.concatenate([positions[:1], positions, positions[-1:]])
        chords = padded[2:] - padded[:-2]
        x, y = chords.T / np.hypot(*chords.T)
        forwards, left = self.direction
        return np.stack([forwards * x - left * y, forwards * y + left * x], axis=1)

    @property
    def lengths(self) -> np.ndarray:
        """Lengths (n,) of the beam that belong to its nodes [m]; 1 for a node."""
        return points_of(self.target).lengths


class GroundSprings(NamedTuple):
    """Springs of a node to the ground along x and y, and against rotation.

    Returned by `Scene.add_spring`.

    Parameters
    ----------
    x, y, rotation : GroundSpring or None
        The spring of each direction, for `Solution.joint`, `Output` and `Scene.remove`; None where
        there is no spring.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    >>> held = scene.add_spring(ball, x=fb.Spring(100.0), rotation=fb.Spring(5.0))
    >>> held.y is None, held.x.on.spring.stiffness
    (True, 100.0)
    """

    x: GroundSpring | None = None
    y: GroundSpring | None = None
    rotation: GroundSpring | None = None


class Bed(NamedTuple):
    """Springs of a beam to the ground, across the beam and along it.

    Returned by `Scene.add_bed`.

    Parameters
    ----------
    normal, tangential : GroundSpring or None
        The spring of each direction, for `Solution.joint`, `Output` and `Scene.remove`; None where
        there is no spring.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> rail = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), name="rail")
    >>> print(scene.add_bed(rail, normal=100.0).normal)
    force 0, bed of beam 'rail' across it
    """

    normal: GroundSpring | None = None
    tangential: GroundSpring | None = None


#: Names of laws in `Coordinate` by their kinds.
_LAWS = {Spring: "spring", Damper: "damper", SmoothFriction: "friction", Stop: "stop"}


def _coordinate(laws, name: str, beginning: float = 0.0) -> Coordinate:
    """Laws of a displacement or rotation since its `beginning`; SceneError for no law."""
    law_list = laws if isinstance(laws, list | tuple) else [laws]
    names = [_LAWS.get(type(law), "") for law in law_list]
    ok = bool(law_list) and all(names) and len({*names}) == len(names)
    expected = "an fx_beam.Spring, Damper, SmoothFriction or Stop, or a list with one of each"
    require(ok, name, laws, expected)
    if beginning:
        law_list = [_since(beginning, law) for law in law_list]
    return Coordinate(**dict(zip(names, law_list, strict=True)))


def _since(beginning: float, law: Any) -> Any:
    """A law of a displacement that is zero at a beginning, as one of the displacement itself."""
    if isinstance(law, Spring):
        return replace(law, rest=law.rest + beginning)
    if isinstance(law, Stop):
        limits = {"lower": law.lower, "upper": law.upper}
        return replace(law, **{n: x + beginning for n, x in limits.items() if x is not None})
    return law


def ground_spring(
    node: Node, laws, direction: np.ndarray | None, name: str, beginning: float = 0.0
) -> GroundSpring:
    """A spring to the ground along a direction or on the rotation, from a `beginning` on."""
    coordinate = _coordinate(laws, name, beginning)
    spring = GroundSpring((node,), coordinate, target=node, direction=direction)
    what = "the rotation" if direction is None else "the displacement"
    check_at_start(spring, beginning, 1e-12 * abs(beginning), what)
    return spring


def parts_of_bed(
    beam: Beam, normal: float, tangential: float, pushes_only: bool, law=None
) -> dict[str, GroundSpring]:
    """Springs across a beam and along it, by their names in `Bed`; across it by a law, if any."""
    parts, up, forwards = dict[str, GroundSpring](), np.array([0.0, 1.0]), np.array([1.0, 0.0])
    if law is None and normal:
        law = Stop(0.0, None, normal) if pushes_only else Spring(normal)
    if law is not None:
        name = f"bed of beam {beam.name!r}: law"
        across = _coordinate(law, name)
        spring, damper, friction = across.spring, across.damper, across.friction
        remembers = spring is not None and spring.internal is not None
        has_law = damper is not None and damper.law is not None
        has_law |= isinstance(friction, SmoothFriction) and callable(friction.force)
        expected = "without internal variables, and dampers and friction without functions"
        require(not (remembers or has_law), name, law, expected)
        parts["normal"] = GroundSpring(beam.nodes, across, target=beam, direction=up)
        check_at_start(parts["normal"], 0.0, 0.0, "the displacement")
    if tangential:
        along = Coordinate(Spring(tangential))
        parts["tangential"] = GroundSpring(beam.nodes, along, target=beam, direction=forwards)
    return parts
