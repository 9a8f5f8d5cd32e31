"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.analyses.dynamics import simulate
from fx_beam.analyses.progress import progress_bar
from fx_beam.errors import SceneError, StepError
from fx_beam.mechanics.schemes import EnergyMomentum, Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.studies import candidates
from fx_beam.validation import is_number, is_whole, require

from . import accuracy
from .accuracy import Exact, History, Quantity, Reference
from .precision import Mesh, Precision, Run
from .report import prepare, write

_log = logging.getLogger("fx_beam")

#: Refinement of a computed reference, relative to the finest run, in time step and element.
FINER_STEP, FINER_MESH = 16, 4
#: Largest number of halvings of a failing step: more would only prolong a lost motion.
MAX_HALVINGS = 2


def study(
    scene: Callable[[int, int], Scene],
    quantities: Mapping[str, Quantity],
    *,
    t_end: float,
    steps: Sequence[float],
    meshes: Sequence[tuple[int, int]],
    schemes: Mapping[str, Scheme] | Sequence[Scheme],
    exact: Mapping[str, Exact] | None = None,
    start: Callable[[int, int], Solution] | None = None,
    repetitions: int = 5,
    results: Path | str | None = None,
) -> Precision:
    """Errors of quantities of interest against run time.

    Every scheme runs with every time step on every mesh. An error is the largest distance from the
    reference at all times of the run, over the largest magnitude of the reference. References that
    are not exact are solutions by `EnergyMomentum`: with a 16th of the smallest step, and 4 times
    the largest number of elements, of the highest degree. Their own error is estimated from a
    second solution with twice the step and half the elements. Solutions with a fine step on each
    mesh separate the error of the time step from that of the mesh.

    The first round of runs compiles the forms and gives the errors. Further rounds are timed; in
    each round the candidates take turns. The cheapest run is the first of all, and a wrong quantity
    raises an error after it. Later errors do not end the study: a failed run is a row with its
    reason, a quantity without a value has a note, and so has a failed reference.

    Parameters
    ----------
    scene : callable
        ``scene(elements, degree)`` gives the `Scene`.
    quantities : dict
        Quantities of interest by name. ``quantity(solution)`` gives a number; a history (n,) or
        (n, k) at `Solution.t`; a pair of times and such a history; or None if there is no value.
    t_end : float
        End of the simulations [s].
    steps : sequence of float
        Time steps [s].
    meshes : sequence of (int, int)
        Pairs of elements and degree.
    schemes : dict or sequence of Scheme
        Time schemes, by label or by their names.
    exact : dict, optional
        Exact references by name of their quantity: a number, or a function of times (n,) that
        gives (n,) or (n, k).
    start : callable, optional
        ``start(elements, degree)`` gives the `Solution` to start from, as `simulate` takes it; by
        default the motions start from the reference configuration.
    repetitions : int
        Timed runs of each candidate, of which the median is taken.
    results : path, optional
        Files to write, without their endings: JSON, CSV, and a Markdown page with its pictures.

    Returns
    -------
    Precision
        Runs, errors and run times.

    Raises
    ------
    SceneError
        For wrong arguments, before the first long run. A later error has the results so far as its
        attribute `precision`.
    KeyboardInterrupt
        If interrupted. It has the attribute `precision` as well, and `results` are written.
    """
    exact = exact or {}
    _check(quantities, exact, t_end, steps, repetitions)
    labelled, grid = candidates.labelled(schemes), _grid(meshes)
    sought = {name: quantity for name, quantity in quantities.items() if name not in exact}
    finest, dt = _finer(grid, FINER_MESH), min(steps) / FINER_STEP
    motion = _Motion(scene, start, t_end, grid)
    if sought:
        motion.at(finest)
    references = {name: accuracy.exact(name, value, t_end) for name, value in exact.items()}
    if results is not None:
        prepare(results)

    found = Precision(
        t_end=t_end,
        repetitions=repetitions,
        references={name: np.nan if name in sought else None for name in quantities},
        origin=f"{EnergyMomentum().name}, {finest}, dt = {dt:.3g} s" if sought else "",
        runs=[],
        start=getattr(start, "__name__", repr(start)) if start else "",
        missing=dict.fromkeys(sought, "not computed: no run was completed, or Ctrl-C came first"),
    )
    count = (1 + repetitions) * len(grid) * len(labelled) * len(steps)
    try:
        with progress_bar(count, None, desc="runs") as bar:
            measured = _first_round(motion, quantities, references, labelled, steps, found, bar)
            if sought and measured:
                _against_fine(motion, sought, dt, found, measured)
            _time(found.runs, motion, labelled, repetitions, bar)
        if results is not None:
            write(results, found)
    except BaseException as stopped:
        stopped.precision = found  # type: ignore[attr-defined]
        if isinstance(stopped, KeyboardInterrupt) and results is not None and found.runs:
            found.missing["some runs"] = "the study was interrupted"
            write(results, found)
        raise
    return found


# -- Arguments -----------------------------------------------------------------------------------


def _check(quantities: Any, exact: Any, t_end: Any, steps: Any, repetitions: Any) -> None:
    """Check the arguments before anything is computed."""
    for name, given in (("quantities", quantities), ("exact", exact)):
        if not isinstance(given, Mapping):
            raise SceneError(f"{name} must be a dict by name, not {given!r:.40}")
    candidates.several("quantities", list(quantities))
    for name, quantity in quantities.items():
        if not callable(quantity):
            raise SceneError(f"quantity {name!r} must be a function of the solution")
    if unknown := [name for name in exact if name not in quantities]:
        raise SceneError(f"exact value of {unknown[0]!r}, which is none of {list(quantities)}")
    require(is_number(t_end) and t_end > 0, "t_end", t_end, "a positive number")
    for dt in candidates.several("steps", steps):
        if not (is_number(dt) and 0 < dt <= t_end):
            raise SceneError(f"step {dt!r} must be a positive number, at most t_end = {t_end:g}")
    require(is_whole(repetitions, 1), "repetitions", repetitions, "a whole number, at least 1")


def _grid(meshes: Any) -> list[Mesh]:
    for mesh in candidates.several("meshes", meshes):
        if np.shape(mesh) != (2,) or not all(is_whole(n, 1) for n in mesh):
            raise SceneError(f"mesh {mesh!r} must be a pair of elements and degree, as (8, 1)")
    return [Mesh(*mesh) for mesh in meshes]


def _finer(grid: Sequence[Mesh], times: int) -> Mesh:
    """Mesh with a multiple of the largest number of elements, of the highest degree."""
    return Mesh(times * max(m.elements for m in grid), max(m.degree for m in grid))


class _Motion:
    """The scene on its meshes, and the state from which each starts."""

    def __init__(self, scene, start, t_end: float, grid: Sequence[Mesh]):
        if not callable(scene):
            raise SceneError(
                "a study needs a function scene(elements, degree) that makes the scene, "
                f"not {scene!r:.40}"
            )
        self._functions, self._t_end, self.grid = {"scene": scene, "start": start}, t_end, grid
        self._made: dict[Mesh, tuple[Scene, Solution | None]] = {}
        for mesh in grid:
            self.at(mesh)

    def at(self, mesh: Mesh) -> tuple[Scene, Solution | None]:
        """The scene of a mesh, made once, and its start."""
        if mesh not in self._made:
            made = []
            for name, function in self._functions.items():
                call = f"{name}({mesh.elements}, {mesh.degree})"
                try:
                    made.append(function and function(mesh.elements, mesh.degree))
                except Exception as wrong:
                    raise SceneError(f"{call} failed, {type(wrong).__name__}: {wrong}") from wrong
                if not isinstance(made[0], Scene):
                    raise SceneError(f"{call} gives {made[0]!r:.40}, which is not a Scene")
            self._made[mesh] = made[0], made[1]
        return self._made[mesh]

    def solve(self, mesh: Mesh, scheme: Scheme, dt: float, **keywords) -> Solution:
        """The solution."""
        scene, start = self.at(mesh)
        return simulate(scene, scheme, dt=dt, t_end=self._t_end, start=start, **keywords)

    def attempt(self, mesh: Mesh, scheme: Scheme, dt: float) -> Solution:
        """The solution, up to a step that fails."""
        try:
            return self.solve(mesh, scheme, dt, max_halvings=MAX_HALVINGS, progress=False)
        except StepError as failed:
            if failed.solution is None:  # no step failed: the scene or the start is wrong
                raise
            return failed.solution


# -- Runs ----------------------------------------------------------------------------------------


def _first_round(
    motion: _Motion, quantities, exact, schemes, steps, found: Precision, bar
) -> list[tuple[Run, dict[str, History]]]:
    """All runs, the cheapest first, and the run times of those that were completed."""
    order = list(itertools.product(motion.grid, schemes, steps))
    measured: list[tuple[Run, dict[str, History]]] = []
    for mesh, label, dt in sorted(order, key=lambda run: run[0].elements * run[0].degree / run[2]):
        histories: dict[str, History] = {}
        try:
            solution = motion.attempt(mesh, schemes[label], dt)
        except (SceneError, StepError) as refused:
            if not found.runs:
                raise
            run = Run(label, schemes[label].name, mesh, dt, failure=str(refused))
        else:
            run = _row(label, mesh, dt, solution)
        if not run.failure:
            histories = _measure(quantities, solution, run.notes)
            run.errors = dict.fromkeys(quantities, np.nan) | _errors(histories, exact, run.notes)
            run.step_errors = dict(run.errors)
            if run.notes and not measured:
                note = next(iter(run.notes.values()))
                raise SceneError(f"{note} ({label}, {mesh}, dt = {dt:.4g} s)")
            measured.append((run, histories))
        found.runs.append(run)
        found.runs.sort(key=lambda run: order.index((run.mesh, run.scheme, run.dt)))
        bar.update()
    return measured


def _row(label: str, mesh: Mesh, dt: float, solution: Solution) -> Run:
    stats, energy = solution.stats, solution.energy
    size = (energy.kinetic + energy.stored).max()
    # Fields that `Stats` and `Run` share; a failed run has no time.
    keys = ["unknowns", "steps", "newton_iterations", "halvings"]
    keys += [] if stats.failure else ["seconds", "setup_seconds"]
    return Run(
        scheme=label,
        name=stats.scheme,
        mesh=mesh,
        dt=dt,
        **{key: getattr(stats, key) for key in keys},
        quartiles=(np.nan, np.nan) if stats.failure else (stats.seconds, stats.seconds),
        reached=float(solution.t[-1]),
        failure=stats.failure.reason if stats.failure else "",
        first_setup_seconds=stats.setup_seconds,
        # Without energy nothing moves, and no energy is lost.
        energy_error=float(abs(energy.balance_error).max() / size) if size else 0.0,
    )


def _time(runs: list[Run], motion: _Motion, schemes, repetitions: int, bar) -> None:
    """Median run times. The runs take turns, so that a slow period of the machine affects all.

    They replace the times of the first round one by one: after Ctrl-C each run has a time.
    """
    spent: dict[int, list] = {k: [] for k, run in enumerate(runs) if not run.failure}
    for _, k in itertools.product(range(repetitions), spent):
        run = runs[k]
        spent[k].append(motion.attempt(run.mesh, schemes[run.scheme], run.dt).stats)
        low, middle, high = np.quantile([one.seconds for one in spent[k]], [0.25, 0.5, 0.75])
        run.seconds, run.quartiles = float(middle), (float(low), float(high))
        run.setup_seconds = float(np.median([one.setup_seconds for one in spent[k]]))
        bar.update()


# -- References ----------------------------------------------------------------------------------


def _against_fine(motion: _Motion, quantities, dt: float, found: Precision, measured) -> None:
    """Errors relative to the references, and relative to a fine step on the same mesh."""
    missing: dict[str, str] = {}
    fine, coarse = (
        _fine(motion, _finer(motion.grid, times), quantities, step, missing)
        for times, step in ((FINER_MESH, dt), (FINER_MESH // 2, 2 * dt))
    )
    both = [name for name in fine if name in coarse]
    references = _noted(both, missing, lambda q: accuracy.computed(q, fine[q], coarse[q]))
    found.references.update({name: reference.error for name, reference in references.items()})
    found.missing.clear()
    found.missing.update(missing)
    for run, histories in measured:
        run.errors |= _errors(histories, references, run.notes)
    for mesh in motion.grid if references else ():
        missing = {}
        fine = _fine(motion, mesh, {name: quantities[name] for name in references}, dt, missing)
        found.missing.update({str(mesh): reason for reason in missing.values()})
        found.mesh_errors[mesh] = _errors(fine, references, {})
        on_mesh = {name: h.reference(references[name].size) for name, h in fine.items()}
        for run, histories in measured:
            if run.mesh == mesh:
                run.step_errors |= _errors(histories, on_mesh, {})


def _fine(motion: _Motion, mesh: Mesh, quantities, dt: float, missing) -> dict[str, History]:
    """Quantities of interest by the scheme of the references, and reasons for missing ones."""
    _log.info("reference: %s, dt = %.3g s", mesh, dt)
    try:
        solution = motion.solve(mesh, EnergyMomentum(), dt)
    except (SceneError, StepError) as failed:
        reason = f"the reference, {mesh} with dt = {dt:.3g} s: {failed}"
        _log.warning(reason)
        missing |= dict.fromkeys(quantities, reason) | missing
        return {}
    return _measure(quantities, solution, missing)


# -- Quantities of interest ----------------------------------------------------------------------


def _measure(quantities, solution: Solution, notes: dict[str, str]) -> dict[str, History]:
    """Quantities of a solution; a missing one is noted with its reason."""
    return _noted(quantities, notes, lambda q: accuracy.measure(q, quantities[q], solution))


def _errors(histories, references: Mapping[str, Reference], notes: dict[str, str]):
    """Errors of quantities with a reference; a missing one is noted with its reason."""
    both = [name for name in histories if name in references]
    return _noted(both, notes, lambda q: accuracy.error(q, histories[q], references[q]))


def _noted(names: Iterable[str], notes: dict[str, str], value: Callable[[str], Any]) -> dict:
    found = {}
    for name in names:
        try:
            found[name] = value(name)
        except SceneError as wrong:
            notes[name] = str(wrong)
    return found
