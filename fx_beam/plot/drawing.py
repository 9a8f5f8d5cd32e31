"""A solution as pictures show it: positions, window, outlines, and the axes in which it lies."""

from __future__ import annotations

import io
import itertools
import logging
import math
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, is_name, is_whole, positive, real_array, require
from fx_beam.results.export import replacing, writable
from fx_beam.results.joint_and_contact_motion import nodes_of
from fx_beam.results.member_fields import nodes_of_elements
from fx_beam.results.solution import Solution, forces_on_nodes, parts_in
from fx_beam.scene.beam import Beam, Node, lagrange, lagrange_and_slopes
from fx_beam.scene.contacts import Circle, Shape
from fx_beam.scene.forces_between import FixedPoint, ForceBetween, GroundSpring
from fx_beam.scene.gears import Gear
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.parts import Parts

from .look import Look, Theme

# -- Outlines of obstacles: lines, and on which side of them is what is not allowed -------------


# How far lines go beyond the nearest positions, as a fraction of the scene's size. An obstacle
# farther away than the size is not drawn.
_BEYOND = 0.1


class Outline(NamedTuple):
    """A line, and the side that is not allowed."""

    #: Points (n, 2) of the line, and unit vectors (n, 2) into the obstacle.
    line: np.ndarray
    sides: np.ndarray
    #: Whether it is a disc.
    is_disc: bool = False

    def moved(self, position: np.ndarray, angle: float) -> Outline:
        """Turned by an angle about the origin, which is then moved to a position."""
        matrix = turn(angle)
        return Outline(self.line @ matrix + position, self.sides @ matrix, self.is_disc)


def turn(angle: float) -> np.ndarray:
    """Matrix (2, 2) that turns rows by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


def outline(shape: Shape, positions: np.ndarray, size: float) -> Outline:
    """The outline of a fixed shape that reaches past some positions."""
    line, sides = shape.outline(positions, size, _BEYOND * size)
    is_disc = isinstance(shape, Circle) and shape.side > 0 and shape.radius <= size
    return Outline(line, sides, is_disc)


def interpolated(places: np.ndarray, s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (m, 2) at places (m,), interpolated between values (n, 2) at s (n,)."""
    return np.column_stack([np.interp(places, s, column) for column in values.T])


def obstacles(drawing: Drawing, parts: Parts) -> list[tuple[Node | None, Outline]]:
    """Outlines of fixed obstacles that are near, and of carried ones relative to their nodes."""
    found = dict[Shape, tuple[Node | None, Outline]]()
    rows = [k for k in drawing.rows if drawing.parts(k) is parts]
    for contact in parts.contacts:
        if isinstance(shape := contact.shape, Beam) or shape in found:
            continue
        carrier, points = shape.carrier, drawing.points
        if carrier is not None:  # what touches in these rows, relative to the node and its section
            nodes, arms = (
                nodes_of(drawing.solution.nodes_of_beam, contact.target),
                [np.zeros((1, 2))],
            )
            for k in rows:
                arm = drawing.positions(nodes, k) - drawing.positions(carrier.number, k)
                arms.append(arm @ turn(-drawing.angle(carrier.number, k)))
            relative = shape.at((0.0, 0.0)), np.concatenate(arms)
            found[shape] = carrier, outline(*relative, drawing.reach)
        elif abs(shape.gap(points)).min() <= drawing.reach:
            found[shape] = None, outline(shape, points, drawing.reach)
    return [*found.values()]


# -- A solution as pictures show it: positions in some rows, the window, and sizes of symbols ---


_log = logging.getLogger("fx_beam")
T = TypeVar("T")

# Lengths of springs from a node and from a bed to the ground; number of the latter.
_GROUND_SPRING, _BED_SPRING, _OF_BED = 0.15, 0.06, 9
# Displacements below this fraction of it cannot be seen.
_TINY = 1e-3


_UNITS = (1e-3, 1e6, r"$\mu$s"), (1e-2, 1e3, "ms"), (math.inf, 1.0, "s")


def three_digits(value: float) -> str:
    """A number with three digits; up to 100 000 with all digits before the point."""
    if 1000 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{float(f'{value:.3g}'):g}"


_PREFIXES = (1e9, "G"), (1e6, "M"), (1e3, "k")
_LARGE = 1e4  # from which on numbers have a prefix


def prefix_of(largest: float, least: float = _LARGE) -> tuple[float, str]:
    """Factor and prefix of the unit for numbers up to a largest one."""
    size = abs(largest)
    return next((p for p in _PREFIXES if size >= max(p[0], least)), (1.0, ""))


def with_unit(value: float, unit: str) -> str:
    """A number with three digits and its unit, which has a prefix for large numbers."""
    factor, prefix = prefix_of(value) if unit.startswith("N") else (1.0, "")
    return f"{three_digits(value / factor)} {prefix}{unit}"


def time_unit(largest: float) -> tuple[float, str]:
    """Factor from seconds to a unit for times up to a last one [s], and name of the unit."""
    return next((factor, name) for limit, factor, name in _UNITS if largest < limit)


def headings(solution: Solution, times: np.ndarray) -> list[str]:
    """Times (n,) with their unit, all with the decimals that they have, or load factors."""
    if solution.stats.static:
        return [f"load factor {three_digits(load_factor)}" for load_factor in times]
    factor, name = time_unit(times.max())
    scaled = factor * times
    exact = (d for d in range(4) if abs(scaled - scaled.round(d)).max() <= 1e-6)
    decimals = next(exact, 4)
    return [f"t = {t:.{decimals}f} {name}" for t in scaled]


# Straight lines per element: over 60 degrees the error is a thousandth of the radius.
_LINES = 12
_LONGEST_FORCE = 0.12  # arrow of the largest force, as a fraction of the scene's size
_DENSE = 1 / 40  # distance of members, as a fraction of the size, below which lines are thinner


def axis(nodes: np.ndarray, degree: int) -> np.ndarray:
    """Points of a beam's axis for drawing, also on curved elements of degree 2 and 3.

    Parameters
    ----------
    nodes : (..., elements * degree + 1, 2) float
        Positions of a beam's nodes, such as `Solution.shape` and `Modes.shape` give [m].
    degree : int
        Degree of the elements of the beam.

    Returns
    -------
    (..., points, 2) float
        Positions along the beam, including the nodes [m].

    Raises
    ------
    SceneError
        For a degree other than 1, 2 and 3, or positions that do not fit it.
    """
    require(is_whole(degree, 1, 3), "axis: degree", degree, "1, 2 or 3")
    positions = real_array(nodes)
    count, width = positions.shape[-2:] if positions.ndim > 1 else (0, 0)
    ok = width == 2 and count % degree == 1 % degree
    require(ok, "axis: nodes", nodes, f"positions (..., elements * {degree} + 1, 2)")
    if degree == 1:
        return positions
    values = lagrange(np.linspace(0, 1, degree + 1), np.arange(_LINES) / _LINES)
    elements = (positions.shape[-2] - 1) // degree
    element_nodes = degree * np.arange(elements)[:, None] + np.arange(degree + 1)
    points = values @ positions[..., element_nodes, :]
    points = points.reshape(*positions.shape[:-2], elements * _LINES, 2)
    return np.concatenate([points, positions[..., -1:, :]], axis=-2)


# A spoke of a wheel of radius 1, and its rim.
_RIM = np.pi / 2 + np.linspace(0, 2 * np.pi, 97)
_WHEEL = np.concatenate([np.zeros((1, 2)), np.column_stack([np.cos(_RIM), np.sin(_RIM)])])


class Drawing:
    """A solution with magnified displacements, in the rows that a picture shows.

    `solution` may be a `Reference`, a scene before it runs, with a single row. `unit` is that of
    lengths.
    """

    def __init__(self, solution: Any, rows: list[int], magnify: float = 1.0, unit: str = "m"):
        require(is_name(unit), "scene_unit", unit, "a text")
        self.solution, self.rows, self.magnify, self.unit = solution, rows, magnify, unit
        recorded = getattr(solution, "recorded", None)
        # Displacements and rotations (rows, nodes, 3); an error says if there are none.
        self._q = solution.q if recorded is None else recorded("q")
        self._element_nodes = nodes_of_elements(solution)
        self._known: dict[tuple[Callable, int], tuple[Parts, Any]] = {}
        #: Points (n, 2) of all members and bodies in all rows.
        self.points = _all_points(self)
        #: Larger side of what holds them [m].
        self.reach = float(np.ptp(self.points, axis=0).max()) or 1.0
        #: Factor of the widths of lines and of symbols: 1, or less where members are dense.
        self.thinness = min(1.0, spacing(self) / (_DENSE * self.reach))
        is_run = isinstance(solution, Solution)
        #: Forces (2,) on nodes by their numbers [N], by rows; the largest of them.
        self.forces = {k: forces_on_nodes(solution, k, magnify) if is_run else {} for k in rows}
        sizes = (np.hypot(*force) for row in self.forces.values() for force in row.values())
        self.largest_force = max(sizes, default=0.0)
        # Lower left and upper right corner (2, 2) of what is in the window.
        self._corners = _ends(_framed_points(self))

    def parts(self, k: int) -> Parts:
        """Parts of the scene as it was in row k."""
        return parts_in(self.solution, k)

    def once(self, find: Callable[[Drawing, Parts], T], parts: Parts) -> T:
        """What a function finds of the parts, found once for all rows."""
        key = find, id(parts)
        if key not in self._known:
            self._known[key] = parts, find(self, parts)
        return self._known[key][1]

    @property
    def stretches(self) -> list[tuple[Parts, list[int]]]:
        """Parts of the scene, and the places in `rows` of the rows that have them."""
        places = itertools.groupby(range(len(self.rows)), lambda i: id(self.parts(self.rows[i])))
        lists = [list(group) for _, group in places]
        return [(self.parts(self.rows[places[0]]), places) for places in lists]

    # -- The window -----------------------------------------------------------------------------

    def include(self, points: ArrayLike) -> None:
        """Have points (n, 2) in the window as well."""
        self._corners = _ends(np.concatenate([self._corners, np.reshape(points, (-1, 2))]))

    @property
    def corners(self) -> np.ndarray:
        """Lower left and upper right corner (2, 2) of what is drawn."""
        return self._corners

    @property
    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right corner of the drawing, with a margin."""
        low, high = self._corners
        size = max(high - low) or self.reach
        # Space for symbols; a straight member needs more beside it.
        margin = np.maximum(0.06 * size, (0.3 * size - (high - low)) / 2)
        return low - margin, high + margin

    @property
    def size(self) -> float:
        """Larger side of the window [m]."""
        return float(np.ptp(self.window, axis=0).max())

    # -- Positions and forces -------------------------------------------------------------------

    def axis(self, beam: str, rows) -> np.ndarray:
        """Points (..., points, 2) of a beam's axis in some rows."""
        positions = self.positions(self.solution.nodes_of_beam[beam], rows)
        return axis(positions, self.solution.beams[beam].degree)

    def along_elements(self, k: int, count: int) -> np.ndarray:
        """Points (elements, count + 1, 2) at the ends of `count` pieces of each element."""
        nodes = self._element_nodes
        values = lagrange(np.linspace(0, 1, nodes.shape[1]), np.arange(count + 1) / count)
        return values @ self.positions(nodes, k)

    def normals(self, k: int, count: int) -> np.ndarray:
        """Unit vectors (elements, count + 1, 2) along the sections there, which turn with them."""
        nodes = self._element_nodes
        fractions = np.arange(count + 1) / count
        values, slopes = lagrange_and_slopes(np.linspace(0, 1, nodes.shape[1]), fractions)
        x, y = np.moveaxis(slopes @ self.solution.X[nodes], -1, 0)
        psi = self.magnify * self._q[k][nodes, 2] @ values.T
        angle = np.arctan2(y, x) + psi
        return np.stack([-np.sin(angle), np.cos(angle)], axis=-1)

    def positions(self, nodes, rows) -> np.ndarray:
        """Positions (..., 2) of nodes, by their numbers, in some rows."""
        nodes, numbers = np.asarray(nodes, dtype=int), np.arange(len(self._q))[rows]
        moved = self._q[numbers.reshape(numbers.shape + (1,) * nodes.ndim), nodes, :2]
        return self.solution.X[nodes] + self.magnify * moved

    def place(self, point: Node | FixedPoint, k: int) -> np.ndarray:
        """Position (2,) of a point of a force in row k."""
        return self.positions(point.number, k) if isinstance(point, Node) else point.position

    def place_at_start(self, point: Node | FixedPoint) -> np.ndarray:
        """Position (2,) of a point of a force in the reference configuration."""
        return self.solution.X[point.number] if isinstance(point, Node) else point.position

    def turned(self, node: Node, k: int, arrow) -> np.ndarray:
        """A vector (2,) that rotates with a node, in row k."""
        if node is GROUND:
            return np.asarray(arrow)
        return np.asarray(arrow) @ turn(self.angle(node.number, k))

    def angle(self, node: int, k: int) -> float:
        """Magnified rotation of a node in row k [rad]."""
        return self.magnify * self._q[k][node, 2]

    def circles(self, parts: Parts, k: int) -> list[np.ndarray]:
        """Balls and wheels in row k: from the centre to the rim (98, 2), along it and round."""
        return [
            self.positions(node, k) + radius * _WHEEL @ turn(self.angle(node, k))
            for node, radius in parts.radii.items()
        ]

    def fixed(self, parts: Parts) -> list[Outline]:
        """Outlines of fixed obstacles that are near."""
        return [outline for carrier, outline in self.once(obstacles, parts) if carrier is None]

    def carried(self, parts: Parts, k: int) -> list[Outline]:
        """Outlines of the obstacles that nodes carry, in row k."""
        return [
            outline.moved(self.positions(node.number, k), self.angle(node.number, k))
            for node, outline in self.once(obstacles, parts)
            if node is not None
        ]

    def arrow(self, node: int, k: int) -> np.ndarray:
        """Tail and tip (2, 2) of the arrow of a force in row k, with its tip at the node."""
        tip, scale = self.positions(node, k), _LONGEST_FORCE * self.reach
        return np.array([tip - scale * self.forces[k][node] / (self.largest_force or 1.0), tip])


def _ends(points: np.ndarray) -> np.ndarray:
    """Lower left and upper right corner (2, 2) of points (n, 2)."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _all_points(drawing: Drawing) -> np.ndarray:
    """Points (n, 2) of all members and bodies in all rows."""
    solution, rows = drawing.solution, drawing.rows
    positions, nodes = drawing.positions(np.arange(len(solution.X)), rows), solution.nodes_of_beam
    members = [axis(positions[:, nodes[name]], b.degree) for name, b in solution.beams.items()]
    numbers = [n.number for body in solution.bodies.values() for n in body.nodes]
    return np.concatenate([*members, drawing.positions(numbers, rows)], axis=1).reshape(-1, 2)


def _framed_points(drawing: Drawing) -> np.ndarray:
    """Points (n, 2) of members, forces between points, arrows and outlines."""
    forces = list(dict.fromkeys(f for parts, _ in drawing.stretches for f in parts.forces_between))
    ends = (point for force in forces for point in force.points)
    fixed = [point.position for point in ends if not isinstance(point, Node)]
    grounded = (force for force in forces if isinstance(force, GroundSpring))
    fixed += [foot for force in grounded for _, foot, _ in feet(drawing, force)]
    arrows = [drawing.arrow(node, k) for k, forces in drawing.forces.items() for node in forces]
    lines = list[np.ndarray]()
    for k in drawing.rows:
        parts = drawing.parts(k)
        lines += [outline.line for outline in drawing.fixed(parts) + drawing.carried(parts, k)]
        lines += drawing.circles(parts, k)
        for place, radius in wheels(drawing, parts, k):
            lines.append(place + radius * _WHEEL)
    return np.concatenate([drawing.points, np.reshape(fixed, (-1, 2)), *arrows, *lines])


def gear_radii(gear: Gear, distance: float) -> tuple[float, float]:
    """Pitch radii of two wheels at a distance, in their ratio; of a belt by 40 % of it."""
    ratio = abs(float(gear.ratio))
    if gear.ratio > 0:
        return 0.4 * distance * min(1.0, ratio), 0.4 * distance * min(1.0, 1 / ratio)
    return distance * ratio / (1 + ratio), distance / (1 + ratio)


def wheels(drawing: Drawing, parts: Parts, k: int) -> list[tuple[np.ndarray, float]]:
    """Centres (2,) in row k and radii of gears and pulleys."""
    circles: list[tuple[np.ndarray, float]] = []
    for gear in parts.gears:
        nodes = [node_of(joint).number for joint in (gear.joint_a, gear.joint_b)]
        radii = abs(float(gear.ratio)), 0.0
        if gear.driven == "rotation":
            radii = gear_radii(
                gear, float(np.hypot(*np.diff(drawing.solution.X[nodes], axis=0)[0]))
            )
        circles += zip(drawing.positions(nodes, k), radii, strict=True)
    for force in parts.forces_between:
        radii = abs(getattr(force, "radii", np.empty(0)))
        pairs = zip(force.points, radii.tolist(), strict=False)
        circles += [(drawing.place(point, k), radius) for point, radius in pairs if radius]
    return circles


def is_grounded(joint: Joint) -> bool:
    """Whether a joint is on the ground."""
    return GROUND in (joint.a, joint.b)


def node_of(joint: Joint) -> Node:
    """The node b of a joint, or the one that it connects with the ground."""
    return joint.a if joint.b is GROUND else joint.b


def words_over(drawing: Drawing, title: str, times: Sequence[str] = ()) -> str:
    """What is written over a picture: a title, times, and the factor on displacements."""
    require(isinstance(title, str), "title", title, "a text")
    magnified = [f"displacements x {drawing.magnify:g}"] if drawing.magnify not in (0, 1) else []
    return ", ".join([*([title] if title else []), *times, *magnified])


def spacing(drawing: Drawing) -> float:
    """Mean distance between members [m]: area by length."""
    sides = np.maximum(np.ptp(drawing.points, axis=0), 0.1 * drawing.reach)
    length = sum(beam.length for beam in drawing.solution.beams.values())
    return float(np.prod(sides)) / length if length else drawing.reach


def line_between(drawing: Drawing, force: ForceBetween, rows) -> np.ndarray:
    """Points (..., points, 2) of a force between points in some rows."""
    shape = drawing.positions(0, rows).shape
    lines = [
        drawing.positions(point.number, rows)
        if isinstance(point, Node)
        else np.broadcast_to(point.position, shape)
        for point in force.points
    ]
    points, rope_line = np.stack(lines, axis=-2), getattr(force, "outline", None)
    if rope_line is None:
        return points
    with np.errstate(invalid="ignore"):
        line = rope_line(np.stack(lines))
    # Magnified, a point may lie in a pulley: then the rope is straight.
    places = np.linspace(0, len(lines) - 1, line.shape[-2])
    first = np.minimum(places.astype(int), len(lines) - 2)
    share = (places - first)[:, None]
    straight = (1 - share) * points[..., first, :] + share * points[..., first + 1, :]
    return np.where(np.isnan(line).any(axis=(-2, -1), keepdims=True), straight, line)


def feet(drawing: Drawing, force: GroundSpring) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Nodes that a force holds to the ground, places of their walls and directions from these.

    Of a bed across a beam some springs are drawn, of one along it the one at the end.
    """
    if force.direction is None:
        return []
    nodes = nodes_of(drawing.solution.nodes_of_beam, force.target)
    X = drawing.solution.X[nodes]
    ways = np.broadcast_to(force.ways(X), X.shape)
    short = len(nodes) > 1 and not force.direction[0]
    drawn = np.linspace(0, len(nodes) - 1, min(len(nodes), _OF_BED if short else 1)).round()
    length = (_BED_SPRING if short else _GROUND_SPRING) * drawing.reach
    return [(int(nodes[i]), X[i] - length * ways[i], ways[i]) for i in drawn.astype(int)]


def checked_rows(
    solution: Solution,
    usual: int = 1,
    rows=None,
    times: Sequence[float] | None = None,
    count: int | None = None,
) -> list[int]:
    """Some rows of a solution, rows next to some times, or a number of rows.

    `usual` is the number if nothing is asked for. SceneError for what does not fit.
    """
    expected = "a Solution, as of simulate or static; plot.scene draws a scene"
    require(isinstance(solution, Solution), "solution", solution, expected)
    last, t = len(solution.t) - 1, solution.t
    if sum(choice is not None for choice in (rows, times, count)) > 1:
        raise SceneError("a picture shows rows, times or a count of rows: give one of these")
    if rows is None and times is None:
        count = usual if count is None else count
        require(is_whole(count, 1), "count", count, "a whole number, at least 1")
        rows = np.unique(np.linspace(0, last, min(count, last + 1)).round().astype(int)).tolist()
    elif times is not None:
        places = real_array(times)
        low, high = t.min(), t.max()  # a static path may come to its end from above
        ok = places.ndim == 1 and len(places) > 0 and low <= places.min() and places.max() <= high
        require(ok, "times", times, f"times of the solution, from {low:g} to {high:g}")
        rows = [int(abs(t - time).argmin()) for time in places]
    ok = real_array(rows).ndim == 1 and all(is_whole(k, -last - 1, last) for k in rows)
    expected = f"rows of the solution, such as range(0, {last + 1}, {max(1, last // 10)})"
    require(ok and len(rows) > 0, "rows", rows, expected)
    return [range(last + 1)[k] for k in rows]  # -1 is the last one


def checked_drawing(solution: Solution, magnify: float, unit: str, *usual, **choice) -> Drawing:
    """A drawing of the rows that `checked_rows` gives for a choice."""
    rows = checked_rows(solution, *usual, **choice)
    return Drawing(solution, rows, positive(magnify, "magnify"), unit)


def say_if_too_small(drawing: Drawing) -> None:
    """Warn of a motion that cannot be seen, with the factor that shows it."""
    moved = abs(drawing.solution.q[drawing.rows][..., :2]).max(initial=0.0)
    if drawing.magnify == 1 and 0 < moved < _TINY * drawing.size:
        factor = 10 ** int(np.log10(0.05 * drawing.size / moved))
        _log.warning("the largest displacement is %.1g: magnify=%g would show it", moved, factor)


# -- Figures: axes over a drawing or in rows and columns, and files -----------------------------


#: Endings of files.
PICTURES = sorted(FigureCanvasAgg.filetypes)
#: Width and height up to which a picture is drawn [inch].
LARGEST = 7.0, 5.6
# Around the axes: left, below, right, above; and what a colour bar needs beside or below them.
_BORDER, _BESIDE, _BELOW = (0.62, 0.45, 0.12, 0.12), 1.0, 0.75
_TITLE, _LONG = 0.18, 36  # height of a line of a title [inch], and letters that may need two
_NARROW = 2.4  # width of the axes that a title needs [inch]
_LOW = 2.2  # height of the axes up to which the colour bar lies below them [inch]


class Picture(Figure):
    """A figure that notebooks show."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=150)
        return file.getvalue()


class Plane:
    """Axes over the window of a drawing.

    Parameters
    ----------
    drawing : Drawing
        What is drawn.
    theme : Theme
        The colours.
    bar : bool
        Whether there is a colour bar.
    title : str
        What is written over the axes.
    size : (float, float), optional
        Width and height [inch], which the axes fill; by default as large as the window asks for.
    room : float
        Around what is drawn, for symbols and labels [points].
    is_framed : bool
        Whether the axes have a frame with numbers.
    """

    def __init__(
        self,
        drawing: Drawing,
        theme: Theme,
        bar: bool = False,
        title: str = "",
        size: tuple[float, float] | None = None,
        room: float = 30.0,
        is_framed: bool = True,
    ):
        low, high = drawing.corners
        whole, margin = np.array(LARGEST if size is None else size), 2 * room / 72
        extent = high - low
        for is_below in (False, True) if bar else (False,):
            left, bottom, right, top = _BORDER if is_framed else (0.05,) * 4
            left += room_for_ticks(low[1], high[1]) if is_framed else 0.0
            if title or (size and is_framed):
                top += _TITLE * (1 + (len(title) > _LONG))
            right, bottom = right + _BESIDE * (bar and not is_below), bottom + _BELOW * is_below
            space = whole - (left + right, bottom + top)
            # Length in the drawing of an inch.
            inch = max(extent / np.maximum(space - margin, 0.3 * space)) or drawing.reach / 2
            inner = np.minimum(extent / inch + margin, space)
            if is_below or inner[1] > _LOW:
                break
        if size is not None:
            inner = space
        inner = np.maximum(inner, np.minimum((_NARROW, 0.25 * inner[0]), space))
        middle = (low + high) / 2
        low, high = middle - inch * inner / 2, middle + inch * inner / 2
        whole = inner + (left + right, bottom + top)
        self.figure = Picture(tuple(whole), facecolor=theme.paper)
        corner = np.array([left, bottom])
        self.ax: Any = self.figure.add_axes((*(corner / whole), *(inner / whole)))
        self.ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        if is_framed:
            self.ax.set(xlabel=f"$x$ [{drawing.unit}]", ylabel=f"$y$ [{drawing.unit}]")
            # A power of ten of the numbers stands above them, and not where the time is written.
            self.ax.yaxis.get_offset_text().set_horizontalalignment("right")
            self.ax.locator_params(axis="x", nbins=max(2, int(inner[0] / 0.7)))
            self.ax.locator_params(axis="y", nbins=max(2, int(inner[1] / 0.5)))
        else:
            self.ax.set_axis_off()
        theme.dress(self.ax)
        self._theme, self._bar_below = theme, bar and is_below
        start = (left, 0.5) if self._bar_below else (left + inner[0] + 0.12, bottom)
        sides = (inner[0], 0.14) if self._bar_below else (0.14, inner[1])
        self._bar_place = (*(np.array(start) / whole), *(np.array(sides) / whole))
        if title and size is None:
            lines = textwrap.fill(title, max(20, int(15 * inner[0])))
            self.ax.set_title(lines, fontsize=9, pad=4)

    def draw_bar(self, scale, **look):
        """Draw the colour bar of a scale."""
        cax = self.figure.add_axes(self._bar_place)
        side = "horizontal" if self._bar_below else "vertical"
        bar = self.figure.colorbar(scale, cax=cax, orientation=side, **look)
        self._theme.dress(cax)
        return bar


def room_for_ticks(low: float, high: float) -> float:
    """Width that numbers on an axis need beyond five characters [inch]."""
    step = np.diff(MaxNLocator(10).tick_values(low, high))[0]
    decimals = max(0, -math.floor(math.log10(step))) + 1
    digits = max(len(f"{value:.{decimals}f}") for value in (low, high))
    return 0.075 * max(0, digits - 6)


def picture(path: Path | str | None) -> Path | None:
    """The path of a picture, if there is one; raises an error if it cannot be written."""
    return None if path is None else writable(path, PICTURES)


def written(figure: Figure, path: Path | None, is_cut: bool = False) -> Figure:
    """A figure, written into a file if there is a path; what is empty around it may be cut."""
    if path is not None:
        with replacing(path) as new:
            cut: Look = {"bbox_inches": "tight", "pad_inches": 0.1} if is_cut else {}
            figure.savefig(new, dpi=200, **cut)
    return figure


def fitted_panels(
    count: int, extent: np.ndarray, room: float, title: float
) -> tuple[int, np.ndarray, float]:
    """Columns, size (2,) of panels over an extent each, and length of a point in the drawing.

    Around each is some room, above it a title [points]. They are large, with few empty places.
    """

    def size(columns: int) -> tuple[float, np.ndarray]:
        space = 72 * np.array(LARGEST) / (columns, -(-count // columns)) - (0, title)
        point = max(extent / np.maximum(space - 2 * room, 0.2 * space))
        return point, np.minimum(extent / point + 2 * room, space)

    def worth(columns: int) -> float:
        return np.prod(size(columns)[1]) * (count / (columns * -(-count // columns))) ** 2

    columns = max(range(1, count + 1), key=worth)
    point, panel = size(columns)
    return columns, panel, point


def panels(
    count: int,
    columns: int,
    panel: np.ndarray,
    middle: np.ndarray,
    point: float,
    theme: Theme,
    title: float,
    over: float = 0.0,
) -> tuple[Picture, list[Any]]:
    """A figure with panels of a size (2,), each with a title above, and more room over all.

    Sizes are in points, whose length in the drawing is that of a `point`; all have one middle (2,).
    """
    whole = np.array([columns, -(-count // columns)]) * (panel + (0, title)) + (0, over)
    figure, axes = Picture(tuple(whole / 72), facecolor=theme.paper), []
    for number in range(count):
        row, column = divmod(number, columns)
        corner = column * panel[0], whole[1] - over - (row + 1) * (panel[1] + title)
        ax: Any = figure.add_axes((*(np.array(corner) / whole), *(panel / whole)))
        (left, bottom), (right, top) = middle - point * panel / 2, middle + point * panel / 2
        ax.set(xlim=(left, right), ylim=(bottom, top))
        ax.set_axis_off()
        ax.title.set_color(theme.ink)
        axes.append(ax)
    return figure, axes
