"""The compiled loop over time steps, run a block of steps at a time.

Forces and driven motions are evaluated here, ahead of the block.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import StepError
from fx_beam.results.state import Past, State
from fx_beam.stepping.newton import NewtonOptions
from fx_beam.stepping.recorder import Recorder
from fx_beam.stepping.stepper import Stepper

from .handover import Problem


class CompiledLoop:
    """Takes the steps of a Stepper in C; one that fails for good the stepper takes in Python."""

    def __init__(self, stepper: Stepper, options: NewtonOptions):
        self._stepper, self.model = stepper, stepper.model
        problem = Problem(self.model, stepper.single.joint_forces, options)
        self._all = problem  # owns what the rest points to
        self._ffi, self._library = problem.ffi, problem.library
        self._problem, self._room, self._past = problem.c, problem.room, problem.past
        problem.c.least_energy = stepper.facing.least_energy
        stepper.stats.solver = f"compiled, {problem.factors}"

    @property
    def past(self) -> Past:
        """What the next increment is foretold from."""
        p, model = self._problem, self.model
        known = min(p.known, self._library.PAST)
        D, y = (values[:known].copy() for values in self._past)
        slides = model.couplings.free_slides(y, len(model.scene.joints))
        return Past(p.past_dt, p.order_of_prediction, D, slides)

    @past.setter
    def past(self, past: Past | None) -> None:
        if past is not None:
            p, known = self._problem, len(past.increments)
            p.past_dt, p.known, p.order_of_prediction = past.length, known, past.order
            y = self.model.couplings.unknowns(past.increments, past.slides)
            for values, found in zip(self._past, (past.increments, y), strict=True):
                values[:known] = found

    def march(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> State:
        """State at the last of `times`, ends of steps of the grid from number `first` on.

        A StepError if a step fails after all halvings, or a function of time fails.
        """
        done = 0
        while done < len(times):
            grid = times[done : done + _equal_steps(state.t, times[done:])]
            state = self._equal(state, grid, first + done, recorder)
            done += len(grid)
        return state

    def _equal(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> State:
        """State after steps of one length, in parts where they fail as a whole."""
        stats, halving = self._stepper.stats, self._stepper.halving
        known = self._ahead(state.t, times)
        done, grid = 0, np.concatenate([[state.t], times])
        while done < len(times):
            ends, ahead = times[done:], known
            if halving.times:
                ends = halving.ends(grid[done:])
                ahead = self._ahead(state.t, ends)
            taken = self._run(state, ends, first + done, recorder, ahead)
            if taken:
                state = self._state(float(ends[taken - 1]))
            steps = halving.take(taken)
            done, known = done + steps, known.after(steps)
            stats.steps += steps
            if self._problem.failure:
                if halving.fail():
                    stats.halvings += 1
                else:  # in Python, which can say why, or else goes on
                    start, end = grid[done : done + 2]
                    self._stepper.past = self.past
                    state = self._stepper.part(state, start, end, first + done, recorder)
                    self.past = self._stepper.past
                    if state.t == end:
                        done, known = done + 1, known.after(1)
                        stats.steps += 1
            elif ahead.error is not None:
                raise ahead.error
        return state

    def _run(
        self, state: State, ends: np.ndarray, first: int, recorder: Recorder, known: _Known
    ) -> int:
        """Take steps or parts of one length, and give how many succeeded."""
        p, stats, model = self._problem, self._stepper.stats, self.model
        room, halving = self._room, self._stepper.halving
        room["q"][:], room["v"][:], room["a"][:] = state.q, state.v, state.a
        room["slide"][:] = state.slides
        room["driven_now"][len(model.prescribed) :] = state.motors
        p.steps_done = state.held is not None
        if state.held is not None:
            room["held"][:] = state.held
        if state.added is not None:
            room["added_force"][:] = state.added
        p.t, p.work, p.dissipated = state.t, state.work, state.dissipated
        p.iterations = p.by_round_off = 0
        p.too_large = p.inside_out = 0
        ahead = self._ffi.new("Ahead *")
        for name in ("loads", "driven", "thrust"):
            setattr(ahead, name, self._ffi.cast("double *", getattr(known, name).ctypes.data))
        ahead.load_stride = known.loads.strides[0] // known.loads.itemsize
        ahead.thrust_stride = known.thrust.strides[0] // known.thrust.itemsize
        to = self._ffi.new("Record *")
        to.every, to.first, to.last = recorder.every, first, recorder.last
        to.parts, to.part = halving.parts, halving.done
        for name, rows in recorder.next_rows(to.parts).items():
            setattr(to, name, self._ffi.cast("double *", rows.ctypes.data))
        dt = (ends[-1] - state.t) / len(ends)
        taken = self._library.fx_run(p, len(known.driven), dt, ahead, to)
        recorder.add(to.rows, to.parts)
        stats.substeps += taken
        stats.newton_iterations += p.iterations
        stats.too_large += p.too_large
        if p.inside_out:
            self._stepper.facing.count(p.inside_out, p.out_t, self._all.out_q)
        for name, count in (("increment", taken - p.by_round_off), ("round-off", p.by_round_off)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        return taken

    def _ahead(self, t: float, times: np.ndarray) -> _Known:
        """What is known of all steps, or of those before the first that fails."""
        starts = np.concatenate([[t], times[:-1]])
        drive, follow = self._stepper.drive, self.model.forms.followers
        try:
            first = slice(1 if self.model.loads.constant else None)
            loads = _of_each_step(drive.loads(starts[first], times[first]), len(times))
            thrust = np.empty((len(times), 0))
            if follow is not None:
                first = slice(1 if follow.constant else None)
                thrust = _of_each_step(follow.series(starts[first], times[first]), len(times))
            return _Known(loads, drive.series(times), thrust)
        except (StepError, KeyboardInterrupt) as raised:
            before = int(np.searchsorted(times, getattr(raised, "time", t)))
            known = self._ahead(t, times[:before]) if before else _Known(*np.empty((3, 0, 2)))
            return known._replace(error=known.error or raised)

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
            dissipated=p.dissipated,
        )


class _Known(NamedTuple):
    """Loads, driven motions and follower forces ahead of steps, and why there are no more."""

    loads: np.ndarray
    driven: np.ndarray
    thrust: np.ndarray
    error: BaseException | None = None

    def after(self, steps: int) -> _Known:
        """The same without the first steps."""
        loads, driven, thrust = (part[steps:] for part in self[:3])
        return _Known(loads, driven, thrust, self.error)


def _of_each_step(rows: np.ndarray, steps: int) -> np.ndarray:
    """Rows of all steps; a single one is that of each, and takes no memory for it."""
    return np.broadcast_to(rows[0], (steps, *rows.shape[1:])) if len(rows) == 1 else rows


def _equal_steps(t: float, times: np.ndarray) -> int:
    """How many of the steps have the length of the first, rounding aside."""
    steps = np.diff(times, prepend=t)
    different = abs(steps / steps[0] - 1) > 1e-6
    return int(np.argmax(different)) if different.any() else len(steps)
