"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError, as_float, check_takes, is_whole, positive, require
from fx_beam.laws.schemes import EnergyMomentum, Scheme
from fx_beam.motions.dynamics import simulate
from fx_beam.motions.progress import progress_bar
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.sweeps import sweep
from fx_beam_studies import candidates

from . import accuracy
from .accuracy import MAX_HALVINGS, Exact, History, Mesh, Precision, Quantity, Run
from .report import prepare, write

#: Time step of the solutions that give the error of a mesh: the smallest step over this number.
FINE_STEP = 8
# A run and the quantities that were measured in it.
Measured = tuple[Run, dict[str, History]]


class Fine(Run):
    """A fine solution, by `EnergyMomentum`; its failing steps are halved as often as usual."""


def study(
    scene: Callable[[int, int], Scene],
    quantities: Mapping[str, Quantity],
    *,
    t_end: float,
    dt: Sequence[float],
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
    4 times the elements of the finest mesh of the highest degree. The error of a reference is
    estimated by its difference from a second solution with twice the step and half the elements.
    Solutions with a fine step on each mesh separate the error of the time step from that of the
    mesh.

    The first round of runs gives the errors. It begins with the cheapest run, after which a wrong
    quantity raises an error. In the other rounds, which are timed, the candidates run in turn. A
    run that ends early is a row with the reason; a quantity or a reference that cannot be computed
    has a note.

    Parameters
    ----------
    scene : callable
        ``scene(elements, degree)`` gives the `Scene`.
    quantities : dict
        Quantities of interest by name. ``quantity(solution)`` gives a number, a history (n,) or
        (n, k) at `Solution.t`, a pair of times and such a history, or None if there is no value.
    t_end : float
        End of the simulations [s].
    dt : sequence of float
        Time steps [s].
    meshes : sequence of (int, int)
        Pairs of elements and degree.
    schemes : dict or sequence of Scheme
        Time schemes, by label or by their names.
    exact : dict, optional
        Exact references by name: a number, or a function of times (n,) that gives (n,) or (n, k).
    start : callable, optional
        ``start(elements, degree)`` gives the `Solution` from which the motions start, as `start` of
        `simulate`; by default they start from the reference configuration.
    finer : (int, int)
        The time step of the reference is the smallest step divided by the first number. The number
        of its elements is that of the finest mesh of the highest degree times the second number,
        which must be even.
    repetitions : int
        Timed runs of each candidate, of which the least time is taken.
    results : path, optional
        Files to write, without their endings: JSON, CSV, and a Markdown page with its pictures.
    executor : concurrent.futures.Executor or int, optional
        An executor or a number of processes for errors and references, as for `sweep`; the
        functions are sent to the processes. By default this process alone. Timed runs are always
        made in this process, one after another; with an executor the times of first calls are not
        known.

    Returns
    -------
    Precision
        Runs, errors and run times.

    Raises
    ------
    SceneError
        For wrong arguments, before the first long run.
    KeyboardInterrupt
        If interrupted; `results` are written. The attribute `precision` of this exception, and of
        any other after the first run, has the results so far.
    """
    exact = exact or {}
    check_takes(scene, "elements, degree", "scene")
    _check(quantities, exact, t_end, dt, meshes, finer, repetitions)
    labelled, grid = candidates.labelled(schemes), [Mesh(*mesh) for mesh in meshes]
    motion = _Motion(scene, start, t_end, quantities, labelled)
    runs = [
        Run(label, scheme.name, mesh, step)
        for mesh, (label, scheme), step in itertools.product(grid, labelled.items(), dt)
    ]
    sought = [name for name in quantities if name not in exact]
    fine = _fine(grid, min(dt), finer) if sought else []
    for mesh in [*grid, *(run.mesh for run in fine[:1])]:
        motion.at(mesh)
    references = {name: accuracy.exact(name, value, t_end) for name, value in exact.items()}
    if results is not None:
        prepare(results)
    precision = Precision(
        t_end,
        repetitions,
        references={name: np.nan if name in sought else None for name in quantities},
        origin=str(fine[0]) if sought else "",
        runs=[],
        start=getattr(start, "__name__", repr(start)) if start else "",
        missing=dict.fromkeys(sought, "not computed before the study ended"),
    )
    try:
        with progress_bar((1 + repetitions) * len(runs) + len(fine), None, desc="runs") as bar:
            _errors(precision, motion, runs, fine, references, executor, bar)
            if executor is not None:
                _load(precision.runs, motion)
            _time(precision.runs, motion, repetitions, bar)
        if results is not None:
            write(results, precision)
    except BaseException as stopped:
        stopped.precision = precision  # type: ignore[attr-defined]
        if isinstance(stopped, KeyboardInterrupt) and results is not None and precision.runs:
            precision.missing["some runs"] = "the study was interrupted"
            write(results, precision)
        raise
    return precision


def _check(quantities, exact, t_end, dt, meshes, finer, repetitions) -> None:
    """Check the arguments before anything is computed."""
    require(isinstance(quantities, Mapping), "quantities", quantities, "a dict by name")
    require(isinstance(exact, Mapping), "exact", exact, "a dict by name of a quantity")
    for name in candidates.several("quantities", list(quantities)):
        check_takes(quantities[name], "solution", f"quantity {name!r}")
    if unknown := [name for name in exact if name not in quantities]:
        raise SceneError(f"exact value of {unknown[0]!r}, which is none of {list(quantities)}")
    positive(t_end, "t_end")
    require(is_whole(repetitions, 1), "repetitions", repetitions, "a whole number, at least 1")
    for step in candidates.several("dt", dt):
        fits = 0 < as_float(step) <= t_end
        require(fits, "dt", step, f"a positive number, at most t_end = {t_end:g}")
    for mesh in candidates.several("meshes", meshes):
        fits = np.shape(mesh) == (2,) and all(is_whole(n, 1) for n in mesh)
        require(fits, "mesh", mesh, "a pair of elements and degree, as (8, 1)")
    fits = np.shape(finer) == (2,) and all(is_whole(n, 1) for n in finer) and finer[1] % 2 == 0
    require(fits, "finer", finer, "a pair of whole numbers, as (16, 4), the second one even")


def _fine(grid: list[Mesh], dt: float, finer: tuple[int, int]) -> list[Fine]:
    """The reference, a coarser one that checks it, and a solution with a fine step on each mesh."""
    best = max(grid, key=lambda mesh: (mesh.degree, mesh.elements))
    pairs = [(Mesh(best.elements * finer[1] // k, best.degree), dt / finer[0] * k) for k in (1, 2)]
    pairs += [(mesh, dt / FINE_STEP) for mesh in grid]
    name = EnergyMomentum().name
    return [Fine(name, name, mesh, step) for mesh, step in pairs]


@dataclass
class _Motion:
    """The scene on its meshes, and the state from which each starts."""

    scene: Callable[[int, int], Scene]
    start: Callable[[int, int], Solution] | None
    t_end: float
    quantities: Mapping[str, Quantity]
    schemes: dict[str, Scheme]
    made: dict[Mesh, tuple[Scene, Solution | None]] = field(default_factory=dict)

    def __getstate__(self):
        # A worker makes its own scenes: their functions of time need not be sent.
        return vars(self) | {"made": {}}

    def at(self, mesh: Mesh) -> tuple[Scene, Solution | None]:
        """The scene of a mesh, made once, and its start."""
        if mesh not in self.made:
            size = mesh.elements, mesh.degree
            scene = accuracy.called(f"scene{size}", self.scene, *size)
            if not isinstance(scene, Scene):
                raise SceneError(f"scene{size} gives {scene!r:.40}, which is not a Scene")
            start = self.start and accuracy.called(f"start{size}", self.start, *size)
            self.made[mesh] = scene, start
        return self.made[mesh]

    def solve(self, run: Run) -> tuple[Solution, float, float]:
        """The solution, up to a step that fails; time and processor time of the call [s]."""
        scene, start = self.at(run.mesh)
        how: dict[str, Any] = {"dt": run.dt, "t_end": self.t_end, "start": start}
        how |= {} if isinstance(run, Fine) else {"max_halvings": MAX_HALVINGS}
        scheme = EnergyMomentum() if isinstance(run, Fine) else self.schemes[run.scheme]
        clock, used = perf_counter(), process_time()
        try:
            solution = simulate(scene, scheme, progress=False, **how)
        except StepError as failed:
            if failed.solution is None:  # no step failed: the scene or the start is wrong
                raise
            solution = failed.solution
        return solution, perf_counter() - clock, process_time() - used

    def measure(self, run: Run) -> Measured:
        """The run with what its solution says of it, and its quantities; in a worker, if any."""
        solution, run.first_seconds, _ = self.solve(run)
        stats, energy = solution.stats, solution.energy
        for name in ("unknowns", "steps", "newton_iterations", "halvings"):
            setattr(run, name, getattr(stats, name))
        run.seconds, run.step_seconds = run.first_seconds, stats.seconds
        run.reached = float(solution.t[-1])
        run.failure = stats.failure.reason if stats.failure else ""
        size = (energy.kinetic + energy.stored).max()
        # Without energy nothing moves, and no energy is lost.
        run.energy_error = float(abs(energy.gained).max() / size) if size else 0.0
        histories = {}
        for name, quantity in self.quantities.items() if not run.failure else ():
            try:
                histories[name] = accuracy.measure(name, quantity, solution)
            except SceneError as wrong:
                run.notes[name] = str(wrong)
        return run, histories


def _errors(precision: Precision, motion: _Motion, runs, fine, exact, executor, bar) -> None:
    """All runs, the cheapest first, then the fine solutions; and the errors of the runs."""
    number, every = len(runs), [*runs, *fine]
    cost = [run.mesh.elements * run.mesh.degree / run.dt for run in runs]
    queue = [*sorted(range(number), key=cost.__getitem__), *range(number, len(every))]
    done: dict[int, Measured] = {}
    completed = 0
    try:
        with closing(sweep.run(motion.measure, [every[k] for k in queue], executor)) as outcomes:
            for index, (job, _, error) in outcomes:
                run, histories = done[queue[index]] = job or (every[queue[index]], {})
                run.failure = run.failure or error
                if error and len(done) == 1:
                    raise SceneError(error)
                if not run.failure and not completed:  # wrong quantities are refused at once
                    _compare(precision, [(run, histories)], [], exact)
                    for note in run.notes.values():
                        raise SceneError(f"{note} ({run})")
                completed += not run.failure
                if executor is not None:
                    run.first_seconds = np.nan
                bar.update()
                if not completed and done.keys() >= set(range(number)):
                    break  # all runs broke off: no reference is needed
    finally:
        precision.runs.extend(done[k][0] for k in range(number) if k in done)
        measured = [done[k] for k in range(number) if k in done and not done[k][0].failure]
        both = {number, number + 1} <= done.keys()
        solved = [done[k] for k in range(number, len(every)) if k in done and both]
        _compare(precision, measured, solved, exact)


def _compare(precision: Precision, measured, fine, exact: dict[str, History]) -> None:
    """Errors relative to the references, and relative to a fine step on the same mesh.

    `fine` has the solutions of `_fine`, or nothing where the first two are missing.
    """
    references = dict(exact)
    for name in list(precision.missing) if fine else ():
        try:
            both = (_history(motion, name) for motion in fine[:2])
            references[name] = accuracy.computed(name, *both)
            precision.references[name] = references[name].error
            del precision.missing[name]
        except SceneError as wrong:
            precision.missing[name] = str(wrong)
    for solved in measured:
        solved[0].errors = {q: _error(solved, q, references.get(q)) for q in precision.references}
        solved[0].step_errors = dict(solved[0].errors)
    for best in fine[2:]:
        mesh, errors = best[0].mesh, precision.mesh_errors.setdefault(best[0].mesh, {})
        for name in (name for name in references if name not in exact):
            try:
                mesh_history = replace(_history(best, name), size=references[name].size)
            except SceneError as wrong:
                precision.missing[str(mesh)] = str(wrong)
                continue
            errors[name] = _error(best, name, references[name])
            for solved in (solved for solved in measured if solved[0].mesh == mesh):
                solved[0].step_errors[name] = _error(solved, name, mesh_history)


def _history(measured: Measured, name: str) -> History:
    run, histories = measured
    if name not in histories:
        raise SceneError(f"{run}: {run.failure or run.notes[name]}")
    return histories[name]


def _error(measured: Measured, name: str, reference: History | None) -> float:
    """Error of a quantity of a run; NaN if there is none, with a note if one was expected."""
    run, histories = measured
    try:
        if name in histories and reference is not None:
            return accuracy.error(name, histories[name], reference)
    except SceneError as wrong:
        run.notes[name] = str(wrong)
    return np.nan


def _load(runs: list[Run], motion: _Motion) -> None:
    """One step of each kind of run: forms that workers have compiled are loaded here, untimed."""
    for run in {(run.scheme, run.mesh.degree): run for run in runs if run.steps}.values():
        with suppress(SceneError, StepError):
            replace(motion, t_end=run.dt).solve(run)


def _time(runs: list[Run], motion: _Motion, repetitions: int, bar) -> None:
    """Least run times. The runs take turns, so that a slow period of the machine affects all.

    Processor times depend less on other work of the machine. They are an upper limit for the steps.
    They replace the times of the first round one by one: after Ctrl-C each run has a time.
    """
    for turn, run in itertools.product(range(repetitions), runs):
        if run.steps:
            solution, _, used = motion.solve(run)
            before = (run.seconds, run.step_seconds) if turn else (np.inf, np.inf)
            run.seconds = min(used, before[0])
            run.step_seconds = min(used, solution.stats.seconds, before[1])
        bar.update()
