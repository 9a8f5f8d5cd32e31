"""Obstacles in pictures: lines and circles, hatched on the side that nodes cannot enter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from fx_beam.scene.beam import Beam
from fx_beam.scene.obstacles import Circle, Line, Obstacle

# Fractions of the scene's size: what is drawn beyond the nearest positions, distance and length
# of the strokes. An obstacle farther away than the size is not drawn.
_BEYOND, _APART, _STROKE = 0.1, 0.03, 0.016


class Outline(NamedTuple):
    """A line, and strokes on the side that is not allowed."""

    #: Points (n, 2) of the line, and ends (m, 2, 2) of the strokes.
    line: np.ndarray
    strokes: np.ndarray

    def moved(self, position: np.ndarray, angle: float) -> Outline:
        """Turned by an angle about the origin, which is then moved to a position."""
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, s], [-s, c]])
        return Outline(self.line @ turn + position, self.strokes @ turn + position)


def outlines(
    obstacles: Iterable[Obstacle], positions: np.ndarray, size: float
) -> Iterator[Outline]:
    """Outlines of the fixed shapes that are near.

    Circles up to the size in radius are whole, larger ones and lines reach past the positions.
    """
    for shape in dict.fromkeys(obstacle.shape for obstacle in obstacles):
        if isinstance(shape, Beam) or shape.carrier is not None:
            continue
        if abs(shape.gap(positions)).min() <= size:
            yield outline(shape, positions, size)


def outline(shape: Line | Circle, positions: np.ndarray, size: float) -> Outline:
    """The outline of a fixed shape that reaches past some positions."""
    if isinstance(shape, Circle):
        line, away = _arc(shape, positions, size)
    else:
        line, away = _straight(shape, positions, size)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(0.5 * _APART * size, s[-1], _APART * size)
    starts, out = (
        np.column_stack([np.interp(at, s, values[:, i]) for i in (0, 1)]) for values in (line, away)
    )
    aside = 0.8 * out[:, ::-1] * (1, -1)
    ends = starts + _STROKE * size * (out + aside)
    return Outline(line, np.stack([starts, ends], axis=1))


def _straight(shape: Line, positions: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends (2, 2) of the line, and its directions (2, 2) away from the free side."""
    x, y = shape.normal
    along = np.array([-y, x])
    s = (positions - shape.point) @ along
    reach = np.array([s.min() - _BEYOND * size, s.max() + _BEYOND * size])
    return shape.point + reach[:, None] * along, np.tile((-x, -y), (2, 1))


def _arc(shape: Circle, positions: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of the circle or of its near part, and directions away from the free side."""
    middle, half = 0.0, np.pi
    if shape.radius > size:
        arms = positions - shape.centre
        middle = np.arctan2(*arms.mean(axis=0)[::-1])
        apart = np.angle(np.exp(1j * (np.arctan2(*arms.T[::-1]) - middle)))
        half = min(np.pi, abs(apart).max() + _BEYOND * size / shape.radius)
    angle = middle + np.linspace(-half, half, 181)
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    return shape.centre + shape.radius * out, out if shape.inside else -out
