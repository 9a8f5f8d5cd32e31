"""Nodes and beams: the geometry of a scene."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fx_beam import errors
from fx_beam.dual import MaybeDual, dual_array, floats, scene_number
from fx_beam.errors import IS_DATA, SceneError, answering, as_float, is_whole, require, shown

#: Components of a node's motion, in the order used in all arrays.
COMPONENTS = ("x", "y", "rotation")
#: Largest number of elements of a beam.
MOST_ELEMENTS = 1_000_000
#: Number of elements of a beam by default, by their degree.
USUAL_ELEMENTS = {1: 16, 2: 4, 3: 2}
# Largest number of elements of a beam whose layout is kept for others.
_MOST_KNOWN = 10_000


@answering
@dataclass(frozen=True)
class Node:
    """A mesh node at the end of an element; created by `Scene.add_beam`.

    Nodes are identified by number, not by position: nodes of different beams may coincide without
    being connected.

    Parameters
    ----------
    number : int
        Row of the node in the scene's arrays.
    x, y : float
        Reference position [m].
    scene : object
        The scene to which the node belongs.

    Examples
    --------
    >>> import fx_beam as fb
    >>> beam = fb.Scene().add_beam([(0, 0), (2, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0), 4)
    >>> print(beam.end)
    node 4 at (2, 0)
    """

    number: int
    x: float
    y: float
    scene: object = field(repr=False, compare=False, default=None)

    def __str__(self):
        return f"node {self.number} at ({self.x:g}, {self.y:g})"

    def __copy__(self):
        return self

    def __getstate__(self):
        # A scene that is copied or unpickled sets itself in its nodes.
        return {**self.__dict__, "scene": None}


def no_node(value: object) -> SceneError:
    """The error of a value in the place of a node."""
    return SceneError(
        f"{shown(value)} is not a node; take one from a beam: beam.start, beam.end or "
        "beam.node(fraction), or from a body: body.centre or body[name]"
    )


class Nodes(list[Node]):
    """Nodes in order; some are measured, in a box."""

    def __init__(self) -> None:
        super().__init__()
        # Number of the nodes that were measured, and their smallest and largest coordinates [m].
        self._measured = 0
        self._box = math.inf, math.inf, -math.inf, -math.inf

    @property
    def size(self) -> float:
        """Larger side of the box of all nodes [m]; 1 for a single node, as in `Mesh.size`."""
        if new := self[self._measured :]:
            x, y = [node.x for node in new], [node.y for node in new]
            left, low, right, high = self._box
            self._box = min(left, *x), min(low, *y), max(right, *x), max(high, *y)
            self._measured = len(self)
        left, low, right, high = self._box
        return max(right - left, high - low) or 1.0

    def add(self, x: float, y: float, scene: object) -> Node:
        """A new node of a scene at a place [m]."""
        if not type(x) is type(y) is float:
            x, y = as_float(x), as_float(y)
        node = Node(len(self), x, y, scene)
        self.append(node)
        return node


@answering
@dataclass(frozen=True, repr=False)
class Beam:
    """A beam along a polyline with rigid corners, or along a curve; created by `Scene.add_beam`.

    Parameters
    ----------
    name : str
        Name in messages and pictures.
    nodes : tuple of Node
        The ends of the elements, in order.
    degree : int
        Polynomial degree of displacement and rotation, 1 to 3.
    s : (elements + 1,) float
        Arc length at the nodes, from the start [m].
    section : Section
        Cross-section; None in a solution that was read from a file.
    inner : (elements, degree - 1, 2) float, optional
        Positions of the nodes inside the elements of a curved beam [m]; None for straight elements.
        With degree 3 they lie near the curve, not on it.
    fractions : (elements + 1,) float, optional
        Fractions at which `node` gives the nodes; by default those of the arc length.
    carriers : tuple of Node
        With an offset of the axis: the nodes on the line of the points of `add_beam`, which carry
        the nodes of the axis by rigid arms. `start`, `end` and `node` are among them.

    Examples
    --------
    >>> import fx_beam as fb
    >>> section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    >>> beam = fb.Scene().add_beam([(0, 0), (4, 0)], section, elements=4)
    >>> beam.elements, beam.length, beam.node(0.25).x
    (4, 4.0, 1.0)
    """

    name: str
    nodes: tuple[Node, ...]
    degree: int
    s: np.ndarray = field(compare=False, metadata=IS_DATA)
    section: Any = None
    inner: np.ndarray | None = field(compare=False, default=None, metadata=IS_DATA)
    fractions: np.ndarray | None = field(compare=False, default=None, metadata=IS_DATA)
    carriers: tuple[Node, ...] = ()

    def __repr__(self):
        return f"<Beam {self.name!r}: {self.elements} elements from {self.start} to {self.end}>"

    def __post_init__(self):
        for values in (self.s, self.inner, self.fractions):
            if values is not None:
                values.setflags(write=False)

    @property
    def start(self) -> Node:
        """First node; with an offset of the axis, the node that carries it."""
        return (self.carriers or self.nodes)[0]

    @property
    def end(self) -> Node:
        """Last node; with an offset of the axis, the node that carries it."""
        return (self.carriers or self.nodes)[-1]

    @property
    def elements(self) -> int:
        """Number of elements."""
        return len(self.nodes) - 1

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.s[-1])

    def at(self, s: float) -> BeamPlace:
        """Place at an arc length, for `Scene.add_force` and `Scene.add_moment`.

        Parameters
        ----------
        s : float
            Arc length from the start [m], anywhere in the elements.

        Returns
        -------
        BeamPlace
            The place.

        Raises
        ------
        SceneError
            For a place beyond the ends.
        """
        place, name = as_float(s), f"beam {self.name!r}: at"
        tolerance = 1e-9 * self.length
        ok = -tolerance <= place <= self.length + tolerance
        require(ok, name, s, f"an arc length from 0 to the length of the beam, {self.length:g}")
        return BeamPlace(self, min(max(place, 0.0), self.length))

    def node(self, fraction: float) -> Node:
        """Node at a fraction of the arc length, in an `imperfect` scene that of the perfect beam.

        With an offset of the axis, the node that carries it.

        Parameters
        ----------
        fraction : float
            From 0 (start) to 1 (end).

        Returns
        -------
        Node
            The node at this fraction.

        Raises
        ------
        SceneError
            If no element ends there.
        """
        fractions = self.s / self.length if self.fractions is None else self.fractions
        distances = abs(fractions - as_float(fraction))
        nearest = int(np.argmin(distances))
        if not distances[nearest] < 1e-9:
            next_end = int(np.searchsorted(fractions, as_float(fraction)))
            nearby = fractions[max(next_end - 3, 0) : next_end + 3]
            ends = np.array2string(nearby, precision=10, separator=", ", max_line_width=200)
            raise SceneError(
                f"beam {self.name!r} has no node at the fraction {shown(fraction)} of its length; "
                f"elements that are near end at {ends}. Use one of these, or change the number of "
                "elements"
            )
        return (self.carriers or self.nodes)[nearest]


@dataclass(frozen=True)
class BeamPlace:
    """A place on the axis of a beam, also inside an element; made by `Beam.at`.

    Parameters
    ----------
    beam : Beam
        The beam.
    s : float
        Arc length from its start [m].

    Examples
    --------
    >>> import fx_beam as fb
    >>> section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    >>> beam = fb.Scene().add_beam([(0, 0), (4, 0)], section, elements=4, name="rail")
    >>> print(beam.at(2.5))
    beam 'rail' at 2.5
    """

    beam: Beam
    s: float = field(metadata=IS_DATA)

    def __str__(self):
        return f"beam {self.beam.name!r} at {self.s:g}"

    @property
    def element(self) -> tuple[int, float]:
        """Number of its element, and the place in it from 0 to 1."""
        ends = self.beam.s
        place = self.s + 1e-9 * ends[-1]  # as of section forces: at a node that behind it
        number = int(np.clip(np.searchsorted(ends, place, "right") - 1, 0, len(ends) - 2))
        return number, (self.s - ends[number]) / (ends[number + 1] - ends[number])

    @property
    def nodes(self) -> slice:
        """Nodes (degree + 1,) of its element among all of the beam."""
        degree = self.beam.degree
        first = degree * self.element[0]
        return slice(first, first + degree + 1)

    @property
    def shares(self) -> tuple[slice, np.ndarray]:
        """These nodes, and their polynomials (degree + 1,) at the place."""
        points = np.linspace(0.0, 1.0, self.beam.degree + 1)
        return self.nodes, lagrange(points, np.array([self.element[1]]))[0]


def checked_degree(degree: int, beams: Sequence[Beam], name: str) -> int:
    """Degree of a new beam; SceneError if other beams have another degree."""
    require(is_whole(degree, 1, 3), f"{name}: degree", degree, "1, 2 or 3")
    if beams and degree != beams[0].degree:
        raise SceneError(
            f"{name}: degree {degree} differs from degree {beams[0].degree} of "
            f"{beams[0].name!r}; use one degree for all beams of a scene"
        )
    return int(degree)


def numbers_along(beam: Beam) -> np.ndarray:
    """Numbers (n,) of all nodes of a beam in order; inner ones are behind all of the scene."""
    scene: Any = beam.nodes[0].scene
    before, inner = scene.beams[: scene.beams.number_of(beam.name)], beam.degree - 1
    first = len(scene.nodes) + sum(other.elements for other in before) * inner
    numbers = np.empty(beam.elements * beam.degree + 1, dtype=int)
    numbers[:: beam.degree] = [node.number for node in beam.nodes]
    for i in range(inner):
        numbers[1 + i :: beam.degree] = first + i + inner * np.arange(beam.elements)
    return numbers


class BeamLayout(NamedTuple):
    """Positions of the nodes of a beam."""

    #: Ends of the elements in order: (x, y) [m], or the Node of another beam.
    ends: list
    #: Arc length at the ends, (elements + 1,) [m].
    s: np.ndarray
    #: Nodes inside curved elements, (elements, degree - 1, 2) [m].
    inner: np.ndarray | None = None


def position_of(point):
    """Position (x, y) of a node or a place; a point is returned as it is."""
    if isinstance(point, BeamPlace):
        nodes, shares = point.shares
        return tuple(shares @ floats(reference_positions(point.beam))[nodes])
    return (point.x, point.y) if isinstance(point, Node) else point


def arc_lengths(beam: Beam, fractions: np.ndarray) -> np.ndarray:
    """Arc lengths (elements, n) at fractions (n,) of each element [m]."""
    return beam.s[:-1, None] + np.diff(beam.s)[:, None] * np.ravel(fractions)


def inner_positions(beam: Beam) -> np.ndarray:
    """Positions (elements * (degree - 1), 2) of the nodes inside the elements of a beam [m]."""
    if beam.inner is not None:
        return beam.inner.reshape(-1, 2)
    if beam.degree == 1:
        return np.empty((0, 2))
    points = dual_array([(node.x, node.y) for node in beam.nodes])
    fractions = np.arange(1, beam.degree)[:, None] / beam.degree
    return (points[:-1, None] + fractions * np.diff(points, axis=0)[:, None]).reshape(-1, 2)


def reference_positions(target: Node | Beam) -> np.ndarray:
    """Positions (nodes, 2) of a node or of all nodes of a beam in order [m]."""
    if not isinstance(target, Beam):
        return np.array([(target.x, target.y)])
    ends = np.array([(node.x, node.y) for node in target.nodes])
    inner = inner_positions(target).reshape(target.elements, -1, 2)
    element_points = np.concatenate([ends[:-1, None], inner], axis=1)
    return np.concatenate([element_points.reshape(-1, 2), ends[-1:]])


def lengths_to_ends(elements: np.ndarray) -> np.ndarray:
    """Arc length (n + 1,) at the ends of elements with nodes (n, degree + 1, 2) [m]."""
    points, weights = gauss_rule(6)
    places = np.linspace(0.0, 1.0, elements.shape[1])
    stretches = lagrange_and_slopes(places, points)[1] @ elements
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.moveaxis(stretches, -1, 0)) @ weights)])


@functools.cache
def gauss_rule(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,) of a Gauss rule on an element, from 0 to 1, and weights (n,) of the sum 1."""
    x, weights = np.polynomial.legendre.leggauss(points)
    rule = (x + 1) / 2, weights / 2
    for values in rule:
        values.setflags(write=False)
    return rule


def lagrange(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (points, nodes) of the Lagrange polynomials of `nodes` at `points`."""
    return lagrange_and_slopes(nodes, points)[0]


def lagrange_and_slopes(nodes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange polynomials (n, k) at points (n,) and their slopes; nodes (k,) or (n, k)."""
    nodes, x = np.atleast_2d(np.asarray(nodes, dtype=float)), np.asarray(points, dtype=float)
    count = nodes.shape[1]
    values, slopes = np.ones((len(x), count)), np.zeros((len(x), count))
    for i in range(count):
        for j in (j for j in range(count) if j != i):
            gap, arm = nodes[:, i] - nodes[:, j], x - nodes[:, j]
            slopes[:, i] = slopes[:, i] * arm / gap + values[:, i] / gap
            values[:, i] *= arm / gap
    return values, slopes


def polyline(
    points: Sequence, elements: int | Sequence[int] | None, degree: int, name: str
) -> BeamLayout:
    """Nodes along a polyline with corners at `points`.

    `elements` is the number in all, spread over the straight pieces by length, or one for each; by
    default the usual number.
    """
    if elements is None:
        elements = max(USUAL_ELEMENTS[degree], len(listed_points(points, f"beam {name!r}")[0]) - 1)
    if type(elements) is int and elements <= _MOST_KNOWN and (places := _plain(points)):
        ends, s = _known(places, elements, name)
        return BeamLayout([points[0], *ends[1:-1], points[-1]], s)
    return _polyline(points, elements, name)


def _plain(points: object) -> tuple | None:
    """Positions for `_known`: Python's numbers, with nodes at most at both ends; else None."""
    if type(points) is not list or len(points) < 2:
        return None
    places = position_of(points[0]), *points[1:-1], position_of(points[-1])
    pairs = all(type(place) is tuple and len(place) == 2 for place in places)
    plain = pairs and all(type(x) is float or type(x) is int for place in places for x in place)
    return places if plain else None


@functools.lru_cache(maxsize=64)
def _known(points: tuple, elements: int, name: str) -> tuple[tuple, np.ndarray]:
    """Ends and arc lengths of a layout: scenes that are built again have many of the last ones."""
    ends, s, _ = _polyline(points, elements, name)
    s.setflags(write=False)
    return tuple(ends), s


def _polyline(points: Sequence, elements: int | Sequence[int], name: str) -> BeamLayout:
    """Nodes along a polyline for points of any kind."""
    points, places = listed_points(points, f"beam {name!r}")
    joints, corners = dual_array(places), np.asarray(places)
    lengths = _distances(joints)
    extent = (corners.max(axis=0) - corners.min(axis=0)).max()
    shortest = max(1e-12 * extent, 1e-15 * abs(corners).max())
    for i in np.flatnonzero(floats(lengths) <= shortest):
        raise SceneError(
            f"beam {name!r}: the points {i} and {i + 1} coincide at ({corners[i, 0]:g}, "
            f"{corners[i, 1]:g}). Remove one of them"
        )
    counts = _spread(elements, floats(lengths), name)
    if sum(counts) == len(counts):  # quickly, as in frames of many members
        return BeamLayout(points, _sums(lengths))
    ends, positions = [points[0]], [joints[:1]]
    for a, b, count, corner in zip(joints[:-1], joints[1:], counts, points[1:], strict=True):
        piece_points = np.linspace(a, b, count + 1)[1:]
        ends += [*map(tuple, piece_points[:-1].tolist()), corner]
        positions.append(piece_points)
    return BeamLayout(ends, _sums(_distances(np.concatenate(positions))))


def _distances(points: MaybeDual) -> MaybeDual:
    """Distances (n - 1,) of neighbours among points (n, 2) [m]."""
    steps = points[1:] - points[:-1]
    return np.hypot(steps[:, 0], steps[:, 1])


def _sums(lengths: MaybeDual) -> np.ndarray:
    """Arc lengths (n + 1,) at the ends of elements with some lengths (n,), with their slopes."""
    return scene_number(np.concatenate([[0.0], np.cumsum(lengths)]))


def listed_points(points, name: str) -> tuple[list, np.ndarray]:
    """Points of a beam as a list, and their positions (n, 2) [m]; SceneError for what is none."""
    errors.refuse_units(points)
    try:
        # Rows of tables count by labels, not from 0.
        listed = [point.to_numpy() if hasattr(point, "to_numpy") else point for point in points]
        positions = errors.real_array([position_of(point) for point in listed])
    except Exception:  # a UFL expression has no length
        listed, positions = [], np.empty((0, 0))
    ok = positions.ndim == 2 and positions.shape[1] == 2
    if not ok or not (abs(positions) <= errors.LARGEST).all():
        raise SceneError(
            f"{name}: points must be points of the plane, finite (x, y) or nodes, not "
            f"{shown(points)}"
        )
    if len(listed) < 2:
        raise SceneError(f"{name}: a beam needs at least two points, not {len(listed)}")
    return listed, positions


def _spread(elements, lengths: np.ndarray, name: str) -> list[int]:
    """Number of elements of each piece: as given, or in proportion to its length."""
    pieces = len(lengths)
    is_list = isinstance(elements, list | tuple) or np.ndim(elements) > 0
    counts = elements if is_list else [elements]
    ok = all(is_whole(n, 1, MOST_ELEMENTS) for n in counts)
    expected = f"positive whole numbers, at most {MOST_ELEMENTS:,}"
    require(ok, f"beam {name!r}: elements", elements, expected)
    counts = [int(n) for n in counts]
    if is_list:
        if len(counts) != pieces:
            raise SceneError(
                f"beam {name!r}: {len(counts)} numbers of elements for {pieces} straight pieces. "
                "Give one number for each piece"
            )
        return counts
    (elements,) = counts
    if elements < pieces:
        raise SceneError(
            f"beam {name!r}: {elements} elements are too few for {pieces} straight pieces. Give "
            "at least one for each piece"
        )
    if pieces == 1:
        return [elements]
    counts = [1] * pieces
    for _ in range(elements - pieces):
        size = lengths / counts
        counts[int(np.argmax(size > (1 - 1e-9) * size.max()))] += 1  # the first of equal ones
    return counts
