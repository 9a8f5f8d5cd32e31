"""Equilibria of a scene under rising loads."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.errors import Failure, SceneError, StepError
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.bend_check import warn_of_sharp_bends
from fx_beam.motions.contact_check import warn_of_depth
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.initial_state import reference_state
from fx_beam.motions.mpi_ranks import waiting_team, warn_of_equal_work
from fx_beam.motions.progress import attach, failure_of, keeping_steps, progress_bar
from fx_beam.motions.run_setup import state_of
from fx_beam.parallel.whole import shared
from fx_beam.results.audit import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.inputs import values_at, with_functions
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.inverted_sections import InversionCheck
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions, StepFailed
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.substeps import MOST_HALVINGS
from fx_beam.step.turning_frame import TurningFrame, check_turns
from fx_beam.validation import (
    as_float,
    is_flag,
    is_number,
    is_one_of,
    is_whole,
    require,
    shown,
    vector,
)

from .arc_length import ArcLength
from .branch_step import first_step, is_equilibrium
from .branches import Branch, grown
from .critical_points import PathStability
from .load_steps import LoadStepper
from .settling import Settling
from .static_path import StaticPath, keep_path

_log = logging.getLogger("fx_beam")
# Largest number of load steps.
_MOST_STEPS = 10_000_000
_UNSTABLE = (
    "static: the equilibrium of this mechanism is unstable; it stands there because its parts are "
    "placed so. Place them a little beside it to find a stable one"
)
_BAR = "{percentage:3.0f}%|{bar}| load factor {n:.3g} [{elapsed}]"


@keeping_steps
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
    inputs: Mapping[str, Any] | None = None,
    spin: float = 0.0,
    pivot: Sequence[float] = (0.0, 0.0),
    start: Solution | Branch | None = None,
    branches: int = 0,
) -> Solution:
    """Compute equilibria of a scene while its loads rise from zero.

    The load factor multiplies all loads, including the weight, prescribed motions and motors.
    Functions of time are evaluated at the time `t`. Inertia, damping and initial velocities have no
    effect. The work of the loads uses the mean of the forces at both ends of each step; the energy
    balance thus has an error of second order in the steps. The potential energy is that of the full
    weight; the part of the weight that does not act yet is counted as an upward load.

    Parameters
    ----------
    scene : Scene
        The scene.
    steps : int
        Number of load steps, if none is divided. A step that fails, or whose work is too
        inaccurate, is halved; after steps with few iterations the length is doubled again. Springs
        under tension are released before the first load step, in the same number of steps. An
        arc-length step changes the load factor by at most 1/`steps`, and its turn is limited in
        proportion.
    t : float
        Time at which functions of time are evaluated [s].
    continuation : {"arc-length"}, optional
        Method to pass limit points: the load factor is an unknown; it falls after a limit point
        and rises again after the next. A path is abandoned at the load factor -10. By default the
        load factor only rises.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_cuts : int
        How often a step may be halved.
    max_steps : int
        Largest number of arc-length steps; if the path has not reached load factor 1 by then, it
        ends and ``stats.failure`` reports this.
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal if the run takes longer than two
        seconds.
    inputs : dict, optional
        For names of inputs of the scene (`Input`) a constant or a function of time. The others are
        zero.
    spin : float
        Spin Omega [rad/s] of a frame in which the scene rests: a steady turn, with the centrifugal
        forces of all masses. Supports, obstacles and loads turn with the frame. The centrifugal
        forces increase with the load factor l, so that a row has the spin Omega sqrt(l), and
        velocities. `modes`, `linearise` and `simulate` continue with this rotation.
    pivot : (float, float)
        Point about which the frame turns [m].
    start : Solution, optional
        A solution from whose last state to start: loads one after the other, such as prestress and
        then a load. The forces that held this state decrease to zero while the loads of the scene
        increase to their full values, so that loads in both stay constant. Prescribed motions and
        motors continue from their present position; a new support holds its node where it is.
        Velocities have no effect. Internal variables, work and dissipated energy continue.

        Or a branch, ``point.branch(+1)`` of a bifurcation among the `critical_points` of a path of
        the same scene that had no `start`, with the same `t` and `inputs`; with
        ``continuation="arc-length"``. The first row is the bifurcation. The path ends at load
        factor 1, or where it returns to the bifurcation.
    branches : int
        Levels of branches that are followed, by arc length, from all bifurcations in both
        directions of each mode; those of the second level start at bifurcations of the first. They
        are in ``solution.branches``.

    Returns
    -------
    Solution
        The equilibria, with their load factors in `Solution.load_factor` in place of times, their
        stability in `unstable_modes`, and `critical_points`. The load factors of limit points that
        arc-length steps have passed, which are also rows, are in ``stats.limit_points``.

    Raises
    ------
    SceneError
        Before the first step, if the scene cannot be in equilibrium, or its loads leave it free to
        move.
    StepError
        If a step fails. Its attribute `solution` has all steps before it, `time` the load factor.
    KeyboardInterrupt
        After Ctrl-C. Its attribute `solution` has the steps so far, or is None before the first
        one. Every other exception has `solution` as well.

    Examples
    --------
    An end moment bends a cantilever into a quarter circle.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_moment(beam.end, math.pi / 2)
    >>> solution = fb.static(scene, steps=4)
    >>> bool(abs(solution.rotation(beam.end)[-1] - math.pi / 2) < 1e-8)
    True
    """
    _check(scene, steps, t, continuation, newton, max_cuts, max_steps, progress)
    _check_turn(scene, spin, pivot, start)
    _check_branches(branches, start, continuation, spin)
    warn_of_equal_work()
    given = scene
    scene, values = (
        with_functions(scene, inputs, "static: inputs"),
        values_at(scene, inputs, as_float(t)),
    )
    clock = time.perf_counter()
    scheme = Equilibrium()
    model = Model(scene, scheme, settles=True)
    stats = Stats(
        scheme=scheme.name,
        level=scheme.rates.level,
        solver="sparse lu",
        unknowns=len(model.reduction.independent),
        compiled=model.compiled,
        assembled=model.assembled,
        static=True,
    )
    if continuation is not None and model.points.follow_joints:
        raise SceneError(
            "static: arc-length steps do not find the force of a joint that its friction follows, "
            "fx_beam.Coulomb. Use load steps (without continuation), or fx_beam.Friction"
        )
    turning = TurningFrame(model, as_float(spin), pivot) if spin else None
    forcing = LoadForcing(model, as_float(t), turning)
    stepper = LoadStepper(model, forcing, newton or NewtonOptions(), stats)
    team = waiting_team() if continuation is None else None
    if team is not None:
        stats.solver = f"PETSc on {team.size} processes"
    inversion = InversionCheck(model, stats)
    stats.setup_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    states = _Path(progress_bar(1.0, progress, bar_format=_BAR))
    branches_off = isinstance(start, Branch)
    try:
        with states.bar, shared(team, stepper.single):
            _follow(stepper, states, start, continuation, steps, max_cuts, max_steps)
        if states[-1].t < 1 and stats.steps >= max_steps:
            factor = states[-1].t
            reason = f"static: load factor {factor:g}, below 1, after max_steps = {max_steps} steps"
            stats.failure = Failure("too many steps", reason, factor)
            _log.warning(reason)
        solution = _solution(stepper, inversion, states, clock, values, branches_off)
        warn_of_depth(solution)
        warn_of_sharp_bends(solution)
        keep_path(StaticPath(solution, model, forcing, states, given, inputs, start is not None))
    except BaseException as error:
        stats.failure = failure_of(error, states[-1].t if states else 0.0)
        if states:
            parts = inversion, states, clock, values, branches_off
            attach(error, lambda: _solution(stepper, *parts))
        if isinstance(error, StepError) and stats.steps:
            _name_critical_point(error, stepper, states, branches_off)
            warn_of_sharp_bends(error.solution)
        raise
    if branches:

        def follow(origin: Branch) -> Solution:
            return static(
                given,
                steps,
                t=t,
                continuation="arc-length",
                newton=newton,
                max_cuts=max_cuts,
                max_steps=max_steps,
                progress=progress,
                inputs=inputs,
                start=origin,
            )

        grown(solution, branches, follow)
    return solution


def _follow(
    stepper: LoadStepper,
    states: list[State],
    start: Solution | Branch | None,
    continuation: str | None,
    steps: int,
    max_cuts: int,
    max_steps: int,
) -> None:
    """Append the states of a path."""
    model = stepper.model
    if isinstance(start, Branch):
        arc = ArcLength(stepper)
        states.append(_bifurcation(arc, start))
        shape = model.from_nodes(start.shape)
        try:
            new, ahead, distance = first_step(arc, states[0], shape, steps, max_cuts)
        except StepFailed as failure:
            raise arc.error(states[0], failure, max_cuts) from failure
        stepper.stats.steps += 1
        states.append(new)
        arc.follow(states, steps, max_cuts, max_steps, (ahead, distance))
        return
    if model.mechanism:
        states.append(_settled(stepper, start, 1 / steps))
    elif start is None:
        states.append(stepper.first_state(steps, max_cuts))
    else:
        states.append(stepper.start_from(_at_rest(model, start)))
    if continuation is None:
        stepper.raise_load(states, steps, max_cuts)
    else:
        ArcLength(stepper).follow(states, steps, max_cuts, max_steps)


def _settled(stepper: LoadStepper, start: Solution | None, goal: float) -> State:
    """The first state of a mechanism, which its loads hold."""
    model = stepper.model
    if start is None:
        state = reference_state(model)
    else:
        try:
            return stepper.start_from(state := _at_rest(model, start))
        except StepError:
            pass  # the forces that held it do not hold it alone
    state = Settling(stepper).settled(state, goal)
    if state.negative_eigenvalues:
        _log.warning(_UNSTABLE)
    return state


def _bifurcation(arc: ArcLength, start: Branch) -> State:
    """The state in which a branch starts."""
    point = start.point
    state = replace(_at_rest(arc.model, point.solution), t=point.load_factor)
    if not is_equilibrium(arc, state):
        raise SceneError(
            "static: start is a branch of another path: the bifurcation is no equilibrium of "
            f"this scene at load factor {point.load_factor:g}. Give the scene, t and inputs of "
            "its path, which must not have a start of its own"
        )
    return state


def _at_rest(model: Model, start: Solution) -> State:
    """The last state of a solution, at rest, at load factor 0."""
    state, rest = state_of(model, start), np.zeros(model.size)
    return replace(state, t=0.0, v=rest, a=rest.copy(), parts=None, past=None, inputs=None)


class _Path(list[State]):
    """States of a path; a progress bar shows the load factor of the last one."""

    def __init__(self, bar):
        self.bar = bar

    def append(self, state: State) -> None:
        super().append(state)
        self.bar.update(state.t - self.bar.n)


def _solution(
    stepper: LoadStepper,
    inversion: InversionCheck,
    states: list[State],
    clock: float,
    inputs=None,
    branches_off: bool = False,
) -> Solution:
    model, stats = stepper.model, stepper.stats
    stats.seconds, stats.substeps = time.perf_counter() - clock, stats.steps
    path = list(states)
    if stepper.forcing.turning is not None:
        states = [_turning(model, stepper.forcing.turning, state) for state in states]
    recorder = Recorder(model, np.array([state.t for state in states]), Record())
    for step, state in enumerate(states):
        recorder.record(step, state)
        inversion.check(state.t, state.q)
    end = replace(states[-1], t=stepper.forcing.time, inputs=inputs)

    def solved(state: State) -> Solution:
        return _solution(stepper, inversion, [state], clock, inputs)

    stability = PathStability(stepper, path, solved, branches_off).found_when_read()
    return solution_of(model, recorder, stats, lambda: end, stability=stability)


def _name_critical_point(
    error: StepError, stepper: LoadStepper, states: list[State], branches_off: bool
) -> None:
    """Let an error say that its path fails at a critical point."""
    try:
        stability = PathStability(stepper, list(states), lambda state: error.solution, branches_off)
        points = stability.at_end()
    except (ValueError, RuntimeError, StepFailed):
        return
    for point in points:
        # Beyond the last state it is extrapolated.
        advice = f"There is a {point.kind} near load factor {point.load_factor:.4g}. "
        if point.kind == "bifurcation":
            advice += (
                "Follow a branch: point = error.solution.critical_points[-1], and then static("
                'scene, start=point.branch(+1), continuation="arc-length"); or give the load a '
                "little more or less"
            )
        else:
            advice += error.failure.advice
        error.failure = stepper.stats.failure = replace(error.failure, advice=advice)
        error.args = (str(error.failure),)


def _turning(model: Model, frame: TurningFrame, state: State) -> State:
    """A state in its turn, with the work that made it turn."""
    v = frame.rates(state.q, state.t)
    a = -state.t * frame.spin**2 * frame.arms(state.q)
    return replace(state, v=v, a=a, work=state.work + float(v @ (model.mass @ v)) / 2)


def _check_turn(scene: Scene, spin, pivot, start) -> None:
    """Refuse a spin or pivot that is none, and what cannot turn with the scene."""
    require(is_number(spin), "static: spin", spin, "a finite number [rad/s]")
    vector(pivot, 2, "static: pivot")
    if spin:
        check_turns(scene, "static: spin")
        if start is not None:
            raise SceneError(
                "static: start with a spin: the loads of a turn rise from zero. Give all loads at "
                "once, without start"
            )


def _check_branches(branches, start, continuation, spin) -> None:
    require(is_whole(branches, 0, 10), "static: branches", branches, "a whole number from 0 to 10")
    if isinstance(start, Branch) and continuation is None:
        raise SceneError('static: start is a branch. Follow it by continuation="arc-length"')
    if branches and (start is not None or spin):
        raise SceneError("static: branches are followed of paths without start and spin")


def _check(scene, steps, t, continuation, newton, max_cuts, max_steps, progress) -> None:
    if not isinstance(scene, Scene):
        raise SceneError(f"static needs an fx_beam.Scene, not {shown(scene)}")
    for name, value in (("steps", steps), ("max_steps", max_steps)):
        fits = is_whole(value, 1, _MOST_STEPS)
        wanted = f"a whole number from 1 to {_MOST_STEPS:,}"
        require(fits, f"static: {name}", value, wanted)
    fits = is_whole(max_cuts, 0, MOST_HALVINGS)
    wanted = f"a whole number from 0 to {MOST_HALVINGS}"
    require(fits, "static: max_cuts", max_cuts, wanted)
    require(is_number(t), "static: t", t, "a finite number")
    fits = continuation is None or is_one_of(continuation, ("arc-length",))
    require(fits, "static: continuation", continuation, '"arc-length" or None')
    fits = isinstance(newton, NewtonOptions | None)
    require(fits, "static: newton", newton, "an fx_beam.NewtonOptions")
    fits = progress is None or is_flag(progress)
    require(fits, "static: progress", progress, "True, False or None")
