"""A study of stability in words, tables, a heat map and curves."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from . import report
from .cell import Cell
from .verdict import BLOWN_UP, KEPT, KINDS, Verdict

#: Colours of the verdicts: pale where nothing is lost, dark where all is.
COLOURS = {
    "kept": "#CFE6F4",
    "lost": "#F6E7A1",
    "gained": "#F2B48A",
    "blew up": "#C8460B",
    "failed": "#6E6E6E",
}
_ON_DARK = "blew up", "failed"
# Cases, and gaps between their groups, side by side in the heat map; letters over each.
_SLOTS, _LETTERS = 27, 7
#: Cases whose curves are drawn.
TELLING = 6


def write(path: Path | str, cells: list[Cell], title: str, remarks: str = "") -> None:
    """Write a study as JSON, as a Markdown page and as the pictures in it.

    Parameters
    ----------
    path : str or path
        Files to write, without their endings.
    cells : list of Cell
        A study.
    title : str
        What was studied.
    remarks : str
        What else the page shall say, in Markdown.
    """
    path = Path(path)
    machine = report.machine()
    report.write_json(path.with_suffix(".json"), {"machine": machine, **numbers(cells)})
    page = markdown(path.name, cells, title, machine, remarks)
    path.with_suffix(".md").write_text(page, "utf-8")
    _draw_map(path.with_suffix(".png"), cells)
    _draw_curves(path.with_name(f"{path.name}_curves.png"), telling(cells))


def numbers(cells: list[Cell]) -> dict[str, Any]:
    """Everything found.

    Parameters
    ----------
    cells : list of Cell
        A study.

    Returns
    -------
    dict
        For a file.
    """
    return {
        "criteria": {"kept": KEPT, "blew up": BLOWN_UP},
        "verdicts": counts(cells),
        "cells": [
            {
                "group": cell.case.group,
                "case": cell.case.label,
                "dt": cell.case.dt,
                "t_end": cell.case.t_end,
                "judged from": cell.case.start,
                "scheme": cell.scheme,
                **asdict(cell.verdict),
                "seconds": cell.seconds,
                "drift": cell.drift and asdict(cell.drift),
            }
            for cell in cells
        ],
    }


def counts(cells: list[Cell]) -> dict[str, dict[str, float]]:
    """How often each scheme had each verdict, and the most that it gained where it ended.

    Parameters
    ----------
    cells : list of Cell
        A study.

    Returns
    -------
    dict
        By scheme, the number of each verdict, and "largest gain".
    """
    found = {}
    for scheme in dict.fromkeys(cell.scheme for cell in cells):
        verdicts = [cell.verdict for cell in cells if cell.scheme == scheme]
        kinds = Counter(verdict.kind for verdict in verdicts)
        gains = [verdict.gain for verdict in verdicts if not np.isnan(verdict.highest)]
        found[scheme] = {kind: kinds[kind] for kind in KINDS} | {"largest gain": max(gains)}
    return found


def telling(cells: list[Cell]) -> list[list[Cell]]:
    """Cases on which the schemes differ most, one of each group.

    First those with the most different verdicts, then those with the widest range of the worst
    energy ratio in powers of ten.

    Parameters
    ----------
    cells : list of Cell
        A study.

    Returns
    -------
    list of lists of Cell
        All schemes of each of these cases.
    """
    best: dict[str, tuple[tuple[int, float], list[Cell]]] = {}
    for case in _cases(cells):
        worst = [np.clip(cell.verdict.worst, 1e-16, 1e16) for cell in case]
        worst = [value for value in worst if not np.isnan(value)]
        spread = float(np.ptp(np.log10(worst))) if worst else 0.0
        score = len({cell.verdict.kind for cell in case}), spread
        group = case[0].case.group
        if group not in best or score > best[group][0]:
            best[group] = score, case
    ranked = sorted(best.values(), key=lambda entry: entry[0], reverse=True)
    return [case for _, case in ranked[:TELLING]]


# -- Words ---------------------------------------------------------------------------------------


def markdown(
    name: str, cells: list[Cell], title: str, machine: dict[str, Any], remarks: str = ""
) -> str:
    """Page on a study.

    Parameters
    ----------
    name : str
        Name of the pictures.
    cells : list of Cell
        A study.
    title : str
        What was studied.
    machine : dict
        What `report.machine` gives.
    remarks : str
        What else to say, in Markdown.

    Returns
    -------
    str
        The page, in Markdown.
    """
    schemes = list(dict.fromkeys(cell.scheme for cell in cells))
    header = ["scheme", *KINDS, "largest gain"]
    tally = [
        [scheme, *(row[kind] for kind in KINDS), f"{row['largest gain']:.1e}"]
        for scheme, row in counts(cells).items()
    ]
    pages = [
        f"# Stability: {title}\n",
        "The ratio is the energy over what it should be: that at the start, or at the end of the "
        "loads, and the work done since. In this order, a scheme **blew up** if the ratio exceeded "
        f"{BLOWN_UP:g}; it **failed** if Newton's method did, after all halvings of the step; it "
        f"**kept** the energy if the ratio was never further than {KEPT:g} from 1; else it "
        "**gained** or **lost**, whichever was more.\n",
        report.table(header, tally),
        f"![Verdicts]({name}.png)\n",
        "*In a cell: the largest error of the ratio where the energy was kept; what was lost or "
        "gained; how many times the energy where it blew up; the part of the time that was reached "
        "where Newton's method failed.*\n",
        f"![Energy over time]({name}_curves.png)\n",
        "*The cases on which the schemes differ most, one of each group: those with the most "
        "different verdicts, then those with the widest range of errors. A cross marks where "
        "Newton's method failed.*\n",
    ]
    for group, cases in _groups(cells).items():
        rows = [[case[0].case.label, *(_words(cell.verdict) for cell in case)] for case in cases]
        pages += [f"## {group}\n", report.table(["", *schemes], rows)]
    pages += [*_drifts(cells), *_failures(cells), remarks]
    stated = ", ".join(f"{key} {value}" for key, value in machine.items())
    return "\n".join([*pages, f"Computed on: {stated}.\n"])


def _words(verdict: Verdict) -> str:
    if verdict.kind == "kept":
        return f"kept, {verdict.worst:.0e}"
    if verdict.kind == "failed":
        return (
            f"failed at {verdict.time:.3g} s, ratio {verdict.lowest:.2g} to {verdict.highest:.2g}"
        )
    until = f", failed at {verdict.time:.3g} s" if verdict.reason else ""
    if verdict.kind == "blew up":
        return f"blew up, {verdict.highest:.0e} times{until}"
    change = verdict.highest - 1 if verdict.kind == "gained" else 1 - verdict.lowest
    return f"{verdict.kind} {_percent(change)}"


def _percent(change: float) -> str:
    return f"{100 * change:.2g} %" if change >= 1e-3 else f"{change:.0e}"


def _drifts(cells: list[Cell]) -> list[str]:
    drifting = [(cell, cell.drift) for cell in cells if cell.drift]
    if not drifting:
        return []
    rows = [
        [
            cell.case.label,
            cell.scheme,
            f"{drift.exponent:.2f}",
            drift.law if cell.verdict.kind == "kept" else None,
            ", ".join(f"{steps:.0e}: {error:.0e}" for steps, error in drift.steps.items()),
        ]
        for cell, drift in drifting
    ]
    header = ["case", "scheme", "exponent", "law", "largest error after so many steps"]
    return ["## Drift with the number of steps\n", report.table(header, rows)]


def _failures(cells: list[Cell]) -> list[str]:
    reasons = [
        [cell.case.name, ". ".join(cell.verdict.reason.split(". ")[:2])]
        for cell in cells
        if cell.verdict.reason
    ]
    return ["## Why runs broke off\n", report.table(["case", "reason"], reasons)] if reasons else []


def _groups(cells: list[Cell]) -> dict[str, list[list[Cell]]]:
    """Cells case by case, by group."""
    found: dict[str, list[list[Cell]]] = {}
    for case in _cases(cells):
        found.setdefault(case[0].case.group, []).append(case)
    return found


def _cases(cells: list[Cell]) -> list[list[Cell]]:
    """Cells case by case."""
    found: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        found.setdefault((cell.case.group, cell.case.label), []).append(cell)
    return list(found.values())


# -- Pictures ------------------------------------------------------------------------------------


def symbol(verdict: Verdict) -> str:
    """A verdict in a few characters, for a cell of the heat map.

    Parameters
    ----------
    verdict : Verdict
        The verdict.

    Returns
    -------
    str
        Such as 2e-13, -17%, +4e-05, x1e9 or, with the part of the time reached, a cross and 54%.
    """
    if verdict.kind == "kept":
        return _short(verdict.worst)
    if verdict.kind == "failed":
        return f"\u2717{100 * verdict.reached:.0f}%"
    if verdict.kind == "blew up":
        return f"\u00d7{_short(verdict.highest)}"
    change = verdict.highest - 1 if verdict.kind == "gained" else verdict.lowest - 1
    return f"{100 * change:+.0f}%" if abs(change) >= 0.01 else f"{change:+.0e}".replace("e-0", "e-")


def _short(value: float) -> str:
    return f"{value:.0e}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


def _draw_map(path: Path, cells: list[Cell]) -> None:
    # Imported here, as a study can be had without matplotlib and pyvista.
    from . import plot

    groups = _groups(cells)
    bands = _bands(groups)
    schemes = list(dict.fromkeys(cell.scheme for cell in cells))
    figure, axes = plot.figure(len(bands), 1, height=0.65 + 0.18 * len(schemes))
    figure.set_figwidth(13.0)
    for ax, band in zip(axes.flat, bands, strict=True):
        _draw_band(ax, [(group, groups[group]) for group in band], schemes)
    squares = [
        axes[0, 0].plot([], [], "s", color=colour, markersize=9, label=kind)[0]
        for kind, colour in COLOURS.items()
    ]
    figure.legend(handles=squares, ncols=5, loc="outside upper center", frameon=False)
    figure.savefig(path, dpi=150)


def _bands(groups: dict[str, list]) -> list[list[str]]:
    """Groups that fit side by side, in their order."""
    bands: list[list[str]] = [[]]
    taken = 0
    for group, cases in groups.items():
        if taken and taken + _width(group, cases) > _SLOTS + 1:
            bands.append([])
            taken = 0
        bands[-1].append(group)
        taken += _width(group, cases)
    return bands


def _width(group: str, cases: list) -> int:
    """Slots that a group takes: its cases and a gap, or what its title needs."""
    title = max(map(len, group.split(": ")))
    return max(len(cases) + 1, -(-title // _LETTERS))


def _draw_band(ax, band: list[tuple[str, list[list[Cell]]]], schemes: list[str]) -> None:
    places, labels, left = [], [], 0
    for group, cases in band:
        for x, case in enumerate(cases, left):
            places.append(x)
            labels.append(case[0].case.label.replace(" ", "\n"))
            for cell in case:
                _draw_cell(ax, x, schemes.index(cell.scheme), cell.verdict)
        title = group.replace(": ", "\n")
        ax.text(left - 0.5, -0.7, title, fontsize=7, va="bottom", linespacing=1.1)
        left += _width(group, cases)
    ax.set(xlim=(-0.55, _SLOTS - 0.45), ylim=(len(schemes) - 0.45, -0.55))
    ax.set_xticks(places, labels, fontsize=6.5, linespacing=0.95)
    ax.set_yticks(range(len(schemes)), schemes, fontsize=7)
    ax.tick_params(length=0, pad=2)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)


def _draw_cell(ax, x: int, y: int, verdict: Verdict) -> None:
    ax.fill_between((x - 0.48, x + 0.48), y - 0.46, y + 0.46, color=COLOURS[verdict.kind], lw=0)
    ink = "white" if verdict.kind in _ON_DARK else "black"
    ax.text(x, y, symbol(verdict), color=ink, fontsize=6, ha="center", va="center_baseline")


def _draw_curves(path: Path, shown: list[list[Cell]]) -> None:
    from . import plot

    columns = 2 if len(shown) > 1 else 1
    figure, axes = plot.figure(-(-len(shown) // columns), columns)
    for ax, case in zip(axes.flat, shown, strict=False):
        ax.set_title(case[0].case.name.replace(": ", "\n", 1), fontsize=8)
        ax.set(ylim=(0.08, 12), yscale="log", xlabel="time $t$ [s]", ylabel="energy ratio $r$ [-]")
        ax.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        for cell in case:
            look = plot.style(cell.family)
            ax.plot(cell.t, np.clip(cell.ratio, 0.01, 100), label=cell.scheme, **look)
            if cell.verdict.reason and len(cell.t):
                end = np.clip(cell.ratio[-1], 0.08, 12)
                ax.plot(cell.t[-1], end, "X", color=look["color"], clip_on=False, zorder=5)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    plot.save(figure, path)
