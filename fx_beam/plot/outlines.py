"""Outlines of obstacles: lines, and on which side of them is what is not allowed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.results.contact_gaps import nodes_of
from fx_beam.scene.beam import Beam
from fx_beam.scene.contacts import Circle, Shape
from fx_beam.scene.parts import Parts

# How far lines go beyond the nearest positions, as a fraction of the scene's size. An obstacle
# farther away than the size is not drawn.
_BEYOND = 0.1


class Outline(NamedTuple):
    """A line, and the side that is not allowed."""

    #: Points (n, 2) of the line, and unit vectors (n, 2) into the obstacle.
    line: np.ndarray
    sides: np.ndarray
    #: Whether it is a disc.
    is_disc: bool = False

    def moved(self, position: np.ndarray, angle: float) -> Outline:
        """Turned by an angle about the origin, which is then moved to a position."""
        matrix = turn(angle)
        return Outline(self.line @ matrix + position, self.sides @ matrix, self.is_disc)


def turn(angle: float) -> np.ndarray:
    """Matrix (2, 2) that turns rows by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


def outline(shape: Shape, positions: np.ndarray, size: float) -> Outline:
    """The outline of a fixed shape that reaches past some positions."""
    line, sides = shape.outline(positions, size, _BEYOND * size)
    is_disc = isinstance(shape, Circle) and shape.side > 0 and shape.radius <= size
    return Outline(line, sides, is_disc)


def interpolated(places: np.ndarray, s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m, 2) at places (m,), interpolated between values (n, 2) at s (n,)."""
    return np.column_stack([np.interp(places, s, column) for column in values.T])


class Obstacles:
    """Outlines of obstacles in each row of a `Drawing`: fixed ones that are near, and carried."""

    def __init__(self, drawing):
        self._drawing = drawing
        # Outlines of fixed shapes, and of carried ones relative to their nodes.
        self._outlines: dict[Shape, Outline | None] = {}
        for parts, places in drawing.stretches:
            for contact in parts.contacts:
                shape = contact.shape
                if not isinstance(shape, Beam) and shape not in self._outlines:
                    rows = [drawing.rows[i] for i in places]
                    self._outlines[shape] = self._outline(shape, contact.target, rows)

    def _outline(self, shape: Shape, target, rows: list[int]) -> Outline | None:
        """Outline of a shape; none of a fixed one that is far away."""
        drawing = self._drawing
        if shape.carrier is None:
            near = abs(shape.gap(drawing.points)).min() <= drawing.reach
            return outline(shape, drawing.points, drawing.reach) if near else None
        # What touches in all rows, relative to the node and its section, and the node itself.
        carrier, point_lists = shape.carrier.number, [np.zeros((1, 2))]
        nodes = nodes_of(drawing.solution.nodes_of_beam, target)
        for k in rows:
            arms = drawing.positions(nodes, k) - drawing.positions(carrier, k)
            point_lists.append(arms @ turn(-drawing.angle(carrier, k)))
        return outline(shape.at((0.0, 0.0)), np.concatenate(point_lists), drawing.reach)

    def fixed(self, parts: Parts) -> list[Outline]:
        """Outlines of the fixed obstacles of a scene."""
        return [outline for shape, outline in self._of(parts) if shape.carrier is None]

    def carried(self, parts: Parts, k: int) -> list[Outline]:
        """Outlines of the obstacles that nodes carry, in row k."""
        drawing = self._drawing
        return [
            outline.moved(drawing.positions(node.number, k), drawing.angle(node.number, k))
            for shape, outline in self._of(parts)
            if (node := shape.carrier) is not None
        ]

    def all(self, k: int) -> list[Outline]:
        """All outlines of row k."""
        parts = self._drawing.parts(k)
        return self.fixed(parts) + self.carried(parts, k)

    def _of(self, parts: Parts) -> list[tuple[Shape, Outline]]:
        shapes = dict.fromkeys(contact.shape for contact in parts.contacts)
        known = ((s, self._outlines[s]) for s in shapes if s in self._outlines)
        return [(shape, line) for shape, line in known if line is not None]
