"""Square pictures for the gallery: the mechanism in motion, without axes and text."""

import io
import itertools

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from fx_beam import plot

COLOURS = "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
PIXELS = 240
#: Most frames of a GIF.
FRAMES = 50


def animate(
    solution,
    rows,
    path,
    moving=None,
    fixed=None,
    shade=None,
    magnify=1.0,
    tall=1.0,
    width=3.0,
    bodies=(),
):
    """Write a GIF of some rows, thinned to `FRAMES`, with functions for objects beside the members.

    ``fixed(axes)`` draws what stands still, ``moving(k)`` gives matplotlib's patches in row k, and
    ``shade(k)`` a number from 0 to 1 for the colour of each member. Displacements are magnified,
    and heights are multiplied by `tall`. Bodies are lists of points, between which lines are drawn.
    """
    rows, beams = list(rows), list(solution.beams.values())
    rows = rows[:: -(-len(rows) // FRAMES)]
    shapes = [(1.0, tall) * _magnified(solution, beam, rows, magnify) for beam in beams]
    for points in bodies:
        shapes.append(np.stack([solution.position(point)[rows] for point in points], axis=1))
    figure = Figure(figsize=(PIXELS / 100, PIXELS / 100), dpi=100)
    canvas, ax = FigureCanvasAgg(figure), figure.add_axes((0, 0, 1, 1))
    ax.set_axis_off()
    low, high = (f([f(s, axis=(0, 1)) for s in shapes], axis=0) for f in (np.min, np.max))
    half = 0.56 * (high - low).max()
    for limits, middle in zip((ax.set_xlim, ax.set_ylim), (low + high) / 2, strict=True):
        limits(middle - half, middle + half)
    if fixed is not None:
        fixed(ax)
    colours = list(itertools.islice(itertools.cycle(COLOURS), len(shapes)))
    look = {"linewidths": width, "capstyle": "round", "zorder": 3}
    look |= {"colors": colours} if shade is None else {"cmap": "magma_r", "clim": (-0.15, 1)}
    lines = ax.add_collection(LineCollection([], **look))
    frames = []
    for number, row in enumerate(rows):
        lines.set_segments([shape[number] for shape in shapes])
        if shade is not None:
            lines.set_array(shade(row))
        patches = [] if moving is None else [ax.add_patch(patch) for patch in moving(row)]
        canvas.draw()
        frames.append(Image.fromarray(np.array(canvas.buffer_rgba())).convert("RGB"))
        for patch in patches:
            patch.remove()
    palette = frames[len(frames) // 2].quantize(32)
    pale = np.array(palette.getpalette()).reshape(-1, 3)
    pale[pale.min(axis=1) > 245] = 255  # the background stays white
    palette.putpalette(pale.ravel().tolist())
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    file = io.BytesIO()
    first.save(file, "GIF", save_all=True, append_images=others, duration=50, loop=0)
    path.write_bytes(file.getvalue())


def _magnified(solution, beam, rows, factor):
    """Positions (rows, points, 2) along a beam, with displacements times a factor."""
    shape = solution.shape(beam)
    return plot.axis(shape[:1] + factor * (shape[rows] - shape[:1]), beam.degree)


def disc(centre, radius):
    """A body, an obstacle or a mass."""
    return Circle(centre, radius, facecolor="0.85", edgecolor="0.3", linewidth=1.5)
