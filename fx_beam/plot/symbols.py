"""Symbols in pictures: supports, joints, masses, springs, dampers, friction, forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fx_beam.results.fields import nodes_of_elements
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node, lagrange
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import Load
from fx_beam.validation import as_float, is_number, is_whole, numbers, require

from .slide_direction import slide_direction

_JOINT: dict[str, Any] = {"color": "white", "markeredgecolor": "black"}
_GUIDE: dict[str, Any] = {"linestyle": ":", "linewidth": 1.2, "zorder": 1}
_ARROW: dict[str, Any] = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "linewidth": 1.2}
# Straight lines per element: over 60 degrees the error is a thousandth of the radius.
_LINES = 12
# Fractions of the picture's size: longest arrow, width of a spring, its far end on the ground.
_LONGEST_FORCE, _SPRING_WIDTH, _SPRING_END = 0.12, 0.02, 0.15
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


def axis(nodes: np.ndarray, degree: int) -> np.ndarray:
    """Points of a beam's axis for drawing, also on curved elements of degree 2 and 3.

    Parameters
    ----------
    nodes : (..., elements * degree + 1, 2) float
        Positions of a beam's nodes, such as `Solution.shape` and `Modes.shape` give [m].
    degree : int
        Degree of its elements.

    Returns
    -------
    (..., points, 2) float
        Positions along the beam, including the nodes [m].
    """
    if degree == 1:
        return nodes
    values = lagrange(np.linspace(0, 1, degree + 1), np.arange(_LINES) / _LINES)
    elements = (nodes.shape[-2] - 1) // degree
    of_element = degree * np.arange(elements)[:, None] + np.arange(degree + 1)
    points = values @ nodes[..., of_element, :]
    points = points.reshape(*nodes.shape[:-2], elements * _LINES, 2)
    return np.concatenate([points, nodes[..., -1:, :]], axis=-2)


@dataclass(frozen=True)
class Drawing:
    """A solution with magnified displacements, in the rows that a picture shows.

    `Reference` is the same for a scene before it runs, with a single row.
    """

    solution: Any
    rows: Sequence[int]
    magnify: float = 1.0

    @property
    def scene(self):
        """The scene; None for a solution that was read from a file."""
        nodes = [beam.start for beam in self.solution.beams.values()]
        return (nodes + [body.centre for body in self.solution.bodies.values()])[0].scene

    @cached_property
    def points(self) -> np.ndarray:
        """Points (n, 2) of all members and bodies in all rows."""
        solution, rows = self.solution, list(self.rows)
        positions, nodes = self.positions(np.arange(len(solution.X)), rows), solution.nodes_of_beam
        members = [axis(positions[:, nodes[name]], b.degree) for name, b in solution.beams.items()]
        numbers = [n.number for body in solution.bodies.values() for n in body.nodes]
        return np.concatenate([*members, self.positions(numbers, rows)], axis=1).reshape(-1, 2)

    @cached_property
    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right corner of the drawing, with a margin."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        size = max(high - low)
        # Space for symbols; a straight member needs more beside it.
        margin = np.maximum(0.05 * size, (0.3 * size - (high - low)) / 2)
        return low - margin, high + margin

    @cached_property
    def size(self) -> float:
        """Larger side of the window [m]."""
        low, high = self.window
        return float(max(high - low))

    @property
    def thinness(self) -> float:
        """Factor of the widths of lines: 1, or less in frames of many members."""
        return min(1.0, 50 / max(1, len(self.solution.beams)) ** 0.5)

    @cached_property
    def _nodes_of_elements(self) -> np.ndarray:
        beams = self.solution.beams
        return np.concatenate([nodes_of_elements(self.solution, name) for name in beams])

    def axis(self, beam: str, rows) -> np.ndarray:
        """Points (..., points, 2) of a beam's axis in some rows."""
        positions = self.positions(self.solution.nodes_of_beam[beam], rows)
        return axis(positions, self.solution.beams[beam].degree)

    def pieces(self, k: int, count: int) -> np.ndarray:
        """Ends (elements * count, 2, 2) of `count` pieces of each element of all beams."""
        nodes = self._nodes_of_elements
        values = lagrange(np.linspace(0, 1, nodes.shape[1]), np.arange(count + 1) / count)
        points = values @ self.positions(nodes, k)
        return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 2)

    def positions(self, nodes, rows) -> np.ndarray:
        """Positions (..., 2) of nodes, by their numbers, in some rows."""
        nodes = np.asarray(nodes, dtype=int)
        moved = self.solution.q[rows][..., nodes, :2]
        return self.solution.X[nodes] + self.magnify * moved

    def turned(self, node: Node, k: int, arrow) -> np.ndarray:
        """A vector (2,) that rotates with a node, in row k."""
        if node is GROUND:
            return np.asarray(arrow)
        psi = self.magnify * self.solution.rotation(node)[k]
        c, s = np.cos(psi), np.sin(psi)
        return np.array([c * arrow[0] - s * arrow[1], s * arrow[0] + c * arrow[1]])

    def force(self, load: Load, node: Node, k: int) -> np.ndarray:
        """A force (2,) on a node in row k [N]."""
        t = self.solution.t[k]
        force = np.asarray(load.value(0.0) * t if self.solution.stats.static else load.value(t))
        return self.turned(node, k, force) if load.follower else force

    @cached_property
    def forces(self) -> list[tuple[Load, Node]]:
        """The forces on nodes, and the nodes."""
        loads = self.scene.loads
        return [(load, load.target) for load in loads if load.kind == "force"]

    @cached_property
    def largest_force(self) -> float:
        """The largest force in the rows that are drawn [N]."""
        sizes = [np.hypot(*self.force(*load, k)) for load in self.forces for k in self.rows]
        return max(sizes, default=0.0)

    def title(self) -> str:
        """Scheme and time step, or the kind of analysis, as a title."""
        t, stats = self.solution.t, self.solution.stats
        if stats.static:
            return "equilibria"
        steps = f"{stats.steps} steps to {t[-1]:g} s"
        even = len(t) == stats.steps + 1 and np.ptp(np.diff(t)) <= 1e-6 * t[-1]
        return f"{stats.scheme}, " + (rf"$\Delta t$ = {t[1] - t[0]:g} s" if even else steps)

    def check(self) -> None:
        """Raise an error for rows that the solution does not have."""
        require(isinstance(self.solution, Solution), "solution", self.solution, "a Solution")
        rows = len(self.solution.t)
        fits = numbers(self.rows).ndim == 1 and all(is_whole(k, 0, rows - 1) for k in self.rows)
        wanted = f"rows of the solution, such as range(0, {rows}, {max(1, rows // 10)})"
        require(fits and len(self.rows) > 0, "steps", self.rows, wanted)
        fits = is_number(self.magnify) and as_float(self.magnify) > 0
        require(fits, "magnify", self.magnify, "a positive number")


# -- Symbols of one row ----------------------------------------------------------------------------


def draw_symbols(ax, drawing: Drawing, k: int, colour: Any = "black", small: bool = False) -> list:
    """Draw masses, joints, guides, springs and forces of row k; returns the artists."""
    if drawing.scene is None:
        return draw_bodies(ax, drawing, k, colour, small)
    drawn = [*_draw_guides(ax, drawing, k, colour), *draw_parts(ax, drawing, k, colour, small)]
    return drawn + _draw_forces(ax, drawing, k, colour)


def draw_parts(ax, drawing: Drawing, k: int, colour: Any = "black", small: bool = False) -> list:
    """Draw masses, joints, springs, dampers and friction of row k; returns the artists."""
    scene = drawing.scene
    drawn = [*_draw_arms(ax, drawing, k, colour), *_draw_springs(ax, drawing, k, colour)]
    drawn += draw_bodies(ax, drawing, k, colour, small)
    drawn += _draw_dampers(ax, drawing, k, colour)
    drawn += _draw_friction(ax, drawing, k, colour)
    heavy = sorted({node for node, mass, _ in scene.masses if mass})
    look = {"color": colour if small else "#D55E00", "markersize": 7 if small else 9, "zorder": 3}
    if heavy:
        drawn += ax.plot(*drawing.positions(heavy, k).T, "o", **look)
    look = _JOINT | {"markeredgecolor": colour, "markersize": 3.5 if small else 5, "zorder": 5}
    # A square for a slide, a ring for a hinge; rigid joints are not marked.
    for marker in "os":
        nodes = [
            (joint.a if joint.b is GROUND else joint.b).number
            for joint in scene.joints
            # A hinge on the ground is drawn as a support.
            if not joint.is_rigid and marker == ("o" if joint.slide is None else "s")
            if not (_is_grounded(joint) and joint.slide is None)
        ]
        if nodes:
            drawn += ax.plot(*drawing.positions(nodes, k).T, marker, **look)
    return drawn


def draw_bodies(ax, drawing: Drawing, k: int, colour: Any, small: bool) -> list:
    """Draw bodies in row k: arms from centre to points, and the area between; the artists."""
    drawn: list = []
    for body in drawing.solution.bodies.values():
        centre, *points = drawing.positions([node.number for node in body.nodes], k)
        for point in points:
            drawn += ax.plot(*np.array([centre, point]).T, color=colour, linewidth=2.0, zorder=2)
        if len(points) > 1:
            around = [centre, *points]
            about = np.array(around) - np.mean(around, axis=0)
            order = np.argsort(np.arctan2(about[:, 1], about[:, 0]))
            corners = np.array(around)[order].T
            drawn += ax.fill(*corners, facecolor=colour, alpha=0.03 if small else 0.15, zorder=1)
        drawn += ax.plot(*centre, "+", color=colour, markersize=6, zorder=4)
    return drawn


def draw_marks(ax, drawing: Drawing, k: int, marks: dict[str, Node]) -> list:
    """Write names beside nodes in row k; returns the artists."""
    drawn: list = []
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for name, node in marks.items():
        drawing.solution.position(node)  # raises an error if it is not a node of the solution
        position = drawing.positions(node.number, k)
        drawn += ax.plot(*position, ".", color="black", markersize=5, zorder=6)
        offset = {"xytext": (5, 5), "textcoords": "offset points"}
        drawn.append(ax.annotate(name, position, **offset, fontsize="small", zorder=7))
    return drawn


def draw_supports(ax, drawing: Drawing) -> list:
    """A ring at a pin, a square at a clamp, a triangle at other supports; dotted guides."""
    if drawing.scene is None:
        return []
    drawn: list = []
    for joint in filter(_is_grounded, drawing.scene.joints):
        if joint.axis is not None:
            node = joint.a if joint.b is GROUND else joint.b
            path = drawing.positions(node.number, slice(None))
            along = (path - path[0]) @ joint.axis
            drawn += ax.plot(*path[[along.argmin(), along.argmax()]].T, color="0.5", **_GUIDE)
    look = _JOINT | {"markersize": 7, "zorder": 5}
    for number, marker in supports(drawing):
        drawn += ax.plot(*drawing.solution.X[number], marker, **look)
    return drawn


def supports(drawing: Drawing) -> list[tuple[int, str]]:
    """Numbers of the nodes that are held, each with its marker."""
    held: dict[int, set[int]] = {}
    scene = drawing.scene
    for node, component in () if scene is None else scene.fixed:
        held.setdefault(node, set()).add(component)
    for joint in () if scene is None else filter(_is_grounded, scene.joints):
        if joint.axis is None:
            node = joint.a if joint.b is GROUND else joint.b
            held[node.number] = {0, 1, 2} if joint.is_rigid else {0, 1}
    return [
        (number, "s" if len(components) == 3 else "o" if components == {0, 1} else "^")
        for number, components in held.items()
    ]


def _is_grounded(joint: Joint) -> bool:
    return GROUND in (joint.a, joint.b)


def _draw_guides(ax, drawing: Drawing, k: int, colour) -> list:
    """Guides on nodes, from their position on the node to the sliding node."""
    drawn: list = []
    for joint in drawing.scene.joints:
        if joint.axis is not None and not _is_grounded(joint):
            ends = _position_on_a(drawing, joint, k), drawing.positions(joint.b.number, k)
            drawn += ax.plot(*np.array(ends).T, color=colour, **_GUIDE)
    return drawn


def _position_on_a(drawing: Drawing, joint: Joint, k: int) -> np.ndarray:
    """Position of a joint on its node a, in row k."""
    return drawing.positions(joint.a.number, k) + drawing.turned(joint.a, k, joint.offset)


def _draw_arms(ax, drawing: Drawing, k: int, colour) -> list:
    """Rigid arms from nodes to joints with an offset."""
    drawn: list = []
    centres = {body.centre for body in drawing.solution.bodies.values()}
    for joint in drawing.scene.joints:
        of_body = joint.is_rigid and joint.a in centres
        if joint.offset.any() and not (of_body or _is_grounded(joint)):
            ends = drawing.positions(joint.a.number, k), _position_on_a(drawing, joint, k)
            drawn += ax.plot(*np.array(ends).T, color=colour, linewidth=2.0, zorder=2)
    return drawn


def _draw_springs(ax, drawing: Drawing, k: int, colour) -> list:
    """Springs of joints: a zigzag along a slide, a spiral around a hinge."""
    drawn: list = []
    look = {"color": colour, "linewidth": 0.9, "zorder": 2}
    for joint in drawing.scene.joints:
        if joint.slide is not None and joint.slide.spring is not None:
            drawn += ax.plot(*_zigzag(*_spring_ends(drawing, joint, k), drawing.size).T, **look)
        if joint.rotation is not None and joint.rotation.spring is not None:
            angle = np.linspace(0, 5 * np.pi, 60)
            spiral = angle * np.array([np.cos(angle), np.sin(angle)]) / angle[-1]
            position = _position_of(drawing, joint, k)
            drawn += ax.plot(*(position[:, None] + _SPRING_WIDTH * drawing.size * spiral), **look)
    return drawn


def _draw_dampers(ax, drawing: Drawing, k: int, colour) -> list:
    """Dampers of joints: a dashpot along a slide, a curved dashpot around a hinge."""
    drawn: list = []
    look = {"color": colour, "linewidth": 0.9, "zorder": 2}
    for joint in drawing.scene.joints:
        if joint.slide is not None and joint.slide.damper is not None:
            beside = joint.slide.spring is not None
            parts = _dashpot(*_spring_ends(drawing, joint, k), drawing.size, beside)
            drawn += ax.plot(*parts.T, **look)
        if joint.rotation is not None and joint.rotation.damper is not None:
            position = _position_of(drawing, joint, k)
            drawn += ax.plot(*(position + _SPRING_WIDTH * drawing.size * _BENT_CUP).T, **look)
    return drawn


def _draw_friction(ax, drawing: Drawing, k: int, colour) -> list:
    """Friction of joints: the shoes of a brake beside a slide, or around a hinge."""
    drawn: list = []
    look = {"color": colour, "linewidth": 2.5, "zorder": 2, "solid_capstyle": "butt"}
    for joint in drawing.scene.joints:
        position, width = _position_of(drawing, joint, k), _SPRING_WIDTH * drawing.size
        if joint.slide is not None and joint.slide.friction is not None:
            along = slide_direction(drawing, joint, k)
            shoes = _SHOES[:, :1] * along + _SHOES[:, 1:] * (-along[1], along[0])
            on_b = position if joint.b is GROUND else drawing.positions(joint.b.number, k)
            drawn += ax.plot(*(on_b + width * shoes).T, **look)
        if joint.rotation is not None and joint.rotation.friction is not None:
            drawn += ax.plot(*(position + width * _BENT_SHOES).T, **look)
    return drawn


def _position_of(drawing: Drawing, joint: Joint, k: int) -> np.ndarray:
    """Position of a joint's node, in row k."""
    return drawing.positions((joint.a if joint.b is GROUND else joint.b).number, k)


def _spring_ends(drawing: Drawing, joint: Joint, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the spring on a slide: its node, and its point on node a or on the ground."""
    if joint.axis is None:  # on a beam: a short one, from the side of its start
        position = drawing.positions(joint.b.number, k)
        return position - _SPRING_END * drawing.size * slide_direction(drawing, joint, k), position
    if not _is_grounded(joint):
        return _position_on_a(drawing, joint, k), drawing.positions(joint.b.number, k)
    node = joint.a if joint.b is GROUND else joint.b
    far = -_SPRING_END * drawing.size * joint.axis
    return drawing.solution.X[node.number] + far, drawing.positions(node.number, k)


def _zigzag(a: np.ndarray, b: np.ndarray, size: float) -> np.ndarray:
    """Points (11, 2) of a spring from a to b."""
    along = (b - a) / max(np.hypot(*(b - a)), 1e-9 * size)
    across = _SPRING_WIDTH * size * np.array([-along[1], along[0]])
    fractions = np.array([0, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 1])
    sides = np.array([0, 0, 1, -1, 1, -1, 1, -1, 1, 0, 0])
    return a + fractions[:, None] * (b - a) + sides[:, None] * across


def _dashpot(a: np.ndarray, b: np.ndarray, size: float, beside: bool) -> np.ndarray:
    """Points of a damper from a to b, beside a spring if there is one; NaN marks gaps."""
    along = (b - a) / max(np.hypot(*(b - a)), 1e-9 * size)
    across = _SPRING_WIDTH * size * np.array([-along[1], along[0]])
    gap = (np.nan, np.nan)
    rod = [(0, 0), (0.5, 0), gap, (0.5, -0.7), (0.5, 0.7), gap]
    cup = [(0.35, -1), (0.65, -1), (0.65, 1), (0.35, 1), gap, (0.65, 0), (1, 0)]
    parts = np.array(rod + cup) + (0, 3.0 if beside else 0)
    return a + parts[:, :1] * (b - a) + parts[:, 1:] * across


def _draw_forces(ax, drawing: Drawing, k: int, colour) -> list:
    """Arrows of forces, with their heads at the nodes and lengths in proportion to the forces."""
    drawn = []
    for load, node in drawing.forces:
        force = drawing.force(load, node, k)
        if np.hypot(*force) > 0.02 * drawing.largest_force:
            tip = drawing.positions(node.number, k)
            tail = tip - _LONGEST_FORCE * drawing.size * force / drawing.largest_force
            look = {"arrowprops": _ARROW | {"color": colour}, "annotation_clip": False}
            drawn.append(ax.annotate("", tip, tail, **look, zorder=4))
    return drawn
