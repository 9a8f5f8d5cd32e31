"""A work-precision study as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies.reporting import beside, machine, section, short, write_json, write_report
from fx_beam.studies.work_precision import accuracy

from .accuracy import ROUND_OFF, Mesh, Precision, Run, alike, counted, floor, observed_order
from .picture import draw_dots, draw_fronts

CLOCKS = {"seconds": "whole call of simulate", "step_seconds": "steps alone"}
#: Relative errors for which the cheapest runs are listed.
LEVELS = 1e-2, 1e-4, 1e-6, 1e-8, 1e-10

_PAGE = Path(__file__).with_name("page.md").read_text("utf-8")


def sentence(study: Precision, quantity: str) -> str:
    """One sentence that says which run is the most accurate, and how well its error is known.

    Parameters
    ----------
    study : Precision
        A study.
    quantity : str
        Name of the quantity.

    Returns
    -------
    str
        The sentence.
    """
    if quantity in study.missing:
        return f"{quantity}: there is no reference: {study.missing[quantity]}"
    best = min(study.runs, key=lambda run: (counted(study, quantity, run), run.seconds))
    error, known = counted(study, quantity, best), study.references[quantity]
    reference = "exact" if known is None else f"known to {known:.3g}"
    astray = sum(not run.errors.get(quantity, np.nan) <= 1 for run in study.runs)
    fastest = study.cheapest(quantity, 1.05 * error)
    names = alike(fastest)
    others = [name for name in names if name != best.scheme and best.scheme in names]
    tie = f" About as fast: {', '.join(others)}." if others else ""
    of_mesh = study.mesh_errors.get(best.mesh, {}).get(quantity, 0.0)
    mesh = " The mesh limits it: smaller steps do not help." if of_mesh > error / 2 > 0 else ""
    return (
        f"{quantity}: the smallest error is {short(error)}, by {best}, in "
        f"{1e3 * best.seconds:.3g} ms.{tie}{mesh} The reference is {reference}. "
        f"{astray} of {len(study.runs)} runs broke off or have an error above 1."
    )


def prepare(path: Path | str) -> None:
    """Check before a study that its results can be written and its pictures drawn."""
    from fx_beam import plot  # noqa: F401  the import of `draw`

    try:
        write_json(beside(path, ".json"), machine())
    except (OSError, TypeError) as wrong:
        raise SceneError(f"results = {path!r} cannot be written: {wrong}") from wrong


def write(path: Path | str, study: Precision) -> None:
    """Write a study as JSON, its runs as CSV, and a Markdown page with two pictures.

    Parameters
    ----------
    path : str or path
        Files to write, without their endings.
    study : Precision
        A study.
    """
    names, tables = list(study.references), _tables(study)
    sentences = {name: sentence(study, name) for name in names}
    panels = [(name, study, name) for name in names]
    draw_dots(beside(path, ".png"), panels)
    draw_fronts(beside(path, "_curves.png"), panels, attrgetter("scheme"))
    page = _PAGE.format(
        accuracy=accuracy,
        study=study,
        name=Path(path).name,
        title=Path(path).name.replace("_", " "),
        start=f", from the solutions that `{study.start}` gives" if study.start else "",
        origin=study.origin or "none",
        sentences="\n".join(f"- {words}" for words in sentences.values()),
        tables="\n".join(section(name, rows) for name, rows in tables.items() if rows),
    )
    runs = [
        asdict(run) | {"lost": run.lost, "counts with": {q: counted(study, q, run) for q in names}}
        for run in study.runs
    ]
    errors = [asdict(mesh) | by_quantity for mesh, by_quantity in study.mesh_errors.items()]
    numbers = {"t_end": study.t_end, "start": study.start, "timed runs of each": study.repetitions}
    numbers |= {"relative errors of the references": study.references, "reference": study.origin}
    numbers |= {"why there is no reference": study.missing, "sentences": sentences, **tables}
    numbers |= {"Errors with a fine time step": errors, "Runs": runs}
    write_report(path, page, numbers, runs)


def _tables(study: Precision) -> dict[str, list[dict[str, Any]]]:
    """Rows of the page's tables by title; the JSON file has them too."""
    names, schemes = list(study.references), study.schemes
    computed = [name for name, error in study.references.items() if error is not None]
    meshes = list(dict.fromkeys(run.mesh for run in study.runs))
    degrees = sorted({mesh.degree for mesh in meshes})
    reasons = {why: name for name, why in study.missing.items()}
    reasons |= {why: run.scheme for run in study.runs for why in run.notes.values()}
    broken = {run.scheme: run.failure for run in reversed(study.runs) if run.failure}
    reasons |= {why: f"{scheme}, the first run that broke off" for scheme, why in broken.items()}
    return {
        "Fastest run of each scheme for an error": [
            {"quantity": name, "error": short(level), **_candidate(run)}
            for name in names
            for level in LEVELS
            for run in study.cheapest(name, level).values()
        ],
        "Runs": [_row(study, run) for run in study.runs],
        f"Run times divided by those of {schemes[0]}, same step and mesh, median": [
            {"scheme": scheme, "time": clock}
            | {f"degree {degree}": _ratio(study, scheme, degree, name) for degree in degrees}
            for scheme in schemes[1:]
            for name, clock in CLOCKS.items()
        ],
        "Observed orders in the time step": [
            {"scheme": scheme, **asdict(mesh)}
            | {name: step_order(study, name, scheme, mesh) for name in names}
            for scheme in schemes
            for mesh in meshes
        ],
        "Errors with a fine time step": [
            asdict(mesh) | {name: _known(study, name, error) for name, error in errors.items()}
            for mesh, errors in study.mesh_errors.items()
        ],
        "Observed orders in the size of the elements": [
            {"degree": degree} | {name: mesh_order(study, name, degree) for name in computed}
            for degree in degrees
            if study.mesh_errors
        ],
        "Missing results": [{"of": what, "reason": why} for why, what in reasons.items()],
    }


def _row(study: Precision, run: Run) -> dict[str, Any]:
    steps, lost = run.steps or np.nan, "energy" if run.lost else None
    return {
        **_candidate(run),
        "unknowns": run.unknowns,
        "Newton it/step": run.newton_iterations / steps,
        "halvings": run.halvings,
        "us/step": 1e6 * run.step_seconds / steps,
        "first call [ms]": 1e3 * run.first_seconds,
        **{name: _known(study, name, run.errors.get(name)) for name in study.references},
        "lost": f"broke off at {run.reached:.3g} s" if run.failure else lost,
    }


def _candidate(run: Run) -> dict[str, Any]:
    times = {"whole call [ms]": 1e3 * run.seconds, "steps alone [ms]": 1e3 * run.step_seconds}
    return {"scheme": run.scheme, **asdict(run.mesh), "dt [s]": run.dt} | times


def _known(study: Precision, name: str, error: float | None) -> float | str | None:
    """An error; one that is not known is given by its limit."""
    low = floor(study, name)
    return f"< {low:.1g}" if error is not None and error < low else error


def step_order(study: Precision, quantity: str, scheme: str, mesh: Mesh) -> float | None:
    """Observed order in the time step; None if the errors have no clear order."""
    runs = [run for run in study.runs if (run.scheme, run.mesh) == (scheme, mesh)]
    return observed_order([(r.dt, r.step_errors.get(quantity, np.nan)) for r in runs], ROUND_OFF)


def mesh_order(study: Precision, quantity: str, degree: int) -> float | None:
    """Observed order in the size of the elements, with a fine time step; None if not clear."""
    left = [(mesh, error) for mesh, error in study.mesh_errors.items() if mesh.degree == degree]
    errors = [(1 / mesh.elements, error.get(quantity, np.nan)) for mesh, error in left]
    return observed_order(errors, max(floor(study, quantity), ROUND_OFF))


def _ratio(study: Precision, scheme: str, degree: int, clock: str) -> float:
    """Median ratio of a run time to that of the first scheme."""
    runs = [run for run in study.runs if run.mesh.degree == degree and not run.failure]
    first = {(r.mesh, r.dt): getattr(r, clock) for r in runs if r.scheme == study.schemes[0]}
    here = {(r.mesh, r.dt): getattr(r, clock) for r in runs if r.scheme == scheme}
    both = [here[key] / first[key] for key in here if key in first]
    return float(np.median(both)) if both else np.nan
