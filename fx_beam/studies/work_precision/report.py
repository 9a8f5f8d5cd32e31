"""A work-precision study as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.studies import reporting
from fx_beam.studies.reporting import short, table

from .accuracy import MARGIN, ROUND_OFF, STEADY, observed_order
from .picture import CLOCKS, draw
from .precision import LOST, MAX_HALVINGS, Mesh, Precision, Run, counted, floor

#: Relative errors for which the cheapest runs are listed.
LEVELS = 1e-2, 1e-4, 1e-6, 1e-8, 1e-10

_PAGE = """# Error against run time: {title}

{t_end:g} s of motion{start}. An error is the largest distance from the reference over time, divided
by the largest magnitude of the reference (absolute if that is 0). An error below {margin:g} times
that of the reference is not known, and is given as "< ...". The run time is the processor time
of the whole call of `simulate`, set-up included, with compiled forms in the cache: the least of
{repetitions} runs. The candidates take turns.

A run *has* an error of 1e-4 if its own error and those of all runs of its scheme with smaller steps
on its mesh are at most 1e-4, and so are those of solutions with a fine step on its mesh and on
finer ones. So no run is good by chance. A run that broke off, as a step failed that had been halved
{halvings} times, or that gained or lost more than {lost:g} of its kinetic and strain energy, has
none of them.

In the pictures a line joins the runs of a scheme that have a smaller error, in this sense, than all
faster ones. Points show the runs' own errors. Runs that broke off or err by more than 1 stand at
the top.
"""
_NOTES = {
    "Observed orders in the time step": (
        "Fit to the three smallest steps, with errors relative to a fine step on the same mesh. A "
        "cell is empty if errors do not fall with the step, or if their slopes differ by more than "
        f"{STEADY:g}: the steps are too large, or an error changes its sign.\n"
    ),
    "Observed orders in the size of the elements": (
        "The same fit over the meshes, with a fine time step. Errors that are not known are left "
        "out.\n"
    ),
}


#: Tables with errors, in columns by quantity.
_OF_ERRORS = "Runs", "Errors with a fine time step"


def sentence(found: Precision, quantity: str) -> str:
    """One sentence that says which run is the most accurate, and how well its error is known.

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
    best = min(found.runs, key=lambda run: (counted(found, quantity, run), run.seconds))
    own, known = counted(found, quantity, best), found.references[quantity]
    run = f"{best.scheme}, dt = {best.dt:.3g} s, {best.mesh}, in {1e3 * best.seconds:.3g} ms"
    words = f"the smallest error is {short(own)}, by {run}"
    if own <= floor(found, quantity) and known is not None:
        words = f"smaller errors than {short(own)} are not known; {run} reaches it"
    if own > 1:
        words = "no run has an error of at most 1"
    reference = "exact" if known is None else f"known to {short(known)}"
    astray = sum(not run.errors.get(quantity, np.nan) <= 1 for run in found.runs)
    return (
        f"{quantity}: {words}. The reference is {reference}. "
        f"{astray} of {len(found.runs)} runs broke off or have an error above 1."
    )


def prepare(path: Path | str) -> None:
    """Check before a study that its results can be written and its pictures can be drawn."""
    from fx_beam import plot  # noqa: F401  the import of `draw`

    reporting.prepare(path)


def write(path: Path | str, found: Precision) -> None:
    """Write a study as JSON, its runs as CSV, and a Markdown page with two pictures.

    Parameters
    ----------
    path : str or path
        Files to write, without their endings.
    found : Precision
        A study.
    """
    title, tables = Path(path).name.replace("_", " "), _tables(found)
    page = [
        _PAGE.format(
            title=title,
            t_end=found.t_end,
            start=f", from the solutions that `{found.start}` gives" if found.start else "",
            margin=MARGIN,
            repetitions=found.repetitions,
            lost=LOST,
            halvings=MAX_HALVINGS,
        )
    ]
    panels = [(quantity, found, quantity) for quantity in found.references]
    # The steps alone for the first quantity only: for all others, points move in the same way.
    for clock, ending, shown in ("seconds", "", panels), ("step_seconds", "_steps", panels[:1]):
        draw(picture := reporting.beside(path, f"{ending}.png"), shown, clock)
        page += [f"![Error against run time, {CLOCKS[clock]}]({picture.name})\n"]
    page += [f"- {sentence(found, quantity)}" for quantity in found.references]
    cheapest = [row for quantity in found.references for row in _cheapest(found, quantity)]
    page += ["\n## Fastest run of each scheme for an error\n", table(cheapest)]
    for name, rows in tables.items():
        stated = [_stated(found, row) for row in rows] if name in _OF_ERRORS else rows
        page += [f"## {name}\n", _NOTES.get(name, ""), table(stated)] if rows else []
    lines = dict.fromkeys(_reasons(found))
    page += ["## Missing results and their reasons\n", "".join(lines)] if lines else []
    runs = [
        asdict(run)
        | {"lost": run.lost, "counts with": {q: counted(found, q, run) for q in found.references}}
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
    reporting.write(path, page, numbers, runs)


def _reasons(found: Precision) -> Iterator[str]:
    """Why runs broke off, one reason of each scheme; missing errors and references."""
    for scheme in found.schemes:
        if failures := [run.failure for run in found.runs if run.scheme == scheme and run.failure]:
            yield f"- {scheme}: {len(failures)} runs broke off, such as {failures[0]}\n"
    for run in found.runs:
        yield from (f"- {run.scheme}: {why}\n" for why in run.notes.values())
    yield from (f"- {name}: {why}\n" for name, why in found.missing.items())


# -- Tables --------------------------------------------------------------------------------------


def _cheapest(found: Precision, quantity: str) -> list[dict[str, Any]]:
    """Fastest run of each scheme for some errors."""
    return [
        {
            "quantity": quantity,
            "error": short(level),
            "scheme": run.scheme,
            "dt [s]": run.dt,
            **asdict(run.mesh),
            "whole call [ms]": 1e3 * run.seconds,
            "steps alone [ms]": 1e3 * run.step_seconds,
        }
        for level in LEVELS
        for run in found.cheapest(quantity, level).values()
    ]


def step_order(found: Precision, quantity: str, scheme: str, mesh: Mesh) -> float | None:
    """Observed order in the time step; None if the errors have no clear order."""
    runs = [run for run in found.runs if (run.scheme, run.mesh) == (scheme, mesh)]
    errors = [run.step_errors.get(quantity, np.nan) for run in runs]
    return observed_order([run.dt for run in runs], errors, ROUND_OFF)


def mesh_order(found: Precision, quantity: str, degree: int) -> float | None:
    """Observed order in the size of the elements, with a fine time step; None if not clear."""
    own = [(1 / m.elements, e) for m, e in found.mesh_errors.items() if m.degree == degree]
    errors = [error.get(quantity, np.nan) for _, error in own]
    known = max(floor(found, quantity), ROUND_OFF)
    return observed_order([size for size, _ in own], errors, known)


def _tables(found: Precision) -> dict[str, list[dict[str, Any]]]:
    """Rows of the page's tables by title; the JSON file has them too."""
    computed = [name for name, error in found.references.items() if error is not None]
    meshes = list(dict.fromkeys(run.mesh for run in found.runs))
    degrees = sorted({mesh.degree for mesh in meshes})
    return {
        "References": [
            {
                "quantity": name,
                "reference": "exact" if error is None else found.origin,
                "estimated error": error,
            }
            for name, error in found.references.items()
            if name not in found.missing
        ],
        "Runs": [_row(found, run) for run in found.runs],
        f"Run times divided by those of {found.schemes[0]}, same step and mesh, median": [
            {"scheme": scheme, "time": clock}
            | {f"degree {degree}": _ratio(found, scheme, degree, name) for degree in degrees}
            for scheme in found.schemes[1:]
            for name, clock in (("seconds", "whole call"), ("step_seconds", "steps alone"))
        ],
        "Observed orders in the time step": [
            {"scheme": scheme, **asdict(mesh)}
            | {name: step_order(found, name, scheme, mesh) for name in found.references}
            for scheme in found.schemes
            for mesh in meshes
        ],
        "Errors with a fine time step": [
            asdict(mesh) | {name: errors.get(name) for name in computed}
            for mesh, errors in found.mesh_errors.items()
        ],
        "Observed orders in the size of the elements": [
            {"degree": degree} | {name: mesh_order(found, name, degree) for name in computed}
            for degree in degrees
            if found.mesh_errors
        ],
    }


def _ratio(found: Precision, scheme: str, degree: int, clock: str) -> float:
    """Median ratio of a run time to that of the first scheme."""
    runs = [run for run in found.runs if run.mesh.degree == degree and not run.failure]
    first = {(r.mesh, r.dt): getattr(r, clock) for r in runs if r.scheme == found.schemes[0]}
    here = {(r.mesh, r.dt): getattr(r, clock) for r in runs if r.scheme == scheme}
    both = [here[key] / first[key] for key in here if key in first]
    return float(np.median(both)) if both else np.nan


def _stated(found: Precision, row: dict[str, Any]) -> dict[str, Any]:
    """A row whose errors that are not known are given by their limit."""
    floors = {name: floor(found, name) for name in found.references if row.get(name) is not None}
    return row | {name: f"< {low:.1g}" for name, low in floors.items() if row[name] < low}


def _row(found: Precision, run: Run) -> dict[str, Any]:
    steps, lost = run.steps or np.nan, "energy" if run.lost else None
    if run.failure:
        lost = f"broke off at {run.reached:.3g} s"
    return {
        "scheme": run.scheme,
        **asdict(run.mesh),
        "dt [s]": run.dt,
        "unknowns": run.unknowns,
        "Newton it/step": run.newton_iterations / steps,
        "halvings": run.halvings,
        "whole call [ms]": 1e3 * run.seconds,
        "steps alone [ms]": 1e3 * run.step_seconds,
        "us/step": 1e6 * run.step_seconds / steps,
        "first call [ms]": 1e3 * run.first_seconds,
        **{name: run.errors.get(name) for name in found.references},
        "lost": lost,
    }
