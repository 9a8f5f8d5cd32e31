"""Diagrams of the axial force, the shear force and the bending moment along the members."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fx_beam.results.fields import RESULTANTS, along
from fx_beam.results.files import replacing, writable
from fx_beam.results.solution import Solution
from fx_beam.validation import is_flag, is_name, require, shown

from .colouring import SIGNED, words_for
from .drawing import Drawing
from .supports import Supports

_PICTURES = "png", "pdf", "svg", "jpg"
_TALLEST = 0.15  # of a diagram, as a fraction of the picture's size
_PIECES = 8  # of an element
_NAMED = 12  # members up to which each has its extreme value written beside it


def diagrams(
    solution: Solution,
    row: int,
    path: Path | str | None = None,
    quantities: Sequence[str] = RESULTANTS,
    deformed: bool = True,
    scene_unit: str = "m",
) -> Figure:
    """Picture of the stress resultants along the members: a panel for N, Q and M each.

    A value is drawn normal to the axis: N and Q to the left of the beam's direction if they are
    positive, M on the side that is in tension. Positive areas are red and negative ones blue. The
    extreme value of each member is written beside it; in frames of more than 12 members those of
    the whole.

    Parameters
    ----------
    solution : Solution
        The motion, or the equilibria.
    row : int
        Row of `Solution.t`. In a motion the values are means over the step that ends there, see
        `Solution.t_level`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    quantities : sequence of {"N", "Q", "M"}
        The panels, from left to right.
    deformed : bool
        Whether the diagrams stand on the deformed members, or on those of the start.
    scene_unit : str
        Unit of length in which the scene is given, for labels; nothing is scaled.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ValueError
        For a row or quantities that the solution does not have, or one without beams.
    """
    path = None if path is None else writable(path, _PICTURES)
    Drawing(solution, [row], 1.0).check()
    if not solution.beams:
        raise ValueError("diagrams need beams, but the solution has none")
    names = [quantities] if isinstance(quantities, str) else list(quantities)
    if not names or any(name not in RESULTANTS for name in names):
        raise ValueError(
            f"quantities = {shown(quantities)} must be some of {', '.join(RESULTANTS)}"
        )
    require(is_flag(deformed), "deformed", deformed, "True or False")
    require(is_name(scene_unit), "scene_unit", scene_unit, "a text")
    drawing = Drawing(solution, [row], 1.0 if deformed else 0.0)
    low, high = drawing.window
    margin = 1.3 * _TALLEST * drawing.size
    low, high = low - margin, high + margin
    shape = (high[1] - low[1]) / (high[0] - low[0])
    size = 4.2 * len(names) + 0.4, 3.6 * min(max(shape, 0.4), 1.6) + 1.1
    fig = Figure(size, layout="constrained")
    for ax, name in zip(fig.subplots(1, len(names), squeeze=False).flat, names, strict=True):
        _panel(ax, drawing, name, row)
        ax.set_title(words_for(name, scene_unit), fontsize="medium")
        ax.set(xlabel=f"$x$ [{scene_unit}]", ylabel=f"$y$ [{scene_unit}]", aspect="equal")
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    static, t = solution.stats.static, solution.t_level[row]
    fig.suptitle(f"load factor {t:.4g}" if static else f"t = {t:.4g} s", fontsize="medium")
    if path is not None:
        with replacing(path) as new:
            fig.savefig(new, dpi=200, bbox_inches="tight")
    return fig


def _panel(ax, drawing: Drawing, quantity: str, row: int) -> None:
    """Draw one quantity along all members."""
    solution = drawing.solution
    fractions = np.linspace(0, 1, _PIECES + 1)
    values = {name: along(solution, name, quantity, [row], fractions)[0] for name in solution.beams}
    largest = max(abs(of).max() for of in values.values())
    scale = _TALLEST * drawing.size / (largest or 1.0)
    points = drawing.pieces(row, _PIECES).reshape(-1, _PIECES, 2, 2)
    # The ends of all pieces: their starts, and the end of the last one.
    points = np.concatenate([points[:, :, 0], points[:, -1:, 1]], axis=1)
    first = 0
    peaks = []
    for name, beam in solution.beams.items():
        own, of = points[first : first + beam.elements], values[name]
        first += beam.elements
        slopes = np.gradient(own, axis=1)
        left = np.stack([-slopes[..., 1], slopes[..., 0]], axis=-1)
        left /= np.linalg.norm(left, axis=-1, keepdims=True)
        tips = own + (-scale if quantity == "M" else scale) * of[..., None] * left
        for axis, tip, value in zip(own, tips, of, strict=True):
            _area(ax, axis, tip, value)
        for end in (0, 0), (-1, -1):
            ax.plot(*np.array([own[end], tips[end]]).T, color="0.3", linewidth=0.7, zorder=2)
        ax.plot(*own.reshape(-1, 2).T, color="black", linewidth=1.5, zorder=3)
        peak = np.unravel_index(abs(of).argmax(), of.shape)
        out = np.sign(of[peak]) * (-left if quantity == "M" else left)[peak]
        peaks.append((of[peak], tips[peak], out))
    if len(peaks) > _NAMED:
        peaks = [max(peaks, key=lambda one: one[0]), min(peaks, key=lambda one: one[0])]
    look = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
    for value, position, out in peaks:
        if abs(value) > 1e-9 * largest:
            words = f"{float(f'{value:.3g}'):g}"
            beside = position + 0.03 * drawing.size * out
            centred = {"ha": "center", "va": "center", "fontsize": "small", "zorder": 6}
            ax.annotate(words, beside, bbox=look, **centred)
    Supports(drawing).draw(ax, row)


def _area(ax, axis: np.ndarray, tips: np.ndarray, values: np.ndarray) -> None:
    """Area between the axis of an element and the values on it, split where the sign changes."""
    for sign, colour in (1, SIGNED(0.9)), (-1, SIGNED(0.1)):
        part = np.where((sign * values > 0)[:, None], tips, axis)
        corners = np.concatenate([axis, part[::-1]])
        ax.fill(*corners.T, facecolor=colour, alpha=0.45, linewidth=0, zorder=1)
    ax.plot(*tips.T, color="0.3", linewidth=0.7, zorder=2)
