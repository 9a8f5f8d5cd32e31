"""A study of work and precision in words, tables and a picture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from . import report
from .precision import Precision, Run, Winner


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
    clauses = [_clause(winner) for winner in found.winners(quantity)]
    none = f"no error below {_level(found.floor(quantity))} is told from that of the reference"
    return f"{quantity}: {'; '.join(clauses) or none}."


def write(path: Path | str, found: Precision) -> None:
    """Write a study as JSON, as a Markdown page and as the picture in it.

    Parameters
    ----------
    path : str or path
        Where to write, without ending.
    found : Precision
        A study.
    """
    path = Path(path)
    machine = report.machine()
    report.write_json(path.with_suffix(".json"), {"machine": machine, **numbers(found)})
    draw(path.with_suffix(".png"), found)
    page = markdown(found, path.stem, machine)
    path.with_suffix(".md").write_text(page, encoding="utf-8")


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
        "timed runs of each": found.repetitions,
        "computed references": found.origin,
        "relative errors of the references": found.references,
        "which scheme wins where": [sentence(found, name) for name in found.references],
        "runs": [asdict(run) for run in found.runs],
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
        What was studied, also the name of the picture.
    machine : dict
        What `report.machine` gives.

    Returns
    -------
    str
        The page, in Markdown.
    """
    pages = [
        f"# Error against run time: {name.replace('_', ' ')}\n",
        f"{found.t_end:g} s of motion. An error is the largest distance from the reference over "
        "time, over the largest magnitude of the reference; absolute where that is 0. Run time is "
        f"that of the steps, the median of {found.repetitions} runs in turn; set-up and "
        "compilation are apart. Schemes are named together where their times differ by less than "
        "5 % or their quartiles overlap. A scheme's line joins its runs that are more accurate "
        "than all faster ones; the others are pale.\n",
        f"![Error against run time]({name}.png)\n",
        "".join(f"- {sentence(found, quantity)}\n" for quantity in found.references),
        "## References\n",
        _references(found),
        "## Runs\n",
        _runs(found),
        f"## Run times over those of {found.schemes[0]}\n",
        "Medians over all steps and meshes, each with its own.\n",
        _cost_table(found),
        "## Observed orders in the time step\n",
        "Fit to the three finest errors against a fine step on the same mesh. Where the steps do "
        "not resolve a vibration, or an error changes its sign, it is no order.\n",
        _order_table(found),
    ]
    if found.mesh_errors:
        pages += ["## Errors with a fine time step\n", _mesh_table(found)]
    stated = ", ".join(f"{key} {value}" for key, value in machine.items())
    return "\n".join([*pages, f"Computed on: {stated}.\n"])


# -- Words ---------------------------------------------------------------------------------------


def _clause(winner: Winner) -> str:
    loosest, tightest = _level(winner.loosest), _level(winner.tightest)
    if winner.run is None:
        return f"no run comes within {tightest}"
    levels = tightest if loosest == tightest else f"{loosest} to {tightest}"
    *others, last = winner.schemes
    names, verb = (f"{', '.join(others)} and {last}", "are") if others else (last, "is")
    first = (
        f"within {levels} {names} {verb} the cheapest ({_time(winner.run.seconds)} at {tightest}, "
        f"{winner.run.mesh}, dt = {winner.run.dt:.3g} s)"
    )
    return first + (
        f", {winner.next} takes {winner.ratio:.3g} times as long" if winner.next else ""
    )


def _level(error: float) -> str:
    return f"{error:.0e}".replace("e-0", "e-")


def _time(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds >= 1 else f"{1e3 * seconds:.2g} ms"


def _error(value: float | None) -> str | None:
    return None if value is None or np.isnan(value) else f"{value:.1e}"


def _hundredths(value: float | None) -> str | None:
    return None if value is None else f"{value:.2f}"


# -- Tables --------------------------------------------------------------------------------------


def _step_orders(found: Precision, scheme: str, mesh) -> dict[str, float | None]:
    return {name: found.step_order(name, scheme, mesh) for name in found.references}


def _mesh_orders(found: Precision, degree: int) -> dict[str, float | None]:
    computed = next(iter(found.mesh_errors.values()))
    return {name: found.mesh_order(name, degree) for name in computed}


def _references(found: Precision) -> str:
    rows = [
        (name, "exact" if error is None else found.origin, _error(error))
        for name, error in found.references.items()
    ]
    return report.table(["quantity", "reference", "its error, estimated"], rows)


def _runs(found: Precision) -> str:
    header = ["scheme", "elements", "degree", "dt [s]", "unknowns", "Newton it/step", "halvings"]
    header += ["run time [ms]", "set-up [ms]", *found.references, "failed"]

    def row(run: Run):
        failed = bool(run.failure)
        iterations = f"{run.newton_iterations / run.steps:.1f}" if run.steps else None
        times = [None if failed else f"{1e3 * t:.3g}" for t in (run.seconds, run.setup_seconds)]
        errors = [_error(run.errors.get(name)) for name in found.references]
        size = run.mesh.elements, run.mesh.degree, f"{run.dt:.4g}", run.unknowns
        end = f"at {run.reached:.3g} s" if failed else None
        return (run.scheme, *size, iterations, run.halvings, *times, *errors, end)

    reasons = dict.fromkeys(f"- {r.scheme}: {r.failure}\n" for r in found.runs if r.failure)
    return "\n".join([report.table(header, map(row, found.runs)), *reasons])


def _cost_table(found: Precision) -> str:
    header = ["scheme", *(f"degree {degree}" for degree in found.degrees)]
    rows = [
        (scheme, *(_hundredths(found.cost(scheme, degree)) for degree in found.degrees))
        for scheme in found.schemes
    ]
    return report.table(header, rows)


def _order_table(found: Precision) -> str:
    rows = [
        (scheme, mesh.elements, mesh.degree)
        + tuple(map(_hundredths, _step_orders(found, scheme, mesh).values()))
        for scheme in found.schemes
        for mesh in found.meshes
    ]
    return report.table(["scheme", "elements", "degree", *found.references], rows)


def _mesh_table(found: Precision) -> str:
    rows: list[tuple] = []
    for degree in found.degrees:
        rows += [
            (mesh.elements, mesh.degree, *map(_error, errors.values()))
            for mesh, errors in found.mesh_errors.items()
            if mesh.degree == degree
        ]
        rows += [("order", degree, *map(_hundredths, _mesh_orders(found, degree).values()))]
    computed = next(iter(found.mesh_errors.values()))
    return report.table(["elements", "degree", *computed], rows)


# -- Picture -------------------------------------------------------------------------------------


def draw(path: Path | str, found: Precision) -> None:
    """Draw errors against run time: all runs as points, the best of each scheme as a line.

    Parameters
    ----------
    path : str or path
        File to write.
    found : Precision
        A study.
    """
    # Imported here, as a study can be had without matplotlib and pyvista.
    from . import plot

    names = list(found.references)
    columns = min(2, len(names))
    figure, axes = plot.figure(-(-len(names) // columns), columns, height=3.2)
    looks = _looks(found, plot.style)
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    for ax, name in zip(axes.flat, names, strict=False):
        ax.set(xscale="log", yscale="log", title=name)
        ax.set(xlabel="run time [s]", ylabel="largest relative error [-]")
        for scheme, look in looks.items():
            _draw_runs(ax, found, name, scheme, look)
        _draw_limits(ax, found, name)
    for degree in found.degrees:
        axes[0, 0].plot([], [], **_dots(degree, "0.3"), label=f"elements of degree {degree}")
    plot.save(figure, path)


def _looks(found: Precision, style) -> dict[str, dict]:
    """Line of each scheme; those that differ in a parameter only have dots of other spacing."""
    names = {run.scheme: run.name for run in found.runs}
    looks: dict[str, dict] = {}
    for scheme, name in names.items():
        before = sum(names[other] == name for other in looks)
        looks[scheme] = style(name) | ({"linestyle": (0, (1, 1 + before))} if before else {})
    return looks


def _dots(degree: int, colour: str) -> dict[str, Any]:
    marker = {1: "o", 2: "s", 3: "^"}[degree]
    return {"linestyle": "", "color": colour, "marker": marker, "markersize": 4}


def _draw_runs(ax, found: Precision, name: str, scheme: str, look: dict) -> None:
    """All runs of a scheme as pale points, and its front as a line through some of them."""
    front = found.front(name, scheme)

    def places(runs):
        # Errors of exactly 0 have no place on a logarithmic axis.
        return [run.seconds for run in runs], [max(run.errors[name], 1e-17) for run in runs]

    ax.plot(*places(front), label=scheme, **look)
    for run in found.runs:
        if run.scheme == scheme and run.errors.get(name, np.nan) <= 1:
            pale = {} if run in front else {"alpha": 0.25, "markeredgewidth": 0}
            ax.plot(*places([run]), **_dots(run.mesh.degree, look["color"]), **pale)


def _draw_limits(ax, found: Precision, name: str) -> None:
    """What the reference cannot tell, a decade at least, and schemes without an error below 1."""
    floor = found.floor(name)
    shown = [run.errors[name] for run in found.runs if run.errors.get(name, np.nan) <= 1]
    low = max(1e-17, min([*shown, floor or 1.0]))
    if floor:
        ax.axhspan(low / 10, floor, color="0.92", label="not told from the reference")
    ax.set(ylim=(low / 3, 3 * max([*shown, 10 * low])))
    if lost := [scheme for scheme in found.schemes if not found.front(name, scheme)]:
        text = "\n".join(["No error below 1:", *lost])
        ax.text(0.03, 0.04, text, transform=ax.transAxes, fontsize=7, color="0.3")
