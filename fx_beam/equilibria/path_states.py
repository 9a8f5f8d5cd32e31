"""The states of a path of equilibria: the first state, and the next ones under rising loads."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fx_beam.errors import SceneError, StepError
from fx_beam.laws.interval import Interval
from fx_beam.motions.initial_state import drawn_state, reference_state
from fx_beam.motions.prepared import state_of
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.step.state_values import added_force
from fx_beam.step.step_failures import StepFailed

from .arc_length import ArcLength
from .branches import Branch, first_step, is_equilibrium
from .load_steps import LoadStepper
from .path_following import PathFollowing
from .rising_loads import raise_load
from .settling import Settling

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
