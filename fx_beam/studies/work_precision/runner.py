"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, suppress
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from fx_beam.analyses import workers
from fx_beam.analyses.dynamics import simulate
from fx_beam.analyses.progress import progress_bar
from fx_beam.errors import SceneError, StepError
from fx_beam.mechanics.schemes import EnergyMomentum, Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.studies import candidates, reporting
from fx_beam.validation import is_number, is_whole, require

from . import accuracy
from .accuracy import Exact, History, Quantity, Reference
from .precision import MAX_HALVINGS, Mesh, Precision, Run
from .report import write

#: Time step of the solutions that give the error of a mesh: the smallest step over this number.
FINE_STEP = 8


class Job(NamedTuple):
    """A run to be made: of a candidate, or a fine solution."""

    mesh: Mesh
    label: str
    scheme: Scheme
    dt: float
    max_halvings: int = MAX_HALVINGS


# A run and the quantities that were measured in it.
Measured = tuple[Run, dict[str, History]]


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
    jobs = [
        Job(mesh, label, labelled[label], dt)
        for mesh, label, dt in itertools.product(grid, labelled, steps)
    ]
    sought = [name for name in quantities if name not in exact]
    fine = _fine(grid, min(steps), finer) if sought else []
    motion = _Motion(scene, start, t_end, quantities)
    for mesh in [*grid, *(job.mesh for job in fine[:1])]:
        motion.at(mesh)
    references = {name: accuracy.exact(name, value, t_end) for name, value in exact.items()}
    if results is not None:
        reporting.prepare(results)
    found = Precision(
        t_end=t_end,
        repetitions=repetitions,
        references={name: np.nan if name in sought else None for name in quantities},
        origin=f"{fine[0].label}, {fine[0].mesh}, dt = {fine[0].dt:.3g} s" if sought else "",
        runs=[],
        start=getattr(start, "__name__", repr(start)) if start else "",
        missing=dict.fromkeys(sought, "not computed before the study ended"),
    )
    try:
        with progress_bar((1 + repetitions) * len(jobs) + len(fine), None, desc="runs") as bar:
            _errors(found, motion, jobs, fine, references, executor, bar)
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
        require(isinstance(given, Mapping), name, given, "a dict by name")
    for name in candidates.several("quantities", list(quantities)):
        if not callable(quantities[name]):
            raise SceneError(f"quantity {name!r} must be a function of the solution")
    if unknown := [name for name in exact if name not in quantities]:
        raise SceneError(f"exact value of {unknown[0]!r}, which is none of {list(quantities)}")
    require(is_number(t_end) and t_end > 0, "t_end", t_end, "a positive number")
    for dt in candidates.several("steps", steps):
        fits = is_number(dt) and 0 < dt <= t_end
        require(fits, "a step", dt, f"a positive number, at most t_end = {t_end:g}")
    require(is_whole(repetitions, 1), "repetitions", repetitions, "a whole number, at least 1")
    for mesh in candidates.several("meshes", meshes):
        fits = np.shape(mesh) == (2,) and all(is_whole(n, 1) for n in mesh)
        require(fits, "a mesh", mesh, "a pair of elements and degree, as (8, 1)")


def _fine(grid: list[Mesh], dt: float, finer: tuple[int, int]) -> list[Job]:
    """The reference, a coarser one that checks it, and a solution with a fine step on each mesh."""
    finest = max(grid, key=lambda mesh: (mesh.degree, mesh.elements))
    settings = [
        (Mesh(finest.elements * finer[1] // k, finest.degree), dt / finer[0] * k) for k in (1, 2)
    ]
    settings += [(mesh, dt / FINE_STEP) for mesh in grid]
    scheme = EnergyMomentum()
    return [Job(mesh, scheme.name, scheme, step, 12) for mesh, step in settings]


class _Motion:
    """The scene on its meshes, the state from which each starts, and what is measured."""

    def __init__(self, scene, start, t_end: float, quantities: Mapping[str, Quantity]):
        if not callable(scene):
            raise SceneError(f"a study needs a function scene(elements, degree), not {scene!r:.40}")
        self._functions, self._t_end = (("scene", scene), ("start", start)), t_end
        self._quantities = quantities
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

    def solve(self, job: Job) -> tuple[Solution, float, float]:
        """The solution, up to a step that fails; time and processor time of the call [s]."""
        scene, start = self.at(job.mesh)
        how: dict[str, Any] = {"dt": job.dt, "t_end": self._t_end, "start": start}
        clock, used = perf_counter(), process_time()
        try:
            found = simulate(scene, job.scheme, max_halvings=job.max_halvings, **how)
        except StepError as failed:
            if failed.solution is None:  # no step failed: the scene or the start is wrong
                raise
            found = failed.solution
        return found, perf_counter() - clock, process_time() - used

    def measure(self, job: Job) -> Measured:
        """A run with its quantities; in a worker, if there are any."""
        solution, seconds, _ = self.solve(job)
        stats, energy = solution.stats, solution.energy
        size = (energy.kinetic + energy.stored).max()
        run = Run(
            job.label,
            job.scheme.name,
            job.mesh,
            job.dt,
            stats.unknowns,
            stats.steps,
            stats.newton_iterations,
            stats.halvings,
            reached=float(solution.t[-1]),
            failure=stats.failure.reason if stats.failure else "",
            # Without energy nothing moves, and no energy is lost.
            energy_error=float(abs(energy.gained).max() / size) if size else 0.0,
            first_seconds=seconds,
            seconds=seconds,
            step_seconds=stats.seconds,
        )
        histories = {}
        for name, quantity in self._quantities.items():
            if not run.failure:
                try:
                    histories[name] = accuracy.measure(name, quantity, solution)
                except SceneError as wrong:
                    run.notes[name] = str(wrong)
        return run, histories


# -- Errors --------------------------------------------------------------------------------------


def _errors(found: Precision, motion, jobs, fine, exact, executor, bar) -> None:
    """All runs, the cheapest first, then the fine solutions; and the errors of the runs."""
    order = [(job.mesh, job.label, job.dt) for job in jobs]
    queue = sorted(jobs, key=lambda job: job.mesh.elements * job.mesh.degree / job.dt) + fine
    measured: list[Measured] = []
    solved: dict[int, Measured] = {}
    try:
        with closing(workers.run(motion.measure, queue, executor)) as outcomes:
            for place, (given, _, error) in outcomes:
                job = queue[place]
                failed = Run(job.label, job.scheme.name, job.mesh, job.dt, failure=error)
                run, histories = given or (failed, {})
                if place >= len(jobs):
                    solved[place - len(jobs)] = run, histories
                    continue
                if executor is not None:
                    run.first_seconds = np.nan
                for name in found.references if not run.failure else ():
                    run.errors[name] = _error(run, histories, name, exact.get(name))
                    run.step_errors[name] = run.errors[name]
                if error and not found.runs:
                    raise SceneError(error)
                if run.notes and not measured:
                    note = next(iter(run.notes.values()))
                    raise SceneError(f"{note} ({run.scheme}, {run.mesh}, dt = {run.dt:.4g} s)")
                found.runs.append(run)
                found.runs.sort(key=lambda run: order.index((run.mesh, run.scheme, run.dt)))
                measured += [(run, histories)] if not run.failure else []
                bar.update()
    finally:
        _compare(found, measured, solved)


def _error(run: Run, histories: Mapping[str, History], name: str, reference) -> float:
    """Error of a quantity of a run; NaN if there is none, and a note if that is not expected."""
    try:
        if name in histories and reference is not None:
            return accuracy.error(name, histories[name], reference)
    except SceneError as wrong:
        run.notes[name] = str(wrong)
    return np.nan


def _compare(found: Precision, measured: list[Measured], solved: dict[int, Measured]) -> None:
    """Errors relative to the references, and relative to a fine step on the same mesh."""
    if not {0, 1} <= solved.keys():
        return
    for name in [name for name, error in found.references.items() if error is not None]:
        lacking = [run for run, histories in (solved[0], solved[1]) if name not in histories]
        if lacking:
            found.missing[name] = f"the reference, {_why(lacking[0], name)}"
            continue
        try:
            reference = accuracy.computed(name, solved[0][1][name], solved[1][1][name])
        except SceneError as wrong:
            found.missing[name] = str(wrong)
            continue
        del found.missing[name]
        found.references[name] = reference.error
        for run, histories in measured:
            run.errors[name] = _error(run, histories, name, reference)
        for fine, on_mesh in (solved[place] for place in sorted(solved) if place > 1):
            errors = found.mesh_errors.setdefault(fine.mesh, {})
            if name not in on_mesh:
                found.missing[str(fine.mesh)] = _why(fine, name)
                continue
            errors[name] = _error(fine, on_mesh, name, reference)
            best = Reference(on_mesh[name].at, reference.size)
            for run, histories in measured:
                if run.mesh == fine.mesh:
                    run.step_errors[name] = _error(run, histories, name, best)


def _why(run: Run, name: str) -> str:
    """Why a fine solution has not a quantity."""
    return f"{run.mesh} with dt = {run.dt:.3g} s: {run.failure or run.notes[name]}"


# -- Run times -----------------------------------------------------------------------------------


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
            solution, _, used = motion.solve(Job(run.mesh, run.scheme, schemes[run.scheme], run.dt))
            times = used, min(used, solution.stats.seconds)
            if turn:
                times = min(times[0], run.seconds), min(times[1], run.step_seconds)
            run.seconds, run.step_seconds = times
        bar.update()
