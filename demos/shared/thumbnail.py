"""Pictures for the gallery: the mechanism with earlier shapes, without axes and text."""

from types import SimpleNamespace

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from PIL import Image

from fx_beam.plot.drawing import Drawing, Plane
from fx_beam.plot.look import ACTS, MEMBERS, THEMES, Pen, mixed
from fx_beam.plot.symbols import draw_held, draw_members, draw_moving

#: Width and height [pixels].
PIXELS = 640, 360
_DPI, _COLOURS = 200, 96
_SHAPES = 6  # that are drawn, with the last one
_PALEST, _DARKEST = 0.88, 0.5  # shares of the paper in the first and the last earlier shape


def card(solution, rows, path, shade=None, magnify=1.0, tall=1.0, scale=1.3, also=None):
    """Write a PNG of some rows, of which six are drawn, the last one with its symbols.

    ``shade(k)`` is a number from 0 to 1 for the colour of each member in row k: then only the last
    row is drawn. Displacements are magnified, and heights are multiplied by `tall`. Members and
    symbols have a `scale`. ``also(k)`` gives matplotlib's patches to draw in the last row.
    """
    every, theme = list(dict.fromkeys(rows)), THEMES["light"]
    places = np.linspace(0, len(every) - 1, min(_SHAPES, len(every))).round().astype(int)
    shown = [every[i] for i in places][-1 if shade else 0 :]
    drawing = Drawing(_stretched(solution, tall), shown, magnify)
    size = np.array(PIXELS) / _DPI
    parts = drawing.parts(shown[-1])
    room = 24.0 if parts.fixed or parts.joints else 8.0  # for supports
    plane = Plane(drawing, theme, size=tuple(size), room=room, is_framed=False)
    plane.figure.set_dpi(_DPI)
    last = Pen(plane.ax, theme, scale * drawing.thinness)
    for i, k in enumerate(shown[:-1]):
        fade = _PALEST - (_PALEST - _DARKEST) * i / max(1, len(shown) - 2)
        pen = Pen(plane.ax, theme, scale * drawing.thinness, fade)
        draw_members(pen, drawing, k, ghost=True)
        draw_moving(pen, drawing, k, ghost=True)
        pen.finish()
    if shade is None:
        draw_members(last, drawing, shown[-1])
    else:
        _draw_shades(plane.ax, drawing, shown[-1], np.asarray(shade(shown[-1])))
    draw_moving(last, drawing, shown[-1])
    draw_held(last, drawing, parts, shown[-1])
    last.finish()
    for patch in also(shown[-1]) if also else ():
        plane.ax.add_patch(patch)
    plane.figure.savefig(path, dpi=_DPI)
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def _stretched(solution, tall):
    """A solution whose heights are multiplied."""
    if tall == 1:
        return solution
    names = ("beams", "bodies", "nodes_of_beam", "contacts", "parts", "line_forces")
    parts = {name: getattr(solution, name) for name in names}
    return SimpleNamespace(X=solution.X * (1, tall), q=solution.q * (1, tall, 1), **parts)


def _draw_shades(ax, drawing, k, shades):
    """Members from grey to orange, those with the strongest colours above."""
    theme = THEMES["light"]
    colours = [mixed(theme.soft, theme.paper, 0.55), *MEMBERS[:1], MEMBERS[3], MEMBERS[2], ACTS]
    ramp = LinearSegmentedColormap.from_list("from grey to orange", colours)
    order, lines = np.argsort(shades), [drawing.axis(name, k) for name in drawing.solution.beams]
    look = {"colors": ramp(shades[order]), "linewidths": 0.5 + 1.0 * shades[order]}
    ax.add_collection(LineCollection([lines[i] for i in order], capstyle="round", **look))
