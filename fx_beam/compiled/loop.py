"""Runs the compiled time loop in blocks of steps.

Loads and driven motions are evaluated in Python before each block.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.mechanics.interval import Interval, divided
from fx_beam.results.state import FORCES, Past, State
from fx_beam.stepping.interrupts import uninterrupted
from fx_beam.stepping.local_error import order_and_constant
from fx_beam.stepping.newton import NewtonOptions, StepFailed
from fx_beam.stepping.recorder import Rows, Unrecorded
from fx_beam.stepping.step_control import StepControl
from fx_beam.stepping.stepper import Attempt, Stepper, Trial

from .handover import Problem


class CompiledLoop:
    """Takes time steps in C. A step that fails after all halvings is repeated in Python."""

    def __init__(self, stepper: Stepper, options: NewtonOptions):
        self._stepper, self.model = stepper, stepper.model
        #: Owns the arrays to which C points.
        self.problem = problem = Problem(self.model, stepper.single.joint_forces, options)
        self._ffi, self._library = problem.ffi, problem.library
        # Read here: an interrupt while cffi reads the name of a type breaks its parser for good.
        names = "double *", "int *", "Inputs *", "Record *"
        self._types = {name: problem.ffi.typeof(name) for name in names}
        self._problem, self._state_arrays, self._past = (
            problem.c,
            problem.state_arrays,
            problem.past,
        )
        problem.c.least_energy = stepper.inversion.least_energy
        stepper.stats.solver = f"compiled, {problem.factors}"

    @property
    def past(self) -> Past:
        """The last configurations, from which the next increment is predicted."""
        p, model = self._problem, self.model
        known = min(p.known_steps, self._library.PAST)
        ages, differences, y = (values[:known].copy() for values in self._past)
        slides = model.couplings.free_slides(y, len(model.scene.joints))
        orders = np.array(list(p.orders[0 : p.sub_steps]))
        return Past(ages, orders, differences, slides)

    @past.setter
    def past(self, past: Past | None) -> None:
        if past is not None:
            p, known = self._problem, len(past.ages)
            p.known_steps, p.orders[0 : p.sub_steps] = known, past.orders.tolist()
            y = self.model.couplings.unknowns(past.differences, past.slides)
            for values, found in zip(self._past, (past.ages, past.differences, y), strict=True):
                values[:known] = found

    def forget_past(self) -> None:
        """Begin anew: the next step has no prediction."""
        p = self._problem
        p.known_steps, p.orders[0 : p.sub_steps] = 0, [0] * p.sub_steps

    def march(self, state: State, times: np.ndarray, first: int, recorder: Rows) -> State:
        """State at the last of `times`, the ends of steps from number `first` on.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        done = 0
        while done < len(times):
            grid = times[done : done + _equal_steps(state.t, times[done:])]
            state = self._equal(state, grid, first + done, recorder)
            done += len(grid)
        return state

    def _equal(self, state: State, times: np.ndarray, first: int, recorder: Rows) -> State:
        """State after steps of equal length; steps that fail are divided into sub-steps."""
        p, stats, halving = self._problem, self._stepper.stats, self._stepper.halving
        inputs = self.inputs(state.t, times)
        done, grid = 0, np.concatenate([[state.t], times])
        while done < len(times):
            ends, now = times[done:], inputs
            if halving.times:
                ends = halving.ends(grid[done:])
                now = self.inputs(state.t, ends)
            parts = halving.parts
            with uninterrupted:
                taken = self._run(state, ends, first + done, recorder, now)
                steps = halving.take(taken)
                stats.steps += steps
                if halving.parts != parts:  # as in `Stepper.part`
                    self.forget_past()
                if taken:
                    state = self.state(float(ends[taken - 1]))
                    recorder.end = state
            done, inputs = done + steps, inputs.after(steps * p.sub_steps)
            if p.failure:
                if halving.fail():
                    stats.halvings += 1
                    self.forget_past()
                else:  # in Python, which reports the cause, or succeeds
                    step = Interval(*grid[done : done + 2])
                    self._stepper.past = self.past
                    state = self._stepper.part(state, step, first + done, recorder)
                    self.past = self._stepper.past
                    if state.t == step.end:
                        done, inputs = done + 1, inputs.after(p.sub_steps)
            elif now.error is not None:
                raise now.error
        return state

    # -- Steps whose local errors are controlled --------------------------------------------------

    def forget_errors(self) -> None:
        """Do not compare the next steps with those before, for example after a jump of a load."""
        p = self._problem
        p.scheme_order, _ = order_and_constant(self.model.scheme)
        p.known_errors, p.ratios = 0, [-1.0, -1.0]

    def trial(self, state: State, t1: float, watch: bool = False) -> Trial:
        """One step to t1 [s] that is not part of the run; with `watch` also its switches."""
        p, past = self._problem, self.past
        p.controlled, p.watches = False, watch
        inputs = self.inputs(state.t, np.array([t1]))
        with uninterrupted:
            taken = self._run(state, np.array([t1]), 1, Unrecorded(), inputs)
            self.past = past
        known = watch and (taken or p.failure == self._library.SWITCHED)
        return Trial(
            self.state(t1) if taken else None,
            self.problem.sides[1].copy() if known else None,
        )

    def attempt(
        self,
        state: State,
        ends: np.ndarray,
        first: int,
        recorder: Rows,
        control: StepControl,
        watch: bool = False,
    ) -> Attempt:
        """Take steps of equal length from number `first` on, as long as this length is right."""
        p, dt = self._problem, float(ends[0]) - state.t
        p.controlled, p.watches = True, watch and p.switches > 0
        p.smooth, p.raw = control.factors(dt)
        p.lowest, p.highest = control.band(dt)
        inputs = self.inputs(state.t, ends)
        known = len(inputs.driven) // p.sub_steps
        with uninterrupted:
            taken = self._run(state, ends[:known], first, recorder, inputs) if known else 0
            if taken:
                self._stepper.stats.steps += taken
                state = self.state(float(ends[taken - 1]))
                recorder.end = state
        if taken == known and inputs.error is not None:
            raise inputs.error
        if p.failure == self._library.SWITCHED:
            return Attempt(state, taken, switched=True)
        rejected = p.failure == self._library.TOO_INACCURATE
        ratios = [ratio if ratio >= 0 else None for ratio in p.ratios]
        if p.failure and not rejected:
            return Attempt(state, taken, failed=True)
        return Attempt(state, taken, ratios[0] if taken > 1 else None, ratios[1])

    def failure(self, state: State, t1: float) -> StepFailed:
        """Why Newton's method fails in a step to t1 [s]."""
        self._stepper.past = self.past
        return self._stepper.failure(state, t1)

    # -- Steps of all kinds -----------------------------------------------------------------------

    def _run(
        self, state: State, ends: np.ndarray, first: int, recorder: Rows, inputs: StepInputs
    ) -> int:
        """Take steps or parts of steps of equal length; returns the number that succeeded."""
        p = self._problem
        self.load(state)
        c_inputs = self.c_inputs(inputs)
        to = self.c_record(recorder, first, len(ends))
        dt = (ends[-1] - state.t) / len(ends)
        taken = self._library.fx_run(p, len(inputs.driven) // p.sub_steps, dt, c_inputs, to)
        recorder.add(to.rows, to.starts)
        self.count(taken)
        return taken

    def load(self, state: State) -> None:
        """Write a state into the memory of C."""
        p, model, arrays = self._problem, self.model, self._state_arrays
        arrays["q"][:], arrays["v"][:], arrays["a"][:] = state.q, state.v, state.a
        arrays["slide"][:] = state.slides
        arrays["driven_now"][len(model.prescribed) :] = state.motors
        p.steps_done = state.constraint_forces is not None
        for name in FORCES:
            force = getattr(state, name)
            arrays[name][:] = 0.0 if force is None else force.ravel()
        if state.added_forces is not None:
            arrays["added_forces"][:] = state.added_forces
        if state.internal is not None:
            arrays["internals"][:] = state.internal.ravel()
        if state.spring_internal is not None:
            arrays["spring_internals"][:] = state.spring_internal
        p.t, p.work, p.dissipated = state.t, state.work, state.dissipated
        p.algorithmic, p.numerical, p.length = state.algorithmic, state.numerical, state.length
        if p.keeps_before:
            arrays["before"][:] = state.q if state.before is None else state.before

    def c_inputs(self, inputs: StepInputs):
        """The inputs for C; they must be kept as long as C uses them."""
        c_inputs, doubles = self._ffi.new(self._types["Inputs *"]), self._types["double *"]
        for name in ("loads", "driven", "thrust"):
            setattr(c_inputs, name, self._ffi.cast(doubles, getattr(inputs, name).ctypes.data))
        c_inputs.load_stride = inputs.loads.strides[0] // inputs.loads.itemsize
        c_inputs.thrust_stride = inputs.thrust.strides[0] // inputs.thrust.itemsize
        return c_inputs

    def c_record(self, recorder: Rows, first: int, steps: int):
        """Rows of a recorder for C, from its next one on, for parts of steps from `first` on."""
        to, halving = self._ffi.new(self._types["Record *"]), self._stepper.halving
        to.every, to.first, to.last = recorder.every, first, recorder.last
        to.parts, to.part = halving.parts, halving.done
        to.keeps_starts = recorder.keeps_starts(to.parts)
        to.starts, to.complete = recorder.starts, recorder.complete
        most = steps * self._problem.sub_steps if to.keeps_starts else 0
        for name, rows in recorder.next_rows(most).items():
            kind = "int *" if rows.dtype == np.int32 else "double *"
            setattr(to, name, self._ffi.cast(self._types[kind], rows.ctypes.data))
        return to

    def count(self, taken: int) -> None:
        """Add what C has counted in some steps or parts to the statistics."""
        p, stats = self._problem, self._stepper.stats
        stats.substeps += taken
        stats.newton_iterations += p.iterations
        stats.too_large += p.too_large
        stats.amplified += p.amplified
        if p.inverted:
            self._stepper.inversion.count(p.inverted, p.inverted_t, self.problem.inverted_q)
        solves = taken * p.sub_steps
        for name, count in (("increment", solves - p.by_round_off), ("round-off", p.by_round_off)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        p.iterations = p.by_round_off = p.too_large = p.inverted = p.amplified = 0

    def inputs(self, t: float, times: np.ndarray) -> StepInputs:
        """Inputs of all sub-steps; if a function of time fails, only of the steps before."""
        starts = np.concatenate([[t], times[:-1]])
        t0, t1 = divided(starts, times, self.model.scheme.fractions)
        forcing, follow = self._stepper.forcing, self.model.forms.followers
        try:
            first = slice(1 if self.model.loads.constant else None)
            loads = _of_each_step(forcing.loads(t0[first], t1[first]), len(t1))
            thrust = np.empty((len(t1), 0))
            if follow is not None:
                first = slice(1 if follow.constant else None)
                thrust = _of_each_step(follow.series(t0[first], t1[first]), len(t1))
            return StepInputs(loads, forcing.series(t1), thrust)
        except BaseException as raised:
            before = int(np.searchsorted(times, getattr(raised, "time", t)))
            inputs = self.inputs(t, times[:before]) if before else StepInputs(*np.empty((3, 0, 2)))
            return inputs._replace(error=inputs.error or raised)

    def state(self, t: float) -> State:
        """The state in the memory of C, at the time t [s]."""
        p = self._problem
        arrays = {name: values.copy() for name, values in self._state_arrays.items()}
        taken, shape = p.steps_done > 0, self.model.forms.internal_shape
        # Those of joints and obstacles are not computed in steps that are not recorded.
        known = taken and (p.keeps_joint_forces or self._stepper.halving.done > 0)
        return State(
            t,
            arrays["q"],
            arrays["v"],
            arrays["a"],
            arrays["slide"],
            arrays["driven_now"][len(self.model.prescribed) :],
            constraint_forces=arrays["constraint_forces"] if taken else None,
            added_forces=arrays["added_forces"] if taken and p.has_added else None,
            work=p.work,
            dissipated=p.dissipated,
            numerical=p.numerical,
            algorithmic=p.algorithmic,
            before=arrays["before"] if p.keeps_before else None,
            internal=arrays["internals"].reshape(shape) if p.cell_internal else None,
            spring_internal=arrays["spring_internals"] if p.spring_width else None,
            length=p.length,
            joint_forces=arrays["joint_forces"].reshape(-1, 3) if known else None,
            contact_forces=arrays["contact_forces"].reshape(-1, 2) if known else None,
        )


class StepInputs(NamedTuple):
    """Loads, driven motions and follower forces of sub-steps, and the error that ended them."""

    loads: np.ndarray
    driven: np.ndarray
    thrust: np.ndarray
    error: BaseException | None = None

    def after(self, steps: int) -> StepInputs:
        """The inputs without the first sub-steps."""
        loads, driven, thrust = (part[steps:] for part in self[:3])
        return StepInputs(loads, driven, thrust, self.error)


def _of_each_step(rows: np.ndarray, steps: int) -> np.ndarray:
    """Rows of all steps; a single row is repeated without copies."""
    return np.broadcast_to(rows[0], (steps, *rows.shape[1:])) if len(rows) == 1 else rows


def _equal_steps(t: float, times: np.ndarray) -> int:
    """Number of steps from the first on that have equal length, up to rounding."""
    steps = np.diff(times, prepend=t)
    different = abs(steps / steps[0] - 1) > 1e-6
    return int(np.argmax(different)) if different.any() else len(steps)
