"""What joints keep: unknowns, gaps, energy and momenta, and the laws of Newton."""

import numpy as np
import pytest
import scipy.sparse
from jointed import KINDS, MEMBER, SLIDING, W, drift, pair, rotation, throw, thrown

import fx_beam as fb
from fx_beam.coupling.index_reduction import IndexReduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.model.model import Model
from fx_beam.stepping.mass_solver import acceleration_of, iterated_acceleration

# HHT differs from the last one in the level only.
NEWMARK_FAMILY = [fb.Newmark(), fb.GeneralizedAlpha(0.6)]


def scale(solution):
    return solution.energy.kinetic.max()


def cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


# -- Unknowns ----------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("motor", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_leaves_no_unknown_but_its_slide(kind, motor, degree):
    rigid = "rigid" in kind
    if rigid and motor:
        motor = False
    options = {"motor": lambda t: 0.1 * t**2} if motor else {}
    scene, first, _, joint = pair(kind, degree, **options)
    scene.fix(first.start, "y")
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    nodes = 2 * (2 * degree + 1)
    turns_together = joint.rotation is None or (motor and joint.axis is None)
    slides = kind in SLIDING and not motor
    expected = 3 * nodes - 1 - (3 if turns_together else 2) + slides
    assert solution.stats.unknowns == expected
    indptr, indices = Model(scene, fb.EnergyMomentum()).reduction.pattern
    assert len(indptr) == expected + 1
    assert set(indices) == set(range(expected))


@pytest.mark.parametrize("kind", KINDS)
def test_only_joints_that_bend_or_are_driven_cost_more_than_numbering(kind):
    scene, first, second, _ = pair(kind)
    model = Model(scene, fb.EnergyMomentum())
    plain = kind in ("rigid", "revolute")
    assert isinstance(model.reduction, IndexReduction if plain else JointReduction)
    assert ("joints" in model.assembled) is not plain


def test_scenes_without_joints_and_with_hinges_on_the_ground_are_only_numbered():
    for hinge in (False, True):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
        if hinge:
            scene.add_joint(fb.Revolute(fb.GROUND, beam.start))
        model = Model(scene, fb.EnergyMomentum())
        assert isinstance(model.reduction, IndexReduction)
        assert "joints" not in model.assembled
        assert model.reduction.free == (7 if hinge else 9)


# -- Energy and momenta ------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.02, 0.002])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_energy_and_momenta_are_kept_in_free_flight(kind, degree, dt):
    scene, joint = thrown(kind, degree)
    solution = fb.simulate(scene, dt=dt, t_end=1.0)
    assert drift(solution.energy.total) < 1e-10
    assert drift(solution.linear_momentum) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10
    assert solution.gap(joint).max() < 1e-12
    if kind in SLIDING:
        assert np.ptp(solution.slide(joint)) > 1.5  # and the members are 1 long
    assert np.ptp(solution.rotation(joint.b)) > 0.3


@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_energy_is_kept_under_gravity_and_at_inner_nodes(kind, inner):
    scene, _ = thrown(kind, gravity=(0.5, -9.81), inner=inner)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    assert abs(solution.energy.balance_error).max() < 1e-10 * scale(solution)


@pytest.mark.parametrize("kind", KINDS)
def test_momenta_are_kept_at_inner_nodes(kind):
    scene, _ = thrown(kind, inner=True)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    assert drift(solution.linear_momentum) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10


def pinned_chain(gravity=None, offset=(0.0, 0.0)):
    """Double pendulum about the origin, hinged with an offset."""
    scene = fb.Scene(gravity=gravity)
    upper = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
    lower = scene.add_beam([(1 + offset[0], offset[1]), (1.8, -0.6)], MEMBER, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, upper.start))
    scene.add_joint(fb.Revolute(upper.end, lower.start, offset=offset))
    for beam in (upper, lower):
        scene.set_velocity(beam, lambda x, y: 2.0 * (W @ (x, y)), spin=2.0)
    return scene


@pytest.mark.parametrize("offset", [(0.0, 0.0), (-0.1, 0.2)])
def test_a_double_pendulum_keeps_its_energy_and_without_gravity_its_angular_momentum(offset):
    solution = fb.simulate(pinned_chain(offset=offset), dt=0.01, t_end=3.0)
    assert drift(solution.energy.total) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10
    assert drift(solution.linear_momentum) > 0.1  # the pin pulls
    solution = fb.simulate(pinned_chain((0, -9.81), offset), dt=0.01, t_end=3.0)
    assert abs(solution.energy.balance_error).max() < 1e-10 * scale(solution)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.1, -0.05)])
def test_a_star_of_three_members_on_one_pin_keeps_energy_and_momenta(offset):
    scene = fb.Scene()
    pin = np.array([0.3, 0.4])
    hub = scene.add_beam([(0, 0), pin], MEMBER, elements=2)
    arms = [
        scene.add_beam([pin + offset, pin + end], MEMBER, elements=2) for end in ((1, 0), (0, 1))
    ]
    for arm, spin in zip(arms, (4.0, -3.0), strict=True):
        scene.add_joint(fb.Revolute(hub.end, arm.start, offset=offset))
        center = pin + offset
        scene.set_velocity(
            arm, lambda x, y, w=spin, c=center: w * (W @ ((x, y) - c)) + (0.1, 1.0), spin=spin
        )
    scene.set_velocity(hub, (0.1, 1.0))
    solution = fb.simulate(scene, dt=0.01, t_end=3.0)
    for kept in (solution.energy.total, solution.linear_momentum, solution.angular_momentum):
        assert drift(kept) < 1e-10
    assert abs(solution.rotation(arms[0].end) - solution.rotation(arms[1].end)).max() > 5.0


def test_gaps_stay_closed_over_10_000_steps_without_stabilisation():
    # A trolley on a long spring, an eccentric arm, and a sleeve that swings along it.
    scene = fb.Scene(gravity=(0, -9.81))
    trolley = scene.add_beam([(0, 0), (0.5, 0)], MEMBER)
    arm = scene.add_beam([(0.7, -0.1), (0.7, -1.1)], MEMBER)
    sleeve = scene.add_beam([(0.7, -1.0), (1.0, -1.0)], MEMBER)
    rail = scene.add_joint(
        fb.Prismatic(fb.GROUND, trolley.start, axis=(1, 0), spring=fb.Spring(2.0))
    )
    pin = scene.add_joint(fb.Revolute(trolley.end, arm.start, offset=(0.2, -0.1)))
    rod = scene.add_joint(
        fb.Prismatic(arm.end, sleeve.start, axis=(0, 1), spring=fb.Spring(1.0, rest=0.1))
    )
    for beam in (trolley, arm, sleeve):
        scene.set_velocity(beam, (4.0, 0.0))
    solution = fb.simulate(scene, dt=0.01, t_end=100.0)
    assert solution.stats.steps == 10_000
    assert np.ptp(solution.slide(rail)) > 6.0
    assert np.ptp(solution.slide(rod)) > 5.0
    for joint in (rail, pin, rod):
        assert solution.gap(joint).max() < 1e-11
    assert abs(solution.energy.balance_error).max() < 1e-9 * scale(solution)


# -- Forces of the joints ----------------------------------------------------------------------


@pytest.fixture
def forces_of_steps(monkeypatch):
    """The forces with which steps are in balance, without those that make rates fit at their ends.

    Of the former these tests hold to round-off. The latter are impulses at the ends of steps, with
    the arms that joints have there, so that of the sum the tests hold to second order.
    """
    monkeypatch.setattr(Model, "fits_rates", False)


def work_of(solution, joint):
    """Work of a joint's forces on both of its nodes in each step."""
    force, moment = np.split(solution.joint(joint).force[1:], [2], axis=1)
    total, turns = 0.0, {}
    x = {}
    for name, node in (("a", joint.a), ("b", joint.b)):
        x[name] = solution.position(node)
        turns[name] = 2 * np.tan(np.diff(solution.rotation(node)) / 2)
    rho = x["b"] - x["a"]
    lever = cross((rho[1:] + rho[:-1]) / 2, force)
    total = np.sum(force * np.diff(rho, axis=0), axis=1) - lever * turns["a"]
    return total + moment[:, 0] * (turns["b"] - turns["a"])


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_does_no_work(kind, degree, forces_of_steps):
    scene, joint = thrown(kind, degree, gravity=(0, -9.81))
    solution = fb.simulate(scene, dt=0.01, t_end=0.5)
    assert abs(solution.joint(joint).force).max() > 0.5
    assert abs(work_of(solution, joint)).max() < 1e-10 * scale(solution)


@pytest.mark.parametrize("kind", SLIDING)
def test_a_guide_has_no_force_along_its_axis_and_a_slot_no_moment(kind, forces_of_steps):
    scene, joint = thrown(kind)
    solution = fb.simulate(scene, dt=0.01, t_end=0.5)
    axes = np.array([rotation(psi) @ joint.axis for psi in solution.rotation(joint.a)])
    force = solution.joint(joint).force[1:]
    along = np.sum(force[:, :2] * (axes[1:] + axes[:-1]) / 2, axis=1)
    assert abs(along).max() < 1e-9 * abs(force).max()
    if "slot" in kind:
        assert abs(force[:, 2]).max() < 1e-9 * abs(force).max()
    else:
        assert abs(force[:, 2]).max() > 0.1


def momenta_of(scene, solution, beam):
    """Linear and angular momentum of one beam."""
    model = Model(scene, fb.EnergyMomentum())
    nodes = solution.nodes_of_beam[beam.name]
    p = np.array([model.to_nodes(model.mass @ model.from_nodes(v))[nodes] for v in solution.v])
    x = solution.shape(beam)
    spin = np.sum(x[..., 0] * p[..., 1] - x[..., 1] * p[..., 0] + p[..., 2], axis=1)
    return p[..., :2].sum(axis=1), spin


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_the_impulse_of_the_joint_is_what_changes_the_momenta_of_a_member(
    kind, backwards, forces_of_steps
):
    # Backwards, a follows b: the second beam's start is supported, and so retained.
    scene, first, second, joint = pair(kind)
    throw(scene, first, second, joint)
    if backwards:
        scene.prescribe(second.start, rotation=lambda t: (1 + (joint.rotation is not None)) * t)
        scene.velocities.clear()
        scene.make_velocities_compatible()
        for beam in (first, second):
            scene.set_velocity(beam, lambda x, y: (1.0 - y, 2.0 + x), spin=1.0)
    dt = 0.01
    solution = fb.simulate(scene, dt=dt, t_end=0.5)
    force = solution.joint(joint).force[1:]
    support = solution.reaction(second.start)[1:]
    for beam, node, sign in ((second, joint.b, 1), (first, joint.a, -1)):
        linear, angular = momenta_of(scene, solution, beam)
        x = (solution.position(node)[1:] + solution.position(node)[:-1]) / 2
        moment = sign * force[:, 2]
        if sign < 0:
            rho = solution.position(joint.b) - solution.position(joint.a)
            moment = moment - cross((rho[1:] + rho[:-1]) / 2, force[:, :2])
        else:
            moment = moment + support[:, 2]
        impulse = dt * sign * force[:, :2]
        twist = dt * (cross(x, sign * force[:, :2]) + moment)
        assert abs(np.diff(linear, axis=0) - impulse).max() < 1e-10 * abs(linear).max()
        assert abs(np.diff(angular) - twist).max() < 1e-10 * abs(angular).max()


@pytest.mark.parametrize("grounded", [False, True])
@pytest.mark.parametrize("make", [fb.Revolute, fb.Rigid])
def test_the_hinges_of_a_hanging_chain_carry_the_weight_below(make, grounded):
    stiff = fb.Section(EA=1e10, GA=1e10, EI=1e8, rhoA=1.0, rhoI=0.1)
    scene = fb.Scene(gravity=(0, -9.81))
    ends = [(0.0, 0.0), (0.0, -1.0), (0.0, -3.0), (0.0, -4.0)]
    members = [
        scene.add_beam([a, b], stiff, elements=2) for a, b in zip(ends, ends[1:], strict=False)
    ]
    joints = [
        scene.add_joint(make(a.end, b.start)) for a, b in zip(members, members[1:], strict=False)
    ]
    if grounded:
        joints.append(scene.add_joint(make(fb.GROUND, members[0].start)))
    else:
        scene.clamp(members[0].start)
    # So stiff, and so damped by the scheme, that it hangs at rest.
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.0), dt=0.1, t_end=3.0)
    weights = [3 * 9.81, 9.81, 4 * 9.81]
    for joint, weight in zip(joints, weights, strict=False):
        assert solution.joint(joint).force[-1] == pytest.approx([0, weight, 0], abs=1e-6 * weight)
    if not grounded:
        reaction = solution.reaction(members[0].start)[-1]
        assert reaction == pytest.approx([0, 4 * 9.81, 0], abs=1e-4)


def test_the_reaction_of_a_jointed_support_is_the_total():
    # Two arms on one supported pin: its reaction holds both, whichever node is supported.
    reactions = []
    for which in (0, 1):
        scene = fb.Scene(gravity=(0, -9.81))
        arms = [scene.add_beam([(0, 0), end], MEMBER, elements=2) for end in ((1, 0), (-0.5, 1))]
        scene.add_joint(fb.Revolute(arms[0].start, arms[1].start))
        scene.pin(arms[which].start)
        solution = fb.simulate(scene, dt=0.01, t_end=0.5)
        reactions.append(solution.reaction(arms[which].start)[1:, :2])
        change = np.diff(solution.linear_momentum, axis=0) / 0.01
        mass = 1.0 + np.hypot(0.5, 1)
        total = reactions[-1] + mass * np.array([0, -9.81])
        assert abs(total - change).max() < 1e-9 * abs(total).max()
    assert abs(reactions[0] - reactions[1]).max() < 1e-8 * abs(reactions[0]).max()


# -- Accelerations at the start --------------------------------------------------------------------


def test_accelerations_are_the_smallest_where_unknowns_outnumber_inertias():
    shapes = np.random.default_rng(5).uniform(-1, 1, (4, 3))
    mass, force = scipy.sparse.csr_matrix(shapes @ shapes.T), shapes @ (1.0, 2.0, 3.0)
    assert mass @ acceleration_of(mass, force) == pytest.approx(force, rel=1e-9)
    nowhere = np.linalg.svd(shapes.T)[2][-1]  # what this force pushes has no mass
    a = acceleration_of(mass, force + nowhere)
    assert abs(a).max() < 1e3


def test_accelerations_without_factors_are_those_of_the_mass_matrix():
    n = 500  # unequal elements in a row, and an unknown without mass
    lengths = np.random.default_rng(3).uniform(0.1, 10, n - 2)
    mass = np.zeros((n, n))
    for i, length in enumerate(lengths):
        mass[i : i + 2, i : i + 2] += length / 6 * np.array([[2, 1], [1, 2]])
    a = np.random.default_rng(4).normal(size=n)
    a[-1] = 0.0
    found = iterated_acceleration(mass.__matmul__, mass.diagonal(), mass @ a)
    assert abs(found - a).max() < 1e-12
    pair = np.ones((2, 2))  # nothing resists their difference
    assert iterated_acceleration(pair.__matmul__, np.ones(2), np.array([2.0, 0.0])) is None


@pytest.mark.parametrize("kind", KINDS)
def test_initial_accelerations_follow_the_joint(kind):
    scene, joint = thrown(kind, spin=2.0, slide=3.0)
    solution = fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.01)
    (xa, va, aa), (xb, vb, ab) = (
        (solution.position(n)[0], solution.v[0, n.number], solution.a[0, n.number])
        for n in (joint.a, joint.b)
    )
    rho, spin = xb - xa, va[2]
    gap = (ab - aa)[:2] - aa[2] * (W @ rho) + spin**2 * rho
    if joint.axis is not None:
        rate = joint.axis @ ((vb - va)[:2] - spin * (W @ rho))
        assert rate == pytest.approx(3.0)
        gap -= 2 * spin * rate * (W @ joint.axis)
        gap -= (gap @ joint.axis) * joint.axis
    assert abs(gap).max() < 1e-6


# -- Newmark's family --------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", NEWMARK_FAMILY, ids=lambda s: s.name)
@pytest.mark.parametrize("kind", KINDS)
def test_the_newmark_family_keeps_linear_momentum_with_joints(kind, scheme):
    scene, joint = thrown(kind)
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=1.0)
    assert drift(solution.linear_momentum) < 1e-10
    assert solution.gap(joint).max() < 1e-12


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.MidPoint(), *NEWMARK_FAMILY], ids=lambda s: s.name
)
def test_schemes_are_of_second_order_with_joints(scheme):
    stout = fb.Section(EA=200.0, GA=200.0, EI=20.0, rhoA=1.0, rhoI=0.1)

    def end(dt):
        scene = fb.Scene(gravity=(0, -9.81))
        arm = scene.add_beam([(0, 0), (1, 0)], stout, elements=2)
        sleeve = scene.add_beam([(0.7, 0.2), (0.7, 1.0)], stout, elements=2)
        bob = scene.add_beam([(0.7, 1.0), (1.0, 1.5)], stout)
        scene.add_joint(fb.Revolute(fb.GROUND, arm.start, spring=fb.Spring(3.0, rest=-0.5)))
        slide = fb.Prismatic(
            arm.end, sleeve.start, axis=(1, 0.5), offset=(-0.7, 0), spring=fb.Spring(9.0, rest=0.1)
        )
        scene.add_joint(slide)
        scene.add_joint(fb.Revolute(sleeve.end, bob.start, offset=(0, 0)))
        for beam in (arm, sleeve, bob):
            scene.set_velocity(beam, lambda x, y: 1.5 * (W @ (x, y)), spin=1.5)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=0.4)
        return np.append(solution.q[-1].ravel(), solution.slides[-1])

    steps = [0.01, 0.005, 0.0025]
    fine = end(0.0003125)
    errors = [np.linalg.norm(end(dt) - fine) for dt in steps]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] > 1.9
