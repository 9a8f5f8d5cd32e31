"""A study of stability in words and tables, with its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fx_beam.errors import SceneError
from fx_beam.studies import reporting

from .case import OFTEN, SAME, Cell, by_group, by_scheme
from .findings import along, counts, lost_motions, percent, sentences, short
from .picture import draw_curves, draw_map
from .verdict import BLOWN_UP, KEPT, KINDS, Verdict


def write(
    path: Path | str,
    cells: list[Cell],
    title: str,
    remarks: str = "",
    findings: Sequence[str] = (),
) -> None:
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
        What else the page shall say at its end, in Markdown.
    findings : sequence of str
        What was found besides the verdicts on each scheme, in sentences.

    Raises
    ------
    SceneError
        If there are no cells.
    """
    if not cells:
        raise SceneError("a page on stability needs cells of a study; none are given")
    path = Path(path)
    machine = reporting.machine()
    found = [*findings, *sentences(cells)]
    reporting.write_json(
        path.with_name(f"{path.name}.json"),
        {"machine": machine, **numbers(cells), "what was found": found},
    )
    page = markdown(path.name, cells, title, machine, found, remarks)
    path.with_name(f"{path.name}.md").write_text(page, "utf-8")
    draw_map(path.with_name(f"{path.name}.png"), cells)
    draw_curves(path.with_name(f"{path.name}_curves.png"), cells)


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
        "criteria": {
            "kept": KEPT,
            "blew up": BLOWN_UP,
            "halvings of a step at most": _limits(cells),
            "halved often, from steps taken for each": OFTEN,
            "the same with other rounding, up to": SAME,
        },
        "verdicts": counts(cells),
        "cells": [
            {
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
            for cell in cells
        ],
    }


def _limits(cells: list[Cell]) -> list[int]:
    return sorted({cell.max_halvings for cell in cells})


# -- Words ---------------------------------------------------------------------------------------


def markdown(
    name: str,
    cells: list[Cell],
    title: str,
    machine: dict[str, Any],
    findings: Sequence[str] = (),
    remarks: str = "",
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
        What `reporting.machine` gives.
    findings : sequence of str
        What was found, in sentences.
    remarks : str
        What else to say, in Markdown.

    Returns
    -------
    str
        The page, in Markdown.
    """
    schemes = list(by_scheme(cells))
    found = {cell.verdict.kind for cell in cells}
    kinds = [kind for kind in KINDS if kind in found]
    tally = [
        [scheme, *(row[kind] for kind in kinds), percent(row["largest gain"])]
        for scheme, row in counts(cells).items()
    ]
    pages = [
        f"# Stability: {title}\n",
        _criteria(cells),
        reporting.table(["scheme", *kinds, "largest gain"], tally),
        "".join(f"- {sentence}\n" for sentence in findings),
        f"![Verdicts]({name}.png)\n",
        "*In a cell: the largest error of the ratio where the energy was kept; what was lost or "
        "gained; how many times the energy where it blew up; the part of the time that was reached "
        "where Newton's method failed. A filled corner: on average a step was halved, or more than "
        "once. ~: a number that turns with rounding; where the verdict does as well, the cell ends "
        "in the colour of the other.*\n",
        f"![Energy over time]({name}_curves.png)\n",
        "*The cases on which the schemes differ most, one of each group: those with the most "
        "different verdicts, then those with the widest range of errors. A cross marks where "
        "Newton's method failed.*\n",
        "## Where energy was gained, and where runs blew up or failed\n",
        reporting.table(["in so many cases", *schemes], lost_motions(cells)),
    ]
    for group, cases in by_group(cells).items():
        header = ["", "dt [s]", "to [s]", *schemes]
        rows = [
            [one.label, f"{one.dt:.3g}", f"{one.t_end:.4g}", *map(_words, case)]
            for one, case in ((case[0].case, case) for case in cases)
        ]
        pages += [f"## {group}\n", reporting.table(header, rows), along(cases)]
    pages += [*_drifts(cells), *_reasons(cells), remarks]
    stated = ", ".join(f"{key} {value}" for key, value in machine.items())
    return "\n".join([*filter(None, pages), f"Computed on: {stated}.\n"])


def _criteria(cells: list[Cell]) -> str:
    limits = " or ".join(map(str, _limits(cells)))
    return (
        "The ratio is 1 and the error of the energy balance since t = 0, the work of all loads "
        "taken off, over the largest kinetic and strain energy that should have been there: that "
        "at the start and what loads and weight have added. In this order, a scheme **blew up** if "
        f"the ratio exceeded {BLOWN_UP:g}; it **failed** if Newton's method did, after {limits} "
        "halvings of the step; it **kept** the energy if the ratio was never further than "
        f"{short(KEPT)} from 1; else it **gained** or **lost**, whichever was more. A run that has "
        "blown up is given up where its steps would have to be halved further.\n\n"
        "A run reached the end of its row, or what its cell says. Where steps were halved, the "
        "cell says how many were taken for each, such as *steps x1.2*. After a ~ stands what the "
        "same run comes to with a step that is another in its last digit: another verdict, or a "
        f"number that differs by more than {100 * SAME:g} %. All runs are repeated so, "
        f"{max(len(cell.others) for cell in cells)} times, but for those that kept the energy with "
        f"less than {OFTEN:g} steps for each.\n"
    )


def _words(cell: Cell) -> str:
    """A cell of a table: the verdict, the steps taken, and what other rounding makes of them."""
    verdict, other = cell.verdict, cell.other
    words = _verdict(verdict)
    if verdict.parts >= 1.005:
        words += f"; steps x{verdict.parts:.3g}"
    if other:
        words += f" ~ {_verdict(other)}"
    return words


def _verdict(verdict: Verdict) -> str:
    if verdict.kind == "no verdict":
        return "no verdict"
    if verdict.kind == "kept":
        return f"kept, {short(verdict.worst)}"
    if verdict.kind == "failed" and not verdict.steps:
        return "failed in the first step"
    if verdict.kind == "failed":
        kept = f"kept, {short(verdict.worst)}"
        ratio = f"ratio {verdict.lowest:.2g} to {verdict.highest:.2g}"
        return f"failed at {verdict.time:.3g} s, {kept if verdict.worst <= KEPT else ratio}"
    until = f", failed at {verdict.time:.3g} s" if verdict.reason else ""
    if verdict.kind == "blew up":
        return f"blew up, {short(verdict.highest)} times{until}"
    return f"{verdict.kind} {percent(verdict.amount)}"


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
            ", ".join(f"{short(steps)}: {short(error)}" for steps, error in drift.steps.items()),
            f"{cell.turns:.1f}",
        ]
        for cell, drift in drifting
    ]
    header = ["case", "scheme", "exponent", "law", "largest error after so many steps", "turns"]
    return ["## Drift with the number of steps\n", reporting.table(header, rows)]


def _reasons(cells: list[Cell]) -> list[str]:
    reasons = [
        [cell.case.name, cell.scheme, cell.verdict.reason] for cell in cells if cell.verdict.reason
    ]
    if not reasons:
        return []
    return ["## Why runs broke off\n", reporting.table(["case", "scheme", "reason"], reasons)]
