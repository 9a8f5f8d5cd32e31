"""Obstacles: shapes, fixed or carried by a node, and members, that points cannot enter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from fx_beam import errors
from fx_beam.dual import dual_array, scene_number
from fx_beam.errors import IS_DATA, SceneError, as_float, flag, is_number, real, require, shown

from .beam import Beam, Node, gauss_rule, lagrange, position_of, reference_positions
from .coordinate import Coulomb, OneSided
from .functions import Numbers
from .joints import GROUND, direction
from .law import Energy, check_energy
from .loads import label
from .parameters import value_of

# Lengths that belong to the nodes of an element, by its degree, relative to its own: the weights of
# the rule that integrates the nodes' polynomials.
_SHARES = {1: np.array([1, 1]) / 2, 2: np.array([1, 4, 1]) / 6, 3: np.array([1, 3, 3, 1]) / 8}
# Most integration points in an element.
_MOST_POINTS = 50
#: A point, or a node that carries a shape, as users give it.
Place = Node | Sequence[float] | np.ndarray
_Two = tuple[np.ndarray, np.ndarray]

# Iterations for the nearest point of a piece; pieces that may have it, from the nearest node.
_ITERATIONS, _ABOUT = 26, np.arange(-1, 2)
# Up to so many pairs of points and nodes the distances of all are computed.
_PAIRS = 100_000


def _place(place: Place, name: str) -> Node | tuple[float, float]:
    """A node that carries a shape, or the point (x, y) of one that is fixed."""
    if isinstance(place, Node) and place is not GROUND:
        return place
    errors.refuse_units(place)
    if not isinstance(place, list | tuple | np.ndarray):
        expected = "(x, y), or a node that carries it: beam.end, body.centre, body[name]"
        words = "the ground" if place is GROUND else shown(place)
        raise SceneError(f"{name} = {words} must be {expected}")
    x, y = map(as_float, errors.vector(place, 2, name))
    return x, y


@dataclass(frozen=True)
class Shape:
    """A shape that points cannot enter: a frozen dataclass, whose first field is its place.

    The place is a point (x, y), or a node that carries it. `laws/gaps.py` has its gap over a step,
    by its name.
    """

    #: -1 where points stay inside.
    side: ClassVar[float] = 1.0

    def __post_init__(self):
        name = self._place
        object.__setattr__(self, name, _place(getattr(self, name), f"{self.name}: {name}"))

    @property
    def name(self) -> str:
        """Name of the class."""
        return type(self).__name__

    @property
    def _place(self) -> str:
        return fields(self)[0].name

    @property
    def carrier(self) -> Node | None:
        """The node that carries the shape; None if it is fixed."""
        place = getattr(self, self._place)
        return place if isinstance(place, Node) else None

    @property
    def origin(self) -> tuple[float, float]:
        """Place (x, y) in the reference configuration [m]."""
        return position_of(getattr(self, self._place))

    def at(self, place: Node | tuple[float, float]) -> Self:
        """A shape like this one at another place."""
        return replace(self, **{self._place: place})

    def gap(self, positions) -> np.ndarray:
        """Distances of positions from the shape in its reference configuration.

        Parameters
        ----------
        positions : (..., 2) float
            Positions [m].

        Returns
        -------
        (...) float
            Distance [m]; negative on the side that is not allowed.
        """
        checked = errors.real_array(positions)
        ok = checked.ndim > 0 and checked.shape[-1] == 2
        require(ok, f"{self.name}.gap: positions", positions, "positions (x, y)")
        return scene_number(self.seen(checked - dual_array(self.origin))[0])

    @property
    def gap_numbers(self) -> tuple[float, ...]:
        """Numbers of the shape in the law of the gap."""
        raise NotImplementedError

    def seen(self, arms: np.ndarray, turn: Numbers = 0.0) -> _Two:
        """Distances (...) and directions (..., 2) to the free side, of arms (..., 2) from it.

        It has turned by an angle (...) [rad].
        """
        raise NotImplementedError

    def check_room(self, radius: float, name: str) -> None:
        """Refuse a shape in which what touches has no room."""

    def outline(self, positions: np.ndarray, size: float, margin: float) -> _Two:
        """Points (n, 2) of a fixed shape near positions, and directions away from the free side.

        It is whole up to a size, else it reaches a length beyond the positions.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Line(Shape):
    """A straight wall, fixed or carried by a node; contact keeps nodes on the side of the normal.

    Parameters
    ----------
    point : (x, y) or Node
        A point of the wall [m]; or a node of a beam or body, with which the wall moves and turns.
    normal : (x, y)
        Direction from the wall to the free side, of any length, in the reference configuration.

    Raises
    ------
    SceneError
        For a normal without direction, or values that are not finite.

    Examples
    --------
    >>> import fx_beam as fb
    >>> floor = fb.Line((0, -1), normal=(0, 2))
    >>> float(floor.gap((5.0, 0.5)))
    1.5
    """

    point: Place = field(metadata=IS_DATA)
    normal: Sequence[float] | np.ndarray = field(metadata=IS_DATA)

    def __post_init__(self):
        super().__post_init__()
        normal = direction(self.normal, "Line: normal")
        object.__setattr__(self, "normal", tuple(map(as_float, normal)))

    @property
    def gap_numbers(self) -> tuple[float, ...]:
        """The normal."""
        return tuple(self.normal)

    def seen(self, arms: np.ndarray, turn: Numbers = 0.0) -> _Two:
        """Distances, and the normal."""
        (x, y), c, s = self.normal, np.cos(turn), np.sin(turn)
        normals = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        return (arms * normals).sum(axis=-1), np.broadcast_to(normals, arms.shape)

    def outline(self, positions: np.ndarray, size: float, margin: float) -> _Two:
        """The two ends of the part past the positions."""
        x, y = self.normal
        tangent = np.array([-y, x])
        s = (positions - self.origin) @ tangent
        reach = np.array([s.min() - margin, s.max() + margin])
        return self.origin + reach[:, None] * tangent, np.tile((-x, -y), (2, 1))


@dataclass(frozen=True)
class Circle(Shape):
    """A circle, fixed or carried by a node; contact keeps nodes outside, or inside.

    Parameters
    ----------
    centre : (x, y) or Node
        The centre [m]; or a node of a beam or body, with which the circle moves.
    radius : float
        Radius [m].
    inside : bool
        Whether nodes stay inside.

    Raises
    ------
    SceneError
        For a radius that is not positive, or values that are not finite.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Circle((0, 0), 2.0).gap([(3.0, 0.0), (0.0, 1.0)])
    array([ 1., -1.])
    """

    centre: Place = field(metadata=IS_DATA)
    radius: float = real("positive")
    inside: bool = flag(default=False)

    def __post_init__(self):
        super().__post_init__()
        errors.check_fields(self)

    @property
    def side(self) -> float:  # type: ignore[override]
        """-1 where points stay inside."""
        return -1.0 if self.inside else 1.0

    @property
    def gap_numbers(self) -> tuple[float, ...]:
        """Radius and side."""
        return self.radius, self.side

    def seen(self, arms: np.ndarray, turn: Numbers = 0.0) -> _Two:
        """Distances, and directions from the centre, or towards it inside."""
        distance = np.hypot(*np.moveaxis(arms, -1, 0))
        directions = self.side * arms / np.maximum(distance, 1e-300)[..., None]
        return self.side * (distance - self.radius), directions

    def check_room(self, radius: float, name: str) -> None:
        """Refuse a circle that is smaller than the one inside."""
        if self.inside and self.radius <= radius:
            raise SceneError(f"{name}: its radius {self.radius:g} must be above the inner one's")

    def outline(self, positions: np.ndarray, size: float, margin: float) -> _Two:
        """Points of the circle or of its near part."""
        middle, half = 0.0, np.pi
        if self.radius > size:
            arms = positions - self.origin
            middle = np.arctan2(*arms.mean(axis=0)[::-1])
            angles = np.angle(np.exp(1j * (np.arctan2(*arms.T[::-1]) - middle)))
            half = min(np.pi, abs(angles).max() + margin / self.radius)
        angle = middle + np.linspace(-half, half, 181)
        directions = np.column_stack([np.cos(angle), np.sin(angle)])
        return self.origin + self.radius * directions, -self.side * directions


@dataclass(frozen=True, eq=False)
class Contact(OneSided):
    """Contact of a node, or of points of a beam, with a line, a circle or a beam.

    Created by `Scene.add_contact`.

    Parameters
    ----------
    target : Node or Beam
        The node or beam that touches the shape.
    shape : Line, Circle or Beam
        The line or circle, fixed or carried by a node; or the other beam.
    stiffness : float
        Stiffness of the contact of a node [N/m], or of a beam, per length [N/m^2]; 1 with an
        energy.
    restitution : float
        Coefficient of restitution e.
    speed : float, optional
        Speed below which the loss is viscous [m/s].
    number : int
        Number among the scene's contacts.
    energy : callable, optional
        Stored energy as a function of the depth, in the place of a stiffness.
    radius : float or pair
        Half of the thickness of a beam, or radius of a ball around a node [m]; between members a
        pair, one for each.
    along : int, optional
        Number of points in each element of a beam that may touch; by default its nodes.
    friction : Coulomb, optional
        Friction that sticks.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 1), (1, 1)], fb.Section(EA=1.0, GA=1.0, EI=1.0), name="bar")
    >>> print(scene.add_contact(beam, fb.Line((0, 0), normal=(0, 1)), stiffness=1e3))
    contact 0, Line for beam 'bar'
    """

    target: Node | Beam
    shape: Shape | Beam
    stiffness: float = real("positive")
    restitution: float = real("not negative", default=1.0)
    speed: float | None = real("positive", optional=True, default=None)
    number: int = -1
    energy: Energy | None = field(default=None, metadata=IS_DATA)
    radius: float | tuple[float, float] = field(default=0.0, metadata=IS_DATA)
    along: int | None = None
    friction: Coulomb | None = None

    def __post_init__(self):
        if not isinstance(self.shape, Shape | Beam):
            raise SceneError(
                f"a contact needs an fx_beam.Line, an fx_beam.Circle or a beam, not "
                f"{shown(self.shape)}. A body has none of its own: give it one, such as "
                "fx_beam.Circle(body.centre, radius)"
            )
        name, along, friction = f"contact of {label(self.target)}", self.along, self.friction
        check_energy(self.energy, None, name, ("d",), "energy")
        if self.energy is not None:
            values = [value_of(self.energy, [d], f"{name}: energy(d)") for d in (0.0, 1e-6)]
            rises = all(map(is_number, values)) and as_float(values[1]) >= as_float(values[0])
            expected = "finite, and rise with the depth d"
            require(rises, f"{name}: energy(d) at d = 0 and 1e-6", values, expected)
        self._check_impact(name)
        if isinstance(self.shape, Beam):
            radius: float | tuple[float, float] = _checked_radii(name, self.radius)
        else:
            radius = errors.finite(self.radius, f"{name}: radius", "not negative")
        if along is not None:
            ok = isinstance(self.target, Beam)
            require(ok, f"{name}: along", along, "None, as a node has no length")
            expected = f"a whole number from 1 to {_MOST_POINTS}, or None"
            require(errors.is_whole(along, 1, _MOST_POINTS), f"{name}: along", along, expected)
            along = int(along)
        ok = friction is None or (isinstance(friction, Coulomb) and friction.radius is None)
        expected = "an fx_beam.Coulomb(mu, stiffness), none that has the radius of a pin, or None"
        require(ok, f"{name}: friction", friction, expected)
        vars(self).update(radius=radius, along=along)

    def __repr__(self):
        unit = "N/m^2" if isinstance(self.target, Beam) else "N/m"
        law = f"stiffness {self.stiffness:g} {unit}" if self.energy is None else "energy of its own"
        return f"<{self}, {law}>"

    def __str__(self):
        number = "" if self.number < 0 else f"contact {self.number}, "
        if isinstance(self.shape, Beam):
            other = "itself" if self.shape is self.target else label(self.shape)
            return f"{number}{label(self.target)} against {other}"
        carrier = f" on {self.shape.carrier}" if self.shape.carrier is not None else ""
        return f"{number}{self.shape.name}{carrier} for {label(self.target)}"

    @property
    def radii(self) -> float:
        """Half thickness or radius of the target; between members the sum of both [m]."""
        return float(np.sum(self.radius))

    @property
    def apart(self) -> float:
        """Least distance along a beam of two of its points that may touch each other [m]."""
        longest = np.hypot(*np.diff(reference_positions(self.target), axis=0).T).max(initial=0.0)
        return float(np.pi / 2 * self.radii + 2 * longest)

    @property
    def variables(self) -> int:
        """Number of internal variables of its friction with a shape: two for each point."""
        sticks = self.friction is not None and not isinstance(self.shape, Beam)
        return 2 * len(self.points.lengths) if sticks else 0

    @property
    def points(self) -> Points:
        """The points that touch it."""
        return points_of(self.target, self.along)


class Points(NamedTuple):
    """Points of a node or a beam, x = sum N_a x_a over all nodes, also inside elements."""

    #: Nodes (points, n) of each point, by their place along the beam, and weights (points, n).
    nodes: np.ndarray
    weights: np.ndarray
    #: Length (points,) of the beam that belongs to each point [m]; 1 for a node.
    lengths: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (..., points, k) at the points, from values (..., nodes, k) at the nodes."""
        return np.sum(self.weights[..., None] * values[..., self.nodes, :], axis=-2)


def points_of(target: Node | Beam, along: int | None = None) -> Points:
    """The points of a node, or of a beam at its nodes or `along` its elements."""
    if not isinstance(target, Beam):
        return Points(np.zeros((1, 1), dtype=int), np.ones((1, 1)), np.ones(1))
    degree, lengths = target.degree, np.diff(target.s)
    nodes = degree * np.arange(target.elements)[:, None] + np.arange(degree + 1)
    if along is None:
        shares = np.bincount(nodes.ravel(), np.outer(lengths, _SHARES[degree]).ravel())
        return Points(np.arange(len(shares))[:, None], np.ones((len(shares), 1)), shares)
    points, shares = gauss_rule(along)
    weights = np.tile(lagrange(np.linspace(0, 1, degree + 1), points), (target.elements, 1))
    return Points(np.repeat(nodes, along, axis=0), weights, np.outer(lengths, shares).ravel())


def _checked_radii(name: str, radius) -> tuple[float, float]:
    """Half thicknesses: of the target, and of the member that it touches; a number is for both."""
    pair = (radius, radius) if is_number(radius) else radius
    pair = tuple(pair) if getattr(pair, "ndim", 0) == 1 else pair
    ok = isinstance(pair, tuple | list) and len(pair) == 2 and all(map(is_number, pair))
    ok = ok and min(map(as_float, pair)) >= 0 and sum(map(as_float, pair)) > 0
    expected = "half of the thickness of the members, positive, or a pair of both"
    require(ok, f"{name}: radius", radius, expected)
    first, second = map(as_float, pair)
    return first, second


def check_start(contact: Contact, size: float) -> None:
    """SceneError if the target starts behind a shape, in a scene of this size [m]."""
    target, shape = contact.target, contact.shape
    assert isinstance(shape, Shape)
    shape.check_room(contact.radii, str(contact))
    nodes = target.nodes if isinstance(target, Beam) else (target,)
    if shape.carrier is not None and shape.carrier in nodes:
        raise SceneError(
            f"{contact}: {shape.carrier} carries the {shape.name.lower()} and belongs to "
            "what it should stop. Let a node of another member or body carry it"
        )
    positions = reference_positions(contact.target)
    points = contact.points.of(positions)
    gaps = shape.gap(points) - contact.radii
    deepest = int(np.argmin(gaps))
    if gaps[deepest] < -1e-9 * max(size, float(np.ptp(positions, axis=0).max())):
        x, y = points[deepest]
        raise SceneError(
            f"{contact}: the {'node' if contact.along is None else 'point'} at ({x:.6g}, {y:.6g}) "
            f"starts {-gaps[deepest]:.4g} behind it. Move it, or give the other side: the opposite "
            "normal of a Line, or inside of a Circle"
        )


class Nearest(NamedTuple):
    """The nearest points of a member for points (..., m)."""

    distance: np.ndarray
    #: Node of the member next to the nearest point.
    node: np.ndarray
    #: The nearest point (..., m, 2).
    point: np.ndarray


def may_be_nearer(points: np.ndarray, nodes: np.ndarray, distance: float) -> np.ndarray:
    """Which points (m,) may be nearer to a member with nodes (n, 2) than a distance [m].

    A piece lies within half an arm of its node.
    """
    arm = np.hypot(*np.diff(nodes, axis=0).T).max()
    square = ((points - nodes[_nearest_node(points, nodes)]) ** 2).sum(axis=-1)
    return square < (distance + arm / 2) ** 2


def _nearest_node(
    points: np.ndarray, nodes: np.ndarray, apart: float = 0.0, arc: np.ndarray | None = None
) -> np.ndarray:
    """Numbers (..., m) of the nodes that are nearest to points, as `nearest` has them."""
    if points.shape[-2] * nodes.shape[-2] <= _PAIRS:
        square = ((points[..., None, :] - nodes[..., None, :, :]) ** 2).sum(axis=-1)
        if arc is not None:
            square[..., abs(arc[:, None] - arc) < apart] = np.inf
        return np.argmin(square, axis=-1)
    if nodes.ndim > 2:
        rows = zip(points, nodes, strict=True)
        return np.array([_nearest_node(*row, apart, arc) for row in rows])
    from scipy.spatial import cKDTree  # loaded for large members alone

    count = 2  # of two that are as near the first one is the nearest
    if arc is not None:  # more of them may be left out
        ends = np.searchsorted(arc, arc + apart, "right") - np.searchsorted(arc, arc - apart)
        count += int(ends.max())
    distance, node = cKDTree(nodes).query(points, min(count, len(nodes)))
    if arc is not None:
        distance[abs(arc[:, None] - arc[node]) < apart] = np.inf
    is_least = distance <= distance.min(axis=1, keepdims=True)
    return np.where(is_least, node, len(nodes)).min(axis=1)


def nearest(
    points: np.ndarray,
    nodes: np.ndarray,
    apart: float = 0.0,
    arc: np.ndarray | None = None,
    closed: bool = False,
) -> Nearest:
    """The nearest points of a member with nodes (..., n, 2) to points (..., m, 2).

    If the points are its own nodes, with arc lengths `arc` (n,), parts that are less than `apart`
    away along the member are left out. The last node of a `closed` member is its first.
    """
    nodes, count = (nodes[..., :-1, :] if closed else nodes), nodes.shape[-2] - 1
    node = _nearest_node(points, nodes, apart, arc)[..., None] + _ABOUT
    node = node % count if closed else np.clip(node, 0, count)
    piece_points = _on_pieces(points[..., None, :], nodes[..., None, :, :], node, closed)
    distance = np.hypot(*np.moveaxis(piece_points - points[..., None, :], -1, 0))
    if arc is not None:
        left_out = abs(arc[:, None] - arc[node]) < apart
        distance[left_out], piece_points[left_out] = np.inf, np.nan
    best = np.argmin(distance, axis=-1)[..., None]
    distance, node = (np.take_along_axis(values, best, -1)[..., 0] for values in (distance, node))
    return Nearest(distance, node, np.take_along_axis(piece_points, best[..., None], -2)[..., 0, :])


def _on_pieces(points: np.ndarray, nodes: np.ndarray, node: np.ndarray, closed: bool) -> np.ndarray:
    """Points (..., m, k, 2) of the pieces about nodes (..., m, k) that are nearest to points.

    The points are (..., m, 1, 2), and all nodes (..., 1, n, 2).
    """
    count = nodes.shape[-2]
    begins, ends = ((node == end) & (not closed) for end in (0, count - 1))
    sides = ((node + k) % count for k in _ABOUT)
    last_nodes, middle, next_nodes = (np.take_along_axis(nodes, k[..., None], -2) for k in sides)
    last_nodes = np.where(begins[..., None], 2 * middle - next_nodes, last_nodes)
    next_nodes = np.where(ends[..., None], 2 * middle - last_nodes, next_nodes)
    bend, slope = (last_nodes - 2 * middle + next_nodes) / 2, (next_nodes - last_nodes) / 2
    value = middle + bend / 4 - points
    low, high = np.where(begins, 0.0, -0.5), np.where(ends, 0.0, 0.5)
    for _ in range(_ITERATIONS):  # bisection: the derivative of the distance has one zero
        x = (low + high) / 2
        residual = value + x[..., None] * (slope + x[..., None] * bend)
        rises = (residual * (slope + 2 * x[..., None] * bend)).sum(axis=-1) > 0
        low, high = np.where(rises, low, x), np.where(rises, x, high)
    x = ((low + high) / 2)[..., None]
    return points + value + x * (slope + x * bend)


def check_members(contact: Contact, size: float) -> None:
    """SceneError if members of a scene of this size [m] touch at the start, or cannot."""
    a, b = contact.target, contact.shape
    assert isinstance(b, Beam)
    if isinstance(a, Node) and a in b.nodes:
        raise SceneError(f"{contact}: the node belongs to the member. Give a node of another one")
    if contact.along is not None:
        raise SceneError(
            f"{contact}: along = {contact.along}, but members touch at their nodes: omit it"
        )
    pairs = [(a, b)] if a is b or not isinstance(a, Beam) else [(a, b), (b, a)]
    for touching, member in pairs:
        points, nodes = reference_positions(touching), reference_positions(member)
        arc = arc_of(nodes) if touching is member else None
        if arc is None:
            points = points[may_be_nearer(points, nodes, contact.radii)]
            if not len(points):
                continue
        gaps = nearest(points, nodes, contact.apart, arc).distance - contact.radii
        deepest = int(np.argmin(gaps))
        if gaps[deepest] < -1e-9 * size:
            x, y = points[deepest]
            other = "itself" if touching is member else label(member)
            raise SceneError(
                f"{contact}: the members overlap at the start: at ({x:.6g}, {y:.6g}) "
                f"{label(touching)} lies {-gaps[deepest]:.4g} deep in {other}. Move one of them, "
                "or give a smaller radius. Members that are joined overlap at their joint"
            )


def arc_of(nodes: np.ndarray) -> np.ndarray:
    """Places (n,) of nodes (n, 2) along a member, by straight pieces."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(nodes, axis=0).T))])
