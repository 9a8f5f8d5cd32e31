"""Axes in which pictures lie: the plane of a solution, panels, and the sheet of a scene."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fx_beam.results.files import replacing, writable

from .drawing import Drawing

#: Endings of files.
PICTURES = sorted(FigureCanvasAgg.filetypes)
#: Width and height up to which a picture is drawn [inch].
LARGEST = 6.4, 5.6
# Around the axes: left, below, right, above; and what a colour bar needs beside or below them.
_BORDER, _BESIDE, _BELOW = (0.8, 0.55, 0.2, 0.4), 1.0, 0.75
_NARROW = 2.4  # width of the axes that a title needs [inch]
_LOW = 2.2  # height of the axes up to which the colour bar lies below them [inch]


class Plane:
    """Axes over the window of a drawing.

    Parameters
    ----------
    drawing : Drawing
        What is drawn.
    bar : bool
        Whether there is a colour bar.
    size : (float, float), optional
        Width and height [inch], which the axes fill; by default as large as the window asks for.
    """

    def __init__(self, drawing: Drawing, bar: bool, size: tuple[float, float] | None = None):
        (low, high), whole = drawing.window, np.array(LARGEST if size is None else size)
        extent = high - low
        for is_below in (False, True) if bar else (False,):
            left, bottom, right, top = _BORDER
            left += room_for_ticks(low[1], high[1])
            right, bottom = right + _BESIDE * (bar and not is_below), bottom + _BELOW * is_below
            room = whole - (left + right, bottom + top)
            inner = extent * min(room / extent)
            if is_below or inner[1] > _LOW:
                break
        if size is not None or inner[0] < _NARROW:
            inner = np.array([_NARROW, inner[1]]) if size is None else room
            margin = (inner * max(extent / inner) - extent) / 2
            low, high = low - margin, high + margin
        whole = inner + (left + right, bottom + top)
        self.figure = Figure(tuple(whole))
        corner = np.array([left, bottom])
        self.ax: Any = self.figure.add_axes((*(corner / whole), *(inner / whole)))
        self.ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        self.ax.set(xlabel=f"$x$ [{drawing.unit}]", ylabel=f"$y$ [{drawing.unit}]")
        # A power of ten of the numbers stands above them, and not where the time is written.
        self.ax.yaxis.get_offset_text().set_horizontalalignment("right")
        self.ax.locator_params(axis="x", nbins=max(2, int(inner[0] / 0.7)))
        self.ax.locator_params(axis="y", nbins=max(2, int(inner[1] / 0.5)))
        self._bar_below = bar and is_below
        start = (left, 0.5) if self._bar_below else (left + inner[0] + 0.12, bottom)
        sides = (inner[0], 0.14) if self._bar_below else (0.14, inner[1])
        self._bar_place = (*(np.array(start) / whole), *(np.array(sides) / whole))

    def draw_bar(self, scale, **look):
        """Draw the colour bar of a scale."""
        cax = self.figure.add_axes(self._bar_place)
        side = "horizontal" if self._bar_below else "vertical"
        return self.figure.colorbar(scale, cax=cax, orientation=side, **look)


def room_for_ticks(low: float, high: float) -> float:
    """Width that numbers on an axis need beyond five characters [inch]."""
    step = np.diff(MaxNLocator(10).tick_values(low, high))[0]
    decimals = max(0, -math.floor(math.log10(step))) + 1
    digits = max(len(f"{value:.{decimals}f}") for value in (low, high))
    return 0.075 * max(0, digits - 6)


def picture(path: Path | str | None) -> Path | None:
    """The path of a picture, if there is one; raises an error if it cannot be written."""
    return None if path is None else writable(path, PICTURES)


def written(figure: Figure, path: Path | None) -> Figure:
    """A figure, written into a file if there is a path."""
    if path is not None:
        with replacing(path) as new:
            figure.savefig(new, dpi=200, bbox_inches="tight")
    return figure


def panels(
    count: int, extent: np.ndarray, border: np.ndarray, share: bool = False
) -> tuple[Figure, int, np.ndarray]:
    """A figure with panels of a shape, the number of columns, and the size of a panel [inch].

    The panels are as large as they can be, with few empty places.
    """

    def size(columns: int) -> np.ndarray:
        room = np.array(LARGEST) / (columns, -(-count // columns)) - border
        return extent * min(np.maximum(room, 0.1) / extent)

    def worth(columns: int) -> float:
        return np.prod(size(columns)) * (count / (columns * -(-count // columns))) ** 2

    columns = max(range(1, count + 1), key=worth)
    rows, panel = -(-count // columns), size(columns)
    figure = Figure(tuple((columns, rows) * (panel + border)), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=share, sharey=share)
    for ax in list(axes.flat)[count:]:
        ax.remove()
    return figure, columns, panel


_INCH = 6.4, 6.4  # the largest width and height of the picture [inch]
# Room for the axes' labels: left and below, right and above.
_LABELS = (0.78, 0.5), (0.15, 0.15)
# Distances of a label from its object, in pixels, and the directions in which it may lie.
_DISTANCES = 4.0, 9.0, 15.0, 23.0, 33.0, 46.0, 64.0, 90.0, 125.0
_DIRECTIONS = np.linspace(0, 2 * np.pi, 16, endpoint=False) + np.pi / 2
_LEADER = 16.0  # from this distance on a line connects a label to its object [pixels]
_DOT = 6.0  # half the side of a marker [pixels]
_OFTEN = 20  # number of equal labels above which only one is written
_CELL = 3.0  # side of the squares that are free or covered [pixels]


class Sheet:
    """Drawing in the plane, framed at the end; symbols are scaled by its size [m]."""

    def __init__(self, size: float):
        self.size = size
        self.figure = Figure(dpi=100)
        self.ax: Any = self.figure.add_axes((0, 0, 1, 1), aspect="equal")
        self._labels: list[tuple[str, np.ndarray, str, float]] = []

    def line(self, points, **look) -> None:
        """A line through points (n, 2)."""
        self.ax.plot(*np.transpose(points), **{"color": "black", "linewidth": 1.0} | look)

    def arrow(self, points, style: str = "-|>", **look) -> None:
        """An arrow along points (n, 2), with its head at the last of them."""
        points = np.asarray(points, dtype=float)
        self.line(points, **look)
        shape = {"arrowstyle": style, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
        shape |= {"color": look.get("color", "black"), "linewidth": look.get("linewidth", 1.0)}
        # On a curve the head follows its last part.
        last, head = (4, 0.06) if len(points) > 8 else (1, 0.02)
        ends = [(points[-1 - last], points[-1])]
        if style.startswith("<"):
            shape["arrowstyle"] = style[1:]
            ends.append((points[last], points[0]))
        for tail, tip in ends:
            foot = tip + (tail - tip) * min(1.0, head * self.size / np.hypot(*(tail - tip)))
            self.ax.annotate("", tip, foot, arrowprops=shape, annotation_clip=False, zorder=4)

    def drawn(self, marks: bool) -> list[np.ndarray]:
        """Points (n, 2) of all markers so far, or of all lines."""
        lines = [line for line in self.ax.lines if (line.get_marker() not in ("None", "")) == marks]
        return [line.get_xydata() for line in lines]

    def corner(self) -> np.ndarray:
        """A point (2,) to the upper right of all that is drawn so far."""
        return self.ax.dataLim.max + 0.08 * self.size

    def label(self, text: str, positions, colour: str = "black", size: float = 9.0) -> None:
        """A text near one of some points (n, 2); its position is chosen at the end."""
        self._labels.append((text, np.atleast_2d(positions), colour, size))

    def finish(self, scene_unit: str) -> Figure:
        """Frame the drawing, and write the labels."""
        low, high = self.ax.dataLim.get_points()
        # Space for labels; a straight member needs more beside it.
        margin = np.maximum(0.1 * self.size, (0.35 * self.size - (high - low)) / 2)
        low, high = low - margin, high + margin
        self.ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        self.ax.set(xlabel=f"$x$ [{scene_unit}]", ylabel=f"$y$ [{scene_unit}]")
        self.ax.tick_params(labelsize="small")
        self.ax.spines[:].set_color("0.7")
        border, other = np.array(_LABELS)
        border[0] += room_for_ticks(low[1], high[1])
        room = np.array(_INCH) - border - other
        inner = (high - low) * min(room / (high - low))
        whole = inner + border + other
        self.figure.set_size_inches(whole)
        self.ax.set_position([*(border / whole), *(inner / whole)])
        for axis, length in zip("xy", inner, strict=True):
            self.ax.locator_params(axis=axis, nbins=max(2, int(length / 0.7)))
        self._write()
        return self.figure

    # -- Labels ---------------------------------------------------------------------------------

    def _write(self) -> None:
        """Write each label where it covers the least."""
        renderer: Any = FigureCanvasAgg(self.figure).get_renderer()
        back = self.ax.transData.inverted()
        covered = self._covered()
        look = {"ha": "center", "va": "center", "zorder": 8}
        for text, positions, colour, size in self._merged():
            written = self.ax.text(0, 0, text, color=colour, fontsize=size, **look)
            extent = written.get_window_extent(renderer)
            half = np.array([extent.width, extent.height]) / 2
            spots, anchors, distances = _candidates(self.ax.transData.transform(positions), half)
            cost = 10 * self._count(covered, spots, half + 2.0) + distances
            best = int(np.argmin(cost + np.arange(len(cost)) * 1e-6))
            spot, anchor = spots[best], anchors[best]
            written.set_position(back.transform(spot))
            low, high = self._cells([spot - half, spot + half])
            covered[low[0] : high[0] + 1, low[1] : high[1] + 1] += 5.0
            if distances[best] > _LEADER:
                ends = back.transform([anchor, spot + np.clip(anchor - spot, -half, half)])
                self.ax.plot(*ends.T, color="0.6", linewidth=0.6, zorder=1)

    def _merged(self) -> list[tuple[str, np.ndarray, str, float]]:
        """The labels; one that there is very often, as on a loaded edge, is written once."""
        alike: dict[tuple[str, str, float], list[np.ndarray]] = {}
        for text, positions, colour, size in self._labels:
            alike.setdefault((text, colour, size), []).append(positions)
        many = {key: parts for key, parts in alike.items() if len(parts) > _OFTEN}
        once = [(text, np.concatenate(parts), *look) for (text, *look), parts in many.items()]
        return [label for label in self._labels if (label[0], *label[2:]) not in many] + once

    def _cells(self, pixels) -> np.ndarray:
        """Squares (n, 2) of the sheet in which some pixels (n, 2) lie."""
        last = (np.asarray(self.figure.bbox.size) / _CELL).astype(int)
        return np.clip((np.asarray(pixels) / _CELL).astype(int), 0, last)

    def _covered(self) -> np.ndarray:
        """Amount drawn in each square of the sheet; very large outside the frame."""
        low, high = self._cells(self.ax.bbox.get_points())
        covered = np.full(self._cells([self.figure.bbox.size])[0] + 1, 1e3)
        covered[low[0] : high[0], low[1] : high[1]] = 0.0
        for line in map(self.ax.transData.transform, self.drawn(marks=False)):
            points = [line[~np.isnan(line[:, 0])]]
            for a, b in zip(line[:-1], line[1:], strict=True):
                length = np.hypot(*(b - a))
                if length > _CELL:
                    points.append(a + np.arange(_CELL, length, _CELL)[:, None] / length * (b - a))
            covered[tuple(self._cells(np.concatenate(points)).T)] += 1.0
        for dots in self.drawn(marks=True):
            for dot in self.ax.transData.transform(dots):
                low, high = self._cells([dot - _DOT, dot + _DOT])
                covered[low[0] : high[0] + 1, low[1] : high[1] + 1] += 1.0
        return covered

    def _count(self, covered: np.ndarray, spots: np.ndarray, half: np.ndarray) -> np.ndarray:
        """Amount (n,) covered by boxes of a given size around points (n, 2)."""
        sums = np.pad(covered.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        (left, low), (right, top) = self._cells(spots - half).T, self._cells(spots + half).T + 1
        return sums[right, top] - sums[left, top] - sums[right, low] + sums[left, low]


def _candidates(anchors: np.ndarray, half: np.ndarray):
    """Possible centres (n, 2) of a label's box, their anchors, and the distances [pixels]."""
    directions = np.column_stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])
    # From its centre to its edge.
    edge_distance = np.min(half / np.maximum(abs(directions), 1e-9), axis=1)
    shifts = [(edge_distance + distance)[:, None] * directions for distance in _DISTANCES]
    spots = anchors[None, :, None] + np.array(shifts)[:, None]
    distances = np.broadcast_to(np.array(_DISTANCES)[:, None, None], spots.shape[:3])
    positions = np.broadcast_to(anchors[None, :, None], spots.shape)
    return spots.reshape(-1, 2), positions.reshape(-1, 2), distances.ravel()
