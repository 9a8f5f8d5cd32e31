"""Animations of a motion."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from fx_beam.deprecation import formerly
from fx_beam.results.files import replacing
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node
from fx_beam.validation import is_whole, require

from .colouring import Colouring
from .digits import clock, three_digits
from .drawing import Drawing, checked_drawing
from .frames import check_frames, write_frames
from .plane import Plane, draw_obstacles
from .supports import Supports
from .symbols import draw_forces, draw_joints, draw_marks, draw_moving

_COLOURS = "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"


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
    drawing = checked_drawing(solution, steps, magnify)
    if trace is not None:
        solution.position(trace)  # refuses what is no node of the solution
    plane = Plane(drawing, scene_unit, bar=colour is not None)
    ax = plane.ax
    look: dict[str, Any] = {"transform": ax.transAxes, "fontsize": "small"}
    ax.text(1, 1.02, drawing.title(), ha="right", **look)
    draw_obstacles(ax, drawing)
    heading = ax.text(0, 1.02, "", family="monospace", **look)
    (past,) = ax.plot([], [], color="0.65", linewidth=1.0, zorder=1)
    members = _members(plane, drawing, colour, scene_unit)
    moving = [heading, past, *(artist for artist, _ in members)]
    for artist in moving:
        artist.set_animated(True)  # left out of the static part of a frame
    canvas = FigureCanvasAgg(plane.figure)
    canvas.draw()
    still, supports = canvas.copy_from_bbox(plane.figure.bbox), Supports(drawing)
    headings = clock(solution.t[list(steps)].tolist())
    if solution.stats.static:
        headings = [f"load factor {three_digits(t)}" for t in solution.t[list(steps)]]
    frames = []
    for k, words in zip(steps, headings, strict=True):
        heading.set_text(words)
        for artist, move in members:
            move(artist, k)
        if trace is not None:
            past.set_data(*drawing.positions(trace.number, slice(steps[0], k + 1)).T)
        drawn = [*draw_moving(ax, drawing, k), *draw_joints(ax, drawing, k)]
        drawn += [*draw_forces(ax, drawing, k), *supports.draw(ax, k)]
        drawn += draw_marks(ax, drawing, k, {} if marks is None else marks)
        drawn += scenery(ax, k) if scenery else []
        canvas.restore_region(still)
        for artist in sorted([*moving, *drawn], key=lambda artist: artist.get_zorder()):
            ax.draw_artist(artist)
        frames.append(np.array(canvas.buffer_rgba()))
        for artist in drawn:
            artist.remove()
    with replacing(path) as new:
        write_frames(frames, new, fps)


def _members(plane: Plane, drawing: Drawing, colour: str | None, scene_unit: str) -> list:
    """Lines for the members, each with a function that moves it to its position in a row."""
    ax, width = plane.ax, 2.5 * drawing.thinness
    if colour is not None:
        colouring = Colouring(drawing, colour, scene_unit)
        plane.draw_bar(colouring.scale, colouring.label, format="%.3g")
        return [(ax.add_collection(colouring.lines(width)), colouring.paint)]

    def mover(name: str):
        return lambda line, k: line.set_data(*drawing.axis(name, k).T)

    return [
        (ax.plot([], [], color=shade, linewidth=width)[0], mover(name))
        for name, shade in zip(drawing.solution.beams, itertools.cycle(_COLOURS), strict=False)
    ]
