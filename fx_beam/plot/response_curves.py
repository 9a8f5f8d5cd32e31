"""Curves over frequency or load: amplitudes, families of periodic motions, equilibrium paths."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import as_float, check_takes, is_number, require
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse, PeriodicFamily
from fx_beam.scene.beam import Node

from .time_curves import QUANTITY_STYLES, Figure, curve, figure, save

_STABLE: dict[str, Any] = {"color": "#0072B2", "linewidth": 2.0, "label": "stable"}
_UNSTABLE: dict[str, Any] = {
    "color": "#CC79A7",
    "linewidth": 1.2,
    "linestyle": (0, (3, 1.5)),
    "zorder": 1.5,
    "label": "unstable",
}
_MARKS = {"limit point": "D", "bifurcation": "o", "flutter": "^"}


def frequency_response(
    responses: FrequencyResponse | Mapping[str, FrequencyResponse],
    path: Path | str | None = None,
    components: Sequence[str] | None = None,
) -> Figure:
    """Picture of amplitudes and phases over the frequency of the load.

    Amplitudes have a logarithmic scale, with a panel for each unit.

    Parameters
    ----------
    responses : FrequencyResponse or dict
        What `fx_beam.frequency_response` returned, or several by their labels.
    path : str or path, optional
        Picture to write; its ending gives the format.
    components : sequence of str, optional
        The components to draw, of `FrequencyResponse.names`; by default all that move.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    named = responses if isinstance(responses, Mapping) else {"": responses}
    shown: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}
    for label, of in named.items():
        wanted = "what fx_beam.frequency_response returned"
        require(isinstance(of, FrequencyResponse), "responses", of, wanted)
        names = components
        if names is None:
            names = [name for name in of.names if of.component(name).any()]
        wanted = f"names to draw, of {list(of.names)}"
        fits = isinstance(names, Sequence) and not isinstance(names, str)
        require(fits and len(names) > 0, "components", names, wanted)
        for name in names:
            curve_label = name if not label else label if len(names) == 1 else f"{label}, {name}"
            unit = of.units[of.names.index(name)] if name in of.names else ""
            shown[curve_label] = unit, of.frequencies, of.component(name)
    kinds = sorted({unit for unit, _, _ in shown.values()})
    fig, axes = figure(len(kinds) + 1, 1)
    *amplitudes, last = axes[:, 0]
    looks = itertools.cycle(QUANTITY_STYLES)
    for (label, (unit, f, values)), look in zip(shown.items(), looks, strict=False):
        draw = {"label": label, "linewidth": 1.5, **look}
        amplitudes[kinds.index(unit)].plot(f, abs(values), **draw)
        last.plot(f, np.degrees(np.unwrap(np.angle(values))), **draw)
    for unit, ax in zip(kinds, amplitudes, strict=True):
        ax.set(yscale="log", ylabel=f"amplitude [{unit}]")
    first, end = (np.array(last.dataLim.intervaly) / 90).round(9)
    first, end = np.floor(first), np.ceil(end)
    last.set_yticks(90 * np.arange(first, end + 1, max(1, (end - first) // 4)))
    last.set(ylabel="phase [deg]", xlabel="frequency of the load [Hz]")
    low, high = last.dataLim.intervalx
    if 0 < 100 * low < high:
        for ax in axes[:, 0]:
            ax.set_xscale("log")
    return _saved(fig, path)


def response(
    families: PeriodicFamily | Mapping[str, PeriodicFamily],
    node: Node,
    component: str = "y",
    path: Path | str | None = None,
) -> Figure:
    """Picture of the amplitude of a node over the frequency of periodic motions.

    Stable motions have a line, unstable ones dots on a thin line.

    Parameters
    ----------
    families : PeriodicFamily or dict
        What `fx_beam.backbone` or `fx_beam.forced_response` returned, or several by their labels.
    node : Node
        A node of the scene.
    component : {"x", "y", "rotation"}
        Component of its motion.
    path : str or path, optional
        Picture to write; its ending gives the format.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    named = families if isinstance(families, Mapping) else {"": families}
    for family in named.values():
        wanted = "what fx_beam.backbone or fx_beam.forced_response returned"
        require(isinstance(family, PeriodicFamily), "response: families", family, wanted)
    fig, axes = figure(1, 1, height=3.5)
    ax = axes[0, 0]
    for label, family in named.items():
        f, a, stable = family.frequencies, family.amplitudes(node, component), family.stable
        style = {"linestyle": "--", "color": "0.4"} if family.free else {"linewidth": 1.5}
        (line,) = ax.plot(f, a, label=label or None, **style)
        if not stable.all():
            of = "unstable" if not label else f"{label}, unstable"
            ax.plot(
                f[~stable], a[~stable], "o", ms=4, mfc="white", color=line.get_color(), label=of
            )
    unit = "rad" if component == "rotation" else "m"
    ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude of {component} [{unit}]")
    return _saved(fig, path)


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
        changes = np.flatnonzero(np.diff(stable)) + 1
        for first, last in itertools.pairwise(np.unique([0, *changes, len(stable)]).tolist()):
            line = x[first : last + 1], load * y[first : last + 1]
            if stable[first]:
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
    return _saved(fig, path)


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


def _saved(fig: Figure, path: Path | str | None) -> Figure:
    if path is not None:
        save(fig, path)
    return fig
