"""Outlines of obstacles: lines with strokes on the side that is not allowed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.results.contact_gaps import nodes_of
from fx_beam.scene.beam import Beam
from fx_beam.scene.contacts import Shape, arc_of

# Fractions of the scene's size: how far lines go beyond the nearest positions, distance and length
# of strokes. An obstacle farther away than the size is not drawn.
_BEYOND, _APART, _STROKE = 0.1, 0.03, 0.016


class Outline(NamedTuple):
    """A line, and strokes on the side that is not allowed."""

    #: Points (n, 2) of the line, and ends (m, 2, 2) of the strokes.
    line: np.ndarray
    strokes: np.ndarray

    def moved(self, position: np.ndarray, angle: float) -> Outline:
        """Turned by an angle about the origin, which is then moved to a position."""
        matrix = turn(angle)
        return Outline(self.line @ matrix + position, self.strokes @ matrix + position)


def turn(angle: float) -> np.ndarray:
    """Matrix (2, 2) that turns rows by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


def outline(shape: Shape, positions: np.ndarray, size: float) -> Outline:
    """The outline of a fixed shape that reaches past some positions."""
    line, outwards = shape.outline(positions, size, _BEYOND * size)
    s = arc_of(line)
    places = np.arange(0.5 * _APART * size, s[-1], _APART * size)
    starts, directions = (interpolated(places, s, values) for values in (line, outwards))
    aside = 0.8 * directions[:, ::-1] * (1, -1)
    ends = starts + _STROKE * size * (directions + aside)
    return Outline(line, np.stack([starts, ends], axis=1))


def interpolated(places: np.ndarray, s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m, 2) at places (m,), interpolated between values (n, 2) at s (n,)."""
    return np.column_stack([np.interp(places, s, column) for column in values.T])


class Obstacles:
    """Outlines of fixed obstacles that are near, and of those that nodes carry, of a `Drawing`."""

    def __init__(self, drawing):
        self._drawing = drawing
        shapes = dict.fromkeys(contact.shape for contact in drawing.solution.contacts)
        #: Outlines of the fixed ones.
        self.fixed = [
            outline(shape, drawing.points, drawing.reach)
            for shape in shapes
            if not isinstance(shape, Beam) and shape.carrier is None
            if abs(shape.gap(drawing.points)).min() <= drawing.reach
        ]
        # Nodes that carry obstacles, and outlines relative to the node.
        self._carried: dict[Shape, tuple[int, Outline]] = {}
        for contact in drawing.solution.contacts:
            shape = contact.shape
            if isinstance(shape, Beam) or shape.carrier is None or shape in self._carried:
                continue
            # What touches in all rows, relative to the node and its section, and the node itself.
            carrier, point_lists = shape.carrier.number, [np.zeros((1, 2))]
            nodes = nodes_of(drawing.solution.nodes_of_beam, contact.target)
            for k in drawing.rows:
                arms = drawing.positions(nodes, k) - drawing.positions(carrier, k)
                point_lists.append(arms @ turn(-drawing.angle(carrier, k)))
            touching = np.concatenate(point_lists)
            drawn = outline(shape.at((0.0, 0.0)), touching, drawing.reach)
            self._carried[shape] = carrier, drawn

    def carried(self, k: int) -> list[Outline]:
        """Outlines of the obstacles that nodes carry, in row k."""
        drawing = self._drawing
        return [
            outline.moved(drawing.positions(number, k), drawing.angle(number, k))
            for number, outline in self._carried.values()
        ]
