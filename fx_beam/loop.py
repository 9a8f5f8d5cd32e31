"""The compiled loop over time steps, run a block of steps at a time.

Forces and driven motions are evaluated here, ahead of the block.
"""

from __future__ import annotations

import numpy as np

from .newton import NewtonOptions
from .problem import Problem
from .recorder import Recorder
from .state import State
from .stepping import Stepper


class CompiledLoop:
    """Steps of a scene in compiled code; a step that fails goes to the stepper, which may halve it.

    Parameters
    ----------
    stepper : Stepper
        The model, its statistics, and the way out.
    options : NewtonOptions
        When Newton's method stops.

    Raises
    ------
    LoopUnavailable
        For a scene that the loop does not take, or if it cannot be built.
    """

    def __init__(self, stepper: Stepper, options: NewtonOptions):
        self._stepper, self.model = stepper, stepper.model
        problem = Problem(self.model, stepper.joint_forces, options)
        self._all = problem  # owns what the rest points to
        self._ffi, self._library = problem.ffi, problem.library
        self._problem, self._room = problem.c, problem.room
        stepper.stats.solver = f"compiled, band {problem.band}"

    def march(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> State:
        """State after several steps of the grid.

        Parameters
        ----------
        state : State
            The present.
        times : (steps,) float
            Ends of the steps [s].
        first : int
            Number of the first of them, from 1.
        recorder : Recorder
            Keeps what it wants.

        Returns
        -------
        State
            The state at the last of the times.

        Raises
        ------
        StepError
            If a step fails after all halvings, or a function of time fails.
        """
        done = 0
        while done < len(times):
            steps = _equal_steps(state.t, times[done:])
            done += self._run(state, times[done : done + steps], first + done, recorder)
            state = self._state(float(times[done - 1]) if done else state.t)
            if self._problem.failure:
                # The step that failed, in Python, which knows how to halve it.
                self._problem.failure = 0
                state = self._stepper.march(state, times[done : done + 1], first + done, recorder)
                done += 1
        return state

    def _run(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> int:
        """Take steps of one length, and give how many succeeded."""
        p, stats, model = self._problem, self._stepper.stats, self.model
        forces, driven, thrust, error = self._ahead(state.t, times)
        room = self._room
        room["q"][:], room["v"][:], room["a"][:] = state.q, state.v, state.a
        room["slide"][:] = state.slides
        room["driven_now"][len(model.prescribed) :] = state.motors
        p.steps_done = state.held is not None
        if state.held is not None:
            room["held"][:] = state.held
        if state.added is not None:
            room["added_force"][:] = state.added
        p.t, p.work, p.iterations, p.by_round_off = state.t, state.work, 0, 0
        ahead = self._ffi.new("Ahead *")
        for name, known in (("forces", forces), ("driven", driven), ("thrust", thrust)):
            setattr(ahead, name, self._ffi.cast("double *", known.ctypes.data))
        ahead.force_stride = forces[0].size if len(forces) > 1 else 0
        ahead.thrust_stride = thrust[0].size if len(thrust) > 1 else 0
        to = self._ffi.new("Record *")
        to.every, to.first, to.last = recorder.every, first, recorder.last
        for name, rows in recorder.arrays.items():
            at = rows[recorder.rows :]
            setattr(to, name, self._ffi.cast("double *", at.ctypes.data))
        dt = (times[-1] - state.t) / len(times)
        done = self._library.fx_run(p, len(driven), dt, ahead, to)
        recorder.rows += to.rows
        stats.steps += done
        stats.newton_iterations += p.iterations
        for name, count in (("increment", done - p.by_round_off), ("round-off", p.by_round_off)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        if error is not None and done == len(driven):
            raise error
        return done

    def _ahead(self, t: float, times: np.ndarray):
        """Forces, driven motions and follower forces of all steps, or of those before one fails."""
        stepper, model = self._stepper, self.model
        starts = np.concatenate([[t], times[:-1]])
        follow, driven, error = model.forms.followers, [], None
        forces: list = []
        thrust: list = []
        try:
            for t0, t1 in zip(map(float, starts), map(float, times), strict=True):
                if not forces or not model.loads.constant:
                    forces.append(stepper.drive.forces(t0, t1))
                if follow is not None and not (thrust and follow.constant):
                    thrust.append(follow.at(t0, t1))
                driven.append(stepper.drive.places(t1) if model.reduction.driven else ())
        except (Exception, KeyboardInterrupt) as raised:
            error = raised
        done = len(driven)
        return (
            np.array(forces or [np.zeros((2, model.size))]),
            np.array(driven, dtype=float).reshape(done, model.reduction.driven),
            np.array(thrust or [np.zeros(2)]),
            error,
        )

    def _state(self, t: float) -> State:
        p, room = self._problem, {name: values.copy() for name, values in self._room.items()}
        taken = p.steps_done > 0
        return State(
            t,
            room["q"],
            room["v"],
            room["a"],
            room["slide"],
            room["driven_now"][len(self.model.prescribed) :],
            held=room["held"] if taken else None,
            added=room["added_force"] if taken and p.has_added else None,
            work=p.work,
        )


def _equal_steps(t: float, times: np.ndarray) -> int:
    """How many of the steps have the length of the first, rounding aside."""
    steps = np.diff(times, prepend=t)
    different = abs(steps / steps[0] - 1) > 1e-6
    return int(np.argmax(different)) if different.any() else len(steps)
