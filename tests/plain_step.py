"""Steps held against their equations: balance at all nodes, with the joints' forces as multipliers.

Of a step in C only its increments are read. Forces at nodes are those of the compiled forms, the
forces of supports and joints are whatever fits them best, and joints stay closed. Nothing is shared
with the package's elimination of what joints hold, nor any tangent. What dolfinx assembles
(dolfinx_steps.py) checks the rest, but takes the maps of joints for granted, and needs beams.
"""

from dataclasses import replace

import numpy as np

import fx_beam as fb
from fx_beam.laws.interval import Interval
from fx_beam.motions.motion_setup import Options, prepare
from fx_beam.scene.joints import GROUND
from fx_beam.scene.sliders import SlidingJoint
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.state_vector import start_of

GAP = 1e-12  # largest that a step opens [m, rad]
SHORT = 1e-6  # part of an element on which the quotient of weights is their slope


def across(x):
    return np.array([-x[1], x[0]])


class PlainStep:
    """A step from a state, with increments D (size,) and of slides; C has both in `results`."""

    def __init__(self, prepared, state, interval):
        model = self.model = prepared.model
        self.state, self.interval, self.forcing = state, interval, prepared.forcing
        self.level, self.rates = model.scheme.rates.level, model.scheme.rates
        result = prepared.loop.problem.results(D=model.size, z=model.reduction.columns)
        self.D, self.z = (part.copy() for part in result)
        self.Dd = np.zeros(len(state.slides))
        for joint, column in model.couplings.slides.items():
            self.Dd[joint] = self.z[column]
        positions = self.forcing.positions(interval.end) - self.forcing.current(state)
        self.prescribed = positions[: len(model.prescribed)]
        motors = zip(model.data.motors, positions[len(self.prescribed) :], strict=True)
        self.motors = {(joint.number, name): value for (joint, name), value in motors}

    def dofs(self, node):
        return self.model.mesh.dofs[node.number]

    def of(self, values, node):
        """Values (3,) at a node; zero on the ground."""
        return np.zeros(3) if node is GROUND else values[self.dofs(node)]

    def mean(self, ends):
        return (1 - self.level) * ends[0] + self.level * ends[1]

    def forces(self, end):
        """Forces (size,) of supports and joints on nodes, by the balance of all others."""
        model, state, interval = self.model, self.state, self.interval
        if len(followed := model.points.normal_forces):  # friction knows the forces of its joints
            state = replace(state, spring_internal=state.spring_internal.copy())
            state.spring_internal[followed] = end.spring_internal[followed]
        start = start_of(model, state, interval.length)
        if (strains := self.forcing.natural(interval.end)) is not None:
            start = start.with_natural(state.natural, strains)
        forces = model.forms.begin_step(interval, start)
        for _ in range(8):  # until all members are known that a point touches
            inner = forces.internal(self.D)
            members = model.points.members
            if members is None or members.check_search(self.D) == 0:
                break
        model.forms.compiled_points.evaluate_slides(self.z)
        added = self.mean(self.forcing.forces(interval))
        inertia, stopping = (
            model.masses.matrix @ self.acceleration(),
            model.masses.matrix @ state.v / interval.length,
        )
        self.size = max(abs(part).max() for part in (added, inner, inertia, stopping))
        return inner + inertia - added

    def acceleration(self):
        """Acceleration (size,) in the equation of motion, by the rule of the scheme."""
        model, state, rates, dt = self.model, self.state, self.rates, self.interval.length
        if rules := model.forms.nodal_rules:
            past = state.q - (state.q if state.q_previous is None else state.q_previous)
            increments = (x[model.mesh.dofs] for x in (self.D, state.v, state.a, past))
            rows = np.hstack([*increments, np.full((len(model.mesh.dofs), 1), dt)])
            return rules[0].in_rows(rows)[:, :3].ravel()
        path, _ = rates.work_increment(self.D, model.mesh.turns)
        return rates.acceleration(path, state.v, state.a, dt)[0]

    def held(self):
        """Gaps that the step opens (n,), and the forces (size, m) of unit multipliers.

        Behind the rows of nodes those of slides: what each force does along them.
        """
        model, size = self.model, self.model.size
        keys = *model.scene.prescribed, *model.scene.fixed
        supported = [model.mesh.dofs[key] for key in keys]
        driven = [*self.prescribed, *[0.0] * len(model.scene.fixed)]
        gaps, columns = [self.D[supported] - driven], list(np.eye(size + len(self.Dd))[supported])
        for joint in model.scene.joints:
            sliding = isinstance(joint, SlidingJoint)
            gap, wrenches = (self.on_beam if sliding else self.on_node)(joint)
            turns = 3 if joint.turns_together else 2
            gaps.append(gap[:turns])
            if (motor := self.motors.get((joint.number, "slide"))) is not None:
                gaps.append([self.Dd[joint.number] - motor])
            for i, (dofs, values, along) in enumerate(wrenches[:turns]):
                column = np.zeros(size + len(self.Dd))
                np.add.at(column, dofs, values)
                if joint.b is not GROUND:
                    column[self.dofs(joint.b)[i]] += 1.0
                column[size + joint.number] = along
                columns.append(column)
        for gear in model.scene.gears:
            if gear.is_ideal:
                gap, column = self.of_gear(gear)
                gaps.append([gap])
                columns.append(column)
        return np.concatenate(gaps), np.array(columns).reshape(-1, size + len(self.Dd)).T

    def of_gear(self, gear):
        """The gap that opens in a gear, and its forces on all for a unit one on b of `joint_b`."""
        gap, column = 0.0, np.zeros(self.model.size + len(self.Dd))
        for joint, name, weight in gear.terms:
            if name == "slide":
                gap += weight * self.Dd[joint.number]
                column[self.model.size + joint.number] += weight
                continue
            a, b = (self.of(self.D, node)[2] for node in (joint.a, joint.b))
            gap += weight * (b - a)
            ratio = 1.0 if a == b else (b - a) / (2 * np.tan(b / 2) - 2 * np.tan(a / 2))
            for node, sign in ((joint.a, -1.0), (joint.b, 1.0)):
                if node is not GROUND:
                    column[self.dofs(node)[2]] += weight * sign * ratio
        return gap, column

    def on_node(self, joint):
        """Gap that opens, and the forces on a for unit forces on b, with what acts on the slide."""
        D, psi = (self.of(of, joint.a) for of in (self.D, self.state.q))
        slides = self.state.slides[joint.number] + np.array([0.0, self.Dd[joint.number]])
        arms, along = [], []
        for angle, d in zip((psi[2], psi[2] + D[2]), slides, strict=True):
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            axis = joint.axis
            slide = np.zeros((2, 2)) if axis is None else (np.multiply(d, axis), axis)
            arms.append(turn @ (joint.offset + slide[0]))
            along.append(turn @ slide[1])
        _, slope = self.rates.work_increment(D[2:], np.arange(1))
        lever, axis = across(self.mean(arms)), slope[0] * self.mean(along)
        gap = self.of(self.D, joint.b) - D
        gap[:2] -= arms[1] - arms[0]
        gap[2] -= self.motors.get((joint.number, "rotation"), 0.0)
        dofs = [] if joint.a is GROUND else self.dofs(joint.a)
        force = [np.array([-1.0, 0, -lever[0]]), np.array([0, -1.0, -lever[1]]), -np.eye(3)[2]]
        return gap, [(dofs, f[: len(dofs)], s) for f, s in zip(force, (*axis, 0.0), strict=True)]

    def on_beam(self, joint):
        """Gap and forces of a node on a beam (fx_beam/coupling/dependent_columns.py)."""
        path, model = joint.path, self.model
        nodes = model.mesh.dofs[model.mesh.nodes_of(model.scene, joint.beam)]
        Ds = self.Dd[joint.number]
        s = self.state.slides[joint.number] + np.array([0.0, Ds])
        every = np.eye(len(path))[None]
        N = np.array([path.over(every, end)[0] for end in s[:, None]])
        slopes = np.array([path.over(every, end, 1)[0] for end in s[:, None]])
        element = path.element(s[0])
        rest = np.column_stack([path.X, path.angles])
        x = rest + np.array([self.state.q[nodes], self.state.q[nodes] + self.D[nodes]])
        gap = self.of(self.D, joint.b) - (N[1] @ x[1] - N[0] @ x[0])
        mean, Dx = self.mean(N), self.D[nodes]
        shares = np.array([np.outer(mean, row) for row in np.eye(3)]).reshape(3, -1, 3)
        if self.level != 0.5:
            return gap, self.on_dofs(nodes, shares, self.mean([slopes[i] @ x[i] for i in (0, 1)]))
        Q = (N[1] - N[0]) / Ds if abs(Ds) > SHORT * path.h[element] else slopes.mean(axis=0)
        axis = Q @ x.mean(axis=0)
        first, last = path.degree * element, path.degree * (element + 1)
        chord = (x[:, last] - x[:, first]).mean(axis=0)[:2]
        w, z = across(chord) / (chord @ chord), across(Q @ Dx[:, :2]) / 4
        shares[:2, last, :2] += Ds * np.outer(z, w)
        shares[:2, first, :2] -= Ds * np.outer(z, w)
        axis[:2] -= z * (w @ (Dx[last] - Dx[first])[:2])
        if joint.turns_together and self.rates.turning:
            half, y, y_c = Dx[:, 2] / 2, mean @ Dx[:, 2] / 2, self.of(self.D, joint.b)[2] / 2
            scale = mean * np.cos(half) / np.sinc((half - y) / np.pi)
            shares[2, :, 2] = scale / scale.sum()
            axis[2] *= np.sinc((y_c - y) / np.pi) / (np.cos(y_c) * np.cos(y))
        return gap, self.on_dofs(nodes, shares, axis)

    @staticmethod
    def on_dofs(nodes, shares, axis):
        return [(nodes.ravel(), -of.ravel(), s) for of, s in zip(shares, axis, strict=True)]

    def errors(self, end):
        """Largest gap that the step opens, and largest force without balance by the largest."""
        r = np.concatenate([self.forces(end), np.zeros(len(self.Dd))])
        points, number = self.model.points, {c: n for n, c in self.model.couplings.slides.items()}
        for column, force in zip(
            points.columns.tolist(), self.model.forms.compiled_points.on_slides(0), strict=True
        ):
            r[self.model.size + number[column]] -= force
        gaps, columns = self.held()
        driven = {number for number, name in self.motors if name == "slide"}
        free_rows = np.setdiff1d(np.arange(len(r)), self.model.size + np.array([*driven], int))
        r, columns = r[free_rows], columns[free_rows]
        multipliers = np.linalg.lstsq(columns, r, rcond=1e-12)[0]
        size = max(self.size, abs(multipliers).max(initial=0.0))
        return abs(gaps).max(initial=0.0), abs(r - columns @ multipliers).max() / (size or 1.0)


def assert_balanced(scene, scheme=None, *, dt, t_end, least=1e-10):
    """Each step of a motion opens no joint, and leaves no force above `least` of the largest one.

    Its scheme has no sub-steps.
    """
    scheme = scheme or fb.EnergyMomentum()
    prepared = prepare(scene, Options(scheme=scheme, max_halvings=0))
    state, times = prepared.first_state(dt, None), dt * np.arange(round(t_end / dt) + 1)
    for number, end_time in enumerate(times[1:]):
        ends, interval = np.array([end_time]), Interval(state.t, float(end_time))
        recorder = Recorder(prepared.model, np.array([state.t, end_time]), Record())
        prepared.loop.record(state, recorder)
        prepared.stepper.advance(ends, 1, recorder)
        end = prepared.loop.state.read()
        errors = PlainStep(prepared, state, interval).errors(end)
        assert errors[0] < GAP and errors[1] < least, (number, errors)
        state = end
