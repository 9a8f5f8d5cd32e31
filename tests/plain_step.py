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
from fx_beam.step.recorder import Record, Recorder

MOST, EXACT, JUMP = 60, 1e-13, 1e-6


class PlainStep:
    """Takes the steps of a model: C only completes each, from its increments and forces."""

    def __init__(self, prepared):
        self.model, self.forcing, self.loop = prepared.model, prepared.forcing, prepared.loop
        self.jacobian = None

    def take(self, state, step, to):
        """The state at the end of a step, which is recorded."""
        fractions, known = self.model.scheme.fractions, []
        times = step.start + step.length * np.cumsum([0.0, *fractions])
        times[-1], now = step.end, state
        for number, ends in enumerate(pairwise(times)):
            interval = Interval(*ends)
            found, started = self.increment(now, interval, number)
            known, state = [*known, found], state if number else started
            now = self.complete(state, step, known, to if number + 1 == len(fractions) else None)
        return now

    def complete(self, state, step, known, to=None):
        """The state after some sub-steps with known increments and forces."""
        loop, p = self.loop, self.loop.problem.c
        loop.problem.load(state)
        count, p.sub_steps = p.sub_steps, len(known)
        inputs = loop.inputs(step.start, np.array([step.end]))
        loop.finish(inputs, step.length, *(np.array(of) for of in zip(*known, strict=True)), to)
        p.sub_steps = count
        return loop.state(step.end)

    def increment(self, state, interval, number):
        """Increment of the columns and forces in a sub-step, and the state from which it starts."""
        model, forcing = self.model, self.forcing
        forces, positions = forcing.forces(interval), forcing.positions(interval.end)
        level = model.scheme.rates.level
        self.force = (1 - level) * forces[0] + level * forces[1]
        self.driven = positions - forcing.current(state)
        self.number = number
        y = np.zeros(model.reduction.free)
        for _ in range(8):
            y = self.solve(state, interval, y)
            members = model.points.members
            if members is None or members.check(self.at(y)[0]) == FINE:
                break
        if model.points.follow_joints:
            y, state = self.follow(state, interval, y)
        return self.columns(y), state

    def columns(self, y):
        """Increment of all columns, and the forces with it."""
        D, r, _ = self.at(y)
        fixed = np.zeros(self.model.reduction.columns - len(y) - len(self.driven))
        return np.concatenate([y, self.driven, fixed]), r

    def follow(self, state, interval, y):
        """The unknowns with the forces of joints that friction follows."""
        points, internal = self.model.points, state.spring_internal.copy()
        points.begin_following()
        for trial in range(100):
            given = replace(state, spring_internal=internal)
            self.complete(given, interval, [self.columns(y)])
            self.begin(given, interval)
            points.evaluate(self.at(y)[0])
            joints = self.loop.problem.state_arrays["joint_forces"].reshape(-1, 3)
            for joint, axis in self.model.reduction.axes():
                points.set_axis(joint, axis)
            if not points.follow(joints, state.q, internal, trial > 90):
                return y, given
            y = self.solve(given, interval, y)
        raise AssertionError("friction and force do not meet")

    def begin(self, state, interval):
        """Set the state at the start of a sub-step."""
        model, self.start, self.length = self.model, state, interval.length
        model.reduction.begin(state.q, state.slides)
        model.forms.begin(interval, model.start_of(state, interval.length))
        if (strains := self.forcing.natural(interval.end)) is not None:
            model.forms.beams.natural.set(None, strains)

    def at(self, y):
        """Increment, forces of supports and joints, and the residual of the unknowns."""
        model, state = self.model, self.start
        D = model.reduction.expand(y, self.driven)
        r = model.forms.internal_force(D) - self.force
        if (rules := model.nodal_rules) is None:
            rates = model.scheme.rates
            a, _ = rates.acceleration(D, state.v, state.a, self.length, model.turns)
        else:
            past = state.q - (state.q if state.q_previous is None else state.q_previous)
            nodal = rules.at(self.number, D, state.v, state.a, past, self.length)
            a = rules.to_vector(nodal[:, :3])
        r += model.mass @ a
        return D, r, model.reduction.project(r)[: len(y)]

    def solve(self, state, interval, y):
        """The unknowns for which the residual is zero, from those that are known."""
        self.begin(state, interval)
        if not len(y):
            return y
        if self.jacobian is None or abs(self.length_of_jacobian / self.length - 1) > 1e-9:
            self.differentiate(y)
        smallest = np.inf
        for _ in range(MOST):
            correction = np.linalg.solve(self.jacobian, self.at(y)[2])
            size = abs(correction).max()
            if size <= EXACT or (size > 0.5 * smallest and size < 1e-10):
                return y - correction
            if size > 0.2 * smallest:
                self.differentiate(y)
                correction = np.linalg.solve(self.jacobian, self.at(y)[2])
            smallest = size = abs(correction).max()
            part = min(1.0, 0.5 / size)
            while part > 1e-3 and self.left(y - part * correction) > size:
                part /= 2
            y = y - part * correction
        raise AssertionError("the plain step does not converge")

    def left(self, y):
        """Size of the next correction by the present Jacobian."""
        left = abs(np.linalg.solve(self.jacobian, self.at(y)[2])).max()
        return left if np.isfinite(left) else np.inf

    def differentiate(self, y):
        """The Jacobian of the residual by central differences."""
        columns = []
        for step in JUMP * np.eye(len(y)):
            ends = (self.at(y + sign * step)[2] for sign in (1, -1))
            columns.append(np.subtract(*ends) / (2 * JUMP))
        self.jacobian, self.length_of_jacobian = np.column_stack(columns), self.length
        following = ~self.jacobian.any(axis=1)  # unknowns that close loops have no equation here
        self.jacobian[following, following] = 1.0


def plainly(scene, scheme=None, *, dt, t_end, newton=None):
    """The motion of a scene in steps of equal length, as `simulate` gives it."""
    scheme = scheme or fb.EnergyMomentum()
    prepared = Prepared(scene, Options(scheme=scheme, newton=newton, max_halvings=0))
    model, times = prepared.model, dt * np.arange(round(t_end / dt) + 1)
    recorder = Recorder(model, times, Record())
    state, plain = prepared.first_state(dt, None), PlainStep(prepared)
    to = prepared.loop.record_start(state, recorder, len(times))
    for to.first, ends in enumerate(pairwise(times), start=1):
        state = plain.take(state, Interval(*ends), to)
        recorder.count(to.rows, to.starts)
    return solution_of(model, recorder, prepared.stats, lambda: state, ended=True)
