"""Equilibria of a scene under growing loads."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

import numpy as np

from fx_beam.errors import Failure, SceneError, StepError
from fx_beam.mechanics.schemes import Equilibrium
from fx_beam.model.model import Model
from fx_beam.results.audit import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.stepping.arc_length import ArcLength
from fx_beam.stepping.forcing import LoadDrive
from fx_beam.stepping.load_steps import LoadStepper
from fx_beam.stepping.newton import NewtonOptions, petsc
from fx_beam.stepping.recorder import Record, Recorder
from fx_beam.stepping.section_facing import FacingCheck
from fx_beam.stepping.substeps import MOST_HALVINGS
from fx_beam.validation import is_number, is_whole, require

from .evaluation import solution_of
from .progress import failure_of, keep, progress_bar

_log = logging.getLogger("fx_beam")
_BAR = "{percentage:3.0f}%|{bar}| load factor {n:.3g} [{elapsed}]"


def static(
    scene: Scene,
    steps: int = 10,
    *,
    t: float = 0.0,
    continuation: str | None = None,
    newton: NewtonOptions | None = None,
    max_cuts: int = 8,
    max_steps: int = 1000,
    progress: bool | None = None,
) -> Solution:
    """Equilibria of a scene while its loads grow from nothing.

    The load factor multiplies all loads, the weight and prescribed motions and motors included.
    Those that are functions of time are taken at the time `t`. Masses, dampers and initial
    velocities play no part. The work of the loads is counted with the mean of the forces at both
    ends of each step, so that the balance of energy closes to second order in the steps; of the
    weight, whose full potential energy counts, the part that does not yet act is a load upwards.

    Parameters
    ----------
    scene : Scene
        What is loaded.
    steps : int
        Load steps, if none is cut: a step that fails, or is too long for its work, is halved, and
        steps grow again where they are easy. Springs under tension are let go in as many, before.
        Along an arc length none changes the load factor by more than 1/`steps`, and none turns by
        more than in proportion to that.
    t : float
        When functions of time are taken [s].
    continuation : {"arc-length"}, optional
        How limit points are passed: with the load factor as an unknown, that goes down behind a
        limit point and up again behind the next; a path that comes to -10 is given up. By default
        the load factor only grows.
    newton : NewtonOptions, optional
        When Newton's method stops.
    max_cuts : int
        How often a step may be halved.
    max_steps : int
        Steps after which a path along an arc length ends, if it has not come to load factor 1;
        ``stats.failure`` says so.
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal when the path takes longer than
        two seconds.

    Returns
    -------
    Solution
        The equilibria, with their load factors in `Solution.load_factor` in place of times. Load
        factors of limit points, which are rows as well, are in ``stats.limit_points``.

    Raises
    ------
    SceneError
        Before anything is computed, for a scene that cannot be in equilibrium.
    RuntimeError
        Where PETSc is missing.
    StepError
        For a step that failed. Its attribute `solution` holds all steps before it, and `time` the
        load factor.
    KeyboardInterrupt
        For Ctrl-C. Its attribute `solution` holds the steps so far.

    Examples
    --------
    An end moment bends a cantilever into a quarter circle.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.clamp(beam.start)
    >>> scene.add_moment(beam.end, math.pi / 2)
    >>> solution = fb.static(scene, steps=4)
    >>> bool(abs(solution.rotation(beam.end)[-1] - math.pi / 2) < 1e-8)
    True
    """
    _check(scene, steps, t, continuation, newton, max_cuts, max_steps, progress)
    petsc("fx_beam.static")
    clock = time.perf_counter()
    scheme = Equilibrium()
    model = Model(scene, scheme)
    stats = Stats(
        scheme=scheme.name,
        level=scheme.rates.level,
        solver="petsc lu" if continuation is None else "superlu",
        unknowns=model.reduction.free,
        compiled=model.compiled,
        assembled=model.assembled,
        static=True,
    )
    drive = LoadDrive(model, float(t))
    stepper = LoadStepper(model, drive, newton or NewtonOptions(), stats)
    facing = FacingCheck(model, stats)
    stats.setup_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    states = _Path(progress_bar(1.0, progress, bar_format=_BAR))
    try:
        with states.bar:
            states.append(stepper.first_state(steps, max_cuts))
            if continuation is None:
                stepper.raise_load(states, steps, max_cuts)
            else:
                ArcLength(stepper).follow(states, steps, max_cuts, max_steps)
    except (StepError, KeyboardInterrupt) as error:
        stats.failure = failure_of(error, states[-1].t if states else 0.0)
        keep(error, _solution(stepper, facing, states, clock) if states else None)
        raise
    if states[-1].t < 1:
        factor = states[-1].t
        reason = f"static: {max_steps} steps, and no further than load factor {factor:g}"
        stats.failure = Failure("too many steps", reason, factor)
        _log.warning(reason)
    return _solution(stepper, facing, states, clock)


class _Path(list[State]):
    """States of a path; the bar shows the load factor of the last one, which may go down."""

    def __init__(self, bar):
        self.bar = bar

    def append(self, state: State) -> None:
        super().append(state)
        self.bar.update(state.t - self.bar.n)


def _solution(
    stepper: LoadStepper, facing: FacingCheck, states: list[State], clock: float
) -> Solution:
    model, stats = stepper.model, stepper.stats
    stats.seconds, stats.substeps = time.perf_counter() - clock, stats.steps
    recorder = Recorder(model, np.array([state.t for state in states]), Record())
    for step, state in enumerate(states):
        recorder.record(step, state)
        facing.check(state.t, state.q)
    end = replace(states[-1], t=stepper.drive.time)
    return solution_of(model, recorder, stats, end)


def _check(scene, steps, t, continuation, newton, max_cuts, max_steps, progress) -> None:
    if not isinstance(scene, Scene):
        raise SceneError(f"static needs an fx_beam.Scene, not {scene!r}")
    for name, value, least in (("steps", steps, 1), ("max_steps", max_steps, 1)):
        wanted = f"a whole number from {least} on"
        require(is_whole(value, least), f"static: {name}", value, wanted)
    fits = is_whole(max_cuts, 0, MOST_HALVINGS)
    wanted = f"a whole number from 0 to {MOST_HALVINGS}"
    require(fits, "static: max_cuts", max_cuts, wanted)
    require(is_number(t), "static: t", t, "a finite number")
    fits = continuation is None or (isinstance(continuation, str) and continuation == "arc-length")
    require(fits, "static: continuation", continuation, '"arc-length" or None')
    fits = isinstance(newton, NewtonOptions | None)
    require(fits, "static: newton", newton, "an fx_beam.NewtonOptions")
    wanted = "True, False or None"
    require(isinstance(progress, bool | None), "static: progress", progress, wanted)
