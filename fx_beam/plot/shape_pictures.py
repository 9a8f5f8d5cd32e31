"""Pictures of shapes: deformed ones, modes, and diagrams of section forces."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Area
from numpy.typing import ArrayLike

from fx_beam.errors import is_flag, is_one_of, is_whole, require
from fx_beam.results.member_fields import RESULTANTS, along_all, in_rows
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import BucklingModes, Modes, displaced
from fx_beam.scene.beam import Beam, BeamPlace, Node, arc_lengths

from . import symbols
from .backend import check_renderer
from .drawing import (
    Drawing,
    Picture,
    Plane,
    checked_drawing,
    checked_rows,
    fitted_panels,
    headings,
    interpolated,
    line_between,
    panels,
    picture,
    prefix_of,
    say_if_too_small,
    spacing,
    three_digits,
    time_unit,
    words_over,
    written,
)
from .labels import Labels
from .look import ROPE, Look, Pen, Theme, left_of, mixed, theme_of

# -- Pictures of shapes: deformed ones of some rows, superposed, and modes, side by side --------


_MANY = 1000  # members above which their tubes have six sides
_JUMP = 1e-3  # part of a piece over which colours change to those of the next one


_ROWS = 8  # that are superposed if none are named
_PALEST, _DARKEST = 0.88, 0.46  # shares of the paper in the first and the last earlier row


def shapes(
    solution: Solution,
    path: Path | str | None = None,
    rows: Sequence[int] | None = None,
    times: Sequence[float] | None = None,
    count: int | None = None,
    scene_unit: str = "m",
    magnify: float = 1.0,
    marks: dict[str, Node] | None = None,
    colour: str | Mapping[str, ArrayLike] | None = None,
    colour_limits: tuple[float, float] | None = None,
    colour_scale: str = "linear",
    thickness: float | None = None,
    title: str = "",
    theme: str = "light",
) -> Figure:
    """Picture of superposed deformed shapes: the last one with its symbols, earlier ones pale.

    Members have their true thickness, but at least 3.4 points. Supports, joints, ropes and springs
    have the symbols of `scene`, at their positions in the last of the drawn rows in which they
    exist. Bodies and nodes with a contact radius have this radius. An arrow is the sum of the
    forces on a node, without forces that are an `Input`. In equilibria the forces are those at the
    time `t` times the load factor; residual forces of the state at `start` decrease to zero with
    the load factor.

    Parameters
    ----------
    solution : Solution
        The motion.
    path : str or path, optional
        Picture to write; its ending gives the format.
    rows : sequence of int, optional
        Rows of `Solution.t` to draw.
    times : sequence of float, optional
        Times [s], or load factors, whose nearest rows are drawn.
    count : int, optional
        Number of rows, evenly spaced; 8 if neither rows nor times are given.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    magnify : float
        Factor on displacements; a value other than 1 is written over the picture.
    marks : dict, optional
        Nodes by the names that are written beside them in the last shape; their paths are dashed.
    colour : str or dict, optional
        "time": the colour of a whole shape shows its time, or the number of its load step. "N",
        "Q", "M", "stress", "strain energy", "speed", or the name of an internal variable: axial
        force, shear force or bending moment, as in `Solution.resultants`; the larger normal stress
        of both edges, as `BeamStress.largest`; stored energy per length; speed. The unit is written
        if the unit of length is "m". A dict with one entry, a label and values of your own, as of
        `fenicsx.Problem.at_points`: (elements, m) for the one row that is shown, or (rows,
        elements, m) for all rows, with a value on each of m equal parts of an element. As with
        "time" members are tubes, drawn by VTK.
    colour_limits : (float, float), optional
        Values at the ends of the colour scale, on a log scale magnitudes; by default the extreme
        values.
    colour_scale : {"linear", "log"}
        Scale of the colours. "log" shows small and large values in one picture; N, Q and M keep
        their signs, and the scale is linear below the smallest magnitude.
    thickness : float, optional
        Factor on the depth of the members, 1 for the true depth. Members are then drawn with all
        changes of their depth, also where they are thin. The depth is twice the contact radius of a
        member; without contact that of a rectangle, sqrt(12 EI / EA), or sqrt(12 rhoI / rhoA)
        without EA. The diameter of a circular member is 1.155 times as large.
    title : str
        Text over the picture, before the times that are shown.
    theme : {"light", "dark"}
        Colours of the picture.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    path, colours = picture(path), theme_of(theme)
    drawing = checked_drawing(solution, magnify, scene_unit, _ROWS, rows, times, count)
    shown, by_time = drawing.rows, isinstance(colour, str) and colour == "time"
    quantity = None if by_time else colour
    members = symbols.DrawnMembers(drawing, theme, thickness, quantity, colour_limits, colour_scale)
    drawing.include(members.corners)
    marks = symbols.checked_marks(drawing, marks)
    ends = headings(solution, solution.t[[shown[-1], shown[0]]])
    first = ends[1].removeprefix("t = ").removeprefix("load factor ")
    heading = ends[0] if by_time or len(shown) < 2 else f"{ends[0]} (paler: from {first})"
    words = words_over(drawing, title, [] if by_time and len(shown) > 1 else [heading])
    bar = quantity is not None or (by_time and len(shown) > 1)
    plane = Plane(drawing, colours, bar, words)
    say_if_too_small(drawing)
    ax, last = plane.ax, shown[-1]
    pen = Pen(ax, colours, drawing.thinness)
    shades: Any = [None] * len(shown)
    if quantity is not None:
        plane.draw_bar(members.scale, **members.bar)
        shades = [members.scale.to_rgba(members.values[k]) for k in shown]
    elif by_time:
        ramp = symbols.SEQUENTIAL[theme]
        shades = [ramp(0.0)] if len(shown) == 1 else _colours_of_times(plane, drawing, ramp)
    has_tubes = thickness is None and (by_time or isinstance(colour, Mapping))
    if has_tubes:
        _draw_tubes(pen, drawing, members.pieces, shades)
    for order, (k, shade) in enumerate(zip(shown, shades, strict=True)):
        is_last = order == len(shown) - 1
        share = _PALEST - (_PALEST - _DARKEST) * order / max(1, len(shown) - 2)
        own = pen if is_last else Pen(ax, colours, drawing.thinness, share)
        if not has_tubes and (quantity is not None or thickness is not None):
            faces = [mixed(face, colours.paper, own.fade) for face in symbols.colours_of(drawing)]
            look = {"facecolor": members.per_piece(faces) if shade is None else shade}
            z = 2 + is_last if shade is None else 3 + 1e-4 * order
            drawn = members.collection(own, z, **look if quantity is None else {})
            members.move(ax.add_collection(drawn), k)
        elif not has_tubes:
            symbols.draw_members(own, drawing, k, ghost=not is_last)
        symbols.draw_moving(own, drawing, k, ghost=not is_last)
        symbols.draw_forces(own, drawing, k)
        if not is_last:
            own.finish()
    symbols.draw_past(pen, drawing)
    symbols.draw_held(pen, drawing, drawing.parts(last), last)
    labels = Labels(plane.figure, colours)
    for name, node in marks.items():
        if len(shown) > 1:
            path_rows = slice(min(shown), max(shown) + 1)
            pen.line(drawing.positions(node.number, path_rows), colours.soft, 1.0, 2.9, (3, 2))
        place = drawing.positions(node.number, last)
        pen.ring(place, 1.5, colours.ink, width=0.0, z=7)
        labels.add(ax, name, place, (1, 1))
    pen.finish()
    labels.write()
    return written(plane.figure, path)


def _colours_of_times(plane: Plane, drawing: Drawing, ramp: Colormap) -> np.ndarray:
    """Colours of the rows by their times, with a colour bar."""
    solution, rows = drawing.solution, list(drawing.rows)
    values = solution.t[rows]
    factor, unit = time_unit(values.max())
    static = solution.stats.static
    # On a path through limit points a load factor occurs more than once: colours are by order.
    values = np.arange(len(rows)) if static else factor * values
    scale = ScalarMappable(Normalize(values.min(), values.max()), ramp)
    shades = scale.to_rgba(values)
    bar = plane.draw_bar(scale, label="load factor, in order" if static else f"time $t$ [{unit}]")
    if static:
        most = 12 if bar.orientation == "vertical" else 6  # numbers side by side need more room
        shown = np.unique(np.linspace(0, len(rows) - 1, most).round().astype(int)).tolist()
        bar.set_ticks(shown, labels=[three_digits(solution.t[rows[i]]) for i in shown])
    return shades


def _draw_tubes(pen: Pen, drawing: Drawing, pieces: int, shades: Any) -> None:
    """Draw members in all rows as tubes, seen along z, with a colour for each piece of each row.

    Later rows cover earlier ones. Where a tube faces the eye it has the colour itself.
    """
    import pyvista as pv  # which takes longer than a picture

    ax, beams = pen.ax, drawing.solution.beams
    limits = ax.get_xlim(), ax.get_ylim()
    low, high = np.transpose(limits)
    size, centre = high - low, (low + high) / 2
    window = [int(pixels) for pixels in 1600 * size / max(size)]
    check_renderer()
    plotter: Any = pv.Plotter(off_screen=True, window_size=window, lighting="none")
    plotter.add_light(pv.Light(light_type="headlight"))
    plotter.set_background(pen.theme.paper)
    counts = [2 * pieces * beam.elements for beam in beams.values()]
    radii = np.repeat(symbols.widths_of(pen, drawing) * pen.point / 2, counts)
    ends = np.cumsum([0, *counts]).tolist()
    lines = [[b - a, *range(a, b)] for a, b in itertools.pairwise(ends)]
    for order, (k, colours) in enumerate(zip(drawing.rows, shades, strict=True) if beams else ()):
        along = drawing.along_elements(k, pieces)
        first, last = along[:, :-1], along[:, 1:]
        # A point at each end of a piece, between which a colour may jump.
        points = np.stack([first, last], axis=2) + _JUMP * np.stack([last - first, first - last], 2)
        # Later shapes lie a little nearer to the eye, so that they cover earlier ones.
        points = np.insert(points.reshape(-1, 2), 2, order * radii.max(), axis=1)
        tubes: Any = pv.PolyData(points, lines=np.concatenate(lines))
        faces = np.broadcast_to(np.asarray(colours)[..., :3], (len(points) // 2, 3))
        tubes["radius"], tubes["colour"] = radii, np.repeat(faces, 2, axis=0)
        sides = 20 if len(beams) <= _MANY else 6
        tubes = tubes.tube(scalars="radius", absolute=True, n_sides=sides)
        look: Look = {"ambient": 0.3, "diffuse": 0.7, "smooth_shading": True}
        plotter.add_mesh(tubes, scalars="colour", rgb=True, **look)
    plotter.camera_position = (*centre, 10 * max(size)), (*centre, 0.0), (0.0, 1.0, 0.0)
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = size[1] / 2
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    # With a parallel projection matplotlib's axes fit the picture exactly.
    ax.imshow(plotter.screenshot(return_img=True), extent=np.ravel(limits), zorder=0.5)
    plotter.close()


_SIZE = 0.15  # largest displacement, as a fraction of the scene's size
# Rows of a vibration.
_AT_REST, _MOVED, _LATER = range(3)


def modes(
    modes: Modes | BucklingModes,
    path: Path | str | None = None,
    count: int | None = None,
    theme: str = "light",
) -> Figure:
    """Picture of mode shapes, side by side, over the configuration to which they belong.

    Where the nodes of a mode do not move in phase, because of dampers, a dashed line is the shape a
    quarter of the period later. Supports are drawn in the configuration at rest.

    Parameters
    ----------
    modes : Modes or BucklingModes
        Result of `fx_beam.modes` or `fx_beam.buckling`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    count : int, optional
        Number of modes to draw, from the lowest; all by default.
    theme : {"light", "dark"}
        Colours of the picture.

    Returns
    -------
    matplotlib.figure.Figure
        The picture, with a panel for each mode. Its title has the frequency or load factor, and the
        number of the mode from 1: mode 1 is row 0 of `Modes`.
    """
    path, colours = picture(path), theme_of(theme)
    titles: list[str] = []
    if isinstance(modes, BucklingModes):
        titles = [f"load factor {three_digits(factor)}" for factor in modes.load_factors]
        modes = modes.modes
    expected = "what fx_beam.modes or fx_beam.buckling returned"
    require(isinstance(modes, Modes), "modes", modes, expected)
    titles = titles or [_kind(modes, mode) for mode in range(len(modes))]
    count = len(modes) if count is None else count
    expected = f"from 1 to {len(modes)}, the number of modes"
    require(is_whole(count, 1, len(modes)), "count", count, expected)
    count = int(count)
    still = Drawing(_vibration(modes, 0, 0.0), [_AT_REST])
    size = _SIZE * still.reach
    low, high = still.corners + np.array([[-size], [size]])
    columns, panel, point = fitted_panels(count, high - low, 18.0, 32.0)
    middle = (low + high) / 2
    figure, axes = panels(count, columns, panel, middle, point, colours, 32.0)
    for mode, ax in enumerate(axes):
        ax.set_title(f"mode {mode + 1}: {titles[mode]}", fontsize=8, pad=2)
        _draw(ax, colours, Drawing(_vibration(modes, mode, size), [_AT_REST]), modes.shapes[mode])
    return written(figure, path)


def _vibration(modes: Modes, mode: int, size: float) -> SimpleNamespace:
    """A mode in the form of a solution with three rows: at rest, moved, a quarter period later."""
    q = np.zeros((3, len(modes.positions), 3))
    for row, phase in (_MOVED, 0.0), (_LATER, np.pi / 2):
        q[row, :, :2] = displaced(modes, mode, size, phase, slice(None)) - modes.positions
    members = {name: getattr(modes, name) for name in ("beams", "bodies", "nodes_of_beam")}
    parts = modes.parts._replace(contacts=())  # obstacles are not of a small motion
    return SimpleNamespace(X=modes.positions, q=q, contacts=(), parts=((0, parts),), **members)


def _draw(ax, theme: Theme, drawing: Drawing, mode_rows: np.ndarray) -> None:
    scale = 0.75 * drawing.thinness
    rest, moved = (Pen(ax, theme, scale, fade) for fade in (0.8, 0.0))
    symbols.draw_members(rest, drawing, _AT_REST, ghost=True)
    symbols.draw_members(moved, drawing, _MOVED)
    if abs(mode_rows.imag).max() > 0.01 * abs(mode_rows).max():
        for name in drawing.solution.beams:
            moved.line(drawing.axis(name, _LATER), theme.soft, 1.0, 3.5, (4, 2))
    symbols.draw_moving(rest, drawing, _AT_REST, ghost=True)
    symbols.draw_moving(moved, drawing, _MOVED)
    parts = drawing.parts(_MOVED)
    symbols.draw_supports(moved, drawing, parts, _AT_REST)
    symbols.draw_joints(moved, drawing, parts, _MOVED)
    symbols.draw_between(moved, drawing, parts, _MOVED)
    rest.finish()
    moved.finish()


def _kind(modes: Modes, mode: int) -> str:
    """Frequency of a mode in words."""
    if modes.unstable[mode]:
        return f"unstable, grows with {three_digits(modes.eigenvalues[mode].real)} 1/s"
    if not modes.eigenvalues[mode] and not modes.rigid[mode]:
        return "of a critical point"
    ratio, frequency = modes.damping_ratios[mode], abs(modes.frequencies[mode])
    kind = "rigid" if modes.rigid[mode] else f"{three_digits(frequency)} Hz"
    return kind + (f",\nratio {three_digits(ratio)}" if ratio else "")


# -- Diagrams of the axial force, the shear force and the bending moment along the members ------


_WIDTH, _TALL = 7.0, 8.0  # of the picture, and the largest height [inch]
_WIDE = 0.35  # height by width of a drawing below which panels lie below each other
_TALLEST, _OVER = 0.17, 1.5  # of a diagram, by the size of the members and by their distance
_ORDINATE = 30.0  # height of diagrams that lie below each other [points]
_ROOM, _TITLE, _NAME = 24.0, 20.0, 72.0  # for numbers, a title above, a name beside [points]
_SYMBOLS = 0.8  # size of symbols
_DENSE = 10.0  # distance between members below which their lines are thinner [points]
_PIECES, _FINE = 8, 64  # of an element, and where values are written
_NAMED = 12  # members up to which each has its values written beside it
# Solutions with the rows that are drawn.
_Cases = list[tuple[Solution, list[int]]]
# Values by the largest that are not written; differences below which one is; ends that are.
_LEAST, _ALIKE, _END, _SAME, _CORNER = 0.03, 0.04, 0.15, 0.005, 12.0
_KILO = 1e3  # from which largest value on numbers have a prefix


def diagrams(
    solution: Solution | Sequence[Solution],
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
    line across the axis. The picture gives the largest and the smallest value of each member and of
    each part between supports, and values at member ends above 15 % of the largest value of all; in
    frames of more than 12 members only the extreme values of the frame. The panel of N has the
    forces of ropes and of springs between points; a slack rope is dashed. Values follow from the
    balance of each element, as those of `BeamResultants.at`: at a clamp they are the reaction, at a
    free end zero.

    For several solutions the picture is the envelope: the largest and least values over all their
    rows, drawn on the members at the start. Beside a value is the number of the solution that gives
    it.

    Parameters
    ----------
    solution : Solution or sequence of Solution
        The motion, or the equilibria; or several load cases or motions of one scene.
    path : str or path, optional
        Picture to write; its ending gives the format.
    row : int, optional
        Row of `Solution.t`, by default the last. In a motion the values are means over the step
        that ends with this row, see `Solution.t_level`. An envelope takes no row.
    quantities : sequence of {"N", "Q", "M"}
        The panels, from left to right, or one below the other if the scene is wide.
    deformed : bool
        Whether the diagrams are drawn on the deformed members, or on the members at the start.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    title : str
        Text over the picture, before the time or load factor.
    theme : {"light", "dark"}
        Colours of the picture.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ValueError
        For a row or quantities that the solution does not have, or a solution without beams.
    """
    path, colours = picture(path), theme_of(theme)
    is_envelope = isinstance(solution, list | tuple)
    cases = _cases_of(solution, row)
    shown, (row, *_) = cases[0]
    if not shown.beams:
        raise ValueError("diagrams need beams, but the solution has none")
    choice = [quantities] if isinstance(quantities, str) else quantities
    names = list(choice) if isinstance(choice, Iterable) else []
    ok = len(names) > 0 and all(is_one_of(name, RESULTANTS) for name in names)
    require(ok, "quantities", quantities, f"some of {', '.join(RESULTANTS)}")
    require(is_flag(deformed), "deformed", deformed, "True or False")
    drawing = Drawing(shown, [row], float(deformed and not is_envelope), scene_unit)
    times = headings(shown, shown.t_level[[row]])
    if is_envelope:
        times = [f"envelope of {len(cases)} solutions"]
    elif shown.stats.static and times[0][-2:] == " 1":
        times = []
    words = words_over(drawing, title, times)
    curves = _curves(drawing, cases, names, is_envelope)
    figure, axes, is_wide, tallest = _axes(drawing, curves, colours, bool(words))
    labels = Labels(figure, colours)
    for ax, name in zip(axes, names, strict=True):
        panel = _Panel(ax, colours, drawing, len(cases), labels, tallest)
        described = panel.draw(name, curves[name])
        if is_wide:
            beside: Look = {"va": "center", "ha": "center", "fontsize": 8, "color": colours.ink}
            place = ax.get_position()
            x, y = place.x0 + _NAME / 2 / 72 / _WIDTH, (place.y0 + place.y1) / 2
            figure.text(x, y, described.replace(" $", "\n$"), **beside)
        else:
            ax.set_title(described, fontsize=9, pad=3, color=colours.ink)
    if words:
        look = {"fontsize": 9, "va": "top", "color": colours.soft}
        figure.suptitle(words, y=1 - 3 / 72 / figure.get_figheight(), **look)
    labels.write()
    return written(figure, path)


def _cases_of(solution: Any, row: int | None) -> _Cases:
    """A solution with its row, or several with all of theirs."""
    if isinstance(solution, list | tuple):
        ok = row is None and len(solution) > 0
        require(ok, "row", row, "left out: an envelope is over all rows of one or more solutions")
        return [(case, [*range(len(case.t))]) for case in solution if checked_rows(case)]
    if row is None and isinstance(solution, Solution):
        row = len(solution.t) - 1
    return [(solution, checked_rows(solution, rows=[row]))]


class _Curves(NamedTuple):
    """Values along beams with as many elements each; a refined one has both sides of jumps."""

    beams: list[Beam]
    #: Arc lengths (n,) of a refined beam; points (beams, n, 2) of the axes, and unit vectors to
    #: positive values.
    s: np.ndarray
    points: np.ndarray
    sides: np.ndarray
    values: np.ndarray
    #: Number (beams, n) of the solution that gives each value.
    givers: np.ndarray

    def tips(self, scale: float) -> np.ndarray:
        """Ends (beams, n, 2) of ordinates."""
        return self.points + scale * self.values[..., None] * self.sides


# All members; of an envelope with the largest values, and with the least ones.
_Diagram = list[list[_Curves]]


def _axes(
    drawing: Drawing, curves: dict[str, _Diagram], theme: Theme, has_title: bool
) -> tuple[Picture, list[Any], bool, float]:
    """Panels in one row, or one below the other of wide members; length of the tallest ordinate."""
    count, over = len(curves), _TITLE * has_title
    low, high = np.array([drawing.points.min(axis=0), drawing.points.max(axis=0)])
    low, high = np.minimum(low, drawing.corners[0]), np.maximum(high, drawing.corners[1])
    tallest = min(_TALLEST * (float(max(high - low)) or 1.0), _OVER * spacing(drawing))
    is_wide = bool((high - low)[1] < _WIDE * (high - low)[0])
    columns, name, title = (1, _NAME, 0.0) if is_wide else (count, 0.0, _TITLE)
    width = 72 * _WIDTH / columns
    if is_wide:  # the ordinates have a height in points
        tallest = min(tallest, _ORDINATE * (high - low)[0] / (width - name - 2 * _ROOM))
    for some in curves.values():
        scale = tallest / (_largest(some) or 1.0)
        tips = np.concatenate([c.tips(scale).reshape(-1, 2) for part in some for c in part])
        low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
    extent, height = high - low, (72 * _TALL - over) / (count // columns) - title
    point = max(extent / np.array([width - name - 2 * _ROOM, height - 2 * _ROOM]))
    panel = np.array([width, extent[1] / point + 2 * _ROOM])
    middle = (low + high) / 2 - (name / 2 * point, 0.0)
    figure, axes = panels(count, columns, panel, middle, point, theme, title, over)
    return figure, axes, is_wide, tallest


def _largest(diagram: _Diagram) -> float:
    """Largest size of all values."""
    return max(float(abs(curves.values).max()) for part in diagram for curves in part)


def _curves(
    drawing: Drawing, cases: _Cases, names: list[str], is_envelope: bool
) -> dict[str, _Diagram]:
    """Values along each member by quantities: fine where they are written or jump inside."""
    beams, (row,) = [*drawing.solution.beams.values()], drawing.rows
    fractions = np.linspace(0, 1, _PIECES + 1)
    values = [along_all(case, names, rows, fractions) for case, rows in cases]
    alike = len({part[names[0]].shape[1:] for part in values}) == 1
    require(alike, "solution", cases, "solutions of scenes with equal members")
    numbers = np.repeat(np.arange(len(cases)), [len(rows) for _, rows in cases])
    points = drawing.along_elements(row, _PIECES)
    left = left_of(np.gradient(points, axis=1))
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    elements = np.array([beam.elements for beam in beams])
    owner, first = np.repeat(np.arange(len(beams)), elements), np.cumsum(elements) - elements
    places = (load.target for load in drawing.parts(row).loads)
    jumping = {place.beam.name for place in places if isinstance(place, BeamPlace)}
    picks = (np.argmax, np.argmin) if is_envelope else (np.argmax,)
    diagrams = dict[str, _Diagram]()
    for name, pick in itertools.product(names, picks):
        picked, givers = _picked([part[name] for part in values], numbers, pick)
        fine = np.full(len(beams), len(beams) <= _NAMED)
        fine[[owner[picked.max(axis=1).argmax()], owner[picked.min(axis=1).argmin()]]] = True
        fine |= [beam.name in jumping for beam in beams]
        groups = [np.array([i]) for i in np.flatnonzero(fine)]
        groups += [np.flatnonzero(~fine & (elements == n)) for n in np.unique(elements[~fine])]
        curves = list[_Curves]()
        for own in groups:
            cells = first[own][:, None] + np.arange(elements[own[0]])
            arrays = points, -left if name == "M" else left, picked, givers
            joined = (a[cells].reshape(len(own), -1, *a.shape[2:]) for a in arrays)
            part = _Curves([beams[i] for i in own], np.empty(0), *joined)
            is_fine = fine[own[0]]
            curves.append(_refined(cases, numbers, part, name, pick) if is_fine else part)
        diagrams.setdefault(name, []).append(curves)
    return diagrams


def _picked(
    parts: list[np.ndarray], numbers: np.ndarray, pick: Callable
) -> tuple[np.ndarray, np.ndarray]:
    """The value among all rows of all cases at each place, and the number of its case."""
    rows = np.concatenate(parts)
    chosen = pick(rows, axis=0)
    return np.take_along_axis(rows, chosen[None], axis=0)[0], numbers[chosen]


def _refined(
    cases: _Cases, numbers: np.ndarray, curve: _Curves, name: str, pick: Callable
) -> _Curves:
    """Values of a beam at many places, and on both sides of each."""
    (beam,) = curve.beams
    coarse = arc_lengths(beam, np.linspace(0, 1, _PIECES + 1)).ravel()
    try:
        resultants = [in_rows(case.resultants(beam.name), rows) for case, rows in cases]
    except ValueError:  # their balance is not known
        return curve._replace(s=coarse)
    balances, parts = [r.balanced() for r in resultants], np.arange(_FINE) / _FINE
    ends = balances[0].s
    places = ends[:-1, None] + np.diff(ends)[:, None] * parts
    jumps = [balance.places for balance in balances]
    s = np.unique(np.concatenate([places.ravel(), ends[-1:], *jumps]))
    both = [
        _picked([getattr(r.at(s, side), name) for r in resultants], numbers, pick)
        for side in ("before", "after")
    ]
    values, givers = (np.stack(sides, axis=1).ravel() for sides in zip(*both, strict=True))
    s = np.repeat(s, 2)
    points, sides = (interpolated(s, coarse, x[0]) for x in (curve.points, curve.sides))
    sides = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    return _Curves(curve.beams, s, points[None], sides[None], values[None], givers[None])


class _Panel:
    """A panel with one quantity along all members."""

    def __init__(
        self, ax, theme: Theme, drawing: Drawing, cases: int, labels: Labels, tallest: float
    ):
        self._ax, self._theme, self._drawing, self._cases = ax, theme, drawing, cases
        (self._row,) = drawing.rows
        self._labels, self._tallest = labels, tallest
        self._thin = min(1.0, spacing(drawing) / Pen(ax, theme).point / _DENSE)

    def draw(self, name: str, diagram: _Diagram) -> str:
        """Draw a quantity; its words, with the unit of the numbers."""
        drawing, theme, row = self._drawing, self._theme, self._row
        parts, largest = drawing.parts(row), _largest(diagram)
        words = symbols.words_for(name, drawing.unit)
        factor, prefix = prefix_of(largest, _KILO) if "[N" in words else (1.0, "")
        scale = self._tallest / (largest or 1.0)
        self._draw_areas(diagram, scale)
        size = _SYMBOLS * self._thin
        top, pale = Pen(self._ax, theme, size), Pen(self._ax, theme, size, 0.45)
        for curves in itertools.chain(*diagram):
            points, gap = curves.points, np.full((len(curves.points), 1, 2), np.nan)
            outlines = [points[:, :1], curves.tips(scale), points[:, -1:], gap]
            line = np.concatenate(outlines, axis=1).reshape(-1, 2)
            top.line(line, mixed(theme.ink, theme.paper, 0.25), 0.9 * self._thin, 2)
            line = np.concatenate([points, gap], axis=1).reshape(-1, 2)
            top.line(line, theme.ink, 2.2 * self._thin, 3)
        symbols.draw_moving(pale, drawing, row)
        shows_pulls = name == "N" and len(diagram) == 1
        symbols.draw_between(top if shows_pulls else pale, drawing, parts, row)
        marks = symbols.marks_of(drawing, parts)
        for kind in ("hinge", "slide"):
            if kind in marks:
                symbols.draw_pin(top, drawing.positions(marks[kind], row))
        symbols.draw_supports(top, drawing, parts, row)
        if largest > 0:
            self._write(top, diagram, scale, largest, factor)
        if shows_pulls:
            self._write_pulls(parts, factor)
        pale.finish()
        top.finish()
        return words.replace("[N", f"[{prefix}N")

    def _draw_areas(self, diagram: _Diagram, scale: float) -> None:
        """Fill the areas between the axes and the values, those below zero with strokes."""
        theme = self._theme
        looks = (1, theme.plus, None), (-1, theme.minus, "//////")
        for some, (sign, face, hatch) in zip((diagram[0], diagram[-1]), looks, strict=True):
            outlines, codes = [np.empty((0, 2))], [np.empty(0, Area.code_type)]
            for curves in some:
                parts = curves._replace(values=sign * np.maximum(sign * curves.values, 0.0))
                corners = [curves.points, parts.tips(scale)[:, ::-1], curves.points[:, :1]]
                areas = np.concatenate(corners, axis=1)[parts.values.any(axis=1)]
                kinds = np.full(areas.shape[:2], Area.LINETO, Area.code_type)
                kinds[:, 0], kinds[:, -1] = Area.MOVETO, Area.CLOSEPOLY
                outlines.append(areas.reshape(-1, 2))
                codes.append(kinds.ravel())
            # One path for all: hatches of each piece would be slow.
            look: Any = {"facecolor": face, "linewidth": 0, "zorder": 1, "alpha": 0.88}
            if hatch and self._thin == 1:
                look |= {"hatch": hatch, "edgecolor": mixed(theme.minus, theme.ink, 0.35)}
            area = Area(np.concatenate(outlines), np.concatenate(codes))
            # Not add_patch, which would look at each corner for the limits of the axes.
            self._ax.add_artist(PathPatch(area, in_layout=False, **look))

    # -- Numbers ----------------------------------------------------------------------------------

    def _write(
        self, pen: Pen, diagram: _Diagram, scale: float, largest: float, factor: float
    ) -> None:
        """Write values beside their tips, the largest first."""
        refined = [curve for part in diagram for curve in part if len(curve.s)]
        picks = [(curve, i) for curve in refined for i in self._picks(curve, largest)]
        if len(self._drawing.solution.beams) > _NAMED and picks:
            value_of = lambda pick: pick[0].values[0, pick[1]]  # noqa: E731
            highest, lowest = max(picks, key=value_of), min(picks, key=value_of)
            picks = [highest] if highest is lowest else [highest, lowest]
        known: list[tuple[list[Beam], float, np.ndarray]] = []
        for curve, i in picks:
            value, foot = float(curve.values[0, i]), curve.points[0, i]
            # Members at a rigid corner have the same moment, and both sides of a support.
            if any(
                abs(abs(value) - abs(other)) < _SAME * largest
                and (beams != curve.beams or value * other > 0)
                and np.hypot(*(place - foot)) < _CORNER * pen.point
                for beams, other, place in known
            ):
                continue
            known.append((curve.beams, value, foot))
            outwards = np.sign(value) * curve.sides[0, i]
            tip = foot + scale * abs(value) * outwards
            pen.ring(tip, 1.8 * self._thin, self._theme.ink, width=0.0, z=4)
            giver = f" ({curve.givers[0, i]})" if self._cases > 1 else ""
            self._labels.add(self._ax, _number(value / factor) + giver, tip, outwards)

    def _picks(self, curve: _Curves, largest: float) -> list[int]:
        """Indices of the values of a member to write, the largest first."""
        (beam,), (values,) = curve.beams, curve.values
        if np.ptp(values) < _ALIKE * largest:
            middle, peak = len(values) // 2, int(abs(values).argmax())
            picks = {middle if abs(values[peak] - values[middle]) < _SAME * largest else peak}
        else:
            supports = self._drawing.once(symbols.supports_of, self._drawing.parts(self._row))
            inner = [s for s, n in zip(beam.s, beam.nodes, strict=True) if n.number in supports]
            # A place has two values: each part has that on its own side.
            cuts = [int(np.searchsorted(curve.s, s, "right")) - 1 for s in inner]
            cuts = sorted({0, len(values), *(c for c in cuts if 1 < c < len(values) - 1)})
            picks = set()
            for first, end in itertools.pairwise(cuts):
                part = values[first:end]
                picks |= {first + int(part.argmax()), first + int(part.argmin())}
            picks |= {i for i in (0, len(values) - 1) if abs(values[i]) > _END * largest}
        picks = {i for i in picks if abs(values[i]) > _LEAST * largest}
        return sorted(picks, key=lambda i: -abs(values[i]))

    def _write_pulls(self, parts, factor: float) -> None:
        """Write the forces of ropes and springs between points beside them."""
        for force in parts.forces_between if len(parts.forces_between) <= _NAMED else ():
            pull = symbols.pull_of(self._drawing, force, self._row)
            if pull is None or len(force.points) < 2 or force.to_ground:
                continue
            line = line_between(self._drawing, force, self._row)
            place = (
                line[0] + 0.62 * (line[-1] - line[0]) if len(line) == 2 else line[len(line) // 2]
            )
            kind = "rope " if symbols.is_a_rope(force) else ""
            words = kind + _number(pull / factor) if pull else "slack"
            across = left_of(line[-1] - line[0])
            colour = self._theme.text(ROPE)
            way = across if across[1] < 0 else -across
            self._labels.add(self._ax, words, place, way, color=colour)


def _number(value: float) -> str:
    """A number with three digits and a true minus sign."""
    return three_digits(value).replace("-", "\u2212")
