"""Nodes that slide on flexible beams: relation, invariants, references, refusals."""

import copy
import pickle
import re

import ufl

import numpy as np
import pytest
import scipy.integrate
from jointed import W, drift
from scipy.optimize import brentq

import fx_beam as fb
from fx_beam.coupling.sliding import Sliding
from fx_beam.scene.path import Path

SOFT = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
STIFF = fb.Section(EA=1e7, GA=1e7, EI=1e5, rhoA=1.0, rhoI=0.01)
SHAPES = {
    "straight": [(0, 0), (6, 0)],
    "curved": fb.arc((0, 0), (3, 0.8), (6, 0)),
    "cornered": [(0, 0), (3, 0), (3, 3)],
}
KINDS = [fb.Slider, fb.Sleeve]


def bead_on(scene, beam, node, make=fb.Slider, mass=0.8, **options):
    """A short beam with a lumped mass, which slides on a beam from one of its nodes on."""
    at = np.array([node.x, node.y])
    bead = scene.add_beam([at, at + (0, 0.3)], SOFT, degree=beam.degree, name="bead")
    scene.add_mass(bead.start, mass, inertia=0.05)
    return bead.start, scene.add_joint(make(beam, bead.start, **options))


def thrown(make=fb.Slider, shape="straight", degree=1, speed=8.0):
    """A free beam of 12 elements that rotates, and a bead that runs along it."""
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES[shape], SOFT, elements=12, degree=degree, name="rod")
    node, joint = bead_on(scene, rod, rod.start, make)
    scene.set_velocity(rod, lambda x, y: (0.2 - 0.3 * y, 0.5 + 0.3 * (x - 3)), spin=0.3)
    scene.set_velocity(scene.beams[1], (speed, 1.0), spin=1.0)
    scene.make_velocities_compatible()
    return scene, joint


# -- The relation ------------------------------------------------------------------------------


def local(values, relation):
    """Values (nodes, 3) of a relation's window, component by component, and none of the slide."""
    return np.append(values[relation.nodes, : relation.components].T.ravel(), 0.0)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_virtual_displacement_has_the_increment_and_rigid_motions(degree, shape):
    scene, random = fb.Scene(), np.random.default_rng(0)
    path = Path(scene.add_beam(SHAPES[shape], SOFT, elements=8, degree=degree))
    for s0, s1 in ((1.1, 1.2), (0.7, 2.2), (2.6, 1.4), (2.0, 2.0), (0.01, 0.5), (1.5, 1.5 + 1e-9)):
        relation = Sliding(path, 3, 0.5, True)
        q, D = 0.3 * random.normal(size=(2, len(path), 3))
        relation.begin(q, s0)
        relation.set(D, s1 - s0)
        step = local(np.column_stack([D[:, :2], 2 * np.tan(D[:, 2] / 2)]), relation)
        step[-1] = s1 - s0
        Dx, Dy, Dpsi = relation.increment
        assert relation.virtual_map @ step == pytest.approx(
            [Dx, Dy, 2 * np.tan(Dpsi / 2)], abs=1e-13
        )
        middle = path.X + q[:, :2] + D[:, :2] / 2
        turn = local(np.column_stack([middle @ W.T, np.ones(len(path))]), relation)
        now = path.X + q[:, :2]
        ends = path.over(np.array([now, now + D[:, :2]]), np.array([s0, s1]))
        assert relation.virtual_map @ turn == pytest.approx(
            [*(W @ ends.sum(axis=0) / 2), 1.0], abs=1e-12
        )


@pytest.mark.parametrize("level, by_tangent", [(0.5, True), (0.5, False), (0.8, False)])
@pytest.mark.parametrize("degree", [1, 3])
def test_derivatives_of_the_relation_are_those_of_differences(degree, level, by_tangent):
    scene, random, h = fb.Scene(), np.random.default_rng(1), 1e-6
    path = Path(scene.add_beam(SHAPES["curved"], SOFT, elements=8, degree=degree))
    q, D = 0.3 * random.normal(size=(2, len(path), 3))
    force = random.normal(size=3)
    for s0, s1 in ((1.1, 1.2), (0.9, 2.3), (3.0, 2.1)):

        def at(values, s0=s0, s1=s1):
            relation = Sliding(path, 3, level, by_tangent)
            relation.begin(q, s0)
            relation.set(D, s1 - s0)
            moved = D.copy()
            moved[relation.nodes] = values[:-1].reshape(3, -1).T
            relation.set(moved, values[-1])
            return relation

        relation = Sliding(path, 3, level, by_tangent)
        relation.begin(q, s0)
        relation.set(D, s1 - s0)
        start = local(D, relation)
        start[-1] = s1 - s0
        for k, unit in enumerate(np.eye(len(start))):
            ahead, behind = at(start + h * unit), at(start - h * unit)
            T = (ahead.increment - behind.increment) / (2 * h)
            assert relation.T[:, k] == pytest.approx(T, abs=1e-7)
            second = (force @ ahead.virtual_map - force @ behind.virtual_map) / (2 * h)
            assert relation.second(force)[:, k] == pytest.approx(second, abs=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_path_meets_the_nodes_and_has_a_tangent_without_jumps(degree):
    beam = fb.Scene().add_beam(SHAPES["curved"], SOFT, elements=8, degree=degree)
    path = Path(beam)
    for node, s in zip(beam.nodes, beam.s, strict=True):
        assert path.position(s) == pytest.approx([node.x, node.y], abs=1e-14)
    for s in beam.s[1:-1]:
        assert path.position(s - 1e-9, 1) == pytest.approx(path.position(s + 1e-9, 1), abs=1e-7)
    for s in np.linspace(0, path.length, 23):
        found, gap = path.nearest(path.position(s))
        assert found == pytest.approx(s, abs=1e-12) and gap < 1e-14


# -- Energy and momenta ------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["straight", "curved"])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("make", KINDS)
def test_energy_and_momenta_are_kept_while_a_bead_crosses_ten_elements(make, degree, shape):
    scene, joint = thrown(make, shape, degree)
    solution = fb.simulate(scene, dt=0.01, t_end=0.75)
    assert solution.stats.solver.startswith("compiled")
    crossed = np.searchsorted(joint.beam.s, solution.slide(joint)[-1])
    assert crossed > 10 and solution.stats.halvings == 0
    assert drift(solution.energy.total) < 1e-11
    assert drift(solution.linear_momentum) < 1e-11
    assert drift(solution.angular_momentum) < 1e-11
    assert solution.joint(joint).gap.max() < 1e-13
    turned = abs(solution.joint(joint).angle).max()
    assert turned < 1e-12 if make is fb.Sleeve else turned > 0.1


def test_a_step_over_many_elements_is_halved_and_keeps_the_energy():
    scene, joint = thrown(speed=40.0)
    solution = fb.simulate(scene, dt=0.05, t_end=0.1)
    assert solution.stats.halvings > 0
    assert drift(solution.energy.total) < 1e-11
    with pytest.raises(fb.StepError) as raised:
        fb.simulate(scene, dt=0.05, t_end=0.1, max_halvings=0)
    assert raised.value.failure.kind == "large slide"


def chain(kinds, degree=1, gravity=(0, -1)):
    """A beam on a beam on a beam on a prismatic joint, each on a slider; a bead on the last."""
    scene = fb.Scene(gravity=gravity)
    options = {"degree": degree}
    base = scene.add_beam([(-1, 0.2), (-0.1, 0.2)], SOFT, elements=2, name="base", **options)
    first = scene.add_beam(SHAPES["straight"], SOFT, elements=12, name="first", **options)
    second = scene.add_beam([(2.3, 0), (2.3, 2)], SOFT, elements=6, name="second", **options)
    third = scene.add_beam([(2.3, 1.1), (4, 1.1)], SOFT, elements=6, name="third", **options)
    last = scene.add_beam([(3.1, 1.1), (3.1, 1.6)], SOFT, name="last", **options)
    arm = scene.add_beam([(2.3, 0), (1.5, -0.5)], SOFT, name="arm", **options)
    guide = {"axis": (1, 0.5), "offset": (0.1, -0.2), "spring": fb.Spring(30.0)}
    damped = {"spring": fb.Spring(10.0, rest=1.0), "damper": fb.Damper(0.3)}
    for joint in (
        fb.Prismatic(base.end, first.start, **guide),
        fb.Revolute(base.start, fb.GROUND),
        kinds[0](first, second.start, **damped),
        kinds[1](second, third.start, friction=fb.Friction(0.5, 0.5)),
        kinds[2](third, last.start),
        fb.Revolute(second.start, arm.start, spring=fb.Spring(3.0)),
    ):
        scene.add_joint(joint)
    return scene


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(-0.2)], ids=lambda s: s.name)
@pytest.mark.parametrize(
    "kinds", [(fb.Slider,) * 3, (fb.Sleeve, fb.Slider, fb.Sleeve)], ids=["pins", "sleeves"]
)
def test_beams_that_hang_on_sliders_move_alike_in_c_and_in_python(kinds, scheme):
    runs = [
        fb.simulate(chain(kinds), scheme, dt=0.005, t_end=0.25, solver=solver)
        for solver in ("compiled", "petsc")
    ]
    first, second = runs
    assert abs(first.slides - first.slides[0])[:, 2:5].max(axis=0).min() > 1e-3
    assert abs(first.q - second.q).max() < 1e-9
    assert abs(first.slides - second.slides).max() < 1e-9
    scale = abs(second.joint_forces).max()
    assert abs(first.joint_forces - second.joint_forces).max() < 1e-7 * scale
    assert first.stats.newton_iterations == second.stats.newton_iterations
    if scheme.name == "EnergyMomentum":
        energy = first.energy
        assert energy.dissipated[-1] > 1e-4 and energy.springs.max() > 0.1
        assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic.max()


@pytest.mark.parametrize("make", KINDS)
def test_two_sliders_on_one_beam_keep_energy_and_momenta(make):
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=12)
    beads = []
    for name, node, speed in (("left", rod.node(1 / 12), 3.0), ("right", rod.node(11 / 12), -4.0)):
        bead = scene.add_beam([(node.x, 0), (node.x, 0.3)], SOFT, name=name)
        scene.add_mass(bead.start, 1.0, inertia=0.05)
        scene.set_velocity(bead, (speed, 0.5))
        beads.append(scene.add_joint(make(rod, bead.start)))
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    slides = [solution.slide(joint) for joint in beads]
    assert slides[0][-1] > slides[1][-1]  # they have passed each other
    assert drift(solution.energy.total) < 1e-11
    assert drift(solution.linear_momentum) < 1e-11
    assert drift(solution.angular_momentum, abs(solution.linear_momentum).max()) < 1e-11


def test_two_wheels_of_a_carriage_roll_over_a_bridge():
    scene = fb.Scene(gravity=(0, -9.81))
    bridge = scene.add_beam(SHAPES["straight"], STIFF, elements=10)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    carriage = scene.add_beam([(0.6, 0), (1.2, 0)], STIFF, elements=1)
    scene.add_mass(carriage.start, 5.0)
    wheels = [scene.add_joint(fb.Slider(bridge, node)) for node in carriage.nodes]
    scene.set_velocity(carriage, (3.0, 0.0))
    solution = fb.simulate(scene, dt=0.005, t_end=1.0)
    apart = solution.slide(wheels[1]) - solution.slide(wheels[0])
    assert apart == pytest.approx(0.6, abs=1e-3)
    assert abs(solution.energy.balance_error).max() < 1e-11 * solution.energy.kinetic.max()


@pytest.mark.parametrize("make", KINDS)
def test_a_body_slides_on_a_beam_and_keeps_energy_and_momenta(make):
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=12)
    body = scene.add_body((0.5, 0.2), 1.0, 0.1, points={"hook": (0.5, 0.0)})
    joint = scene.add_joint(make(rod, body["hook"]))
    scene.set_velocity(body.centre, (8.0, 1.0), spin=1.0)
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.01, t_end=0.6)
    assert solution.slide(joint)[-1] > 5
    assert drift(solution.energy.total) < 1e-11
    assert drift(solution.linear_momentum) < 1e-11
    assert drift(solution.angular_momentum) < 1e-11


def test_a_closed_loop_of_bodies_and_a_slider_share_a_scene_but_no_node():
    def made(wheels=False):
        scene = fb.Scene(gravity=(0, -9.81))
        rod = scene.add_beam(SHAPES["straight"], SOFT, elements=12)
        scene.pin(rod.start)
        scene.pin(rod.end)
        ends = [(10, 0), (10, 1), (11.5, 1.5), (11.5, 0)]
        scene.add_joint(fb.Slider(rod, scene.add_body((1.3, 0), 1.0, 0.1).centre))
        last = fb.GROUND
        for start, end in zip(ends[:-1], ends[1:], strict=True):
            middle = tuple(np.mean([start, end], axis=0))
            bar = scene.add_body(middle, 1.0, 0.1, points={"a": start, "b": end})
            scene.add_joint(fb.Revolute(last, bar["a"]))
            last = bar["b"]
        scene.add_joint(fb.Revolute(last, fb.GROUND))
        if wheels:
            points = {"left": (3, 0), "right": (3.6, 0)}
            carriage = scene.add_body((3.3, 0.2), 1.0, 0.1, points=points)
            for name in points:
                scene.add_joint(fb.Slider(rod, carriage[name]))
        return scene

    runs = [
        fb.simulate(made(), dt=0.01, t_end=0.3, solver=solver) for solver in ("compiled", "petsc")
    ]
    assert abs(runs[0].q - runs[1].q).max() < 1e-10
    assert abs(runs[0].energy.balance_error).max() < 1e-11
    with pytest.raises(fb.SceneError, match="closed loop of rigid members contains a node that"):
        fb.simulate(made(wheels=True), dt=0.01, t_end=0.01)


# -- References --------------------------------------------------------------------------------


def wire(degree, elements, make=fb.Slider, at=0.75, **options):
    """A bead of 2 kg on a clamped half circle of radius 1 m, in gravity."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam(fb.arc((-1, 0), (0, -1), (1, 0)), STIFF, elements, degree)
    for node in beam.nodes:
        scene.clamp(node)
    light = fb.Section(EA=1e5, GA=1e5, EI=1e3)
    node = beam.node(at)
    bead = scene.add_beam([(node.x, node.y), (node.x, node.y + 0.1)], light, degree=degree)
    scene.add_mass(bead.start, 2.0, inertia=1e-6)
    scene.fix(bead.end, "rotation")
    return scene, bead.start, scene.add_joint(make(beam, bead.start, **options))


@pytest.mark.parametrize("degree, error", [(1, 1e-3), (3, 2e-5)])
def test_a_bead_on_a_circular_wire_swings_as_a_pendulum(degree, error):
    scene, node, joint = wire(degree, 24)
    solution = fb.simulate(scene, dt=0.001, t_end=2.0)
    x, y = solution.position(node).T
    start = np.arctan2(x[0], -y[0])

    def pendulum(t, state):
        return state[1], -9.81 * np.sin(state[0])

    exact = scipy.integrate.solve_ivp(
        pendulum, (0, 2), (start, 0), t_eval=solution.t, rtol=1e-11, atol=1e-12
    )
    found = np.arctan2(x, -y)
    assert np.ptp(found) > 1.5 and abs(found - exact.y[0]).max() < error
    # Over 2000 steps, each with the tolerance of Newton's method.
    assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.kinetic.max()
    # The joint's force on the bead is m (a - g).
    mean = np.diff(solution.velocity(node), axis=0) / 0.001 + (0, 9.81)
    assert solution.joint(joint).force[1:, :2] == pytest.approx(2.0 * mean, abs=1e-7)


def test_a_bead_at_rest_on_a_wire_vibrates_as_a_pendulum():
    held = wire(3, 12, at=0.5)[0]
    held.fix(held.beams[1].end, "x")
    at_rest = fb.static(held, steps=1)
    lowest = fb.modes(wire(3, 12, at=0.5)[0], at_rest, n=1).angular_frequencies[0]
    assert lowest == pytest.approx(np.sqrt(9.81), rel=5e-3)


def test_a_sleeve_on_a_turning_arm_moves_as_exp_and_turns_with_it():
    scene, rate = fb.Scene(), 2.0
    arm = scene.add_beam([(0, 0), (4, 0)], STIFF, elements=10)
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=lambda t: rate * t))
    node, joint = bead_on(scene, arm, arm.node(0.1), fb.Sleeve, mass=1.0)
    scene.set_velocity(arm, lambda x, y: (-rate * y, rate * x), spin=rate)
    scene.set_velocity(scene.beams[1], lambda x, y: (-rate * y, rate * x), spin=rate)
    solution = fb.simulate(scene, dt=0.005, t_end=1.0)
    # Its own beam of 0.3 m and 0.3 kg turns with it, and its mass is at the same slide.
    assert solution.slide(joint) == pytest.approx(0.4 * np.cosh(rate * solution.t), rel=1e-3)
    assert solution.rotation(node) == pytest.approx(rate * solution.t, abs=2e-4)
    assert abs(solution.energy.balance_error).max() < 1e-11 * solution.energy.kinetic.max()
    found = solution.joint(joint).rate
    along = np.diff(solution.slide(joint)) / np.diff(solution.t)
    assert (found[1:] + found[:-1]) / 2 == pytest.approx(along, abs=1e-4)


def flexible_arm(EI, motor=None, rhoA=1e-3):
    """An arm that turns about its start, and a body of 1 kg that slides outwards on it."""
    scene, rate = fb.Scene(), 2.0
    section = fb.Section(EA=1e6, GA=1e6, EI=EI, rhoA=rhoA, rhoI=1e-3 * rhoA)
    arm = scene.add_beam([(0, 0), (3, 0)], section, elements=30)
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=motor))
    body = scene.add_body((0.4, 0.0), 1.0, 1e-4)
    joint = scene.add_joint(fb.Sleeve(arm, body.centre))
    scene.set_velocity(arm, lambda x, y: (-rate * y, rate * x), spin=rate)
    scene.set_velocity(body, (0.0, 0.4 * rate), spin=rate)
    return scene, body, joint


def test_a_sleeve_bends_a_turning_arm_by_the_coriolis_force():
    rate, EI = 2.0, 5e3
    scene, body, joint = flexible_arm(EI, motor=lambda t: rate * t)
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    slide, motion = solution.slide(joint), solution.joint(joint)
    assert slide == pytest.approx(0.4 * np.cosh(rate * solution.t), rel=2e-3)
    x, y = solution.position(body.centre).T
    c, s = np.cos(rate * solution.t), np.sin(rate * solution.t)
    bent = (c * y - s * x)[-300:]
    force = (2 * rate * motion.rate)[-300:]  # on 1 kg, across the arm
    assert bent == pytest.approx(-force * slide[-300:] ** 3 / (3 * EI), rel=0.02)
    turned = solution.rotation(body.centre)[-300:] - rate * solution.t[-300:]
    assert turned == pytest.approx(-force * slide[-300:] ** 2 / (2 * EI), rel=0.02)


def test_a_sleeve_on_a_soft_arm_keeps_energy_and_the_moment_of_momentum():
    scene, body, joint = flexible_arm(EI=5.0, rhoA=1.0)
    solution = fb.simulate(scene, dt=5e-3, t_end=1.2)
    assert solution.slide(joint)[-1] > 1.0
    bent = solution.rotation(body.centre) - solution.rotation(scene.beams[0].start)
    assert abs(bent).max() > 0.2
    assert drift(solution.energy.total) < 1e-11
    assert drift(solution.angular_momentum) < 1e-11  # about the hinge, at the origin


def test_a_motor_moves_the_node_and_its_work_is_in_the_balance():
    scene, node, joint = wire(2, 12, fb.Sleeve, at=0.25, motor=lambda t: 0.6 * t**2)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    motion = solution.joint(joint)
    assert motion.slide[-1] - motion.slide[0] == pytest.approx(0.6, abs=1e-13)
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert solution.energy.work[-1] == pytest.approx(np.sum(motion.motor_power[1:] * 0.01))


def test_friction_stops_a_bead_on_the_way():
    scene = fb.Scene()
    rail = scene.add_beam(SHAPES["straight"], STIFF, elements=12)
    for node in rail.nodes:
        scene.clamp(node)
    node, joint = bead_on(scene, rail, rail.node(1 / 12), friction=fb.Friction(2.2, 0.01))
    scene.set_velocity(scene.beams[1], (2.0, 0.0))
    scene.fix(scene.beams[1].end, "rotation")
    solution = fb.simulate(scene, dt=0.01, t_end=1.5)
    assert solution.slide(joint)[-1] == pytest.approx(0.5 + 1.0, rel=0.01)  # m v^2 / (2 F), 1.1 kg
    assert solution.energy.dissipated[-1] == pytest.approx(2.2, rel=1e-3)


@pytest.mark.parametrize("degree", [1, 3])
def test_a_weight_between_two_nodes_bends_a_beam_as_the_formula_says(degree):
    scene, section, place = fb.Scene(), fb.Section(EA=1e9, GA=1e9, EI=1e5), 2.3
    beam = scene.add_beam(SHAPES["straight"], section, elements=24, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    post = scene.add_beam([(place, 0), (place, 0.3)], section, degree=degree)
    scene.add_force(post.start, (0.0, -10.0))
    scene.fix(post.end, "x", "rotation")
    joint = scene.add_joint(fb.Slider(beam, post.start))
    solution = fb.static(scene, steps=2)
    exact = -10.0 * place**2 * (6 - place) ** 2 / (3 * 1e5 * 6)
    assert solution.displacement(post.start)[-1, 1] == pytest.approx(exact, rel=2e-3)
    assert solution.joint(joint).force[-1, 1] == pytest.approx(10.0)
    assert solution.joint(joint).gap.max() < 1e-14
    left, right = (solution.reaction(node)[-1, 1] for node in (beam.start, beam.end))
    assert (left, right) == pytest.approx((10 * (6 - place) / 6, 10 * place / 6), rel=1e-6)


@pytest.mark.parametrize("solver", ["static", "compiled", "petsc"])
def test_a_sleeve_carries_the_moment_of_its_load(solver):
    scene = fb.Scene()
    beam = scene.add_beam(SHAPES["straight"], STIFF, elements=12)
    scene.clamp(beam.start)
    post = scene.add_beam([(2.3, 0), (2.3, 0.5)], STIFF)
    scene.add_force(post.end, (3.0, -10.0))
    joint = scene.add_joint(fb.Sleeve(beam, post.start, spring=fb.Spring(1e6, rest=2.3)))
    if solver == "static":
        solution = fb.static(scene, steps=1)
        moment, force = -3.0 * 0.5, np.array([-3.0, 10.0])
        assert solution.joint(joint).force[-1] == pytest.approx([*force, -moment], rel=1e-2)
        at_wall = solution.reaction(beam.start)[-1]
        assert at_wall == pytest.approx([-3.0, 10.0, 10.0 * 2.3 + 3.0 * 0.5], rel=1e-2)
    else:
        # Impulse and angular momentum of the post about the node, in a short time.
        solution = fb.simulate(scene, dt=1e-3, t_end=0.05, solver=solver)
        push = solution.joint(joint).force[1:].sum(axis=0) * 1e-3 + (0.05 * 3, -0.05 * 10, 0)
        ends = solution.velocity(post.start)[-1], solution.velocity(post.end)[-1]
        assert push[:2] == pytest.approx(0.5 * (ends[0] + ends[1]) / 2, abs=1e-9)
        assert abs(solution.joint(joint).force[1:, 2]).max() > 0.1


# -- Runs --------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_running_off_the_end_names_joint_and_time_and_keeps_the_steps(solver):
    scene, joint = thrown()
    with pytest.raises(fb.StepError, match=r"joint 0, Slider of node 13 .* off the end") as raised:
        fb.simulate(scene, dt=0.02, t_end=2.0, solver=solver, max_halvings=3)
    error = raised.value
    assert error.failure.kind == "off the end" and 0.7 < error.time < 0.8
    slide = error.solution.slide(joint)
    assert len(slide) > 35 and 5.7 < slide[-1] <= joint.beam.length
    assert drift(error.solution.energy.total) < 1e-11


def test_a_spring_with_a_stop_of_its_own_turns_a_node_back():
    scene, _ = thrown()

    def stop(x):
        return 5e3 * ufl.max_value(x, 0) ** 3

    scene.joints.clear()
    bead, rod = scene.beams[1], scene.beams[0]
    joint = scene.add_joint(
        fb.Slider(rod, bead.start, spring=fb.Spring(rest=5.0, strain_energy=stop))
    )
    solution = fb.simulate(scene, dt=0.005, t_end=1.0)
    slide = solution.slide(joint)
    assert 5.0 < slide.max() < 6.0 and slide[-1] < 5.0
    assert drift(solution.energy.total) < 1e-11


def test_copies_files_and_restarts_have_the_same_motion(tmp_path):
    scene, joint = thrown(fb.Sleeve, "curved", 2)
    solution = fb.simulate(scene, dt=0.01, t_end=0.4)
    other = copy.deepcopy(scene)
    assert other.joints[0].beam is other.beams[0]
    assert (fb.simulate(other, dt=0.01, t_end=0.4).q == solution.q).all()
    solution.save(tmp_path / "run.npz")
    read = fb.load(tmp_path / "run.npz")
    assert (read.slide(joint) == solution.slide(joint)).all()
    assert read.joint(joint).gap.max() < 1e-13
    half = fb.simulate(scene, dt=0.01, t_end=0.2)
    rest = fb.simulate(scene, dt=0.01, t_end=0.4, start=half)
    assert abs(rest.q[-1] - solution.q[-1]).max() < 1e-12


def test_a_scene_with_a_slider_goes_to_another_process():
    scene = wire(2, 12)[0]
    other = pickle.loads(pickle.dumps(scene))
    runs = [fb.simulate(each, dt=0.01, t_end=0.1).q for each in (scene, other)]
    assert (runs[0] == runs[1]).all()


def test_a_tolerance_chooses_steps_and_rows_between_them_lie_on_the_beam():
    scene, node, joint = wire(2, 12)
    times = np.linspace(0, 1, 31)
    solution = fb.simulate(scene, tolerance=1e-5, t_end=1.0, record=fb.Record(times=times))
    fixed = fb.simulate(scene, dt=0.001, t_end=1.0)
    assert solution.position(node)[-1] == pytest.approx(fixed.position(node)[-1], abs=2e-4)
    assert solution.joint(joint).gap.max() < 1e-7


@pytest.mark.parametrize("make", KINDS)
def test_stops_before_the_ends_turn_a_node_back(make):
    scene, _ = thrown(make)
    scene.joints.clear()
    rod, bead = scene.beams
    joint = scene.add_joint(make(rod, bead.start, stop=(0.0, 5.5, 1e4)))
    solution = fb.simulate(scene, dt=0.005, t_end=1.2)
    slide = solution.slide(joint)
    assert 5.5 < slide.max() < 5.7 and slide[-1] < 5.0
    assert drift(solution.energy.total) < 1e-11
    assert drift(solution.linear_momentum) < 1e-11
    assert drift(solution.angular_momentum) < 1e-11
    with pytest.raises(fb.SceneError, match="its slide starts at 0, beyond the lower limit 1"):
        scene.add_joint(make(rod, bead.start, stop=(1.0, 5.5, 1e4)))


def test_a_motion_measures_slide_and_rate_and_its_linear_system_has_them():
    scene, joint = thrown()
    outputs = {name: fb.Output(name, joint) for name in ("slide", "rate", "force")}
    motion = fb.Motion(scene, dt=0.01, outputs=outputs)
    for _ in range(20):
        found = motion.step()
    solution = fb.simulate(scene, dt=0.01, t_end=0.2)
    assert found["slide"] == pytest.approx(solution.slide(joint)[-1], abs=1e-11)
    assert found["rate"] == pytest.approx(solution.joint(joint).rate[-1], abs=1e-9)
    assert found["force"] == pytest.approx(solution.joint(joint).force[-1], rel=1e-8)
    outputs.pop("force")
    system = fb.linearise(scene, at=motion, outputs=outputs)
    slide, rate = np.asarray(system.C)
    assert slide @ np.asarray(system.A) == pytest.approx(rate, abs=1e-9 * abs(rate).max())
    with pytest.raises(fb.SceneError, match="measure the rotation of the node that slides"):
        fb.Motion(scene, dt=0.01, outputs={"angle": fb.Output("angle", joint)})


# -- Refusals ----------------------------------------------------------------------------------


def test_bad_sliders_are_refused_with_their_names():
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=6)
    post = scene.add_beam([(1.5, 0), (1.5, 1)], SOFT)
    away = scene.add_beam([(2, 0.25), (2, 1)], SOFT)
    other = fb.Scene().add_beam(SHAPES["straight"], SOFT)
    for raising, message in (
        (lambda: fb.Slider(rod.start, post.start), "is not a beam"),
        (lambda: fb.Slider(rod, "post"), "is not a node"),
        (lambda: fb.Sleeve(rod, rod.end), "node 6 .* belongs to beam 'beam 1'"),
        (lambda: fb.Slider(rod, fb.GROUND), "the ground cannot slide"),
        (lambda: fb.Slider(rod, post.start, fraction=1.2), "fraction = 1.2 .* from 0 to 1"),
        (lambda: fb.Slider(rod, post.start, damper=3.0), "damper = 3.0 must be"),
        (
            lambda: scene.add_joint(fb.Slider(rod, away.start)),
            r"on the axis of the beam, but 0.25 away. The nearest point of the axis is \(2, 0\)",
        ),
        (
            lambda: scene.add_joint(fb.Slider(rod, post.start, fraction=0.5)),
            "not on the axis of the beam at the fraction 0.5, but 1.5 away",
        ),
        (lambda: scene.add_joint(fb.Slider(rod, other.start)), "another scene"),
        (lambda: scene.add_joint(fb.Slider(other, post.start)), "another scene"),
        (
            lambda: scene.add_joint(fb.Slider(rod, post.start, motor=lambda t: 1 + t)),
            "the motor of its slide is 1 at t = 0",
        ),
    ):
        with pytest.raises(fb.SceneError, match=message):
            raising()
    bent = scene.add_beam([(0, 3), (3, 3), (3, 6)], SOFT, elements=6)
    top = scene.add_beam([(1, 3), (1, 4)], SOFT)
    with pytest.raises(fb.SceneError, match="the beam has corners"):
        scene.add_joint(fb.Sleeve(bent, top.start))
    scene.add_joint(fb.Slider(bent, top.start))


def over_constrained(build, message):
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=6)
    post = scene.add_beam([(1.5, 0), (1.5, 1)], SOFT)
    build(scene, rod, post)
    with pytest.raises(fb.SceneError, match=message):
        fb.simulate(scene, dt=0.01, t_end=0.01)


def test_a_node_that_is_held_twice_is_refused_before_the_run():
    def clamped(scene, rod, post):
        scene.add_joint(fb.Slider(rod, post.start))
        scene.pin(post.start)

    def twice(scene, rod, post):
        second = scene.add_beam([(0, 1), (1.5, 0), (3, -1)], SOFT, elements=2)
        scene.add_joint(fb.Slider(rod, post.start))
        scene.add_joint(fb.Slider(second, post.start))

    def jointed(scene, rod, post):
        scene.add_joint(fb.Slider(rod, post.start))
        scene.add_joint(fb.Revolute(post.start, fb.GROUND))

    over_constrained(clamped, "joint 0, Slider .*x of the node is supported")
    over_constrained(twice, "joint 0, .*joint 1, .*node 7 .* slides on two beams")
    over_constrained(jointed, "both supported")


def test_beams_that_slide_on_each_other_are_refused():
    scene = fb.Scene()
    first = scene.add_beam([(0, 0), (2, 0)], SOFT, elements=2)
    second = scene.add_beam([(1, 0), (0, 0)], SOFT, elements=2)
    scene.add_joint(fb.Slider(first, second.start))
    scene.add_joint(fb.Slider(second, first.start))
    with pytest.raises(fb.SceneError, match="slides on a beam that the other nodes carry"):
        fb.simulate(scene, dt=0.01, t_end=0.01)


def test_velocities_that_leave_the_beam_are_refused_and_so_are_other_starts():
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=6)
    post = scene.add_beam([(1.5, 0), (1.5, 1)], SOFT)
    scene.add_joint(fb.Slider(rod, post.start))
    scene.set_velocity(post, (2.0, 0.5))
    with pytest.raises(fb.SceneError, match="joint 0, Slider .* separate at 0.5 m/s"):
        fb.simulate(scene, dt=0.01, t_end=0.01)
    free = copy.deepcopy(scene)
    free.joints.clear()
    away = free.beams[1]
    free.add_joint(fb.Revolute(fb.GROUND, away.end))
    free.velocities.clear()
    free.set_velocity(free.beams[0], (0.0, 0.5))
    moved = fb.simulate(free, dt=0.01, t_end=0.1)
    scene.velocities.clear()
    with pytest.raises(fb.SceneError, match="violates joint 0, Slider .* a gap of 0.05 m"):
        fb.simulate(scene, dt=0.01, t_end=0.2, start=moved)


def test_a_bead_that_nothing_holds_is_found_before_the_run():
    scene, light = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=50.0)
    rail = scene.add_beam(SHAPES["straight"], SOFT, elements=4)
    post = scene.add_beam([(1.5, 0), (1.5, 1)], light)
    scene.add_joint(fb.Slider(rail, post.start))
    scene.fix(post.end, "rotation")
    with pytest.raises(fb.SceneError, match=r"can move along \(1, 0\)"):
        fb.simulate(scene, dt=0.01, t_end=0.01)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_point_of_a_circle_is_told_where_the_axis_of_the_elements_is(degree):
    scene = fb.Scene()
    ring = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), SOFT, elements=16, degree=degree)
    place = np.cos(1), np.sin(1)
    with pytest.raises(
        fb.SceneError, match="nearer with more elements or a higher degree"
    ) as error:
        scene.add_joint(fb.Slider(ring, scene.add_body(place, 1.0).centre))
    # What it says helps.
    numbers = re.search(r"axis is \((.*), (.*)\), at", str(error.value))
    nearest = float(numbers[1]), float(numbers[2])
    assert 1e-8 < np.hypot(*np.subtract(nearest, place)) < 1e-5
    scene.add_joint(fb.Slider(ring, scene.add_body(nearest, 1.0).centre))


def mass_on_a_string(points):
    """A mass on the lowest point of a string, which it pulls down."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e5, GA=1e5, EI=1e-3, rhoA=0.01, rhoI=1e-6)
    string = scene.add_beam(points, section, elements=20, name="string")
    scene.pin(string.start)
    scene.pin(string.end)
    scene.add_joint(fb.Slider(string, scene.add_body((1, -1), 1.0, 0.01).centre))
    return scene


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_a_step_that_fails_at_a_corner_says_so(solver):
    corner = r"at a corner of its beam, at \(1, -1\) .* Round the corner by an fx_beam.spline"
    points = [(0, 0), (1, -1), (2, 0)]
    with pytest.raises(fb.StepError, match=corner):
        fb.simulate(mass_on_a_string(points), dt=0.01, t_end=0.1, max_halvings=1, solver=solver)
    fb.simulate(mass_on_a_string(fb.spline(points)), dt=0.01, t_end=0.1, solver=solver)


def test_tolerances_for_a_single_body_are_relative_to_1_metre():
    scene = fb.Scene()
    body = scene.add_body((0, 0), 1.0, 1.0)
    motor = fb.Prismatic(fb.GROUND, body.centre, (1, 0), motor=lambda t: 1e-17 + t**2)
    assert scene.add_joint(motor).number == 0


# -- Pulleys on cables ---------------------------------------------------------------------------


def tensions_beside_a_pulley(length, elements, degree=2, stiffness=50.0, moving=False):
    """Relative difference of both tensions, where those of an ideal cable are equal.

    The cable is stretched between two heights; `length` is sqrt(EI / T). Equal tensions T make
    equal angles: 2 T sin a = W. A spring rests where the pulley then is; `moving`, the pulley
    comes to rest by a damper and drag in its place.
    """
    span, height, W, EA = 1.0, 0.3, 1.0, 5.0
    L = np.hypot(span, height)

    def wide(T):
        return L * (1 + T / EA) * np.sqrt(1 - (W / 2 / T) ** 2) - span

    T = brentq(wide, 0.501 * W, 20 * W)
    place = L / 2 - height * T / W / (1 + T / EA)
    scene = fb.Scene()
    section = fb.Section(EA=EA, GA=EA, EI=T * length**2, rhoA=0.02, rhoI=2e-6)
    cable = scene.add_beam([(0, 0), (span, height)], section, elements, degree)
    scene.pin(cable.start)
    scene.pin(cable.end)
    pulley = scene.add_body((0.3 * span, 0.3 * height), 1.0, 0.01)
    holds = {"spring": fb.Spring(stiffness, rest=place)}
    if moving:
        holds = {"damper": fb.Damper(3.0)}
        scene.add_drag(cable, linear=(1.0, 1.0))
    scene.add_joint(fb.Slider(cable, pulley.centre, **holds))
    scene.fix(pulley.centre, "rotation")
    scene.add_force(pulley.centre, (0.0, -W))
    if moving:
        solution = fb.simulate(scene, fb.EnergyDecaying(), dt=0.02, t_end=20.0)
        assert abs(solution.v[-1]).max() < 0.05
    else:
        solution = fb.static(scene, steps=5)
    left, right = (np.hypot(*solution.reaction(end)[-1, :2]) for end in (cable.start, cable.end))
    return abs(left - right) / T


def test_a_pulley_on_a_cable_comes_to_equal_tensions_as_bending_and_elements_shrink():
    found = [tensions_beside_a_pulley(0.08 / k, 20 * k) for k in (1, 2, 4)]
    assert found[0] < 0.04
    assert np.log2(found[0] / np.array(found[1:])) == pytest.approx([1, 2], abs=0.25)


def test_elements_longer_than_the_bend_under_a_pulley_hold_it_as_friction_would():
    coarse = max(tensions_beside_a_pulley(0.005, n) for n in (8, 9, 10))
    fine = max(tensions_beside_a_pulley(0.005, n) for n in (64, 65))
    assert coarse > 4 * fine


def test_load_steps_that_lose_a_pulley_name_the_length_of_elements_and_a_simulation():
    with pytest.raises(fb.StepError, match="simulation with dampers.*sqrt.EI / N.*friction"):
        tensions_beside_a_pulley(0.05, 32, degree=1, stiffness=0.2)


def test_a_simulation_finds_where_a_free_pulley_comes_to_rest_on_a_slack_cable():
    with pytest.raises(fb.StepError, match="simulation with dampers"):
        tensions_beside_a_pulley(0.02, 32, stiffness=0.05)
    assert tensions_beside_a_pulley(0.02, 32, moving=True) < 0.02


@pytest.mark.parametrize("joint", [fb.Slider, fb.Sleeve])
def test_the_first_acceleration_of_a_node_that_slides_over_a_node_is_that_of_the_motion(joint):
    """There the third derivative of the curve of the beam jumps."""
    section = fb.Section(EA=1e3, GA=1e3, EI=5.0, rhoA=1.0, rhoI=0.01)
    scene = fb.Scene(gravity=(0, -9.81))
    rod = scene.add_beam([(0, 0), (3, 0.2)], section, elements=6)
    scene.pin(rod.start)
    x, y = rod.nodes[2].x, rod.nodes[2].y
    post = scene.add_beam([(x, y), (x + 0.1, y + 0.3)], section)
    scene.add_mass(post.end, 0.5, inertia=0.01)
    scene.add_joint(joint(rod, post.start))
    scene.set_velocity(rod, lambda x, y: (0.3 * y - 0.8, -0.3 * x - 0.9), spin=-0.3)
    scene.set_velocity(post, lambda x, y: (0.3 * y + 1.2, -0.3 * x - 0.9), spin=-0.3)
    scene.make_velocities_compatible()
    dt = 1e-5
    run = fb.simulate(scene, dt=dt, t_end=4 * dt)
    mean = np.diff(run.v, axis=0) / dt
    at_start = (25 * mean[0] - 23 * mean[1] + 13 * mean[2] - 3 * mean[3]) / 12
    assert abs(run.a[0] - at_start).max() < 1e-5 * abs(run.a[0]).max()
