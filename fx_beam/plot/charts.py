"""Charts: curves over time, frequency or load."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from numpy.typing import ArrayLike

from fx_beam.errors import array_of, check_takes, is_number, is_whole, positive, real_array, require
from fx_beam.results.export import replacing, writable
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse, PeriodicFamily
from fx_beam.scene.beam import Node

from .look import Look

# Colours of Okabe and Ito, safe for colour-blind eyes; line styles differ in grey prints.
STYLES: dict[str, dict] = {
    "EnergyMomentum": {"color": "#0072B2", "linestyle": "-", "linewidth": 2.4},
    "EnergyMomentum(order=4)": {"color": "#004b87", "linestyle": (0, (1, 1)), "linewidth": 2.0},
    "EnergyDecaying": {"color": "black", "linestyle": "-", "linewidth": 1.0},
    "ModifiedMidPoint": {"color": "#56B4E9", "linestyle": (0, (5, 2))},
    "MidPoint": {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    "Newmark": {"color": "#D55E00", "linestyle": (0, (6, 1.5, 1, 1.5))},
    "HHT": {"color": "#009E73", "linestyle": (0, (3, 1.2))},
    "GeneralizedAlpha": {"color": "#E69F00", "linestyle": (0, (6, 1, 1, 1, 1, 1))},
}
# Markers that distinguish curves of one line style in one panel, after the first, a plain line.
_MARKERS = "o", "s", "^", "D", "v"
QUANTITY_STYLES = cycler(
    color=("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "black"),
    linestyle=("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 3))),
)


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
    return {"linewidth": 1.2} | STYLES.get(scheme, {"color": "black", "linestyle": (0, (2, 2))})


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
        The panels of the figure.
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

    Each scheme has its own line style; further solutions by the same scheme have markers as well. A
    cross marks the end of a solution that failed. Set the limits of the axes first: if the curve
    ends outside them, its cross is drawn on the edge.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        The axes in which to draw.
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
    """Marker style of curve number 0, 1, ... with one line style."""
    if not number:
        return {}
    marker = _MARKERS[(number - 1) % len(_MARKERS)]
    markers = (0.03 * number, 0.12)
    return {"marker": marker, "markevery": markers, "fillstyle": "none", "markersize": 5}


def _looks() -> Iterator[dict]:
    """Styles of quantities one after the other; when all lines are used, with markers as well."""
    for number, look in enumerate(QUANTITY_STYLES()):
        yield look | _marked(number // len(QUANTITY_STYLES))


def quantities(axes, values: dict[str, np.ndarray], t: np.ndarray) -> None:
    """Draw several quantities over time, each with a style of its own.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        The axes in which to draw.
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
    for (label, row), look in zip(values.items(), _looks(), strict=False):
        y = curve(row, t, f"values[{label!r}]")
        axes.plot(t, y, label=label, linewidth=1.5, **look)


def _check(axes: object, curves: object, name: str) -> None:
    """Refuse axes that draw nothing, and curves without labels."""
    expected = "axes of matplotlib, such as fx_beam.plot.figure(1, 1)[1][0, 0]"
    require(isinstance(axes, Axes), "axes", axes, expected)
    require(isinstance(curves, Mapping), name, curves, "a dict by labels in the legend")


def curve(row: ArrayLike, t: np.ndarray, name: str) -> np.ndarray:
    """Values (n,) over times or load factors (n,)."""
    values = real_array(row)
    require(values.shape == t.shape, name, row, f"{t.size} numbers, one for each row or time")
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
    look: Look = {"loc": "outside upper center", "frameon": False, "handlelength": 3.2}
    figure.legend(handles.values(), handles.keys(), ncols=columns, **look)
    with replacing(writable(path, sorted(figure.canvas.get_supported_filetypes()))) as new:
        figure.savefig(new, dpi=200)


_STABLE: Look = {"color": "#0072B2", "linewidth": 2.0, "label": "stable"}
_UNSTABLE: Look = {"color": "#CC79A7", "linewidth": 1.2, "label": "unstable"}
_MARKS = {"limit point": "D", "bifurcation": "o", "flutter": "^"}
_MARKS |= {"contact": "s", "flow": "v", "kink": "X"}  # where the stiffness jumps


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
        The result of `fx_beam.frequency_response`, or several results by their labels.
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
    require(len(named) > 0, "responses", responses, "at least one")
    shown: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}
    for label, result in named.items():
        expected = "what fx_beam.frequency_response returned"
        require(isinstance(result, FrequencyResponse), "responses", result, expected)
        moving = [name for name in result.names if result.component(name).any()]
        names = moving if components is None else components
        expected = f"names to draw, of {list(result.names)}, of which {moving or 'none'} move"
        ok = isinstance(names, Sequence) and not isinstance(names, str)
        require(ok and len(names) > 0, "components", names, expected)
        for name in names:
            curve_label = name if not label else label if len(names) == 1 else f"{label}, {name}"
            unit = result.units[result.names.index(name)] if name in result.names else ""
            shown[curve_label] = unit, result.frequencies, result.component(name)
    kinds = sorted({unit for unit, _, _ in shown.values()})
    fig, axes = figure(len(kinds) + 1, 1)
    *amplitudes, last = axes[:, 0]
    for (label, (unit, f, values)), look in zip(shown.items(), _looks(), strict=False):
        draw = {"label": label, "linewidth": 1.5, "marker": "." if len(f) == 1 else "", **look}
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
        The result of `fx_beam.backbone` or `fx_beam.forced_response`, or several results by their
        labels.
    node : Node
        A node of the scene.
    component : {"x", "y", "rotation"}
        Component of the motion of the node.
    path : str or path, optional
        Picture to write; its ending gives the format.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.
    """
    named = families if isinstance(families, Mapping) else {"": families}
    for family in named.values():
        expected = "what fx_beam.backbone or fx_beam.forced_response returned"
        require(isinstance(family, PeriodicFamily), "response: families", family, expected)
    fig, axes = figure(1, 1, height=3.5)
    ax = axes[0, 0]
    for label, family in named.items():
        f, a, stable = family.frequencies, family.amplitudes(node, component), family.stable
        style = {"linestyle": "--", "color": "0.4"} if family.free else {"linewidth": 1.5}
        (line,) = ax.plot(f, a, label=label or None, **style)
        if not stable.all():
            name = "unstable" if not label else f"{label}, unstable"
            look = {"markersize": 4, "markerfacecolor": "white", "color": line.get_color()}
            ax.plot(f[~stable], a[~stable], "o", label=name, **look)
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

    Stable equilibria are on solid lines, unstable ones on dashed lines; critical points have marks,
    one for each kind.

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
    is_static = isinstance(solution, Solution) and solution.stats.static
    require(is_static, "solution", solution, "what fx_beam.static returned")
    check_takes(value, "solution", "value")
    require(is_number(load), "load", load, "a number")
    load = float(load)
    fig, axes = figure(1, 1, height=4.0)
    ax = axes[0, 0]
    marks: dict[str, list[tuple[float, float]]] = {kind: [] for kind in _MARKS}
    for branch in _all_of(solution):
        x, y, stable = _with_points(branch, value, marks)
        changes = np.flatnonzero(np.diff(stable)) + 1
        for first, last in itertools.pairwise(np.unique([0, *changes, len(stable)]).tolist()):
            line = x[first : last + 1], load * y[first : last + 1]
            if stable[first]:
                ax.plot(*line, **_STABLE)
            else:  # on white: branches that coincide would fill the gaps of the dashes
                ax.plot(*line, color="white", lw=2, zorder=1.5)
                ax.plot(*line, linestyle=(0, (3, 1.5)), zorder=1.5, **_UNSTABLE)
    for kind, points in marks.items():
        if points:
            xs, ys = np.array(points).T
            look = {"color": "#D55E00", "markersize": 5, "zorder": 4, "linestyle": ""}
            ax.plot(xs, load * ys, marker=_MARKS[kind], label=kind, **look)
    ax.set(xlabel=label, ylabel=load_label)
    return _saved(fig, path)


def _all_of(solution: Solution) -> Iterator[Solution]:
    """A path, its branches, branches of the branches, and so on."""
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
    points = [point for point in solution.critical_points if point.solution is not None]
    rows = [point.row for point in points]
    places = [(_values(value, point.solution)[-1], point.load_factor) for point in points]
    for point, place in zip(points, places, strict=True):
        marks[point.kind].append(place)
    # Between two points no equilibrium is known.
    pairs = itertools.pairwise([*rows, None])
    stable_after = [row != next_row and stable[row + 1] for row, next_row in pairs]
    order = np.argsort([*range(len(values)), *(row + 0.5 for row in rows)], kind="stable")
    x, y = np.array([*zip(values, factors, strict=True), *places])[order].T
    return x, y, np.array([*stable, *stable_after])[order][:-1]


def _values(value: Callable[[Solution], np.ndarray], solution: Solution) -> np.ndarray:
    """Values (n,) in the rows of a solution."""
    return curve(value(solution), solution.t, "value(solution)")


def _saved(fig: Figure, path: Path | str | None) -> Figure:
    if path is not None:
        save(fig, path)
    return fig
