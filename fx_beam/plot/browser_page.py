"""A motion as a page for a browser: one file, which needs no network."""

from __future__ import annotations

import base64
import html
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import real_array, require
from fx_beam.results.export import of_numpy, replacing, writable
from fx_beam.results.member_fields import RESULTANTS, along_all
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node, arc_lengths
from fx_beam.scene.forces_between import GroundSpring
from fx_beam.scene.parts import Parts
from fx_beam.scene.section import has_stresses

from . import symbols
from .drawing import Drawing, Outline, checked_drawing, line_between, time_unit, words_over
from .look import MEMBERS, THEMES

_TEMPLATE = Path(__file__).with_suffix(".html")
_ROWS = 200  # that are shown if none are named
_MANY = 6_000  # straight pieces of all elements, if an element has several
_SHADES = 64
_ENERGIES = "kinetic", "strain", "potential", "springs", "total"
_DEPTH = 0.016  # of the strip of an obstacle, by the size of the scene
_FINEST = 32_767  # positions and values are whole numbers up to this one


class Page:
    """A page for a browser; notebooks show it in their own.

    Attributes
    ----------
    text : str
        The page, in HTML.
    """

    def __init__(self, text: str):
        require(isinstance(text, str), "Page: text", text, "a page in HTML, see plot.interactive")
        self.text = text

    def __repr__(self):
        return f"<Page: {len(self.text) / 1e6:.1f} MB>"

    def _repr_html_(self):
        frame = 'style="width:100%;height:42rem;border:0"'
        return f'<iframe srcdoc="{html.escape(self.text)}" {frame}></iframe>'


def interactive(
    solution: Solution,
    path: Path | str | None = None,
    rows: Sequence[int] | None = None,
    trace: Node | Sequence[Node] = (),
    series: dict[str, np.ndarray] | None = None,
    scene_unit: str = "m",
    magnify: float = 1.0,
    title: str = "",
) -> Page:
    """Page that plays a motion, with its shapes, values and curves.

    The page has a slider and a play button, shapes coloured by a selected quantity, with limits and
    a log scale, names and values of the point under the pointer, paths of points that are clicked,
    and curves over time. The wheel zooms, dragging moves, and a double click shows the whole scene.
    The page has the light or dark theme of the browser. It is one file, which needs no network;
    2000 members with 200 rows take 10 MB.

    Parameters
    ----------
    solution : Solution
        The motion, or the equilibria.
    path : str or path, optional
        File to write; its name ends with .html. A notebook shows the returned page, also without a
        path.
    rows : sequence of int, optional
        Rows of `Solution.t` to show; by default at most 200, evenly spaced.
    trace : Node or sequence of Node, optional
        Nodes whose paths are drawn from the start.
    series : dict, optional
        Curves by name: n values each, one for each row of `Solution.t`; by default the energies.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    magnify : float
        Factor on displacements.
    title : str
        Text over the shapes, and in the title of the window.

    Returns
    -------
    Page
        The page; its `text` is the content of the file.

    Raises
    ------
    ValueError
        For rows, nodes or series that the solution does not have, or a path that cannot be written.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> rope = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], rope, elements=8)
    >>> scene.pin(beam.start)
    >>> solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    >>> page = fb.plot.interactive(solution, trace=beam.end)
    >>> "<canvas" in page.text
    True
    """
    path = None if path is None else writable(path, ("html", "htm"))
    drawing = checked_drawing(solution, magnify, scene_unit, _ROWS, rows)
    traced = trace if isinstance(trace, Sequence) else [trace]
    for node in traced:
        solution.position(node)  # refuses what is no node of the solution
    words = words_over(drawing, title)
    data = _data(drawing, traced) | {"title": words, "series": _series(drawing, series)}
    # No text of the user's may end the element that holds the data.
    text = json.dumps(data, allow_nan=False, default=of_numpy).replace("<", "\\u003c")
    page = Page(_TEMPLATE.read_text("utf-8").replace("/* DATA */", text))
    if path is not None:
        with replacing(path) as new:
            new.write_text(page.text, "utf-8")
    return page


def _data(drawing: Drawing, traced: Sequence[Node]) -> dict[str, object]:
    """All of a motion that the page draws, by the names in the page."""
    solution = drawing.solution
    factor, unit = time_unit(solution.t[-1])
    bodies = {name: [n.number for n in body.nodes] for name, body in solution.bodies.items()}
    return {
        "unit": drawing.unit,
        "members": MEMBERS,
        "themes": {
            name: theme._asdict() | {"scales": _scales(name)} for name, theme in THEMES.items()
        },
        "static": solution.stats.static,
        "t": solution.t[drawing.rows],
        "clock": [factor, _plain(unit)],
        "window": drawing.window,
        "thinness": drawing.thinness,
        "finest": _FINEST,
        **_members(drawing),
        "bodies": [
            {"name": name, "nodes": nodes, "points": _points_of(drawing, nodes)}
            for name, nodes in bodies.items()
        ],
        "stretches": [_stretch(drawing, *stretch) for stretch in drawing.stretches],
        "traces": [_points_of(drawing, [node.number]) for node in traced],
    }


def _stretch(drawing: Drawing, parts: Parts, places: list[int]) -> dict[str, object]:
    """What the scene has in some rows one after the other, and the places of these rows."""
    rows = [drawing.rows[i] for i in places]
    carried = [drawing.carried(parts, k) for k in rows]

    def points_of(nodes: list[int]) -> str:
        return _points(drawing, drawing.positions(nodes, rows))

    return {
        "first": places[0],
        "obstacles": [_carried(drawing, [outline]) for outline in drawing.fixed(parts)],
        "circles": [
            {"count": len(lines[0]), "points": _points(drawing, lines)}
            for lines in zip(*(drawing.circles(parts, k) for k in rows), strict=True)
        ],
        "carried": [_carried(drawing, outlines) for outlines in zip(*carried, strict=True)],
        "supports": [
            {"points": points_of([node]), **support._asdict()}
            for node, support in symbols.supports_of(drawing, parts).items()
        ],
        "markers": [
            {"marker": marker, "count": len(nodes), "points": points_of(nodes)}
            for marker, nodes in symbols.marks_of(drawing, parts).items()
        ],
        "between": [
            {
                "spring": force.on.spring is not None and not symbols.is_a_rope(force),
                "rope": symbols.is_a_rope(force),
                "count": len(line_between(drawing, force, rows[0])),
                "points": _points(drawing, line_between(drawing, force, rows)),
            }
            for force in parts.forces_between
            if not isinstance(force, GroundSpring)  # which are only in drawings
        ],
        "forces": [
            {"points": _points(drawing, [drawing.arrow(node, k) for k in rows])}
            for node in drawing.forces[rows[0]]
        ],
    }


def _members(drawing: Drawing) -> dict[str, object]:
    """Points of the axes of all beams in all rows, and values of their pieces."""
    solution = drawing.solution
    beams = solution.beams
    if not beams:
        return {"beams": [], "points": "", "nodes": "", "s": "", "quantities": []}
    degree = next(iter(beams.values())).degree
    elements, pieces = np.array([beam.elements for beam in beams.values()]), 1
    if degree > 1:  # a divisor of the lines that are drawn
        pieces = next((n for n in (12, 6, 4, 3, 2) if n * elements.sum() <= _MANY), 1)
    positions, nodes, s = [], [], []
    for name, beam in beams.items():
        points = drawing.axis(name, drawing.rows)
        positions.append(points[:, :: (points.shape[1] - 1) // (beam.elements * pieces)])
        numbers = np.full(beam.elements * pieces + 1, -1)
        numbers[::pieces] = solution.nodes_of_beam[name][::degree]
        nodes.append(numbers)
        s.append(np.append(arc_lengths(beam, np.arange(pieces) / pieces), beam.length))
    middles = (np.arange(pieces) + 0.5) / pieces
    fields = along_all(solution, _known(solution), drawing.rows, middles)
    return {
        "beams": [[name, beam.elements * pieces] for name, beam in beams.items()],
        "points": _points(drawing, np.concatenate(positions, axis=1)),
        "nodes": _text(np.concatenate(nodes).astype(np.int32)),
        "s": _text(np.concatenate(s).astype(np.float32)),
        "quantities": [_quantity(drawing, name, values) for name, values in fields.items()],
    }


def _known(solution: Solution) -> list[str]:
    """Quantities along the members that the solution has."""
    names = [*RESULTANTS]
    sections = [beam.section for beam in solution.beams.values()]
    if all(has_stresses(section) for section in sections):
        names.append("stress")
    if all(section is not None for section in sections):
        names.append("strain energy")
    if solution.has_rates and not solution.stats.static:
        names.append("speed")
    return names + sorted({*itertools.chain(*solution.variables_of_beam.values())})


def _scales(theme: str) -> list[list[str]]:
    """Colours of quantities without a sign, and with one."""
    scales = symbols.SEQUENTIAL[theme], symbols.SIGNED
    return [symbols.hexadecimal(scale, _SHADES) for scale in scales]


def _quantity(drawing: Drawing, name: str, values: np.ndarray) -> dict[str, object]:
    values = values.reshape(len(drawing.rows), -1)
    largest = float(abs(values).max()) or 1.0
    return {
        "name": symbols.WORDS.get(name, name).replace("$", ""),
        "unit": symbols.unit_of(name, drawing.unit),
        "largest": largest,
        "signed": symbols.is_signed(name),
        "values": _whole(values / largest, np.int16),
    }


def _carried(drawing: Drawing, outlines: Sequence[Outline]) -> dict[str, object]:
    """An obstacle by rows: points of the line, then others a little inside of the obstacle."""
    depth = _DEPTH * drawing.reach
    rows = [[*o.line, *(o.line + depth * o.sides)] for o in outlines]
    return {"count": 2 * len(outlines[0].line), "points": _points(drawing, rows)}


def _points_of(drawing: Drawing, nodes: list[int]) -> str:
    """Positions of some nodes in all rows."""
    return _points(drawing, drawing.positions(nodes, drawing.rows))


def _series(drawing: Drawing, series: dict[str, np.ndarray] | None) -> list[dict]:
    solution = drawing.solution
    if series is None:
        unit = " [J]" if drawing.unit == "m" else ""
        energies = {name: getattr(solution.energy, name) for name in _ENERGIES}
        shown_names = (name for name in _ENERGIES if name == "total" or energies[name].any())
        series = {f"{name} energy{unit}": energies[name] for name in shown_names}
    require(isinstance(series, dict), "series", series, "a dict of values by name")
    entries = []
    for name, curve in series.items():
        values = real_array(curve)
        expected = f"{len(solution.t)} finite numbers, one for each row of the solution"
        ok = values.shape == solution.t.shape and bool(np.isfinite(values).all())
        require(ok, f"series[{name!r}]", curve, expected)
        entries.append({"name": str(name), "values": values[drawing.rows]})
    return entries


def _plain(text: str) -> str:
    """A text without TeX."""
    return text.replace(r"$\mu$", "\u03bc")


def _points(drawing: Drawing, positions: ArrayLike) -> str:
    """Positions as whole numbers, as fractions of the window."""
    low, high = drawing.window
    return _whole((np.asarray(positions) - low) / (high - low), np.uint16)


def _whole(values: np.ndarray, kind: type) -> str:
    """Values up to 1 in size as whole numbers of two bytes, in base 64."""
    return _text(np.clip(np.rint(values * _FINEST), -_FINEST, 2 * _FINEST).astype(kind))


def _text(values: np.ndarray) -> str:
    little = values.astype(values.dtype.newbyteorder("<"))
    return base64.b64encode(np.ascontiguousarray(little).tobytes()).decode("ascii")
