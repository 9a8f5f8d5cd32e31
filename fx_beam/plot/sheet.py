"""Figures: axes over a drawing or in rows and columns, and files."""

from __future__ import annotations

import io
import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fx_beam.results.files import replacing, writable

from .drawing import Drawing
from .look import Look, Theme

#: Endings of files.
PICTURES = sorted(FigureCanvasAgg.filetypes)
#: Width and height up to which a picture is drawn [inch].
LARGEST = 7.0, 5.6
# Around the axes: left, below, right, above; and what a colour bar needs beside or below them.
_BORDER, _BESIDE, _BELOW = (0.62, 0.45, 0.12, 0.12), 1.0, 0.75
_TITLE, _LONG = 0.18, 36  # height of a line of a title [inch], and letters that may need two
_NARROW = 2.4  # width of the axes that a title needs [inch]
_LOW = 2.2  # height of the axes up to which the colour bar lies below them [inch]


class Picture(Figure):
    """A figure that notebooks show."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=150)
        return file.getvalue()


class Plane:
    """Axes over the window of a drawing.

    Parameters
    ----------
    drawing : Drawing
        What is drawn.
    theme : Theme
        The colours.
    bar : bool
        Whether there is a colour bar.
    title : str
        What is written over the axes.
    size : (float, float), optional
        Width and height [inch], which the axes fill; by default as large as the window asks for.
    room : float
        Around what is drawn, for symbols and labels [points].
    is_framed : bool
        Whether the axes have a frame with numbers.
    """

    def __init__(
        self,
        drawing: Drawing,
        theme: Theme,
        bar: bool = False,
        title: str = "",
        size: tuple[float, float] | None = None,
        room: float = 30.0,
        is_framed: bool = True,
    ):
        low, high = drawing.corners
        whole, margin = np.array(LARGEST if size is None else size), 2 * room / 72
        extent = high - low
        for is_below in (False, True) if bar else (False,):
            left, bottom, right, top = _BORDER if is_framed else (0.05,) * 4
            left += room_for_ticks(low[1], high[1]) if is_framed else 0.0
            if title or (size and is_framed):
                top += _TITLE * (1 + (len(title) > _LONG))
            right, bottom = right + _BESIDE * (bar and not is_below), bottom + _BELOW * is_below
            space = whole - (left + right, bottom + top)
            # Length in the drawing of an inch.
            inch = max(extent / np.maximum(space - margin, 0.3 * space)) or drawing.reach / 2
            inner = np.minimum(extent / inch + margin, space)
            if is_below or inner[1] > _LOW:
                break
        if size is not None:
            inner = space
        inner = np.maximum(inner, np.minimum((_NARROW, 0.25 * inner[0]), space))
        middle = (low + high) / 2
        low, high = middle - inch * inner / 2, middle + inch * inner / 2
        whole = inner + (left + right, bottom + top)
        self.figure = Picture(tuple(whole), facecolor=theme.paper)
        corner = np.array([left, bottom])
        self.ax: Any = self.figure.add_axes((*(corner / whole), *(inner / whole)))
        self.ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        if is_framed:
            self.ax.set(xlabel=f"$x$ [{drawing.unit}]", ylabel=f"$y$ [{drawing.unit}]")
            # A power of ten of the numbers stands above them, and not where the time is written.
            self.ax.yaxis.get_offset_text().set_horizontalalignment("right")
            self.ax.locator_params(axis="x", nbins=max(2, int(inner[0] / 0.7)))
            self.ax.locator_params(axis="y", nbins=max(2, int(inner[1] / 0.5)))
        else:
            self.ax.set_axis_off()
        theme.dress(self.ax)
        self._theme, self._bar_below = theme, bar and is_below
        start = (left, 0.5) if self._bar_below else (left + inner[0] + 0.12, bottom)
        sides = (inner[0], 0.14) if self._bar_below else (0.14, inner[1])
        self._bar_place = (*(np.array(start) / whole), *(np.array(sides) / whole))
        if title and size is None:
            lines = textwrap.fill(title, max(20, int(15 * inner[0])))
            self.ax.set_title(lines, fontsize=9, pad=4)

    def draw_bar(self, scale, **look):
        """Draw the colour bar of a scale."""
        cax = self.figure.add_axes(self._bar_place)
        side = "horizontal" if self._bar_below else "vertical"
        bar = self.figure.colorbar(scale, cax=cax, orientation=side, **look)
        self._theme.dress(cax)
        return bar


def room_for_ticks(low: float, high: float) -> float:
    """Width that numbers on an axis need beyond five characters [inch]."""
    step = np.diff(MaxNLocator(10).tick_values(low, high))[0]
    decimals = max(0, -math.floor(math.log10(step))) + 1
    digits = max(len(f"{value:.{decimals}f}") for value in (low, high))
    return 0.075 * max(0, digits - 6)


def picture(path: Path | str | None) -> Path | None:
    """The path of a picture, if there is one; raises an error if it cannot be written."""
    return None if path is None else writable(path, PICTURES)


def written(figure: Figure, path: Path | None, is_cut: bool = False) -> Figure:
    """A figure, written into a file if there is a path; what is empty around it may be cut."""
    if path is not None:
        with replacing(path) as new:
            cut: Look = {"bbox_inches": "tight", "pad_inches": 0.1} if is_cut else {}
            figure.savefig(new, dpi=200, **cut)
    return figure


def panels(
    count: int, extent: np.ndarray, theme: Theme, room: float, title: float = 18.0
) -> tuple[Picture, list[Any], float]:
    """A figure with panels over an extent each, and the length of a point in the drawing.

    Around each there is some room, and above it that of a title [points]. The panels are as large
    as they can be, with few empty places.
    """

    def size(columns: int) -> tuple[float, np.ndarray]:
        rows = -(-count // columns)
        space = 72 * np.array(LARGEST) / (columns, rows) - (0, title)
        point = max(extent / np.maximum(space - 2 * room, 0.2 * space))
        return point, np.minimum(extent / point + 2 * room, space)

    def worth(columns: int) -> float:
        return np.prod(size(columns)[1]) * (count / (columns * -(-count // columns))) ** 2

    columns = max(range(1, count + 1), key=worth)
    rows, (point, panel) = -(-count // columns), size(columns)
    whole = np.array([columns, rows]) * (panel + (0, title))
    figure, axes = Picture(tuple(whole / 72), facecolor=theme.paper), []
    for number in range(count):
        row, column = divmod(number, columns)
        corner = np.array([column * panel[0], whole[1] - (row + 1) * (panel[1] + title)])
        ax: Any = figure.add_axes((*(corner / whole), *(panel / whole)))
        ax.set_axis_off()
        ax.title.set_color(theme.ink)
        axes.append(ax)
    return figure, axes, point
