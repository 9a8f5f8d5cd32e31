"""Picture that answers which scheme or degree to take: a line for each, named at its end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fx_beam import plot
from fx_beam.studies.work_precision.accuracy import Precision, Run, counted, floor

# Differences of looks that remain in grey: markers, and dashes.
_LOOKS = [
    ("#0072B2", "o", "-"),
    ("#004b87", "s", (0, (1, 1))),
    ("#000000", "^", "-"),
    ("#56B4E9", "D", (0, (5, 2))),
    ("#CC79A7", "v", (0, (1, 1))),
    ("#D55E00", "P", (0, (6, 1.5, 1, 1.5))),
    ("#009E73", "X", (0, (3, 1.2))),
    ("#E69F00", "*", (0, (6, 1, 1, 1, 1, 1))),
]
_APART = 0.065  # least distance of names, as a fraction of the panel's height
_ROW = 0.075  # height of a row of lost runs


def front(study: Precision, quantity: str, runs: list[Run]) -> np.ndarray:
    """Times of the steps [ms] and errors (n, 2) of runs that err less than all faster ones."""
    points = sorted((1e3 * run.step_seconds, counted(study, quantity, run)) for run in runs)
    kept: list[tuple[float, float]] = []
    for time, error in points:
        if np.isfinite(time) and error <= 1 and (not kept or error < kept[-1][1]):
            kept.append((time, error))
    return np.array(kept).reshape(-1, 2)


def draw_fronts(
    path: Path, title: str, study: Precision, quantity: str, kind: Callable[[Run], str]
) -> None:
    """Draw one line for each kind of run, such as its scheme: the best errors over the run time.

    Kinds of which runs are lost stand above, at the times of these runs.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    kinds: dict[str, list[Run]] = {}
    for run in study.runs:
        kinds.setdefault(kind(run), []).append(run)
    lines = {name: front(study, quantity, runs) for name, runs in kinds.items()}
    lost = {name: [run for run in runs if run.lost] for name, runs in kinds.items()}
    lost = {name: runs for name, runs in lost.items() if runs}
    known = floor(study, quantity) if study.references[quantity] is not None else None

    figure, axes = plot.figure(1, 1, height=3.2 + 0.22 * len(lost))
    ax = axes[0, 0]
    ax.set(xscale="log", yscale="log")
    looks = dict(zip(kinds, _LOOKS * 4, strict=False))
    ends = []
    for name, points in lines.items():
        if len(points):
            colour, marker, dashes = looks[name]
            style = {"color": colour, "marker": marker, "linestyle": dashes, "markersize": 4.5}
            ax.plot(*points.T, linewidth=1.6, **style)
            ends.append((*points[-1], name))
    low = min((error for *_, error in (p for of in lines.values() for p in of)), default=1e-3)
    bottom = 10 ** np.floor(np.log10(min(low, known or low) / 1.5))
    decades = -np.log10(bottom) / (1 - _ROW * (len(lost) + 0.5))
    top = bottom * 10**decades
    for row, (name, runs) in enumerate(lost.items(), 1):
        times = [1e3 * run.step_seconds for run in runs if np.isfinite(run.step_seconds)]
        height = 10 ** (row * _ROW * decades)
        colour, marker, _ = looks[name]
        ax.plot(times, [height] * len(times), "x", color=colour, markersize=4)
        words = f"  {name}: {len(runs)} of {len(kinds[name])} lost"
        ax.annotate(words, (max(times, default=1.0), height), va="center", fontsize=8, color=colour)
    if lost:
        ax.axhline(1, color="0.6", linewidth=0.8)
    if known is not None:
        ax.axhspan(bottom, known, color="0.92")
        ax.annotate(
            "errors are not known here",
            (0.01, known),
            xycoords=("axes fraction", "data"),
            va="top",
            fontsize=8,
            color="0.4",
        )
    ax.set_ylim(bottom, top)
    times = [time for of in lines.values() for time, _ in of]
    times += [1e3 * run.step_seconds for runs in lost.values() for run in runs]
    times = [time for time in times if np.isfinite(time)]
    if times:
        # Space at the right for names.
        ax.set_xlim(min(times) / 1.3, max(times) * (max(times) / min(times)) ** 0.35 * 1.6)
    ax.set_xticks(ticks := _ticks(*ax.get_xlim()), [f"{tick:g}" for tick in ticks])
    ax.minorticks_off()
    ax.set_yticks(
        shown := 10.0 ** np.arange(np.log10(bottom), 0.5, max(1, -np.log10(bottom) // 6)),
        [f"$10^{{{int(round(np.log10(tick)))}}}$" for tick in shown],
    )
    _name_ends(ax, ends, looks, bottom, decades)
    ax.set(xlabel="processor time of the steps [ms]", ylabel="largest relative error [-]")
    ax.set_title(title, fontsize=10, loc="left")
    plot.save(figure, path)


def _ticks(low: float, high: float) -> np.ndarray:
    """Ticks at 1, 2 and 5, or at powers of ten where these are many."""
    ticks = np.outer(10.0 ** np.arange(-6, 7), (1, 2, 5)).ravel()
    inside = ticks[(ticks >= low) & (ticks <= high)]
    return inside if len(inside) < 8 else np.array([x for x in inside if f"{x:e}"[0] == "1"])


def _name_ends(ax, ends, looks, bottom: float, decades: float) -> None:
    """Write names right of the ends of lines, moved apart where they would overlap."""
    right = max((time for time, *_ in ends), default=1.0)
    ends = sorted(ends, key=lambda end: end[1])
    heights = [np.log10(error / bottom) / decades for _, error, _ in ends]
    for (time, error, name), height in zip(ends, _apart(heights), strict=True):
        at = (right * 1.25, bottom * 10 ** (height * decades))
        line = {"arrowstyle": "-", "color": "0.7", "linewidth": 0.6, "relpos": (0, 0.5)}
        text = {"va": "center", "fontsize": 8.5, "color": looks[name][0]}
        ax.annotate(name, (time, error), at, arrowprops=line | {"shrinkB": 3}, **text)


def _apart(heights: list[float]) -> list[float]:
    """Sorted heights, moved apart by the least distance: groups stay about their mean."""
    groups: list[list[float]] = []
    for height in heights:
        groups.append([height])
        while len(groups) > 1 and _low(groups[-1]) < _high(groups[-2]) + _APART:
            groups[-2:] = [groups[-2] + groups[-1]]
    return [_low(group) + _APART * k for group in groups for k in range(len(group))]


def _low(group: list[float]) -> float:
    return max(float(np.mean(group)) - _APART * (len(group) - 1) / 2, 0.02)


def _high(group: list[float]) -> float:
    return _low(group) + _APART * (len(group) - 1)
