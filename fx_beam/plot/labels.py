"""Labels of a figure, written where there is no ink."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from .look import Look, Theme

# Distances of a label from its place [points], and directions in which it may lie.
_DISTANCES = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 24.0, 31.0, 40.0, 52.0, 68.0, 90.0])
_ANGLES = np.arange(32) * np.pi / 16
_WAYS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_GAP, _LEADER = 1.2, 9.0  # around a label; distance from which on a line leads to it [points]
_COVERS, _TURNS = 1.0, 5.0  # costs of covered ink [points per pixel], of another direction
_RESOLUTION = 100  # at which ink is looked for [pixels per inch]
_FAINT = 0.02  # what is nearly as the paper
_OFTEN = 20  # number of equal labels above which only one is written


class _Label(NamedTuple):
    ax: Any
    text: str
    #: Places (n, 2) of which it may name any, and the direction (2,) in which it would lie.
    places: np.ndarray
    way: np.ndarray
    look: Look


class Labels:
    """Labels of a figure: collected while it is drawn, written at its end."""

    def __init__(self, figure: Figure, theme: Theme):
        self._figure, self._theme = figure, theme
        self._labels: list[_Label] = []

    def add(self, ax, text: str, places, way=(0.0, 0.0), size: float = 8.0, **look) -> None:
        """A text beside one of some places (n, 2) in data, if possible in the direction `way`."""
        places = np.atleast_2d(np.asarray(places, dtype=float))
        look = {"fontsize": size, "color": self._theme.ink} | look
        self._labels.append(_Label(ax, text, places, np.asarray(way, dtype=float), look))

    def write(self) -> None:
        """Write all labels, each as near as it can be without covering others or the drawing."""
        if not self._labels:
            return
        figure, usual = self._figure, self._figure.dpi
        figure.set_dpi(_RESOLUTION)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255.0
        ink = abs(pixels - to_rgb(self._theme.paper)).mean(axis=2).T
        ink = np.where(ink < _FAINT, 0.0, 0.15 + ink)
        placing = _Placing(ink, self._theme, canvas.get_renderer())
        for label in self._merged():
            placing.write(label)
        figure.set_dpi(usual)

    def _merged(self) -> list[_Label]:
        """The labels; one that there is very often, as on a loaded edge, is written once."""
        alike: dict[tuple, list[_Label]] = {}
        for label in self._labels:
            alike.setdefault((id(label.ax), label.text), []).append(label)
        often = [labels for labels in alike.values() if len(labels) > _OFTEN]
        places = [np.concatenate([label.places for label in labels]) for labels in often]
        merged = [labels[0]._replace(places=x) for labels, x in zip(often, places, strict=True)]
        many = {label.text for label in merged}
        return [label for label in self._labels if label.text not in many] + merged


class _Placing:
    """Places labels over the ink of a figure and over each other."""

    def __init__(self, ink: np.ndarray, theme: Theme, renderer):
        self._sums = np.pad(ink.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        self._shape, self._theme, self._renderer = ink.shape, theme, renderer
        # Lower left and upper right corners (n, 4) of what was written.
        self._boxes = np.empty((0, 4))

    def write(self, label: _Label) -> None:
        """Write a label where it covers least, near one of its places."""
        ax, point = label.ax, _RESOLUTION / 72
        centred: Look = {"ha": "center", "va": "center", "zorder": 9}
        written = ax.text(*label.places[0], label.text, **centred | label.look)
        box = written.get_window_extent(self._renderer)
        half = np.array([box.width, box.height]) / 2 + _GAP * point
        starts = ax.transData.transform(label.places)
        # From the middle of the box to its edge, then on.
        edge = np.min(half / np.maximum(abs(_WAYS), 1e-9), axis=1)
        away = edge + point * _DISTANCES[:, None]
        spots = starts[:, None, None] + away[..., None] * _WAYS
        cost = _DISTANCES[:, None] + _TURNS * (np.hypot(*label.way) > 0) * (
            1 - _WAYS @ (label.way / (np.hypot(*label.way) or 1.0))
        )
        cost = cost + 0.3 * np.arange(len(starts))[:, None, None]
        corners = np.concatenate([spots - half, spots + half], axis=-1)
        cost = cost + _COVERS * self._covered(corners)
        frame = ax.bbox.extents
        outside = (corners[..., :2] < frame[:2]) | (corners[..., 2:] > frame[2:])
        cost = np.where(outside.any(axis=-1), cost + 1e4, cost)
        place, far, way = np.unravel_index(cost.argmin(), cost.shape)
        spot, back = spots[place, far, way], ax.transData.inverted()
        written.set_position(back.transform(spot))
        self._boxes = np.vstack([self._boxes, corners[place, far, way]])
        if _DISTANCES[far] > _LEADER:
            ends = starts[place] + 2 * point * _WAYS[way], spot - edge[way] * _WAYS[way]
            look: Look = {"color": self._theme.soft, "linewidth": 0.6, "zorder": 8.5}
            ax.plot(*back.transform(ends).T, **look)
            steps = np.linspace(*ends, 12)
            self._boxes = np.vstack([self._boxes, np.hstack([steps - 1, steps + 1])])

    def _covered(self, corners: np.ndarray) -> np.ndarray:
        """Ink (...) in boxes with corners (..., 4) [pixels]."""
        left, low = np.moveaxis(np.clip(corners[..., :2].astype(int), 0, self._shape), -1, 0)
        right, top = np.moveaxis(np.clip(corners[..., 2:].astype(int) + 1, 0, self._shape), -1, 0)
        sums = self._sums
        ink = sums[right, top] - sums[left, top] - sums[right, low] + sums[left, low]
        for box in self._boxes:
            sides = np.minimum(corners[..., 2:], box[2:]) - np.maximum(corners[..., :2], box[:2])
            ink = ink + np.maximum(sides, 0).prod(axis=-1)
        return ink
