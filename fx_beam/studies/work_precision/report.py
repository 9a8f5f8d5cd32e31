"""A work-precision study as JSON, CSV and a Markdown page with pictures."""

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
magnitude of the reference (absolute if that is 0). The run time is that of the steps only, without
set-up: the median of {{repetitions}} runs. The candidates take turns.

These rules exclude results by chance:

- A run is assigned the largest of these errors: its own, those of its scheme with smaller steps on
  the same mesh, and those of solutions with a fine step on the same mesh and on finer ones. The
  assigned error is at least {MARGIN:g} times the error of the reference.
- A run is *lost* if a step failed, or if it gained or lost more than {LOST:g} of its kinetic and
  strain energy. Lost runs are excluded, and so are the runs of their scheme with larger steps.
- The line of a scheme joins the runs that are more accurate than all faster ones, by at least
  {100 * (SAME - 1):.0f} %. Run times at a given error are read from these lines.
- Schemes cost the same if their run times differ by less than {100 * (TIE - 1):.0f} %, or if their
  quartiles overlap.
"""


_NOTES = {
    "Runs": "Each run has its own error here; all numbers are in the CSV and JSON files.\n",
    "Observed orders in the time step": (
        "Fit to the three smallest steps, with errors relative to a fine step on the same mesh. A "
        "cell is empty if errors do not fall with the step, or if their slopes differ by more than "
        f"{STEADY:g}: the steps are too large, or an error changes its sign.\n"
    ),
    "Observed orders in the size of the elements": (
        "The same fit over the meshes, with a fine time step. Errors that do not exceed that of "
        "the reference are left out.\n"
    ),
}


def sentence(found: Precision, quantity: str) -> str:
    """One sentence that says which scheme is the cheapest for which error.

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
        return f"{quantity}: there is no reference: {found.missing[quantity]}"
    parts = []
    for schemes, own in groupby(found.levels(quantity), lambda level: set(level.cheapest)):
        levels = list(own)
        errors = " to ".join(dict.fromkeys(short(levels[k].error) for k in (0, -1)))
        if not schemes:
            parts.append(f"no run reaches an error of {errors}")
            continue
        are = (
            f"{' and '.join(levels[0].cheapest)} {'are' if len(schemes) > 1 else 'is'} the cheapest"
        )
        if len(schemes) == len(found.schemes) > 1:
            are = "all schemes cost about the same"
        times = _span([min(level.seconds.values()) for level in levels])
        parts.append(f"for an error of {errors} {are} ({times})")
    none = f"the reference cannot resolve errors below {short(found.floor(quantity))}"
    return f"{quantity}: {'; '.join(parts) or none}."


def prepare(path: Path | str) -> None:
    """Check before a study that its results can be written and pictures can be drawn."""
    from fx_beam import plot  # noqa: F401  the import of `draw`

    reporting.require_libraries()
    try:
        directory = reporting.beside(path, "").parent
    except (OSError, TypeError) as wrong:
        raise SceneError(f"results = {path!r} cannot be written: {wrong}") from wrong
    if not os.access(directory, os.W_OK):
        raise SceneError(f"results = {path!r} cannot be written: no permission in {directory}")


def write(path: Path | str, found: Precision) -> None:
    """Write a study as JSON, its runs as CSV, and a Markdown page with a picture of each quantity.

    Parameters
    ----------
    path : str or path
        Files to write, without their endings.
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
        f"The run time does not include the set-up: {_span(later)}; the first time, with "
        f"compilation if forms were not in the cache, {_span(first)}, {_time(sum(first))} in "
        "total.\n"
    )
    rules = _RULES.format(repetitions=found.repetitions)
    none = "No run was completed.\n"
    return f"{found.t_end:g} s of motion{start}.\n\n{rules}\n{spent if later else none}"


def _reasons(found: Precision) -> list[str]:
    """Reasons for failed runs and for missing errors or references."""
    noted = [(run.scheme, why) for run in found.runs for why in (run.failure, *run.notes.values())]
    noted += found.missing.items()
    lines = dict.fromkeys(f"- {name}: {why}\n" for name, why in noted if why)
    return ["## Missing results and their reasons\n", "".join(lines)] if lines else []


# -- Tables --------------------------------------------------------------------------------------


def _tables(found: Precision) -> dict[str, list[dict[str, Any]]]:
    """Rows of the page's tables by title; the JSON file has them too."""
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
    """Run times of all schemes for errors of 1e-1, 1e-2, ..., and the cheapest run."""
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
