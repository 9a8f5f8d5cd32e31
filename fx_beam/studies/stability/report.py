"""A study of stability as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies import reporting
from fx_beam.studies.reporting import short, table

from .case import OFTEN, SAME, Cell, by_group, by_scheme
from .picture import draw_curves, draw_map, symbol
from .verdict import BLOWN_UP, KEPT, KINDS

#: Verdicts on a motion that is wrong.
LOST_MOTION = "gained", "blew up", "failed"
_VERBS = {
    "lost": "loses energy",
    "gained": "gains energy",
    "blew up": "blows up",
    "failed": "fails",
    "no verdict": "has no verdict",
}
_CRITERIA = f"""The energy ratio is 1 + (E - E(0) - W) / E0. E is the energy and W the work of all
loads less what dampers took; what the scheme takes counts as lost. E0 is the largest kinetic and
strain energy that the motion should have: the energy at the start, plus what loads and weight have
added. The verdict is the first of these that applies:

- **blew up**: the ratio exceeded {BLOWN_UP:g};
- **failed**: Newton's method did not converge, after {{limits}} halvings of the step;
- **kept**: the ratio always differed from 1 by at most {short(KEPT)};
- **gained** or **lost**: the larger of the two differences.

A run is *sensitive to round-off* if its verdict changes, or its number changes by more than
{100 * SAME:g} %, with time steps that differ in the last digit. Runs are repeated with {{repeats}}
such time steps if they did not keep the energy, or took {OFTEN:g} or more steps per step of the
time grid.

In a table, "steps x1.2" is the number of steps taken per step of the time grid. A verdict after a ~
is that of a repeated run.
"""
_MAP = (
    "Number in a cell: the largest error if the energy was kept; the part that was lost or "
    "gained; the energy ratio if it blew up; the part of the time that was reached if the run "
    f"failed. Black corner: {OFTEN:g} or more steps were taken per step of the time grid. ~: the "
    "number is sensitive to round-off. If the verdict is sensitive as well, the right end of "
    "the cell has the colour of the other verdict."
)


def write(
    path: Path | str,
    cells: list[Cell],
    title: str,
    remarks: str = "",
    findings: Sequence[str] = (),
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
        Sentences to be listed after those on each scheme.

    Raises
    ------
    SceneError
        If there are no cells.
    """
    if not cells:
        raise SceneError("a report on stability needs cells of a study; none are given")
    found, tally = [*findings, *sentences(cells)], counts(cells)
    judged, name = criteria(cells), Path(path).name
    draw_map(reporting.beside(path, ".png"), cells)
    draw_curves(reporting.beside(path, "_curves.png"), cells)
    page = [
        f"# Stability: {title}\n",
        _CRITERIA.format(
            limits=" or ".join(map(str, judged["halvings of a step at most"])),
            repeats=max(len(cell.others) for cell in cells),
        ),
        table([{"scheme": scheme} | row for scheme, row in tally.items()]),
        "".join(f"- {sentence}\n" for sentence in found),
        f"![Verdicts]({name}.png)\n",
        f"*{_MAP}*\n",
        f"![Energy over time]({name}_curves.png)\n",
        "*The cases in which the schemes differ most, one of each group. A cross marks a failure "
        "of Newton's method.*\n",
        *_tables(cells),
        remarks,
    ]
    rows = [_row(cell) for cell in cells]
    numbers = {"criteria": judged, "verdicts": tally, "what was found": found, "cells": rows}
    reporting.write(path, page, numbers, rows)


def criteria(cells: list[Cell]) -> dict[str, Any]:
    """The limits that decide the verdicts."""
    return {
        "kept": KEPT,
        "blew up": BLOWN_UP,
        "halvings of a step at most": sorted({cell.max_halvings for cell in cells}),
        "halved often, from steps taken for each": OFTEN,
        "the same with other rounding, up to": SAME,
    }


def counts(cells: Iterable[Cell]) -> dict[str, dict[str, float]]:
    """Number of cases with each verdict, for each scheme.

    Parameters
    ----------
    cells : iterable of Cell
        A study.

    Returns
    -------
    dict
        By scheme, the number of each verdict; "largest error where kept" and "largest gain", as
        parts of the energy; and the numbers of cases in which it kept the energy with "steps halved
        often", whose number "depends on rounding" (is sensitive to round-off), and whose "verdict
        depends on rounding".
    """
    found: dict[str, dict[str, float]] = {}
    for scheme, own in by_scheme(cells).items():
        kinds = Counter(cell.verdict.kind for cell in own)
        kept = [cell for cell in own if cell.verdict.kind == "kept"]
        others = [(cell.verdict.kind, cell.other.kind) for cell in own if cell.other]
        gains = [cell.verdict.gain for cell in own if not np.isnan(cell.verdict.highest)]
        found[scheme] = {kind: kinds[kind] for kind in KINDS} | {
            "largest error where kept": max((c.verdict.worst for c in kept), default=np.nan),
            "largest gain": max(gains, default=0.0),
            "steps halved often": sum(cell.halved_often for cell in kept),
            "depends on rounding": len(others),
            "verdict depends on rounding": sum(one != other for one, other in others),
        }
    return found


def sentences(cells: Iterable[Cell]) -> list[str]:
    """A sentence on each scheme."""
    found = []
    for scheme, row in counts(cells).items():
        cases = f"{row['kept']} of {sum(row[kind] for kind in KINDS)} cases"
        within = f" (error at most {short(row['largest error where kept'])})" if row["kept"] else ""
        parts = [f"{scheme} keeps the energy in {cases}{within}"]
        parts += [f"{verb} in {row[kind]:g}" for kind, verb in _VERBS.items() if row[kind]]
        gain = f"at most {percent(row['largest gain'])}" if row["largest gain"] else "no energy"
        found.append(f"{', '.join(parts)}. It gains {gain}.")
    return found


def percent(part: float) -> str:
    """A part of the energy in percent; below 0.1 % or above 1000 % as a plain number."""
    if part < 1e-3 or part >= 10:
        return f"{short(part)} times the energy"
    return f"{100 * part:.2g} %" if part < 0.0995 else f"{100 * part:.0f} %"


def _row(cell: Cell) -> dict[str, Any]:
    return {
        "group": cell.case.group,
        "case": cell.case.label,
        "dt": cell.case.dt,
        "t_end": cell.case.t_end,
        "scheme": cell.scheme,
        **asdict(cell.verdict),
        "with other rounding": [
            {key: getattr(other, key) for key in ("kind", "time", "highest", "lowest")}
            for other in cell.others
        ],
        "seconds": cell.seconds,
        "drift": cell.drift and asdict(cell.drift),
        "turns": cell.turns,
    }


# -- Tables of the page --------------------------------------------------------------------------


def _tables(cells: list[Cell]) -> list[str]:
    lost = "Number of cases in which energy was gained, or a run blew up or failed"
    found = [f"## {lost}\n", table([_lost(group, own) for group, own in by_group(cells).items()])]
    for group, cases in by_group(cells).items():
        rows = [
            {"case": one.label, "dt [s]": one.dt, "to [s]": one.t_end}
            | {cell.scheme: _words(cell) for cell in case}
            for one, case in ((case[0].case, case) for case in cases)
        ]
        found += [f"## {group}\n", table(rows)]
    drifts = [
        {
            "case": cell.case.label,
            "scheme": cell.scheme,
            "exponent": cell.drift.exponent,
            "law": cell.drift.law if cell.verdict.kind == "kept" else None,
            "largest error after so many steps": ", ".join(
                f"{short(steps)}: {short(error)}" for steps, error in cell.drift.steps.items()
            ),
            "turns": cell.turns,
        }
        for cell in cells
        if cell.drift
    ]
    reasons = [
        {
            "case": cell.case.name,
            "scheme": cell.scheme,
            "t [s]": cell.verdict.time,
            "lowest ratio": cell.verdict.lowest,
            "highest ratio": cell.verdict.highest,
            "reason": cell.verdict.reason,
        }
        for cell in cells
        if cell.verdict.reason
    ]
    found += ["## Drift with the number of steps\n", table(drifts)] if drifts else []
    return found + (["## Reasons for failed runs\n", table(reasons)] if reasons else [])


def _lost(group: str, cases: list[list[Cell]]) -> dict[str, Any]:
    """Number of cases of a group in which each scheme gained energy, blew up or failed."""
    row: dict[str, Any] = {"group": group, "cases": len(cases)}
    for scheme, own in by_scheme(cell for case in cases for cell in case).items():
        row[scheme] = sum(cell.verdict.kind in LOST_MOTION for cell in own) or None
    return row


def _words(cell: Cell) -> str:
    """The verdict, the steps taken per step of the time grid, and a differing repeated verdict."""
    steps = f"; steps x{cell.verdict.parts:.3g}" if cell.verdict.parts >= 1.005 else ""
    other = f" ~ {cell.other.kind} {symbol(cell.other)}" if cell.other else ""
    return f"{cell.verdict.kind} {symbol(cell.verdict)}{steps}{other}"
