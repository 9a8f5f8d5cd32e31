"""Picture of a work-precision study: error against run time, with a line for each scheme."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .accuracy import MARGIN
from .precision import Precision, Run

#: Smallest error drawn: an error of exactly 0 cannot be shown on a logarithmic axis.
_LEAST = 1e-17
_MARKERS = {1: "o", 2: "s", 3: "^"}


def draw(path: Path | str, found: Precision, quantity: str) -> None:
    """Draw errors against run time: all runs as pale points, and a line for each scheme.

    On the line a run is drawn at its assigned error, and as a pale point at its own error.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    figure, ((ax,),) = plot.figure(1, 1, height=4.6)
    ax.set(title=quantity, xlabel="run time [ms]", ylabel="largest relative error [-]")
    ax.set_yscale("log", subs=())
    ax.set_xscale("log", subs=(2, 5))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("{x:g}")
    looks = _looks(found, plot.style)
    for scheme, look in looks.items():
        front = found.front(quantity, scheme)
        ax.plot(*_places(front.runs, front.errors), label=scheme, **look)
        for run, error in zip(front.runs, front.errors, strict=True):
            ax.plot(*_places([run], [error]), **_point(run, look["color"]) | {"alpha": 1.0})
    drawn = [run for run in found.runs if run.errors.get(quantity, np.nan) <= 1]
    for run in drawn:
        ax.plot(*_places([run], [run.errors[quantity]]), **_point(run, looks[run.scheme]["color"]))
    for degree in found.degrees:
        dot = {"linestyle": "", "color": "0.5", "marker": _MARKERS[degree], "markersize": 4}
        ax.plot([], [], **dot, label=f"elements of degree {degree}")
    if any(run.lost for run in drawn):
        ax.plot([], [], **_LOST, color="0.5", label="lost: energy error above one half")
    _limit(ax, found, quantity, drawn)
    plot.save(figure, path)


def _looks(found: Precision, style) -> dict[str, dict]:
    """Line style of each scheme; the same scheme with another parameter gets another dotting."""
    names = {run.scheme: run.name for run in found.runs}
    looks: dict[str, dict] = {}
    for scheme, name in names.items():
        before = sum(names[other] == name for other in looks)
        looks[scheme] = style(name) | ({"linestyle": (0, (1, 1 + before))} if before else {})
    return looks


_LOST: dict[str, Any] = {"linestyle": "", "marker": "x", "markersize": 4}


def _point(run: Run, colour: str) -> dict[str, Any]:
    if run.lost:
        return _LOST | {"color": colour, "alpha": 0.5}
    marker = {"marker": _MARKERS[run.mesh.degree], "markersize": 4, "markeredgewidth": 0}
    return {"linestyle": "", "color": colour, "alpha": 0.45} | marker


def _places(runs: list[Run], errors: list[float]) -> tuple[list[float], list[float]]:
    return [1e3 * run.seconds for run in runs], [max(error, _LEAST) for error in errors]


def _limit(ax, found: Precision, quantity: str, drawn: list[Run]) -> None:
    """Axis limits, the range below the reference's error, and the schemes without a line."""
    errors = [max(run.errors[quantity], _LEAST) for run in drawn]
    floor, computed = found.floor(quantity), found.references[quantity] is not None
    low = min([*errors, floor if computed else 1.0])
    if computed:
        label = f"below {MARGIN:g} times the error of the reference"
        ax.axhspan(low / 10, floor, color="0.92", label=label)
    ax.set(ylim=(low / 3, 3 * max([*errors, 10 * low])))
    if none := [scheme for scheme in found.schemes if not found.front(quantity, scheme).runs]:
        text = "\n".join(["No line, as all runs are excluded:", *none])
        ax.text(0.02, 0.03, text, transform=ax.transAxes, fontsize=7, color="0.3")
