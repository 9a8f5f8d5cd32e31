"""Picture of a work-precision study: error against run time, with a line for each scheme."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .accuracy import MARGIN
from .precision import Precision, Run, counted, floor

CLOCKS = {"seconds": "whole call of simulate", "step_seconds": "steps alone"}
_MARKERS = {1: "o", 2: "s", 3: "^"}
_BROKE_OFF, _LOST, _LARGE = "x", "+", "v"


def draw(path: Path, panels: Sequence[tuple[str, Precision, str]], clock: str) -> None:
    """Draw panels of title, study and quantity: errors against one of the `CLOCKS`.

    All runs are pale points; a line joins the runs of a scheme that are more accurate than all
    faster ones. Runs that broke off or err by more than 1 stand at the top margin, in a row of
    their scheme.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    rows = -(-len(panels) // 2)
    figure, axes = plot.figure(rows, min(len(panels), 2), height=4.2 if rows == 1 else 3.0)
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax, (title, found, quantity) in zip(axes.flat, panels, strict=False):
        _panel(ax, found, quantity, clock, _looks(found, plot.style))
        ax.set_title(title, fontsize=8, loc="left")
    for ax in axes.flat[max(len(panels) - 2, 0) : len(panels)]:
        ax.set_xlabel(f"{CLOCKS[clock]} [ms]", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("largest relative error [-]", fontsize=8)
    plot.save(figure, path)


def _panel(ax, found: Precision, quantity: str, clock: str, looks: dict[str, dict]) -> None:
    known, computed = floor(found, quantity), found.references[quantity] is not None
    runs = [(r, 1e3 * getattr(r, clock), r.errors.get(quantity, np.nan)) for r in found.runs]
    inside = [max(error, known) for _, _, error in runs if error <= 1]
    least = np.nanmin([0.1, *inside, *([known] if computed else [])])
    bottom = int(np.floor(np.log10(least / 1.5)))
    margin = dict.fromkeys(run.scheme for run, _, error in runs if not error <= 1)
    heights = {scheme: 10 ** (-0.07 * bottom * k) for k, scheme in enumerate(margin, 1)}
    for scheme, look in looks.items():
        own = [(time, counted(found, quantity, r)) for r, time, _ in runs if r.scheme == scheme]
        line = [(time, error) for time, error in sorted(own) if error <= 1]
        front = [p for k, p in enumerate(line) if all(p[1] < q[1] for q in line[:k])]
        ax.plot(*np.array(front).reshape(-1, 2).T, label=scheme, **look)
    for run, time, error in runs:
        at = max(error, known) if error <= 1 else heights[run.scheme]
        fill = "none" if error < known else "full"
        point = {"color": looks[run.scheme]["color"], "fillstyle": fill, "markersize": 4}
        ax.plot(time, at, _marker(run, error), alpha=0.5, **point)
    used = {_marker(run, error) for run, _, error in runs}
    for marker, label in _LABELS.items():
        if marker in used:
            ax.plot([], [], marker, color="0.5", markersize=4, label=label)
    if computed:
        label = f"not known: below {MARGIN:g} times the error of the reference"
        ax.axhspan(10.0**bottom, known, color="0.92", label=label)
    _axes(ax, bottom, heights, [time for _, time, _ in runs if np.isfinite(time)])


def _looks(found: Precision, style) -> dict[str, dict]:
    """Line style of each scheme; the same scheme with another parameter gets another dotting."""
    names = {run.scheme: run.name for run in found.runs}
    looks: dict[str, dict] = {}
    for scheme, name in names.items():
        before = sum(names[other] == name for other in looks)
        looks[scheme] = style(name) | ({"linestyle": (0, (1, 1 + before))} if before else {})
    return looks


def _marker(run: Run, error: float) -> str:
    if run.failure:
        return _BROKE_OFF
    return _LARGE if not error <= 1 else _LOST if run.lost else _MARKERS[run.mesh.degree]


_LABELS = {marker: f"elements of degree {degree}" for degree, marker in _MARKERS.items()} | {
    _LOST: "lost: energy error above one half",
    _BROKE_OFF: "broke off",
    _LARGE: "error above 1, or none",
}


def _axes(ax, bottom: int, heights: dict[str, float], times: list[float]) -> None:
    """Ticks at 1, 2 and 5 on the time axis; at powers of ten and margin rows on the other.

    The time axis ends at ticks, so that it always has two or more.
    """
    ax.set(xscale="log", yscale="log")
    ticks = [m * 10.0**k for k in range(-7, 7) for m in (1, 2, 5)]
    first = bisect.bisect(ticks, min(times, default=1) / 1.1) - 1
    last = bisect.bisect(ticks, max(times, default=1) * 1.1)
    ax.set_xlim(ticks[first], ticks[last])
    ticks = [x for x in ticks[first : last + 1] if last - first < 8 or f"{x:e}"[0] == "1"]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    decades = range(0, bottom - 1, -max(1, -bottom // 6))
    labels = [f"$10^{{{k}}}$" for k in decades] + [scheme.split(" (")[0] for scheme in heights]
    ax.set_yticks([10.0**k for k in decades] + list(heights.values()), labels)
    ax.tick_params(labelsize=6.5)
    ax.minorticks_off()
    ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_ylim(10.0**bottom, 10 ** (-0.07 * bottom * (len(heights) + 0.9)))
