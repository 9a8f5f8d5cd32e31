"""Drawing of a scene before it runs: members, joints, supports, loads and other actions."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from fx_beam.dual import floats
from fx_beam.errors import SceneError, is_flag, require, shown
from fx_beam.scene.beam import Beam, Node, position_of, reference_positions
from fx_beam.scene.contacts import arc_of
from fx_beam.scene.coordinate import Locked
from fx_beam.scene.functions import InputSignal, Signal, SignalAlong
from fx_beam.scene.loads import Load, PressureTerm, VirtualWork, label
from fx_beam.scene.parts import Parts
from fx_beam.scene.scene import Scene

from .drawing import (
    Drawing,
    Plane,
    axis,
    interpolated,
    node_of,
    picture,
    three_digits,
    with_unit,
    words_over,
    written,
)
from .labels import Labels
from .look import ACTS, MEMBERS, Colour, Pen, left_of, mixed, theme_of, unit
from .symbols import colours_of, draw_held, draw_members, draw_moving, lumped_masses

# Lengths of arrows of forces, line loads and motions; radius of turns; beside a member [points].
_FORCE, _LINE_LOAD, _MOTION, _TURN, _BESIDE = 32.0, 16.0, 24.0, 22.0, 7.0
_INITIAL, _STRAINED = MEMBERS[2], MEMBERS[3]
_STRAINS = {"axial": r"$\varepsilon^*$", "shear": r"$\gamma^*$", "curvature": r"$\kappa^*$"}
#: Times at which a function of time is evaluated, to find its direction [s].
_TIMES = np.concatenate([[0.0], 2.0 ** np.arange(-12, 8)])
_ARROWS = 12  # largest number of arrows of initial velocities
_APART = 15.0  # distance of arrows of line loads [points]


class _Sheet(NamedTuple):
    """A drawing with a pen and labels."""

    pen: Pen
    labels: Labels
    #: Upper right corner (2,) of the drawing.
    corner: np.ndarray

    def label(self, words: str, places, colour: Colour, way=(0.0, 0.0), size: float = 8.0) -> None:
        """Write words near one of some places (n, 2), if possible in a direction."""
        shade = self.pen.theme.text(colour)
        self.labels.add(self.pen.ax, words, places, way, size, color=shade)


def draw_actions(sheet: _Sheet, scene: Scene, si: bool) -> None:
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
            _driven(sheet, sheet.corner, words, np.eye(2)["xy".index(way)])


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
    value_and_unit = f" = {with_unit(value, unit) if si else three_digits(value)}"
    return symbol + (load.value.arguments or value_and_unit) + ", follower" * load.follower


def _force(sheet: _Sheet, load: Load, si: bool) -> None:
    force, tip = _shown(load), position_of(load.target)
    if force.any():
        way = unit(force)
        tail, tip = (tip - part * sheet.pen.point * way for part in (_FORCE + 5, 5.0))
        sheet.pen.arrow([tail, tip], width=2.0, head=8.0)
        sheet.label(_words("F", load, np.hypot(*force), "N", si), tail, ACTS, -way)


def _moment(sheet: _Sheet, load: Load, si: bool) -> None:
    (moment,) = _shown(load)
    if moment:
        points = _turn(sheet, position_of(load.target), np.sign(moment))
        sheet.pen.arrow(points)
        sheet.label(_words("M", load, moment, "N m", si), points[::4], ACTS)


def _line_load(sheet: _Sheet, load: Load, si: bool) -> None:
    beam: Any = load.target
    arc, tips, _ = _along(sheet, beam, *(load.between or (0.0, beam.length)))
    if isinstance(load.value, SignalAlong):
        loads = floats(load.value.values_at(arc, _largest(load)[0]))
    elif load.value.place:
        loads = np.array([load.value(s) for s in arc])
    else:
        loads = np.tile(_shown(load), (len(arc), 1))
    _arrows_along(sheet, tips, loads, load, si)


def _pressure(sheet: _Sheet, scene: Scene, work: VirtualWork, si: bool) -> None:
    """Arrows across a beam, on the side from which the pressure pushes."""
    if isinstance(work.term, PressureTerm):
        beam: Any = work.beam
        start, *_, end = beam.s[slice(work.elements[0], (work.elements[1] or beam.elements) + 1)]
        load = Load("line load", beam, scene.parameters.functions[work.term.pressure.name])
        _, tips, tangents = _along(sheet, beam, start, end)
        _arrows_along(sheet, tips, _shown(load) * left_of(tangents), load, si)


def _along(sheet: _Sheet, beam: Beam, start: float, end: float) -> tuple[np.ndarray, ...]:
    """Arc lengths (n,) of arrows from one to another, their points (n, 2) and tangents (n, 2)."""
    count = 1 + max(2, min(40, int((end - start) / (_APART * sheet.pen.point))))
    arc, points = np.linspace(start, end, count), _axis(beam)
    s = arc_of(points)
    places = arc * s[-1] / beam.length
    columns = points, np.gradient(points, s, axis=0)
    return arc, *(interpolated(places, s, values) for values in columns)


def _arrows_along(sheet: _Sheet, tips: np.ndarray, loads: np.ndarray, load: Load, si: bool) -> None:
    """Arrows of loads (n, 2) that end beside points (n, 2), with the area that they cover."""
    sizes, pen = np.hypot(*loads.T), sheet.pen
    if not sizes.max() > 0:
        return
    ways = loads / sizes.max()
    tips = tips - 4.5 * pen.point * ways / np.maximum(np.hypot(*ways.T), 0.05)[:, None]
    tails = tips - _LINE_LOAD * pen.point * ways
    pale = mixed(ACTS, pen.theme.paper, 0.82)
    pen.area(np.concatenate([tips, tails[::-1]]), pale, "none", 0.0, 0.8)
    pen.line(tails, ACTS, 1.1, 4)
    visible = sizes > 0.05 * sizes.max()
    for tail, tip in zip(tails[visible], tips[visible], strict=True):
        pen.arrow([tail, tip], width=1.0, head=5.0, z=4)
    symbol = "p" if load.value.size == 1 else "q"
    words = _words(symbol, load, sizes.max(), "N/m", si)
    sheet.label(words, tails[1:-1], ACTS, -ways.mean(axis=0))


def _axis(beam: Beam) -> np.ndarray:
    """Points (n, 2) of the axis of a beam in its reference configuration."""
    return axis(floats(reference_positions(beam)), beam.degree)


def _drags(sheet: _Sheet, scene: Scene) -> None:
    """The word, at each beam and node with drag."""
    targets = {label(drag.target): drag.target for drag in scene.drags}
    for target in targets.values():
        nodes = target.nodes if isinstance(target, Beam) else (target,)
        sheet.label("drag", [position_of(node) for node in nodes[::-1]], ACTS)


def _natural_strains(sheet: _Sheet, scene: Scene, si: bool) -> None:
    """A dashed line beside each beam that has natural strains, with what they are."""
    for strain in scene.natural_strains:
        points = _axis(strain.beam)
        left = left_of(np.gradient(points, axis=0))
        left /= np.hypot(*left.T)[:, None]
        line = points + _BESIDE * sheet.pen.point * left
        sheet.pen.line(line, _STRAINED, 1.2, dash=(4, 2))
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


def _prescribed(sheet: _Sheet, scene: Scene) -> None:
    for number, component in scene.prescribed:
        text = ("x(t)", "y(t)", r"$\psi$(t)")[component]
        direction = None if component == 2 else np.eye(2)[component]
        _driven(sheet, position_of(scene.nodes[number]), text, direction)


def _motors(sheet: _Sheet, scene: Scene) -> None:
    for joint in scene.joints:
        for name in joint.driven:
            way, text = (joint.direction, "d") if name == "slide" else (None, r"$\psi$")
            is_locked = isinstance(joint.coordinates[name].motor, Locked)
            text = "locked" if is_locked else f"motor {text}(t)"
            _driven(sheet, position_of(node_of(joint)), text, way)


def _driven(sheet: _Sheet, position, text: str, direction: np.ndarray | None) -> None:
    """An arrow with two heads: along a direction, beside a point, or around the point."""
    pen = sheet.pen
    if direction is None:
        points = _turn(sheet, position, 1.0)
        ends = points[::4]
    else:
        middle = position + 14.0 * pen.point * left_of(direction)
        points = middle + _MOTION * pen.point * np.outer((-1, 0, 1), direction)
        ends = points[::-1]
    pen.arrow(points, both=True)
    sheet.label(text, ends, ACTS)


def _velocities(sheet: _Sheet, scene: Scene) -> None:
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
            tips.append(position + 1.2 * _FORCE * sheet.pen.point * value / largest)
            sheet.pen.arrow([position, tips[-1]], _INITIAL, 1.4)
    if tips:
        sheet.label("v(0)", tips, _INITIAL)


def _weight(sheet: _Sheet, gravity, words: str) -> None:
    """The acceleration of gravity, beside the upper right corner."""
    way = unit(gravity)
    tail, tip = (sheet.corner + part * sheet.pen.point * way for part in (-14.0, 14.0))
    sheet.pen.arrow([tail, tip], sheet.pen.theme.soft, 1.4)
    sheet.label(words, (tail + tip) / 2, sheet.pen.theme.soft, left_of(way))


def _turn(sheet: _Sheet, position, sense: float) -> np.ndarray:
    """Points (33, 2) of three quarters of a circle about a point."""
    angle = np.pi / 4 + sense * np.linspace(0, 1.5 * np.pi, 33)
    arms = np.column_stack([np.cos(angle), np.sin(angle)])
    return position + _TURN * sheet.pen.point * arms


_AWAY, _SHORTEST = 40.0, 14.0  # of dimensions from the drawing; the shortest one [points]
_MANY = 15  # number of members above which their names are small
_CROWD = 500  # number of members, or of bodies, above which they have no names
_ROOM = 40.0  # around the drawing, for loads and labels [points]


def scene(
    scene: Scene,
    path: Path | str | None = None,
    scene_unit: str = "m",
    dimensions: bool | Sequence[tuple[Node, Node]] = False,
    marks: dict[str, Node] | None = None,
    nodes: bool = False,
    title: str = "",
    theme: str = "light",
) -> Figure:
    """Drawing of a scene in its reference configuration.

    Members and bodies have their names, if there are at most 500 of a kind; members have their
    depth if it is large enough to be seen. A body is a rounded shape around its points, with a
    quartered disc at the centre of mass; with a contact radius it is a wheel. Hatched strips are
    the ground. A pin is a triangle, a roller a triangle on wheels, a
    clamp a wall. A ring is a hinge, a black plate a rigid joint; a block between rails, a slot, a
    carriage on wheels and two jaws are slides. A disc is a lumped mass. A coil or a spiral is a
    spring, a cup a damper, black shoes are friction; walls across a slide, or an arc with two ends,
    are stops. The radii of gears have their ratio, pulleys have their true radius. Beams and nodes
    with drag have the word "drag". Loads and motions are orange: arrows of forces end at their
    nodes, arrows of initial velocities start at them. Prescribed motions, motors and the
    acceleration of the base have arrows with two heads. Loads that are functions of time are drawn
    with their largest value. Of virtual works only pressures are drawn.

    Parameters
    ----------
    scene : Scene
        Scene to draw.
    path : str or path, optional
        Picture to write; its ending gives the format.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled. With "m"
        masses and loads have SI units, otherwise none.
    dimensions : bool or sequence of (Node, Node)
        Whether to write the distances between the ends of members; or pairs of nodes whose
        distances to write.
    marks : dict, optional
        Nodes by the names that are written beside them.
    nodes : bool
        Whether the nodes between elements have dots.
    title : str
        Text over the drawing.
    theme : {"light", "dark"}
        Colours of the drawing.

    Returns
    -------
    matplotlib.figure.Figure
        The drawing; its axes are ``figure.axes[0]``.

    Raises
    ------
    SceneError
        If the argument is not a scene, or the scene has no beams and no bodies.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"plot.scene needs an fx_beam.Scene, not {shown(scene)}")
    if not (scene.beams or scene.bodies):
        raise SceneError("plot.scene: the scene has no beams; add one with scene.add_beam")
    path, colours = picture(path), theme_of(theme)
    for name, value in (("nodes", nodes), ("dimensions", dimensions)):
        pairs = name == "dimensions" and not isinstance(value, bool)
        require(pairs or is_flag(value), name, value, "True or False")
    drawing = Drawing(Reference(scene), [0], unit=scene_unit)
    parts, si = drawing.parts(0), scene_unit == "m"
    words, room = words_over(drawing, title), _ROOM + (_AWAY - 16.0) * bool(dimensions)
    plane = Plane(drawing, colours, title=words, room=room, is_framed=not dimensions)
    pen = Pen(plane.ax, colours, drawing.thinness)
    corner = drawing.corners[1] + 18.0 * pen.point
    sheet = _Sheet(pen, Labels(plane.figure, colours), corner)
    draw_members(pen, drawing, 0)
    draw_held(pen, drawing, parts, 0)
    draw_moving(pen, drawing, 0)
    draw_actions(sheet, scene, si)
    if nodes:
        for beam in scene.beams:
            pen.ring([(n.x, n.y) for n in beam.nodes], 1.6, colours.ink, width=0.0, z=3.5)
    _names(sheet, drawing, scene, {} if marks is None else marks, si)
    if dimensions:
        _dimensions(sheet, scene, drawing, dimensions)
    pen.finish()
    sheet.labels.write()
    return written(plane.figure, path, is_cut=bool(dimensions))


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


def _names(sheet: _Sheet, drawing: Drawing, scene: Scene, marks, si: bool) -> None:
    """Labels of masses, marked nodes and members, in the order of their priority."""
    ink = sheet.pen.theme.ink
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for name, node in marks.items():
        if getattr(node, "scene", None) is not scene:
            raise SceneError(f"mark {name!r}: {shown(node)} is not a node of the scene")
        sheet.pen.ring((node.x, node.y), 1.8, ink, width=0.0, z=7)
        sheet.label(name, (node.x, node.y), ink)
    for number, mass, inertia in lumped_masses(drawing, drawing.parts(0)):
        node = scene.nodes[number]
        words = [f"m = {three_digits(mass)}{' kg' if si else ''}"] if mass else []
        words += [f"J = {three_digits(inertia)}{' kg m$^2$' if si else ''}"] if inertia else []
        if words:
            sheet.label(", ".join(words), (node.x, node.y), ink)
    masses = {mass.node: mass.mass for mass in scene.masses}
    for body in scene.bodies if len(scene.bodies) <= _CROWD else ():
        place = body.centre.x, body.centre.y
        sheet.label(body.name, place, sheet.pen.theme.soft)
        if weight := masses.get(body.centre.number):
            sheet.label(three_digits(weight) + (" kg" if si else ""), place, ink)
    if len(scene.beams) > _CROWD:
        return
    size = 8.0 if len(scene.beams) <= _MANY else 5.5
    for beam, colour in zip(scene.beams, colours_of(drawing), strict=True):
        points = drawing.axis(beam.name, 0)
        s = arc_of(points)
        places = interpolated(s[-1] * np.array([0.5, 0.35, 0.65, 0.2, 0.8]), s, points)
        sheet.label(beam.name, places, colour, size=size)


def _dimensions(sheet: _Sheet, scene: Scene, drawing: Drawing, chosen) -> None:
    """Dimension lines of pairs of nodes, or below and to the left between the ends of members."""
    point, (low, high) = sheet.pen.point, drawing.corners
    if not isinstance(chosen, bool):
        for a, b in chosen:
            pair = np.array([position_of(a), position_of(b)])
            side = left_of(unit(pair[1] - pair[0]))
            if side @ (2 * pair.mean(axis=0) - low - high) < 0:
                side = -side
            _dimension(sheet, pair + _AWAY / 2 * point * side, side)
        return
    ends = [(node.x, node.y) for beam in scene.beams for node in (beam.start, beam.end)]
    ends += [(node.x, node.y) for body in scene.bodies for node in body.nodes]
    for i in (0, 1):
        values = np.sort(np.array(ends)[:, i])
        values = values[np.append(True, np.diff(values) > _SHORTEST * point)]
        normal = np.eye(2)[1 - i]
        level = (low[1 - i] - _AWAY * point) * normal
        for a, b in itertools.pairwise(values):
            _dimension(sheet, [level + value * np.eye(2)[i] for value in (a, b)], -normal)


def _dimension(sheet: _Sheet, ends, side: np.ndarray) -> None:
    """A dimension line between two points, with ticks, on one side of the drawing."""
    pen, soft = sheet.pen, sheet.pen.theme.soft
    tail, tip = map(np.asarray, ends)
    pen.arrow([tail, tip], soft, 0.7, 6.0, both=True)
    for place in (tail, tip):
        pen.line([place - 6 * pen.point * side, place + 3 * pen.point * side], soft, 0.6)
    sheet.label(three_digits(float(np.hypot(*(tip - tail)))), (tail + tip) / 2, soft, side)
