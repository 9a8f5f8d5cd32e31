"""A work-precision study as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies.reporting import beside, machine, section, short, write_json, write_report
from fx_beam.studies.work_precision import accuracy

from .accuracy import MARGIN, ROUND_OFF, Mesh, Precision, Run, counted, floor, observed_order

CLOCKS = {"seconds": "whole call of simulate", "step_seconds": "steps alone"}
_MARKERS = {
    "o": "elements of degree 1",
    "s": "elements of degree 2",
    "^": "elements of degree 3",
    "+": "lost: energy error above one half",
    "x": "broke off",
    "v": "error above 1, or none",
}

#: Relative errors for which the cheapest runs are listed.
LEVELS = 1e-2, 1e-4, 1e-6, 1e-8, 1e-10

_PAGE = Path(__file__).with_name("page.md").read_text("utf-8")


def draw(path: Path, panels: Sequence[tuple[str, Precision, str]], clock: str) -> None:
    """Draw panels of title, study and quantity: errors against one of the `CLOCKS`.

    All runs are pale points; a line joins the runs of a scheme that are more accurate than all
    faster ones. Runs that broke off or err by more than 1 stand at the top, a row for each scheme.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    rows = -(-len(panels) // 2)
    figure, axes = plot.figure(rows, min(len(panels), 2), height=4.2 if rows == 1 else 3.0)
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax, (title, study, quantity) in zip(axes.flat, panels, strict=False):
        _panel(ax, study, quantity, clock, plot.style)
        ax.set_title(title, fontsize=8, loc="left")
    for ax in axes.flat[max(len(panels) - 2, 0) : len(panels)]:
        ax.set_xlabel(f"{CLOCKS[clock]} [ms]", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("largest relative error [-]", fontsize=8)
    plot.save(figure, path)


def _panel(ax, study: Precision, quantity: str, clock: str, style) -> None:
    known, computed = floor(study, quantity), study.references[quantity] is not None
    runs = [(r, 1e3 * getattr(r, clock), r.errors.get(quantity, np.nan)) for r in study.runs]
    inside = [max(error, known) for _, _, error in runs if error <= 1]
    bottom = int(np.log10(np.nanmin([0.1, *inside, known if computed else 0.1]) / 1.5) // 1)
    astray = dict.fromkeys(run.scheme for run, _, error in runs if not error <= 1)
    heights = {scheme: 10 ** (-0.07 * bottom * k) for k, scheme in enumerate(astray, 1)}
    looks: dict[str, dict] = {}
    used: list[str] = []
    for scheme, name in {run.scheme: run.name for run in study.runs}.items():
        looks[scheme] = style(name)
        if name in used:  # with another parameter: another dotting
            looks[scheme] |= {"linestyle": (0, (1, 1 + used.count(name)))}
        used.append(name)
        points = sorted((t, counted(study, quantity, r)) for r, t, _ in runs if r.scheme == scheme)
        front = [
            p for k, p in enumerate(points) if p[1] <= 1 and all(p[1] < q[1] for q in points[:k])
        ]
        ax.plot(*np.array(front).reshape(-1, 2).T, label=scheme, **looks[scheme])
    for run, time, error in runs:
        at = max(error, known) if error <= 1 else heights[run.scheme]
        fill = "none" if error < known else "full"
        point = {"color": looks[run.scheme]["color"], "fillstyle": fill, "markersize": 4}
        ax.plot(time, at, _marker(run, error), alpha=0.5, **point)
    drawn = {_marker(run, error) for run, _, error in runs}
    for marker, label in _MARKERS.items():
        if marker in drawn:
            ax.plot([], [], marker, color="0.5", markersize=4, label=label)
    if computed:
        label = f"not known: below {MARGIN:g} times the error of the reference"
        ax.axhspan(10.0**bottom, known, color="0.92", label=label)
    _axes(ax, bottom, heights, np.array([time for _, time, _ in runs if np.isfinite(time)]))


def _marker(run: Run, error: float) -> str:
    if run.failure or not error <= 1:
        return "x" if run.failure else "v"
    return "+" if run.lost else "os^"[run.mesh.degree - 1]


def _axes(ax, bottom: int, heights: dict[str, float], times: np.ndarray) -> None:
    """Ticks at 1, 2 and 5 on the time axis; at powers of ten and margin rows on the other.

    The time axis ends at ticks, so that it always has two or more.
    """
    ax.set(xscale="log", yscale="log")
    ticks = np.outer(10.0 ** np.arange(-7, 7), (1, 2, 5)).ravel()
    first, last = np.searchsorted(ticks, (min(times, default=1) / 1.1, max(times, default=1) * 1.1))
    ax.set_xlim(ticks[first - 1], ticks[last])
    shown = [x for x in ticks[first - 1 : last + 1] if last - first < 7 or f"{x:e}"[0] == "1"]
    ax.set_xticks(shown, [f"{tick:g}" for tick in shown])
    decades = range(0, bottom - 1, -max(1, -bottom // 6))
    labels = [f"$10^{{{k}}}$" for k in decades] + [scheme.split(" (")[0] for scheme in heights]
    ax.set_yticks([10.0**k for k in decades] + list(heights.values()), labels)
    ax.tick_params(labelsize=6.5)
    ax.minorticks_off()
    ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_ylim(10.0**bottom, 10 ** (-0.07 * bottom * (len(heights) + 0.9)))


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
    known = study.references[quantity]
    reference = "exact" if known is None else f"known to {known:.3g}"
    astray = sum(not run.errors.get(quantity, np.nan) <= 1 for run in study.runs)
    return (
        f"{quantity}: the smallest error is {short(counted(study, quantity, best))}, by {best}, in "
        f"{1e3 * best.seconds:.3g} ms. The reference is {reference}. "
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
    # The steps alone for the first quantity only: for all others, points move in the same way.
    for clock, ending, shown in ("seconds", "", names), ("step_seconds", "_steps", names[:1]):
        draw(beside(path, f"{ending}.png"), [(name, study, name) for name in shown], clock)
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
