"""The plane of a picture: axes of equal scales with a colour bar, and obstacles in it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fx_beam.errors import is_name, require
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
    scene_unit : str
        Unit of length in which the scene is given, for labels.
    bar : bool
        Whether there is a colour bar.
    size : (float, float), optional
        Width and height [inch], which the axes fill; by default as large as the window asks for.
    """

    def __init__(
        self,
        drawing: Drawing,
        scene_unit: str,
        bar: bool,
        size: tuple[float, float] | None = None,
    ):
        require(is_name(scene_unit), "scene_unit", scene_unit, "a text")
        (low, high), whole = drawing.window, np.array(LARGEST if size is None else size)
        extent = high - low
        for below in (False, True) if bar else (False,):
            left, bottom, right, top = _BORDER
            left += room_for_ticks(low[1], high[1])
            right, bottom = right + _BESIDE * (bar and not below), bottom + _BELOW * below
            room = whole - (left + right, bottom + top)
            inner = extent * min(room / extent)
            if below or inner[1] > _LOW:
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
        self.ax.set(xlabel=f"$x$ [{scene_unit}]", ylabel=f"$y$ [{scene_unit}]")
        self.ax.locator_params(axis="x", nbins=max(2, int(inner[0] / 0.7)))
        self.ax.locator_params(axis="y", nbins=max(2, int(inner[1] / 0.5)))
        #: Low and high corner of the axes.
        self.low, self.high = low, high
        self._bar_below = bar and below
        start = (left, 0.5) if self._bar_below else (left + inner[0] + 0.12, bottom)
        sides = (inner[0], 0.14) if self._bar_below else (0.14, inner[1])
        self._of_bar = (*(np.array(start) / whole), *(np.array(sides) / whole))

    def draw_bar(self, scale, **look):
        """Draw the colour bar of a scale."""
        cax = self.figure.add_axes(self._of_bar)
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
    places = figure.subplots(rows, columns, squeeze=False, sharex=share, sharey=share)
    for ax in list(places.flat)[count:]:
        ax.remove()
    return figure, columns, panel
