"""Nodes that slide on flexible beams: invariants, references, refusals."""

import re

import ufl

import numpy as np
import pytest
import scipy.integrate
from jointed import drift, four_bar
from plain_step import assert_balanced
from scenes import assert_refused, clamped_bar, lattice, one_bar, pinned_bar, supported_bar
from scipy.optimize import brentq

import fx_beam as fb

SOFT = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
LIGHT = fb.Section(EA=1e4, GA=1e4, EI=50.0)
STIFF = fb.Section(EA=1e7, GA=1e7, EI=1e5, rhoA=1.0, rhoI=0.01)
SHAPES = {"straight": [(0, 0), (6, 0)], "curved": fb.arc((0, 0), (3, 0.8), (6, 0))}


def bead_on(scene, beam, node, make=fb.Slider, mass=0.8, section=SOFT, **options):
    """A short beam with a lumped mass, which slides on a beam from one of its nodes on."""
    place = np.array([node.x, node.y])
    bead = scene.add_beam(
        [place, place + (0, 0.3)], section, degree=beam.degree, name="bead", elements=1
    )
    scene.add_mass(bead.start, mass, inertia=0.05)
    return bead.start, scene.add_joint(make(beam, bead.start, **options))


def thrown(make=fb.Slider, shape="straight", degree=1, speed=8.0, **options):
    """A free beam of 12 elements that rotates, and a bead that runs along it."""
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES[shape], SOFT, elements=12, degree=degree, name="rod")
    node, joint = bead_on(scene, rod, rod.start, make, **options)
    scene.set_velocity(rod, lambda x, y: (0.2 - 0.3 * y, 0.5 + 0.3 * (x - 3)), spin=0.3)
    scene.set_velocity(scene.beams[1], (speed, 1.0), spin=1.0)
    scene.make_velocities_compatible()
    return scene, joint


# -- Energy and momenta ------------------------------------------------------------------------


def assert_kept(solution):
    """Energy and both momenta."""
    for invariant in (solution.energy.total, solution.linear_momentum, solution.angular_momentum):
        assert drift(invariant) < 1e-11


@pytest.mark.parametrize(
    ("make", "degree", "shape"), [(fb.Slider, 1, "straight"), (fb.Sleeve, 2, "curved")]
)
def test_energy_and_momenta_are_kept_while_a_bead_crosses_ten_elements(make, degree, shape):
    scene, joint = thrown(make, shape, degree)
    solution = fb.simulate(scene, dt=0.01, t_end=0.75)
    assert solution.stats.solver.startswith("compiled")
    crossed = np.searchsorted(joint.beam.s, solution.joint(joint).slide[-1])
    assert crossed > 10 and solution.stats.halvings == 0
    assert_kept(solution)
    assert solution.joint(joint).gap.max() < 1e-13
    turned = abs(solution.joint(joint).angle).max()
    assert turned < 1e-12 if make is fb.Sleeve else turned > 0.1
    # A small term of the tangent with the wrong sign takes half an iteration more.
    tight = fb.NewtonOptions(tolerance=1e-12)
    stats = fb.simulate(scene, dt=0.02, t_end=0.16, newton=tight).stats
    assert stats.newton_iterations <= 5.5 * stats.steps


def test_a_step_over_many_elements_is_halved_and_keeps_the_energy():
    scene, joint = thrown(speed=40.0)
    solution = fb.simulate(scene, dt=0.05, t_end=0.1)
    assert solution.stats.halvings > 0
    assert drift(solution.energy.total) < 1e-11
    with pytest.raises(fb.StepError) as raised:
        fb.simulate(scene, dt=0.05, t_end=0.1, max_halvings=0)
    assert raised.value.failure.kind == "large slide"


# -- In tangents of all kinds ----------------------------------------------------------------------


def carriage(wheels=(fb.Slider, fb.Slider), degree=1, section=SOFT):
    """A simply supported beam, on which a carriage of two wheels runs."""
    scene, beam = supported_bar(
        (6, 0), section, elements=24 // degree, degree=degree, gravity=(0, -9.81)
    )
    axle = scene.add_beam([(0.5, 0), (1.1, 0)], section, degree=degree, elements=1)
    for node, make in zip((axle.start, axle.end), wheels, strict=True):
        scene.add_mass(node, 0.4, inertia=0.05)
        scene.add_joint(make(beam, node))
    scene.set_velocity(axle, (3.0, 0.0))
    return scene


def massless_rod():
    """A massless rod that is held along its axis, and else by two nodes that slide on it."""
    scene = carriage((fb.Sleeve, fb.Slider), section=LIGHT)
    scene.fixed.clear()
    scene.fix(scene.beams[0].start, "x")
    return scene


def on_a_lattice():
    scene = lattice()
    bead_on(scene, scene.beams[0], scene.beams[0].nodes[1])
    return scene


def on_a_mechanism():
    """On a beam that is carried by a four-bar of bodies."""
    scene, bars, _ = four_bar()
    beam = scene.add_beam([bars[1].centre, (4, 1.1)], SOFT, elements=10)
    bead_on(scene, beam, beam.nodes[5])
    return scene


MADE = {
    "chain": carriage,
    "sleeves in a band": lambda: carriage((fb.Sleeve, fb.Slider), degree=2),
    "massless rod": massless_rod,
    "sparse": on_a_lattice,
    "loop": on_a_mechanism,
}


@pytest.mark.parametrize(
    ("made", "scheme"), [*((made, fb.EnergyMomentum()) for made in MADE), ("chain", fb.HHT(-0.2))]
)
def test_what_slides_is_in_balance(made, scheme):
    run = {"scheme": scheme, "dt": 0.01, "t_end": 0.2}
    assert_balanced(MADE[made](), **run)
    solution = fb.simulate(MADE[made](), **run)
    *_, storage = made.split()
    assert storage not in ("chain", "band", "sparse") or storage in solution.stats.solver
    assert solution.stats.newton_iterations <= 4.5 * solution.stats.steps
    if scheme.name == "EnergyMomentum":
        assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.kinetic.max()


def test_a_rigid_carriage_on_two_wheels_closes_a_loop_and_keeps_energy_and_momenta():
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=12)
    points = {"left": (3, 0), "right": (3.6, 0)}
    body = scene.add_body((3.3, 0.2), 1.0, 0.1, points=points)
    wheels = [scene.add_joint(fb.Slider(rod, body[name])) for name in points]
    scene.set_velocity(body, (2.0, 0.0))
    scene.set_velocity(rod, lambda x, y: (0.0, 0.3 * (x - 3)), spin=0.3)
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.01, t_end=0.3)
    assert_kept(solution)
    assert max(solution.joint(wheel).gap.max() for wheel in wheels) < 1e-12
    rear, front = (solution.joint(wheel).slide for wheel in wheels)
    assert rear[-1] > 3.3 and np.ptp(front - rear) > 1e-6


# -- References --------------------------------------------------------------------------------


def wire(degree, elements, at=0.75, **options):
    """A bead of 2 kg on a clamped half circle of radius 1 m, in gravity."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam(fb.arc((-1, 0), (0, -1), (1, 0)), STIFF, elements, degree)
    for node in beam.nodes:
        scene.clamp(node)
    light = fb.Section(EA=1e5, GA=1e5, EI=1e3)
    node, joint = bead_on(scene, beam, beam.node(at), fb.Slider, 2.0, light, **options)
    scene.fix(scene.beams[1].end, "rotation")
    return scene, node, joint


@pytest.mark.parametrize("degree, error", [(1, 1e-3), (2, 2e-5)])
def test_a_bead_on_a_circular_wire_swings_as_a_pendulum(degree, error):
    scene, node, joint = wire(degree, 24)
    solution = fb.simulate(scene, dt=0.001, t_end=1.2)
    x, y = solution.position(node).T
    start = np.arctan2(x[0], -y[0])

    def pendulum(t, state):
        return state[1], -9.81 * np.sin(state[0])

    exact = scipy.integrate.solve_ivp(
        pendulum, (0, 1.2), (start, 0), t_eval=solution.t, rtol=1e-11, atol=1e-12
    )
    computed = np.arctan2(x, -y)
    assert np.ptp(computed) > 1.5 and abs(computed - exact.y[0]).max() < error
    # The joint's force on the bead is m (a - g).
    mean = np.diff(solution.velocity(node), axis=0) / 0.001 + (0, 9.81)
    assert solution.joint(joint).force[1:, :2] == pytest.approx(2.0 * mean, abs=1e-7)


def test_a_bead_at_rest_on_a_wire_vibrates_as_a_pendulum():
    held = wire(2, 24, at=0.5)[0]
    held.fix(held.beams[1].end, "x")
    at_rest = fb.static(held, load_steps=1)
    lowest = fb.modes(wire(2, 24, at=0.5)[0], at_rest, n=1).angular_frequencies[0]
    assert lowest == pytest.approx(np.sqrt(9.81), rel=5e-3)


def flexible_arm(EI, motor=None):
    """An arm that turns about its start, and a body of 1 kg that slides outwards on it."""
    scene, rate = fb.Scene(), 2.0
    section = fb.Section(EA=1e6, GA=1e6, EI=EI, rhoA=1e-3, rhoI=1e-3 * 1e-3)
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
    slide, motion = solution.joint(joint).slide, solution.joint(joint)
    assert slide == pytest.approx(0.4 * np.cosh(rate * solution.t), rel=2e-3)
    along = np.diff(slide) / np.diff(solution.t)
    assert (motion.rate[1:] + motion.rate[:-1]) / 2 == pytest.approx(along, abs=1e-4)
    x, y = solution.position(body.centre).T
    c, s = np.cos(rate * solution.t), np.sin(rate * solution.t)
    bent = (c * y - s * x)[-300:]
    force = (2 * rate * motion.rate)[-300:]  # on 1 kg, across the arm
    assert bent == pytest.approx(-force * slide[-300:] ** 3 / (3 * EI), rel=0.02)
    turned = solution.rotation(body.centre)[-300:] - rate * solution.t[-300:]
    assert turned == pytest.approx(-force * slide[-300:] ** 2 / (2 * EI), rel=0.02)


def test_a_weight_between_two_nodes_bends_a_beam_as_the_formula_says():
    scene, section, place = fb.Scene(), fb.Section(EA=1e9, GA=1e9, EI=1e5), 2.3
    beam = scene.add_beam(SHAPES["straight"], section, elements=24)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    post = scene.add_beam([(place, 0), (place, 0.3)], section, elements=1)
    scene.add_force(post.start, (0.0, -10.0))
    scene.fix(post.end, "x", "rotation")
    joint = scene.add_joint(fb.Slider(beam, post.start))
    solution = fb.static(scene, load_steps=2)
    exact = -10.0 * place**2 * (6 - place) ** 2 / (3 * 1e5 * 6)
    assert solution.displacement(post.start)[-1, 1] == pytest.approx(exact, rel=2e-3)
    assert solution.joint(joint).force[-1, 1] == pytest.approx(10.0)
    assert solution.joint(joint).gap.max() < 1e-14
    left, right = (solution.reaction(node)[-1, 1] for node in (beam.start, beam.end))
    assert (left, right) == pytest.approx((10 * (6 - place) / 6, 10 * place / 6), rel=1e-6)


def shears(x):
    """Two bars with a hinge on top, pressed by x[0]; their feet slide on a rod, by springs x[1]."""
    rigid = fb.Section(EA=1e9, GA=1e9, EI=1e9)
    scene, rod = clamped_bar((2, 0), rigid, elements=8)
    scene.clamp(rod.end)
    feet = [scene.add_body((place, 0.0), 1.0, points={"hinge": (1.0, 0.8)}) for place in (0.4, 1.6)]
    scene.add_joint(fb.Revolute(*(foot["hinge"] for foot in feet)))
    for foot, rest in zip(feet, (0.4, 1.6), strict=True):
        joint = scene.add_joint(fb.Slider(rod, foot.centre, spring=fb.Spring(x[1], rest=rest)))
    scene.add_force(feet[0]["hinge"], (0.0, -x[0]))
    return scene, {"slide": fb.Output("slide", joint)}


def carried(x):
    """A body on two feet that slide along a rod, pulled by x[0], with a spring x[1] on one foot."""
    rigid = fb.Section(EA=1e9, GA=1e9, EI=1e9)
    scene, rod = clamped_bar((2, 0), rigid, elements=8)
    body = scene.add_body((0.8, 0.1), 1.0, points={"back": (0.75, 0.0), "front": (1.05, 0.0)})
    scene.add_joint(fb.Slider(rod, body["back"], spring=fb.Spring(x[1], rest=0.75)))
    joint = scene.add_joint(fb.Slider(rod, body["front"]))
    scene.add_force(body.centre, (x[0], -20.0))
    return scene, {"slide": fb.Output("slide", joint)}


def spread(load, spring):
    """Arc length of the second foot of shears: half the load times d / h is the springs' force."""

    def unbalanced(d):
        return spring * (d - 0.6) - load / 2 * d / np.sqrt(1.0 - d**2)

    return 1.0 + brentq(unbalanced, 0.6, 0.9)


@pytest.mark.parametrize(
    ("build", "x", "place"),
    [(shears, (20.0, 200.0), spread), (carried, (5.0, 50.0), lambda F, k: 1.05 + F / k)],
)
def test_loops_through_slides_have_equilibria_though_no_inertia_holds_their_bodies(build, x, place):
    """With derivatives, forwards and backwards."""
    run = fb.StaticResponse(build, load_steps=20)
    _, y = run(x)
    assert y["slide"][-1] == pytest.approx(place(*x), abs=1e-6)
    h = 1e-4 * np.diag(x)
    slopes = [(place(*(x + dx)) - place(*(x - dx))) / (2 * dx.sum()) for dx in h]
    assert run.jacobian()["slide"][-1] == pytest.approx(slopes, rel=1e-5)
    weights = np.zeros_like(y["slide"])
    weights[-1] = 1.0
    assert run.vjp({"slide": weights}) == pytest.approx(slopes, rel=1e-5)


# -- Runs --------------------------------------------------------------------------------------


def test_running_off_the_end_names_joint_and_time_and_keeps_the_steps():
    scene, joint = thrown()
    with pytest.raises(fb.StepError, match=r"joint 0, Slider of node 13 .* off the end") as raised:
        fb.simulate(scene, dt=0.02, t_end=2.0, max_halvings=3)
    error = raised.value
    assert error.failure.kind == "off the end" and 0.7 < error.time < 0.8
    slide = error.solution.joint(joint).slide
    assert len(slide) > 35 and 5.7 < slide[-1] <= joint.beam.length
    assert drift(error.solution.energy.total) < 1e-11


def test_a_tolerance_chooses_steps_and_rows_between_them_lie_on_the_beam():
    scene, node, joint = wire(2, 12)
    times = np.linspace(0, 1, 31)
    solution = fb.simulate(scene, tolerance=1e-5, t_end=1.0, record=fb.Record(times=times))
    fixed = fb.simulate(scene, dt=0.002, t_end=1.0)
    assert solution.position(node)[-1] == pytest.approx(fixed.position(node)[-1], abs=2e-4)
    assert solution.joint(joint).gap.max() < 1e-7


def own_stop(x):
    return 5e3 * ufl.max_value(x, 0) ** 3


@pytest.mark.parametrize(
    ("make", "options", "limit"),
    [
        (fb.Sleeve, {"stop": (0.0, 5.5, 1e4)}, 5.5),
        (fb.Slider, {"spring": fb.Spring(rest=5.0, strain_energy=own_stop)}, 5.0),
    ],
    ids=["stop", "spring"],
)
def test_stops_before_the_ends_turn_a_node_back(make, options, limit):
    scene, joint = thrown(make, **options)
    solution = fb.simulate(scene, dt=0.005, t_end=1.2)
    slide = solution.joint(joint).slide
    assert limit < slide.max() < 6.0 and slide[-1] < 5.0
    assert_kept(solution)


def test_a_motion_measures_slide_and_rate_and_its_linear_system_has_them():
    scene, joint = thrown()
    outputs = {name: fb.Output(name, joint) for name in ("slide", "rate", "force")}
    motion = fb.Motion(scene, dt=0.01, outputs=outputs)
    motion.run(0.2)
    record = fb.simulate(scene, dt=0.01, t_end=0.2).joint(joint)
    for name, value in motion.outputs.items():
        assert value == pytest.approx(getattr(record, name)[-1], rel=1e-8, abs=1e-9)
    outputs.pop("force")
    system = fb.linearise(scene, state=motion, outputs=outputs)
    slide, rate = np.asarray(system.C)
    assert slide @ np.asarray(system.A) == pytest.approx(rate, abs=1e-9 * abs(rate).max())
    with pytest.raises(fb.SceneError, match="measure the rotation of the node that slides"):
        fb.Motion(scene, dt=0.01, outputs={"angle": fb.Output("angle", joint)})


# -- Guides ------------------------------------------------------------------------------------


def on_the_ground(scene, rod, make):
    return scene.add_joint(make(rod, fb.GROUND, fraction=0.2))


def on_a_clamped_node(scene, rod, make):
    guide = scene.add_body((1.2, 0), 0.0).centre
    scene.clamp(guide)
    return scene.add_joint(make(rod, guide))


def on_a_clamped_body(scene, rod, make):
    block = scene.add_body((1.2, -0.3), 2.0, 0.1, points={"hole": (1.2, 0)})
    scene.clamp(block.centre)
    return scene.add_joint(make(rod, block["hole"]))


def on_a_welded_node(scene, rod, make):
    joint = scene.add_joint(make(rod, scene.add_body((1.2, 0), 0.0).centre))
    scene.add_joint(fb.Rigid(fb.GROUND, joint.b))
    return joint


GUIDES = on_the_ground, on_a_clamped_node, on_a_clamped_body, on_a_welded_node


def falling_rod():
    scene = fb.Scene(gravity=(0, -9.81))
    return scene, scene.add_beam(SHAPES["straight"], SOFT, elements=8)


@pytest.mark.parametrize("make", [fb.Slider, fb.Sleeve])
def test_a_fixed_guide_is_the_same_however_it_is_held_and_its_force_moves_the_rod(make):
    ends = []
    for hold in GUIDES:
        scene, rod = falling_rod()
        joint = hold(scene, rod, make)
        solution = fb.simulate(scene, dt=0.01, t_end=0.4)
        assert abs(solution.energy.balance_error).max() < 1e-12
        assert solution.joint(joint).gap.max() < 1e-13
        assert abs(solution.displacement(joint.b)).max() < 1e-13
        momentum = np.diff(solution.linear_momentum, axis=0) / 0.01
        weight = np.array([0.0, -9.81 * 6.0 * SOFT.rhoA])
        assert abs(momentum + solution.joint(joint).force[1:, :2] - weight).max() < 1e-9
        ends.append([*solution.position(rod.end)[-1], solution.joint(joint).slide[-1]])
    assert abs(np.array(ends) - ends[0]).max() < 1e-10


@pytest.mark.parametrize("make", [fb.Slider, fb.Sleeve])
def test_a_driven_guide_carries_the_rod_and_its_work_is_in_the_balance(make):
    scene, rod = falling_rod()
    guide = scene.add_body((1.2, 0), 0.0).centre
    motion = (lambda t: 0.3 * t**2), (lambda t: 0.5 * t**2), (lambda t: -(t**2))
    scene.prescribe(guide, *motion)
    joint = scene.add_joint(make(rod, guide))
    solution = fb.simulate(scene, dt=0.01, t_end=0.4)
    assert abs(solution.energy.balance_error).max() < 1e-11
    driven = [[f(t) for f in motion] for t in solution.t]
    assert solution.displacement(joint.b) == pytest.approx(np.array(driven)[:, :2], abs=1e-13)
    if make is fb.Sleeve:
        assert solution.rotation(joint.b) == pytest.approx(np.array(driven)[:, 2], abs=1e-13)


def sprung_rod(*far):
    """A rod in a sleeve on the ground, whose spring is stretched; a body may be far away."""
    scene = fb.Scene(gravity=(0.5, -9.81))
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    rod = scene.add_beam([(0, 0), (1, 0.3)], section, elements=4)
    scene.add_joint(fb.Sleeve(rod, fb.GROUND, fraction=0.6, spring=fb.Spring(20.0, rest=0.4)))
    tip = scene.add_body((1, 0.3), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Rigid(rod.end, tip.centre))
    if far:
        scene.clamp(scene.add_body(far, mass=1.0, inertia=0.1).centre)
    return scene, rod


def test_what_is_far_away_changes_nothing():
    """Of a bent rod the slide moves its rotation little: it must not follow that."""
    scene, rod = sprung_rod()
    motion, rest = fb.simulate(scene, dt=0.01, t_end=0.2), fb.static(scene, load_steps=3)
    scene, rod = sprung_rod(0, 1000)
    moved = fb.simulate(scene, dt=0.01, t_end=0.2)
    assert moved.stats.newton_iterations == motion.stats.newton_iterations
    assert moved.position(rod.end) == pytest.approx(motion.position(rod.end), abs=1e-9)
    found = fb.static(scene, load_steps=3).position(rod.end)
    assert found == pytest.approx(rest.position(rod.end), abs=1e-9)


def test_a_path_with_a_loop_and_a_stretched_spring_may_end_early():
    """What still holds its start is among the loads of its last row, from which others begin."""
    scene, rod = sprung_rod()
    path = fb.static(scene, load_steps=3, continuation="arc-length", max_steps=1)
    assert 0.1 < path.load_factor[-1] < 0.9
    rest = fb.static(scene, start=path).position(rod.end)
    assert rest[0] == pytest.approx(path.position(rod.end)[-1], abs=1e-12)
    assert rest[-1] == pytest.approx(fb.static(scene).position(rod.end)[-1], abs=1e-9)


def test_a_guide_that_rolls_or_turns_on_a_pin_is_held_where_it_cannot_move():
    for hold, free in ((("y",), "x"), (("x", "y"), "rotation")):
        scene, rod = falling_rod()
        guide = scene.add_body((1.2, 0), 1.0, 0.1).centre
        scene.fix(guide, *hold)
        joint = scene.add_joint(fb.Sleeve(rod, guide))
        solution = fb.simulate(scene, dt=0.01, t_end=0.4)
        moved = np.column_stack([solution.displacement(joint.b), solution.rotation(joint.b)])
        still = [i for i, name in enumerate(("x", "y", "rotation")) if name in hold]
        assert abs(moved[:, still]).max() < 1e-13
        assert abs(moved[-1, ("x", "y", "rotation").index(free)]) > 1e-3
        assert abs(solution.energy.balance_error).max() < 1e-11


@pytest.mark.parametrize("degree, error", [(1, 0.015), (2, 2e-3), (3, 2e-3)])
def test_a_sleeve_pushes_a_bent_rod_out_by_its_energy_per_length(degree, error):
    """M^2 / 2EI (Bigoni et al. 2015), and V^2 / 2GA: as the mean over places in an element."""
    elements, load, pushes, wanted = 8, 3.0, [], []
    scene, section = fb.Scene(), fb.Section(EA=1e5, GA=1e5, EI=1.0, rhoA=1.0, rhoI=1e-3)
    rod = scene.add_beam([(0, 0), (1, 0)], section, elements, degree)
    joint = scene.add_joint(fb.Sleeve(rod, fb.GROUND, fraction=0.5, motor=lambda t: t))
    scene.add_force(rod.end, (0.0, load))
    for t in (np.arange(8) + 0.5) / 8 / elements:
        there = fb.static(scene, load_steps=3, t=t).joint(joint)
        pushes.append(there.motor_force[-1])
        wanted.append(there.force[-1, 2] ** 2 / 2 + load**2 / 2e5)
    assert np.mean(pushes) == pytest.approx(np.mean(wanted), rel=error)


# -- Refusals ----------------------------------------------------------------------------------


def crossed():
    """A rod, a post on it, a post beside it, and a beam on the post's start."""
    scene = fb.Scene()
    rod = scene.add_beam(SHAPES["straight"], SOFT, elements=8)
    post = scene.add_beam([(1.5, 0), (1.5, 1)], LIGHT, elements=1)
    away = scene.add_beam([(2, 0.25), (2, 1)], SOFT, elements=1)
    across = scene.add_beam([(0, 1), (1.5, 0), (3, -1)], SOFT, elements=2)
    return scene, rod, post, away, across


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda rod, *_: fb.Sleeve(rod, rod.end), "node 8 .* belongs to beam 'beam 1'"),
        (lambda rod, *_: fb.Slider(rod, fb.GROUND), "ground needs its place .* fraction"),
        (
            lambda rod, post, away, _: fb.Slider(rod, away.start),
            r"on the axis of the beam, but 0.25 away. The nearest point of the axis is \(2, 0\)",
        ),
        (lambda rod, post, *_: fb.Slider(rod, post.start, fraction=0.5), "0.5, but 1.5 away"),
        (
            lambda rod, post, *_: fb.Slider(rod, post.start, stop=(2, 5.5, 1e4)),
            "its slide starts at 1.5, beyond the lower limit 2",
        ),
    ],
)
def test_bad_sliders_are_refused_with_their_names(make, message):
    scene, *beams = crossed()
    assert_refused(message, lambda: scene.add_joint(make(*beams)))


def test_a_sleeve_on_the_ground_that_is_refused_leaves_nothing_in_the_scene():
    """A node that it left would be free to move."""
    scene, bent = clamped_bar([(0, 0), (1, 0), (2, 1)], LIGHT, elements=[2, 2], load=(0.0, -1.0))
    before = fb.static(scene).q[-1]
    assert_refused("corners", lambda: scene.add_joint(fb.Sleeve(bent, fb.GROUND, fraction=0.5)))
    assert len(scene.nodes) == len(before)
    assert np.array_equal(fb.static(scene).q[-1], before)


def held_everywhere(scene, rod, *_):
    for node in rod.nodes:
        scene.clamp(node)
    scene.add_joint(fb.Sleeve(rod, fb.GROUND, fraction=0.5))


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (
            lambda scene, rod, post, _: scene.pin(post.start),
            "x of the node is supported.* before this joint",
        ),
        (
            lambda scene, rod, post, across: scene.add_joint(fb.Slider(across, post.start)),
            "joint 0, .*joint 1, .*node 9 .* slides on two beams",
        ),
        (held_everywhere, "joint 1, Sleeve .*; joint 2, Rigid .*: they close loops, and 2 of"),
        (
            lambda scene, rod, post, _: scene.add_joint(fb.Slider(post, rod.node(0.25))),
            "^joint 0, .* slides on a beam that the other nodes carry, as in a telescope",
        ),
        (lambda scene, rod, post, _: scene.fix(post.end, "rotation"), r"can move along \(1, 0\)"),
    ],
)
def test_nodes_that_are_held_twice_or_not_at_all_are_refused_before_the_run(add, message):
    scene, rod, post, _, across = crossed()
    scene.add_joint(fb.Slider(rod, post.start))
    add(scene, rod, post, across)
    assert_refused(message, fb.simulate, scene, dt=0.01, t_end=0.01)


def test_velocities_that_leave_the_beam_are_refused():
    scene, rod, post, *_ = crossed()
    scene.add_joint(fb.Slider(rod, post.start))
    scene.add_mass(post.end, 1.0, 0.1)
    scene.set_velocity(post, (2.0, 0.5))
    with pytest.raises(fb.SceneError, match="joint 0, Slider .* separate at 0.5 m/s"):
        fb.simulate(scene, dt=0.01, t_end=0.01)


@pytest.mark.parametrize("degree", [1, 3])
def test_a_point_of_a_circle_is_told_where_the_axis_of_the_elements_is(degree):
    scene, ring = one_bar(fb.arc((1, 0), (0, 1), (-1, 0)), SOFT, elements=16, degree=degree)
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
    section = fb.Section(EA=1e5, GA=1e5, EI=1e-3, rhoA=0.01, rhoI=1e-6)
    scene, string = pinned_bar(points, section, elements=20, name="string", gravity=(0, -9.81))
    scene.pin(string.end)
    scene.add_joint(fb.Slider(string, scene.add_body((1, -1), 1.0, 0.01).centre))
    return scene


def test_a_step_that_fails_at_a_corner_says_so():
    corner = r"at a corner of its beam, at \(1, -1\) .* Round the corner by an fx_beam.spline"
    points = [(0, 0), (1, -1), (2, 0)]
    with pytest.raises(fb.StepError, match=corner):
        fb.simulate(mass_on_a_string(points), dt=0.01, t_end=0.1, max_halvings=1)
    fb.simulate(mass_on_a_string(fb.spline(points)), dt=0.01, t_end=0.1)


# -- Pulleys on cables ---------------------------------------------------------------------------


def tensions_beside_a_pulley(length, elements, stiffness=50.0, moving=False):
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
    section = fb.Section(EA=EA, GA=EA, EI=T * length**2, rhoA=0.02, rhoI=2e-6)
    scene, cable = supported_bar((span, height), section, elements, 2, held="xy")
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
        solution = fb.static(scene, load_steps=5)
    left, right = (np.hypot(*solution.reaction(end)[-1, :2]) for end in (cable.start, cable.end))
    return abs(left - right) / T


def test_a_pulley_on_a_cable_comes_to_equal_tensions_as_bending_and_elements_shrink():
    tensions = [tensions_beside_a_pulley(0.08 / k, 20 * k) for k in (1, 2, 4)]
    assert tensions[0] < 0.04
    assert np.log2(tensions[0] / np.array(tensions[1:])) == pytest.approx([1, 2], abs=0.25)


def test_elements_longer_than_the_bend_under_a_pulley_hold_it_as_friction_would():
    coarse = max(tensions_beside_a_pulley(0.005, n) for n in (8, 9, 10))
    fine = max(tensions_beside_a_pulley(0.005, n) for n in (64, 65))
    assert coarse > 4 * fine


def test_a_simulation_finds_where_a_free_pulley_comes_to_rest_on_a_slack_cable():
    with pytest.raises(fb.StepError, match="simulation with dampers"):
        tensions_beside_a_pulley(0.02, 32, stiffness=0.05)
    assert tensions_beside_a_pulley(0.02, 32, moving=True) < 0.02


@pytest.mark.parametrize("joint", [fb.Slider, fb.Sleeve])
def test_the_first_acceleration_of_a_node_that_slides_over_a_node_is_that_of_the_motion(joint):
    """There the third derivative of the curve of the beam jumps."""
    section = fb.Section(EA=1e3, GA=1e3, EI=5.0, rhoA=1.0, rhoI=0.01)
    scene, rod = pinned_bar((3, 0.2), section, elements=6, gravity=(0, -9.81))
    x, y = rod.nodes[2].x, rod.nodes[2].y
    post = scene.add_beam([(x, y), (x + 0.1, y + 0.3)], section, elements=1)
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


def guided(load=(0.0, -20.0)):
    """A clamped rod through a guide on the ground, which closes a loop."""
    section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=1e-2)
    scene, rod = one_bar((1, 0.2), section, elements=4, gravity=(0.0, -9.81), load=load)
    guide = scene.add_joint(fb.Slider(rod, fb.GROUND, fraction=0.6))
    return scene, rod, guide


def test_reactions_beside_a_guide_balance_the_loads():
    scene, rod, guide = guided()
    scene.clamp(rod.start)
    state = fb.static(scene, load_steps=4)
    total = state.reaction(rod.start)[-1, :2] - state.joint(guide).force[-1, :2]
    weight = 9.81 * rod.length
    assert total == pytest.approx([0.0, 20.0 + weight], abs=1e-8)
    motion = fb.simulate(scene, dt=1e-3, t_end=0.05)
    pulled = motion.reaction(rod.start)[1:, :2] - motion.joint(guide).force[1:, :2]
    change = np.diff(motion.linear_momentum, axis=0) / 1e-3
    assert pulled - change == pytest.approx(np.tile([0.0, 20.0 + weight], (50, 1)), abs=1e-7)


def test_a_motor_beside_a_guide_does_the_work_of_its_moment():
    scene, rod, guide = guided(load=(0.0, 0.0))
    turn = scene.add_joint(fb.Revolute(fb.GROUND, rod.start, motor=lambda t: 0.5 * t**2))
    motion = fb.simulate(scene, dt=1e-3, t_end=0.1)
    motor = motion.joint(turn)
    assert motor.motor_force[1:] == pytest.approx(motor.force[1:, 2], rel=1e-9)
    assert motion.energy.work[-1] > 1e-4
    assert abs(motion.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("kind", ["slider", "sleeve", "prismatic"])
def test_a_massless_body_on_a_slide_has_the_rates_of_a_light_one(kind):
    def end(mass):
        section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=0.5, rhoI=1e-3)
        scene, rod = clamped_bar((1, 0), section, elements=4, load=(0, -1.0))
        body = scene.add_body((0.5, 0), mass=mass).centre
        slide = {"spring": fb.Spring(10.0, rest=0.5)}
        if kind == "prismatic":
            scene.add_joint(fb.Prismatic(rod.node(0.5), body, axis=(1, 0), **slide))
        else:
            make = fb.Slider if kind == "slider" else fb.Sleeve
            scene.add_joint(make(rod, body, **slide))
            scene.add_drag(body, rotation=0.1)
        solution = fb.simulate(scene, dt=0.01, t_end=0.1)
        rows = solution.velocity(rod.end), solution.reaction(rod.start), solution.linear_momentum
        return np.hstack(rows)

    assert end(0.0) == pytest.approx(end(1e-12), abs=1e-6)


def test_a_slider_has_only_its_slide_to_lock_and_no_angle_in_vibrations():
    """Its node turns freely on the beam, whose slope there no single node has."""
    scene, _, guide = guided()
    scene.clamp(scene.beams[0].start)
    assert_refused("one of ..slide..", scene.lock, guide, "rotation")
    with pytest.raises(fb.SceneError, match="one of ..slide.."):
        latch = fb.Latch(guide, 0.1, "rotation")
        fb.simulate(scene, dt=0.01, t_end=0.1, changes={"latch": latch})
    load = scene.beams[0].end, (0.0, 1.0)
    assert fb.frequency_response(scene, load, guide, [1.0]).names == ("slide",)
    held = scene.lock(guide)
    motion = fb.simulate(scene, dt=0.01, t_end=0.1)
    assert motion.joint(held).slide == pytest.approx(0.6 * scene.beams[0].length, abs=1e-12)


def test_a_body_that_turns_freely_on_a_locked_slider_has_the_modes_of_one_on_a_hinge():
    def frequencies(locked):
        section = fb.Section(EA=2e4, GA=1e4, EI=30.0, rhoA=1.5, rhoI=0.02)
        scene, arch = supported_bar(fb.arc((0, 0), (0.5, 0.15), (1, 0)), section, elements=4)
        node = arch.node(0.5)
        body = scene.add_body((0.6, 0.35), 1.0, 0.03, points={"pin": (node.x, node.y)})
        if locked:
            scene.lock(scene.add_joint(fb.Slider(arch, body["pin"])))
        else:
            scene.add_joint(fb.Revolute(node, body["pin"]))
        return fb.modes(scene).angular_frequencies

    assert frequencies(locked=True) == pytest.approx(frequencies(locked=False), rel=1e-8, abs=1e-3)


@pytest.mark.parametrize("make", [fb.Slider, fb.Sleeve])
def test_a_guide_works_as_well_far_from_the_origin(make):
    """As in coordinates of a map: those that C uses are of the rod."""

    def pushed(x, y):
        scene, rod = one_bar([(x, y), (x + 2, y)], SOFT, elements=6, degree=2, gravity=(0.0, -9.81))
        scene.add_joint(make(rod, fb.GROUND, 0.5))
        scene.add_joint(fb.Prismatic(fb.GROUND, rod.start, (1, 0), motor=lambda t: 0.2 * t**2))
        return fb.simulate(scene, dt=0.01, t_end=0.3)

    near, far = pushed(0.0, 0.0), pushed(5e5, 5.4e6)
    assert far.stats.halvings == 0
    assert abs(far.q - near.q).max() < 1e-8
    assert abs(far.joint_forces - near.joint_forces).max() < 1e-4 * abs(near.joint_forces).max()
