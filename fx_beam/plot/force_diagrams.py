"""Diagrams of the axial force, the shear force and the bending moment along the members."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Area

from fx_beam.errors import is_flag, is_one_of, require
from fx_beam.results.fields import RESULTANTS, along_all, in_rows
from fx_beam.results.solution import Solution

from .drawing import Drawing, checked_rows, headings, spacing, three_digits
from .members import SIGNED, words_for
from .sheet import panels, picture, written
from .symbols import draw_lines, draw_surroundings, left_of

_TALLEST = 0.15  # of a diagram, as a fraction of the picture's size
_OVER = 1.5  # of a diagram, as a multiple of the distance between members
_BESIDE_TIP = 0.06  # of a number, as a fraction of the picture's size
_BORDER = np.array((0.35, 0.45))  # of a panel, for title and numbers [inch]
_DENSE = 10.0  # distance between members below which their lines are thinner [points]
_PIECES = 8  # of an element
_FINE = 64  # of an element in which an extreme value is sought
_NAMED = 12  # members up to which each has its extreme value written beside it
# Solutions and their rows.
_Cases = list[tuple[Solution, list[int]]]


def diagrams(
    solution: Solution | Sequence[Solution],
    path: Path | str | None = None,
    row: int | None = None,
    quantities: Sequence[str] = RESULTANTS,
    deformed: bool = True,
    scene_unit: str = "m",
) -> Figure:
    """Picture of the stress resultants along the members: a panel for N, Q and M each.

    A value is drawn normal to the axis: N and Q to the left of the beam's direction if they are
    positive, M on the side that is in tension. Positive areas are red, negative ones blue and
    hatched. The extreme value of each member is written beside it; in frames of more than 12
    members only the extreme values of the frame. Values follow from the balance of each element, as
    `BeamResultants.at` has them: at a clamp they are the reaction, at a free end zero.

    Of several solutions it is the envelope: largest and least values over all their rows, on the
    members as they start. Beside an extreme value is the number of the solution that gives it.

    Parameters
    ----------
    solution : Solution or sequence of Solution
        The motion, or the equilibria; or several load cases or motions of one scene.
    path : str or path, optional
        Picture to write; its ending gives the format.
    row : int, optional
        Row of `Solution.t`, by default the last. In a motion the values are means over the step
        that ends there, see `Solution.t_level`. Left out of an envelope.
    quantities : sequence of {"N", "Q", "M"}
        The panels, from left to right.
    deformed : bool
        Whether the diagrams stand on the deformed members, or on the members as they start.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ValueError
        For a row or quantities that the solution does not have, or one without beams.
    """
    path = picture(path)
    is_envelope = isinstance(solution, list | tuple)
    cases = _rows_of(solution, row)
    shown, (row, *_) = cases[0]
    if not shown.beams:
        raise ValueError("diagrams need beams, but the solution has none")
    choice = [quantities] if isinstance(quantities, str) else quantities
    names = list(choice) if isinstance(choice, Iterable) else []
    ok = len(names) > 0 and all(is_one_of(name, RESULTANTS) for name in names)
    require(ok, "quantities", quantities, f"some of {', '.join(RESULTANTS)}")
    require(is_flag(deformed), "deformed", deformed, "True or False")
    drawing = Drawing(shown, [row], float(deformed and not is_envelope), scene_unit)
    tallest = min(_TALLEST * drawing.size, _OVER * spacing(drawing))
    low, high = drawing.window
    margin = 1.3 * tallest + _BESIDE_TIP * drawing.size
    low, high = low - margin, high + margin
    fig, columns, panel = panels(len(names), high - low, _BORDER, share=True)
    gap = 72 * max(panel) * spacing(drawing) / max(high - low)  # members [points]
    thinness = min(1.0, gap / _DENSE)
    for number, (ax, name) in enumerate(zip(fig.axes, names, strict=True)):
        _panel(ax, drawing, name, cases, tallest, thinness)
        ax.set_title(words_for(name, scene_unit), fontsize="medium")
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        ax.locator_params(axis="x", nbins=max(2, int(panel[0] / 0.7)))
        lowest, first = number + columns >= len(names), number % columns == 0
        ax.tick_params(labelbottom=lowest, labelleft=first)
        ax.set_xlabel(f"$x$ [{scene_unit}]" if lowest else "")
        ax.set_ylabel(f"$y$ [{scene_unit}]" if first else "")
    (words,) = headings(shown, shown.t_level[[row]])
    if is_envelope:
        words = f"envelope of {len(cases)} solutions"
    fig.suptitle(words, fontsize="medium")
    return written(fig, path)


def _rows_of(solution: Any, row: int | None) -> _Cases:
    """A solution with its row, or several with all of theirs."""
    if isinstance(solution, list | tuple):
        ok = row is None and len(solution) > 0
        require(ok, "row", row, "left out: an envelope is over all rows of one or more solutions")
        return [(case, [*range(len(case.t))]) for case in solution if checked_rows(case)]
    if row is None and isinstance(solution, Solution):
        row = len(solution.t) - 1
    return [(solution, checked_rows(solution, rows=[row]))]


def _panel(
    ax, drawing: Drawing, quantity: str, cases: _Cases, tallest: float, thinness: float
) -> None:
    """Draw one quantity in one row, or its envelope in several, along all members."""
    beams = drawing.solution.beams
    places = np.linspace(0, 1, _PIECES + 1)
    parts = [along_all(case, [quantity], rows, places)[quantity] for case, rows in cases]
    alike = len({part.shape[1:] for part in parts}) == 1
    require(alike, "solution", cases, "solutions of scenes with equal members")
    origins = [(number, row) for number, (_, rows) in enumerate(cases) for row in rows]
    values, row = np.concatenate(parts), origins[0][1]
    high, low = values.max(axis=0), values.min(axis=0)
    largest = float(max(abs(high).max(), abs(low).max()))
    points = drawing.along_elements(row, _PIECES)
    side = left_of(np.gradient(points, axis=1)) * (-1 if quantity == "M" else 1)
    side *= tallest / (largest or 1.0) / np.linalg.norm(side, axis=-1, keepdims=True)
    for curve, sign, colour, hatch in (high, 1, SIGNED(0.9), None), (low, -1, SIGNED(0.1), "/////"):
        tips = points + side * np.where(sign * curve > 0, curve, 0)[..., None]
        corners = [points[:, :-1], points[:, 1:], tips[:, 1:], tips[:, :-1], points[:, :-1]]
        areas = np.stack(corners, axis=2).reshape(-1, 5, 2)
        # One path for all: hatches of each piece would be slow.
        codes = np.tile([Area.MOVETO, *3 * [Area.LINETO], Area.CLOSEPOLY], len(areas))
        pale = to_rgba(colour, 0.45)
        look = {"facecolor": pale, "edgecolor": pale if hatch else "none", "hatch": hatch}
        area = Area(areas.reshape(-1, 2), codes)
        # Not add_patch, which would look at each corner for the limits of the axes.
        ax.add_artist(PathPatch(area, linewidth=0, zorder=1, in_layout=False, **look))
    ends = np.concatenate([[0], np.cumsum([beam.elements for beam in beams.values()])]).tolist()
    members = list(map(slice, ends[:-1], ends[1:]))
    corners = [end for member in members for end in ((member.start, 0), (member.stop - 1, _PIECES))]
    for curve in [high, low][: len(values)]:
        tips = points + side * curve[..., None]
        edges = [np.stack([points[end], tips[end]]) for end in corners]
        draw_lines(ax, [*tips, *edges], color="0.3", linewidth=0.7 * thinness, zorder=2)
    axes = [points[member].reshape(-1, 2) for member in members]
    draw_lines(ax, axes, linewidth=1.5 * thinness, zorder=3)
    ways: list[Callable] = [np.argmax, np.argmin]
    if len(values) == 1:
        ways = [lambda part: abs(part).argmax()]
    # Numbers of a row, an element and a piece, by members.
    peaks = list[tuple[str, tuple[int, ...]]]()
    for name, member in zip(beams, members, strict=True):
        part = values[:, member]
        for way in ways:
            number, element, piece = map(int, np.unravel_index(way(part), part.shape))
            peaks.append((name, (number, member.start + element, piece)))
    if len(beams) > _NAMED:
        peaks = [pick(peaks, key=lambda peak: values[peak[1]]) for pick in (max, min)]
    firsts = dict(zip(beams, ends, strict=False))
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
    for name, peak in peaks:
        value, place = values[peak], peak[1:]
        if abs(value) > 1e-9 * largest:
            outwards = np.sign(value) * side[place] / np.linalg.norm(side[place])
            tip = points[place] + side[place] * value
            label_place = tip + _BESIDE_TIP / 2 * drawing.size * outwards
            centred = {"ha": "center", "va": "center", "fontsize": "small", "zorder": 7}
            (case, case_row), element = origins[peak[0]], place[0] - firsts[name]
            extreme = _extreme(cases[case][0], name, quantity, case_row, element, value)
            text = three_digits(extreme) + (f" ({case})" if len(cases) > 1 else "")
            ax.annotate(text, label_place, bbox=box, **centred)
    draw_surroundings(ax, drawing, row)


def _extreme(
    solution: Solution, name: str, quantity: str, row: int, element: int, drawn: float
) -> float:
    """Extreme value of a member, of the sign of one drawn in an element: there, or at a load."""
    try:
        resultants = in_rows(solution.resultants(name), [row])
    except ValueError:  # their balance is not known
        return drawn
    balance = resultants.balanced()
    fine = np.linspace(balance.s[element], balance.s[element + 1], _FINE + 1)
    places, sign = np.append(fine, balance.places), np.sign(drawn)
    sides = [resultants.at(places, side) for side in ("before", "after")]
    return float(sign * max((sign * getattr(side, quantity)).max() for side in sides))
