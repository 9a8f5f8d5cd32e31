"""A study of stability as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.export import replacing
from fx_beam_studies.reporting import beside, section, short, table, write_report

from . import cases as rules
from .cases import KINDS, Cell, Verdict, grouped

# Of each verdict the colour, from pale for kept to dark for failed, the sign of the number in a
# cell, and what a legend says of it.
_LOOKS = {
    "kept": ("#CFE6F4", "", "kept: largest error"),
    "damped": ("#B9DCB4", "-", "damped, as meant: part of the energy"),
    "lost": ("#F6E7A1", "-", "lost: part of the energy"),
    "gained": ("#F2B48A", "+", "gained: part of the energy"),
    "blew up": ("#C8460B", "\u00d7", "blew up: times the energy"),
    "failed": ("#6E6E6E", "\u2717", "failed: part of the time"),
    "no verdict": ("#F0F0F0", "?", "no verdict"),
}
_ON_DARK = "blew up", "failed"
#: Verdicts on a motion that is wrong.
LOST_MOTION = "gained", "blew up", "failed"
_PAGE = Path(__file__).with_name("page.md").read_text("utf-8")


def symbol(verdict: Verdict) -> str:
    """A verdict as a short text: 2e-13, -17%, +4e-5, x1e9, or a cross and the part reached."""
    (_, sign, _), kind, amount = _LOOKS[verdict.kind], verdict.kind, verdict.amount
    if kind == "failed" or kind in ("damped", "lost", "gained") and amount >= 0.01:
        return f"{sign}{100 * amount:.0f}%"
    return sign if np.isnan(amount) else sign + short(amount)


def draw_summary(path: Path, questions: Mapping[str, list[Cell]]) -> None:
    """Draw the parts of the verdicts of each scheme as bars, a column for each list of cells."""
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    every = [cell for cells in questions.values() for cell in cells]
    schemes, kinds = list(grouped(every, "scheme")), _in_order(every)
    figure, axes = plot.figure(1, 1, height=0.9 + 0.3 * len(schemes))
    figure.set_figwidth(2.6 + 0.95 * len(questions))
    ax, names = axes[0, 0], []
    for x, (name, cells) in enumerate(questions.items()):
        names.append(textwrap.fill(name, 16) + f"\n{len(grouped(cells, 'case.name'))} cases")
        parts = Counter((cell.scheme, cell.verdict.kind) for cell in cells)
        totals = Counter(cell.scheme for cell in cells)
        ends = np.full(len(schemes), x - 0.46)
        for kind in kinds:
            widths = np.array([0.92 * parts[s, kind] / max(totals[s], 1) for s in schemes])
            colour, _, words = _LOOKS[kind]
            label = "" if x else words.partition(":")[0]
            ax.barh(range(len(schemes)), widths, 0.8, ends, color=colour, label=label)
            ends = ends + widths
    ax.set_xticks(range(len(names)), names, fontsize=8)
    ax.xaxis.tick_top()
    ax.set(xlim=(-0.52, len(names) - 0.48), ylim=(len(schemes) - 0.5, -0.5))
    _bare(ax, schemes, 9)
    figure.legend(ncols=6, loc="outside lower center", frameon=False, fontsize=9)
    with replacing(path) as new:
        figure.savefig(new, dpi=150)


def _bare(ax, schemes: list[str], fontsize: float) -> None:
    """Name the rows of axes by schemes, and draw no lines."""
    ax.set_yticks(range(len(schemes)), schemes, fontsize=fontsize)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)


def _in_order(cells: list[Cell]) -> list[str]:
    """The kinds of the verdicts on cells, from kept to failed."""
    return sorted(grouped(cells, "verdict.kind"), key=KINDS.index)


def draw_map(path: Path, cells: list[Cell], slots: int = 27) -> None:
    """Write the heat map; `slots` is the number of cases and gaps side by side."""
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    bands = _bands(cells, slots)
    figure, axes = plot.figure(len(bands), 1, height=0.65 + 0.18 * len(grouped(cells, "scheme")))
    figure.set_figwidth(0.48 * slots)
    for ax, band in zip(axes.flat, bands, strict=True):
        _draw_band(ax, band, list(grouped(cells, "scheme")))
        ax.set_xlim(-0.55, slots - 0.45)
    looks = [_LOOKS[kind] for kind in _in_order(cells)]
    legend: dict = {words: ("s", colour) for colour, _, words in looks}
    legend["steps halved often"] = ((-1, 1), (1, 1), (-1, -1)), "black"
    legend["sensitive to round-off"] = r"$\sim$", "black"
    for label, (marker, colour) in legend.items():
        look = {"marker": marker, "color": colour, "linestyle": "none", "markersize": 9}
        axes[0, 0].plot([], [], label=label, **look)
    figure.legend(ncols=slots // 7, loc="outside upper center", frameon=False, fontsize=8)
    with replacing(path) as new:
        figure.savefig(new, dpi=150)


def _bands(cells: list[Cell], slots: int) -> list[dict[int, list[Cell]]]:
    """Groups that fit side by side, by the index of their first case."""
    bands: list[dict[int, list[Cell]]] = [{}]
    left = 0
    for group, own_cells in grouped(cells, "case.group").items():
        letters = max(map(len, group.split(": ")))  # of the title, 7 to a slot
        width = max(len(grouped(own_cells, "case.label")) + 1, -(-letters // 7))
        if left and left + width > slots + 1:
            bands.append({})
            left = 0
        bands[-1][left] = own_cells
        left += width
    return bands


def _draw_band(ax, band: dict[int, list[Cell]], schemes: list[str]) -> None:
    labels = {}
    for left, group in band.items():
        title = group[0].case.group.replace(": ", "\n")
        ax.text(left - 0.5, -0.7, title, fontsize=7, va="bottom", linespacing=1.1)
        for x, (label, case) in enumerate(grouped(group, "case.label").items(), left):
            labels[x] = label.replace(" ", "\n")
            for cell in case:
                _draw_cell(ax, x, schemes.index(cell.scheme), cell)
    ax.set_xticks(list(labels), list(labels.values()), fontsize=6.5, linespacing=0.95)
    ax.set_ylim(len(schemes) - 0.45, -0.55)
    ax.tick_params(pad=2)
    _bare(ax, schemes, 7)


def _draw_cell(ax, x: int, y: int, cell: Cell) -> None:
    """A square in the colour of the verdict; its right end shows a differing repeated verdict."""
    verdict, other = cell.verdict, cell.other
    ink = "white" if verdict.kind in _ON_DARK else "black"
    stripe = 0.16 if other and other.kind != verdict.kind else 0.0
    ax.barh(y, 0.96, 0.92, x - 0.48, color=_LOOKS[verdict.kind][0])
    if other and stripe:
        ax.barh(y, stripe, 0.92, x + 0.48 - stripe, color=_LOOKS[other.kind][0])
    if cell.halved_often:
        ax.fill((x - 0.48, x - 0.28, x - 0.48), (y - 0.46, y - 0.46, y - 0.1), color=ink, lw=0)
    text = f"{'~' if other else ''}{symbol(verdict)}"
    # The text lies in its cell: the layout need not measure it.
    look = {"color": ink, "fontsize": 6, "ha": "center", "va": "center_baseline"}
    ax.text(x - stripe / 2, y, text, **look).set_in_layout(False)


def write(
    path: Path | str, cells: list[Cell], title: str, remarks: str = "", findings: Sequence[str] = ()
) -> None:
    """Write a study as JSON, its cells as CSV, and a Markdown page with two pictures.

    Parameters
    ----------
    path : str or path
        Files to write, without their endings.
    cells : list of Cell
        A study.
    title : str
        What was studied.
    remarks : str
        Text for the end of the page, in Markdown.
    findings : sequence of str
        Sentences to be listed after the table of verdicts.

    Raises
    ------
    SceneError
        If there are no cells.
    """
    if not cells:
        raise SceneError("a report on stability needs cells of a study; none are given")
    tally, limits = counts(cells), sorted({cell.max_halvings for cell in cells})
    draw_summary(beside(path, "_summary.png"), grouped(cells, "case.group"))
    draw_map(beside(path, ".png"), cells)
    page = _PAGE.format(
        case=rules,
        title=title,
        name=Path(path).name,
        limits=" or ".join(map(str, limits)),
        repeats=max(len(cell.others) for cell in cells),
        verdicts=table([{"scheme": scheme} | row for scheme, row in tally.items()]),
        findings="".join(f"- {finding}\n" for finding in findings),
        tables="\n".join(filter(None, _tables(cells))),
        remarks=remarks,
    )
    criteria = {
        "kept": rules.KEPT,
        "blew up": rules.BLOWN_UP,
        "halvings of a step at most": limits,
        "halved often, from steps taken for each": rules.OFTEN,
        "the same with other rounding, up to": rules.SAME,
    }
    rows = [_row(cell) for cell in cells]
    numbers = {"criteria": criteria, "verdicts": tally, "what was found": findings, "cells": rows}
    write_report(path, page, numbers, rows)


def counts(cells: Iterable[Cell]) -> dict[str, dict[str, float]]:
    """Number of cases with each verdict, for each scheme.

    Parameters
    ----------
    cells : iterable of Cell
        A study.

    Returns
    -------
    dict
        For each scheme the number of each verdict; "largest error where kept", "largest loss"
        (damped or lost) and "largest gain", as parts of the energy; and the number of cases in
        which it kept the energy with "steps halved often", in which the number of the verdict
        "depends on rounding", and in which the "verdict depends on rounding".

    Raises
    ------
    SceneError
        For what is no cell of a study.
    """
    rows: dict[str, dict[str, float]] = {}
    for scheme, own_cells in grouped(cells, "scheme").items():
        kinds = Counter(cell.verdict.kind for cell in own_cells)
        keeping = [c for c in own_cells if c.verdict.kind == "kept"]
        losses = [c.verdict.amount for c in own_cells if c.verdict.kind in ("damped", "lost")]
        turned = [cell.verdict.kind != cell.other.kind for cell in own_cells if cell.other]
        rows[scheme] = {kind: kinds[kind] for kind in KINDS} | {
            "largest error where kept": max((c.verdict.worst for c in keeping), default=np.nan),
            "largest loss": max(losses, default=np.nan),
            "largest gain": max(0.0, *(cell.verdict.gain for cell in own_cells)),
            "steps halved often": sum(cell.halved_often for cell in keeping),
            "depends on rounding": len(turned),
            "verdict depends on rounding": sum(turned),
        }
    return rows


def _row(cell: Cell) -> dict[str, Any]:
    """Entries of a cell in the JSON and CSV files."""
    repeated = "kind", "time", "highest", "lowest"
    others = [{key: getattr(other, key) for key in repeated} for other in cell.others]
    row: dict[str, Any] = {"group": cell.case.group, "case": cell.case.label}
    row |= {"dt": cell.case.dt, "t_end": cell.case.t_end, "scheme": cell.scheme}
    row |= asdict(cell.verdict) | {"with other rounding": others, "seconds": cell.seconds}
    return row | {"drift": cell.drift and asdict(cell.drift), "turns": cell.turns}


def _tables(cells: list[Cell]) -> list[str]:
    groups = grouped(cells, "case.group")
    lost = "Number of cases in which energy was gained, or a run blew up or failed"
    drifts = [
        {"case": cell.case.label, "scheme": cell.scheme, "exponent": drift.exponent}
        | {"law": drift.law if cell.verdict.kind == "kept" else None, "turns": cell.turns}
        | {f"error after {short(n)} steps": error for n, error in drift.steps.items()}
        for cell in cells
        if (drift := cell.drift)
    ]
    reasons = [
        {"case": cell.case.name, "scheme": cell.scheme, "t [s]": verdict.time}
        | {
            "lowest ratio": verdict.lowest,
            "highest ratio": verdict.highest,
            "reason": verdict.reason,
        }
        for cell in cells
        if (verdict := cell.verdict).reason
    ]
    return [
        section(lost, [_lost(group, own_cells) for group, own_cells in groups.items()]),
        *(section(group, _verdicts(own_cells)) for group, own_cells in groups.items()),
        section("Drift with the number of steps", drifts),
        section("Reasons for failed runs", reasons),
    ]


def _lost(group: str, cells: list[Cell]) -> dict[str, Any]:
    """Number of cases of a group in which each scheme gained energy, blew up or failed."""
    row: dict[str, Any] = {"group": group, "cases": len(grouped(cells, "case.label"))}
    for scheme, own_cells in grouped(cells, "scheme").items():
        row[scheme] = sum(cell.verdict.kind in LOST_MOTION for cell in own_cells) or None
    return row


def _verdicts(group: list[Cell]) -> list[dict[str, Any]]:
    """A row for each case, with the verdicts on all schemes."""
    return [
        {"case": label, "dt [s]": case[0].case.dt, "to [s]": case[0].case.t_end}
        | {cell.scheme: _words(cell) for cell in case}
        for label, case in grouped(group, "case.label").items()
    ]


def _words(cell: Cell) -> str:
    """The verdict, the steps taken per step of the time grid, and a differing repeated verdict."""
    steps = f"; steps x{cell.verdict.parts:.3g}" if cell.verdict.parts >= 1.005 else ""
    other = f" ~ {cell.other.kind} {symbol(cell.other)}" if cell.other else ""
    return f"{cell.verdict.kind} {symbol(cell.verdict)}{steps}{other}"
