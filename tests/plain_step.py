"""A plain step: forms of dolfinx, joints in NumPy, a Jacobian by differences and dense Newton.

It shares no tangent, no assembly and no solver with the loop in C, whose motions it must give.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

import fx_beam as fb
from fx_beam.fem.member_contacts import FINE
from fx_beam.laws.interval import Interval
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.options import Options
from fx_beam.motions.prepared import Prepared
from fx_beam.step.newton import NewtonOptions, StepSolution
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.single_step import SingleStep

MOST, EXACT, JUMP = 60, 1e-13, 1e-6


class PlainStep:
    """Takes the sub-steps of a model."""

    def __init__(self, prepared):
        self.model, self.forcing = prepared.model, prepared.forcing
        self.states = SingleStep(self.model, self.forcing, NewtonOptions(), prepared.stats)
        self.jacobian = None

    def take(self, state, interval, number):
        """The state at the end of a sub-step."""
        model, forcing = self.model, self.forcing
        forces, positions = forcing.forces(interval), forcing.positions(interval.end)
        level = model.scheme.rates.level
        self.force = (1 - level) * forces[0] + level * forces[1]
        self.driven = positions - forcing.current(state)
        self.states.equations.sub_step = number
        y = np.zeros(model.reduction.free)
        for _ in range(8):
            y = self.solve(state, interval, y)
            members = model.points.members
            if members is None or members.check(self.at(y)[0]) == FINE:
                break
        if model.points.follow_joints:
            y = self.follow(state, interval, y)
        D, r, _ = self.at(y)
        step = StepSolution(D, y, r, 1, "increment", D)
        return self.states.finish(state, interval, step, forces, positions)

    def follow(self, state, interval, y):
        """The unknowns with the forces of joints that friction follows."""
        points, internal = self.model.points, state.spring_internal.copy()
        points.begin_following()
        for trial in range(100):
            D, r, _ = self.at(y)
            points.evaluate(D)
            joints = self.states.joint_forces.evaluate(r)
            for joint, axis in self.model.reduction.axes():
                points.set_axis(joint, axis)
            if not points.follow(joints, state.q, internal, trial > 90):
                return y
            y = self.solve(replace(state, spring_internal=internal), interval, y)
        raise AssertionError("friction and force do not meet")

    def at(self, y):
        """Increment, forces of supports and joints, and the residual of the unknowns."""
        model, state = self.model, self.start
        D = model.reduction.expand(y, self.driven)
        r = model.forms.internal_force(D) - self.force
        if (rules := model.nodal_rules) is None:
            rates = model.scheme.rates
            a, _ = rates.acceleration(D, state.v, state.a, self.length, model.turns)
        else:
            a = rules.to_vector(self.states.equations._nodal(rules, D)[:, :3])
        r += model.mass @ a
        return D, r, model.reduction.project(r)[: len(y)]

    def solve(self, state, interval, y):
        """The unknowns for which the residual is zero, from those that are known."""
        self.start, self.length = state, interval.length
        self.states.equations.begin(interval, state)
        if not len(y):
            return y
        unit = np.ones(len(y))
        fresh = self.jacobian is None or abs(self.length_of_jacobian / self.length - 1) > 1e-9
        if fresh:
            self.differentiate(y, unit)
        smallest = np.inf
        for _ in range(MOST):
            correction = np.linalg.solve(self.jacobian, self.at(y)[2])
            size = abs(correction / unit).max()
            if size <= EXACT or (size > 0.5 * smallest and size < 1e-10):
                return y - correction
            if size > 0.2 * smallest:
                self.differentiate(y, unit)
                correction = np.linalg.solve(self.jacobian, self.at(y)[2])
            smallest = size = abs(correction / unit).max()
            part = min(1.0, 0.5 / size)
            while part > 1e-3 and self.left(y - part * correction, unit) > size:
                part /= 2
            y = y - part * correction
        raise AssertionError("the plain step does not converge")

    def left(self, y, unit):
        """Size of the next correction by the present Jacobian."""
        left = abs(np.linalg.solve(self.jacobian, self.at(y)[2]) / unit).max()
        return left if np.isfinite(left) else np.inf

    def differentiate(self, y, unit):
        """The Jacobian of the residual by central differences."""
        columns = []
        for i, h in enumerate(JUMP * unit):
            ends = (self.at(y + sign * h * np.eye(len(y))[i])[2] for sign in (1, -1))
            columns.append(np.subtract(*ends) / (2 * h))
        self.jacobian, self.length_of_jacobian = np.column_stack(columns), self.length
        following = ~self.jacobian.any(axis=1)  # unknowns that close loops have no equation here
        self.jacobian[following, following] = 1.0


def plainly(scene, scheme=None, *, dt, t_end, newton=None):
    """The motion of a scene in steps of equal length, as `simulate` gives it."""
    scheme = scheme or fb.EnergyMomentum()
    prepared = Prepared(scene, Options(scheme=scheme, newton=newton, max_halvings=0))
    model, times = prepared.model, dt * np.arange(round(t_end / dt) + 1)
    recorder = Recorder(model, times, Record())
    state, step = prepared.first_state(dt, None), PlainStep(prepared)
    recorder.record(0, state)
    for number, (t0, t1) in enumerate(pairwise(times), start=1):
        starts, ends = [state], t0 + (t1 - t0) * np.cumsum([0.0, *scheme.fractions])
        ends[-1] = t1
        for part, (a, b) in enumerate(pairwise(ends)):
            starts.append(step.take(starts[-1], Interval(a, b), part))
        *starts, new = starts
        if len(starts) > 1:
            if model.nodal_rules is None:
                new.a = (new.v - state.v) / dt
            for name in ("constraint_forces", "added_forces", "joint_forces", "contact_forces"):
                if getattr(new, name) is not None:
                    parts = [getattr(one, name) for one in (*starts[1:], new)]
                    setattr(new, name, np.tensordot(scheme.fractions, parts, 1))
        recorder.store_starts(number, starts, new, (0, 1))
        recorder.record(number, new)
        state = new
    return solution_of(model, recorder, prepared.stats, lambda: state, ended=True)
