"""A work-precision study as JSON, CSV and a Markdown page with pictures."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, is_one_of, require
from fx_beam_studies.reporting import beside, machine, section, short, write_json, write_report
from fx_beam_studies.work_precision import accuracy

from .accuracy import ROUND_OFF, Mesh, Precision, Run, alike, counted, floor, observed_order

#: Title, study and quantity of a panel.
Panel = tuple[str, Precision, str]
#: Relative errors for which times are drawn, and their colours.
COLOURS = {1e-2: "#7FB8DA", 1e-3: "#2171B5", 1e-4: "#08306B"}
#: Part of its runs from which on a scheme that loses them is marked.
FRAGILE = 1 / 20
_LOST = "#C8460B"
_PANELS_IN_A_ROW = 4
_ROW = 0.3  # powers of ten from one row of lost runs to the next


# -- Run time for an error -------------------------------------------------------------------------


def draw_dots(path: Path, panels: Sequence[Panel]) -> None:
    """Draw the time of each scheme's fastest run for each of the `COLOURS`, a row for each scheme.

    A dot is the whole call of `simulate`, a ring its steps alone; beside them stands the time step.
    A cross has the number of runs that the scheme loses, of those with a mesh and a step with which
    any scheme has the error. Names of schemes that lose more than one run in twenty are red.
    """
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    schemes = list(dict.fromkeys(s for _, study, _ in panels for s in study.schemes))
    columns = min(len(panels), _PANELS_IN_A_ROW)
    figure, axes = plot.figure(-(-len(panels) // columns), columns, 0.7 + 0.42 * len(schemes))
    figure.set_figwidth(2.2 + 2.4 * columns)
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    names, fragile = [], []
    for scheme in schemes:
        lost = [r.lost for _, study, _ in panels for r in study.runs if r.scheme == scheme]
        fragile.append(sum(lost) > FRAGILE * len(lost))
        names.append(f"{scheme}\n{sum(lost)} of {len(lost)} runs lost" if any(lost) else scheme)
    for place, (ax, (title, study, quantity)) in enumerate(zip(axes.flat, panels, strict=False)):
        _dots(ax, study, quantity, schemes)
        ax.set_title(title, fontsize=9, loc="left")
        ax.set_yticks(range(len(schemes)), [] if place % columns else names, fontsize=8.5)
        for text, is_fragile in zip(ax.get_yticklabels(), fragile, strict=False):
            text.set_color(_LOST if is_fragile else "black")
        ax.set_xlabel("processor time [ms]", fontsize=8)
        ax.tick_params(axis="x", labelsize=8)
        ax.tick_params(axis="y", length=0)
    for error, colour in COLOURS.items():
        axes[0, 0].plot([], [], "o", color=colour, label=f"error {short(error)}, whole call")
    axes[0, 0].plot([], [], "o", color="0.4", fillstyle="none", label="steps alone")
    axes[0, 0].plot([], [], "x", color=_LOST, label="runs that are lost at this error")
    plot.save(figure, path)


def _dots(ax, study: Precision, quantity: str, schemes: list[str]) -> None:
    known = floor(study, quantity)
    times: list[float] = []
    rows = np.linspace(-0.28, 0.28, len(COLOURS))
    for (level, colour), shift in zip(COLOURS.items(), rows, strict=True):
        fastest = study.cheapest(quantity, level)
        able = {(r.mesh, r.dt) for r in study.runs if counted(study, quantity, r) <= level}
        for row, scheme in enumerate(schemes):
            height = row + shift
            if run := fastest.get(scheme):
                ends = 1e3 * run.step_seconds, 1e3 * run.seconds
                ax.plot(ends, [height] * 2, color=colour, linewidth=0.8)
                ax.plot(ends[0], height, "o", color=colour, fillstyle="none", markersize=3.2)
                ax.plot(ends[1], height, "o", color=colour, markersize=4)
                place = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
                ax.annotate(f"{1e3 * run.dt:.3g} ms", (ends[1], height), fontsize=6.5, **place)
                times += ends
            tried = [r for r in study.runs if r.scheme == scheme and (r.mesh, r.dt) in able]
            if lost := sum(run.lost for run in tried):
                words, right = f"\u00d7 {lost} of {len(tried)}", {"ha": "right", "va": "center"}
                where = ax.get_yaxis_transform()
                ax.text(0.995, height, words, fontsize=6.5, color=_LOST, transform=where, **right)
    if unknown := [level for level in COLOURS if level < known]:
        words = f"errors of {short(max(unknown))} and less are not known"
        look = {"ha": "center", "va": "center", "fontsize": 7, "color": "0.4"}
        ax.text(0.5, len(schemes) - 0.33, words, transform=ax.get_yaxis_transform(), **look)
    ax.set_xscale("log")
    low, high = min(times, default=1.0), max(times, default=10.0)
    # Space at the right for time steps and lost runs.
    ax.set_xlim(low / 1.3, high * 2 * max((high / low) ** 0.7, 3))
    ax.set_xticks(ticks := _ticks(*ax.get_xlim()), [f"{tick:g}" for tick in ticks])
    ax.minorticks_off()
    ax.grid(visible=False, axis="y")
    for row in range(0, len(schemes), 2):
        ax.axhspan(row - 0.5, row + 0.5, color="0.96", zorder=0)
    ax.set_ylim(len(schemes) - 0.1, -0.5)


# -- Errors over the run time ----------------------------------------------------------------------


def front(study: Precision, quantity: str, runs: list[Run]) -> np.ndarray:
    """Times of the steps [ms] and errors (n, 2) of runs that err less than all faster ones."""
    points = sorted((1e3 * run.step_seconds, counted(study, quantity, run)) for run in runs)
    best: list[tuple[float, float]] = []
    for time, error in points:
        if np.isfinite(time) and error <= 1 and (not best or error < best[-1][1]):
            best.append((time, error))
    return np.array(best).reshape(-1, 2)


def draw_fronts(path: Path, panels: Sequence[Panel], kind: Callable[[Run], str]) -> None:
    """Draw one line for each kind of run, such as its scheme: the best errors over the run time.

    Lost runs are crosses above, a row for each kind.
    """
    from fx_beam import plot

    figure, axes = plot.figure(len(panels), 1, height=3.9)
    for ax, (title, study, quantity) in zip(axes.flat, panels, strict=True):
        _fronts(ax, study, quantity, kind)
        ax.set_title(title, fontsize=10, loc="left")
        ax.set(xlabel="processor time of the steps [ms]", ylabel="largest relative error [-]")
    plot.save(figure, path)


def _fronts(ax, study: Precision, quantity: str, kind: Callable[[Run], str]) -> None:
    from fx_beam.plot.charts import STYLES

    ax.set(xscale="log", yscale="log")
    rows, looks = 0, itertools.cycle(zip(STYLES.values(), "os^DvPX*", strict=True))
    for name in dict.fromkeys(map(kind, study.runs)):
        runs, (style, marker) = [run for run in study.runs if kind(run) == name], next(looks)
        lost = [1e3 * run.step_seconds for run in runs if run.lost]
        label = f"{name}, {len(lost)} of {len(runs)} lost" if lost else name
        look = style | {"linewidth": 1.6, "marker": marker, "markersize": 4.5}
        ax.plot(*front(study, quantity, runs).T, label=label, **look)
        rows += bool(lost)
        ax.plot(lost, [10 ** (rows * _ROW)] * len(lost), "x", color=style["color"], markersize=4)
    low, known = ax.get_ylim()[0], floor(study, quantity)
    if study.references[quantity] is not None and low < known:
        ax.axhspan(low, known, color="0.92")
        place = {"xycoords": ("axes fraction", "data"), "va": "top", "fontsize": 8, "color": "0.4"}
        ax.annotate("errors are not known here", (0.01, known), **place)
    if rows:
        ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_xticks(ticks := _ticks(*ax.get_xlim()), [f"{tick:g}" for tick in ticks])
    ax.set_yticks([tick for tick in ax.get_yticks() if low <= tick <= 1])
    ax.minorticks_off()
    ax.set_ylim(low, 10 ** ((rows + 1) * _ROW))


def _ticks(low: float, high: float) -> np.ndarray:
    """Ticks at 1, 2 and 5, or at powers of ten where these are many."""
    ticks = np.outer(10.0 ** np.arange(-6, 7), (1, 2, 5)).ravel()
    inside = ticks[(ticks >= low) & (ticks <= high)]
    return inside if len(inside) < 6 else np.array([x for x in inside if f"{x:e}"[0] == "1"])


CLOCKS = {"seconds": "whole call of simulate", "step_seconds": "steps alone"}
#: Relative errors for which the cheapest runs are listed.
LEVELS = 1e-2, 1e-4, 1e-6, 1e-8, 1e-10

_PAGE = Path(__file__).with_name("page.md").read_text("utf-8")


def sentence(study: Precision, quantity: str) -> str:
    """A sentence on the most accurate run and on how well its error is known.

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
    wanted = f"one of {[*study.references]}"
    require(is_one_of(quantity, study.references), "quantity", quantity, wanted)
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
    mesh_error = study.mesh_errors.get(best.mesh, {}).get(quantity, 0.0)
    mesh = " The mesh limits it: smaller steps do not help." if mesh_error > error / 2 > 0 else ""
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
    except (OSError, ValueError) as wrong:
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
    errors = [asdict(mesh) | quantity_errors for mesh, quantity_errors in study.mesh_errors.items()]
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
