"""Drawing of a scene before it runs: members, joints, supports, loads and other actions."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fx_beam.dual import floats
from fx_beam.errors import SceneError, is_flag, require, shown
from fx_beam.scene.beam import Beam, Node, position_of, reference_positions
from fx_beam.scene.contacts import arc_of
from fx_beam.scene.coordinate import Locked
from fx_beam.scene.functions import Signal, SignalAlong
from fx_beam.scene.inputs import InputSignal
from fx_beam.scene.loads import Load, VirtualWork, label
from fx_beam.scene.parts import Parts
from fx_beam.scene.pressure import PressureTerm
from fx_beam.scene.scene import Scene

from .drawing import Drawing, apart, axis, three_digits
from .outlines import interpolated
from .sheet import Sheet, picture, written
from .symbols import draw_moving, draw_surroundings, left_of, node_of

# Fractions of the drawing's size: arrows of forces, line loads and motions; radius of rotations.
_FORCE, _LINE_LOAD, _MOTION, _TURN = 0.12, 0.06, 0.08, 0.045
_BESIDE = 0.02
_DRIVEN, _INITIAL, _LOAD, _STRAINED = "#009E73", "#CC79A7", "black", "#D55E00"
_STRAINS = {"axial": r"$\varepsilon^*$", "shear": r"$\gamma^*$", "curvature": r"$\kappa^*$"}
#: Times at which a function of time is evaluated, to find its direction [s].
_TIMES = np.concatenate([[0.0], 2.0 ** np.arange(-12, 8)])
_ARROWS = 12  # largest number of arrows of a line load or of initial velocities


def draw_actions(sheet: Sheet, scene: Scene, si: bool) -> None:
    """Draw all actions, with values in SI units or without units."""
    drawn = {"force": _force, "moment": _moment, "line load": _line_load}
    for load in scene.loads:
        if load.target is not None:
            drawn[load.kind](sheet, load, si)
    for work in scene.virtual_works:
        _pressure(sheet, scene, work, si)
    _drags(sheet, scene)
    _natural_strains(sheet, scene, si)
    _velocities(sheet, scene)
    _prescribed(sheet, scene)
    _motors(sheet, scene)
    if scene.gravity is not None and np.any(scene.gravity):
        size = np.hypot(*scene.gravity)
        _weight(sheet, scene.gravity, f"g = {three_digits(size)}{' m/s$^2$' if si else ''}")
    for load in scene.loads:
        if load.kind == "gravity" and np.any(gravity := _shown(load)):
            _weight(sheet, gravity, _words("g", load, np.hypot(*gravity), "m/s$^2$", si))
        elif load.target is None:
            way = load.kind[-1]
            words = _words(f"base: $a_{way}$", load, float(_shown(load)[0]), "m/s$^2$", si)
            _driven(sheet, sheet.corner(), words, np.eye(2)["xy".index(way)])


def _shown(load: Load) -> np.ndarray:
    """The largest value of a load at the sampled times."""
    if isinstance(load.value, InputSignal):
        return load.value.factor.sum(axis=1)
    return _largest(load)[1]


def _largest(load: Load) -> tuple[float, np.ndarray]:
    """The sampled time at which a load is largest, and the value then."""
    samples = [(0.0, load.value(0.0))]
    for t in _TIMES[1:].tolist():
        with suppress(Exception):  # a function may be defined for the times of its run only
            samples.append((t, load.value(t)))
    sizes = [np.hypot(*value) if len(value) == 2 else abs(value[0]) for _, value in samples]
    return samples[int(np.nanargmax(sizes))]


def _words(symbol: str, load: Load, value: float, unit: str, si: bool) -> str:
    if isinstance(load.value, InputSignal):
        return load.value.name + ", follower" * load.follower
    value_and_unit = f" = {three_digits(value)}{f' {unit}' if si else ''}"
    return symbol + (load.value.arguments or value_and_unit) + ", follower" * load.follower


def _force(sheet: Sheet, load: Load, si: bool) -> None:
    force, tip = _shown(load), position_of(load.target)
    size = np.hypot(*force)
    if size > 0:
        tail = tip - _FORCE * sheet.size * force / size
        sheet.arrow([tail, tip], linewidth=1.6, color=_LOAD)
        sheet.label(_words("F", load, size, "N", si), [tail, (tail + tip) / 2], _LOAD)


def _moment(sheet: Sheet, load: Load, si: bool) -> None:
    (moment,) = _shown(load)
    if moment:
        points = _turn(position_of(load.target), sheet.size, np.sign(moment))
        sheet.arrow(points, linewidth=1.4, color=_LOAD)
        sheet.label(_words("M", load, moment, "N m", si), points[::4], _LOAD)


def _line_load(sheet: Sheet, load: Load, si: bool) -> None:
    beam: Any = load.target
    first, last = load.between or (0.0, beam.length)
    arc, points = np.linspace(first, last, _ARROWS + 1), _axis(beam)
    s = arc_of(points)
    tips = interpolated(arc, s * beam.length / s[-1], points)
    if isinstance(load.value, SignalAlong):
        loads = floats(load.value.at(arc, _largest(load)[0]))
    elif load.value.place:
        loads = np.array([load.value(s) for s in arc])
    else:
        loads = np.tile(_shown(load), (len(arc), 1))
    _arrows_along(sheet, tips, loads, load, si)


def _pressure(sheet: Sheet, scene: Scene, work: VirtualWork, si: bool) -> None:
    """Arrows across a beam, on the side from which the pressure pushes."""
    if not isinstance(work.term, PressureTerm):
        return
    beam: Any = work.beam
    start, *_, end = beam.s[slice(work.elements[0], (work.elements[1] or beam.elements) + 1)]
    load = Load("line load", beam, scene.parameters.functions[work.term.pressure.name])
    points = _axis(beam)
    s = arc_of(points)
    arc = np.linspace(start, end, _ARROWS + 1) * s[-1] / beam.length
    tangents = interpolated(arc, s, np.gradient(points, s, axis=0))
    tips = interpolated(arc, s, points)
    _arrows_along(sheet, tips, _shown(load) * left_of(tangents), load, si)


def _arrows_along(sheet: Sheet, tips: np.ndarray, loads: np.ndarray, load: Load, si: bool) -> None:
    """Arrows of loads (n, 2) that end at points (n, 2), and a line along their tails."""
    sizes = np.hypot(*loads.T)
    if not sizes.max() > 0:
        return
    tails = tips - _LINE_LOAD * sheet.size * loads / sizes.max()
    sheet.line(tails, color=_LOAD, linewidth=0.8)
    visible = sizes > 0.05 * sizes.max()
    for tail, tip in zip(tails[visible], tips[visible], strict=True):
        sheet.arrow([tail, tip], color=_LOAD, linewidth=0.8)
    symbol = "p" if load.value.size == 1 else "q"
    sheet.label(_words(symbol, load, sizes.max(), "N/m", si), tails[1:-1], _LOAD)


def _axis(beam: Beam) -> np.ndarray:
    """Points (n, 2) of the axis of a beam in its reference configuration."""
    return axis(floats(reference_positions(beam)), beam.degree)


def _drags(sheet: Sheet, scene: Scene) -> None:
    """The word, at each beam and node with drag."""
    targets = {label(drag.target): drag.target for drag in scene.drags}
    for target in targets.values():
        nodes = target.nodes if isinstance(target, Beam) else (target,)
        sheet.label("drag", [position_of(node) for node in nodes[::-1]], _LOAD)


def _natural_strains(sheet: Sheet, scene: Scene, si: bool) -> None:
    """A dashed line beside each beam that has natural strains, with what they are."""
    for strain in scene.natural_strains:
        points = _axis(strain.beam)
        left = left_of(np.gradient(points, axis=0))
        left /= np.hypot(*left.T)[:, None]
        line = points + _BESIDE * sheet.size * left
        sheet.line(line, color=_STRAINED, linewidth=1.2, linestyle=(0, (4, 2)))
        words = [_of_part(*part, si) for part in strain.parts.items()]
        sheet.label(", ".join(words), line[len(line) // 2 :], _STRAINED)


def _of_part(name: str, value: Signal, si: bool) -> str:
    """A component of a natural strain as text: value, input, or arguments of a function."""
    symbol = _STRAINS[name]
    if isinstance(value, InputSignal):
        return f"{symbol}: {value.name}"
    unit = " 1/m" if si and name == "curvature" else ""
    words = value.arguments or f" = {three_digits(float(value(0.0)[0]))}{unit}"
    return symbol + words


def _prescribed(sheet: Sheet, scene: Scene) -> None:
    for number, component in scene.prescribed:
        text = ("x(t)", "y(t)", r"$\psi$(t)")[component]
        direction = None if component == 2 else np.eye(2)[component]
        _driven(sheet, position_of(scene.nodes[number]), text, direction)


def _motors(sheet: Sheet, scene: Scene) -> None:
    for joint in scene.joints:
        for name in joint.driven:
            text = {"slide": "motor d(t)", "rotation": r"motor $\psi$(t)"}[name]
            text = "locked" if isinstance(joint.coordinates[name].motor, Locked) else text
            direction = joint.direction if name == "slide" else None
            _driven(sheet, position_of(node_of(joint)), text, direction)


def _driven(sheet: Sheet, position, text: str, direction: np.ndarray | None) -> None:
    """An arrow with two heads: along a direction, beside a point, or around the point."""
    if direction is None:
        points = _turn(position, sheet.size, 1.0)
        ends = points[::4]
    else:
        middle = position + 0.04 * sheet.size * left_of(direction)
        points = middle + _MOTION * sheet.size * np.outer((-1, 0, 1), direction)
        ends = points[::-1]
    sheet.arrow(points, "<-|>", color=_DRIVEN, linewidth=1.4)
    sheet.label(text, ends, _DRIVEN)


def _velocities(sheet: Sheet, scene: Scene) -> None:
    """Initial velocities, with arrows in proportion to them."""
    velocities: dict[int, np.ndarray] = {}
    for velocity in scene.velocities:
        nodes = velocity.target.nodes if isinstance(velocity.target, Beam) else (velocity.target,)
        for node in nodes[:: max(1, len(nodes) // _ARROWS)]:
            velocities[node.number] = velocity.value(node.x, node.y)
    largest = max((np.hypot(*value) for value in velocities.values()), default=0.0)
    tips = []
    for number, value in velocities.items():
        if np.hypot(*value) > 0.02 * largest:
            position = position_of(scene.nodes[number])
            tips.append(position + _FORCE * sheet.size * value / largest)
            sheet.arrow([position, tips[-1]], color=_INITIAL)
    if tips:
        sheet.label("v(0)", tips, _INITIAL)


def _weight(sheet: Sheet, gravity, words: str) -> None:
    """The acceleration of gravity, beside everything drawn so far."""
    size = np.hypot(*gravity)
    tip = sheet.corner() + 0.5 * _FORCE * sheet.size * np.asarray(gravity) / size
    tail = tip - _FORCE * sheet.size * np.asarray(gravity) / size
    sheet.arrow([tail, tip], color="0.4")
    sheet.label(words, [(tail + tip) / 2], "0.4")


def _turn(position, size: float, sense: float) -> np.ndarray:
    """Points (33, 2) of three quarters of a circle about a point."""
    angle = np.pi / 4 + sense * np.linspace(0, 1.5 * np.pi, 33)
    return position + _TURN * size * np.column_stack([np.cos(angle), np.sin(angle)])


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
    an arc with two ends its stops. A dotted line between two joints is a gear. Grey hatched lines
    and circles are obstacles. Beams and nodes with drag have the word "drag".
    Arrows of forces end at their nodes, arrows of initial velocities start there.
    Prescribed motions, motors and the acceleration of the base have arrows with two heads. Loads
    that are functions of time are drawn with their largest value. Other virtual works
    than pressures are not drawn.

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
    if not (scene.beams or scene.bodies):
        raise SceneError("plot.scene: the scene has no beams; add one with scene.add_beam")
    path = picture(path)
    require(is_flag(dimensions), "dimensions", dimensions, "True or False")
    drawing = Drawing(Reference(scene), [0], unit=scene_unit)
    axes = {beam.name: drawing.axis(beam.name, 0) for beam in scene.beams}
    sheet = Sheet(drawing.reach)
    _members(sheet, scene, axes, drawing.thinness)
    draw_surroundings(sheet.ax, drawing, 0)
    draw_moving(sheet.ax, drawing, 0)
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
        self.contacts, self.parts = scene.contacts, ((0, Parts.of(scene)),)
        #: Rows of `X` with the nodes of each beam in order, also inside elements. For this `X` has
        #: the nodes of each beam once more.
        self.nodes_of_beam = dict[str, np.ndarray]()
        free, rows = len(scene.nodes), [np.array([(node.x, node.y) for node in scene.nodes])]
        for beam in scene.beams:
            rows.append(floats(reference_positions(beam)))
            self.nodes_of_beam[beam.name] = np.arange(free, free := free + len(rows[-1]))
        self.X = np.concatenate(rows)
        self.q = np.zeros((1, len(self.X), 3))


def _members(sheet: Sheet, scene: Scene, axes: dict[str, np.ndarray], width: float) -> None:
    if len(axes) > _CROWD:
        sheet.line(apart(axes.values()), color=_MEMBER, linewidth=2.5 * width, zorder=2)
        return
    for beam in scene.beams:
        sheet.line(axes[beam.name], color=_MEMBER, linewidth=2.5, zorder=2)
        ends = [(node.x, node.y) for node in beam.nodes]
        sheet.ax.plot(*np.transpose(ends), ".", color=_MEMBER, markersize=6, zorder=2)


def _names(sheet: Sheet, scene: Scene, axes, marks: dict[str, Node], si: bool) -> None:
    """Labels of masses, marked nodes and members, in the order of their priority."""
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for name, node in marks.items():
        if getattr(node, "scene", None) is not scene:
            raise SceneError(f"mark {name!r}: {shown(node)} is not a node of the scene")
        sheet.ax.plot(node.x, node.y, ".", color="black", markersize=5, zorder=4)
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
        places = interpolated(s[-1] * np.array([0.5, 0.35, 0.65, 0.2, 0.8]), s, points)
        sheet.label(name, places, _MEMBER, size)


def _dimensions(sheet: Sheet, scene: Scene, points: np.ndarray) -> None:
    """Dimension lines below and to the left, between the ends of members and the extremes."""
    ends = [(node.x, node.y) for beam in scene.beams for node in (beam.start, beam.end)]
    ends += [(node.x, node.y) for body in scene.bodies for node in body.nodes]
    low, high = points.min(axis=0), points.max(axis=0)
    for i in (0, 1):
        values = np.sort(np.concatenate([np.array(ends)[:, i], [low[i], high[i]]]))
        values = values[np.append(True, np.diff(values) > _SHORTEST * sheet.size)]
        normal = np.eye(2)[1 - i]
        level = (low[1 - i] - _AWAY * sheet.size) * normal
        tick = 0.02 * sheet.size * normal
        for a, b in zip(values[:-1], values[1:], strict=True):
            tail, tip = (level + value * np.eye(2)[i] for value in (a, b))
            sheet.arrow([tail, (tail + tip) / 2, tip], "<-|>", **_DIMENSION)
            ticks = np.array([[point - tick, point + tick] for point in (tail, tip)])
            sheet.line(apart(ticks), **_DIMENSION)
            sheet.label(three_digits(b - a), (tail + tip) / 2, "0.3")
