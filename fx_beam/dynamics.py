"""Simulation of a scene over time."""

from __future__ import annotations

import logging
import math
import time

import numpy as np
from tqdm import tqdm

from .audit import BeamResultants, Stats
from .compat import gauss_points
from .drive import Drive
from .errors import SceneError, StepError
from .initial import initial_state
from .library import LoopUnavailable
from .loop import CompiledLoop
from .model import Model
from .newton import Newton, NewtonOptions
from .recorder import Record, Recorder
from .scene import Scene
from .schemes import EnergyMomentum, Scheme
from .solution import Solution
from .stepping import Stepper

_log = logging.getLogger("fx_beam")

#: Steps, times degrees of freedom, between two looks at the progress bar and at the keyboard.
_BLOCK = 500_000


def simulate(
    scene: Scene,
    scheme: Scheme | None = None,
    *,
    dt: float,
    t_end: float,
    newton: NewtonOptions | None = None,
    max_halvings: int = 8,
    record: Record | None = None,
    solver: str = "auto",
    progress: bool | None = None,
) -> Solution:
    """Motion of a scene from t = 0 to `t_end`.

    Parameters
    ----------
    scene : Scene
        What moves.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    dt : float
        Time step [s]. The last step is shorter where `t_end` is no multiple of it.
    t_end : float
        End of the simulation [s].
    newton : NewtonOptions, optional
        When Newton's method stops.
    max_halvings : int
        How often a failing step is halved before the simulation is given up; 0 for never.
    record : Record, optional
        What is kept; everything of every step by default.
    solver : {"auto", "compiled", "petsc"}
        Who takes the steps: a compiled loop with a banded solver, or Python with PETSc, which is
        slower and takes any scene. By default the loop where the scene allows it.
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal when the run takes longer than
        two seconds.

    Returns
    -------
    Solution
        The motion at the times 0, dt, 2 dt, ..., t_end.

    Raises
    ------
    SceneError
        Before anything runs, for a scene, scheme or time grid that cannot be computed.
    StepError
        For a step that failed. Its attribute `solution` holds all steps before it.
    """
    scheme = EnergyMomentum() if scheme is None else scheme
    if not isinstance(scene, Scene):
        raise SceneError(f"simulate needs an fx_beam.Scene, not {scene!r}")
    if not isinstance(scheme, Scheme):
        raise SceneError(
            f"unknown scheme {scheme!r}; give one such as fx_beam.EnergyMomentum() or "
            "fx_beam.Newmark(), with its brackets, or an fx_beam.Scheme of your own"
        )
    if max_halvings < 0:
        raise SceneError(f"max_halvings = {max_halvings!r} must not be negative")
    times = _time_grid(dt, t_end)

    clock = time.perf_counter()
    model = Model(scene, scheme)
    stats = Stats(
        scheme=scheme.name,
        level=scheme.rates.level,
        solver="petsc lu",
        unknowns=model.reduction.free,
        compiled=model.compiled,
        assembled=model.assembled,
    )
    options = newton or NewtonOptions()
    drive = Drive(model)
    stepper = Stepper(model, Newton(model, options), drive, stats, max_halvings)
    march = _march(solver, stepper, options)
    recorder = Recorder(model, times, record or Record())
    state = initial_state(model, drive, float(times[1]))
    recorder.record(state, state.q)
    stats.setup_seconds = time.perf_counter() - clock

    clock = time.perf_counter()
    show = None if progress is None else not progress
    try:
        # tqdm takes None as: only on a terminal.
        with tqdm(
            total=len(times) - 1, disable=show, delay=0 if progress else 2, leave=False
        ) as bar:
            steps = max(1, min(1000, _BLOCK // model.size))
            for first in range(1, len(times), steps):
                block = times[first : first + steps]
                state = march(state, block, first, recorder)
                bar.update(len(block))
    except (StepError, KeyboardInterrupt) as error:
        stats.seconds = time.perf_counter() - clock
        stats.failure = str(error) or "interrupted"
        error.solution = _solution(model, recorder, stats)  # type: ignore[union-attr]
        raise
    stats.seconds = time.perf_counter() - clock
    if stats.halvings:
        _log.warning("%s: %d steps were halved on the way", scheme.name, stats.halvings)
    return _solution(model, recorder, stats)


def _march(solver: str, stepper: Stepper, options: NewtonOptions):
    """Who takes the steps: the compiled loop where it can, and is not refused."""
    if solver not in ("auto", "compiled", "petsc"):
        raise SceneError(f'solver = {solver!r} must be "auto", "compiled" or "petsc"')
    if solver == "petsc":
        return stepper.march
    try:
        return CompiledLoop(stepper, options).march
    except LoopUnavailable as reason:
        if solver == "compiled":
            raise SceneError(f'solver = "compiled" is not to be had: {reason}') from reason
        stepper.stats.solver += f" ({reason})"
        return stepper.march


def _time_grid(dt: float, t_end: float) -> np.ndarray:
    for name, value in (("dt", dt), ("t_end", t_end)):
        if not isinstance(value, int | float | np.number) or not math.isfinite(value):
            raise SceneError(f"{name} = {value!r} must be a finite number")
    if dt <= 0:
        raise SceneError(f"dt = {dt!r} must be positive")
    if t_end < dt * (1 - 1e-6):
        raise SceneError(f"t_end = {t_end!r} is smaller than dt = {dt!r}")
    # A remainder below 1e-6 steps is rounding of t_end / dt, not a step.
    steps = math.ceil(t_end / dt - 1e-6)
    times = dt * np.arange(steps + 1)
    times[-1] = t_end
    return times


def _solution(model: Model, recorder: Recorder, stats: Stats) -> Solution:
    scene, mesh = model.scene, model.mesh
    histories = recorder.histories()
    cache: list[np.ndarray] = []

    def resultants_of_beam(name: str) -> BeamResultants:
        if not cache:
            q = recorder.arrays["q"][: recorder.rows]
            cache.append(model.forms.resultants(histories["t"], q, *recorder.steps_before()))
        number = [beam.name for beam in scene.beams].index(name)
        beam, values = scene.beams[number], cache[0][:, mesh.cells[number]]
        s = beam.s[:-1, None] + np.diff(beam.s)[:, None] * gauss_points(beam.degree).T
        N, Q, M = np.moveaxis(values.reshape(len(values), -1, 3), -1, 0)
        return BeamResultants(s.ravel(), N, Q, M)

    return Solution(
        X=mesh.X,
        **histories,
        stats=stats,
        beams={beam.name: beam for beam in scene.beams},
        nodes_of_beam={b.name: n for b, n in zip(scene.beams, mesh.nodes, strict=True)},
        resultants_of_beam=resultants_of_beam,
    )
