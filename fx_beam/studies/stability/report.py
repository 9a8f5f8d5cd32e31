"""A study of stability as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies.reporting import beside, section, short, table, write_report

from . import case
from .case import KINDS, Cell, grouped
from .picture import draw_curves, draw_map, symbol

#: Verdicts on a motion that is wrong.
LOST_MOTION = "gained", "blew up", "failed"
_PAGE = Path(__file__).with_name("page.md").read_text("utf-8")


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
    draw_map(beside(path, ".png"), cells)
    draw_curves(beside(path, "_curves.png"), cells)
    page = _PAGE.format(
        case=case,
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
        "kept": case.KEPT,
        "blew up": case.BLOWN_UP,
        "halvings of a step at most": limits,
        "halved often, from steps taken for each": case.OFTEN,
        "the same with other rounding, up to": case.SAME,
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
        By scheme, the number of each verdict; "largest error where kept", "largest loss where lost"
        and "largest gain", as parts of the energy; and the numbers of cases in which it kept the
        energy with "steps halved often", whose number "depends on rounding" (is sensitive to
        round-off), and whose "verdict depends on rounding".
    """
    rows: dict[str, dict[str, float]] = {}
    for scheme, own in grouped(cells, "scheme").items():
        kinds = Counter(cell.verdict.kind for cell in own)
        kept, lost = ([c for c in own if c.verdict.kind == kind] for kind in ("kept", "lost"))
        turned = [cell.verdict.kind != cell.other.kind for cell in own if cell.other]
        rows[scheme] = {kind: kinds[kind] for kind in KINDS} | {
            "largest error where kept": max((c.verdict.worst for c in kept), default=np.nan),
            "largest loss where lost": max((c.verdict.amount for c in lost), default=np.nan),
            "largest gain": max(0.0, *(cell.verdict.gain for cell in own)),
            "steps halved often": sum(cell.halved_often for cell in kept),
            "depends on rounding": len(turned),
            "verdict depends on rounding": sum(turned),
        }
    return rows


def _row(cell: Cell) -> dict[str, Any]:
    """What the JSON and CSV files have of a cell."""
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
        {"case": cell.case.name, "scheme": cell.scheme, "t [s]": one.time}
        | {"lowest ratio": one.lowest, "highest ratio": one.highest, "reason": one.reason}
        for cell in cells
        if (one := cell.verdict).reason
    ]
    return [
        section(lost, [_lost(group, own) for group, own in groups.items()]),
        *(section(group, _verdicts(own)) for group, own in groups.items()),
        section("Drift with the number of steps", drifts),
        section("Reasons for failed runs", reasons),
    ]


def _lost(group: str, cells: list[Cell]) -> dict[str, Any]:
    """Number of cases of a group in which each scheme gained energy, blew up or failed."""
    row: dict[str, Any] = {"group": group, "cases": len(grouped(cells, "case.label"))}
    for scheme, own in grouped(cells, "scheme").items():
        row[scheme] = sum(cell.verdict.kind in LOST_MOTION for cell in own) or None
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
