"""Animations of a motion, and the files of their frames."""

from __future__ import annotations

import base64
import importlib.util
import io
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike
from PIL import Image

from fx_beam.errors import check_takes, is_whole, require
from fx_beam.results.export import replacing, writable
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node

from . import symbols
from .drawing import (
    LARGEST,
    Drawing,
    Plane,
    checked_drawing,
    headings,
    say_if_too_small,
    words_over,
)
from .look import Colour, Look, Pen, Theme, theme_of


def _write_mp4(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    """Frames (height, width, 4), `fps` per second, one after the other."""
    import imageio_ffmpeg

    first = next(frames)
    # H.264 needs even numbers of pixels.
    height, width = (size // 2 * 2 for size in first.shape[:2])
    look = {"fps": fps, "quality": 8, "macro_block_size": 2}
    film = imageio_ffmpeg.write_frames(str(path), (width, height), "rgba", **look)
    film.send(None)
    for frame in itertools.chain([first], frames):
        film.send(np.ascontiguousarray(frame[:height, :width]))
    film.close()


def _write_gif(
    frames: Iterator[np.ndarray], path: Path | io.BytesIO, fps: int, paper: Colour
) -> None:
    """Frames, each with a palette of its own, in which the background stays as it is."""
    images, background = [], 255 * np.array(to_rgb(paper))
    for frame in frames:
        image = Image.fromarray(frame).convert("RGB")
        image = image.quantize(method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        colours = np.array(image.getpalette()).reshape(-1, 3)
        colours[abs(colours - background).max(axis=1) <= 10] = background.round()
        image.putpalette(colours.ravel().tolist())
        images.append(image)
    first, *rest = images
    # The format knows hundredths of a second: rounded ends of frames keep the whole time.
    ends = 10 * np.round(100 / fps * np.arange(len(images) + 1)).astype(int)
    first.save(
        path, "GIF", save_all=True, append_images=rest, duration=np.diff(ends).tolist(), loop=0
    )


class Film(bytes):
    """An animation as a GIF; notebooks show it."""

    def __repr__(self):
        return f"<Film: {len(self) / 1e6:.1f} MB>"

    __str__ = __repr__

    def _repr_html_(self):
        return f'<img src="data:image/gif;base64,{base64.b64encode(self).decode()}">'


_BESIDE = 4.0  # width of the axes over which the time and the title are side by side [inch]


def animate(
    solution: Solution,
    path: Path | str | None = None,
    rows: Sequence[int] | None = None,
    times: Sequence[float] | None = None,
    count: int | None = None,
    fps: int = 20,
    trace: Node | None = None,
    scene_unit: str = "m",
    magnify: float = 1.0,
    marks: dict[str, Node] | None = None,
    scenery: Callable[[Axes, int], list] | None = None,
    colour: str | Mapping[str, ArrayLike] | None = None,
    colour_limits: tuple[float, float] | None = None,
    colour_scale: str = "linear",
    thickness: float | None = None,
    size: tuple[int, int] | None = None,
    title: str = "",
    theme: str = "light",
) -> Film | None:
    """Animation of the motion as a GIF or MP4, with the symbols of `shapes`.

    Parameters
    ----------
    solution : Solution
        The motion.
    path : str or path, optional
        File to write; its name ends with .gif or .mp4. Without a path the film is returned, and a
        notebook shows it.
    rows : sequence of int, optional
        Rows of `Solution.t` to draw, one for each frame.
    times : sequence of float, optional
        Times [s], or load factors, whose nearest rows are drawn.
    count : int, optional
        Number of rows, evenly spaced; 100 if neither rows nor times are given.
    fps : int
        Frames per second [1/s]; in a GIF at most 50.
    trace : Node, optional
        Node whose path is drawn.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.
    magnify : float
        Factor on displacements; a value other than 1 is written over the film.
    marks : dict, optional
        Nodes by the names that are written beside them.
    scenery : callable, optional
        ``scenery(axes, k)`` draws additional objects in row k, such as a user-defined force.
        Objects that it adds to the axes, or returns as a list, are removed after the frame.
    colour : str or dict, optional
        Quantity, internal variable or values of your own that the colours show, as in `shapes`; by
        default each member has its own colour.
    colour_limits, colour_scale, thickness : optional
        Ends and kind of the colour scale, and factor on the depth of members, as in `shapes`.
    size : (int, int), optional
        Width and height of the frames [pixels], from 100 to 4096, such as (1920, 1080); by default
        by the shape of the scene, at most 700 and 560.
    title : str
        Text over the film, on the right.
    theme : {"light", "dark"}
        Colours of the film.

    Returns
    -------
    Film or None
        Without a path the GIF, as bytes that a notebook shows; else None.

    Raises
    ------
    RuntimeError
        For an MP4 if imageio-ffmpeg is not installed.
    """
    path = None if path is None else writable(path, ("gif", "mp4"))
    colours, is_film = theme_of(theme), path is not None and path.suffix.lower() == ".mp4"
    if is_film and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise RuntimeError(
            f"cannot write {path}: an MP4 needs imageio-ffmpeg: pip install imageio-ffmpeg. A GIF "
            "needs nothing more"
        )
    most = 1000 if is_film else 50  # browsers slow down a GIF with shorter frames
    require(is_whole(fps, 1, most), "fps", fps, f"a whole number from 1 to {most}")
    if scenery is not None:
        check_takes(scenery, "axes, k", "scenery")
    drawing = checked_drawing(solution, magnify, scene_unit, 100, rows, times, count)
    shown, words = drawing.rows, words_over(drawing, title)
    members = symbols.DrawnMembers(drawing, theme, thickness, colour, colour_limits, colour_scale)
    framed_points = members.corners
    if trace is not None:
        solution.position(trace)  # refuses what is no node of the solution
        framed_points += [*drawing.positions(trace.number, slice(shown[0], max(shown) + 1))]
    drawing.include(framed_points)
    marks = symbols.checked_marks(drawing, marks)
    say_if_too_small(drawing)
    plane = _plane(drawing, colours, colour is not None, size)
    if colour is not None:
        plane.draw_bar(members.scale, **members.bar)
    thick = None if colour is None and thickness is None else members
    drawn = _frames(plane, drawing, thick, colours, words, marks, trace, scenery)
    if path is None:
        file = io.BytesIO()
        _write_gif(drawn, file, fps, colours.paper)
        return Film(file.getvalue())
    with replacing(path) as target:
        if is_film:
            _write_mp4(drawn, target, fps)
        else:
            _write_gif(drawn, target, fps, colours.paper)
    return None


def _frames(
    plane: Plane,
    drawing: Drawing,
    members: symbols.DrawnMembers | None,
    theme: Theme,
    words: str,
    marks: dict[str, Node],
    trace: Node | None,
    scenery: Callable[[Axes, int], list] | None,
) -> Iterator[np.ndarray]:
    """Pixels (height, width, 4) of each frame: what stays is drawn once, and all else for each."""
    ax, figure, shown = plane.ax, plane.figure, drawing.rows
    look: Look = {"xycoords": "axes fraction", "textcoords": "offset points"}
    look |= {"fontsize": "small", "va": "bottom", "color": theme.ink}
    if words:  # beside the time, or above it where there is no room
        rise = 4 if ax.bbox.width > _BESIDE * figure.dpi else 15
        ax.annotate(words, (1, 1), (0, rise), ha="right", **look)
    heading = ax.annotate("", (0, 1), (0, 4), family="monospace", **look)
    moving: list = [heading]
    if members is not None:
        lines = members.collection(Pen(ax, theme, drawing.thinness))
        if not members.has_colours:
            lines.set_color(members.per_piece(symbols.colours_of(drawing)).tolist())
        moving.append(ax.add_collection(lines))
    for artist in moving:
        artist.set_animated(True)  # left out of the static part of a frame
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    times = headings(drawing.solution, drawing.solution.t[shown])
    for k, time in zip(shown, times, strict=True):
        heading.set_text(time)
        known_artists = {*ax.get_children()}
        if members is not None:
            members.move(lines, k)
        _draw(ax, drawing, theme, k, marks, trace, members is None)
        scenery_artists = (scenery(ax, k) if scenery else None) or []
        new = [artist for artist in ax.get_children() if artist not in known_artists]
        drawn = list(dict.fromkeys([*new, *scenery_artists]))
        canvas.restore_region(still)
        for artist in sorted([*moving, *drawn], key=lambda artist: artist.get_zorder()):
            ax.draw_artist(artist)
        yield np.array(canvas.buffer_rgba())
        for artist in drawn:
            artist.remove()


def _draw(
    ax, drawing: Drawing, theme: Theme, k: int, marks: dict[str, Node], trace, is_plain: bool
) -> None:
    """Draw row k, plain members included, with names of nodes and the path of one."""
    pen = Pen(ax, theme, drawing.thinness)
    if is_plain:
        symbols.draw_members(pen, drawing, k)
    if trace is not None:
        path = drawing.positions(trace.number, slice(drawing.rows[0], k + 1))
        pen.line(path, theme.soft, 1.0, 1)
    symbols.draw_moving(pen, drawing, k)
    symbols.draw_held(pen, drawing, drawing.parts(k), k)
    symbols.draw_forces(pen, drawing, k)
    pen.finish()
    for name, node in marks.items():
        position = drawing.positions(node.number, k)
        # Towards the middle, where there is room for long names.
        left = position[0] > np.mean(ax.get_xlim())
        offset = {"xytext": (-5 if left else 5, 5), "ha": "right" if left else "left"}
        look: Look = {"textcoords": "offset points", "fontsize": "small", "zorder": 9}
        ax.annotate(name, position, color=theme.ink, **offset, **look)


def _plane(drawing: Drawing, theme: Theme, bar: bool, size: tuple[int, int] | None) -> Plane:
    """Axes of frames of a size [pixels], in which letters are as large as in other pictures."""
    if size is None:
        return Plane(drawing, theme, bar, title=" ")
    ok = isinstance(size, Sequence) and len(size) == 2
    ok = ok and all(is_whole(pixels, 100, 4096) for pixels in size)
    require(ok, "size", size, "width and height [pixels], such as (1920, 1080)")
    dpi = min(size[0] / LARGEST[0], size[1] / (0.75 * LARGEST[1]))
    # A little more, as a fraction of a pixel is cut off.
    inches = (size[0] + 0.01) / dpi, (size[1] + 0.01) / dpi
    plane = Plane(drawing, theme, bar, size=inches)
    plane.figure.set_dpi(dpi)
    return plane
