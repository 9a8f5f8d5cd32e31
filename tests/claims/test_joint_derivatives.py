"""The coupling of joints against differences, dense products, and what it has to reproduce."""

from dataclasses import replace

import numpy as np
import pytest
from jointed import AXIS, BENDING, KINDS, MEMBER, OFFSET, W, pair, rotation

import fx_beam as fb
from fx_beam.coupling.index_reduction import IndexReduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.fem.step_start import StepStart
from fx_beam.mechanics.interval import Interval
from fx_beam.model.model import Model
from fx_beam.stepping.initial_state import reference_state

# One of each kind of virtual map: exact work, and weighted ends of the step, of which Newmark and
# HHT are members with other weights.
SCHEMES = [fb.EnergyMomentum(), fb.GeneralizedAlpha(0.6)]
DT = 0.1


def on_a_node(kind, **options):
    return pair(kind, **options)[0]


def with_b_retained(kind):
    scene, _, second, _ = pair(kind)
    scene.pin(second.start)
    return scene


def with_b_clamped(kind):
    scene, _, second, _ = pair(kind)
    scene.clamp(second.start)
    return scene


def with_a_clamped(kind):
    scene, first, _, _ = pair(kind)
    scene.clamp(first.end)
    return scene


def with_x_and_y_held_apart(kind):
    scene, first, second, _ = pair(kind)
    scene.fix(first.end, "x")
    scene.fix(second.start, "y")
    return scene


def on_the_ground(kind):
    make, _, given = KINDS[kind]
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
    scene.add_joint(make(fb.GROUND, beam.start, **{k: v for k, v in given.items() if k == "axis"}))
    return scene


def with_the_ground_as_b(kind):
    make, _, given = KINDS[kind]
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
    scene.add_joint(make(beam.start, fb.GROUND, **given))
    return scene


def chain(kinds=("rigid with offset", "prismatic with offset", "pin in slot"), ground=False):
    """Beams of one element, each joined to the start of the one before, at which b follows a."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], MEMBER)
    if ground:
        scene.add_joint(fb.PinInSlot(beam.start, fb.GROUND, axis=(1, 2), offset=(0.1, 0.3)))
    for kind in kinds:
        make, place, given = KINDS[kind]
        start = np.array([beam.start.x, beam.start.y]) + place
        other = scene.add_beam([start, start + (1, 0.5)], MEMBER)
        scene.add_joint(make(beam.start, other.start, **given))
        beam = other
    return scene


def backward_chain():
    """Three joints of which the last node is supported, so that each a follows its b."""
    scene = chain()
    scene.clamp(scene.beams[-1].start)
    return scene


def chain_held_apart():
    """A chain held in y at one end and in x at the other."""
    scene = chain(("rigid with offset", "revolute", "pin in slot"))
    scene.fix(scene.beams[0].start, "y")
    scene.fix(scene.beams[-1].start, "x")
    return scene


def motors():
    """A turning motor that carries a guide with a driven slide, and a free slot on that."""
    scene = fb.Scene()
    beams = [scene.add_beam([(0, i), (1, i)], MEMBER) for i in range(4)]
    a, b, c, d = (beam.start for beam in beams)
    scene.add_joint(fb.Revolute(a, b, offset=(0, 1), motor=lambda t: 2 * t))
    scene.add_joint(fb.Prismatic(b, c, axis=(0, 1), motor=lambda t: 3 * t**2))
    hinge = fb.Coordinate(motor=lambda t: -t)
    scene.add_joint(fb.PinInSlot(c, d, axis=(1, 0), offset=(0.3, 1), hinge=hinge))
    return scene


SCENES = {
    **{f"{k}, on a node": (on_a_node, k) for k in BENDING},
    **{f"{k}, b retained": (with_b_retained, k) for k in BENDING},
    **{f"{k}, b clamped": (with_b_clamped, k) for k in BENDING},
    **{f"{k}, a clamped": (with_a_clamped, k) for k in BENDING},
    **{f"{k}, x of a and y of b held": (with_x_and_y_held_apart, k) for k in BENDING},
    **{f"{k}, on the ground": (on_the_ground, k) for k in ("prismatic", "pin in slot")},
    **{f"{k}, the ground as b": (with_the_ground_as_b, k) for k in BENDING},
    "chain": (chain,),
    "chain of slots": (chain, ("pin in slot", "pin in slot with offset", "prismatic")),
    "chain on the ground": (chain, ("prismatic", "revolute with offset"), True),
    "chain, the last one supported": (backward_chain,),
    "chain, held in y at one end and in x at the other": (chain_held_apart,),
    "motors": (motors,),
}


@pytest.fixture(params=SCENES)
def scene(request):
    build, *arguments = SCENES[request.param]
    return build(*arguments)


class Moved:
    """The reduction of a scene in a finite configuration, and finite increments from there."""

    def __init__(self, scene, scheme=None, seed=1):
        self.model = Model(scene, scheme or fb.EnergyMomentum())
        self.reduction = self.model.reduction
        random = np.random.default_rng(seed)
        n = self.reduction.free, self.reduction.driven
        self.q = np.zeros(self.model.size)
        self.slides = np.array([joint.start()[0] for joint in scene.joints])
        z = np.concatenate([random.uniform(-0.7, 0.7, k) for k in n])
        self.begin()
        self.q = self.expand(z)
        self.slides = self.slides + self.slide_increments(z)
        self.begin()
        self.z = np.concatenate([random.uniform(-0.7, 0.7, k) for k in n])
        self.D = self.expand(self.z)
        self.r = random.uniform(-1, 1, self.model.size)

    def begin(self):
        start = replace(reference_state(self.model), q=self.q, slides=self.slides)
        self.model.forms.begin(Interval(0.0, DT), self.model.start_of(start, DT))
        self.reduction.begin(self.q, self.slides)

    def expand(self, z):
        return self.reduction.expand(z[: self.reduction.free], z[self.reduction.free :]).copy()

    def slide_increments(self, z):
        increments = np.zeros(len(self.model.scene.joints))
        for number, column in self.model.couplings.slides.items():
            increments[number] = z[column]
        return increments

    def moving(self):
        """Columns that are not fixed."""
        return np.eye(self.reduction.free + self.reduction.driven)

    def virtual_map(self):
        """The matrix That (size, columns)."""
        return np.array([self.reduction.project(e) for e in np.eye(self.model.size)])

    def tangent(self, values, r):
        indptr, indices = self.reduction.pattern
        dense, out = np.zeros((self.reduction.free,) * 2), np.full(len(indices), np.nan)
        self.reduction.fill(values, r, out)
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        dense[rows, indices] = out
        return dense


def differences(function, at, directions, h=1e-3):
    """Directional derivatives, one in each column, with an error of h^6."""
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    return np.array(
        [
            sum(
                w * (function(at + k * h * e) - function(at - k * h * e))
                for k, w in weights.items()
            )
            / h
            for e in directions
        ]
    ).T


def gap(joint, x, psi, slide):
    """Distance of b from its place on a."""
    arm = joint.offset + (0 if joint.axis is None else slide * joint.axis)
    turn = 0.0 if joint.a is fb.GROUND else psi[joint.a.number]
    return x[joint.b.number] - x[joint.a.number] - rotation(turn) @ arm


# -- The motion and its derivatives ------------------------------------------------------------


def test_the_motion_satisfies_every_joint_after_finite_increments(scene):
    moved = Moved(scene)
    q = moved.model.to_nodes(moved.q + moved.D)
    slides = moved.slides + moved.slide_increments(moved.z)
    X = moved.model.mesh.X
    for joint in scene.joints:
        # The ground's point, last in the list, is where the joint starts.
        ground = next((n for n in (joint.a, joint.b) if n is not fb.GROUND), None)
        point = X[ground.number] + (joint.offset if joint.b is fb.GROUND else 0)
        x = np.vstack([X + q[:, :2], point])
        assert abs(gap(joint, x, q[:, 2], slides[joint.number])).max() < 1e-14
        if joint.turns_together and joint.rotation is None:
            psi = np.append(q[:, 2], 0.0)
            assert abs(psi[joint.b.number] - psi[joint.a.number]) < 1e-15


def test_coupling_is_the_derivative_of_the_motion(scene):
    moved = Moved(scene)
    columns = moved.moving()
    expected = differences(moved.expand, moved.z, columns)
    moved.expand(moved.z)
    T = moved.reduction.coupling().toarray()
    assert abs(T[:, : len(columns)] - expected).max() < 1e-11
    for e, column in zip(np.eye(T.shape[1]), T.T, strict=True):
        assert abs(moved.reduction.spread(e) - column).max() == 0.0


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_second_order_term_is_the_derivative_of_the_generalised_forces(scene, scheme):
    moved = Moved(scene, scheme)
    free = moved.reduction.free

    def forces(z):
        moved.expand(z)
        return moved.reduction.project(moved.r)[:free]

    expected = differences(forces, moved.z, moved.moving()[:free])
    moved.expand(moved.z)
    no_stiffness = np.zeros_like(moved.model.forms.stiffness.data)
    assert abs(moved.tangent(no_stiffness, moved.r) - expected).max() < 1e-10


def test_reduced_tangent_is_the_dense_product(scene):
    moved = Moved(scene)
    free, matrix = moved.reduction.free, moved.model.forms.stiffness
    K = matrix.copy()
    K.data = np.random.default_rng(3).uniform(-1, 1, len(K.data))

    def forces(z):
        moved.expand(z)
        return moved.reduction.project(moved.r)[:free]

    second = differences(forces, moved.z, moved.moving()[:free])
    moved.expand(moved.z)
    T = moved.reduction.coupling().toarray()[:, :free]
    dense = moved.virtual_map()[:, :free].T @ K.toarray() @ T + second
    assert abs(moved.tangent(K.data, moved.r) - dense).max() < 1e-10 * abs(dense).max()


@pytest.mark.parametrize("kind", ["rigid", "revolute"])
def test_index_reduction_is_the_dense_product(kind):
    moved = Moved(pair(kind)[0])
    assert isinstance(moved.reduction, IndexReduction)
    K = moved.model.forms.stiffness.copy()
    K.data = np.random.default_rng(3).uniform(-1, 1, len(K.data))
    T = moved.reduction.coupling().toarray()[:, : moved.reduction.free]
    assert abs(T - differences(moved.expand, moved.z, moved.moving())).max() < 1e-11
    assert abs(moved.virtual_map() - T).max() == 0.0
    assert abs(moved.tangent(K.data, moved.r) - T.T @ K @ T).max() < 1e-14


# -- What the virtual displacements reproduce ---------------------------------------------------


def column_values(moved, x):
    """Values of the columns of all degrees of freedom that are columns of their own."""
    z = np.zeros(moved.reduction.columns)
    for dof in range(moved.model.size):
        own = moved.model.couplings.entries(dof)
        if len(own) == 1 and own[0][1:] == (0, 1.0):
            z[own[0][0]] = x[dof]
    return z


@pytest.mark.parametrize("name", [name for name in SCENES if name != "motors"])
def test_virtual_displacements_reproduce_the_increment_of_the_step(name):
    # A turning motor does its work on the difference of two Dtheta: see the test of its work.
    build, *arguments = SCENES[name]
    moved = Moved(build(*arguments))
    work, _ = moved.model.scheme.rates.work_increment(moved.D, moved.model.turns)
    z = column_values(moved, work)
    for column in moved.model.couplings.slides.values():
        z[column] = moved.z[column]
    assert abs(moved.virtual_map() @ z - work).max() < 1e-13


@pytest.mark.parametrize("name", [name for name in SCENES if "ground" not in name])
def test_virtual_displacements_contain_every_rigid_rotation(name):
    build, *arguments = SCENES[name]
    moved = Moved(build(*arguments))
    q0, D = moved.model.to_nodes(moved.q), moved.model.to_nodes(moved.D)
    mean = moved.model.mesh.X + q0[:, :2] + D[:, :2] / 2
    turned = moved.model.from_nodes(np.column_stack([mean @ W.T, np.ones(len(mean))]))
    assert abs(moved.virtual_map() @ column_values(moved, turned) - turned).max() < 1e-13


# -- The whole equation of motion ----------------------------------------------------------------


def machine():
    """Several joints of all kinds with springs, dampers and motors, in a loop, with a support."""
    scene = fb.Scene(gravity=(0, -9.81))
    spring, damper = fb.Spring(30.0, rest=0.2), fb.Damper(4.0)
    crank = scene.add_beam([(0, 0), (0, 1)], MEMBER, elements=2)
    coupler = scene.add_beam([(0, 1), (2, 1.5)], MEMBER, elements=2)
    rocker = scene.add_beam([(2.2, 1.6), (2, 0)], MEMBER, elements=2)
    sleeve = scene.add_beam([(1.2, 1.25), (1.2, 3)], MEMBER)
    slider = scene.add_beam([(1.2, 3), (2, 3)], MEMBER)
    wheel = scene.add_beam([(2, 3), (2, 4)], MEMBER)
    scene.add_joint(fb.Revolute(fb.GROUND, crank.start, spring=spring, damper=damper))
    scene.add_joint(fb.Revolute(crank.end, coupler.start, spring=spring, damper=damper))
    scene.add_joint(fb.Revolute(coupler.end, rocker.start, offset=(0.2, 0.1), spring=spring))
    scene.pin(rocker.end)
    scene.add_joint(
        fb.Prismatic(coupler.node(0.5), sleeve.start, axis=(1, 0), spring=spring, damper=damper)
    )
    hinge = fb.Coordinate(spring=spring, damper=damper)
    scene.add_joint(fb.PinInSlot(slider.start, sleeve.end, axis=AXIS, spring=spring, hinge=hinge))
    scene.add_joint(fb.Revolute(slider.end, wheel.start, motor=lambda t: 3 * t))
    scene.add_joint(fb.PinInSlot(wheel.end, fb.GROUND, axis=(1, 0), offset=OFFSET, spring=spring))
    return scene


@pytest.mark.parametrize("scheme", [*SCHEMES, fb.Newmark(), fb.MidPoint()], ids=lambda s: s.name)
def test_tangent_is_the_derivative_of_the_whole_residual(scheme):
    moved = Moved(machine(), scheme)
    model, reduction = moved.model, moved.reduction
    assert isinstance(reduction, JointReduction)
    random = np.random.default_rng(4)
    v, a, load = (random.uniform(-1, 1, model.size) for _ in range(3))
    model.forms.begin(Interval(0.0, DT), StepStart(moved.q, v, a))
    free = reduction.free

    def forces(z):
        D = moved.expand(z)
        acceleration, slope = scheme.rates.acceleration(D, v, a, DT, model.turns)
        return model.forms.internal_force(D) + model.mass @ acceleration - load, slope

    def residual(z):
        r, _ = forces(z)
        return reduction.project(r)[:free]

    expected = differences(residual, moved.z, moved.moving()[:free])
    r, slope = forces(moved.z)
    model.forms.assemble_stiffness()
    K = model.forms.stiffness
    values = K.data + model.mass.data * slope[K.indices]
    assert abs(moved.tangent(values, r) - expected).max() < 1e-9 * abs(expected).max()
