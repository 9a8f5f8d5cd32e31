"""A study of work and precision in words, tables and pictures."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies import reporting

from .accuracy import MARGIN, STEADY
from .fronts import SAME, TIE, Winner
from .picture import draw, short
from .precision import Precision
from .run import LOST, Run


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
    clauses = [_clause(winner, found) for winner in found.winners(quantity)]
    none = f"no error below {short(found.floor(quantity))} is told from that of the reference"
    return f"{quantity}: {'; '.join(clauses) or none}."


def prepare(path: Path | str) -> None:
    """Refuse before a study what would end it: a place that cannot be written, or no pictures.

    Parameters
    ----------
    path : str or path
        Where to write, without ending; its directory is made.

    Raises
    ------
    SceneError
        If that cannot be.
    """
    from fx_beam import plot  # noqa: F401  the same that `draw` imports, if it can be had

    try:
        directory = Path(path).parent
        directory.mkdir(parents=True, exist_ok=True)
    except (OSError, TypeError) as wrong:
        raise SceneError(f"results = {path!r} cannot be written: {wrong}") from wrong
    if not os.access(directory, os.W_OK):
        raise SceneError(f"results = {path!r} cannot be written: no permission in {directory}")


def write(path: Path | str, found: Precision) -> None:
    """Write a study as JSON, as a Markdown page and as the pictures in it, one a quantity.

    Parameters
    ----------
    path : str or path
        Where to write, without ending.
    found : Precision
        A study.
    """
    path = Path(path)
    # Endings are added, as the name may have a point in it.
    beside = {ending: path.with_name(path.name + ending) for ending in (".json", ".md")}
    machine = reporting.machine()
    reporting.write_json(beside[".json"], {"machine": machine, **numbers(found)})
    for name, picture in _pictures(found, path.name).items():
        draw(path.with_name(picture), found, name)
    beside[".md"].write_text(markdown(found, path.name, machine), encoding="utf-8")


def _pictures(found: Precision, name: str) -> dict[str, str]:
    """Names of the pictures by quantity, in their order."""
    words = {quantity: re.sub(r"\W+", "_", quantity) for quantity in found.references}
    return {q: f"{name}_{number}_{word}.png" for number, (q, word) in enumerate(words.items(), 1)}


def numbers(found: Precision) -> dict[str, Any]:
    """All numbers of a study by name.

    Parameters
    ----------
    found : Precision
        A study.

    Returns
    -------
    dict
        For a file.
    """
    return {
        "t_end": found.t_end,
        "start": found.start,
        "timed runs of each": found.repetitions,
        "computed references": found.origin,
        "relative errors of the references": found.references,
        "why there is no reference": found.missing,
        "import [s]": reporting.import_seconds(),
        "which scheme wins where": [sentence(found, name) for name in found.references],
        "runs": [
            asdict(run)
            | {
                "lost": run.lost,
                "counts with": {q: found.counted(q, run) for q in found.references},
            }
            for run in found.runs
        ],
        "orders in the time step": [
            {"scheme": scheme, "mesh": asdict(mesh), "orders": _step_orders(found, scheme, mesh)}
            for scheme in found.schemes
            for mesh in found.meshes
        ],
        "errors with a fine time step": [
            {"mesh": asdict(mesh), "errors": errors} for mesh, errors in found.mesh_errors.items()
        ],
        "orders in the element": [
            {"degree": degree, "orders": _mesh_orders(found, degree)}
            for degree in found.degrees
            if found.mesh_errors
        ],
        "run times over the first scheme's": [
            {"scheme": scheme, "degree": degree, "median": found.cost(scheme, degree)}
            for scheme in found.schemes
            for degree in found.degrees
        ],
    }


def markdown(found: Precision, name: str, machine: dict[str, Any]) -> str:
    """Page on a study.

    Parameters
    ----------
    found : Precision
        A study.
    name : str
        What was studied, also the first part of the names of the pictures.
    machine : dict
        What `reporting.machine` gives.

    Returns
    -------
    str
        The page, in Markdown.
    """
    pages = [f"# Error against run time: {name.replace('_', ' ')}\n", _rules(found), _apart(found)]
    for quantity, picture in _pictures(found, name).items():
        pages += [
            f"## {quantity}\n",
            f"![{quantity}]({picture})\n",
            sentence(found, quantity) + "\n",
        ]
    pages += [
        "## References\n",
        _references(found),
        "## Runs\n",
        _runs(found),
        f"## Run times over those of {found.schemes[0]}\n",
        "Medians over all steps and meshes, each with its own.\n",
        _cost_table(found),
        "## Observed orders in the time step\n",
        "Fit to the three finest errors against a fine step on the same mesh, where they fall with "
        f"the step and their two slopes differ by at most {STEADY:g}. Elsewhere the steps are too "
        "large for an order, or an error changes its sign.\n",
        _order_table(found),
    ]
    if found.mesh_errors:
        pages += [
            "## Errors with a fine time step\n",
            "Orders are fits as above, of errors that can be told from that of the reference.\n",
            _mesh_table(found),
        ]
    stated = ", ".join(f"{key} {value}" for key, value in machine.items())
    return "\n".join([*pages, f"Computed on: {stated}.\n"])


# -- Words ---------------------------------------------------------------------------------------


def _rules(found: Precision) -> str:
    """How to read the page."""
    percent = f"{100 * (SAME - 1):.0f} %"
    start = f", from the solutions that `{found.start}` gives" if found.start else ""
    return (
        f"{found.t_end:g} s of motion{start}. An error is the largest distance from the reference "
        "over time, over the largest magnitude of the reference; absolute where that is 0. Run "
        f"time is that of the steps, the median of {found.repetitions} runs in turn.\n\n"
        "So that no scheme wins by chance,\n\n"
        "- a run counts with the largest error of itself, of its scheme's smaller steps on its "
        "mesh, and of a fine step on its mesh and on those of more elements, and with no less "
        f"than {MARGIN:g} times the reference's own error;\n"
        "- it does not count where it, or one of those smaller steps, broke off, or gained or lost "
        f"more than {LOST:g} of its largest kinetic and strain energy;\n"
        "- a scheme's line joins the runs that are more accurate than all faster ones, by "
        f"{percent} at least; pale points are all runs, at their own errors;\n"
        "- times at an error lie on these lines, and schemes are named together where their times "
        f"differ by less than {100 * (TIE - 1):.0f} %, or overlap by quartiles and by {percent} "
        "in the error.\n"
    )


def _apart(found: Precision) -> str:
    """Import and set-up, which no run time has in it."""
    first = [run.first_setup_seconds for run in found.runs if run.unknowns]
    later = [run.setup_seconds for run in found.runs if not run.failure]
    if not later:
        return "No run came to the end.\n"
    return (
        f"Apart from that: import {_time(reporting.import_seconds())}; "
        f"set-up {_span(later)} a run; the first set-up of each, with compilation where forms were "
        f"not in the cache, {_span(first)}, {_time(sum(first))} in all.\n"
    )


def _clause(winner: Winner, found: Precision) -> str:
    loosest, tightest = short(winner.loosest), short(winner.tightest)
    if winner.run is None:
        return f"no run comes within {tightest}"
    levels = tightest if loosest == tightest else f"{loosest} to {tightest}"
    there = "" if loosest == tightest else f" for {tightest}"
    spent = f"{_span(winner.seconds)}; {winner.run.mesh}, dt = {winner.run.dt:.3g} s{there}"
    clause = f"within {levels} {_who(winner.schemes, found.schemes)} ({spent})"
    if winner.next:
        return f"{clause}, {winner.next} takes {winner.ratio:.3g} times as long"
    everyone = len(winner.schemes) == len(found.schemes)
    return clause if everyone else f"{clause}, the rest never comes within {tightest}"


def _who(schemes: Sequence[str], all_schemes: Sequence[str]) -> str:
    """Who is the cheapest; by the others, where those are fewer."""
    left = [scheme for scheme in all_schemes if scheme not in schemes]
    if len(schemes) == 1:
        return f"{schemes[0]} is the cheapest"
    if not left:
        return "all schemes cost the same"
    if len(left) < len(schemes):
        return f"all but {' and '.join(left)} cost the same"
    return f"{', '.join(schemes[:-1])} and {schemes[-1]} are the cheapest"


def _span(seconds: Sequence[float]) -> str:
    low, high = _time(min(seconds)), _time(max(seconds))
    return low if low == high else f"{low} to {high}"


def _time(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds > 0.099 else f"{1e3 * seconds:.2g} ms"


def _error(value: float | None) -> str | None:
    return None if value is None or np.isnan(value) else f"{value:.1e}"


def _hundredths(value: float | None) -> str | None:
    return None if value is None else f"{value:.2f}"


# -- Tables --------------------------------------------------------------------------------------


def _step_orders(found: Precision, scheme: str, mesh) -> dict[str, float | None]:
    return {name: found.step_order(name, scheme, mesh) for name in found.references}


def _mesh_orders(found: Precision, degree: int) -> dict[str, float | None]:
    return {name: found.mesh_order(name, degree) for name in _computed(found)}


def _computed(found: Precision) -> list[str]:
    """Quantities with a computed reference."""
    return [name for name, error in found.references.items() if error is not None]


def _references(found: Precision) -> str:
    origins = dict.fromkeys(found.missing, "none")
    rows = [
        (name, "exact" if error is None else origins.get(name, found.origin), _error(error))
        for name, error in found.references.items()
    ]
    reasons = [f"- {name}: {reason}\n" for name, reason in found.missing.items()]
    table = reporting.table(["quantity", "reference", "its error, estimated"], rows)
    return "\n".join([table, *reasons])


def _runs(found: Precision) -> str:
    header = ["scheme", "elements", "degree", "dt [s]", "unknowns", "Newton it/step", "halvings"]
    header += ["run time [ms]", "us/step", "set-up [ms]", *found.references, "lost"]

    def row(run: Run):
        failed = bool(run.failure)
        iterations = f"{run.newton_iterations / run.steps:.1f}" if run.steps else None
        spent = 1e3 * run.seconds, 1e6 * run.seconds / max(1, run.steps), 1e3 * run.setup_seconds
        times = [None if failed else f"{t:.3g}" for t in spent]
        errors = [_error(run.errors.get(name)) for name in found.references]
        size = run.mesh.elements, run.mesh.degree, f"{run.dt:.4g}", run.unknowns
        end = f"at {run.reached:.3g} s" if failed else "energy" if run.lost else None
        return (run.scheme, *size, iterations, run.halvings, *times, *errors, end)

    noted = [(run.scheme, why) for run in found.runs for why in (run.failure, *run.notes.values())]
    reasons = dict.fromkeys(f"- {scheme}: {why}\n" for scheme, why in noted if why)
    return "\n".join([reporting.table(header, map(row, found.runs)), *reasons])


def _cost_table(found: Precision) -> str:
    header = ["scheme", *(f"degree {degree}" for degree in found.degrees)]
    rows = [
        (scheme, *(_hundredths(found.cost(scheme, degree)) for degree in found.degrees))
        for scheme in found.schemes
    ]
    return reporting.table(header, rows)


def _order_table(found: Precision) -> str:
    rows = [
        (scheme, mesh.elements, mesh.degree)
        + tuple(map(_hundredths, _step_orders(found, scheme, mesh).values()))
        for scheme in found.schemes
        for mesh in found.meshes
    ]
    return reporting.table(["scheme", "elements", "degree", *found.references], rows)


def _mesh_table(found: Precision) -> str:
    rows: list[tuple] = []
    for degree in found.degrees:
        rows += [
            (mesh.elements, mesh.degree, *(_error(errors.get(name)) for name in _computed(found)))
            for mesh, errors in found.mesh_errors.items()
            if mesh.degree == degree
        ]
        rows += [("order", degree, *map(_hundredths, _mesh_orders(found, degree).values()))]
    return reporting.table(["elements", "degree", *_computed(found)], rows)
