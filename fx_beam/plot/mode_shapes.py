"""Mode shapes, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fx_beam.errors import is_whole, require
from fx_beam.results.vibrations import Modes
from fx_beam.scene.body import Body

from .drawing import Drawing, three_digits
from .sheet import panels, picture, written
from .symbols import Supports, draw_between, draw_bodies, draw_hinges, draw_lines

_MODE = "#0072B2"
_SIZE = 0.15  # largest displacement, as a fraction of the scene's size
_BORDER = np.array((0.0, 0.3))  # of a panel, for its title [inch]
# Rows of a vibration.
_AT_REST, _MOVED, _LATER = range(3)


def modes(modes: Modes, path: Path | str | None = None, count: int | None = None) -> Figure:
    """Picture of mode shapes, side by side, over the configuration to which they belong.

    Where the nodes of a mode do not move in phase, because of dampers, a dashed line is the shape a
    quarter of the period later. Supports are drawn where they are at rest.

    Parameters
    ----------
    modes : Modes
        Result of `fx_beam.modes`.
    path : str or path, optional
        Picture to write; its ending gives the format.
    count : int, optional
        Number of modes to draw, from the lowest; all by default.

    Returns
    -------
    matplotlib.figure.Figure
        The picture, with a panel for each mode. Their titles have its number, from 0 as in `Modes`,
        and its frequency.
    """
    path = picture(path)
    require(isinstance(modes, Modes), "modes", modes, "what fx_beam.modes returned")
    count = len(modes) if count is None else count
    wanted = f"from 1 to {len(modes)}, the number of modes"
    require(is_whole(count, 1, len(modes)), "count", count, wanted)
    count = int(count)
    at_rest = Drawing(Vibration(modes, 0, 0.0), [_AT_REST])
    size = _SIZE * at_rest.reach
    low, high = at_rest.window
    low, high = low - size, high + size
    fig, _, _ = panels(count, high - low, _BORDER)
    for mode, ax in enumerate(fig.axes):
        ax.axis("off")
        ax.set_title(f"mode {mode}: {_kind(modes, mode)}", fontsize="small")
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        _draw(ax, Drawing(Vibration(modes, mode, size), [_AT_REST]))
    return written(fig, path)


class Vibration:
    """A mode in the form of a solution with three rows: at rest, moved, a quarter period later."""

    contacts = ()

    def __init__(self, modes: Modes, mode: int, size: float):
        self.modes, self.mode, self.X = modes, mode, modes.positions
        #: Displacements (3, n_node, 3), without rotations.
        self.q = np.zeros((3, len(self.X), 3))
        parts: list[tuple[str | Body, Any]] = list(modes.nodes_of_beam.items())
        parts += [(body, [node.number for node in body.nodes]) for body in modes.bodies.values()]
        for part, nodes in parts:
            for row, phase in (_MOVED, 0.0), (_LATER, np.pi / 2):
                self.q[row, nodes, :2] = modes.shape(part, mode, size, phase) - self.X[nodes]

    def __getattr__(self, name: str):
        """The beams, bodies and nodes are those of the modes."""
        return getattr(self.modes, name)


def _draw(ax, drawing: Drawing) -> None:
    vibration = drawing.solution
    of_mode = vibration.shapes[vibration.mode]
    looks: dict[int, dict[str, Any]] = {
        _AT_REST: {"color": "0.7", "linewidth": 1.0},
        _MOVED: {"color": _MODE},
    }
    if abs(of_mode.imag).max() > 0.01 * abs(of_mode).max():
        looks[_LATER] = {"color": _MODE, "linewidth": 1.0, "linestyle": "--"}
    for row, look in looks.items():
        lines = [drawing.axis(name, row) for name in vibration.nodes_of_beam]
        draw_lines(ax, lines, **{"linewidth": 2.0 * drawing.thinness, "zorder": 2} | look)
        if row != _LATER:
            draw_bodies(ax, drawing, row, look["color"], small=True)
    draw_between(ax, drawing, _MOVED)
    draw_hinges(ax, drawing, _MOVED)
    Supports(drawing).draw(ax, _AT_REST)


def _kind(modes: Modes, mode: int) -> str:
    """Frequency of a mode in words."""
    if modes.unstable[mode]:
        return f"unstable, grows with {three_digits(modes.eigenvalues[mode].real)} 1/s"
    if not modes.eigenvalues[mode] and not modes.rigid[mode]:
        return "of a critical point"
    ratio, frequency = modes.damping_ratios[mode], abs(modes.frequencies[mode])
    kind = "rigid" if modes.rigid[mode] else f"{three_digits(frequency)} Hz"
    return kind + (f", ratio {three_digits(ratio)}" if ratio else "")
