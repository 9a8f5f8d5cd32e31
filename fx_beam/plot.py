"""Pictures of solutions: superposed shapes, animations, and schemes compared in curves."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pyvista as pv
from matplotlib.animation import PillowWriter
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from .beam import Node, lagrange
from .joints import GROUND, Joint
from .solution import Solution

# The colours of Okabe and Ito, which all eyes tell apart; the line styles do so in grey.
_STYLES: dict[str, dict] = {
    "EnergyMomentum": {"color": "#0072B2", "linestyle": "-", "linewidth": 2.4},
    "ModifiedMidPoint": {"color": "#56B4E9", "linestyle": (0, (5, 2))},
    "MidPoint": {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    "Newmark": {"color": "#D55E00", "linestyle": (0, (6, 1.5, 1, 1.5))},
    "HHT": {"color": "#009E73", "linestyle": (0, (3, 1.2))},
    "GeneralizedAlpha": {"color": "#E69F00", "linestyle": (0, (6, 1, 1, 1, 1, 1))},
}
# Without its palest end, which is hard to see on white.
_TIME_COLOURS = LinearSegmentedColormap.from_list(
    "time", matplotlib.colormaps["viridis"](np.linspace(0, 0.92, 256))
)
# What tells apart several curves of one scheme in one panel; the first is the plain line.
_MARKERS = None, "o", "s", "^", "D", "v"
_BEAM_COLOURS = "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
# A ring where two members turn, a square where they slide; rigid joints are not marked.
_JOINT_MARKERS = {"Revolute": "o", "Prismatic": "s", "PinInSlot": "s"}
_JOINT: dict[str, Any] = {"color": "white", "markeredgecolor": "black", "zorder": 5}
# Straight lines an element is drawn in: with 60 degrees in it, off by a thousandth of its radius.
_LINES = 12
_GUIDE: dict[str, Any] = {"color": "0.5", "linestyle": ":", "linewidth": 1.2, "zorder": 1}


# -- Curves ------------------------------------------------------------------------------------


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
    A cross marks the end of a solution that failed. Set the limits of the axes first: the cross of
    a curve that left them is put on their edge.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    solutions : dict
        Solutions by the label that each shall have in the legend.
    value : callable
        ``value(solution)`` gives the quantity (n,).
    times : callable
        ``times(solution)`` gives the times (n,) at which it holds [s], such as
        `Solution.t_level` for stress resultants.
    """
    drawn: dict[str, int] = {}
    cross = {"marker": "X", "markersize": 9, "markeredgecolor": "white", "linestyle": ""}
    for label, solution in solutions.items():
        scheme = solution.stats.scheme
        look = style(scheme) | _marked(drawn.get(scheme, 0))
        drawn[scheme] = drawn.get(scheme, 0) + 1
        t, y = times(solution), value(solution)
        axes.plot(t, y, label=label, **look)
        if solution.stats.failure and t[-1] <= axes.get_xlim()[1]:
            edge = np.clip(y[-1], *axes.get_ylim())
            axes.plot(t[-1], edge, **cross | {"color": look["color"]}, clip_on=False, zorder=5)
            # One entry for all: the same scheme may fail in one panel and not in another.
            axes.plot([], [], **cross | {"color": "0.4"}, label="a step fails, the run ends")


def _marked(number: int) -> dict:
    """Markers of the curve with this number among those of one scheme."""
    if not number:
        return {}
    marker = _MARKERS[1 + (number - 1) % (len(_MARKERS) - 1)]
    places = (0.03 * number, 0.12)
    return {"marker": marker, "markevery": places, "fillstyle": "none", "markersize": 5}


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure, with one legend for all its panels.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        A figure with labelled curves.
    path : str or path
        File to write; its ending says in which format.
    """
    handles: dict = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    columns = len(handles) if len(handles) < 4 else 2
    look = {"loc": "outside upper center", "frameon": False, "handlelength": 3.2}
    figure.legend(handles.values(), handles.keys(), ncols=columns, **look)
    figure.savefig(path, dpi=200)


# -- Shapes ------------------------------------------------------------------------------------


def axis(nodes: np.ndarray, degree: int) -> np.ndarray:
    """Points of a beam's axis for drawing: on the curves that elements of degree 2 and 3 are.

    Parameters
    ----------
    nodes : (..., elements * degree + 1, 2) float
        Positions of a beam's nodes, such as `Solution.shape` and `Modes.shape` give [m].
    degree : int
        Degree of its elements.

    Returns
    -------
    (..., points, 2) float
        Positions along the beam, the nodes among them [m].
    """
    if degree == 1:
        return nodes
    values = lagrange(np.linspace(0, 1, degree + 1), np.arange(_LINES) / _LINES)
    elements = (nodes.shape[-2] - 1) // degree
    of_element = degree * np.arange(elements)[:, None] + np.arange(degree + 1)
    points = values @ nodes[..., of_element, :]
    points = points.reshape(*nodes.shape[:-2], elements * _LINES, 2)
    return np.concatenate([points, nodes[..., -1:, :]], axis=-2)


def shapes(
    solution: Solution, steps: Sequence[int], path: Path | str, length_unit: str = "m"
) -> None:
    """Picture of deformed shapes, superposed and coloured by time or load factor.

    Discs are lumped masses; joints are white rings, or squares on a dotted guide where they slide.

    Parameters
    ----------
    solution : Solution
        The motion.
    steps : sequence of int
        Rows of `Solution.t` to draw.
    path : str or path
        Picture to write; its ending says in which format.
    length_unit : str
        Unit of length, for the axes.
    """
    low, high = _window(solution, steps)
    centre, size = (low + high) / 2, high - low
    times = solution.t[list(steps)]
    colours = ScalarMappable(Normalize(times.min(), times.max()), _TIME_COLOURS)

    window = [int(pixels) for pixels in 1600 * size / max(size)]
    plotter: Any = pv.Plotter(off_screen=True, window_size=window)
    plotter.set_background("white")
    radius = 0.0025 * max(size)
    for order, (k, t) in enumerate(zip(steps, times, strict=True)):
        for name in solution.beams:
            # Later shapes lie a little nearer to the eye, so that they cover earlier ones.
            points = np.insert(_axis(solution, name, k), 2, order * radius, axis=1)
            tube = pv.MultipleLines(points).tube(radius=radius)
            plotter.add_mesh(tube, color=colours.to_rgba(t)[:3], ambient=0.3, smooth_shading=True)
    plotter.view_xy()
    plotter.enable_parallel_projection()
    plotter.camera.focal_point = (*centre, 0.0)
    plotter.camera.position = (*centre, 10 * max(size))
    plotter.camera.parallel_scale = size[1] / 2
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    picture = plotter.screenshot(return_img=True)
    plotter.close()

    # The projection is parallel, so that matplotlib's axes fit the picture exactly.
    fig, ax = _plane(low, high, length_unit, width=6.4)
    ax.imshow(picture, extent=(low[0], high[0], low[1], high[1]), interpolation="antialiased")
    for k, t in zip(steps, times, strict=True):
        _draw_step(ax, solution, k, colours.to_rgba(t))
    _draw_supports(ax, solution)
    label = "load factor" if solution.stats.static else "time $t$ [s]"
    fig.colorbar(colours, cax=ax.inset_axes((1.03, 0, 0.03, 1)), label=label)
    fig.savefig(path, dpi=200, bbox_inches="tight")


def animate(
    solution: Solution,
    steps: Sequence[int],
    path: Path | str,
    fps: int = 20,
    trace: Node | None = None,
    length_unit: str = "m",
) -> None:
    """Animation of the motion as a GIF.

    Parameters
    ----------
    solution : Solution
        The motion.
    steps : sequence of int
        Rows of `Solution.t`, one for each picture.
    path : str or path
        GIF file to write.
    fps : int
        Pictures per second [1/s].
    trace : Node, optional
        Node whose path is drawn.
    length_unit : str
        Unit of length, for the axes.
    """
    low, high = _window(solution, steps)
    flat = high[0] - low[0] > 1.6 * (high[1] - low[1])
    fig, ax = _plane(low, high, length_unit, width=7.0 if flat else 5.0)
    _draw_supports(ax, solution)
    clock = ax.set_title(" ", loc="left", family="monospace", fontsize="medium")
    (past,) = ax.plot([], [], color="0.65", linewidth=1.0, zorder=1)
    colours = itertools.cycle(_BEAM_COLOURS)
    lines = {
        name: ax.plot([], [], color=colour, linewidth=2.5)[0]
        for name, colour in zip(solution.beams, colours, strict=False)
    }
    (masses,) = ax.plot([], [], "o", color="#D55E00", markersize=9, zorder=4)
    guides = [(joint, ax.plot([], [], **_GUIDE)[0]) for joint in _guided(solution)]
    joints = {
        marker: ax.plot([], [], marker, **_JOINT, markersize=5)[0]
        for marker in _JOINT_MARKERS.values()
    }

    writer = PillowWriter(fps)
    with writer.saving(fig, str(path), dpi=100):
        for k in steps:
            now = f"{solution.t[k]:.3f}"
            clock.set_text(f"load factor {now}" if solution.stats.static else f"t = {now} s")
            for name, line in lines.items():
                line.set_data(*_axis(solution, name, k).T)
            masses.set_data(*_masses(solution, k).T)
            for joint, guide in guides:
                guide.set_data(*_guide(solution, joint, k).T)
            for marker, places in joints.items():
                places.set_data(*_joints(solution, k, marker).T)
            if trace is not None:
                past.set_data(*solution.position(trace)[steps[0] : k + 1].T)
            writer.grab_frame()
            # The layout of the first picture is that of all.
            fig.set_layout_engine("none")


def _axis(solution: Solution, name: str, rows) -> np.ndarray:
    """Points (..., points, 2) of a beam's axis in some rows."""
    return axis(solution.shape(name)[rows], solution.beams[name].degree)


def _scene(solution: Solution):
    """The scene of a solution; None for one that was read from a file."""
    return next(iter(solution.beams.values())).start.scene


def _masses(solution: Solution, k: int) -> np.ndarray:
    """Places (masses, 2) of the lumped masses in row k."""
    scene = _scene(solution)
    heavy = sorted({node for node, mass, _ in scene.masses if mass}) if scene else []
    return solution.X[heavy] + solution.q[k, heavy, :2]


def _joints(solution: Solution, k: int, marker: str) -> np.ndarray:
    """Places (joints, 2) in row k of the joints that bear a marker; hinges on the ground do not."""
    nodes = []
    for joint in _joints_of(solution):
        grounded = GROUND in (joint.a, joint.b)
        if _JOINT_MARKERS.get(joint.kind) == marker and not (grounded and joint.axis is None):
            nodes.append((joint.a if joint.b is GROUND else joint.b).number)
    return solution.X[nodes] + solution.q[k, nodes, :2]


def _joints_of(solution: Solution) -> list[Joint]:
    scene = _scene(solution)
    return scene.joints if scene else []


def _guided(solution: Solution) -> list[Joint]:
    """The joints whose guide is carried by a node."""
    return [
        joint
        for joint in _joints_of(solution)
        if joint.axis is not None and GROUND not in (joint.a, joint.b)
    ]


def _guide(solution: Solution, joint: Joint, k: int) -> np.ndarray:
    """Ends (2, 2) in row k of a guide from its node to what slides on it."""
    psi = solution.rotation(joint.a)[k]
    turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
    place = solution.position(joint.a)[k] + turn @ joint.offset
    return np.array([place, solution.position(joint.b)[k]])


def _draw_step(ax, solution: Solution, k: int, colour) -> None:
    """Masses, guides and joints of one of several superposed shapes."""
    for joint in _guided(solution):
        ax.plot(*_guide(solution, joint, k).T, **_GUIDE | {"color": colour})
    ax.plot(*_masses(solution, k).T, "o", color=colour, markersize=7, zorder=3)
    look = _JOINT | {"markeredgecolor": colour, "markersize": 3.5, "zorder": 4}
    for marker in set(_JOINT_MARKERS.values()):
        ax.plot(*_joints(solution, k, marker).T, marker, **look)


def _window(solution: Solution, steps: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of all that is drawn, with a margin."""
    rows = list(steps)
    points = np.concatenate([_axis(solution, name, rows) for name in solution.beams], axis=1)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    margin = 0.05 * max(high - low)
    return low - margin, high + margin


def _plane(low: np.ndarray, high: np.ndarray, length_unit: str, width: float):
    """Figure with equal axes over a window of the plane."""
    size = high - low
    # Labels and a colour bar take about a seventh of the width.
    fig = Figure((width, 0.86 * width * size[1] / size[0] + 0.5), layout="constrained")
    ax = fig.add_subplot()
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.set(xlabel=f"$x$ [{length_unit}]", ylabel=f"$y$ [{length_unit}]")
    return fig, ax


def _draw_supports(ax, solution: Solution) -> None:
    """A ring at a pin, a square at a clamp, a triangle at any other support; guides dotted."""
    scene = _scene(solution)
    if scene is None:
        return
    held: dict[int, set[int]] = {}
    for node, component in scene.fixed:
        held.setdefault(node, set()).add(component)
    for joint in scene.joints:
        if GROUND in (joint.a, joint.b):
            node = joint.a if joint.b is GROUND else joint.b
            if joint.axis is None:
                held[node.number] = {0, 1} if joint.kind == "Revolute" else {0, 1, 2}
            else:
                path = solution.position(node)
                along = (path - path[0]) @ joint.axis
                ax.plot(*path[[along.argmin(), along.argmax()]].T, **_GUIDE)
    for node, components in held.items():
        marker = "s" if len(components) == 3 else "o" if components == {0, 1} else "^"
        look = {"color": "white", "markeredgecolor": "black", "markersize": 7}
        ax.plot(*solution.X[node], marker, **look, zorder=5)
