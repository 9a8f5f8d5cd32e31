"""Picture of a work-precision study: error against run time, with a line for each scheme."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .accuracy import MARGIN, Precision, Run, counted, floor

CLOCKS = {"seconds": "whole call of simulate", "step_seconds": "steps alone"}
_MARKERS = {
    "o": "elements of degree 1",
    "s": "elements of degree 2",
    "^": "elements of degree 3",
    "+": "lost: energy error above one half",
    "x": "broke off",
    "v": "error above 1, or none",
}


def draw(path: Path, panels: Sequence[tuple[str, Precision, str]], clock: str) -> None:
    """Draw panels of title, study and quantity: errors against one of the `CLOCKS`.

    All runs are pale points; a line joins the runs of a scheme that are more accurate than all
    faster ones. Runs that broke off or err by more than 1 stand at the top, a row for each scheme.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    rows = -(-len(panels) // 2)
    figure, axes = plot.figure(rows, min(len(panels), 2), height=4.2 if rows == 1 else 3.0)
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax, (title, study, quantity) in zip(axes.flat, panels, strict=False):
        _panel(ax, study, quantity, clock, plot.style)
        ax.set_title(title, fontsize=8, loc="left")
    for ax in axes.flat[max(len(panels) - 2, 0) : len(panels)]:
        ax.set_xlabel(f"{CLOCKS[clock]} [ms]", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("largest relative error [-]", fontsize=8)
    plot.save(figure, path)


def _panel(ax, study: Precision, quantity: str, clock: str, style) -> None:
    known, computed = floor(study, quantity), study.references[quantity] is not None
    runs = [(r, 1e3 * getattr(r, clock), r.errors.get(quantity, np.nan)) for r in study.runs]
    inside = [max(error, known) for _, _, error in runs if error <= 1]
    bottom = int(np.log10(np.nanmin([0.1, *inside, known if computed else 0.1]) / 1.5) // 1)
    astray = dict.fromkeys(run.scheme for run, _, error in runs if not error <= 1)
    heights = {scheme: 10 ** (-0.07 * bottom * k) for k, scheme in enumerate(astray, 1)}
    looks: dict[str, dict] = {}
    used: list[str] = []
    for scheme, name in {run.scheme: run.name for run in study.runs}.items():
        looks[scheme] = style(name)
        if name in used:  # with another parameter: another dotting
            looks[scheme] |= {"linestyle": (0, (1, 1 + used.count(name)))}
        used.append(name)
        own = sorted((t, counted(study, quantity, r)) for r, t, _ in runs if r.scheme == scheme)
        front = [p for k, p in enumerate(own) if p[1] <= 1 and all(p[1] < q[1] for q in own[:k])]
        ax.plot(*np.array(front).reshape(-1, 2).T, label=scheme, **looks[scheme])
    for run, time, error in runs:
        at = max(error, known) if error <= 1 else heights[run.scheme]
        fill = "none" if error < known else "full"
        point = {"color": looks[run.scheme]["color"], "fillstyle": fill, "markersize": 4}
        ax.plot(time, at, _marker(run, error), alpha=0.5, **point)
    drawn = {_marker(run, error) for run, _, error in runs}
    for marker, label in _MARKERS.items():
        if marker in drawn:
            ax.plot([], [], marker, color="0.5", markersize=4, label=label)
    if computed:
        label = f"not known: below {MARGIN:g} times the error of the reference"
        ax.axhspan(10.0**bottom, known, color="0.92", label=label)
    _axes(ax, bottom, heights, np.array([time for _, time, _ in runs if np.isfinite(time)]))


def _marker(run: Run, error: float) -> str:
    if run.failure or not error <= 1:
        return "x" if run.failure else "v"
    return "+" if run.lost else "os^"[run.mesh.degree - 1]


def _axes(ax, bottom: int, heights: dict[str, float], times: np.ndarray) -> None:
    """Ticks at 1, 2 and 5 on the time axis; at powers of ten and margin rows on the other.

    The time axis ends at ticks, so that it always has two or more.
    """
    ax.set(xscale="log", yscale="log")
    ticks = np.outer(10.0 ** np.arange(-7, 7), (1, 2, 5)).ravel()
    first, last = np.searchsorted(ticks, (min(times, default=1) / 1.1, max(times, default=1) * 1.1))
    ax.set_xlim(ticks[first - 1], ticks[last])
    shown = [x for x in ticks[first - 1 : last + 1] if last - first < 7 or f"{x:e}"[0] == "1"]
    ax.set_xticks(shown, [f"{tick:g}" for tick in shown])
    decades = range(0, bottom - 1, -max(1, -bottom // 6))
    labels = [f"$10^{{{k}}}$" for k in decades] + [scheme.split(" (")[0] for scheme in heights]
    ax.set_yticks([10.0**k for k in decades] + list(heights.values()), labels)
    ax.tick_params(labelsize=6.5)
    ax.minorticks_off()
    ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_ylim(10.0**bottom, 10 ** (-0.07 * bottom * (len(heights) + 0.9)))
