"""Drawing of a scene before it runs: members, joints, supports and loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fx_beam.errors import SceneError, is_flag, is_name, require, shown
from fx_beam.scene.beam import Node, inner_positions
from fx_beam.scene.contacts import arc_of
from fx_beam.scene.scene import Scene

from .actions import draw_actions
from .drawing import Drawing, apart, interpolated, three_digits
from .plane import picture, written
from .sheet import Sheet
from .supports import Supports
from .symbols import draw_joints, draw_moving, draw_outlines

_MEMBER = "#0072B2"
_DIMENSION = {"color": "0.45", "linewidth": 0.6}
# Fractions of the drawing's size: distance of dimensions from it, and the shortest dimension shown.
_AWAY, _SHORTEST = 0.2, 0.04
_MANY = 15  # number of members above which their names are small
_CROWD = 500  # number of members above which they have neither names nor dots


def scene(
    scene: Scene,
    path: Path | str | None = None,
    scene_unit: str = "m",
    dimensions: bool = False,
    marks: dict[str, Node] | None = None,
) -> Figure:
    """Drawing of a scene in its reference configuration.

    Members have their names, and dots between elements, but not if there are more than 500. Bodies
    are arms from a cross at the centre of mass to their points, with the area between them. Hatched
    lines are the ground. A pin is a triangle, a roller a triangle with a gap, a clamp a wall. Rings
    are hinges, squares on dotted lines are slides, discs are lumped masses. A zigzag or a spiral is
    the spring of a joint, a cup its damper, two thick strokes its friction, bars across a slide or
    an arc with two ends its stops. Grey hatched lines and circles are obstacles. Beams and nodes
    with drag have the word "drag".
    Arrows of forces end at their nodes, those of initial velocities start there.
    Prescribed motions and motors have arrows with two heads. Loads that are functions of time are
    drawn with their largest value. Added virtual works are not drawn.

    Parameters
    ----------
    scene : Scene
        Scene to draw.
    path : str or path, optional
        Picture to write; its ending gives the format.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled. With "m"
        masses and loads have SI units, otherwise none.
    dimensions : bool
        Whether to write the distances between the ends of members.
    marks : dict, optional
        Nodes by the names that are written beside them.

    Returns
    -------
    matplotlib.figure.Figure
        The drawing; its axes are ``figure.axes[0]``.

    Raises
    ------
    SceneError
        If it is not a scene, or a scene without beams and bodies.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"plot.scene needs an fx_beam.Scene, not {shown(scene)}")
    if not scene.nodes:
        raise SceneError("plot.scene: the scene has no beams; add one with scene.add_beam")
    path = picture(path)
    require(is_flag(dimensions), "dimensions", dimensions, "True or False")
    require(is_name(scene_unit), "scene_unit", scene_unit, "a text")
    drawing = Drawing(Reference(scene), [0])
    axes = {beam.name: drawing.axis(beam.name, 0) for beam in scene.beams}
    sheet = Sheet(drawing.reach)
    _members(sheet, scene, axes, drawing.thinness)
    sheet.see(draw_outlines(sheet.ax, drawing.obstacles))
    sheet.see(Supports(drawing).draw(sheet.ax, 0))
    sheet.see(draw_moving(sheet.ax, drawing, 0))
    sheet.see(draw_joints(sheet.ax, drawing, 0))
    draw_actions(sheet, scene, si=scene_unit == "m")
    _names(sheet, scene, axes, {} if marks is None else marks, si=scene_unit == "m")
    if dimensions:
        _dimensions(sheet, scene, drawing.points)
    return written(sheet.finish(scene_unit), path)


class Reference:
    """A scene in its reference configuration, in the form of a solution with one row."""

    def __init__(self, scene: Scene):
        self.beams = {beam.name: beam for beam in scene.beams}
        self.bodies = {body.name: body for body in scene.bodies}
        self.contacts = scene.contacts
        #: Rows of `X` with the nodes of each beam in order, including those inside elements.
        self.nodes_of_beam = dict[str, np.ndarray]()
        free = len(scene.nodes)
        for beam in scene.beams:
            inside = beam.elements * (beam.degree - 1)
            of_beam = np.empty(beam.elements * beam.degree + 1, dtype=int)
            ends = np.arange(len(of_beam)) % beam.degree == 0
            of_beam[ends] = [node.number for node in beam.nodes]
            of_beam[~ends] = np.arange(free, free + inside)
            self.nodes_of_beam[beam.name] = of_beam
            free += inside
        places = np.array([(node.x, node.y) for node in scene.nodes])
        self.X = np.concatenate([places, *map(inner_positions, scene.beams)])
        self.q = np.zeros((1, len(self.X), 3))

    def rotation(self, node: Node) -> np.ndarray:
        """Rotation (1,) of a node: zero."""
        return np.zeros(1)


def _members(sheet: Sheet, scene: Scene, axes: dict[str, np.ndarray], width: float) -> None:
    if len(axes) > _CROWD:
        sheet.line(apart(axes.values()), color=_MEMBER, linewidth=2.5 * width, zorder=2)
        return
    for beam in scene.beams:
        sheet.line(axes[beam.name], color=_MEMBER, linewidth=2.5, zorder=2)
        ends = [(node.x, node.y) for node in beam.nodes]
        sheet.dots(ends, ".", color=_MEMBER, markersize=6, zorder=2)


def _names(sheet: Sheet, scene: Scene, axes, marks: dict[str, Node], si: bool) -> None:
    """Labels of masses, marked nodes and members, in the order of their priority."""
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for name, node in marks.items():
        if getattr(node, "scene", None) is not scene:
            raise SceneError(f"mark {name!r}: {shown(node)} is not a node of the scene")
        sheet.dots([(node.x, node.y)], ".", color="black", markersize=5, zorder=4)
        sheet.label(name, (node.x, node.y))
    for number, mass, inertia in scene.masses:
        node = scene.nodes[number]
        words = [f"m = {three_digits(mass)}{' kg' if si else ''}"] if mass else []
        words += [f"J = {three_digits(inertia)}{' kg m$^2$' if si else ''}"] if inertia else []
        if words:
            sheet.label(", ".join(words), (node.x, node.y))
    for body in scene.bodies:
        sheet.label(body.name, (body.centre.x, body.centre.y), _MEMBER)
    size = 9.0 if len(axes) <= _MANY else 5.5
    for name, points in axes.items() if len(axes) <= _CROWD else ():
        s = arc_of(points)
        at = interpolated(s[-1] * np.array([0.5, 0.35, 0.65, 0.2, 0.8]), s, points)
        sheet.label(name, at, _MEMBER, size)


def _dimensions(sheet: Sheet, scene: Scene, points: np.ndarray) -> None:
    """Dimension lines below and to the left, between the ends of members and the extremes."""
    ends = [(node.x, node.y) for beam in scene.beams for node in (beam.start, beam.end)]
    ends += [(node.x, node.y) for body in scene.bodies for node in body.nodes]
    low, high = points.min(axis=0), points.max(axis=0)
    for i in (0, 1):
        values = np.sort(np.concatenate([np.array(ends)[:, i], [low[i], high[i]]]))
        values = values[np.append(True, np.diff(values) > _SHORTEST * sheet.size)]
        across = np.eye(2)[1 - i]
        level = (low[1 - i] - _AWAY * sheet.size) * across
        tick = 0.02 * sheet.size * across
        for a, b in zip(values[:-1], values[1:], strict=True):
            tail, tip = (level + value * np.eye(2)[i] for value in (a, b))
            sheet.arrow([tail, (tail + tip) / 2, tip], "<-|>", **_DIMENSION)
            sheet.strokes(np.array([tail, tip]) - tick, np.array([tail, tip]) + tick, **_DIMENSION)
            sheet.label(three_digits(b - a), (tail + tip) / 2, "0.3")
