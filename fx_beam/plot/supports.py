"""Symbols of the ground: supports, guides and walls, hatched as in drawings of mechanisms."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND, Joint

from .drawing import Drawing, apart

# Fractions of the drawing's size: height of a support, length of a wall, its strokes, half of the
# shortest guide, and what guides have beyond the path on them.
_HEIGHT, _WALL, _STROKE, _GUIDE, _MORE = 0.032, 0.08, 0.016, 0.12, 0.04
_MARKER = 0.016  # size of a marker, as a fraction of the longer side of the axes
_WHITE: dict[str, Any] = {"color": "white", "markeredgecolor": "black", "zorder": 6}
_SIDES = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])


class Strokes(NamedTuple):
    """Lines of a symbol in units of the drawing's size, and what is at its node."""

    thick: list[np.ndarray]
    thin: list[np.ndarray]
    marker: str = ""  # "o" for a pin, "s" where the rotation is held, as in matplotlib

    def at(self, position: np.ndarray, unit: float) -> Strokes:
        """The same lines at a position, in a unit."""
        thick, thin = ([position + unit * line for line in lines] for lines in self[:2])
        return Strokes(thick, thin, self.marker)


class Supports:
    """Supports and guides on the ground, each on a side without members.

    A pin is a triangle, a roller a triangle with a gap, a clamp a wall. They move with their nodes.

    Attributes
    ----------
    symbols : dict
        The strokes of each support by the number of its node.
    """

    def __init__(self, drawing: Drawing):
        self._drawing = drawing
        self._guides: list[Joint] = []
        held: dict[int, set[int]] = {}
        scene = drawing.scene
        for number, component in () if scene is None else scene.fixed:
            if number in scene.gone:
                continue
            held.setdefault(number, set()).add(component)
        for joint in () if scene is None else filter(is_grounded, scene.joints):
            if joint.axis is not None:
                self._guides.append(joint)
            else:
                held[node_of(joint).number] = {0, 1, 2} if joint.is_rigid else {0, 1}
        leaving = _leaving(drawing, set(held))
        self.symbols = {n: _support(held[n], np.array(leaving[n])) for n in sorted(held)}

    def draw(self, ax, k: int) -> list:
        """Draw the supports in row k, and the guides; returns the artists."""
        drawing, thick, thin = self._drawing, list[np.ndarray](), list[np.ndarray]()
        nodes: dict[str, list[int]] = {"o": [], "s": []}
        unit = drawing.size * drawing.thinness
        for number, symbol in self.symbols.items():
            strokes = symbol.at(drawing.positions(number, k), unit)
            thick += strokes.thick
            thin += strokes.thin
            if strokes.marker:
                nodes[strokes.marker].append(number)
        dotted = []
        for joint in self._guides:
            guide, wall = self._guide(joint)
            dotted.append(guide)
            thick += wall.thick
            thin += wall.thin
        drawn = draw_lines(ax, thick, linewidth=1.2, zorder=3)
        drawn += draw_lines(ax, thin, linewidth=0.7, zorder=3)
        drawn += draw_lines(ax, dotted, linewidth=1.2, linestyle=":", zorder=1)
        for marker, of in nodes.items():
            if of:
                size = marker_size(ax, drawing)
                drawn += ax.plot(*drawing.positions(of, k).T, marker, markersize=size, **_WHITE)
        return drawn

    def _guide(self, joint: Joint) -> tuple[np.ndarray, Strokes]:
        """A guide along an axis, as long as the path on it, and its wall."""
        drawing, axis, size = self._drawing, joint.direction, self._drawing.size
        assert axis is not None
        number = node_of(joint).number
        start = drawing.solution.X[number]
        slides = (drawing.positions(number, list(drawing.rows)) - start) @ axis
        low, high = min(0.0, slides.min()), max(0.0, slides.max())
        more = max(_MORE * size, _GUIDE * size - (high - low) / 2)
        ends = low - more, high + more
        away = left_of(axis) if axis[0] < -1e-9 else -left_of(axis)
        middle = start + np.mean(ends) * axis + 0.025 * size * away
        wall = wall_strokes(away, (ends[1] - ends[0]) / size).at(middle, size)
        return start + np.outer(ends, axis), wall


def draw_lines(ax, lines: list[np.ndarray], **look) -> list:
    """Draw lines (n, 2) as one, black if no colour is given; returns the artists."""
    return ax.plot(*apart(lines).T, **{"color": "black"} | look) if lines else []


def marker_size(ax, drawing: Drawing) -> float:
    """Size of the marker of a support [points], which fits its lines also in small panels."""
    longest = max(ax.get_window_extent().size) * 72 / ax.figure.dpi
    return max(2.5, _MARKER * longest * drawing.thinness)


def is_grounded(joint: Joint) -> bool:
    """Whether a joint is on the ground."""
    return GROUND in (joint.a, joint.b)


def node_of(joint: Joint) -> Node:
    """The node b of a joint, or the one that it connects with the ground."""
    return joint.a if joint.b is GROUND else joint.b


def wall_strokes(away: np.ndarray, length: float = _WALL, foot: Any = (0.0, 0.0)) -> Strokes:
    """A line across a direction, with strokes on its far side."""
    along = length * left_of(away)
    starts = np.outer(np.arange(-0.4, 0.6, 0.2 * _WALL / length), along) + foot
    ends = starts + _STROKE * (away - 0.8 * left_of(away))
    line = foot + np.outer((-0.5, 0.5), along)
    return Strokes([line], list(np.stack([starts, ends], axis=1)))


def left_of(direction: np.ndarray) -> np.ndarray:
    """A direction turned by 90 degrees to the left."""
    return np.array([-direction[1], direction[0]])


def _leaving(drawing: Drawing, numbers: set[int]) -> dict[int, list[np.ndarray]]:
    """Directions (2,) in which members leave each of some nodes at the start."""
    directions: dict[int, list[np.ndarray]] = {number: [] for number in numbers}
    X = drawing.solution.X
    for beam in drawing.solution.beams.values():
        for k, node in enumerate(beam.nodes):
            for other in (k - 1, k + 1) if node.number in numbers else ():
                if 0 <= other <= beam.elements:
                    along = X[beam.nodes[other].number] - X[node.number]
                    directions[node.number].append(along / np.hypot(*along))
    for body in drawing.solution.bodies.values():
        centre = X[body.centre.number]
        for node in body.points.values():
            along = X[node.number] - centre
            for number, side in ((node.number, -1.0), (body.centre.number, 1.0)):
                if number in numbers and along.any():
                    directions[number].append(side * along / np.hypot(*along))
    return {number: parts or [np.array([0.0, 1.0])] for number, parts in directions.items()}


def _support(components: set[int], leaving: np.ndarray) -> Strokes:
    moves = {0, 1} - components
    if moves == {0, 1}:  # only the rotation is held
        return Strokes([], [], "s")
    if components == {0, 1, 2}:
        return wall_strokes(_across(leaving))
    # Below, or above if a member leaves downwards; a roller across its free direction.
    away = -np.eye(2)[0 if moves == {1} else 1]
    if (leaving @ away).max() > 0.5:
        away = -away
    gap = 0.25 * _HEIGHT if moves else 0.0
    if 2 in components:
        return wall_strokes(away, foot=gap * away)._replace(marker="s")
    foot, along = _HEIGHT * away, 0.6 * _HEIGHT * left_of(away)
    triangle = np.array([(0.0, 0.0), foot + along, foot - along, (0.0, 0.0)])
    wall = wall_strokes(away, foot=foot + gap * away)
    return Strokes([triangle, *wall.thick], wall.thin, "o")


def _across(leaving: np.ndarray) -> np.ndarray:
    """Direction into the wall of a clamp: along a single member, else the nearest axis."""
    mean = leaving.sum(axis=0)
    if np.hypot(*mean) < 1e-6 or np.ptp(leaving, axis=0).max() < 1e-6:
        return -leaving[0]
    return _SIDES[(_SIDES @ -mean).round(6).argmax()]
