"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from . import accuracy
from .accuracy import Exact, History, Quantity, Reference
from .dynamics import simulate
from .errors import SceneError, StepError
from .precision import Mesh, Precision, Run
from .precision_report import sentence, write
from .scene import Scene
from .schemes import EnergyMomentum, Scheme
from .solution import Solution

__all__ = ["Mesh", "Precision", "Run", "sentence", "study", "write"]

_log = logging.getLogger("fx_beam")

#: How much finer than all runs a computed reference is, in the time step and in the element.
FINER_STEP, FINER_MESH = 16, 4
#: A failing step of a run is halved at most so often: more would only draw out a lost motion.
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
    repetitions: int = 5,
    results: Path | str | None = None,
) -> Precision:
    """Errors of quantities of interest against run time.

    Every scheme runs with every time step on every mesh. An error is the largest distance from the
    reference at all times of the run, over the largest magnitude of the reference. References that
    are not exact are solutions by `EnergyMomentum` with a step 16 times as fine as the finest and
    elements 4 times as many as the most, of the highest degree; their own error is estimated from a
    second one with twice the step and half the elements. A fine step on each mesh tells the error
    of the step from that of the mesh.

    A first round of runs compiles and gives the errors. Those that follow, in turn over all
    candidates, are timed. A run that fails is a row with its reason.

    Parameters
    ----------
    scene : callable
        ``scene(elements, degree)`` gives the `Scene`.
    quantities : dict
        Quantities of interest by name. ``quantity(solution)`` gives a number; a history (n,) or
        (n, k) at `Solution.t`; or a pair of times and such a history.
    t_end : float
        End of the simulations [s].
    steps : sequence of float
        Time steps [s].
    meshes : sequence of (int, int)
        Pairs of elements and degree.
    schemes : dict or sequence of Scheme
        Time schemes, by label or by their names.
    exact : dict, optional
        References that are known, by name of their quantity: a number, or a function of times
        (n,) that gives (n,) or (n, k).
    repetitions : int
        Timed runs of each candidate, of which the median is taken.
    results : path, optional
        Where to write, without ending: JSON, a Markdown page, and the picture in it.

    Returns
    -------
    Precision
        What was found.

    Raises
    ------
    SceneError
        If the scene cannot be computed, or something named is not there.
    StepError
        If the reference fails.
    """
    exact = exact or {}
    _check(scene, quantities, schemes, steps, meshes, exact, repetitions)
    labelled = schemes if isinstance(schemes, Mapping) else {s.name: s for s in schemes}
    grid = [Mesh(*mesh) for mesh in meshes]
    references = {name: accuracy.exact(name, value, t_end) for name, value in exact.items()}
    sought = {name: q for name, q in quantities.items() if name not in exact}
    by_mesh: dict[Mesh, dict[str, History]] = {}
    origin = ""
    if sought:
        computed, by_mesh, origin = _computed(scene, sought, t_end, min(steps), grid)
        references |= computed

    scenes = {mesh: scene(mesh.elements, mesh.degree) for mesh in grid}
    runs = []
    for mesh, label, dt in itertools.product(grid, labelled, steps):
        solution = _solve(scenes[mesh], labelled[label], dt, t_end)
        run = _row(label, mesh, dt, solution)
        runs.append(run)
        if not run.failure:
            histories = _measure(quantities, solution)
            run.errors = _errors(histories, references)
            run.step_errors = _errors(histories, _on_mesh(references, by_mesh.get(mesh, {})))
    _time(runs, scenes, labelled, t_end, repetitions)
    found = Precision(
        t_end=t_end,
        repetitions=repetitions,
        references={name: references[name].error for name in quantities},
        origin=origin,
        runs=runs,
        mesh_errors={mesh: _errors(histories, references) for mesh, histories in by_mesh.items()},
    )
    if results is not None:
        write(results, found)
    return found


def _check(scene, quantities, schemes, steps, meshes, exact, repetitions) -> None:
    """Refuse what could not be computed, before anything is."""
    for name, given in (
        ("quantities", quantities),
        ("schemes", schemes),
        ("steps", steps),
        ("meshes", meshes),
    ):
        if not len(given):
            raise SceneError(f"a study needs {name}; none are given")
    if isinstance(scene, Scene):
        raise SceneError(
            "a study needs a function scene(elements, degree) that makes the scene, not a scene"
        )
    names = list(schemes) if isinstance(schemes, Mapping) else [s.name for s in schemes]
    if twice := [name for name in names if names.count(name) > 1]:
        raise SceneError(
            f"several schemes are called {twice[0]}; give a dict of labels and schemes"
        )
    if wrong := [mesh for mesh in meshes if np.shape(mesh) != (2,)]:
        raise SceneError(f"mesh {wrong[0]!r} must be a pair of elements and degree, as (8, 1)")
    if unknown := [name for name in exact if name not in quantities]:
        raise SceneError(f"exact value of {unknown[0]!r}, which is none of {list(quantities)}")
    if repetitions < 1:
        raise SceneError(f"repetitions = {repetitions!r} must be at least 1")


# -- References ----------------------------------------------------------------------------------


def _computed(scene, quantities, t_end, step, meshes):
    """References by quantity; histories with a fine step by mesh; and where both come from."""
    dt = step / FINER_STEP
    elements, degree = max(m.elements for m in meshes), max(m.degree for m in meshes)
    finest, coarser = (Mesh(n * elements, degree) for n in (FINER_MESH, FINER_MESH // 2))
    fine = _fine(scene, finest, quantities, dt, t_end)
    coarse = _fine(scene, coarser, quantities, 2 * dt, t_end)
    references = {name: accuracy.computed(name, fine[name], coarse[name]) for name in quantities}
    by_mesh = {mesh: _fine(scene, mesh, quantities, dt, t_end) for mesh in meshes}
    origin = f"{EnergyMomentum().name}, {finest}, dt = {dt:.3g} s"
    return references, by_mesh, origin


def _on_mesh(references, histories) -> dict[str, Reference]:
    """What a scheme would come to on a mesh if its step were fine."""
    fine = {name: Reference(h.at, references[name].size) for name, h in histories.items()}
    return references | fine


def _fine(scene, mesh, quantities, dt, t_end) -> dict[str, History]:
    """Quantities of interest by the scheme of the references."""
    _log.info("reference: %s, dt = %.3g s", mesh, dt)
    try:
        solution = simulate(scene(mesh.elements, mesh.degree), EnergyMomentum(), dt=dt, t_end=t_end)
    except StepError as failed:
        failed.args = (f"the reference, {mesh} with dt = {dt:.3g} s: {failed}",)
        raise
    return _measure(quantities, solution)


# -- Runs ----------------------------------------------------------------------------------------


def _solve(scene: Scene, scheme: Scheme, dt: float, t_end: float) -> Solution:
    """The solution, as far as the scheme goes."""
    try:
        return simulate(
            scene, scheme, dt=dt, t_end=t_end, max_halvings=MAX_HALVINGS, progress=False
        )
    except StepError as failed:
        if failed.solution is None:  # not a step of the scheme, but what is given at the start
            raise
        return failed.solution


def _row(label: str, mesh: Mesh, dt: float, solution: Solution) -> Run:
    stats = solution.stats
    return Run(
        scheme=label,
        name=stats.scheme,
        mesh=mesh,
        dt=dt,
        unknowns=stats.unknowns,
        steps=stats.steps,
        newton_iterations=stats.newton_iterations,
        halvings=stats.halvings,
        reached=float(solution.t[-1]),
        failure=stats.failure.split(". ")[0],
        first_setup_seconds=stats.setup_seconds,
    )


def _measure(quantities, solution: Solution) -> dict[str, History]:
    return {name: accuracy.measure(name, q, solution) for name, q in quantities.items()}


def _errors(
    histories: Mapping[str, History], references: Mapping[str, Reference]
) -> dict[str, float]:
    return {name: accuracy.error(name, h, references[name]) for name, h in histories.items()}


def _time(runs: list[Run], scenes, schemes, t_end: float, repetitions: int) -> None:
    """Median run times, all runs in turn so that a slow moment of the machine hits them alike."""
    runs = [run for run in runs if not run.failure]
    stats: list[list] = [[] for _ in runs]
    for _ in range(repetitions):
        for run, found in zip(runs, stats, strict=True):
            found.append(_solve(scenes[run.mesh], schemes[run.scheme], run.dt, t_end).stats)
    for run, found in zip(runs, stats, strict=True):
        low, middle, high = np.quantile([one.seconds for one in found], [0.25, 0.5, 0.75])
        run.seconds, run.quartiles = float(middle), (float(low), float(high))
        run.setup_seconds = float(np.median([one.setup_seconds for one in found]))
