"""The look of pictures: colours of light and dark ones, and a pen whose symbols are in points."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from scipy.spatial import ConvexHull

from fx_beam.errors import is_one_of, require

#: Keyword arguments of matplotlib; a colour as it takes it.
Look = dict[str, Any]
Colour = str | tuple[float, float, float]

#: Colours of members one after the other; of what acts or is free; of ropes. At least 3 : 1 on both
#: papers, and apart from each other for all kinds of colour-blind eyes.
MEMBERS = "#2a66d8", "#0fa069", "#9c4f7c", "#8d7ac6"
ACTS, ROPE = "#d37520", "#8a7a55"


class Theme(NamedTuple):
    """Colours that differ between light and dark pictures."""

    #: Background; outlines and values; axes, dimensions and paths; ground, bodies and supports.
    paper: str
    ink: str
    soft: str
    ground: str
    #: Areas of positive and of negative values.
    plus: str
    minus: str

    def dress(self, ax) -> None:
        """Give axes the colours."""
        ax.set_facecolor("none")
        ax.tick_params(colors=self.soft, which="both", labelsize=8)
        for spine in ax.spines.values():
            spine.set_color(mixed(self.soft, self.paper, 0.5))
        for text in (ax.xaxis.label, ax.yaxis.label, ax.xaxis.offsetText, ax.yaxis.offsetText):
            text.set_color(self.soft)
        ax.title.set_color(self.ink)

    def text(self, colour: Colour) -> Colour:
        """A colour in which words can be read."""
        return mixed(colour, self.ink, 0.35)


THEMES = {
    "light": Theme("#ffffff", "#1c2127", "#6b7480", "#dfe3e7", "#f6cfae", "#c7ddf2"),
    "dark": Theme("#14181e", "#e8ebee", "#97a1ac", "#39424c", "#7a4418", "#1f4a70"),
}


def theme_of(name: str) -> Theme:
    """A theme by its name."""
    require(is_one_of(name, THEMES), "theme", name, "'light' or 'dark'")
    return THEMES[name]


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """A colour with a share of another one."""
    pairs = zip(to_rgb(colour), to_rgb(other), strict=True)
    red, green, blue = ((1 - share) * a + share * b for a, b in pairs)
    return red, green, blue


def left_of(direction: np.ndarray) -> np.ndarray:
    """Directions (..., 2) turned by 90 degrees to the left."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)


def unit(way) -> np.ndarray:
    """A vector (2,) of length 1 in a direction; along x if it has no length."""
    way = np.asarray(way, dtype=float)
    size = np.hypot(*way)
    return way / size if size > 0 else np.array([1.0, 0.0])


_HEAD = np.array([(0, 0), (-1.0, 0.38), (-0.8, 0), (-1.0, -0.38)])  # of an arrow of length 1
_GAP = np.full((1, 2), np.nan)


class Pen:
    """Draws lines, areas and symbols on axes, those of one look together.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Axes with their limits.
    theme : Theme
        The colours.
    scale : float
        Factor on the sizes of symbols.
    fade : float
        Share of the paper in all colours.
    """

    def __init__(self, ax: Any, theme: Theme, scale: float = 1.0, fade: float = 0.0):
        self.ax, self.theme, self.scale, self.fade = ax, theme, scale, fade
        width = ax.get_window_extent().width * 72 / ax.figure.dpi
        #: Length of a point in the drawing, and of a point of symbols.
        self.point = float(np.ptp(ax.get_xlim())) / width
        self.unit = scale * self.point
        #: Points of lines, areas and rings by their looks.
        self.lines = defaultdict[tuple, list](list)
        self.areas = defaultdict[tuple, list](list)
        self.rings = defaultdict[tuple, list](list)

    def _shade(self, colour: Colour | None, usual: Colour) -> Colour:
        colour = usual if colour is None else colour
        return colour if colour == "none" else mixed(colour, self.theme.paper, self.fade)

    def line(
        self, points, colour: Colour | None = None, width=1.0, z=3.0, dash: Sequence[float] = ()
    ) -> None:
        """A line through points (n, 2)."""
        key = self._shade(colour, self.theme.ink), width, z, tuple(dash)
        self.lines[key].append(np.asarray(points, dtype=float))

    def area(self, points, face: Colour | None = None, edge=None, width=1.0, z=3.0) -> None:
        """An area with corners (n, 2)."""
        theme = self.theme
        key = self._shade(face, theme.ground), self._shade(edge, theme.ink), width, z
        self.areas[key].append(np.asarray(points, dtype=float))

    def ring(self, centres, radius: float, face=None, edge=None, width=1.2, z=6.0) -> None:
        """Circles about points (n, 2), with a radius in points of symbols."""
        theme = self.theme
        key = radius, self._shade(face, theme.paper), self._shade(edge, theme.ink), width, z
        self.rings[key].append(np.reshape(centres, (-1, 2)))

    def at(self, place, shape, way=(1.0, 0.0)) -> np.ndarray:
        """Points (n, 2) of a symbol, in points, turned from the x-axis into a direction."""
        shape = np.asarray(shape, dtype=float)
        way = np.asarray(way, dtype=float)
        return place + self.unit * (shape[:, :1] * way + shape[:, 1:] * left_of(way))

    def arrow(self, points, colour: Colour = ACTS, width=1.6, head=7.0, z=7.0, both=False) -> None:
        """An arrow along points (n, 2), with its head at the last of them."""
        points = np.asarray(points, dtype=float)
        s = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        length = min(head * self.unit, 0.6 * s[-1] / (1 + both))
        inner = np.array([0.8 * length * both, s[-1] - 0.8 * length])
        places = np.concatenate([inner[:1], s[(s > inner[0]) & (s < inner[1])], inner[1:]])
        line = np.column_stack([np.interp(places, s, column) for column in points.T])
        self.line(line, colour, width, z)
        for tip, foot in ((points[-1], line[-1]), (points[0], line[0]))[: 1 + both]:
            way = unit(tip - foot)
            shape = length * (_HEAD[:, :1] * way + _HEAD[:, 1:] * left_of(way))
            self.area(tip + shape, colour, "none", 0.0, z)

    def finish(self) -> None:
        """Add all to the axes."""
        for (colour, width, z, dash), lines in self.lines.items():
            points = np.concatenate([part for line in lines for part in (line, _GAP)])
            look: Look = {"color": colour, "linewidth": width, "zorder": z}
            if dash:
                look |= {"linestyle": (0, dash), "dash_capstyle": "butt"}
            else:
                look |= {"solid_capstyle": "round", "solid_joinstyle": "round"}
            self.ax.plot(*points.T, **look)
        for (face, edge, width, z), areas in self.areas.items():
            look = {"facecolor": face, "edgecolor": edge, "linewidth": width, "zorder": z}
            self.ax.add_collection(PolyCollection(areas, **look), autolim=False)
        for (radius, face, edge, width, z), centres in self.rings.items():
            look = {"markerfacecolor": face, "markeredgecolor": edge, "markeredgewidth": width}
            size = 2 * radius * self.scale
            points = np.concatenate(centres)
            self.ax.plot(*points.T, "o", linestyle="", markersize=size, zorder=z, **look)

    # -- Ground -----------------------------------------------------------------------------------

    def ground(self, line, side, depth: float = 6.0, z: float = 1.5) -> None:
        """A line (n, 2) of the ground, with strokes on one side: unit vectors (n, 2) to it."""
        line, side = np.asarray(line, dtype=float), np.asarray(side, dtype=float)
        side = np.broadcast_to(side, line.shape) * depth * self.unit
        self.area(np.concatenate([line, (line + side)[::-1]]), edge="none", width=0.0, z=z)
        s = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        lean = 0.8 * depth * self.unit  # of a stroke along the line
        starts = np.arange(0.1 * self.unit, s[-1], 4.2 * self.unit)
        part = np.minimum(1.0, (s[-1] - starts) / lean)[:, None]
        tops, feet, ways = (
            np.column_stack([np.interp(places, s, column) for column in values.T])
            for places, values in (
                (starts + lean * part[:, 0], line),
                (starts, line),
                (starts, side),
            )
        )
        strokes = np.stack([tops + (1 - part) * ways, feet + ways], axis=1)
        strokes = np.concatenate([strokes, np.full((len(strokes), 1, 2), np.nan)], axis=1)
        self.line(strokes.reshape(-1, 2), self.theme.soft, 0.7 * self.scale, z + 0.1)
        self.line(line, width=1.5 * self.scale, z=z + 0.2)

    def wall(self, place, away, length: float = 26.0, depth: float = 6.0, z: float = 1.5) -> None:
        """Ground behind a short line; `away` is the direction into it."""
        line = self.at(place, [(-length / 2, 0), (length / 2, 0)], left_of(np.asarray(away)))
        self.ground(line, away, depth, z)


def circle(centre, radius: float, count: int = 48) -> np.ndarray:
    """Points (count + 1, 2) of a circle."""
    angle = np.linspace(0, 2 * np.pi, count + 1)
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def hull(points) -> np.ndarray:
    """Corners (n, 2) of the convex hull of points that are on no line, anticlockwise."""
    points = np.asarray(points, dtype=float)
    return points[ConvexHull(points).vertices]


def rounded(points, radius: float) -> np.ndarray:
    """Corners (n, 2) of the hull of discs of a radius about points."""
    return hull(np.concatenate([circle(np.asarray(point), radius, 16) for point in points]))
