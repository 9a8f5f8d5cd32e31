"""Symbols of the ground: supports and guides, hatched as in drawings of mechanisms."""

from __future__ import annotations

import numpy as np

from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene

from .sheet import Sheet

# Fractions of the drawing's size: height of a support, length of a wall, its strokes, half a guide.
_HEIGHT, _WALL, _STROKE, _GUIDE = 0.032, 0.08, 0.016, 0.12
_WHITE = {"color": "white", "markeredgecolor": "black", "zorder": 6}


def draw_grounds(sheet: Sheet, scene: Scene) -> None:
    """Draw supports and guides on the ground, each on a side without members."""
    held: dict[int, set[int]] = {}
    for number, component in scene.fixed:
        held.setdefault(number, set()).add(component)
    for joint in scene.joints:
        if GROUND in (joint.a, joint.b):
            node = joint.a if joint.b is GROUND else joint.b
            if joint.axis is not None:
                _ground_guide(sheet, _position(scene, node.number), joint.axis)
            else:
                held[node.number] = {0, 1, 2} if joint.is_rigid else {0, 1}
    leaving = _leaving(scene, set(held))
    for number, components in held.items():
        _support(sheet, _position(scene, number), components, np.array(leaving[number]))


def _position(scene: Scene, number: int) -> np.ndarray:
    node = scene.nodes[number]
    return np.array([node.x, node.y])


def _leaving(scene: Scene, numbers: set[int]) -> dict[int, list[np.ndarray]]:
    """Directions (2,) in which members leave each of some nodes."""
    directions: dict[int, list[np.ndarray]] = {number: [] for number in numbers}
    for beam in scene.beams:
        for k, node in enumerate(beam.nodes):
            for other in (k - 1, k + 1) if node.number in numbers else ():
                if 0 <= other <= beam.elements:
                    along = _position(scene, beam.nodes[other].number) - _position(
                        scene, node.number
                    )
                    directions[node.number].append(along / np.hypot(*along))
    for body in scene.bodies:
        centre = _position(scene, body.centre.number)
        for node in body.points.values():
            along = _position(scene, node.number) - centre
            for number, side in ((node.number, -1.0), (body.centre.number, 1.0)):
                if number in numbers and along.any():
                    directions[number].append(side * along / np.hypot(*along))
    return {number: ways or [np.array([0.0, 1.0])] for number, ways in directions.items()}


def _support(sheet: Sheet, position, components: set[int], leaving: np.ndarray) -> None:
    moves = {0, 1} - components
    if moves == {0, 1}:  # only the rotation is held
        return sheet.dots([position], "s", markersize=7, **_WHITE)
    if components == {0, 1, 2}:
        mean = leaving.sum(axis=0)
        mean = leaving[0] if np.hypot(*mean) < 1e-6 else mean
        away = -mean / np.hypot(*mean)
        return _wall(sheet, position, away, _WALL)
    # Below, or above if a member leaves downwards; a roller across its free direction.
    away = -np.eye(2)[0 if moves == {1} else 1]
    if (leaving @ away).max() > 0.5:
        away = -away
    gap = 0.25 * _HEIGHT if moves else 0.0
    if 2 in components:
        foot = position + gap * sheet.size * away
        sheet.dots([position], "s", markersize=7, **_WHITE)
    else:
        foot = position + _HEIGHT * sheet.size * away
        along = 0.6 * _HEIGHT * sheet.size * _left(away)
        sheet.line([position, foot + along, foot - along, position])
        sheet.dots([position], "o", markersize=6, **_WHITE)
        foot = foot + gap * sheet.size * away
    return _wall(sheet, foot, away, _WALL)


def _wall(sheet: Sheet, position, away: np.ndarray, length: float) -> None:
    """A line across a direction, with strokes on its far side."""
    along = length * sheet.size * _left(away)
    sheet.line(position + np.outer((-0.5, 0.5), along), linewidth=1.4)
    starts = position + np.outer(np.arange(-0.4, 0.6, 0.2 * _WALL / length), along)
    ends = starts + _STROKE * sheet.size * (away - 0.8 * _left(away))
    sheet.strokes(starts, ends, linewidth=0.7)


def draw_guides(sheet: Sheet, scene: Scene) -> None:
    """Guides on nodes, drawn a little beyond their point on the node and the sliding node."""
    for joint in scene.joints:
        if joint.axis is not None and GROUND not in (joint.a, joint.b):
            start, slide = _position(scene, joint.a.number) + joint.offset, joint.start()[0]
            more = 0.5 * _GUIDE * sheet.size
            ends = np.outer((min(slide, 0) - more, max(slide, 0) + more), joint.axis)
            sheet.line(start + ends, linestyle=":", linewidth=1.6)


def _ground_guide(sheet: Sheet, position, axis: np.ndarray) -> None:
    """A guide along an axis, on a wall."""
    along = _GUIDE * sheet.size * axis
    sheet.line([position - along, position + along], linestyle=":", linewidth=1.2)
    away = _left(axis) if axis[0] < -1e-9 else -_left(axis)
    _wall(sheet, position + 0.025 * sheet.size * away, away, 2 * _GUIDE)


def _left(direction: np.ndarray) -> np.ndarray:
    """A direction turned by 90 degrees to the left."""
    return np.array([-direction[1], direction[0]])
