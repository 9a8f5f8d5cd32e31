"""Pictures of shapes: deformed ones of some rows, superposed, and modes, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyvista as pv
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
    Look,
    checked_drawing,
    headings,
    say_if_too_small,
    three_digits,
    time_unit,
    title,
)
from .members import SEQUENTIAL, Members
from .sheet import Plane, panels, picture, written

_MANY = 1000  # members above which their tubes have six sides


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
) -> Figure:
    """Picture of superposed deformed shapes, coloured by time or by the order of load steps.

    Bodies, lumped masses (discs) and forces on nodes (arrows of their sums) are drawn in all rows,
    but for forces that are an `Input`. In equilibria they are the forces at the time `t`, times the
    load factor; forces of the state at the `start` fade. Supports, joints and forces between
    points have the symbols of `scene`; they are drawn once, where they are in the last of the rows
    in which the scene has them.

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
        Factor on displacements; the title shows it if it is not 1.
    marks : dict, optional
        Nodes by the names that are written beside them in the first shape.
    colour : str, optional
        "N", "Q", "M", "stress", "strain energy", "speed", or the name of an internal variable:
        quantity that the colours show instead of the time: axial force, shear force or bending
        moment, as in `Solution.resultants`, the larger normal stress of both edges, as
        `BeamStress.largest`, stored energy per length, or speed. Its unit is given if the unit of
        length is "m".
    colour_limits : (float, float), optional
        Values at the ends of the colour scale; by default those that occur. On a log scale the
        smallest and the largest size.
    colour_scale : {"linear", "log"}
        Scale of the colours. "log" shows weak and strong values beside each other; N, Q and M keep
        their signs, with a linear part up to the smallest size.
    thickness : float, optional
        Factor on the depth of the members, which are then drawn as thick as they are: 1 is true.
        The depth is that with which a member touches others, twice the radius of its contact; else
        that of a rectangle, sqrt(12 EI / EA), or sqrt(12 rhoI / rhoA) without EA; a circle's
        diameter is 1.155 times that. By default members are lines.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    path = picture(path)
    drawing = checked_drawing(solution, magnify, scene_unit, 8, rows, times, count)
    shown = drawing.rows
    members = Members(drawing, thickness, colour, colour_limits, colour_scale)
    drawing.include(members.corners)
    single = headings(solution, solution.t[shown]) if len(shown) == 1 else []
    plane = Plane(drawing, bar=not single or colour is not None)
    say_if_too_small(drawing)
    ax = plane.ax
    ax.set_title(", ".join([title(drawing), *single]), fontsize="medium")
    shades: Any = ["0.35"] * len(shown)
    if colour is not None:
        plane.draw_bar(members.scale, **members.bar)
    elif single:
        shades = [SEQUENTIAL(0.0)]
    else:
        shades = _colours_of_times(plane, drawing)
    if colour is None and thickness is None:
        # With a parallel projection matplotlib's axes fit the picture exactly.
        extent = np.transpose(drawing.window).ravel()
        ax.imshow(_tubes(drawing, shades), extent=extent, interpolation="antialiased")
    else:
        for order, (k, shade) in enumerate(zip(shown, shades, strict=True)):
            look = {} if colour else {"facecolor": shade}
            members.move(ax.add_collection(members.collection(2.2, 2 + 1e-4 * order, **look)), k)
    for k, shade in zip(shown, shades, strict=True):
        symbols.draw_moving(ax, drawing, k, shade, small=True)
        symbols.draw_forces(ax, drawing, k, shade)
    symbols.draw_past(ax, drawing)
    symbols.draw_surroundings(ax, drawing, shown[-1])
    symbols.draw_marks(ax, drawing, shown[0], marks)
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


def _tubes(drawing: Drawing, shades: np.ndarray) -> np.ndarray:
    """Picture of the members in all rows, seen along z; later ones cover earlier ones."""
    (low, high), size = drawing.window, np.ptp(drawing.window, axis=0)
    centre = (low + high) / 2
    window = [int(pixels) for pixels in 1600 * size / max(size)]
    check_renderer()
    plotter: Any = pv.Plotter(off_screen=True, window_size=window)
    plotter.set_background("white")
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


_MODE = "#0072B2"
_SIZE = 0.15  # largest displacement, as a fraction of the scene's size
_BORDER = np.array((0.0, 0.3))  # of a panel, for its title [inch]
# Rows of a vibration.
_AT_REST, _MOVED, _LATER = range(3)


def modes(
    modes: Modes | BucklingModes, path: Path | str | None = None, count: int | None = None
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

    Returns
    -------
    matplotlib.figure.Figure
        The picture, with a panel for each mode. Their titles have its number, from 0 as in `Modes`,
        and its frequency or load factor.
    """
    path = picture(path)
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
    low, high = still.window
    low, high = low - size, high + size
    fig, _, _ = panels(count, high - low, _BORDER)
    for mode, ax in enumerate(fig.axes):
        ax.axis("off")
        ax.set_title(f"mode {mode}: {titles[mode]}", fontsize="small")
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        _draw(ax, Drawing(_vibration(modes, mode, size), [_AT_REST]), modes.shapes[mode])
    return written(fig, path)


def _vibration(modes: Modes, mode: int, size: float) -> SimpleNamespace:
    """A mode in the form of a solution with three rows: at rest, moved, a quarter period later."""
    q = np.zeros((3, len(modes.positions), 3))
    for row, phase in (_MOVED, 0.0), (_LATER, np.pi / 2):
        q[row, :, :2] = displaced(modes, mode, size, phase, slice(None)) - modes.positions
    members = {name: getattr(modes, name) for name in ("beams", "bodies", "nodes_of_beam")}
    parts = modes.parts._replace(contacts=())  # obstacles are not of a small motion
    return SimpleNamespace(X=modes.positions, q=q, contacts=(), parts=((0, parts),), **members)


def _draw(ax, drawing: Drawing, mode_rows: np.ndarray) -> None:
    looks: dict[int, Look] = {
        _AT_REST: {"color": "0.7", "linewidth": 1.0},
        _MOVED: {"color": _MODE},
    }
    if abs(mode_rows.imag).max() > 0.01 * abs(mode_rows).max():
        looks[_LATER] = {"color": _MODE, "linewidth": 1.0, "linestyle": "--"}
    for row, look in looks.items():
        lines = [drawing.axis(name, row) for name in drawing.solution.beams]
        symbols.draw_lines(ax, lines, **{"linewidth": 2.0 * drawing.thinness, "zorder": 2} | look)
        if row != _LATER:
            symbols.draw_bodies(ax, drawing, row, look["color"], small=True)
    parts = drawing.parts(_MOVED)
    symbols.draw_between(ax, drawing, parts, _MOVED)
    symbols.draw_hinges(ax, drawing, parts, _MOVED)
    symbols.Supports(drawing, parts).draw(ax, _AT_REST)


def _kind(modes: Modes, mode: int) -> str:
    """Frequency of a mode in words."""
    if modes.unstable[mode]:
        return f"unstable, grows with {three_digits(modes.eigenvalues[mode].real)} 1/s"
    if not modes.eigenvalues[mode] and not modes.rigid[mode]:
        return "of a critical point"
    ratio, frequency = modes.damping_ratios[mode], abs(modes.frequencies[mode])
    kind = "rigid" if modes.rigid[mode] else f"{three_digits(frequency)} Hz"
    return kind + (f",\nratio {three_digits(ratio)}" if ratio else "")
