"""Members and symbols in pictures: bands, supports, joints, masses, springs, forces."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm, to_hex
from numpy.typing import ArrayLike

from fx_beam.errors import as_float, is_name, is_one_of, positive, real_array, require
from fx_beam.results.member_fields import QUANTITIES, RESULTANTS, along_all
from fx_beam.scene.beam import Beam, Node, arc_lengths
from fx_beam.scene.contacts import Contact
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.forces_between import GroundSpring
from fx_beam.scene.gears import Gear
from fx_beam.scene.joints import Joint
from fx_beam.scene.loads import Mass
from fx_beam.scene.parts import Parts
from fx_beam.scene.section import has_stresses

from .drawing import Drawing, Outline, feet, gear_radii, is_grounded, line_between, node_of
from .look import (
    ACTS,
    MEMBERS,
    ROPE,
    Colour,
    Look,
    Pen,
    circle,
    hull,
    left_of,
    mixed,
    rounded,
    unit,
)

# -- Members in pictures: lines, or bands as thick as they are, coloured by a quantity ----------


_PIECES = 12  # per element, each with one colour
_NONE = np.empty((0, 1))
_MANY = 6_000  # largest number of pieces in all, if elements have several pieces

# By themes: without the palest colours on white, and without the darkest ones on black.
SEQUENTIAL = {
    theme: LinearSegmentedColormap.from_list(theme, matplotlib.colormaps["viridis"](parts))
    for theme, parts in (
        ("light", np.linspace(0, 0.92, 256)),
        ("dark", np.linspace(0.3, 1, 256)),
    )
}
# Blue below zero and red above; grey and not white in between.
SIGNED = matplotlib.colormaps["coolwarm"]
WORDS = {
    "N": "axial force $N$",
    "Q": "shear force $Q$",
    "M": "bending moment $M$",
    "stress": "largest normal stress",
    "strain energy": "strain energy per length",
    "speed": "speed",
}
_SCALES = "linear", "log"
_DECADES = 1e-4  # smallest value on a logarithmic scale, as a fraction of the largest


class DrawnMembers:
    """All members of a drawing, in pieces of their elements, in the colours of a quantity if given.

    The colours are on the same scale in all rows of the drawing.

    Attributes
    ----------
    pieces : int
        Pieces of an element.
    scale : ScalarMappable
        The scale of the quantity, for a colour bar.
    bar : dict
        How the colour bar looks, and its label.
    """

    def __init__(
        self,
        drawing: Drawing,
        theme: str,
        thickness: float | None = None,
        quantity: Any = None,
        limits: tuple[float, float] | None = None,
        scale: str = "linear",
    ):
        self._drawing = drawing
        self._depths: Any = None
        beams = drawing.solution.beams.values()
        elements = sum(beam.elements for beam in beams)
        self.pieces = max(1, min(_PIECES, _MANY // max(elements, 1)))
        if isinstance(quantity, Mapping):
            quantity = _own_values(drawing, quantity)
            self.pieces = quantity[1].shape[2]
        if thickness is not None:
            positive(thickness, "thickness", "a positive factor on the depth, or None")
            fractions = np.arange(self.pieces + 1) / self.pieces
            touching = _contact_depths(drawing.solution.contacts)
            depths = [_depths(beam, fractions, touching.get(beam.name)) for beam in beams]
            self._depths = as_float(thickness) * np.concatenate(depths or [_NONE])[..., None]
        #: Values (elements * pieces,) by rows.
        self.values: dict[int, np.ndarray] = {}
        if quantity is not None:
            self._take_colours(theme, quantity, limits, scale)
            return
        expected = "given with a colour, such as colour='M'"
        require(limits is None, "colour_limits", limits, expected)
        require(isinstance(scale, str) and scale == "linear", "colour_scale", scale, expected)

    def _take_colours(
        self, theme: str, quantity: Any, limits: tuple[float, float] | None, scale: str
    ) -> None:
        drawing, solution = self._drawing, self._drawing.solution
        if not solution.beams:
            raise ValueError(f"colour = {quantity!r} needs beams, but the solution has none")
        require(is_one_of(scale, _SCALES), "colour_scale", scale, "'linear' or 'log'")
        if isinstance(quantity, tuple):
            label, values = quantity
            signed = bool((values < 0).any())
        else:
            internal = itertools.chain(*solution.variables_of_beam.values())
            names = [*QUANTITIES, *sorted({*internal})]
            expected = f"one of {', '.join(map(repr, names))}, values by their label, or None"
            require(is_one_of(quantity, names), "colour", quantity, expected)
            middles = (np.arange(self.pieces) + 0.5) / self.pieces
            values = along_all(solution, [quantity], drawing.rows, middles)[quantity]
            label, signed = words_for(quantity, drawing.unit), is_signed(quantity)
        rows = values.reshape(len(drawing.rows), -1)
        norm = _norm(values, signed, limits, scale == "log")
        low, high = bool((rows < norm.vmin).any()), bool((rows > norm.vmax).any())
        if scale == "log" and not signed:  # zero has the colour of the low end
            rows = np.maximum(rows, norm.vmin)
        self.values = dict(zip(drawing.rows, rows, strict=True))
        self.scale = ScalarMappable(norm, SIGNED if signed else SEQUENTIAL[theme])
        ends_beyond = {(True, True): "both", (True, False): "min", (False, True): "max"}
        self.bar: Look = {"label": label}
        self.bar["extend"] = ends_beyond.get((low, high), "neither")
        if scale == "linear":
            self.bar["format"] = "%.3g"

    def collection(self, pen: Pen, zorder: float = 3, **look) -> LineCollection | PolyCollection:
        """Collection of the members, without a position: lines as thick as they are, or bands."""
        # They are inside of the axes: a layout that asks each piece would be slow.
        look = {"zorder": zorder, "in_layout": False} | look
        if self.values:
            look |= {"norm": self.scale.norm, "cmap": self.scale.cmap}
        if self._depths is None:
            widths = self.per_piece(widths_of(pen, self._drawing))
            return LineCollection([], linewidth=widths, capstyle="round", **look)
        # A thin edge of the same colour closes the gaps between the pieces.
        return PolyCollection([], edgecolor="face", linewidth=0.3, **look)

    @property
    def has_colours(self) -> bool:
        """Whether the colours show a quantity."""
        return bool(self.values)

    def move(self, collection: LineCollection | PolyCollection, k: int) -> None:
        """Move the drawn members to their positions in row k, and colour them by its values."""
        if self.values:
            collection.set_array(self.values[k])
        if self._depths is None:
            points = self._drawing.along_elements(k, self.pieces)
            pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2)
            collection.set_verts(list(pieces.reshape(-1, 2, 2)))
            return
        left, right = self._sides(k)
        corners = [left[:, :-1], left[:, 1:], right[:, 1:], right[:, :-1]]
        collection.set_verts(list(np.stack(corners, axis=2).reshape(-1, 4, 2)))

    def _sides(self, k: int) -> np.ndarray:
        """Both sides (2, elements, points, 2) of members drawn as thick as they are, in row k."""
        points = self._drawing.along_elements(k, self.pieces)
        aside = self._depths / 2 * self._drawing.normals(k, self.pieces)
        return np.stack([points + aside, points - aside])

    @property
    def corners(self) -> list[np.ndarray]:
        """Corners (2,) of what holds such members in each row."""
        if self._depths is None or not self._depths.size:
            return []
        sides = (self._sides(k) for k in self._drawing.rows)
        return [corner for x in sides for corner in (x.min((0, 1, 2)), x.max((0, 1, 2)))]

    def per_piece(self, values) -> np.ndarray:
        """One value for each member, repeated for its pieces."""
        counts = [beam.elements * self.pieces for beam in self._drawing.solution.beams.values()]
        return np.repeat(np.asarray(values), counts, axis=0)


def _own_values(drawing: Drawing, colour: Mapping[str, ArrayLike]) -> tuple[str, np.ndarray]:
    """Label and values (rows, elements, pieces) of a field of the user's in the rows shown."""
    expected = "values by one label, as of fenicsx.Problem.at_points: {'damage': values}"
    require(len(colour) == 1 and is_name(*colour), "colour", colour, expected)
    ((label, field),) = colour.items()
    values, rows = real_array(field), drawing.rows
    if values.ndim == 2 and len(rows) == 1:
        values, rows = values[None], [0]
    elements = sum(beam.elements for beam in drawing.solution.beams.values())
    count = len(drawing.solution.t) if rows is drawing.rows else 1
    ok = values.ndim == 3 and values.shape[:2] == (count, elements) and values.size > 0
    expected = (
        f"finite values (elements, m) of {elements} elements in the one row that is shown, or "
        f"(rows, elements, m) in all {len(drawing.solution.t)} rows"
    )
    require(ok and bool(np.isfinite(values).all()), f"colour[{label!r}]", field, expected)
    return label, values[rows]


_LEAST, _EDGE, _BRIGHT = 3.4, 0.75, 5.0  # widths of lines [points]
_STOUT = 0.3  # largest width of a member, by its length
_PLAIN = 500  # members above which they are plain lines


def colours_of(drawing: Drawing) -> list[Colour]:
    """A colour for each member."""
    return [MEMBERS[i % len(MEMBERS)] for i in range(len(drawing.solution.beams))]


def widths_of(pen: Pen, drawing: Drawing) -> np.ndarray:
    """Widths (n,) of members [points]: of lines, or their depths where these are larger."""
    touching, least = _contact_depths(drawing.solution.contacts), _LEAST * pen.scale
    known: dict[int, Any] = {}
    middle, widths = np.array([0.5]), []
    for beam in drawing.solution.beams.values():
        depth = touching.get(beam.name)
        # Of stiffnesses alone no depth is known.
        if depth is None and beam.section is not None and has_stresses(beam.section):
            key = id(beam.section)
            if key not in known:
                known[key] = _depth_of(beam, middle)
            depth = known[key]
        mean = 0.0 if depth is None else float(np.mean(depth))
        widths.append(min(mean, _STOUT * beam.length) / pen.point)
    return np.maximum(widths, least)


def draw_members(
    pen: Pen, drawing: Drawing, k: int, ghost: bool = False, width: float | None = None
) -> None:
    """Draw all members in row k as lines as thick as they are, or of a width; ghosts are plain."""
    beams = list(drawing.solution.beams.values())
    if not beams:
        return
    elements = np.array([beam.elements for beam in beams])
    straight = all(beam.degree == 1 for beam in beams)
    pieces = 1 if straight else max(1, min(_PIECES, _MANY // elements.sum()))
    points, colours = drawing.along_elements(k, pieces), colours_of(drawing)
    if len(beams) > _PLAIN:
        gaps = np.full((len(points), 1, 2), np.nan)
        lines = np.concatenate([points, gaps], axis=1)
        owner = np.repeat(np.arange(len(beams)) % len(MEMBERS), elements)
        for number, colour in enumerate(MEMBERS):
            pen.line(lines[owner == number].reshape(-1, 2), colour, _LEAST * pen.scale)
        return
    ends, theme = np.cumsum(elements), pen.theme
    z, widths = 3.0, widths_of(pen, drawing) if width is None else np.full(len(beams), width)
    for i, (shade, thick) in enumerate(zip(colours, widths.tolist(), strict=True)):
        own = points[ends[i] - elements[i] : ends[i]]
        line = np.concatenate([own[:, :-1].reshape(-1, 2), own[-1:, -1]])
        if ghost:
            pen.line(line, shade, thick, z - 1)
            continue
        if thick > 2:
            pen.line(line, mixed(shade, theme.ink, 0.55), thick + 2 * _EDGE, z)
        pen.line(line, shade, thick, z + 0.01)
        if thick > _BRIGHT:
            pen.line(line, mixed(shade, "#ffffff", 0.42), 0.28 * thick, z + 0.02)


def _contact_depths(contacts: Iterable[Contact]) -> dict[str, float]:
    """Thickness with which members touch, by their names; where they have several the largest."""
    depths: dict[str, float] = {}
    for contact in contacts:
        radii = np.broadcast_to(contact.radius, 2)
        for member, radius in zip((contact.target, contact.shape), radii.tolist(), strict=True):
            if isinstance(member, Beam) and radius > 0:
                depths[member.name] = max(depths.get(member.name, 0.0), 2 * radius)
    return depths


def _depths(beam: Beam, fractions: np.ndarray, touching: float | None) -> np.ndarray:
    """Depths (elements, points) of a beam [m]: its thickness in contacts, else of a rectangle.

    The rectangle has the stiffnesses or masses of the section.
    """
    if touching is not None:
        return np.full((beam.elements, len(fractions)), touching)
    if beam.section is None:
        raise ValueError(
            f"thickness needs the section of {beam.name!r}, which a saved file does not hold; take "
            "the solution as simulate gave it"
        )
    depths = _depth_of(beam, fractions)
    if depths is None:
        raise ValueError(
            f"thickness needs EA and EI, or rhoA and rhoI, in the section of {beam.name!r}"
        )
    return depths


def _depth_of(beam: Beam, fractions: np.ndarray) -> np.ndarray | None:
    """Depths (elements, points) of a rectangle as stiff as a beam [m]; None without stiffnesses."""
    s, section = arc_lengths(beam, fractions) / beam.length, beam.section
    assert section is not None
    for bending, axial in ("EI", "EA"), ("rhoI", "rhoA"):
        first, second = section.values(axial, s), section.values(bending, s)
        if first.all() and second.all():
            return np.sqrt(12 * second / first)
    return None


def is_signed(quantity: str) -> bool:
    """Whether a quantity has both signs: stress resultants and internal variables."""
    return quantity in RESULTANTS or quantity not in QUANTITIES


def unit_of(quantity: str, scene_unit: str) -> str:
    """Unit of a quantity; empty, as it is unknown, if the scene's unit is not the metre."""
    return QUANTITIES.get(quantity, "") if scene_unit == "m" else ""


def words_for(quantity: str, scene_unit: str) -> str:
    """A quantity in words, with its unit."""
    unit = unit_of(quantity, scene_unit)
    return WORDS.get(quantity, quantity) + (f" [{unit}]" if unit else "")


def hexadecimal(scale, count: int) -> list[str]:
    """Colours of a scale from one end to the other, as pages write them."""
    return [to_hex(shade) for shade in scale(np.linspace(0, 1, count))]


def _norm(
    values: np.ndarray, signed: bool, limits: tuple[float, float] | None, logarithmic: bool
) -> Any:
    """The scale between two values."""
    largest = float(abs(values).max()) or 1.0
    if limits is not None:
        ok = real_array(limits).shape == (2,) and bool(np.isfinite(real_array(limits)).all())
        low, high = (as_float(limit) for limit in limits) if ok else (0.0, 0.0)
        expected = "two finite numbers, the lower one first"
        require(ok and low < high, "colour_limits", limits, expected)
        if logarithmic:
            expected = "the smallest and the largest size, both positive, on a log scale"
            require(low > 0, "colour_limits", limits, expected)
    elif logarithmic:
        low, high = _DECADES * largest, largest
    else:
        low, high = -largest if signed else 0.0, largest
    if not logarithmic:
        return Normalize(low, high)
    return SymLogNorm(low, vmin=-high, vmax=high) if signed else LogNorm(low, high)


# -- Symbols in pictures: supports, joints, gears, springs, ropes, masses, bodies, obstacles ----


_SIDES = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])
_FORCE = 0.02  # smallest force that is drawn, as a fraction of the largest


# -- Supports --------------------------------------------------------------------------------------


class Support(NamedTuple):
    """A support: "pin", "roller", "clamp", "guide" or "turn", and the direction into the ground."""

    kind: str
    away: np.ndarray


def supports_of(drawing: Drawing, parts: Parts) -> dict[int, Support]:
    """Supports by the numbers of their nodes, each on a side without members."""
    fixed: dict[int, set[int]] = {}
    for number, component in parts.fixed:
        fixed.setdefault(number, set()).add(component)
    for joint in parts.joints:
        if is_grounded(joint) and joint.axis is None:
            fixed[node_of(joint).number] = {0, 1, 2} if joint.is_rigid else {0, 1}
    leaving = leaving_of(drawing, set(fixed))
    return {number: _support(fixed[number], np.array(leaving[number])) for number in sorted(fixed)}


def leaving_of(drawing: Drawing, numbers: set[int]) -> dict[int, list[np.ndarray]]:
    """Directions (2,) in which members leave each of some nodes at the start."""
    directions: dict[int, list[np.ndarray]] = {number: [] for number in numbers}
    X = drawing.solution.X
    segments = [ends for beam in drawing.solution.beams.values() for ends in pairwise(beam.nodes)]
    bodies = drawing.solution.bodies.values()
    segments += [(body.centre, node) for body in bodies for node in body.points.values()]
    for first, last in segments:
        for node, other in ((first, last), (last, first)):
            if node.number in numbers and (way := X[other.number] - X[node.number]).any():
                directions[node.number].append(unit(way))
    return {number: parts or [np.array([0.0, 1.0])] for number, parts in directions.items()}


def _support(components: set[int], leaving: np.ndarray) -> Support:
    moves = {0, 1} - components
    if components == {0, 1, 2}:
        return Support("clamp", _across(leaving))
    # Below, or above if a member leaves downwards; a roller across its free direction.
    away = -np.eye(2)[0 if moves == {1} else 1]
    if (leaving @ away).max() > 0.5:
        away = -away
    kind = "turn" if len(moves) == 2 else "guide" if 2 in components else "roller"
    return Support(kind if moves else "pin", away)


def _across(leaving: np.ndarray) -> np.ndarray:
    """Direction into the wall of a clamp: along a single member, else the nearest axis."""
    mean = leaving.sum(axis=0)
    if np.hypot(*mean) < 1e-6 or np.ptp(leaving, axis=0).max() < 1e-6:
        return -leaving[0]
    return _SIDES[(_SIDES @ -mean).round(6).argmax()]


_TRIANGLE = np.array([(0, 0), (8, -13), (-8, -13)])
_PLATE = np.array([(-10, 0), (10, 0), (10, -4), (-10, -4)])
_SQUARE = 4 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def draw_supports(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw all supports in row k, with one strip of ground where they are side by side."""
    spans: dict[tuple, list[tuple[float, float, float]]] = {}
    for number, support in drawing.once(supports_of, parts).items():
        place, away = drawing.positions(number, k), support.away
        foot = _draw_support(pen, place, support)
        if foot is not None:
            level, s = place @ away + foot * pen.unit, place @ left_of(away)
            half = (15.0 if foot else 13.0) * pen.unit
            key = (*away.round(6).tolist(), round(level / pen.point))
            spans.setdefault(key, []).append((s - half, s + half, level))
    for (x, y, _), parts_of_strip in spans.items():
        away, strips = np.array([x, y]), list[list[float]]()
        for start, end, level in sorted(parts_of_strip):
            if strips and start < strips[-1][1] + 10.0 * pen.unit:
                strips[-1][1] = max(end, strips[-1][1])
            else:
                strips.append([start, end, level])
        for start, end, level in strips:
            line = level * away + np.outer((start, end), left_of(away))
            pen.ground(line, away)


def _draw_support(pen: Pen, place: np.ndarray, support: Support) -> float | None:
    """Draw a triangle for a pin, with wheels for a roller; height above the ground, if any."""
    kind, away = support
    across = left_of(away)
    if kind == "turn":
        pen.area(pen.at(place, _SQUARE), pen.theme.paper, z=6)
        return None
    if kind == "clamp":
        return 0.0
    foot = 13.0 if kind in ("pin", "roller") else 4.0
    pen.area(pen.at(place, _TRIANGLE if foot > 4 else _PLATE, across), width=1.2, z=4)
    if kind != "pin":
        wheels = [(x, -foot - 2.6) for x in (-5, 5)]
        pen.ring(pen.at(place, wheels, across), 2.4, width=1.0, z=4)
        foot += 5.2
    if kind != "guide":
        draw_pin(pen, place)
    return foot


def draw_pin(pen: Pen, places) -> None:
    """Draw rings with a dot at some places."""
    pen.ring(places, 4.0, z=6)
    pen.ring(places, 0.9, pen.theme.ink, width=0.0, z=6.1)


# -- All that is in a row --------------------------------------------------------------------------


def draw_held(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw supports, joints, gears, springs, ropes and fixed obstacles of a scene in row k."""
    for outline in drawing.fixed(parts):
        draw_outline(pen, outline)
    draw_supports(pen, drawing, parts, k)
    draw_joints(pen, drawing, parts, k)
    draw_between(pen, drawing, parts, k)


def draw_past(pen: Pen, drawing: Drawing) -> None:
    """Draw what the scene has no more in the last row, where it was last."""
    last = drawing.parts(drawing.rows[-1])
    for parts, places in drawing.stretches[:-1]:
        draw_held(pen, drawing, parts.without(last), drawing.rows[places[-1]])


def draw_moving(pen: Pen, drawing: Drawing, k: int, ghost: bool = False) -> None:
    """Draw arms, bodies, balls, carried obstacles and masses of row k; of ghosts outlines only."""
    parts = drawing.parts(k)
    for outline in drawing.carried(parts, k):
        draw_outline(pen, outline, ghost)
    for wheel in drawing.circles(parts, k):
        pen.area(wheel[1:-1], "none" if ghost else None, width=1.0 if ghost else 1.3, z=2.2)
        if not ghost:
            pen.line(wheel[:2], z=2.3)
    _draw_bodies(pen, drawing, k, ghost)
    if not ghost:
        _draw_arms(pen, drawing, parts, k)
    _draw_masses(pen, drawing, parts, k)


def draw_outline(pen: Pen, outline: Outline, ghost: bool = False) -> None:
    """Draw an obstacle: a disc, or a line of the ground with strokes on one side."""
    if ghost:
        pen.line(outline.line, z=1)
    elif outline.is_disc:
        pen.area(outline.line[:-1], width=1.3, z=2.1)
        pen.line([outline.line.mean(axis=0), outline.line[len(outline.line) // 4]], z=2.3)
    else:
        pen.ground(outline.line, outline.sides, 7.0, z=1)


def _draw_bodies(pen: Pen, drawing: Drawing, k: int, ghost: bool) -> None:
    """Draw bodies as their points, rounded, with the centre of mass."""
    face = "none" if ghost else None
    for body in drawing.solution.bodies.values():
        corners = drawing.positions([node.number for node in body.nodes], k)
        if len(corners) > 1:
            pen.area(rounded(corners, 4.0 * pen.unit), face, width=1.0 if ghost else 1.2, z=2.5)
        if not ghost:
            _draw_centre(pen, corners[0])
        elif len(corners) == 1 and body.centre.number not in drawing.parts(k).radii:
            pen.ring(corners, 4.2, "none", width=1.0, z=2.5)


def _draw_centre(pen: Pen, place: np.ndarray) -> None:
    """Draw a centre of mass: a quartered disc."""
    pen.ring(place, 4.2, width=0.9, z=6.5)
    for start in (0, 12):
        arc = circle(np.zeros(2), 4.2, 24)[start : start + 7]
        pen.area(pen.at(place, [(0, 0), *arc]), pen.theme.ink, "none", 0.0, 6.6)


def _draw_masses(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw lumped masses on members as discs whose volumes are in proportion."""
    lumped = lumped_masses(drawing, parts)
    largest = max((mass.mass for mass in lumped), default=0.0)
    for mass in lumped:
        if mass.mass > 0:
            radius = max(2.5, 6.0 * (mass.mass / largest) ** (1 / 3))
            pen.ring(drawing.positions(mass.node, k), radius, pen.theme.soft, width=1.0, z=5.5)


def lumped_masses(drawing: Drawing, parts: Parts) -> list[Mass]:
    """Masses that are not those of bodies."""
    centres = {body.centre.number for body in drawing.solution.bodies.values()}
    return [mass for mass in parts.masses if mass.node not in centres]


def _draw_arms(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw rigid arms from nodes to joints with an offset."""
    centres = {body.centre for body in drawing.solution.bodies.values()}
    for joint in parts.joints:
        is_of_body = joint.is_rigid and joint.a in centres
        if joint.offset.any() and not (is_of_body or is_grounded(joint)):
            start = drawing.positions(joint.a.number, k)
            pen.line([start, _origin(drawing, joint, k)], width=2.0, z=2.8)


# -- Forces and names ------------------------------------------------------------------------------


def draw_forces(pen: Pen, drawing: Drawing, k: int) -> None:
    """Draw arrows of forces on nodes, with lengths in proportion; very small ones are left out."""
    for node, force in drawing.forces[k].items():
        if np.hypot(*force) > _FORCE * drawing.largest_force:
            pen.arrow(drawing.arrow(node, k), width=2.0, head=8.0)


def checked_marks(drawing: Drawing, marks: dict[str, Node] | None) -> dict[str, Node]:
    """Nodes by the names to write; SceneError for others than those of the solution."""
    marks = {} if marks is None else marks
    require(isinstance(marks, dict), "marks", marks, "a dict of nodes by the names to write")
    for node in marks.values():
        drawing.solution.position(node)
    return marks


# -- Joints ----------------------------------------------------------------------------------------


def draw_joints(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw hinges, slides, gears, and what acts on their angles and slides."""
    hinges = []
    of_bodies = {node for body in drawing.solution.bodies.values() for node in body.nodes}
    for joint in parts.joints:
        place = drawing.positions(node_of(joint).number, k)
        if joint.slide is not None:
            _draw_slide(pen, drawing, parts, joint, place, k)
        elif not (joint.is_rigid or is_grounded(joint)):
            hinges.append(place)
        elif of_bodies.isdisjoint((joint.a, joint.b)) and not (
            joint.offset.any() or is_grounded(joint)
        ):
            _draw_gusset(pen, drawing, parts, joint, k)
        if joint.rotation is not None:
            _draw_around(pen, place, joint.rotation)
    if hinges:
        draw_pin(pen, hinges)
    for number, gear in enumerate(parts.gears):
        _draw_gear(pen, drawing, gear, number, k)


def _draw_gusset(pen: Pen, drawing: Drawing, parts: Parts, joint: Joint, k: int) -> None:
    """Draw a plate over the ends of members that a rigid joint connects."""
    known = drawing.once(_rigid_ways, parts)
    ways = [drawing.turned(n, k, way) for n in (joint.a, joint.b) for way in known[n.number]]
    place = drawing.positions(joint.b.number, k)
    ends = [c * 4.5 * left_of(way) + s * way for way in ways for c in (-1, 1) for s in (0.0, 12.0)]
    pen.area(hull(place + pen.unit * np.array(ends)), pen.theme.ink, "none", 0.0, 5)


def _rigid_ways(drawing: Drawing, parts: Parts) -> dict[int, list[np.ndarray]]:
    """Directions of members at rigid joints."""
    rigid = (joint for joint in parts.joints if joint.is_rigid and not is_grounded(joint))
    return leaving_of(drawing, {node.number for joint in rigid for node in (joint.a, joint.b)})


def slide_direction(drawing: Drawing, joint: Any, k: int) -> np.ndarray:
    """Unit vector (2,) of a slide in row k; on a beam the direction between two of its nodes."""
    if joint.axis is not None:
        return drawing.turned(joint.a, k, joint.direction)
    positions = drawing.positions(drawing.solution.nodes_of_beam[joint.beam.name], k)
    nearest = int(np.argmin(np.hypot(*(positions - drawing.positions(joint.b.number, k)).T)))
    return unit(np.gradient(positions, axis=0)[nearest])


def _origin(drawing: Drawing, joint: Joint, k: int) -> np.ndarray:
    """Where the slide of a joint is zero: on its node a in row k, or on the ground."""
    if is_grounded(joint):
        return drawing.solution.X[node_of(joint).number]
    return drawing.positions(joint.a.number, k) + drawing.turned(joint.a, k, joint.offset)


def _ranges(drawing: Drawing, parts: Parts) -> dict[int, tuple[float, float]]:
    """Least and largest slide in all rows of the picture, by the numbers of joints."""
    ranges = {}
    for joint in parts.joints:
        if joint.slide is not None and joint.axis is not None:
            number = node_of(joint).number
            slides = [
                (drawing.positions(number, k) - _origin(drawing, joint, k))
                @ slide_direction(drawing, joint, k)
                for k in drawing.rows
            ]
            ranges[joint.number] = min(0.0, *slides), max(0.0, *slides)
    return ranges


_JAW = np.array([(-12, 4), (12, 4), (12, 7.5), (-12, 7.5)])
_CARRIAGE = np.array([(-10, 8), (10, 8), (10, 11), (-10, 11)])
_BLOCK = np.array([(-15, -9), (15, -9), (15, 9), (-15, 9)])
_MIRROR = np.array([1.0, -1.0])


def _draw_slide(
    pen: Pen, drawing: Drawing, parts: Parts, joint: Any, place: np.ndarray, k: int
) -> None:
    """Draw a guide on the ground or on a node, a slot, a carriage or a sleeve on a beam."""
    way, turns = slide_direction(drawing, joint, k), joint.rotation is not None
    if joint.axis is None:
        shape = _CARRIAGE if turns else _JAW
        for side in (1, _MIRROR):
            pen.area(pen.at(place, shape * side, way), width=1.1, z=5.1)
            if turns:
                wheels = pen.at(place, np.array([(-6, 5.6), (6, 5.6)]) * side, way)
                pen.ring(wheels, 2.5, width=1.0, z=5.2)
        if turns:
            draw_pin(pen, place)
        _draw_along(pen, drawing, joint, place, way, k)
        return
    origin, (low, high) = _origin(drawing, joint, k), drawing.once(_ranges, parts)[joint.number]
    more = max((2.5 if turns else 8.0) * pen.unit, (46.0 * pen.unit - (high - low)) / 2)
    ends = origin + np.outer((low - more, high + more), way)
    if turns:  # a slot
        for radius, face, z in ((7.5, None, 4.4), (5.0, pen.theme.paper, 4.5)):
            pen.area(rounded(ends, radius * pen.unit), face, width=1.1, z=z)
        draw_pin(pen, place)
    elif is_grounded(joint):
        long = ends + np.outer((-15.0, 15.0), way) * pen.unit
        for across in (left_of(way), -left_of(way)):
            pen.ground(long + 10.0 * pen.unit * across, across, 5.0)
        pen.area(pen.at(place, _BLOCK, way), width=1.2, z=2.6)
    else:
        slide = (place - origin) @ way  # the guide reaches a little beyond what slides
        reach = np.array([min(0.0, slide), max(0.0, slide)]) + 20.0 * pen.unit * np.array([-1, 1])
        pen.line(origin + np.outer(reach, way), pen.theme.soft, 1.0, 2.4)
        for side in (1, _MIRROR):
            pen.area(pen.at(place, _JAW * side, way), width=1.1, z=4.6)
    _draw_along(pen, drawing, joint, place, way, k)


def _draw_along(
    pen: Pen, drawing: Drawing, joint: Any, place: np.ndarray, way: np.ndarray, k: int
) -> None:
    """Draw spring, damper, friction and stops of a slide."""
    short = 40.0 * pen.unit * way
    start = place - short if joint.axis is None else _origin(drawing, joint, k)
    if is_grounded(joint) and joint.axis is not None:
        start = start - short
    draw_straight(pen, joint.slide, start, place)
    limits = getattr(joint.slide.stop, "lower", None), getattr(joint.slide.stop, "upper", None)
    for side, limit in zip((-1.0, 1.0), limits, strict=True):
        if limit is not None and joint.axis is not None:
            stop = _origin(drawing, joint, k) + limit * way
            pen.wall(stop, side * way, 18.0, 4.0, z=4.7)


# -- Laws ------------------------------------------------------------------------------------------

_HELIX = np.linspace(0, 1, 141)


def draw_straight(pen: Pen, laws: Coordinate, a: np.ndarray, b: np.ndarray) -> None:
    """Draw a spring, a damper and friction between two points, beside each other."""
    way, length = unit(b - a), np.hypot(*(b - a)) / pen.unit
    has = [name for name in ("spring", "damper") if getattr(laws, name) is not None]
    for name, aside in zip(has, (0.0,) if len(has) == 1 else (-5.5, 5.5), strict=False):
        half = min(4.5, length / 4)
        if name == "spring":
            x = length * (0.15 + 0.7 * _HELIX) - 0.2 * half * (1 - np.cos(14 * np.pi * _HELIX))
            coil = np.column_stack([x, half * np.sin(14 * np.pi * _HELIX) + aside])
            symbol = np.concatenate([[(0, aside)], coil, [(length, aside)]])
            pen.line(pen.at(a, symbol, way), pen.theme.paper, 3.0, 3.4)
            pen.line(pen.at(a, symbol, way), width=1.4, z=3.5)
        else:
            _draw_damper(pen, a, way, length, half, aside)
    if len(has) == 2:
        for place in (a, b):
            pen.line(pen.at(place, [(0, -5.5), (0, 5.5)], way), width=1.4, z=3.5)
    if laws.friction is not None:
        _draw_shoes(pen, (a + b) / 2, way)


def _draw_damper(pen: Pen, a, way, length: float, half: float, aside: float) -> None:
    first, last, middle = 0.31 * length, 0.69 * length, 0.5 * length
    cup = np.array([(first, -half), (last, -half), (last, half), (first, half)]) + (0, aside)
    pen.area(pen.at(a, cup, way), edge="none", width=0.0, z=3.4)
    rods = [cup[[0, 1, 2, 3]], [(0, aside), (middle, aside)], [(last, aside), (length, aside)]]
    for rod in rods:
        pen.line(pen.at(a, rod, way), width=1.4, z=3.5)
    piston = [(middle, aside + 1.4 - half), (middle, aside + half - 1.4)]
    pen.line(pen.at(a, piston, way), width=2.2, z=3.5)


def _draw_shoes(pen: Pen, place, way) -> None:
    """Draw shoes of a brake on both sides of a slide."""
    shoe = np.array([(-10, 8), (10, 8), (10, 12), (-10, 12)])
    for side in (1, _MIRROR):
        pen.area(pen.at(place, shoe * side, way), pen.theme.ink, "none", 0.0, 4.8)


_SPIN = np.linspace(0, 5.2 * np.pi, 90)
_SPIRAL = (4.0 + 10.0 * _SPIN / _SPIN[-1]) * np.array([np.cos(_SPIN), np.sin(_SPIN)])
_BEND = np.linspace(0.3, 1.7, 16)
_ROUND = np.column_stack([np.cos(_BEND), np.sin(_BEND)])
_SHOE = np.linspace(-0.5, 0.5, 8)
_BENT = np.column_stack([np.cos(_SHOE), np.sin(_SHOE)])
_ENDS = np.array([19.0, 26.0])[:, None]


def _draw_around(pen: Pen, place: np.ndarray, laws: Coordinate) -> None:
    """Draw spring, damper, friction and stops of an angle around a hinge."""
    if laws.spring is not None:
        pen.line(pen.at(place, _SPIRAL.T), pen.theme.paper, 3.0, 4.9)
        pen.line(pen.at(place, _SPIRAL.T), width=1.2, z=5)
    if laws.damper is not None:
        cup = np.concatenate([13.0 * _ROUND, 21.0 * _ROUND[::-1]])
        pen.area(pen.at(place, cup), edge="none", width=0.0, z=4.8)
        pen.line(pen.at(place, cup), width=1.4, z=4.9)
        plate = np.outer((14.4, 19.6), _ROUND[8])
        pen.line(pen.at(place, plate), width=2.2, z=4.9)
    if laws.friction is not None:
        for side in (1.0, -1.0):
            shoe = np.concatenate([17.0 * _BENT, 21.0 * _BENT[::-1]])
            pen.area(pen.at(place, side * shoe), pen.theme.ink, "none", 0.0, 4.8)
    if laws.stop is not None:
        for line in (_ENDS * _ROUND[0], 22.5 * _ROUND, _ENDS * _ROUND[-1]):
            pen.line(pen.at(place, line), width=1.5, z=4.8)


# -- Gears -----------------------------------------------------------------------------------------

_TOOTH = np.array([(-0.27, -1.1), (-0.21, -0.2), (-0.11, 1), (0.11, 1), (0.21, -0.2), (0.27, -1.1)])
_MODULE = 4.0  # [points]


def _draw_gear(pen: Pen, drawing: Drawing, gear: Gear, number: int, k: int) -> None:
    """Draw two wheels whose radii have the ratio of the gear, a belt, or a rack with its wheel."""
    nodes = [node_of(joint).number for joint in (gear.joint_a, gear.joint_b)]
    start = drawing.solution.X[nodes]
    a, b = drawing.positions(nodes, k)
    faces = [mixed(MEMBERS[(number + i) % 4], pen.theme.paper, 0.55) for i in (0, 3)]
    if gear.driven == "slide":
        _draw_rack(pen, drawing, gear, (a, b), faces, k)
        return
    distance = float(np.hypot(*(start[1] - start[0])))
    radii = gear_radii(gear, distance)
    way = np.arctan2(*(b - a)[::-1])
    angles = [drawing.angle(node, k) for node in nodes]
    if distance <= 20.0 * pen.unit:  # on one axis
        return
    if gear.ratio > 0:  # a belt
        lean = np.arcsin((radii[0] - radii[1]) / distance)
        for side in (1.0, -1.0):
            angle = way + side * (np.pi / 2 - lean)
            arm = np.array([np.cos(angle), np.sin(angle)])
            pen.line([a + radii[0] * arm, b + radii[1] * arm], ROPE, 2.0, 2.1)
        for place, radius, angle, face in zip((a, b), radii, angles, faces, strict=True):
            pen.area(circle(place, radius)[:-1], face, width=1.2, z=2.0)
            pen.line([place, place + radius * np.array([-np.sin(angle), np.cos(angle)])], z=2.2)
        return
    for i, (place, radius) in enumerate(zip((a, b), radii, strict=True)):
        teeth = max(8, round(2 * radius / (_MODULE * pen.unit)))
        phase = way + angles[0] if i == 0 else way + np.pi * (1 + 1 / teeth) + angles[1]
        _draw_wheel(pen, place, radius, teeth, phase, faces[i])


def _draw_wheel(pen: Pen, centre, radius: float, teeth: int, phase: float, face) -> None:
    """Draw a toothed wheel with a pitch radius [m]."""
    depth = min(1.1 * radius / teeth, 0.2 * radius)
    angles = phase + 2 * np.pi * (np.arange(teeth)[:, None] + _TOOTH[:, 0]) / teeth
    arms = (radius + depth * _TOOTH[:, 1])[None, :, None]
    rim = arms * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    pen.area(centre + rim.reshape(-1, 2), face, width=1.0, z=2.0)
    for angle in phase + 2 * np.pi * np.arange(5) / 5:
        hole = centre + 0.58 * radius * np.array([np.cos(angle), np.sin(angle)])
        pen.area(circle(hole, 0.16 * radius, 24)[:-1], pen.theme.paper, width=0.8, z=2.1)


def _draw_rack(pen: Pen, drawing: Drawing, gear: Gear, places, faces, k: int) -> None:
    wheel, block = places
    radius, way = abs(float(gear.ratio)), slide_direction(drawing, gear.joint_b, k)
    angle = drawing.angle(node_of(gear.joint_a).number, k)
    teeth = max(8, round(2 * radius / (_MODULE * pen.unit)))
    side = left_of(way) * (1.0 if (block - wheel) @ left_of(way) > 0 else -1.0)
    _draw_wheel(pen, wheel, radius, teeth, np.arctan2(*side[::-1]) + angle, faces[0])
    pitch = 2 * np.pi * radius / teeth
    depth, slide = min(1.1 * radius / teeth, 0.2 * radius), (block - wheel) @ way
    foot = wheel + radius * side + slide % pitch * way
    x = pitch * (np.arange(-teeth // 3, teeth // 3 + 1)[:, None] + 0.5 + _TOOTH[:, 0]).ravel()
    y = -depth * np.tile(_TOOTH[:, 1], len(x) // len(_TOOTH))
    back = np.array([(x[-1], 4 * depth), (x[0], 4 * depth)])
    strip = np.concatenate([np.column_stack([x, y]), back])
    pen.area(foot + strip[:, :1] * way + strip[:, 1:] * side, faces[1], width=1.0, z=1.9)


# -- Forces between points -------------------------------------------------------------------------


def draw_between(pen: Pen, drawing: Drawing, parts: Parts, k: int) -> None:
    """Draw springs, dampers, ropes and other forces between points, and springs to the ground."""
    supports = drawing.positions([*drawing.once(supports_of, parts)], k)
    for force in parts.forces_between:
        if isinstance(force, GroundSpring):
            _draw_to_ground(pen, drawing, force, k)
            continue
        points, laws = line_between(drawing, force, k), force.on
        is_rope = is_a_rope(force)
        if is_rope:
            _draw_rope(pen, drawing, force, points, k)
        elif laws.spring is None and laws.damper is None:
            pen.line(points, ACTS, 1.2, 3.5, (6, 3))
        if not is_rope:
            draw_straight(pen, laws, points[0], points[-1])
        for end, sense in ((0, -1.0), (-1, 1.0)):
            if isinstance(force.points[end], Node):
                pen.ring(points[end], 2.0, pen.theme.ink, width=0.0, z=5.6)
            elif not (np.hypot(*(supports - points[end]).T) < 8.0 * pen.unit).any():
                pen.wall(points[end], unit(sense * force.apart[end]), 20.0)


def is_a_rope(force) -> bool:
    """Whether a force between points only pulls, from a length on."""
    return len(force.points) > 2 or any("of rope" in name for name in force.own)


def pull_of(drawing: Drawing, force, k: int) -> float | None:
    """Force of a line in row k [N]; None where it is not known, as in a scene."""
    forces = getattr(drawing.solution, "line_forces", np.empty((0, 0)))
    is_known = k < len(forces) and force.number < forces.shape[1]
    return float(forces[k, force.number]) if is_known else None


def _draw_rope(pen: Pen, drawing: Drawing, force, points: np.ndarray, k: int) -> None:
    if pull_of(drawing, force, k) == 0 and k > 0:
        pen.line(points, pen.theme.soft, 1.0, 3.5, (4, 3))
    else:
        pen.line(points, pen.theme.paper, 3.6, 3.5)
        pen.line(points, mixed(ROPE, pen.theme.ink, 0.25), 2.0, 3.6)
    for i, radius in enumerate(np.abs(getattr(force, "radii", ()))):
        if radius > 0:
            _draw_pulley(pen, drawing, force, i, radius, k)


def _draw_pulley(pen: Pen, drawing: Drawing, force, i: int, radius: float, k: int) -> None:
    """Draw a wheel with three spokes, which turn as the rope runs or with the node of a drum."""
    at, before = (drawing.place(force.points[j], k) for j in (i, max(i - 1, 0)))
    start, first = (drawing.place_at_start(force.points[j]) for j in (i, max(i - 1, 0)))
    run = np.hypot(*(at - before)) - np.hypot(*(start - first))
    angle = np.sign(force.radii[i]) * run / radius
    if force.kinds[i] == "D":
        angle = drawing.angle(force.points[i].number, k)
    pen.area(circle(at, radius)[:-1], width=1.1, z=3.2)
    inner = max(0.72 * radius, radius - 5 * pen.unit)
    pen.area(
        circle(at, inner)[:-1], mixed(pen.theme.ground, pen.theme.paper, 0.6), width=0.8, z=3.3
    )
    for spoke in angle + np.pi / 2 + 2 * np.pi * np.arange(3) / 3:
        tip = at + inner * np.array([np.cos(spoke), np.sin(spoke)])
        pen.line([at, tip], pen.theme.soft, 0.8, 3.35)
    draw_pin(pen, at)


def _draw_to_ground(pen: Pen, drawing: Drawing, force: GroundSpring, k: int) -> None:
    """Draw what holds a node or a beam to the ground, with walls."""
    if force.direction is None:
        _draw_around(pen, drawing.positions(force.nodes[0], k), force.on)
    for node, foot, way in feet(drawing, force):
        place = drawing.positions(node, k)
        draw_straight(pen, force.on, foot, place)
        if force.on.spring is None and force.on.damper is None:
            pen.line([foot, place], width=1.2, z=3.5)
        pen.wall(foot, -way, 18.0, 5.0)


def marks_of(drawing: Drawing, parts: Parts) -> dict[str, list[int]]:
    """Numbers of nodes at hinges, at slides and with lumped masses."""
    lumped = lumped_masses(drawing, parts)
    nodes: dict[str, list[int]] = {"mass": [mass.node for mass in lumped if mass.mass > 0]}
    for joint in parts.joints:
        # A hinge on the ground is drawn as a support; rigid joints are not marked.
        if not (joint.is_rigid or (is_grounded(joint) and joint.slide is None)):
            kind = "hinge" if joint.slide is None else "slide"
            nodes.setdefault(kind, []).append(node_of(joint).number)
    return nodes
