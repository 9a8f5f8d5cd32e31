"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from fx_beam.analyses import workers
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
from .precision import MAX_HALVINGS, Mesh, Precision, Run
from .report import prepare, write

_log = logging.getLogger("fx_beam")

#: Time step of the solutions that give the error of a mesh: the smallest step over this number.
FINE_STEP = 8


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
    finer: tuple[int, int] = (16, 4),
    repetitions: int = 5,
    results: Path | str | None = None,
    executor: Executor | int | None = None,
) -> Precision:
    """Errors of quantities of interest against run time.

    Every scheme runs with every time step on every mesh. An error is the largest distance from the
    reference at all times of the run, over the largest magnitude of the reference. References that
    are not exact are solutions by `EnergyMomentum`, by default with a 16th of the smallest step and
    4 times the elements of the finest mesh of the highest degree. A second solution with twice the
    step and half the elements checks them: the difference is taken as their error. Solutions with a
    fine step on each mesh separate the error of the time step from that of the mesh.

    The first round of runs compiles the forms and gives the errors. Further rounds are timed; in
    each round the candidates take turns. The cheapest run is the first of all, and a wrong quantity
    raises an error after it. Later errors do not end the study: a run that broke off is a row with
    its reason, a quantity without a value has a note, and so has a failed reference.

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
    finer : (int, int)
        The reference's time step is the smallest step over the first number; its elements are
        those of the finest mesh of the highest degree times the second number, which is even.
    repetitions : int
        Timed runs of each candidate, of which the least time is taken.
    results : path, optional
        Files to write, without their endings: JSON, CSV, and a Markdown page with its pictures.
    executor : concurrent.futures.Executor or int, optional
        What computes the errors and the references, as for `sweep`: an executor or a number of
        processes, to which the functions are sent; by default this process alone. Timed runs take
        place here, one after another, and times of first calls are not known.

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
    _check(quantities, exact, t_end, steps, meshes, repetitions)
    labelled, grid = candidates.labelled(schemes), [Mesh(*mesh) for mesh in meshes]
    sought = {name: quantity for name, quantity in quantities.items() if name not in exact}
    degree = max(mesh.degree for mesh in grid)
    elements = max(mesh.elements for mesh in grid if mesh.degree == degree)
    fine = [
        (Mesh(elements * finer[1] // k, degree), min(steps) / finer[0] * k, EnergyMomentum())
        for k in (1, 2)
    ]
    motion = _Motion(scene, start, t_end)
    for mesh in [*grid, fine[0][0]] if sought else grid:
        motion.at(mesh)
    references = {name: accuracy.exact(name, value, t_end) for name, value in exact.items()}
    if results is not None:
        prepare(results)

    found = Precision(
        t_end=t_end,
        repetitions=repetitions,
        references={name: np.nan if name in sought else None for name in quantities},
        origin=f"{EnergyMomentum().name}, {fine[0][0]}, dt = {fine[0][1]:.3g} s" if sought else "",
        runs=[],
        start=getattr(start, "__name__", repr(start)) if start else "",
        missing=dict.fromkeys(sought, "not computed: no run was completed, or Ctrl-C came first"),
    )
    count = (1 + repetitions) * len(grid) * len(labelled) * len(steps)
    try:
        with progress_bar(count, None, desc="runs") as bar:
            order = list(itertools.product(grid, labelled, steps))
            measured = _first_round(
                motion, order, labelled, quantities, references, found, bar, executor
            )
            if sought and measured:
                _against_fine(motion, grid, sought, fine, min(steps), found, measured, executor)
            if executor is not None:
                _load(found.runs, motion, labelled)
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


def _check(quantities, exact, t_end, steps, meshes, repetitions) -> None:
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
    for mesh in candidates.several("meshes", meshes):
        if np.shape(mesh) != (2,) or not all(is_whole(n, 1) for n in mesh):
            raise SceneError(f"mesh {mesh!r} must be a pair of elements and degree, as (8, 1)")


class _Motion:
    """The scene on its meshes, and the state from which each starts."""

    def __init__(self, scene, start, t_end: float):
        if not callable(scene):
            raise SceneError(f"a study needs a function scene(elements, degree), not {scene!r:.40}")
        self._functions, self._t_end = (("scene", scene), ("start", start)), t_end
        self._made: dict[Mesh, list[Any]] = {}

    def __getstate__(self):
        # A worker makes its own scenes: their functions of time need not be sent.
        return vars(self) | {"_made": {}}

    def at(self, mesh: Mesh) -> list[Any]:
        """The scene of a mesh, made once, and its start."""
        if mesh not in self._made:
            size = mesh.elements, mesh.degree
            made = [f and accuracy.called(f"{name}{size}", f, *size) for name, f in self._functions]
            if not isinstance(made[0], Scene):
                raise SceneError(f"scene{size} gives {made[0]!r:.40}, which is not a Scene")
            self._made[mesh] = made
        return self._made[mesh]

    def solve(self, mesh: Mesh, dt: float, scheme: Scheme, **keywords) -> Solution:
        """The solution."""
        scene, start = self.at(mesh)
        return simulate(scene, scheme, dt=dt, t_end=self._t_end, start=start, **keywords)

    def attempt(self, mesh: Mesh, dt: float, scheme: Scheme) -> tuple[Solution, float, float]:
        """The solution, up to a step that fails; time and processor time of the call [s]."""
        self.at(mesh)
        clock, used = perf_counter(), process_time()
        try:
            found = self.solve(mesh, dt, scheme, max_halvings=MAX_HALVINGS, progress=False)
        except StepError as failed:
            if failed.solution is None:  # no step failed: the scene or the start is wrong
                raise
            found = failed.solution
        return found, perf_counter() - clock, process_time() - used


# -- Runs ----------------------------------------------------------------------------------------


def _first_round(
    motion: _Motion, order, schemes, quantities, exact, found: Precision, bar, executor
) -> list[tuple[Run, dict[str, History]]]:
    """All runs, the cheapest first, and the histories of those that were completed."""
    measured: list[tuple[Run, dict[str, History]]] = []
    cheapest = sorted(order, key=lambda run: run[0].elements * run[0].degree / run[2])
    jobs = [(mesh, label, schemes[label], dt) for mesh, label, dt in cheapest]
    first = partial(_first, motion=motion, quantities=quantities)
    with closing(workers.run(first, jobs, executor)) as outcomes:
        for place, (given, _, error) in outcomes:
            mesh, label, scheme, dt = jobs[place]
            run, histories, refused = given or (Run(label, scheme.name, mesh, dt), {}, None)
            run.failure = run.failure or error
            if not found.runs and (refused or error):
                raise refused or SceneError(error)
            if executor is not None:
                run.first_seconds = np.nan
            if not run.failure:
                run.errors = dict.fromkeys(quantities, np.nan)
                run.errors |= _errors(histories, exact, run.notes)
                run.step_errors = dict(run.errors)
                if run.notes and not measured:
                    note = next(iter(run.notes.values()))
                    raise SceneError(f"{note} ({label}, {mesh}, dt = {dt:.4g} s)")
                measured.append((run, histories))
            found.runs.append(run)
            found.runs.sort(key=lambda run: order.index((run.mesh, run.scheme, run.dt)))
            bar.update()
    return measured


def _first(
    job, motion: _Motion, quantities
) -> tuple[Run, dict[str, History], SceneError | StepError | None]:
    """A run, its histories, and an error of its scene or scheme; in a worker, if there are any."""
    mesh, label, scheme, dt = job
    run = Run(label, scheme.name, mesh, dt)
    try:
        solution, run.first_seconds, _ = motion.attempt(mesh, dt, scheme)
    except (SceneError, StepError) as refused:
        run.failure = str(refused)
        return run, {}, refused
    _fill(run, solution)
    return run, {} if run.failure else _measure(quantities, solution, run.notes), None


def _fill(run: Run, solution: Solution) -> None:
    """Enter what a solution says of its run."""
    stats, energy = solution.stats, solution.energy
    for name in ("unknowns", "steps", "newton_iterations", "halvings"):
        setattr(run, name, getattr(stats, name))
    run.seconds, run.step_seconds = run.first_seconds, stats.seconds
    run.reached = float(solution.t[-1])
    run.failure = stats.failure.reason if stats.failure else ""
    size = (energy.kinetic + energy.stored).max()
    # Without energy nothing moves, and no energy is lost.
    run.energy_error = float(abs(energy.gained).max() / size) if size else 0.0


def _load(runs: list[Run], motion: _Motion, schemes) -> None:
    """One step of each kind of run: forms that workers have compiled are loaded here, untimed."""
    for run in {(run.scheme, run.mesh.degree): run for run in runs if run.steps}.values():
        scene, start = motion.at(run.mesh)
        with suppress(SceneError, StepError):
            simulate(scene, schemes[run.scheme], dt=run.dt, t_end=run.dt, start=start)


def _time(runs: list[Run], motion: _Motion, schemes, repetitions: int, bar) -> None:
    """Least run times. The runs take turns, so that a slow period of the machine affects all.

    Processor times depend less on other work of the machine. They are an upper limit for the steps.
    They replace the times of the first round one by one: after Ctrl-C each run has a time.
    """
    for turn, run in itertools.product(range(repetitions), runs):
        if run.steps:
            solution, _, used = motion.attempt(run.mesh, run.dt, schemes[run.scheme])
            times = used, min(used, solution.stats.seconds)
            if turn:
                times = min(times[0], run.seconds), min(times[1], run.step_seconds)
            run.seconds, run.step_seconds = times
        bar.update()


# -- References ----------------------------------------------------------------------------------


def _against_fine(
    motion: _Motion, grid, quantities, fine, dt: float, found, measured, executor
) -> None:
    """Errors relative to the references, and relative to a fine step on the same mesh."""
    settings = [*fine, *((mesh, dt / FINE_STEP, EnergyMomentum()) for mesh in grid)]
    references: dict[str, Reference] = {}
    given: dict[int, tuple[dict[str, History], dict[str, str]]] = {}
    solve = partial(_solved, motion=motion, quantities=quantities)
    with closing(workers.run(solve, settings, executor)) as outcomes:
        for place, (value, _, error) in outcomes:
            given[place] = value or ({}, dict.fromkeys(quantities, error))
            if place < 2 and {0, 1} <= given.keys():
                references = _compare(given, found)
                if not references:
                    return
                for run, histories in measured:
                    run.errors |= _errors(histories, references, run.notes)
    for place, mesh in enumerate(grid, len(fine)):
        histories, missing = given[place]
        best = {name: history for name, history in histories.items() if name in references}
        reasons = [reason for name, reason in missing.items() if name in references]
        found.missing.update({str(mesh): reason for reason in reasons})
        found.mesh_errors[mesh] = _errors(best, references, {})
        on_mesh = {name: h.reference(references[name].size) for name, h in best.items()}
        for run, histories in measured:
            if run.mesh == mesh:
                run.step_errors |= _errors(histories, on_mesh, {})


def _compare(given, found: Precision) -> dict[str, Reference]:
    """References by the first two of the fine solutions, with their errors."""
    (best, missing), (second, more) = given[0], given[1]
    missing = more | missing
    both = [name for name in best if name in second]
    references = _noted(both, missing, lambda q: accuracy.computed(q, best[q], second[q]))
    found.references.update({name: reference.error for name, reference in references.items()})
    found.missing.clear()
    found.missing.update(missing)
    return references


def _solved(setting, motion: _Motion, quantities) -> tuple[dict[str, History], dict[str, str]]:
    """Quantities of a fine solution, and reasons for missing ones; in a worker, if any."""
    mesh, dt, scheme = setting
    missing: dict[str, str] = {}
    _log.info("reference: %s, dt = %.3g s", mesh, dt)
    try:
        solution = motion.solve(mesh, dt, scheme)
    except (SceneError, StepError) as failed:
        reason = f"the reference, {mesh} with dt = {dt:.3g} s: {failed}"
        _log.warning(reason)
        return {}, dict.fromkeys(quantities, reason)
    return _measure(quantities, solution, missing), missing


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
