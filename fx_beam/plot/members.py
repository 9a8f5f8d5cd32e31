"""Members in pictures: lines, or bands as thick as they are, coloured by a quantity."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm, to_hex

from fx_beam.errors import as_float, is_one_of, positive, real_array, require
from fx_beam.results.fields import QUANTITIES, RESULTANTS, along_all
from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.contacts import Contact
from fx_beam.scene.section import has_stresses

from .drawing import Drawing
from .look import MEMBERS, Colour, Look, Pen, mixed

_PIECES = 12  # per element, each with one colour
_NONE = np.empty((0, 1))
_MANY = 6_000  # largest number of pieces in all, if elements have several pieces

# Without the palest colours, which are hard to see on white.
SEQUENTIAL = LinearSegmentedColormap.from_list(
    "sequential", matplotlib.colormaps["viridis"](np.linspace(0, 0.92, 256))
)
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
        thickness: float | None = None,
        quantity: str | None = None,
        limits: tuple[float, float] | None = None,
        scale: str = "linear",
    ):
        self._drawing = drawing
        self._depths: Any = None
        beams = drawing.solution.beams.values()
        elements = sum(beam.elements for beam in beams)
        self.pieces = max(1, min(_PIECES, _MANY // max(elements, 1)))
        if thickness is not None:
            positive(thickness, "thickness", "a positive factor on the depth, or None")
            fractions = np.arange(self.pieces + 1) / self.pieces
            touching = _contact_depths(drawing.solution.contacts)
            depths = [_depths(beam, fractions, touching.get(beam.name)) for beam in beams]
            self._depths = as_float(thickness) * np.concatenate(depths or [_NONE])[..., None]
        self._values: dict[int, np.ndarray] = {}
        if quantity is not None:
            self._take_colours(quantity, limits, scale)
            return
        expected = "given with a colour, such as colour='M'"
        require(limits is None, "colour_limits", limits, expected)
        require(isinstance(scale, str) and scale == "linear", "colour_scale", scale, expected)

    def _take_colours(self, quantity: str, limits: tuple[float, float] | None, scale: str) -> None:
        drawing, solution = self._drawing, self._drawing.solution
        if not solution.beams:
            raise ValueError(f"colour = {quantity!r} needs beams, but the solution has none")
        internal = itertools.chain(*solution.variables_of_beam.values())
        names = [*QUANTITIES, *sorted({*internal})]
        expected = f"one of {', '.join(map(repr, names))}, or None"
        require(is_one_of(quantity, names), "colour", quantity, expected)
        require(is_one_of(scale, _SCALES), "colour_scale", scale, "'linear' or 'log'")
        middles = (np.arange(self.pieces) + 0.5) / self.pieces
        values = along_all(solution, [quantity], drawing.rows, middles)[quantity]
        rows = values.reshape(len(drawing.rows), -1)
        signed = is_signed(quantity)
        norm = _norm(values, signed, limits, scale == "log")
        low, high = bool((rows < norm.vmin).any()), bool((rows > norm.vmax).any())
        if scale == "log" and not signed:  # zero has the colour of the low end
            rows = np.maximum(rows, norm.vmin)
        self._values = dict(zip(drawing.rows, rows, strict=True))
        self.scale = ScalarMappable(norm, SIGNED if signed else SEQUENTIAL)
        ends_beyond = {(True, True): "both", (True, False): "min", (False, True): "max"}
        self.bar: Look = {"label": words_for(quantity, drawing.unit)}
        self.bar["extend"] = ends_beyond.get((low, high), "neither")
        if scale == "linear":
            self.bar["format"] = "%.3g"

    def collection(self, pen: Pen, zorder: float = 3, **look) -> LineCollection | PolyCollection:
        """Collection of the members, without a position: lines as thick as they are, or bands."""
        # They are inside of the axes: a layout that asks each piece would be slow.
        look = {"zorder": zorder, "in_layout": False} | look
        if self._values:
            look |= {"norm": self.scale.norm, "cmap": self.scale.cmap}
        if self._depths is None:
            widths = self.per_piece(widths_of(pen, self._drawing))
            return LineCollection([], linewidth=widths, capstyle="round", **look)
        # A thin edge of the same colour closes the gaps between the pieces.
        return PolyCollection([], edgecolor="face", linewidth=0.3, **look)

    @property
    def has_colours(self) -> bool:
        """Whether the colours show a quantity."""
        return bool(self._values)

    def move(self, collection: LineCollection | PolyCollection, k: int) -> None:
        """Move the drawn members to their positions in row k, and colour them by its values."""
        if self._values:
            collection.set_array(self._values[k])
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
