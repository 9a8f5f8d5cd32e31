"""Nodes and beams: the geometry of a scene as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .errors import SceneError

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


@dataclass(frozen=True)
class Beam:
    """A beam along a polyline; corners are rigid.

    Parameters
    ----------
    name : str
        Name in messages and pictures.
    nodes : tuple of Node
        The ends of its elements, in order.
    degree : int
        Polynomial degree of displacement and rotation, 1 to 3.
    section : Section
        Cross-section; None in a solution that was read from a file.
    """

    name: str
    nodes: tuple[Node, ...]
    degree: int
    section: Any = field(repr=False, default=None)

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
    def s(self) -> np.ndarray:
        """Arc length at the nodes, from the start, (elements + 1,) [m]."""
        points = np.array([(node.x, node.y) for node in self.nodes])
        lengths = np.hypot(*np.diff(points, axis=0).T)
        return np.concatenate(([0.0], np.cumsum(lengths)))

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


def polyline(points: Sequence, elements: int | Sequence[int], name: str) -> list[np.ndarray]:
    """Points at which the elements of a polyline end.

    Parameters
    ----------
    points : sequence of (x, y)
        Corners [m].
    elements : int or sequence of int
        Number of elements in all, spread over the straight pieces by their length, or one number
        for each piece.
    name : str
        Name of the beam, for messages.

    Returns
    -------
    list of (elements of a piece + 1, 2) float arrays
        The points of each straight piece, its corners included.

    Raises
    ------
    SceneError
        For fewer than two points, a piece of length zero, or too few elements.
    """
    try:
        corners = np.array(points, dtype=float)
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
    return [
        np.linspace(a, b, count + 1)
        for a, b, count in zip(corners[:-1], corners[1:], counts, strict=True)
    ]


def _spread(elements, lengths: np.ndarray, name: str) -> list[int]:
    """Numbers of elements of each piece: as given, or in proportion to its length."""
    pieces = len(lengths)
    counts = [elements] if np.ndim(elements) == 0 else list(elements)
    if not all(isinstance(n, int | np.integer) and n >= 1 for n in counts):
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
