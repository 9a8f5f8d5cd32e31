"""Obstacles in pictures: lines and circles, hatched on the side that nodes cannot enter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from fx_beam.scene.obstacles import Circle, Line, Obstacle

# Fractions of the scene's size: what is drawn beyond the nearest positions, distance and length
# of the strokes. An obstacle farther away than the size is not drawn.
_BEYOND, _APART, _STROKE = 0.1, 0.03, 0.016


def outlines(
    obstacles: Iterable[Obstacle], positions: np.ndarray, size: float
) -> Iterator[tuple[np.ndarray, ...]]:
    """Points (n, 2) of the line, and starts and ends (m, 2) of the strokes, of each shape.

    Circles up to the size in radius are whole, larger ones and lines reach past the positions.
    """
    for shape in dict.fromkeys(obstacle.shape for obstacle in obstacles):
        if shape.carrier is not None:
            continue
        if abs(shape.gap(positions)).min() > size:
            continue
        if isinstance(shape, Circle):
            line, away = _arc(shape, positions, size)
        else:
            line, away = _straight(shape, positions, size)
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        at = np.arange(0.5 * _APART * size, s[-1], _APART * size)
        starts, out = (
            np.column_stack([np.interp(at, s, values[:, i]) for i in (0, 1)])
            for values in (line, away)
        )
        aside = 0.8 * out[:, ::-1] * (1, -1)
        yield line, starts, starts + _STROKE * size * (out + aside)


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
