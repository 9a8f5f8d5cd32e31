"""Load over displacement: paths of equilibria with their branches, stability and points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.validation import as_float, check_takes, is_number, require

from .time_curves import Figure, curve, figure, save

_STABLE: dict[str, Any] = {"color": "#0072B2", "linewidth": 2.0, "label": "stable"}
_UNSTABLE: dict[str, Any] = {
    "color": "#CC79A7",
    "linewidth": 1.2,
    "linestyle": (0, (3, 1.5)),
    "zorder": 1.5,
    "label": "unstable",
}
_MARKS = {"limit point": "D", "bifurcation": "o", "flutter": "^"}


def equilibrium_paths(
    solution: Solution,
    value: Callable[[Solution], np.ndarray],
    path: Path | str | None = None,
    label: str = "",
    load: float = 1.0,
    load_label: str = "load factor",
) -> Figure:
    """Bifurcation diagram: the load over a quantity, for a path of equilibria and its branches.

    Stable equilibria are on solid lines, unstable ones on dashed lines; limit points, bifurcations
    and flutter have marks.

    Parameters
    ----------
    solution : Solution
        A path by `fx_beam.static`, with the branches in ``solution.branches``.
    value : callable
        ``value(solution)`` gives the quantity (n,) of the horizontal axis.
    path : str or path, optional
        Picture to write; its ending gives the format.
    label : str
        Name of the quantity, with its unit.
    load : float
        The load at load factor 1.
    load_label : str
        Name of the load, with its unit.

    Returns
    -------
    matplotlib.figure.Figure
        The picture, with a single panel, ``figure.axes[0]``.
    """
    static = isinstance(solution, Solution) and solution.stats.static
    require(static, "solution", solution, "what fx_beam.static returned")
    check_takes(value, "solution", "value")
    require(is_number(load), "load", load, "a number")
    load = as_float(load)
    fig, axes = figure(1, 1, height=4.0)
    ax = axes[0, 0]
    marks: dict[str, list[tuple[float, float]]] = {kind: [] for kind in _MARKS}
    for each in _all_of(solution):
        x, y, stable = _with_points(each, value, marks)
        for first, last, is_stable in _pieces(stable):
            line = x[first : last + 1], load * y[first : last + 1]
            if is_stable:
                ax.plot(*line, **_STABLE)
            else:  # on white: branches that coincide would fill the gaps of the dashes
                ax.plot(*line, color="white", lw=2, zorder=1.5)
                ax.plot(*line, **_UNSTABLE)
    for kind, places in marks.items():
        if places:
            xs, ys = np.array(places).T
            look = {"color": "#D55E00", "markersize": 5, "zorder": 4, "linestyle": ""}
            ax.plot(xs, load * ys, marker=_MARKS[kind], label=kind, **look)
    ax.set(xlabel=label, ylabel=load_label)
    if path is not None:
        save(fig, path)
    return fig


def _all_of(solution: Solution) -> Iterator[Solution]:
    """A path, its branches, and theirs."""
    yield solution
    for branch in solution.branches:
        yield from _all_of(branch)


def _with_points(
    solution: Solution,
    value: Callable[[Solution], np.ndarray],
    marks: dict[str, list[tuple[float, float]]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values and load factors (m,) of rows and points; whether lines between are stable."""
    values, factors, stable = _values(value, solution), solution.load_factor, solution.stable
    places, lines = list[tuple[float, float]](), list[bool]()
    points = [point for point in solution.critical_points if point.solution is not None]
    for row, place in enumerate(zip(values.tolist(), factors.tolist(), strict=True)):
        places.append(place)
        inside = [point for point in points if point.row == row]
        for number, point in enumerate(inside):
            places.append((_values(value, point.solution)[-1], point.load_factor))
            marks[point.kind].append(places[-1])
            lines.append(number == 0 and bool(stable[row]))
        lines.append(bool(stable[row + 1] if inside else stable[row]))
    x, y = np.array(places).T
    return x, y, np.array(lines[:-1])


def _values(value: Callable[[Solution], np.ndarray], solution: Solution) -> np.ndarray:
    """Values (n,) in the rows of a solution."""
    return curve(value(solution), solution.t, "value(solution)")


def _pieces(stable: np.ndarray) -> Iterator[tuple[int, int, bool]]:
    """First and last places of runs of lines that are all stable or all not."""
    first = 0
    for last in range(1, len(stable) + 1):
        if last == len(stable) or stable[last] != stable[first]:
            yield first, last, bool(stable[first])
            first = last
