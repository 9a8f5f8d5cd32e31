"""Deformed shapes: superposed, as an animation, and mode shapes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from fx_beam.analyses.modal import Modes
from fx_beam.deprecation import formerly
from fx_beam.results.files import replacing, writable
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node
from fx_beam.validation import as_float, is_name, is_whole, require

from .colouring import SEQUENTIAL, Colouring
from .frames import check_frames, write_frames
from .obstacles import obstacles_on_axes
from .symbols import Drawing, axis, draw_marks, draw_supports, draw_symbols

_BEAM_COLOURS = "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
_MANY = 1000  # members above which their tubes have six sides
_PICTURES = "png", "pdf", "svg", "jpg"


@formerly(length_unit="scene_unit")
def shapes(
    solution: Solution,
    steps: Sequence[int],
    path: Path | str | None = None,
    scene_unit: str = "m",
    magnify: float = 1.0,
    marks: dict[str, Node] | None = None,
    colour: str | None = None,
) -> Figure:
    """Picture of superposed deformed shapes, coloured by time or by the order of load steps.

    Discs are lumped masses, white rings are hinges, squares on dotted lines are slides, arrows are
    forces on nodes. A zigzag or a spiral is the spring of a joint, a cup its damper. Grey hatched
    lines and circles are obstacles.

    Parameters
    ----------
    solution : Solution
        The motion.
    steps : sequence of int
        Rows of `Solution.t` to draw.
    path : str or path, optional
        Picture to write; its ending gives the format.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    magnify : float
        Factor on displacements; the title shows it if it is not 1.
    marks : dict, optional
        Nodes by the names that are written beside them in the first shape.
    colour : str, optional
        "N", "Q", "M", "strain energy", "speed", or the name of an internal variable:
        quantity that the colours show instead of the time: axial force, shear force or bending
        moment, as in `Solution.resultants`, stored energy per length, or speed. Its unit is given
        if the unit of length is "m".

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    path = None if path is None else writable(path, _PICTURES)
    drawing = _drawing(solution, steps, magnify)
    low, high = drawing.window
    fig, ax = _plane(low, high, scene_unit, width=6.4)
    ax.set_title(_title(drawing), fontsize="medium")
    obstacles_on_axes(ax, drawing)
    bar = ax.inset_axes((1.03, 0, 0.03, 1))
    shades: Any
    if colour is None:
        shades = _by_time(fig, ax, bar, drawing)
    else:
        width = 2.2 * drawing.thinness
        colouring, shades = Colouring(drawing, colour, scene_unit), ["0.35"] * len(steps)
        for order, k in enumerate(steps):
            ax.add_collection(colouring.paint(colouring.lines(width, 2 + 1e-4 * order), k))
        fig.colorbar(colouring.scale, cax=bar, label=colouring.label, format="%.3g")
    for k, shade in zip(steps, shades, strict=True):
        draw_symbols(ax, drawing, k, shade, small=True)
    draw_supports(ax, drawing)
    draw_marks(ax, drawing, steps[0], {} if marks is None else marks)
    if path is not None:
        with replacing(path) as new:
            fig.savefig(new, dpi=200, bbox_inches="tight")
    return fig


@formerly(length_unit="scene_unit")
def animate(
    solution: Solution,
    steps: Sequence[int],
    path: Path | str,
    fps: int = 20,
    trace: Node | None = None,
    scene_unit: str = "m",
    magnify: float = 1.0,
    marks: dict[str, Node] | None = None,
    scenery: Callable[[Any, int], list] | None = None,
    colour: str | None = None,
) -> None:
    """Animation of the motion as a GIF or MP4, with the symbols of `shapes`.

    Parameters
    ----------
    solution : Solution
        The motion.
    steps : sequence of int
        Rows of `Solution.t`, one for each frame.
    path : str or path
        File to write; its name ends with .gif or .mp4.
    fps : int
        Frames per second [1/s].
    trace : Node, optional
        Node whose path is drawn.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    magnify : float
        Factor on displacements; the title shows it if it is not 1.
    marks : dict, optional
        Nodes by the names that are written beside them.
    scenery : callable, optional
        ``scenery(axes, k)`` draws additional objects in row k, such as a user-defined force. It
        returns the list of matplotlib artists, which are removed after the frame.
    colour : {"N", "Q", "M", "strain energy", "speed"} or internal variable, optional
        Quantity that the colours show, as in `shapes`; by default each member has its own colour.

    Raises
    ------
    RuntimeError
        For an MP4 if imageio-ffmpeg is not installed.
    """
    path = check_frames(path)
    require(is_whole(fps, 1, 1000), "fps", fps, "a whole number from 1 to 1000")
    fits = scenery is None or callable(scenery)
    require(fits, "scenery", scenery, "a function of axes and row")
    drawing = _drawing(solution, steps, magnify)
    low, high = drawing.window
    flat = high[0] - low[0] > 1.6 * (high[1] - low[1])
    fig, ax = _plane(low, high, scene_unit, width=7.0 if flat else 5.0)
    ax.set_title(_title(drawing), loc="right", fontsize="small")
    obstacles_on_axes(ax, drawing)
    clock = ax.set_title(" ", loc="left", family="monospace", fontsize="small")
    (past,) = ax.plot([], [], color="0.65", linewidth=1.0, zorder=1)
    members = _members(fig, ax, drawing, colour, scene_unit)
    moving = [clock, past, *(artist for artist, _ in members), *draw_supports(ax, drawing)]
    for artist in moving:
        artist.set_animated(True)  # left out of the static part of a frame
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    still = canvas.copy_from_bbox(fig.bbox)
    frames = []
    for k in steps:
        now = f"{solution.t[k]:.3f}"
        clock.set_text(f"load factor {now}" if solution.stats.static else f"t = {now} s")
        for artist, move in members:
            move(artist, k)
        if trace is not None:
            solution.position(trace)  # refuses what is no node of the solution
            past.set_data(*drawing.positions(trace.number, slice(steps[0], k + 1)).T)
        drawn = draw_symbols(ax, drawing, k) + draw_marks(
            ax, drawing, k, {} if marks is None else marks
        )
        drawn += scenery(ax, k) if scenery else []
        canvas.restore_region(still)
        for artist in sorted([*moving, *drawn], key=lambda artist: artist.get_zorder()):
            ax.draw_artist(artist)
        frames.append(np.array(canvas.buffer_rgba()))
        for artist in drawn:
            artist.remove()
    with replacing(path) as new:
        write_frames(frames, new, fps)


@formerly(found="modes")
def modes(modes: Modes, path: Path | str | None = None, count: int | None = None) -> Figure:
    """Picture of mode shapes, side by side, over the configuration to which they belong.

    Where the nodes of a mode do not move in phase, because of dampers, a dashed line is the shape a
    quarter of the period later.

    Parameters
    ----------
    modes : Modes
        Result of `fx_beam.modes`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    count : int, optional
        Number of modes to draw, from the lowest; all by default.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    path = None if path is None else writable(path, _PICTURES)
    require(isinstance(modes, Modes), "modes", modes, "what fx_beam.modes returned")
    count = len(modes) if count is None else count
    wanted = f"from 1 to {len(modes)}, the number of modes"
    require(is_whole(count, 1, len(modes)), "count", count, wanted)
    count = int(count)
    low, high = modes.positions.min(axis=0), modes.positions.max(axis=0)
    size = 0.15 * max(high - low)
    columns = min(count, 3)
    rows = -(-count // columns)
    width, height = high - low + 2.4 * size
    fig = Figure((2.6 * columns, (2.6 * height / width + 0.4) * rows), layout="constrained")
    panels = list(fig.subplots(rows, columns, squeeze=False).flat)
    for ax in panels:
        ax.axis("off")
    for mode, ax in zip(range(count), panels, strict=False):
        for name, nodes in modes.nodes_of_beam.items():
            rest, moved = modes.positions[nodes], modes.shape(name, mode, size)
            ax.plot(*axis(rest, modes.degree).T, color="0.7", linewidth=1.0)
            ax.plot(*axis(moved, modes.degree).T, color=_BEAM_COLOURS[0], linewidth=2.0)
            if abs(modes.shapes[mode].imag).max() > 0.01 * abs(modes.shapes[mode]).max():
                later = axis(modes.shape(name, mode, size, np.pi / 2), modes.degree)
                ax.plot(*later.T, color=_BEAM_COLOURS[0], linewidth=1.0, linestyle="--")
        for body in modes.bodies.values():
            rest = modes.positions[[node.number for node in body.nodes]]
            for (centre, *points), shade in (
                (rest, "0.7"),
                (modes.shape(body, mode, size), _BEAM_COLOURS[0]),
            ):
                for point in points:
                    ax.plot(*np.array([centre, point]).T, color=shade, linewidth=1.5)
        kind = "rigid" if modes.rigid[mode] else f"{abs(modes.frequencies[mode]):.4g} Hz"
        if modes.damping_ratios[mode]:
            kind += f", ratio {modes.damping_ratios[mode]:.3g}"
        if modes.unstable[mode]:
            kind = f"unstable, grows with {modes.eigenvalues[mode].real:.4g} 1/s"
        ax.set_title(f"mode {mode}: {kind}", fontsize="small")
        (left, bottom), (right, top) = low - 1.2 * size, high + 1.2 * size
        ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    if path is not None:
        with replacing(path) as new:
            fig.savefig(new, dpi=200)
    return fig


def _members(fig: Figure, ax, drawing: Drawing, colour: str | None, scene_unit: str) -> list:
    """Lines for the members, each with a function that moves it to its position in a row."""
    if colour is not None:
        colouring = Colouring(drawing, colour, scene_unit)
        words = colouring.label
        fig.colorbar(colouring.scale, ax=ax, fraction=0.05, label=words, format="%.3g")
        return [(ax.add_collection(colouring.lines(2.5 * drawing.thinness)), colouring.paint)]

    def mover(name: str):
        return lambda line, k: line.set_data(*drawing.axis(name, k).T)

    colours = itertools.cycle(_BEAM_COLOURS)
    return [
        (ax.plot([], [], color=shade, linewidth=2.5)[0], mover(name))
        for name, shade in zip(drawing.solution.beams, colours, strict=False)
    ]


def _drawing(solution: Solution, steps: Sequence[int], magnify: float) -> Drawing:
    Drawing(solution, steps, magnify).check()
    return Drawing(solution, steps, as_float(magnify))


def _title(drawing: Drawing) -> str:
    factor = drawing.magnify
    return drawing.title() + (f", displacements x {factor:g}" if factor != 1 else "")


def _by_time(fig: Figure, ax, cax, drawing: Drawing) -> np.ndarray:
    """Draw the members in the colours of their times, with a colour bar; returns the colours."""
    low, high = drawing.window
    colours, shades = _colours(drawing)
    # With a parallel projection matplotlib's axes fit the picture exactly.
    extent = (low[0], high[0], low[1], high[1])
    ax.imshow(_tubes(drawing, shades), extent=extent, interpolation="antialiased")
    bar, solution, steps = fig.colorbar(colours, cax=cax), drawing.solution, drawing.rows
    bar.set_label("load factor, in order" if solution.stats.static else "time $t$ [s]")
    if solution.stats.static:
        # On a path through limit points a load factor occurs more than once.
        shown = np.unique(np.linspace(0, len(steps) - 1, 12).round().astype(int)).tolist()
        bar.set_ticks(shown, labels=[f"{solution.t[steps[i]]:.3g}" for i in shown])
    return shades


def _colours(drawing: Drawing) -> tuple[ScalarMappable, np.ndarray]:
    """The colour scale, and the colour of each row: by time, or by order in statics."""
    values = drawing.solution.t[list(drawing.rows)]
    if drawing.solution.stats.static:
        values = np.arange(len(values))
    scale = ScalarMappable(Normalize(values.min(), values.max()), SEQUENTIAL)
    return scale, scale.to_rgba(values)


def _tubes(drawing: Drawing, shades: np.ndarray) -> np.ndarray:
    """Picture of the members in all rows, seen along z; later ones cover earlier ones."""
    low, high = drawing.window
    centre, size = (low + high) / 2, high - low
    window = [int(pixels) for pixels in 1600 * size / max(size)]
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
    plotter.view_xy()
    plotter.enable_parallel_projection()
    plotter.camera.focal_point = (*centre, 0.0)
    plotter.camera.position = (*centre, 10 * max(size))
    plotter.camera.parallel_scale = size[1] / 2
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    picture = plotter.screenshot(return_img=True)
    plotter.close()
    return picture


def _plane(low: np.ndarray, high: np.ndarray, scene_unit: str, width: float):
    """Figure with equal axes over a window of the plane."""
    require(is_name(scene_unit), "scene_unit", scene_unit, "a text")
    size = high - low
    # Labels and a colour bar need about a seventh of the width.
    fig = Figure((width, 0.86 * width * size[1] / size[0] + 0.5), layout="constrained")
    ax = fig.add_subplot()
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.set(xlabel=f"$x$ [{scene_unit}]", ylabel=f"$y$ [{scene_unit}]")
    return fig, ax
