"""Whole scenes with joints: invariance, equivalence, loops, initial rates and accelerations."""

import numpy as np
import pytest
from jointed import KINDS, MEMBER, W, momenta, pair, rotation
from scenes import clamped_bar, one_bar, pinned_bar

import fx_beam as fb

# -- Invariance ----------------------------------------------------------------------------------


def swing(Q=None, order=(0, 1, 2, 3), swapped=False):
    """A mechanism with all kinds of joints in a frame Q; its joints in an order."""
    Q = np.eye(2) if Q is None else Q
    sign = np.linalg.det(Q)
    scene = fb.Scene(gravity=Q @ (0, -9.81))
    lines = [((0, 0), (1, 0)), ((1.2, 0.1), (2, 1)), ((2, 1), (2.5, 0)), ((2.5, 0), (3, 1))]
    arm, sleeve, rod, bob = (scene.add_beam([Q @ p, Q @ q], MEMBER, elements=2) for p, q in lines)
    laws = {"spring": fb.Spring(3.0), "damper": fb.Damper(0.1)}
    hinge = fb.Coordinate(**laws)
    ends = (rod.start, sleeve.end) if swapped else (sleeve.end, rod.start)
    joints = [
        fb.Revolute(fb.GROUND, arm.start, motor=lambda t: sign * np.sin(np.pi * t) ** 2),
        fb.Prismatic(arm.end, sleeve.start, axis=Q @ (1, 0), offset=Q @ (0, 0.1)),
        fb.Revolute(*ends, spring=fb.Spring(5.0, rest=(-sign if swapped else sign) * 0.2)),
        fb.PinInSlot(rod.end, bob.start, axis=Q @ (1, 1), damper=laws["damper"], hinge=hinge),
    ]
    made = {i: scene.add_joint(joints[i]) for i in order}
    solution = fb.simulate(scene, dt=0.01, t_end=0.6)
    forces = np.array([solution.joint(made[i]).force for i in range(4)])
    if swapped:
        forces[2] *= -1  # the action on the other node
    x = np.array([solution.position(beam.node(f)) for beam in scene.beams for f in (0, 0.5, 1)])
    psi = solution.q[:, :, 2]
    slides = np.array([solution.joint(made[i]).slide for i in (1, 3)])
    return x @ Q, sign * psi, slides, forces[..., :2] @ Q, sign * forces[..., 2]


@pytest.fixture(scope="module")
def plain_swing():
    results = _, psi, slides, forces, _ = swing()
    assert np.ptp(psi) > 1.0 and np.ptp(slides, axis=1).min() > 0.3
    assert abs(forces).max(axis=(1, 2)).min() > 1.0
    return results


def assert_same(results, expected):
    for value, plain in zip(results, expected, strict=True):
        assert abs(value - plain).max() < 1e-9 * max(1.0, abs(plain).max())


@pytest.mark.parametrize(("turn", "mirror"), [(2.1, False), (0.0, True), (-np.pi / 2, True)])
def test_a_turned_or_mirrored_scene_has_the_turned_or_mirrored_motion(plain_swing, turn, mirror):
    Q = rotation(turn) @ np.diag([1.0, -1.0 if mirror else 1.0])
    assert_same(swing(Q), plain_swing)


@pytest.mark.parametrize("options", [{"order": (2, 0, 3, 1)}, {"swapped": True}])
def test_the_order_of_joints_and_of_their_nodes_does_not_matter(plain_swing, options):
    assert_same(swing(**options), plain_swing)


# -- Equivalence ---------------------------------------------------------------------------------


def loaded(prepare):
    """Positions and rotations of a beam after `prepare(scene, beam)` has held it."""
    scene, beam = one_bar((1, 0.5), MEMBER, elements=4, gravity=(1.0, -9.81))
    joint = prepare(scene, beam)
    scene.add_moment(beam.end, lambda t: 3.0 * np.sin(5 * t))
    solution = fb.simulate(scene, dt=0.01, t_end=0.5)
    reaction = solution.joint(joint).force if joint else solution.reaction(beam.start)
    return solution.q[:, [node.number for node in beam.nodes]], reaction


def fixed(*components):
    return lambda scene, beam: scene.fix(beam.start, *components)


def grounded(make, *arguments, swapped=False, **options):
    def prepare(scene, beam):
        ends = (beam.start, fb.GROUND) if swapped else (fb.GROUND, beam.start)
        return scene.add_joint(make(*ends, *arguments, **options))

    return prepare


STILL = {"motor": lambda t: 0.0}


@pytest.mark.parametrize(
    ("support", "joint"),
    [
        (fixed("x", "y", "rotation"), grounded(fb.Rigid)),
        (fixed("x", "y"), grounded(fb.Revolute)),
        (fixed("x", "y"), grounded(fb.Revolute, swapped=True)),
        (fixed("x", "y"), grounded(fb.PinInSlot, (1, 2), **STILL)),
        (fixed("y"), grounded(fb.PinInSlot, (1, 0))),
        (fixed("x"), grounded(fb.PinInSlot, (0, -3))),
        (fixed("y", "rotation"), grounded(fb.Prismatic, (1, 0))),
        (fixed("x", "y", "rotation"), grounded(fb.Prismatic, (1, 1), **STILL)),
        (fixed("x", "y", "rotation"), grounded(fb.Revolute, **STILL)),
    ],
)
def test_a_joint_on_the_ground_is_the_support_of_the_same_freedom(support, joint):
    (q, reaction), (same, force) = loaded(support), loaded(joint)
    assert np.ptp(q) > 0.01
    assert abs(same - q).max() < 1e-10
    # On the ground as b the force is that on the ground.
    error = min(abs(force - reaction).max(), abs(force + reaction).max())
    assert error < 1e-8 * abs(reaction).max()


def test_a_rigid_joint_with_offset_and_a_body_are_a_stiff_short_beam():
    motions = []
    for how in ("joint", "beam", "body"):
        scene, first = clamped_bar((1, 0), MEMBER, elements=2, gravity=(0, -9.81))
        start = 1, 0.3
        if how == "beam":
            start = scene.add_beam(
                [first.end, start], fb.Section(EA=1e9, GA=1e9, EI=1e9), elements=1
            ).end
        if how == "body":
            start = scene.add_body((1, 0.3), 0.0, points={"a": first.end}).centre
        second = scene.add_beam([start, (2, 0.3)], MEMBER, elements=2)
        if how == "joint":
            scene.add_joint(fb.Rigid(first.end, second.start, offset=(0, 0.3)))
        solution = fb.simulate(scene, dt=0.01, t_end=0.5)
        motions.append(np.hstack([solution.shape(first), solution.shape(second)]))
    assert np.ptp(motions[0], axis=0).max() > 0.05
    assert abs(motions[1] - motions[0]).max() < 1e-6
    assert abs(motions[2] - motions[0]).max() < 1e-11


# -- Initial rates -------------------------------------------------------------------------------


def relative_rates(solution, joint, row):
    """Velocity of b against its place on a in a row, and relative spin."""
    x = [solution.position(n)[row] for n in (joint.a, joint.b)]
    v = [solution.velocity(n)[row] for n in (joint.a, joint.b)]
    w = [solution.spin(n)[row] for n in (joint.a, joint.b)]
    gap = v[1] - v[0] - w[0] * (W @ (x[1] - x[0]))
    if joint.axis is not None:
        axis = rotation(solution.rotation(joint.a)[row]) @ joint.axis
        gap -= (gap @ axis) * axis
    return [*gap, (w[1] - w[0]) * joint.turns_together]


FIELDS = (
    lambda x, y: (np.sin(3 * x) + y, np.cos(2 * x) - y),
    lambda x, y: (x * y, 1 + np.sin(y + 2 * x)),
)


def projected(kind, massless, field):
    """Velocities of a pair before and after they are made compatible; with a tail of members."""
    scene, *beams, joint = pair(kind)
    joints = [joint]
    if massless:
        bar = fb.Section(EA=1e4, GA=1e4, EI=100.0)
        third = scene.add_beam([beams[1].end, (2, 0)], bar, elements=2)
        beams.append(scene.add_beam([(2, 0), (3, 0)], MEMBER, elements=1))
        joints.append(scene.add_joint(fb.Revolute(third.end, beams[2].start)))
    rates = np.zeros((1, len(scene.nodes), 3))
    for node in beams[1].nodes:
        rates[0, node.number] = *field(node.x, node.y), node.x + 2
    scene.set_velocity(beams[1], field, spin=lambda x, y: x + 2)
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.01, t_end=0.01)
    for each in joints:
        assert relative_rates(solution, each, 0) == pytest.approx([0, 0, 0], abs=1e-13)
        assert relative_rates(solution, each, -1) == pytest.approx([0, 0, 0], abs=1e-9)
    return beams, rates - solution.v[:1], solution.v[:1]


@pytest.mark.parametrize(
    ("kind", "massless"), [*((kind, False) for kind in KINDS), ("prismatic with offset", True)]
)
def test_rates_satisfy_the_joint_and_projected_ones_are_the_nearest(kind, massless):
    # What is taken away has no momentum along any motion that the joint allows.
    (beams, change, v), (_, _, allowed) = (projected(kind, massless, field) for field in FIELDS)
    for rates in (v, allowed):
        work = [
            (momenta(change, beam) * rates[:, [node.number for node in beam.nodes]]).sum()
            for beam in beams
        ]
        assert abs(sum(work)) < 1e-9 * abs(change).max() * abs(rates).max()
    assert abs(change).max() > 0.1


# -- Initial accelerations -----------------------------------------------------------------------


def test_a_mass_on_a_massless_arm_falls_freely_at_the_start():
    # The arm's end moves the mass by x, y, rotation and slide: more unknowns than it has inertia.
    scene, arm = pinned_bar(
        (1, 0), fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=1, gravity=(0, -9.81)
    )
    bob = scene.add_beam([(1, 0.2), (2, 0.2)], MEMBER, elements=1)
    scene.add_joint(fb.Prismatic(arm.end, bob.start, axis=(1, 0), offset=(0, 0.2)))
    solution = fb.simulate(scene, fb.Newmark(), dt=0.001, t_end=0.01)
    for node in (bob.start, bob.end):
        assert solution.acceleration(node)[0] == pytest.approx([0, -9.81], abs=1e-10)


# -- Rates of massless nodes -----------------------------------------------------------------------


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum, fb.EnergyDecaying, fb.Newmark, fb.HHT])
def test_a_massless_node_has_the_rates_of_the_node_that_holds_it(scheme):
    scene = fb.Scene(gravity=(0.0, -9.81))
    stiffness = {"EA": 1e4, "GA": 1e4, "EI": 10.0}
    heavy = scene.add_beam([(0, 0), (1, 0)], fb.Section(**stiffness, rhoA=1.0, rhoI=0.1), 2)
    thin = scene.add_beam([(0, 0), (0, 1)], fb.Section(**stiffness, rhoA=1.0), 2)
    massless = scene.add_beam([(1, 0), (2, 0)], fb.Section(**stiffness), elements=1)
    scene.pin(massless.end)
    rigid = scene.add_joint(fb.Rigid(thin.start, heavy.start))
    hinge = scene.add_joint(fb.Revolute(massless.start, heavy.end))
    scene.add_moment(heavy.start, 1.0)
    solution = fb.simulate(scene, scheme(), dt=0.01, t_end=0.1)
    for rates in (solution.v, solution.a):
        assert np.array_equal(rates[:, rigid.a.number], rates[:, rigid.b.number])
        assert np.array_equal(rates[:, hinge.a.number, :2], rates[:, hinge.b.number, :2])
