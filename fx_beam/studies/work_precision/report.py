"""A study of work and precision as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies import reporting
from fx_beam.studies.reporting import short, table

from .accuracy import MARGIN, STEADY
from .picture import draw
from .precision import LOST, SAME, TIE, Precision, Run

_RULES = f"""An error is the largest distance from the reference over time, divided by the largest
magnitude of the reference (not divided where that is 0). The run time is that of the steps: the
median of {{repetitions}} runs, taken in turn over all candidates.

So that no scheme is the best by chance:

- A run counts with the largest error among itself, the runs of its scheme with smaller steps on its
  mesh, and solutions with a fine step on its mesh and on finer ones. It counts with no less than
  {MARGIN:g} times the error of the reference.
- A run is *lost* if it broke off, or gained or lost more than {LOST:g} of its kinetic and strain
  energy. It does not count, nor do those of its scheme with larger steps.
- The line of a scheme joins the runs that are more accurate than all faster ones, by
  {100 * (SAME - 1):.0f} % at least. Run times at an error are read from these lines.
- Schemes are equally cheap if their run times differ by less than {100 * (TIE - 1):.0f} %, or their
  quartiles overlap.
"""


_NOTES = {
    "Runs": "Errors are each run's own; all numbers are in the CSV and JSON files.\n",
    "Observed orders in the time step": (
        "Fit to the three finest errors against a fine step on the same mesh. A cell is empty "
        f"where errors do not fall with the step, or their slopes differ by more than {STEADY:g}: "
        "the steps are too large, or an error changes its sign.\n"
    ),
    "Observed orders in the size of the elements": (
        "The same fit, to the errors with a fine time step that exceed that of the reference.\n"
    ),
}


def sentence(found: Precision, quantity: str) -> str:
    """One sentence on which scheme is the cheapest at which error.

    Parameters
    ----------
    found : Precision
        A study.
    quantity : str
        Name of the quantity.

    Returns
    -------
    str
        The sentence.
    """
    if quantity in found.missing:
        return f"{quantity}: there is no reference, as {found.missing[quantity]}"
    parts = []
    for schemes, own in groupby(found.levels(quantity), lambda level: set(level.cheapest)):
        levels = list(own)
        errors = " to ".join(dict.fromkeys(short(levels[k].error) for k in (0, -1)))
        if not schemes:
            parts.append(f"no run comes within {errors}")
            continue
        are = (
            f"{' and '.join(levels[0].cheapest)} {'are' if len(schemes) > 1 else 'is'} the cheapest"
        )
        if len(schemes) == len(found.schemes) > 1:
            are = "all schemes cost about the same"
        times = _span([min(level.seconds.values()) for level in levels])
        parts.append(f"for an error of {errors} {are} ({times})")
    none = f"the reference cannot tell errors below {short(found.floor(quantity))}"
    return f"{quantity}: {'; '.join(parts) or none}."


def prepare(path: Path | str) -> None:
    """Refuse before a study what would end it: a place that cannot be written, or no pictures."""
    from fx_beam import plot  # noqa: F401  the same that `draw` imports, if it can be had

    reporting.require_libraries()
    try:
        directory = reporting.beside(path, "").parent
    except (OSError, TypeError) as wrong:
        raise SceneError(f"results = {path!r} cannot be written: {wrong}") from wrong
    if not os.access(directory, os.W_OK):
        raise SceneError(f"results = {path!r} cannot be written: no permission in {directory}")


def write(path: Path | str, found: Precision) -> None:
    """Write a study as JSON, its runs as CSV, and a Markdown page with a picture a quantity.

    Parameters
    ----------
    path : str or path
        Where to write, without ending.
    found : Precision
        A study.
    """
    tables = _tables(found)
    page = [f"# Error against run time: {Path(path).name.replace('_', ' ')}\n", _rules(found)]
    for number, quantity in enumerate(found.references, 1):
        word = re.sub(r"\W+", "_", quantity)
        picture = reporting.beside(path, f"_{number}_{word}.png")
        draw(picture, found, quantity)
        page += [f"## {quantity}\n", f"![{quantity}]({picture.name})\n"]
        page += [sentence(found, quantity) + "\n", table(_levels(found, quantity))]
    for title, rows in tables.items():
        page += [f"## {title}\n", _NOTES.get(title, ""), table(rows)] if rows else []
    runs = [
        asdict(run)
        | {"lost": run.lost, "counts with": {q: found.counted(q, run) for q in found.references}}
        for run in found.runs
    ]
    numbers = {
        "t_end": found.t_end,
        "start": found.start,
        "timed runs of each": found.repetitions,
        "relative errors of the references": found.references,
        "why there is no reference": found.missing,
        "sentences": {quantity: sentence(found, quantity) for quantity in found.references},
        **tables,
        "Runs": runs,
    }
    reporting.write(path, [*page, *_reasons(found)], numbers, runs)


def _rules(found: Precision) -> str:
    start = f", from the solutions that `{found.start}` gives" if found.start else ""
    first = [run.first_setup_seconds for run in found.runs if run.unknowns]
    later = [run.setup_seconds for run in found.runs if not run.failure]
    spent = (
        f"Not in the run time: the set-up of a run, {_span(later)}; its first set-up, with "
        f"compilation where forms were not in the cache, {_span(first)}, {_time(sum(first))} in "
        "all.\n"
    )
    rules = _RULES.format(repetitions=found.repetitions)
    none = "No run came to the end.\n"
    return f"{found.t_end:g} s of motion{start}.\n\n{rules}\n{spent if later else none}"


def _reasons(found: Precision) -> list[str]:
    """Why runs failed, and why errors or references are missing."""
    noted = [(run.scheme, why) for run in found.runs for why in (run.failure, *run.notes.values())]
    noted += found.missing.items()
    lines = dict.fromkeys(f"- {name}: {why}\n" for name, why in noted if why)
    return ["## What is missing, and why\n", "".join(lines)] if lines else []


# -- Tables --------------------------------------------------------------------------------------


def _tables(found: Precision) -> dict[str, list[dict[str, Any]]]:
    """Rows of the page's tables by title, which are in the JSON file too."""
    computed = [name for name, error in found.references.items() if error is not None]
    origins = dict.fromkeys(found.missing, "none")
    return {
        "References": [
            {
                "quantity": name,
                "reference": "exact" if error is None else origins.get(name, found.origin),
                "estimated error": error,
            }
            for name, error in found.references.items()
        ],
        "Runs": [_row(found, run) for run in found.runs],
        f"Run times divided by those of {found.schemes[0]}": [
            {"scheme": scheme}
            | {f"degree {degree}": found.cost(scheme, degree) for degree in found.degrees}
            for scheme in found.schemes
        ],
        "Observed orders in the time step": [
            {"scheme": scheme, **asdict(mesh)}
            | {name: found.step_order(name, scheme, mesh) for name in found.references}
            for scheme in found.schemes
            for mesh in found.meshes
        ],
        "Errors with a fine time step": [
            asdict(mesh) | {name: errors.get(name) for name in computed}
            for mesh, errors in found.mesh_errors.items()
        ],
        "Observed orders in the size of the elements": [
            {"degree": degree} | {name: found.mesh_order(name, degree) for name in computed}
            for degree in found.degrees
            if found.mesh_errors
        ],
    }


def _levels(found: Precision, quantity: str) -> list[dict[str, Any]]:
    """Run times of all schemes at errors of powers of ten, and the cheapest run."""
    return [
        {"error": short(level.error)}
        | {f"{s} [ms]": 1e3 * level.seconds.get(s, np.nan) for s in found.schemes}
        | {"cheapest run": f"{level.run.mesh}, dt = {level.run.dt:.3g} s" if level.run else "none"}
        for level in found.levels(quantity)
    ]


def _row(found: Precision, run: Run) -> dict[str, Any]:
    steps = run.steps or np.nan
    return {
        "scheme": run.scheme,
        **asdict(run.mesh),
        "dt [s]": run.dt,
        "unknowns": run.unknowns,
        "Newton it/step": run.newton_iterations / steps,
        "halvings": run.halvings,
        "run time [ms]": 1e3 * run.seconds,
        "us/step": 1e6 * run.seconds / steps,
        "set-up [ms]": 1e3 * run.setup_seconds,
        **{name: run.errors.get(name) for name in found.references},
        "lost": f"at {run.reached:.3g} s" if run.failure else "energy" if run.lost else None,
    }


def _span(seconds: Sequence[float]) -> str:
    return " to ".join(dict.fromkeys([_time(min(seconds)), _time(max(seconds))]))


def _time(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds > 0.099 else f"{1e3 * seconds:.2g} ms"
