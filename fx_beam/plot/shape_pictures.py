"""Pictures of shapes: deformed ones of some rows, superposed, and modes, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from fx_beam.errors import is_whole, require
from fx_beam.results.buckling_modes import BucklingModes
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import Modes, displaced
from fx_beam.scene.beam import Node

from . import symbols
from .backend import check_renderer
from .drawing import (
    Drawing,
    checked_drawing,
    headings,
    say_if_too_small,
    three_digits,
    time_unit,
    words_over,
)
from .labels import Labels
from .look import Pen, Theme, mixed, theme_of
from .members import SEQUENTIAL, DrawnMembers, colours_of, draw_members
from .sheet import Plane, panels, picture, written

_MANY = 1000  # members above which their tubes have six sides


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
    colour: str | None = None,
    colour_limits: tuple[float, float] | None = None,
    colour_scale: str = "linear",
    thickness: float | None = None,
    title: str = "",
    theme: str = "light",
) -> Figure:
    """Picture of superposed deformed shapes: the last one with its symbols, earlier ones pale.

    Members are as thick as they are, but no thinner than 3.4 points. Supports, joints, ropes and
    springs have the symbols of `scene`, where they are in the last of the rows in which the scene
    has them. Bodies and nodes with a contact radius have that size. Forces on nodes are arrows of
    their sums, but for forces that are an `Input`. In equilibria they are the forces at the time
    `t`, times the load factor; forces of the state at the `start` fade.

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
        Factor on displacements; it is written over the picture if it is not 1.
    marks : dict, optional
        Nodes by the names that are written beside them in the last shape; their paths are dashed.
    colour : str, optional
        "time": all shapes are alike, and their colours show the time, or the order of load
        steps.
        "N", "Q", "M", "stress", "strain energy", "speed", or the name of an internal variable:
        axial force, shear force or bending moment, as in `Solution.resultants`, the larger normal
        stress of both edges, as `BeamStress.largest`, stored energy per length, or speed. Its unit
        is given if the unit of length is "m".
    colour_limits : (float, float), optional
        Values at the ends of the colour scale; by default those that occur. On a log scale the
        smallest and the largest size.
    colour_scale : {"linear", "log"}
        Scale of the colours. "log" shows weak and strong values beside each other; N, Q and M keep
        their signs, with a linear part up to the smallest size.
    thickness : float, optional
        Factor on the depth of the members, which are then drawn with all changes of their depth,
        and also where they are thin: 1 is true. The depth is that with which a member touches
        others, twice the radius of its contact; else that of a rectangle, sqrt(12 EI / EA), or
        sqrt(12 rhoI / rhoA) without EA; a circle's diameter is 1.155 times that.
    title : str
        What is written over the picture, before the times that are shown.
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
    members = DrawnMembers(drawing, thickness, quantity, colour_limits, colour_scale)
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
    elif by_time:
        shades = [SEQUENTIAL(0.0)] if len(shown) == 1 else _colours_of_times(plane, drawing)
    if by_time and thickness is None:
        # With a parallel projection matplotlib's axes fit the picture exactly.
        limits = ax.get_xlim(), ax.get_ylim()
        ax.imshow(_tubes(limits, drawing, shades, colours), extent=np.ravel(limits), zorder=0.5)
    for order, (k, shade) in enumerate(zip(shown, shades, strict=True)):
        is_last = order == len(shown) - 1
        share = _PALEST - (_PALEST - _DARKEST) * order / max(1, len(shown) - 2)
        own = pen if is_last else Pen(ax, colours, drawing.thinness, share)
        if quantity is not None or (thickness is not None and by_time):
            look = {} if quantity else {"facecolor": shade}
            drawn = ax.add_collection(members.collection(own, 3 + 1e-4 * order, **look))
            members.move(drawn, k)
        elif thickness is not None:
            faces = [mixed(face, colours.paper, own.fade) for face in colours_of(drawing)]
            look = {"facecolor": members.per_piece(faces), "zorder": 2 + is_last}
            members.move(ax.add_collection(members.collection(own, **look)), k)
        elif not by_time:
            draw_members(own, drawing, k, ghost=not is_last)
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


def _colours_of_times(plane: Plane, drawing: Drawing) -> np.ndarray:
    """Colours of the rows by their times, with a colour bar."""
    solution, rows = drawing.solution, list(drawing.rows)
    values = solution.t[rows]
    factor, unit = time_unit(values.max())
    static = solution.stats.static
    # On a path through limit points a load factor occurs more than once: colours are by order.
    values = np.arange(len(rows)) if static else factor * values
    scale = ScalarMappable(Normalize(values.min(), values.max()), SEQUENTIAL)
    shades = scale.to_rgba(values)
    bar = plane.draw_bar(scale, label="load factor, in order" if static else f"time $t$ [{unit}]")
    if static:
        most = 12 if bar.orientation == "vertical" else 6  # numbers side by side need more room
        shown = np.unique(np.linspace(0, len(rows) - 1, most).round().astype(int)).tolist()
        bar.set_ticks(shown, labels=[three_digits(solution.t[rows[i]]) for i in shown])
    return shades


def _tubes(limits, drawing: Drawing, shades: np.ndarray, theme: Theme) -> np.ndarray:
    """Picture of the members in all rows, seen along z; later ones cover earlier ones."""
    import pyvista as pv  # which takes longer than a picture

    low, high = np.transpose(limits)
    size, centre = high - low, (low + high) / 2
    window = [int(pixels) for pixels in 1600 * size / max(size)]
    check_renderer()
    plotter: Any = pv.Plotter(off_screen=True, window_size=window)
    plotter.set_background(theme.paper)
    radius = 0.0025 * max(size) * drawing.thinness
    beams = drawing.solution.beams
    for order, (k, shade) in enumerate(zip(drawing.rows, shades, strict=True) if beams else ()):
        # Later shapes lie a little nearer to the eye, so that they cover earlier ones.
        axes = [drawing.axis(name, k) for name in beams]
        points = np.insert(np.concatenate(axes), 2, order * radius, axis=1)
        starts = np.cumsum([0, *map(len, axes)]).tolist()
        lines = [[b - a, *range(a, b)] for a, b in zip(starts[:-1], starts[1:], strict=True)]
        tubes = pv.PolyData(points, lines=np.concatenate(lines)).tube(
            radius=radius, n_sides=20 if len(axes) <= _MANY else 6
        )
        plotter.add_mesh(tubes, color=shade[:3], ambient=0.3, smooth_shading=True)
    plotter.camera_position = (*centre, 10 * max(size)), (*centre, 0.0), (0.0, 1.0, 0.0)
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = size[1] / 2
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return picture


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
    quarter of the period later. Supports are drawn where they are at rest.

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
        The picture, with a panel for each mode. Their titles count from 1: mode 1 is row 0 of
        `Modes`. They have its frequency or load factor.
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
    figure, axes, point = panels(count, high - low, colours, 18.0, title=32.0)
    for mode, ax in enumerate(axes):
        ax.set_title(f"mode {mode + 1}: {titles[mode]}", fontsize=8, pad=2)
        half = point * ax.get_window_extent().size * 72 / figure.dpi / 2
        left, bottom = (low + high) / 2 - half
        right, top = (low + high) / 2 + half
        ax.set(xlim=(left, right), ylim=(bottom, top))
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
    draw_members(rest, drawing, _AT_REST, ghost=True)
    draw_members(moved, drawing, _MOVED)
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
