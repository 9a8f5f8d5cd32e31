"""Symbols in pictures: supports, joints, masses, bodies, springs, dampers, friction, forces."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.collections import PolyCollection
from numpy.typing import ArrayLike

from fx_beam.errors import require
from fx_beam.scene.beam import Node
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.ground_springs import GroundSpring
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.parts import Parts

from .drawing import Colour, Drawing, Look, apart, feet, line_between
from .outlines import Outline

# Fractions of the drawing's size: height of a support, length of a wall, its strokes, half of the
# shortest guide, and what guides have beyond the path on them.
_HEIGHT, _WALL, _STROKE, _GUIDE, _MORE = 0.032, 0.08, 0.016, 0.12, 0.04
_MARKER = 0.016  # size of a marker, as a fraction of the longer side of the axes
_WHITE: Look = {"color": "white", "markeredgecolor": "black", "zorder": 6}
_THIN: Look = {"linewidth": 0.7, "zorder": 3}
_RAIL: Look = {"linewidth": 1.2, "linestyle": ":", "zorder": 1}
_SIDES = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])


class Strokes(NamedTuple):
    """Lines of a symbol in units of the drawing's size, and the marker at its node."""

    thick: list[np.ndarray]
    thin: list[np.ndarray]
    marker: str = ""  # "o" for a pin, "s" where the rotation is held, as in matplotlib

    def at(self, position: np.ndarray, unit: float) -> Strokes:
        """The lines moved to a position, times a unit."""
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

    def __init__(self, drawing: Drawing, parts: Parts):
        self._drawing = drawing
        self._guides: list[Joint] = []
        fixed: dict[int, set[int]] = {}
        for number, component in parts.fixed:
            fixed.setdefault(number, set()).add(component)
        for joint in filter(is_grounded, parts.joints):
            if joint.axis is not None:
                self._guides.append(joint)
            else:
                fixed[node_of(joint).number] = {0, 1, 2} if joint.is_rigid else {0, 1}
        leaving = _leaving(drawing, set(fixed))
        self.symbols = {n: _support(fixed[n], np.array(leaving[n])) for n in sorted(fixed)}

    def draw(self, ax, k: int) -> None:
        """Draw the supports in row k, and the guides."""
        drawing, symbols = self._drawing, self.symbols
        unit, guides = drawing.size * drawing.thinness, [*map(self._guide, self._guides)]
        strokes = [symbol.at(drawing.positions(n, k), unit) for n, symbol in symbols.items()]
        strokes += [wall for _, wall in guides]
        thick = [line for stroke in strokes for line in stroke.thick]
        draw_lines(ax, thick, linewidth=1.2, zorder=3)
        draw_lines(ax, [line for stroke in strokes for line in stroke.thin], **_THIN)
        draw_lines(ax, [guide for guide, _ in guides], **_RAIL)
        for marker in "os":
            if nodes := [number for number, symbol in symbols.items() if symbol.marker == marker]:
                size = marker_size(ax, drawing)
                ax.plot(*drawing.positions(nodes, k).T, marker, markersize=size, **_WHITE)

    def _guide(self, joint) -> tuple[np.ndarray, Strokes]:
        """A guide along an axis, as long as the path on it, and its wall."""
        drawing, axis, size = self._drawing, joint.direction, self._drawing.size
        number = node_of(joint).number
        start = drawing.solution.X[number]
        slides = (drawing.positions(number, list(drawing.rows)) - start) @ axis
        low, high = min(0.0, slides.min()), max(0.0, slides.max())
        margin = max(_MORE * size, _GUIDE * size - (high - low) / 2)
        ends = low - margin, high + margin
        away = left_of(axis) if axis[0] < -1e-9 else -left_of(axis)
        middle = start + np.mean(ends) * axis + 0.025 * size * away
        wall = wall_strokes(away, (ends[1] - ends[0]) / size).at(middle, size)
        return start + np.outer(ends, axis), wall


def draw_lines(ax, lines: list[np.ndarray], **look) -> None:
    """Draw lines (n, 2) as one, black if no colour is given."""
    if lines:
        ax.plot(*apart(lines).T, **{"color": "black"} | look)


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


def wall_strokes(away: np.ndarray, length: float = _WALL, foot: ArrayLike = (0.0, 0.0)) -> Strokes:
    """A line across a direction, with strokes on its far side."""
    line_way = length * left_of(away)
    starts = np.outer(np.arange(-0.4, 0.6, 0.2 * _WALL / length), line_way) + foot
    ends = starts + _STROKE * (away - 0.8 * left_of(away))
    line = foot + np.outer((-0.5, 0.5), line_way)
    return Strokes([line], list(np.stack([starts, ends], axis=1)))


def left_of(direction: np.ndarray) -> np.ndarray:
    """Directions (..., 2) turned by 90 degrees to the left."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)


def _leaving(drawing: Drawing, numbers: set[int]) -> dict[int, list[np.ndarray]]:
    """Directions (2,) in which members leave each of some nodes at the start."""
    directions: dict[int, list[np.ndarray]] = {number: [] for number in numbers}
    X = drawing.solution.X
    segments = [ends for beam in drawing.solution.beams.values() for ends in pairwise(beam.nodes)]
    bodies = drawing.solution.bodies.values()
    segments += [(body.centre, node) for body in bodies for node in body.points.values()]
    for first, last in segments:
        way = X[last.number] - X[first.number]
        for node, side in ((first, 1.0), (last, -1.0)):
            if node.number in numbers and way.any():
                directions[node.number].append(side * way / np.hypot(*way))
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
    foot, half_base = _HEIGHT * away, 0.6 * _HEIGHT * left_of(away)
    triangle = np.array([(0.0, 0.0), foot + half_base, foot - half_base, (0.0, 0.0)])
    wall = wall_strokes(away, foot=foot + gap * away)
    return Strokes([triangle, *wall.thick], wall.thin, "o")


def _across(leaving: np.ndarray) -> np.ndarray:
    """Direction into the wall of a clamp: along a single member, else the nearest axis."""
    mean = leaving.sum(axis=0)
    if np.hypot(*mean) < 1e-6 or np.ptp(leaving, axis=0).max() < 1e-6:
        return -leaving[0]
    return _SIDES[(_SIDES @ -mean).round(6).argmax()]


def slide_direction(drawing: Drawing, joint, k: int) -> np.ndarray:
    """Unit vector (2,) of a slide in row k; on a beam the direction between two of its nodes."""
    if joint.axis is not None:
        return drawing.turned(joint.a, k, joint.direction)
    positions = drawing.positions(drawing.solution.nodes_of_beam[joint.beam.name], k)
    nearest = int(np.argmin(np.hypot(*(positions - drawing.positions(joint.b.number, k)).T)))
    tangent = np.gradient(positions, axis=0)[nearest]
    return tangent / np.hypot(*tangent)


# Lines of symbols, and shoes of friction.
_FINE: Look = {"linewidth": 0.9, "zorder": 2}
_LOOKS = {
    "guide": _FINE | {"linestyle": ":"},
    "pull": _FINE | {"linestyle": (0, (6, 3))},
    "friction": _FINE | {"linewidth": 2.5, "solid_capstyle": "butt"},
    "stop": _FINE | {"linewidth": 1.5},
}
_ARROW: Look = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "inches"}
# Fractions of the drawing's size: width of a spring, its far end on the ground, what a guide on a
# node has beyond its ends, length of the wall of a force.
_SPRING_WIDTH, _SPRING_END, _BEYOND, _SHORT_WALL = 0.02, 0.15, 0.06, 0.05
# Points of a damper around a hinge, in widths of a spring: two arcs, and a plate between them.
_ARC = np.linspace(0.3, 1.7, 12)
_ROUND = np.column_stack([np.cos(_ARC), np.sin(_ARC)])
_GAP = np.full((1, 2), np.nan)
_PLATE = np.outer((1.4, 1.9), (np.cos(1.0), np.sin(1.0)))
# Shoes of a brake on both sides, in widths of a spring: along a slide and around a hinge.
_SHOES = np.concatenate([[(-1.5, 1.6), (1.5, 1.6)], _GAP, [(-1.5, -1.6), (1.5, -1.6)]])
_BENT = np.linspace(-0.5, 0.5, 8)
_ROUND_SHOE = 2.5 * np.column_stack([np.cos(_BENT), np.sin(_BENT)])
_BENT_SHOES = np.concatenate([_ROUND_SHOE, _GAP, -_ROUND_SHOE])
_BENT_CUP = np.concatenate([1.25 * _ROUND, 2.05 * _ROUND[::-1], _GAP, _PLATE])
_TURN = np.linspace(0, 5 * np.pi, 60)
_SPIRAL = (_TURN * np.array([np.cos(_TURN), np.sin(_TURN)]) / _TURN[-1]).T
# Two bars that end an arc around a hinge, and the bar that ends a slide.
_ENDS = np.array([2.4, 3.6, 3.0])[:, None]
_BENT_STOP = np.concatenate([_ENDS * _ROUND[0], 3.0 * _ROUND, _ENDS[::-1] * _ROUND[-1]])
_BAR = np.array([(0.0, -1.6), (0.0, 1.6)])
_AROUND = {"spring": _SPIRAL, "damper": _BENT_CUP, "friction": _BENT_SHOES, "stop": _BENT_STOP}
# A spring and a damper along a line: fractions of its length, and widths of a spring beside it.
_FRACTIONS = [0, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 1]
_ZIGZAG = np.column_stack([_FRACTIONS, [0, 0, *[1, -1] * 3, 1, 0, 0]])
_ROD = np.concatenate([[(0, 0), (0.5, 0)], _GAP, [(0.5, -0.7), (0.5, 0.7)], _GAP])
_CUP = np.concatenate([[(0.35, -1), (0.65, -1), (0.65, 1), (0.35, 1)], _GAP, [(0.65, 0), (1, 0)]])
_STRAIGHT = {"spring": _ZIGZAG, "damper": np.concatenate([_ROD, _CUP])}


# -- In every row ----------------------------------------------------------------------------------


def draw_moving(
    ax, drawing: Drawing, k: int, colour: Colour = "black", small: bool = False
) -> None:
    """Draw rigid arms, bodies, masses and carried obstacles of row k."""
    _draw_arms(ax, drawing, k, colour)
    draw_lines(ax, drawing.circles(drawing.parts(k), k), color=colour, linewidth=1.2, zorder=2)
    draw_bodies(ax, drawing, k, colour, small)
    draw_outlines(ax, drawing.obstacles.carried(drawing.parts(k), k), colour if small else "0.35")
    heavy = nodes_with_mass(drawing.parts(k))
    if heavy:
        look = {"color": colour if small else "#D55E00", "markersize": 5 if small else 9}
        ax.plot(*drawing.positions(heavy, k).T, "o", **look, zorder=3)


def draw_outlines(ax, outlines: Sequence[Outline], colour: Colour = "0.35") -> None:
    """Draw obstacles as lines with strokes on one side."""
    look: Look = {"color": colour, "zorder": 1}
    draw_lines(ax, [outline.line for outline in outlines], linewidth=1.4, **look)
    strokes = [pair for outline in outlines for pair in outline.strokes]
    draw_lines(ax, strokes, linewidth=0.7, **look)


def draw_surroundings(ax, drawing: Drawing, k: int) -> None:
    """Draw fixed obstacles, and joints and supports of row k."""
    draw_outlines(ax, drawing.obstacles.fixed(drawing.parts(k)))
    draw_held(ax, drawing, drawing.parts(k), k)


def draw_held(ax, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw joints, forces between points and supports of a scene in row k."""
    draw_joints(ax, drawing, parts, k)
    Supports(drawing, parts).draw(ax, k)


def draw_past(ax, drawing: Drawing) -> None:
    """Draw what the scene has no more in the last row, where it was last."""
    last = drawing.parts(drawing.rows[-1])
    for parts, places in drawing.stretches[:-1]:
        gone = parts.without(last)
        draw_outlines(ax, drawing.obstacles.fixed(gone))
        draw_held(ax, drawing, gone, drawing.rows[places[-1]])


def nodes_with_mass(parts: Parts) -> list[int]:
    """Numbers of the nodes with lumped masses."""
    return sorted({node for node, mass, _ in parts.masses if mass})


def draw_forces(ax, drawing: Drawing, k: int, colour: Colour = "black") -> None:
    """Draw arrows of forces, with their heads at the nodes and lengths in proportion.

    Forces below a fiftieth of the largest one are left out.
    """
    least = 0.02 * drawing.largest_force
    nodes = [node for node, force in drawing.forces[k].items() if np.hypot(*force) > least]
    if not nodes:
        return
    tails, tips = np.moveaxis(np.array([drawing.arrow(node, k) for node in nodes]), 1, 0)
    look = _ARROW | {"width": 0.018, "headwidth": 6, "headlength": 8, "headaxislength": 8}
    ax.quiver(*tails.T, *(tips - tails).T, color=colour, **look, zorder=4)


def _draw_arms(ax, drawing: Drawing, k: int, colour) -> None:
    """Rigid arms from nodes to joints with an offset."""
    arms = []
    centres = {body.centre for body in drawing.solution.bodies.values()}
    for joint in drawing.parts(k).joints:
        is_of_body = joint.is_rigid and joint.a in centres
        if joint.offset.any() and not (is_of_body or is_grounded(joint)):
            ends = drawing.positions(joint.a.number, k), _origin(drawing, joint, k)
            arms.append(np.array(ends))
    draw_lines(ax, arms, color=colour, linewidth=2.0, zorder=2)


def draw_bodies(ax, drawing: Drawing, k: int, colour: Colour, small: bool) -> None:
    """Draw bodies of row k: arms from centre to points, and the area between."""
    arms, areas, centres = [], [], []
    for body in drawing.solution.bodies.values():
        corners = drawing.positions([node.number for node in body.nodes], k)
        arms += [np.array([corners[0], point]) for point in corners[1:]]
        if len(corners) > 2:
            relative = corners - corners.mean(axis=0)
            areas.append(corners[np.argsort(np.arctan2(relative[:, 1], relative[:, 0]))])
        centres.append(corners[0])
    draw_lines(ax, arms, color=colour, linewidth=2.0, zorder=2)
    if areas:
        look: Look = {"facecolor": colour, "alpha": 0.03 if small else 0.15, "linewidth": 0}
        ax.add_collection(PolyCollection(areas, **look, zorder=1))
    if centres:
        ax.plot(*np.transpose(centres), "+", color=colour, markersize=6, zorder=4)


# -- Joints and forces between points --------------------------------------------------------------


def draw_joints(ax, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw joints, gears, springs, dampers, stops, forces between points of row k."""
    lines = defaultdict[str, list[np.ndarray]](list)
    for joint in parts.joints:
        position = drawing.positions(node_of(joint).number, k)
        if joint.axis is not None and not is_grounded(joint):
            lines["guide"].append(_guide(drawing, joint, position, k))
        for name, coordinate in joint.coordinates.items():
            for part in (part for part in _AROUND if getattr(coordinate, part) is not None):
                if name == "slide":
                    symbol = _along_slide(drawing, joint, part, position, k)
                else:
                    symbol = position + _SPRING_WIDTH * drawing.size * _AROUND[part]
                lines[part].append(symbol)
    for gear in parts.gears:
        nodes = [node_of(term.joint).number for term in gear.terms]
        lines["guide"].append(drawing.positions(nodes, k))
    _draw_by_looks(ax, lines)
    draw_between(ax, drawing, parts, k)
    draw_hinges(ax, drawing, parts, k)


def draw_between(ax, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw forces between points of row k, with walls at points."""
    lines = defaultdict[str, list[np.ndarray]](list)
    size = drawing.size
    for force in parts.forces_between:
        if isinstance(force, GroundSpring):
            _draw_to_ground(lines, drawing, force, k)
            continue
        points, coordinate = line_between(drawing, force, k), force.on
        # One with a length only pulls.
        is_rope = len(points) > 2 or any("of rope" in name for name in force.own)
        for part in () if is_rope else ("spring", "damper", "friction"):
            if getattr(coordinate, part) is not None:
                lines[part].append(_straight(part, coordinate, points[-2], points[-1], size))
        if is_rope or (coordinate.spring is None and coordinate.damper is None):
            lines["pull"].append(points)
        ends = (force.points[0], -force.apart[0]), (force.points[-1], force.apart[-1])
        for point, way in ends:
            if not isinstance(point, Node):
                wall = wall_strokes(way / np.hypot(*way), _SHORT_WALL).at(point.position, size)
                lines["wall"] += wall.thick + wall.thin
    _draw_by_looks(ax, lines)


def _draw_to_ground(lines: dict, drawing: Drawing, force: GroundSpring, k: int) -> None:
    """Add what holds a node or a beam to the ground, with walls."""
    size, parts = drawing.size, [part for part in _AROUND if getattr(force.on, part) is not None]
    if force.direction is None:
        centre = drawing.positions(force.nodes[0], k)
        for part in parts:
            symbol = centre + _SPRING_WIDTH * size * _AROUND[part]
            lines[part].append(symbol)
    for node, foot, way in feet(drawing, force):
        for part in [part for part in parts if part != "stop"] or ["spring"]:
            symbol = _straight(part, force.on, foot, drawing.positions(node, k), size)
            lines[part].append(symbol)
        wall = wall_strokes(-way, _SHORT_WALL).at(foot, size)
        lines["wall"] += wall.thick + wall.thin


def _draw_by_looks(ax, lines: dict[str, list[np.ndarray]]) -> None:
    """Draw lines by their looks."""
    for look, points in lines.items():
        draw_lines(ax, points, **_LOOKS.get(look, _FINE))


def draw_hinges(ax, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw a ring at each hinge of row k, and a square at each slide."""
    size = 0.8 * marker_size(ax, drawing)
    look = {"color": "white", "markeredgecolor": "black", "markersize": size, "zorder": 5}
    for marker, nodes in nodes_of_joints(parts).items():
        ax.plot(*drawing.positions(nodes, k).T, marker, **look)


def nodes_of_joints(parts: Parts) -> dict[str, list[int]]:
    """Numbers of the nodes at hinges by the marker "o", and at slides by "s"."""
    nodes: dict[str, list[int]] = {}
    for joint in parts.joints:
        # A hinge on the ground is drawn as a support; rigid joints are not marked.
        if not (joint.is_rigid or (is_grounded(joint) and joint.slide is None)):
            marker = "o" if joint.slide is None else "s"
            nodes.setdefault(marker, []).append(node_of(joint).number)
    return nodes


def _along(points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Points of a symbol, turned from the x-axis into a direction."""
    return points[:, :1] * direction + points[:, 1:] * left_of(direction)


def _guide(drawing: Drawing, joint: Joint, end: np.ndarray, k: int) -> np.ndarray:
    """A guide on a node, from its position there to the sliding node, and a little beyond."""
    start, direction = _origin(drawing, joint, k), slide_direction(drawing, joint, k)
    slide, margin = (end - start) @ direction, _BEYOND * drawing.size
    return start + np.outer((min(slide, 0.0) - margin, max(slide, 0.0) + margin), direction)


def _origin(drawing: Drawing, joint: Joint, k: int) -> np.ndarray:
    """Where the slide of a joint is zero: on its node a in row k, or on the ground."""
    if is_grounded(joint):
        return drawing.solution.X[node_of(joint).number]
    return drawing.positions(joint.a.number, k) + drawing.turned(joint.a, k, joint.offset)


def _along_slide(drawing: Drawing, joint, part: str, end: np.ndarray, k: int) -> np.ndarray:
    """A part of a slide: a zigzag, a dashpot, shoes of a brake beside it, or bars at its stops."""
    direction, size = slide_direction(drawing, joint, k), drawing.size
    short, slides_on_beam = _SPRING_END * size, joint.axis is None
    start = end - short * direction if slides_on_beam else _origin(drawing, joint, k)
    if part == "stop":
        limits = () if slides_on_beam else (joint.slide.stop.lower, joint.slide.stop.upper)
        bar = _SPRING_WIDTH * size * _along(_BAR, direction)
        return apart(start + limit * direction + bar for limit in limits if limit is not None)
    if part == "friction":
        return end + _SPRING_WIDTH * size * _along(_SHOES, direction)
    if is_grounded(joint) and not slides_on_beam:
        start = start - short * joint.direction
    return _straight(part, joint.slide, start, end, size)


def _straight(part: str, coordinate: Coordinate, a, b, size: float) -> np.ndarray:
    """A zigzag, a dashpot, beside a spring if there is one, or shoes of a brake in the middle."""
    direction = (b - a) / max(np.hypot(*(b - a)), 1e-9 * size)
    if part == "friction":
        return (a + b) / 2 + _SPRING_WIDTH * size * _along(_SHOES, direction)
    # Fractions of the way from a to b, and widths of a spring beside it.
    points = _STRAIGHT[part].copy()
    if part == "damper" and coordinate.spring is not None:
        points[:, 1] += 3.0
    return a + points[:, :1] * (b - a) + points[:, 1:] * _SPRING_WIDTH * size * left_of(direction)


# -- Names -----------------------------------------------------------------------------------------


def draw_marks(ax, drawing: Drawing, k: int, marks: dict[str, Node] | None) -> None:
    """Write names beside nodes in row k."""
    marks = {} if marks is None else marks
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for name, node in marks.items():
        drawing.solution.position(node)  # raises an error if it is not a node of the solution
        position = drawing.positions(node.number, k)
        ax.plot(*position, ".", color="black", markersize=5, zorder=6)
        # Towards the middle, where there is room for long names.
        left = position[0] > np.mean(ax.get_xlim())
        offset = {"xytext": (-5 if left else 5, 5), "ha": "right" if left else "left"}
        look = {"textcoords": "offset points", "fontsize": "small", "zorder": 7}
        ax.annotate(name, position, **offset, **look)
