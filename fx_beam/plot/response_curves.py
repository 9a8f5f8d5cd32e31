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

from .time_curves import Figure, curve, figure, quantities, save

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
    response: FrequencyResponse,
    path: Path | str | None = None,
    components: Sequence[str] | None = None,
) -> Figure:
    """Picture of amplitudes and phases over the frequency of the load.

    Amplitudes have a logarithmic scale, with a panel for each unit.

    Parameters
    ----------
    response : FrequencyResponse
        Result of `fx_beam.frequency_response`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    components : sequence of str, optional
        The components to draw, of `FrequencyResponse.names`; by default all that move.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    wanted = "what fx_beam.frequency_response returned"
    require(isinstance(response, FrequencyResponse), "response", response, wanted)
    if components is None:
        components = [name for name in response.names if response.component(name).any()]
    wanted = f"names to draw, of {list(response.names)}"
    fits = isinstance(components, Sequence) and not isinstance(components, str)
    require(fits and len(components) > 0, "components", components, wanted)
    values = {name: response.component(name) for name in components}
    units = {name: response.units[response.names.index(name)] for name in values}
    kinds = sorted(set(units.values()))
    fig, axes = figure(len(kinds) + 1, 1)
    for unit, ax in zip(kinds, axes[:, 0], strict=False):
        # Each curve has the same style in all panels; those of other units are empty here.
        shown = {
            name: abs(v) if units[name] == unit else np.full(len(v), np.nan)
            for name, v in values.items()
        }
        quantities(ax, response.frequencies, shown)
        ax.set(yscale="log", ylabel=f"amplitude [{unit}]")
    phases = {name: np.degrees(np.unwrap(np.angle(v))) for name, v in values.items()}
    last = axes[-1, 0]
    quantities(last, response.frequencies, phases)
    angles = np.concatenate(list(phases.values())) / 90
    first, end = np.floor(angles.min()), np.ceil(angles.max())
    last.set_yticks(90 * np.arange(first, end + 1, max(1, (end - first) // 4)))
    last.set(ylabel="phase [deg]", xlabel="frequency of the load [Hz]")
    low, high = response.frequencies.min(), response.frequencies.max()
    for ax in axes[:, 0] if 0 < 100 * low < high else ():
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
