"""Curves over time: one quantity for several schemes, or several quantities."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fx_beam.errors import array_of, check_takes, is_whole, numbers, positive, require
from fx_beam.results.files import replacing
from fx_beam.results.solution import Solution

# Colours of Okabe and Ito, safe for colour-blind readers; line styles differ in grey prints.
_STYLES: dict[str, dict] = {
    "EnergyMomentum": {"color": "#0072B2", "linestyle": "-", "linewidth": 2.4},
    "EnergyMomentum(order=4)": {"color": "#004b87", "linestyle": (0, (1, 1)), "linewidth": 2.0},
    "EnergyDecaying": {"color": "black", "linestyle": "-", "linewidth": 1.0},
    "ModifiedMidPoint": {"color": "#56B4E9", "linestyle": (0, (5, 2))},
    "MidPoint": {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    "Newmark": {"color": "#D55E00", "linestyle": (0, (6, 1.5, 1, 1.5))},
    "HHT": {"color": "#009E73", "linestyle": (0, (3, 1.2))},
    "GeneralizedAlpha": {"color": "#E69F00", "linestyle": (0, (6, 1, 1, 1, 1, 1))},
}
# Markers that distinguish curves of one scheme in one panel; the first is the plain line.
_MARKERS = None, "o", "s", "^", "D", "v"
QUANTITY_STYLES = [
    {"color": color, "linestyle": line}
    for color, line in zip(
        ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "black"),
        ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 3))),
        strict=True,
    )
]


def style(scheme: str) -> dict:
    """Line style of a time scheme, the same in all figures.

    Parameters
    ----------
    scheme : str
        Name of the scheme, as in `Stats.scheme`.

    Returns
    -------
    dict
        Arguments for matplotlib's `plot`.
    """
    return {"linewidth": 1.2} | _STYLES.get(scheme, {"color": "black", "linestyle": (0, (2, 2))})


def figure(rows: int, columns: int, height: float = 2.5):
    """Figure with a grid of panels in the common style.

    Parameters
    ----------
    rows, columns : int
        Number of panels.
    height : float
        Height of a row [inch].

    Returns
    -------
    figure : matplotlib.figure.Figure
        The figure, for `save`.
    axes : (rows, columns) array of matplotlib.axes.Axes
        Its panels.
    """
    for name, number in (("rows", rows), ("columns", columns)):
        require(is_whole(number, 1), f"figure: {name}", number, "a whole number from 1 on")
    height = positive(height, "figure: height")
    fig = Figure(figsize=(7.5, rows * height + 0.5), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="0.9", linewidth=0.6)
        ax.set_axisbelow(True)
    return fig, axes


def curves(
    axes,
    solutions: dict[str, Solution],
    value: Callable[[Solution], np.ndarray],
    times: Callable[[Solution], np.ndarray] = lambda solution: solution.t,
) -> None:
    """Draw one quantity over time for several solutions.

    Each scheme has its own line style; further solutions by the same scheme have markers as well.
    A cross marks the end of a solution that failed. Set the limits of the axes first: if the curve
    ends outside, its cross is drawn on the edge.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    solutions : dict
        Solutions by their labels in the legend.
    value : callable
        ``value(solution)`` gives the quantity (n,).
    times : callable
        ``times(solution)`` gives the times (n,) of the values [s], such as `Solution.t_level` for
        stress resultants.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=1.0).centre
    >>> runs = {"free fall": fb.simulate(scene, dt=0.1, t_end=0.5)}
    >>> figure, axes = fb.plot.figure(1, 1)
    >>> fb.plot.curves(axes[0, 0], runs, lambda solution: solution.position(ball)[:, 1])
    """
    _check(axes, solutions, "solutions")
    for label, solution in solutions.items():
        require(isinstance(solution, Solution), f"solutions[{label!r}]", solution, "a Solution")
    check_takes(value, "solution", "value")
    check_takes(times, "solution", "times")
    drawn: dict[str, int] = {}
    cross = {"marker": "X", "markersize": 9, "markeredgecolor": "white", "linestyle": ""}
    for label, solution in solutions.items():
        scheme = solution.stats.scheme
        look = style(scheme) | _marked(drawn.get(scheme, 0))
        drawn[scheme] = drawn.get(scheme, 0) + 1
        t = array_of(times(solution), "times(solution)")
        y = curve(value(solution), t, "value(solution)")
        axes.plot(t, y, label=label, **look)
        if solution.stats.failure and t[-1] <= axes.get_xlim()[1]:
            edge = np.clip(y[-1], *axes.get_ylim())
            axes.plot(t[-1], edge, **cross | {"color": look["color"]}, clip_on=False, zorder=5)
            # One legend entry for all: a scheme may fail in one panel and not in another.
            axes.plot([], [], **cross | {"color": "0.4"}, label="a step fails, the run ends")


def _marked(number: int) -> dict:
    """Marker style of the curve with this number among those of one scheme."""
    if not number:
        return {}
    marker = _MARKERS[1 + (number - 1) % (len(_MARKERS) - 1)]
    markers = (0.03 * number, 0.12)
    return {"marker": marker, "markevery": markers, "fillstyle": "none", "markersize": 5}


def quantities(axes, values: dict[str, np.ndarray], t: np.ndarray) -> None:
    """Draw several quantities over time, each with a style of its own.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    values : dict
        Quantities (n,) by their labels in the legend.
    t : (n,) float
        Times, or other values for the horizontal axis.

    Examples
    --------
    >>> import numpy as np, fx_beam as fb
    >>> figure, axes = fb.plot.figure(1, 1)
    >>> t = np.linspace(0, 1, 50)
    >>> fb.plot.quantities(axes[0, 0], {"kinetic": t**2, "potential": 1 - t**2}, t)
    >>> [line.get_label() for line in axes[0, 0].lines]
    ['kinetic', 'potential']
    """
    _check(axes, values, "values")
    t = array_of(t, "t")
    for (label, given), look in zip(values.items(), itertools.cycle(QUANTITY_STYLES), strict=False):
        y = curve(given, t, f"values[{label!r}]")
        axes.plot(t, y, label=label, linewidth=1.5, **look)


def _check(axes: Any, curves: Any, what: str) -> None:
    """Refuse axes that draw nothing, and curves without labels."""
    wanted = "axes of matplotlib, such as fx_beam.plot.figure(1, 1)[1][0, 0]"
    require(isinstance(axes, Axes), "axes", axes, wanted)
    require(isinstance(curves, Mapping), what, curves, "a dict by labels in the legend")


def curve(given: Any, t: np.ndarray, what: str) -> np.ndarray:
    """Values (n,) over times or load factors (n,)."""
    values = numbers(given)
    require(values.shape == t.shape, what, given, f"{len(t)} numbers, one for each row or time")
    return values


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure, with one legend for all its panels.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure with labelled curves.
    path : str or path
        File to write; its ending gives the format.
    """
    require(isinstance(figure, Figure), "figure", figure, "a figure, as of fx_beam.plot.figure")
    handles: dict = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    columns = len(handles) if len(handles) < 4 else 2
    look: dict[str, Any] = {"loc": "outside upper center", "frameon": False, "handlelength": 3.2}
    figure.legend(handles.values(), handles.keys(), ncols=columns, **look)
    with replacing(path, sorted(figure.canvas.get_supported_filetypes())) as new:
        figure.savefig(new, dpi=200)
