"""Random mechanisms against bodies whose joints are multipliers: they share no code.

The reference is M a = F(q, v) - G^T lambda, G a = -G' v, by an explicit method of order 8. Its
forces and G are derivatives of an energy and of gaps by steps along the imaginary axis.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fx_beam as fb

T_END, TINY, SMALL = 0.1, 1e-30, 1e-4
KINDS = "revolute", "prismatic", "slot", "rigid"


class Mechanism:
    """Bodies in a tree of joints, with springs, dampers, a rope over points and a gear."""

    def __init__(self, seed):
        rng = self.rng = np.random.default_rng(seed)
        self.count = n = int(rng.integers(2, 6))
        self.kinds = ["revolute", *rng.choice(KINDS, n - 1, p=[0.5, 0.2, 0.2, 0.1])]
        self.parents = [-1, *(int(rng.integers(i)) for i in range(1, n))]
        self.places, self.centres = np.zeros((n, 2)), np.zeros((n, 2))
        for i, parent in enumerate(self.parents):
            self.places[i] = 0 if parent < 0 else self.end(parent)
            self.centres[i] = self.places[i] + rng.normal(size=2) / 2
        self.axes = np.array([(np.cos(a), np.sin(a)) for a in rng.uniform(0, 6, n)])
        self.mass, self.inertia = 10 ** rng.uniform(-0.5, 0.7, (2, n)) * [[1], [0.2]]
        self.springs, self.dampers = 10 ** rng.uniform([[0], [-2]], [[2.5], [0.5]], (2, n))
        self.gravity, self.speed = 5 * rng.normal(size=2), 3 * rng.normal()
        self.rope = 10 ** rng.uniform(1, 3), rng.uniform(0.9, 1.02), 2 * rng.normal(size=(2, 2))
        hinges = [i for i, kind in enumerate(self.kinds) if kind in ("revolute", "slot")]
        self.geared = hinges[:2] if len(hinges) > 1 and rng.random() < 0.6 else None
        self.ratio = rng.choice([-1, 1]) * rng.uniform(0.4, 2.5)

    def end(self, i):
        """The far end of a body."""
        return 2 * self.centres[i] - self.places[i]

    def place(self, q, i, point):
        """Where a point of a body is; of the ground, where it was."""
        if i < 0:
            return np.array(point), 0.0
        (x, y), angle = np.subtract(point, self.centres[i]), q[3 * i + 2]
        c, s = np.cos(angle), np.sin(angle)
        return self.centres[i] + q[3 * i : 3 * i + 2] + [c * x - s * y, s * x + c * y], angle

    def joint(self, q, i):
        """Way along and across the axis of the parent, and the angle."""
        (a, turn), (b, angle) = (self.place(q, k, self.places[i]) for k in (self.parents[i], i))
        c, s, (x, y), way = np.cos(turn), np.sin(turn), self.axes[i], b - a
        along = np.array([c * x - s * y, s * x + c * y])
        return way @ along, way[1] * along[0] - way[0] * along[1], angle - turn

    def free(self, q, i):
        """The coordinate on which a spring acts."""
        along, _, angle = self.joint(q, i)
        return {"revolute": angle, "rigid": 0.0}.get(self.kinds[i], along)

    def gaps(self, q):
        gaps = []
        for i, kind in enumerate(self.kinds):
            along, across, angle = self.joint(q, i)
            gaps += [across, *[along] * (kind in ("revolute", "rigid"))]
            gaps += [angle] * (kind in ("prismatic", "rigid"))
        if self.geared:
            a, b = (self.joint(q, i)[2] for i in self.geared)
            gaps.append(b - self.ratio * a)
        return np.array(gaps)

    def length(self, q):
        """Of the rope: from the ground over the end of a body to the ground."""
        point = self.place(q, self.count - 1, self.end(self.count - 1))[0]
        return sum(np.sqrt((point - fixed) @ (point - fixed)) for fixed in self.rope[2])

    def energy(self, q):
        stiffness, part, _ = self.rope
        stretch = self.length(q) - part * self.length(np.zeros(len(q)))
        weight = sum(m * self.gravity @ q[3 * i : 3 * i + 2] for i, m in enumerate(self.mass))
        stored = sum(k * self.free(q, i) ** 2 for i, k in enumerate(self.springs))
        return stored / 2 + stiffness / 2 * stretch**2 * (stretch.real > 0) - weight

    def motion(self, times):
        """Increments of the centres and rotations (rows, 3 n)."""
        n, masses = 3 * self.count, np.repeat(self.mass, 3)
        masses[2::3] = self.inertia

        def slopes(function, q):
            steps = 1j * TINY * np.eye(n)
            return np.array([np.imag(function(q + step)) / TINY for step in steps]).T

        def accelerations(_, y):
            q, v = y[:n], y[n:]
            G = slopes(self.gaps, q)
            force = -slopes(self.energy, q)
            for i, c in enumerate(self.dampers):
                along = slopes(lambda q, i=i: self.free(q + 0j, i), q)
                force -= c * along * (along @ v)
            ahead, behind = (slopes(self.gaps, q + e * v) @ v for e in (SMALL, -SMALL))
            push = (G / masses) @ force + (ahead - behind) / (2 * SMALL)
            return np.append(v, (force - G.T @ np.linalg.solve((G / masses) @ G.T, push)) / masses)

        start = self.velocities.ravel()
        y = solve_ivp(accelerations, (0, T_END), np.append(np.zeros(n), start), "DOP853", times,
                      rtol=1e-8, atol=1e-10).y  # fmt: skip
        return y[:n].T

    @property
    def velocities(self):
        """A turn of all bodies about the first hinge (n, 3); gears are at rest."""
        speed = 0.0 if self.geared else self.speed
        x, y = self.centres.T
        return speed * np.stack([-y, x, np.ones(self.count)], axis=1)

    def scene(self):
        scene, bodies, joints = fb.Scene(gravity=tuple(self.gravity)), [], []
        for i, kind in enumerate(self.kinds):
            points = {"start": self.places[i], "end": self.end(i)}
            body = scene.add_body(self.centres[i], self.mass[i], self.inertia[i], points)
            parent = fb.GROUND if i == 0 else bodies[self.parents[i]]["end"]
            laws = {"spring": fb.Spring(self.springs[i]), "damper": fb.Damper(self.dampers[i])}
            axis = {"axis": tuple(self.axes[i])}
            joint = {
                "revolute": lambda a, b: fb.Revolute(a, b, **laws),  # noqa: B023
                "prismatic": lambda a, b: fb.Prismatic(a, b, **axis, **laws),  # noqa: B023
                "slot": lambda a, b: fb.PinInSlot(a, b, **axis, **laws),  # noqa: B023
                "rigid": fb.Rigid,
            }[kind](parent, body["start"])
            joints.append(scene.add_joint(joint))
            bodies.append(body)
            *velocity, spin = self.velocities[i]
            scene.set_velocity(body, tuple(velocity), spin=spin)
        if self.geared:
            scene.add_joint(fb.Gear(*(joints[i] for i in self.geared), ratio=self.ratio))
        stiffness, part, (first, last) = self.rope
        length = part * self.length(np.zeros(3 * self.count))
        over = [tuple(first), bodies[-1]["end"], tuple(last)]
        rope = scene.add_rope(over, spring=fb.Spring(stiffness), length=length)
        return scene, bodies, rope


@pytest.mark.parametrize("seed", range(12))
def test_random_mechanisms_move_as_bodies_whose_joints_are_multipliers(seed):
    mechanism = Mechanism(seed)
    expected = mechanism.motion(np.linspace(0, T_END, 5))
    size, errors = abs(expected).max(), []
    for steps in (40, 160):
        scene, bodies, rope = mechanism.scene()
        found = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=T_END / steps, t_end=T_END)
        rows = slice(None, None, steps // 4)
        columns = [
            np.column_stack([found.displacement(body.centre), found.rotation(body.centre)])[rows]
            for body in bodies
        ]
        errors.append(abs(np.hstack(columns) - expected).max() / size)
    assert errors[1] < 1e-6 or errors[1] < errors[0] / 8 and errors[1] < 1e-4
    lengths = [mechanism.length(q) for q in expected]
    assert found.joint(rope).length[rows] == pytest.approx(lengths, abs=1e-4 * size)
