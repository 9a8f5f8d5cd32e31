"""Nodes and beams: the geometry of a scene as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import is_whole

#: Components of a node's motion, in the order of all arrays.
COMPONENTS = ("x", "y", "rotation")


@dataclass(frozen=True)
class Node:
    """A mesh node, where elements meet; made by a beam, known by its number and never by place.

    Parameters
    ----------
    number : int
        Row of the node in the scene's arrays.
    x, y : float
        Reference position [m].
    scene : object
        The scene to which the node belongs.
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
        # A scene that is copied or unpickled gives itself to its nodes.
        return {**self.__dict__, "scene": None}


@dataclass(frozen=True, repr=False)
class Beam:
    """A beam along a polyline, whose corners are rigid, or along a curve.

    Parameters
    ----------
    name : str
        Name in messages and pictures.
    nodes : tuple of Node
        The ends of its elements, in order.
    degree : int
        Polynomial degree of displacement and rotation, 1 to 3.
    s : (elements + 1,) float
        Arc length at the nodes, from the start [m].
    section : Section
        Cross-section; None in a solution that was read from a file.
    inner : (elements, degree - 1, 2) float, optional
        Places of the nodes inside the elements of a curve [m], those of degree 3 near it and not
        on it; none where elements are straight.
    """

    name: str
    nodes: tuple[Node, ...]
    degree: int
    s: np.ndarray = field(compare=False)
    section: Any = None
    inner: np.ndarray | None = field(compare=False, default=None)

    def __repr__(self):
        return f"<Beam {self.name!r}: {self.elements} elements from {self.start} to {self.end}>"

    def __post_init__(self):
        for values in (self.s, self.inner):
            if values is not None:
                values.setflags(write=False)

    @property
    def start(self) -> Node:
        """First node."""
        return self.nodes[0]

    @property
    def end(self) -> Node:
        """Last node."""
        return self.nodes[-1]

    @property
    def elements(self) -> int:
        """Number of elements."""
        return len(self.nodes) - 1

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.s[-1])

    def node(self, fraction: float) -> Node:
        """Node at a fraction of the arc length.

        Parameters
        ----------
        fraction : float
            From 0 (start) to 1 (end).

        Returns
        -------
        Node
            The node there.

        Raises
        ------
        SceneError
            If no element ends there.
        """
        fractions = self.s / self.length
        nearest = int(np.argmin(abs(fractions - fraction)))
        if not abs(fractions[nearest] - fraction) < 1e-9:
            places = np.array2string(fractions, precision=4, threshold=12, separator=", ")
            raise SceneError(
                f"beam {self.name!r} has no node at the fraction {fraction!r} of its length; its "
                f"elements end at {places}. Take one of these, or another number of elements"
            )
        return self.nodes[nearest]


class Layout(NamedTuple):
    """Where the nodes of a beam lie.

    Parameters
    ----------
    ends : list of (x, y) or Node
        The ends of its elements, in order [m]; nodes that other beams have already as such.
    s : (elements + 1,) float
        Arc length there [m].
    inner : (elements, degree - 1, 2) float, optional
        Places of the nodes inside the elements of a curve [m].
    """

    ends: list
    s: np.ndarray
    inner: np.ndarray | None = None


def place(point):
    """Place (x, y) of a node; a point as it is."""
    return (point.x, point.y) if isinstance(point, Node) else point


def lagrange(nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values (places, nodes) of the Lagrange polynomials of some nodes at other places."""
    nodes, places = np.asarray(nodes, dtype=float), np.asarray(places, dtype=float)
    values = np.ones((len(places), len(nodes)))
    for i, own in enumerate(nodes):
        for other in np.delete(nodes, i):
            values[:, i] *= (places - other) / (own - other)
    return values


def polyline(points: Sequence, elements: int | Sequence[int], name: str) -> Layout:
    """Nodes along a polyline.

    Parameters
    ----------
    points : sequence of (x, y) or Node
        Corners [m].
    elements : int or sequence of int
        Number of elements in all, spread over the straight pieces by their length, or one number
        for each piece.
    name : str
        Name of the beam, for messages.

    Returns
    -------
    Layout
        Ends of the elements and their arc lengths.

    Raises
    ------
    SceneError
        For fewer than two points, a piece of length zero, or too few elements.
    """
    try:
        points = list(points)
    except TypeError:
        raise SceneError(f"beam {name!r}: points must be pairs (x, y) or nodes") from None
    try:
        corners = np.array([place(point) for point in points], dtype=float)
    except (TypeError, ValueError):
        corners = np.empty(0)
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise SceneError(f"beam {name!r}: points must be finite pairs (x, y) or nodes")
    if len(corners) < 2:
        raise SceneError(f"beam {name!r}: a beam needs at least two points")
    lengths = np.hypot(*np.diff(corners, axis=0).T)
    shortest = max(1e-12 * np.ptp(corners, axis=0).max(), 1e-15 * abs(corners).max())
    for i in np.flatnonzero(lengths <= shortest):
        raise SceneError(
            f"beam {name!r}: the points {i} and {i + 1} coincide at ({corners[i, 0]:g}, "
            f"{corners[i, 1]:g}); a beam needs a length"
        )
    counts = _spread(elements, lengths, name)
    ends = [points[0]]
    for a, b, count, corner in zip(corners[:-1], corners[1:], counts, points[1:], strict=True):
        ends += [*np.linspace(a, b, count + 1)[1:-1], corner]
    steps = np.diff([place(end) for end in ends], axis=0)
    return Layout(ends, np.concatenate(([0.0], np.cumsum(np.hypot(*steps.T)))))


def _spread(elements, lengths: np.ndarray, name: str) -> list[int]:
    """Numbers of elements of each piece: as given, or in proportion to its length."""
    pieces = len(lengths)
    counts = [elements] if np.ndim(elements) == 0 else list(elements)
    if not all(is_whole(n, 1) for n in counts):
        raise SceneError(f"beam {name!r}: elements = {elements!r} must be positive whole numbers")
    if np.ndim(elements) != 0:
        if len(counts) != pieces:
            raise SceneError(
                f"beam {name!r}: {len(counts)} numbers of elements for {pieces} straight pieces"
            )
        return counts
    if elements < pieces:
        raise SceneError(
            f"beam {name!r}: {elements} elements are too few for {pieces} straight pieces"
        )
    counts = [1] * pieces
    for _ in range(elements - pieces):
        counts[int(np.argmax(lengths / counts))] += 1
    return counts
