"""Equilibria of a scene under rising loads: the path with its states, and its solution."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fx_beam.errors import Failure, SceneError, StepError, shown
from fx_beam.laws.interval import Interval, Rest
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.contact_check import warn_of_long_elements, warn_of_places, warn_of_sharp_bends
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.initial_state import drawn_state, reference_state
from fx_beam.motions.motion_setup import check_scene, model_for, state_of, stats_of
from fx_beam.motions.progress import attach, attach_partial_result, failure_of, progress_bar
from fx_beam.motions.sweep_context import warn_of_equal_work
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution, forces_on_nodes
from fx_beam.results.state import State
from fx_beam.scene.functions import constant, present, values_at, with_functions
from fx_beam.scene.loads import Load
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch
from fx_beam.step.forcing import LoadForcing, TurningFrame, check_turns
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.state_vector import added_force
from fx_beam.step.stepper import StepFailed, count_inverted

from .arc_length import ArcLength, PathFollowing
from .critical_points import Branch, Crossings, PathStability, first_step, grow, is_equilibrium
from .load_steps import LoadStepper, StaticOptions, raise_load
from .path_equations import SmallMotions
from .settling import Settling
from .small_loads import first_order

# -- The states of a path of equilibria: the first state, and the next ones under rising loads --


_log = logging.getLogger("fx_beam")
#: What a path starts from: rest, a solution or a branch.
Start = Solution | Branch | None
# A scene that cannot follow even this part of its loads, one in so many, may settle instead.
_SHORTEST = 100
# How often loads double from the first under which such a scene settles.
_DOUBLINGS = 24
# Forces that hold the reference, relative to the largest forces at nodes, that are round-off.
_HELD = 1e-9
# Difference of load factors, in load steps, that is round-off.
_ROUNDING = 1e-9


class PathStates:
    """Finds the states of a path, from rest, a solution or a branch."""

    def __init__(self, arc: ArcLength, start: Start):
        self._arc, self._start = arc, start
        self._stepper: LoadStepper = arc.stepper
        self._options, self._model, self._path = arc.stepper.options, arc.model, arc.stepper.path

    def follow(self, states: list[State]) -> None:
        """Append all states of a path; a scene without any stiffness may settle on the way."""
        if isinstance(self._start, Branch):
            self._branch_off(self._start, states)
            return
        model, options = self._model, self._options
        if model.mechanism and model.scene.virtual_works:
            if Settling(self._stepper).freest(reference_state(model)) is None:
                model.mechanism = ""  # they hold it
        states.append(self.first_state())
        is_short = options.load_steps * 2**options.max_cuts >= _SHORTEST
        self._raise_load(states, is_short)
        if model.mechanism:
            Settling(self._stepper).check_balance(states[-1])

    def _raise_load(self, states: list[State], is_short: bool) -> None:
        """Append the states up to load factor 1, if a step `is_short` after all cuts in any way.

        A scene that follows no small part of its loads, as a slack cable, settles as a mechanism.
        """
        slack, may_settle = False, is_short and self._start is None and not self._model.mechanism
        while True:
            try:
                if self._options.continuation is None:
                    raise_load(self._stepper, states)
                else:
                    PathFollowing(self._arc, states).run()
                return
            except StepError as error:
                if is_short and self._followed_along(states):
                    continue
                # What has followed its loads for a while is not slack.
                if not (may_settle and (slack or len(states) == 1)):
                    raise
                settled = self._settled_again(states[-1], error)
                if not slack:
                    states.clear()
                    _log.warning(
                        "static: the scene follows no small part of its loads, as what is slack, "
                        "or is pushed together with hardly a load across: it has settled at load "
                        "factor %.3g, without rows before",
                        settled.t,
                    )
                states.append(settled)
                slack = True

    def _followed_along(self, states: list[State]) -> bool:
        """Whether the arc length leads through a load step that bends too sharply for all cuts.

        Its states are appended then. Behind a limit point, or if unstable, they are not.
        """
        options, limits, before = self._options, self._stepper.stats.limit_points, list(states)
        # What friction follows is not found along the arc length.
        follows = options.continuation is not None or len(self._model.points.normal_forces)
        if follows or self._is_unstable(states[-1]):
            return False
        self._arc.goal = self._end_of_load_step(states[-1])
        with suppress(StepError):
            PathFollowing(self._arc, states, part=4.0**-options.max_cuts).run()
        if states[-1].t >= self._arc.goal and not self._is_unstable(states[-1]):
            return True
        limits.clear()
        states[:] = before
        return False

    def _is_unstable(self, state: State) -> bool:
        return bool(self._stepper.motions.count(state, state))

    def _end_of_load_step(self, state: State) -> float:
        steps = self._options.load_steps
        return float(np.floor(state.t * steps + _ROUNDING) + 1) / steps

    def _settled_again(self, state: State, error: StepError) -> State:
        """The state at the end of the load step of an error, if it is stable; else the error."""
        path = self._path
        holding_forces, path.held = path.held, 0 * path.held
        with suppress(SceneError):
            new = self._settled_by_parts(state, self._end_of_load_step(state), str(error))
            if not self._is_unstable(new):
                return new
        path.held = holding_forces
        raise error

    def _settled_by_parts(self, state: State, goal: float, reason: str) -> State:
        """The equilibrium that is found by settling under loads that double from a small part.

        What is pushed together then bends to the side of its load, as by the lowest mode.
        """
        settling, last = Settling(self._stepper, reason), state
        settling.keeps_side = True
        for part in (2.0 ** -np.arange(_DOUBLINGS, 0, -1)).tolist():
            with suppress(SceneError):
                last = settling.settled(last, state.t + part * (goal - state.t))
        return settling.settled(last, goal)

    def _branch_off(self, start: Branch, states: list[State]) -> None:
        """Append the states of a branch."""
        stepper, point = self._stepper, start.point
        if not self._model.mechanism:
            self._hold_reference()
        state = replace(self._at_rest(point.solution), t=point.load_factor)
        if self._model.mechanism:
            largest = stepper.energies.largest_force(state)
            Settling(stepper).hold_rigid_motions(state, largest)
        if not is_equilibrium(self._arc, state):
            raise SceneError(
                "static: start is a branch of another path: the bifurcation is no equilibrium of "
                "this scene. Give scene, t and inputs of its path, one without a start of its own"
            )
        states.append(state)
        try:
            new, ahead, distance = first_step(self._arc, state, start.shape.flatten())
        except StepFailed as failure:
            raise self._arc.error(state, failure) from failure
        states.append(new)
        PathFollowing(self._arc, states, (ahead, distance)).run()

    # -- The first state --------------------------------------------------------------------------

    def first_state(self) -> State:
        """The equilibrium at load factor 0, from which the loads rise."""
        if self._model.mechanism:
            return self._settled()
        if isinstance(self._start, Solution):
            return self._from_state(self._at_rest(self._start))
        try:
            return self._from_reference()
        except StepError as error:
            # Laws of springs may leave a part without any support.
            settling = Settling(self._stepper)
            free = settling.freest(reference_state(self._model))
            if error.failure.kind != "singular" or free is None:
                raise
            part = settling.where(free)
            self._model.mechanism = f"Static analysis is singular: without loads {part} is free"
        self._path.held = 0 * self._path.held
        return self._settled()

    def unloaded_state(self) -> State:
        """The equilibrium without loads; from rest that to which springs under tension lead."""
        state, stepper, held = self.first_state(), self._stepper, self._path.held
        unit = self._model.units.unknowns[: len(held)]
        largest = abs(stepper.loop.balance(state, state.t).f * self._model.units.nodes).max()
        is_held = self._start is None and abs(held * unit).max(initial=0.0) > _HELD * largest
        self._path.held = 0 * held
        if not is_held:
            return state
        reason = "springs are under tension in the scene as it is drawn"
        settled = Settling(stepper, reason).settled(state, state.t)
        gained = stepper.energies.energy(settled) - stepper.energies.energy(state)
        return settled.changed(work=state.work + gained)

    def _from_reference(self) -> State:
        """The reference configuration. Forces that fade hold springs under tension there."""
        stepper, start = self._stepper, self._hold_reference()
        stepper.hold_between(0.0, 0.0)
        try:
            state = stepper.step(start, 0.0)
            if stepper.loop.singular:
                raise StepFailed("singular", "the tangent is singular", state.q - start.q)
        except StepFailed as failure:
            message = "without loads there is no equilibrium"
            advice = "Check for a part without support"
            raise stepper.loop.failures.error(message, 0, start, failure, advice) from failure
        state.work = 0.0
        return state

    def _hold_reference(self) -> State:
        """The reference, where springs have yielded; forces hold it that fade as the loads rise."""
        stepper, model = self._stepper, self._model
        state = drawn_state(model)
        if model.points.width:
            y, forces = np.zeros(model.reduction.free), np.zeros(model.size)
            new = stepper.loop.finished(state, Interval(0.0, 0.0), y, forces)
            new.dissipated += stepper.energies.energy(state) - stepper.energies.energy(new)
            state = new
        self._path.held = stepper.residual(state, 0.0)
        return state

    def _from_state(self, state: State) -> State:
        """A state as the start: the forces that hold it there fade as the loads rise."""
        stepper, forcing, model = self._stepper, self._stepper.loop.forcing, self._model
        loads = state.loads
        if loads is None:  # those at the end of a motion are not known
            loads = forcing.dead(1.0) + added_force(model, state, 1.0, forcing.time)
        # Virtual works may act at load factor 0 already.
        forcing.start_from(state, loads - added_force(model, state, 0.0, forcing.time))
        self._path.held = stepper.residual(state, 0.0)
        stepper.hold_between(0.0, 0.0)
        try:
            return replace(stepper.step(state, 0.0), work=state.work)
        except StepFailed as failure:
            message = "the state to start from is no equilibrium that the scene can hold"
            advice = "Check that the scene has the supports and joints of this state"
            raise stepper.loop.failures.error(message, 0, state, failure, advice) from failure

    def _settled(self) -> State:
        """The first state of a mechanism, which its loads hold."""
        stepper, settling = self._stepper, Settling(self._stepper)
        if not isinstance(self._start, Solution):
            state = drawn_state(self._model)
        else:
            state = self._at_rest(self._start)
            settling.hold_rigid_motions(state, stepper.energies.largest_force(state))
            with suppress(StepError):  # the forces that held it do not hold it alone
                return self._from_state(state)
        return settling.settled(state, 1 / self._options.load_steps)

    def _at_rest(self, start: Solution) -> State:
        """The last state of a solution, at rest, at load factor 0."""
        state, rest = state_of(self._model, start), np.zeros(self._model.size)
        return replace(state, t=0.0, v=rest, a=rest.copy(), parts=None, past=None, inputs=None)


# -- Equilibria of a scene under rising loads: the path with its states, and its solution -------


_BAR = "{percentage:3.0f}%|{bar}| load factor {n:.3g} [{elapsed}]"


class LoadPath:
    """The equilibria of a scene, from rest, or from a start whose loads go over to its own.

    `began` is when it was begun, by `time.perf_counter` [s].
    """

    def __init__(self, scene: Scene, options: StaticOptions, start: Start):
        check_scene(scene, "static")
        watch = Watch(scene)
        _check_start(options, scene, start)
        warn_of_equal_work()
        connected = with_functions(scene, options.inputs, "static: inputs")
        self.scene = scene
        #: Whether it starts from rest, or from a bifurcation.
        self.from_rest, self._branches_off = start is None, isinstance(start, Branch)
        # The start, until the end of the run: with it one would hold all solutions before it.
        self._start = start
        # Now, as the scene may change later.
        self._loads_on_nodes = _loads_on_nodes(scene, start, options.t)
        self._inputs = values_at(scene, options.inputs, options.t)
        self.began = time.perf_counter()
        self.options = options
        #: The model that takes the steps of the scene with its inputs.
        self.model = model = model_for(present(connected), Equilibrium(), settles=True)
        self.stats = stats_of(model, solver="sparse lu", static=True)
        if options.continuation is not None and len(model.points.normal_forces):
            raise SceneError(
                "static: arc-length steps do not find the force of a joint that its friction "
                "follows. Use load steps (without continuation), or fx_beam.SmoothFriction"
            )
        turning = TurningFrame(model, options.spin, options.pivot) if options.spin else None
        self.forcing = LoadForcing(model, options.t, turning)
        #: What takes the steps.
        self.stepper = LoadStepper(self.forcing, options, self.stats)
        self.crossings = Crossings(self.stepper)
        self.stepper.check = self.crossings.check_stability
        self.stepper.is_singular = self.crossings.is_singular
        #: Whether it warns if its last row is unstable.
        self.warns = True
        #: The states so far.
        self.states: list[State] = []
        watch.check_unchanged("static")  # it calls all functions of time
        self.stats.setup_seconds = time.perf_counter() - self.began

    @property
    def held(self) -> np.ndarray:
        """Forces (free,) that hold the start, and fade as the loads rise."""
        return self.stepper.path.held

    def whole_path(self) -> Solution:
        """The whole path. An exception has the solution of the steps before it."""
        self._clock = time.perf_counter()
        bar = progress_bar(1.0, self.options.progress, bar_format=_BAR)
        self.states = states = _States(bar)
        try:
            with bar:
                PathStates(self.crossings.arc, self._start).follow(states)
            self.stats.steps = len(states) - 1
            _end_early(self.stats, self.options, states[-1].t)
            solution = self._solution(states)
            if self.warns:
                _warn_if_unstable(self.stepper.motions, states)
            warn_of_places(solution, self.scene)
            warn_of_long_elements(solution, solution.t, solution.recorded("q"))
        except BaseException as error:
            self._fail(error)
            raise
        solution.load_path, self._start = self, None
        return solution

    def _fail(self, error: BaseException) -> None:
        """Give an error the solution of the steps before it."""
        stats, states = self.stats, self.states
        stats.failure = failure_of(error, states[-1].t if states else 0.0)
        stats.steps = max(len(states) - 1, 0)  # wherever an interrupt came
        if states:
            attach(error, lambda: self._solution(states))
        if isinstance(error, StepError) and stats.steps:
            _name_critical_point(self, error)
            warn_of_sharp_bends(error.solution)

    def unloaded_state(self) -> State:
        """The equilibrium without loads: that to which springs under tension bring the scene."""
        return PathStates(self.crossings.arc, self._start).unloaded_state()

    def unloaded(self) -> Solution:
        """The solution of one row without loads."""
        self._clock = time.perf_counter()
        return self._solution([self.unloaded_state()])

    def first_order(self) -> Solution:
        """The solution by small displacements about the equilibrium without loads."""
        if self.model.mechanism:
            raise SceneError(f"{self.model.mechanism}: it has no first-order equilibrium")
        self._clock = time.perf_counter()
        start = self.unloaded_state()

        def end(last: State) -> State:
            return replace(last, t=self.forcing.time, loads=self.forcing.dead(1.0), length=0.0)

        self.stats.linear, self.stats.steps = True, 1
        solution = first_order(self.stepper, start, self.stats, end)
        self.stats.seconds = time.perf_counter() - self._clock
        solution.loads_on_nodes = self._loads_on_nodes
        return solution

    def _solution(self, states: list[State]) -> Solution:
        """The solution of some states."""
        stats, model = self.stats, self.model
        stats.seconds, stats.substeps = time.perf_counter() - self._clock, stats.steps
        turning = [_turned(state, self.forcing) for state in states]
        recorder = Recorder(model, np.array([state.t for state in states]), Record())
        for state in turning:
            self.stepper.loop.record(state, recorder)
            if model.forms.beams is not None and model.forms.beams.is_inverted(state.q):
                count_inverted(model, stats, 1, state.t, state.q)
        # Load factors are no times: no step in time came before.
        loads, last = self.forcing.dead(turning[-1].t), replace(turning[-1], length=0.0)
        if self.forcing.turning is not None:
            loads = loads + last.t * self.forcing.turning.force(last.q)
        if model.forms.has_added:
            loads += last.added_forces
        loads += self.stepper.held_at_nodes(last)
        end = replace(last, t=self.forcing.time, loads=loads).changed(**self._inputs)
        later = {
            name: partial(self._read, name, list(states))
            for name in ("unstable_modes", "critical_points")
        }
        rest = Rest(self.forcing.time, recorder.t)
        solution = solution_of(recorder, stats, lambda: end, ended=True, stability=later, rest=rest)
        solution.loads_on_nodes = self._loads_on_nodes
        return solution

    def _read(self, name: str, states: list[State]) -> Any:
        with self.model.lock:
            stability = self.stability(states, lambda state: self._solution([state]))
            return getattr(stability, name)()

    def stability(self, states: list[State], solved: Callable[[State], Solution]) -> PathStability:
        """The stability of states, whose `solved` gives the solution of one."""
        return PathStability(self.stepper, self.crossings, states, solved, self._branches_off)


def _end_early(stats: Stats, options: StaticOptions, factor: float) -> None:
    """Warn of a path that ends below load factor 1 since it has too many steps."""
    stopped = stats.closed or (options.stop_at and stats.limit_points)
    if factor < 1 and not stopped and stats.steps >= options.max_steps:
        reason = f"static: load factor {factor:g}, below 1, after max_steps = {options.max_steps}"
        stats.failure = Failure("too many steps", f"{reason} steps", factor)
        _log.warning(stats.failure.reason)


def _name_critical_point(path: LoadPath, error: StepError) -> None:
    """Let an error name the critical point at which its path fails, or has become unstable."""
    try:
        stability = path.stability(path.states, lambda state: error.solution)
        counts = stability.unstable_modes()
        lost = stability.critical_points()[:1] if counts[0] < counts[-1] else []
        number = 0 if lost and lost[0].kind == "bifurcation" else -1
        (point,) = lost if number == 0 else stability.at_end(counts)  # ValueError if none
    except (ValueError, RuntimeError, StepFailed):
        return
    # Beyond the last state it is extrapolated.
    advice = f"There is a {point.kind} near load factor {point.load_factor:.4g}. "
    follows = point.kind == "bifurcation" and path.from_rest and not path.options.spin
    if follows:
        advice += (
            f"Follow a branch: start=error.solution.critical_points[{number}].branch(+1), with "
            'continuation="arc-length", which also passes the point, with more steps'
        )
    if lost or not follows:
        advice += ". " * follows + error.failure.advice
    error.failure = path.stats.failure = replace(error.failure, advice=advice)
    error.args = (str(error.failure),)


def _turned(state: State, forcing: LoadForcing) -> State:
    """A state with the rates of its frame, if that turns, and the work of spinning it up."""
    if (frame := forcing.turning) is None:
        return state
    v = frame.rates(state.q, state.t)
    a = -state.t * frame.spin**2 * frame.arms(state.q)
    return replace(
        state, v=v, a=a, work=state.work + float(v @ (forcing.model.masses.matrix @ v)) / 2
    )


def _warn_if_unstable(motions: SmallMotions, states: list[State]) -> None:
    """Say that a path ends in an equilibrium that is unstable."""
    old, last = states[-2:][0], states[-1]
    if motions.count(last, old) and (count := motions.count_again(old, last)[1]):
        _log.warning(
            "static: the equilibrium at load factor %g, the last row, is unstable: %d of its "
            "modes %s. See critical_points: a path of stable ones may branch off there "
            "(branch); or place the parts, or a small load, a little to one side",
            *(last.t, count, "grows" if count == 1 else "grow"),
        )


def unloaded(scene: Scene, caller: str) -> Solution | None:
    """The equilibrium of a scene without loads, in a solution of one row; None of a mechanism."""
    path = LoadPath(scene, StaticOptions(what=caller), None)
    if path.model.mechanism:
        return None
    solution = path.unloaded()
    return None if path.model.mechanism else solution  # laws of springs may leave a part free


def path_of(solution: object, scene: Scene) -> LoadPath | None:
    """The path of a solution's equilibria, if they are of this scene; else, or of a copy, None."""
    path = getattr(solution, "load_path", None)
    return path if path is not None and path.scene is scene else None


def _loads_on_nodes(
    scene: Scene, start: Start, t: float
) -> tuple[list[Load], dict[int, np.ndarray]]:
    """Forces on nodes at a time, and forces that fade from a start, as numbers."""
    with suppress(Exception):  # the run says which function fails at its time
        forces = (load for load in scene.loads if load.kind == "force")
        loads = [replace(force, value=constant(force.value(t))) for force in forces]
        return loads, forces_on_nodes(start, -1) if isinstance(start, Solution) else {}
    return [], {}


def _check_start(options: StaticOptions, scene: Scene, start: Start) -> None:
    """Refuse what is no start, or does not fit the other options, and what cannot turn."""
    if not isinstance(start, Solution | Branch | None):
        raise SceneError(f"static: start must be a Solution, or a branch, not {shown(start)}")
    if options.spin:
        check_turns(scene, "static: spin")
        if start is not None:
            raise SceneError("static: start with a spin: give all loads at once, without start")
    if isinstance(start, Branch) and options.continuation is None:
        raise SceneError('static: start is a branch. Follow it by continuation="arc-length"')
    other_options = start is not None or options.spin or options.continuation or options.branches
    if options.linear and other_options:
        raise SceneError("static: linear goes without start, spin, continuation and branches")
    if options.branches and (start is not None or options.spin):
        raise SceneError("static: branches are followed of paths without start and spin")


class _States(list[State]):
    """States of a path; a progress bar shows the load factor of the last one."""

    def __init__(self, bar):
        self.bar = bar

    def append(self, state: State) -> None:
        super().append(state)
        self.bar.update(state.t - self.bar.n)


@attach_partial_result
def static(
    scene: Scene,
    load_steps: int = 10,
    *,
    t: float = 0.0,
    continuation: str | None = None,
    newton: NewtonOptions | None = None,
    max_cuts: int = 8,
    max_steps: int = 1000,
    progress: bool | None = None,
    inputs: Mapping[str, object] | None = None,
    spin: float = 0.0,
    pivot: Sequence[float] = (0.0, 0.0),
    start: Solution | Branch | None = None,
    branches: int = 0,
    stop_at: str | None = None,
    linear: bool = False,
) -> Solution:
    """Compute equilibria of a scene while its loads rise from zero.

    The load factor multiplies all loads, including the weight, natural strains, prescribed motions
    and motors. At the load factor 0 auxiliary forces hold springs that are under tension in the
    scene as drawn; these forces decrease to zero as the load factor rises. A path whose last row is
    unstable ends with a warning. Functions of time are evaluated at the time `t`. Inertia, damping
    and initial velocities have no effect; `Coulomb` friction acts. The work of the loads uses the
    mean of the forces at both ends of each step; the energy balance thus has an error of second
    order in the steps. The potential energy is that of the full weight, and the part of the weight
    that does not act yet is an upward load.

    Parameters
    ----------
    scene : Scene
        The scene.
    load_steps : int
        Number of load steps, if none is divided. A step that fails, whose work is too inaccurate,
        or in which modes become unstable at no critical point, is halved; after steps with few
        iterations the length is doubled again. Where a stable path bends too sharply for all cuts,
        as near Euler's load of a compressed member, arc-length steps lead to the end of the load
        step, if the load factor only rises on the way. An arc-length step changes the load factor
        by at most 1/`load_steps`, and the direction of the path by an angle in proportion.
    t : float
        Time at which functions of time are evaluated [s].
    continuation : {"arc-length"}, optional
        Method to pass limit points: the load factor is an unknown; it falls after a limit point and
        rises again after the next. A path ends at the load factor -10, and where no further load
        can be carried. By default the load factor only rises.
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
        A constant or a function of time for each name of an `Input` of the scene; other inputs are
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

        Or a branch, ``point.branch(+1)`` of a bifurcation among the `critical_points` of a path
        without `start` of the same scene, with the same `t` and `inputs` and
        ``continuation="arc-length"``. The first row is the bifurcation. The path ends at load
        factor 1, or at the bifurcation if it returns there (``stats.closed``).
    branches : int
        Levels of branches to be followed by arc length, from all bifurcations in both directions of
        each mode; branches of the second level start at bifurcations of the first level.
        ``solution.branches`` has them.
    stop_at : {"limit point"}, optional
        Where an arc-length path ends before the load factor 1. The first limit point is then the
        last row but one.
    linear : bool
        Whether to compute the first-order answer of a frame program instead: small displacements
        about the reference, or about the equilibrium without loads to which springs under tension
        bring it, with equilibrium in this shape. The solution has two rows, without loads and with
        all loads; from the first on displacements, reactions, resultants and diagrams are
        proportional to the load factor, energies and work to its square. Friction of joints does
        not act. Without `start`, `spin` and `continuation`.

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
        After Ctrl-C. The attribute `solution` has the steps so far, or is None before the first
        one. Any other exception has this attribute as well.

    Examples
    --------
    An end moment bends a cantilever into a quarter circle.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_moment(beam.end, math.pi / 2)
    >>> solution = fb.static(scene, load_steps=4)
    >>> bool(abs(solution.rotation(beam.end)[-1] - math.pi / 2) < 1e-8)
    True
    """
    options = StaticOptions.among(locals())
    if linear:
        return LoadPath(scene, options, start).first_order()
    solution = LoadPath(scene, options, start).whole_path()
    if branches:
        options = replace(options, continuation="arc-length", branches=0)
        grow(solution, branches, lambda origin: LoadPath(scene, options, origin).whole_path(), [])
    return solution
