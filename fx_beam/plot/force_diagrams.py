"""Diagrams of the axial force, the shear force and the bending moment along the members."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Area

from fx_beam.errors import is_flag, is_one_of, require
from fx_beam.results.fields import RESULTANTS, along_all, in_rows
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam, BeamPlace, arc_lengths

from .drawing import (
    Drawing,
    checked_rows,
    headings,
    line_between,
    prefix_of,
    spacing,
    three_digits,
    words_over,
)
from .labels import Labels
from .look import ROPE, Look, Pen, Theme, left_of, mixed, theme_of
from .members import words_for
from .outlines import interpolated
from .sheet import Picture, picture, written
from .symbols import (
    draw_between,
    draw_moving,
    draw_pin,
    draw_support,
    is_a_rope,
    marks_of,
    pull_of,
    supports_of,
)

_WIDTH, _TALL = 7.0, 8.0  # of the picture, and the largest height [inch]
_WIDE = 0.35  # height by width of a drawing below which panels lie below each other
_TALLEST, _OVER = 0.17, 1.5  # of a diagram, by the size of the members and by their distance
_ORDINATE = 30.0  # height of diagrams that lie below each other [points]
_ROOM, _TITLE, _NAME = 24.0, 20.0, 72.0  # for numbers, a title above, a name beside [points]
_SYMBOLS = 0.8  # size of symbols
_DENSE = 10.0  # distance between members below which their lines are thinner [points]
_PIECES, _FINE = 8, 64  # of an element, and where values are written
_NAMED = 12  # members up to which each has its values written beside it
# Values by the largest that are not written; differences below which one is; ends that are.
_LEAST, _ALIKE, _END, _SAME, _CORNER = 0.03, 0.04, 0.15, 0.005, 12.0
_KILO = 1e3  # from which largest value on numbers have a prefix


def diagrams(
    solution: Solution,
    path: Path | str | None = None,
    row: int | None = None,
    quantities: Sequence[str] = RESULTANTS,
    deformed: bool = True,
    scene_unit: str = "m",
    title: str = "",
    theme: str = "light",
) -> Figure:
    """Picture of the stress resultants along the members: a panel for N, Q and M each.

    A value is drawn normal to the axis: N and Q to the left of the beam's direction if they are
    positive, M on the side that is in tension. Negative areas are hatched; a jump at a force is a
    line across the axis. Written are the largest and the smallest value of each member, and of each
    part between supports, and values at its ends above 15 % of the largest of all; in frames of
    more than 12 members only the extreme values of the frame. Ropes and springs between points have
    their forces in the panel of N, a slack rope is dashed. Values follow from the balance of each
    element, as `BeamResultants.at` has them: at a clamp they are the reaction, at a free end zero.

    Parameters
    ----------
    solution : Solution
        The motion, or the equilibria.
    path : str or path, optional
        Picture to write; its ending gives the format.
    row : int, optional
        Row of `Solution.t`, by default the last. In a motion the values are means over the step
        that ends there, see `Solution.t_level`.
    quantities : sequence of {"N", "Q", "M"}
        The panels, from left to right, or one below the other if the scene is wide.
    deformed : bool
        Whether the diagrams stand on the deformed members, or on the members as they start.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    title : str
        What is written over the picture, before the time or load factor.
    theme : {"light", "dark"}
        Colours of the picture.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ValueError
        For a row or quantities that the solution does not have, or one without beams.
    """
    path, colours = picture(path), theme_of(theme)
    if row is None and isinstance(solution, Solution):
        row = len(solution.t) - 1
    (row,) = checked_rows(solution, rows=[row])
    if not solution.beams:
        raise ValueError("diagrams need beams, but the solution has none")
    choice = [quantities] if isinstance(quantities, str) else quantities
    names = list(choice) if isinstance(choice, Iterable) else []
    ok = len(names) > 0 and all(is_one_of(name, RESULTANTS) for name in names)
    require(ok, "quantities", quantities, f"some of {', '.join(RESULTANTS)}")
    require(is_flag(deformed), "deformed", deformed, "True or False")
    drawing = Drawing(solution, [row], 1.0 if deformed else 0.0, scene_unit)
    times = headings(solution, solution.t_level[[row]])
    words = words_over(
        drawing, title, [] if solution.stats.static and times[0][-2:] == " 1" else times
    )
    curves = _curves(drawing, row, names)
    layout = _layout(drawing, curves, bool(words))
    figure = Picture(tuple(layout.whole / 72), facecolor=colours.paper)
    labels = Labels(figure, colours)
    for corner, name in zip(layout.corners, names, strict=True):
        place = (*(corner / layout.whole), *(layout.panel / layout.whole))
        ax: Any = figure.add_axes(place)
        ax.set_axis_off()
        half = layout.point * layout.panel / 2
        left, low = layout.middle - half
        right, top = layout.middle + half
        ax.set(xlim=(left, right), ylim=(low, top))
        panel = _Panel(ax, colours, drawing, row, labels, layout.tallest)
        described = panel.draw(name, curves[name])
        if layout.is_wide:
            beside: Look = {"va": "center", "ha": "center", "fontsize": 8, "color": colours.ink}
            x, y = (corner + (_NAME / 2, layout.panel[1] / 2)) / layout.whole
            figure.text(x, y, described.replace(" $", "\n$"), **beside)
        else:
            ax.set_title(described, fontsize=9, pad=3, color=colours.ink)
    if words:
        look = {"fontsize": 9, "va": "top", "color": colours.soft}
        figure.suptitle(words, y=1 - 3 / layout.whole[1], **look)
    labels.write()
    return written(figure, path)


class _Layout(NamedTuple):
    """Places of panels in a figure, all in points."""

    is_wide: bool
    #: Size (2,) of the figure and of a panel, and lower left corners of the panels.
    whole: np.ndarray
    panel: np.ndarray
    corners: list[np.ndarray]
    #: Middle (2,) of the window, length of a point, and of the tallest ordinate in the drawing.
    middle: np.ndarray
    point: float
    tallest: float


class _Curve(NamedTuple):
    """Values along a beam, with both sides of jumps."""

    #: Arc lengths (n,), points (n, 2) of the axis, unit vectors (n, 2) to positive values.
    s: np.ndarray
    points: np.ndarray
    sides: np.ndarray
    values: np.ndarray


def _layout(drawing: Drawing, curves: dict[str, dict[str, _Curve]], has_title: bool) -> _Layout:
    """Panels in one row, or one below the other if the members are wide."""
    count, over = len(curves), _TITLE * has_title
    low, high = np.array([drawing.points.min(axis=0), drawing.points.max(axis=0)])
    low, high = np.minimum(low, drawing.corners[0]), np.maximum(high, drawing.corners[1])
    size = float(max(high - low)) or 1.0
    tallest = min(_TALLEST * size, _OVER * spacing(drawing))
    is_wide = (high - low)[1] < _WIDE * (high - low)[0]
    columns, name = (1, _NAME) if is_wide else (count, 0.0)
    rows, width, title = count // columns, 72 * _WIDTH / columns, _TITLE * (not is_wide)
    if is_wide:  # the ordinates have a height in points
        tallest = min(tallest, _ORDINATE * (high - low)[0] / (width - name - 2 * _ROOM))
    for some in curves.values():
        scale = tallest / (_largest(some) or 1.0)
        tips = np.concatenate(
            [c.points + scale * c.values[:, None] * c.sides for c in some.values()]
        )
        low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
    extent, space = high - low, (72 * _TALL - over) / rows - title
    point = max(extent / np.array([width - name - 2 * _ROOM, space - 2 * _ROOM]))
    panel = np.array([width, extent[1] / point + 2 * _ROOM])
    whole = np.array([columns * panel[0], rows * (panel[1] + title) + over])
    step = panel + (0.0, title)
    corners = [
        np.array([i % columns * step[0], whole[1] - over - (i // columns + 1) * step[1]])
        for i in range(count)
    ]
    middle = (low + high) / 2 - (name / 2 * point, 0.0)
    return _Layout(is_wide, whole, panel, corners, middle, point, tallest)


def _largest(curves: dict[str, _Curve]) -> float:
    """Largest size of all values."""
    return max(float(abs(curve.values).max()) for curve in curves.values())


def _curves(drawing: Drawing, row: int, names: list[str]) -> dict[str, dict[str, _Curve]]:
    """Values along each member by quantities: fine where they are written or jump inside."""
    beams = drawing.solution.beams
    fractions = np.linspace(0, 1, _PIECES + 1)
    values = along_all(drawing.solution, names, [row], fractions)
    points = drawing.along_elements(row, _PIECES)
    left = left_of(np.gradient(points, axis=1))
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    ends = np.cumsum([beam.elements for beam in beams.values()]).tolist()
    places = (load.target for load in drawing.parts(row).loads)
    jumping = {place.beam.name for place in places if isinstance(place, BeamPlace)} & {*beams}
    curves: dict[str, dict[str, _Curve]] = {}
    for name in names:
        known = curves.setdefault(name, {})
        for (beam_name, beam), end in zip(beams.items(), ends, strict=True):
            own = slice(end - beam.elements, end)
            s = arc_lengths(beam, fractions).ravel() if len(beams) <= _NAMED else np.empty(0)
            side = -left[own] if name == "M" else left[own]
            arrays = points[own], side, values[name][0, own]
            known[beam_name] = _Curve(s, *(a.reshape(-1, *a.shape[2:]) for a in arrays))
        fine = set(beams)
        if len(beams) > _NAMED:
            highest = max(known, key=lambda n: known[n].values.max())
            fine = {highest, min(known, key=lambda n: known[n].values.min())} | jumping
        for beam_name in fine:
            beam = beams[beam_name]
            curve = known[beam_name]._replace(s=arc_lengths(beam, fractions).ravel())
            known[beam_name] = _refined(drawing.solution, row, beam, curve, name)
    return curves


def _refined(solution: Solution, row: int, beam: Beam, curve: _Curve, name: str) -> _Curve:
    """Values at many places, and on both sides of each."""
    try:
        resultants = in_rows(solution.resultants(beam.name), [row])
    except ValueError:  # their balance is not known
        return curve
    balance, parts = resultants.balanced(), np.arange(_FINE) / _FINE
    places = balance.s[:-1, None] + np.diff(balance.s)[:, None] * parts
    s = np.unique(np.concatenate([places.ravel(), balance.s[-1:], balance.places]))
    both = [getattr(resultants.at(s, side), name)[0] for side in ("before", "after")]
    s, values = np.repeat(s, 2), np.stack(both, axis=1).ravel()
    points, sides = (interpolated(s, curve.s, x) for x in (curve.points, curve.sides))
    return _Curve(s, points, sides / np.linalg.norm(sides, axis=1, keepdims=True), values)


class _Panel:
    """A panel with one quantity along all members."""

    def __init__(
        self, ax, theme: Theme, drawing: Drawing, row: int, labels: Labels, tallest: float
    ):
        self._ax, self._theme, self._drawing, self._row = ax, theme, drawing, row
        self._labels, self._tallest = labels, tallest
        point = Pen(ax, theme).point
        self._thin = min(1.0, spacing(drawing) / point / _DENSE)

    def draw(self, name: str, curves: dict[str, _Curve]) -> str:
        """Draw a quantity; its words, with the unit of the numbers."""
        drawing, theme, row = self._drawing, self._theme, self._row
        parts = drawing.parts(row)
        supports = drawing.once(supports_of, parts)
        largest = _largest(curves)
        words = words_for(name, drawing.unit)
        factor, prefix = prefix_of(largest, _KILO)
        factor, words = (
            (factor, words.replace("[N", f"[{prefix}N")) if "[N" in words else (1.0, words)
        )
        scale = self._tallest / (largest or 1.0)
        self._draw_areas(curves, scale)
        symbols = _SYMBOLS * self._thin
        top, pale = Pen(self._ax, theme, symbols), Pen(self._ax, theme, symbols, 0.45)
        for curve in curves.values():
            tips = curve.points + scale * curve.values[:, None] * curve.sides
            outline = np.concatenate([curve.points[:1], tips, curve.points[-1:]])
            top.line(outline, mixed(theme.ink, theme.paper, 0.25), 0.9 * self._thin, 2)
            top.line(curve.points, theme.ink, 2.2 * self._thin, 3)
        draw_moving(pale, drawing, row)
        draw_between(top if name == "N" else pale, drawing, parts, row)
        marks = marks_of(drawing, parts)
        for kind in ("hinge", "slide"):
            if kind in marks:
                draw_pin(top, drawing.positions(marks[kind], row))
        for number, support in supports.items():
            draw_support(top, drawing.positions(number, row), support)
        if largest > 0:
            self._write(top, curves, scale, largest, factor, set(supports))
        if name == "N":
            self._write_pulls(parts, factor)
        pale.finish()
        top.finish()
        return words

    def _draw_areas(self, curves: dict[str, _Curve], scale: float) -> None:
        """Fill the areas between the axes and the values, those below zero with strokes."""
        theme = self._theme
        for sign, face, hatch in (1, theme.plus, None), (-1, theme.minus, "//////"):
            outlines, codes = [], []
            for curve in curves.values():
                part = np.maximum(sign * curve.values, 0.0)
                if part.any():
                    tips = curve.points + sign * scale * part[:, None] * curve.sides
                    outlines.append(np.concatenate([curve.points, tips[::-1], curve.points[:1]]))
                    lines = [Area.LINETO] * (len(outlines[-1]) - 2)
                    codes += [Area.MOVETO, *lines, Area.CLOSEPOLY]
            if outlines:
                # One path for all: hatches of each piece would be slow.
                look: Any = {"facecolor": face, "linewidth": 0, "zorder": 1, "alpha": 0.88}
                if hatch and self._thin == 1:
                    look |= {"hatch": hatch, "edgecolor": mixed(theme.minus, theme.ink, 0.35)}
                area = Area(np.concatenate(outlines), codes)
                # Not add_patch, which would look at each corner for the limits of the axes.
                patch = PathPatch(area, in_layout=False, **look)
                self._ax.add_artist(patch)

    # -- Numbers ----------------------------------------------------------------------------------

    def _write(
        self, pen: Pen, curves: dict[str, _Curve], scale: float, largest: float, factor: float,
        supports: set[int],
    ) -> None:  # fmt: skip
        """Write values beside their tips, the largest first."""
        picks = [
            (name, i) for name in curves for i in self._picks(name, curves[name], largest, supports)
        ]
        if len(curves) > _NAMED and picks:
            value_of = lambda pick: curves[pick[0]].values[pick[1]]  # noqa: E731
            picks = list(dict.fromkeys([max(picks, key=value_of), min(picks, key=value_of)]))
        known: list[tuple[str, float, np.ndarray]] = []
        for name, i in picks:
            curve = curves[name]
            value, foot = float(curve.values[i]), curve.points[i]
            # Members at a rigid corner have the same moment, and both sides of a support.
            if any(
                abs(abs(value) - abs(other)) < _SAME * largest
                and (member != name or value * other > 0)
                and np.hypot(*(place - foot)) < _CORNER * pen.point
                for member, other, place in known
            ):
                continue
            known.append((name, value, foot))
            outwards = np.sign(value) * curve.sides[i]
            tip = foot + scale * abs(value) * outwards
            pen.ring(tip, 1.8 * self._thin, self._theme.ink, width=0.0, z=4)
            self._labels.add(self._ax, _number(value / factor), tip, outwards)

    def _picks(self, name: str, curve: _Curve, largest: float, supports: set[int]) -> Iterable[int]:
        """Indices of the values of a member to write, the largest first."""
        beam, values = self._drawing.solution.beams[name], curve.values
        if np.ptp(values) < _ALIKE * largest:
            picks = {len(values) // 2}
        else:
            inner = [s for s, n in zip(beam.s, beam.nodes, strict=True) if n.number in supports]
            # A place has two values: each part has that on its own side.
            cuts = [int(np.searchsorted(curve.s, s, "right")) - 1 for s in inner]
            cuts = sorted({0, len(values), *(c for c in cuts if 1 < c < len(values) - 1)})
            picks = set()
            for first, end in itertools.pairwise(cuts):
                part = values[first:end]
                picks |= {first + int(part.argmax()), first + int(part.argmin())}
            picks |= {i for i in (0, len(values) - 1) if abs(values[i]) > _END * largest}
        return sorted(
            (i for i in picks if abs(values[i]) > _LEAST * largest), key=lambda i: -abs(values[i])
        )

    def _write_pulls(self, parts, factor: float) -> None:
        """Write the forces of ropes and springs between points beside them."""
        for force in parts.forces_between if len(parts.forces_between) <= _NAMED else ():
            pull = pull_of(self._drawing, force, self._row)
            if pull is None or len(force.points) < 2 or force.to_ground:
                continue
            line = line_between(self._drawing, force, self._row)
            place = (
                line[0] + 0.62 * (line[-1] - line[0]) if len(line) == 2 else line[len(line) // 2]
            )
            kind = "rope " if is_a_rope(force) else ""
            words = kind + _number(pull / factor) if pull else "slack"
            across = left_of(line[-1] - line[0])
            colour = self._theme.text(ROPE)
            way = across if across[1] < 0 else -across
            self._labels.add(self._ax, words, place, way, color=colour)


def _number(value: float) -> str:
    """A number with three digits and a true minus sign."""
    return three_digits(value).replace("-", "\u2212")
