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
_LATER = 0.3  # cost of each place of a label before the one that it names
_RESOLUTION = 100  # at which ink is looked for [pixels per inch]
_FAINT = 0.02  # what is nearly as the paper
_OFTEN = 20  # number of equal labels above which only one is written
_MOST = 500  # number of other labels that are written: more would cover each other


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
        """The first labels; one that there is very often, as on a loaded edge, is written once."""
        alike: dict[tuple, list[_Label]] = {}
        for label in self._labels:
            alike.setdefault((id(label.ax), label.text), []).append(label)
        often = [labels for labels in alike.values() if len(labels) > _OFTEN]
        places = [np.concatenate([label.places for label in labels]) for labels in often]
        merged = [labels[0]._replace(places=x) for labels, x in zip(often, places, strict=True)]
        many = {label.text for label in merged}
        return [label for label in self._labels if label.text not in many][:_MOST] + merged


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
        # From the middle of the box to its edge.
        edge = np.min(half / np.maximum(abs(_WAYS), 1e-9), axis=1)
        start, spot, distance, way = self._best(label, half, edge)
        back = ax.transData.inverted()
        written.set_position(back.transform(spot))
        self._boxes = np.vstack([self._boxes, np.append(spot - half, spot + half)])
        if distance > _LEADER:
            ends = start + 2 * point * _WAYS[way], spot - edge[way] * _WAYS[way]
            look: Look = {"color": self._theme.soft, "linewidth": 0.6, "zorder": 8.5}
            ax.plot(*back.transform(ends).T, **look)
            steps = np.linspace(*ends, 12)
            self._boxes = np.vstack([self._boxes, np.hstack([steps - 1, steps + 1])])

    def _best(self, label: _Label, half: np.ndarray, edge: np.ndarray) -> tuple:
        """The place that a label names, the middle of its box, its distance, and number of way.

        Looked for from the least cost without other labels on, as long as this may be the least.
        """
        turn = 1 - _WAYS @ (label.way / (np.hypot(*label.way) or 1.0))
        first_cost = np.ravel(_DISTANCES[:, None] + _TURNS * label.way.any() * turn)
        away = (edge + _RESOLUTION / 72 * _DISTANCES[:, None])[..., None] * _WAYS
        least, frame = np.inf, label.ax.bbox.extents
        best: tuple = ()
        for i, place in enumerate(label.ax.transData.transform(label.places)):
            if least <= _LATER * i:
                break
            spots = (place + away).reshape(-1, 2)
            corners = np.concatenate([spots - half, spots + half], axis=-1)
            cost = first_cost + _LATER * i + _COVERS * self._ink(corners)
            outside = (corners[:, :2] < frame[:2]) | (corners[:, 2:] > frame[2:])
            cost = np.where(outside.any(axis=-1), cost + 1e4, cost)
            others = self._near(corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0))
            for k in np.argsort(cost, kind="stable"):
                if cost[k] >= least:
                    break
                if (whole := cost[k] + _COVERS * _shared(corners[k], others)) < least:
                    far, way = divmod(k, len(_WAYS))
                    least, best = whole, (place, spots[k], _DISTANCES[far], way)
        return best

    def _near(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Boxes (4, n) of what was written between two corners."""
        near = (self._boxes[:, :2] < high) & (self._boxes[:, 2:] > low)
        return np.ascontiguousarray(self._boxes[near.all(axis=1)].T)

    def _ink(self, corners: np.ndarray) -> np.ndarray:
        """Ink (n,) of the drawing in boxes with corners (n, 4) [pixels]."""
        left, low = np.clip(corners[:, :2].astype(int), 0, self._shape).T
        right, top = np.clip(corners[:, 2:].astype(int) + 1, 0, self._shape).T
        sums = self._sums
        return sums[right, top] - sums[left, top] - sums[right, low] + sums[left, low]


def _shared(box: np.ndarray, boxes: np.ndarray) -> float:
    """Area that a box with corners (4,) shares with boxes (4, n) [pixels]."""
    left, low, right, top = boxes
    wide = np.minimum(box[2], right) - np.maximum(box[0], left)
    high = np.minimum(box[3], top) - np.maximum(box[1], low)
    return float(np.maximum(wide, 0.0) @ np.maximum(high, 0.0))
