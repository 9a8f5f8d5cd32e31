"""Gears and racks: closed forms of inertia, ratios, frequencies; Lagrange's equation by scipy."""

import copy
import pickle
import re

import numpy as np
import pytest
from scenes import assert_refused, held_body, one_body
from scipy.integrate import solve_ivp

import fx_beam as fb

G = 9.81


def wheels(*inertias, **options):
    """Wheels on the ground, side by side, and their joints."""
    scene = fb.Scene(**options)
    nodes = [scene.add_body((i, 0), 1.0, inertia).centre for i, inertia in enumerate(inertias)]
    return scene, nodes, [scene.add_joint(fb.Revolute(fb.GROUND, node)) for node in nodes]


def train(count, ratio):
    """A chain of gears."""
    scene, nodes, joints = wheels(*[0.1] * (count + 1))
    pairs = zip(joints, joints[1:], strict=False)
    return scene, nodes, joints, [scene.add_joint(fb.Gear(*pair, ratio)) for pair in pairs]


# -- Inertia and ratios --------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [-0.5, 1.0, 1e-3, 1e3])
@pytest.mark.parametrize("driven", [0, 1])
def test_an_inertia_behind_a_ratio_counts_by_its_square(ratio, driven):
    scene, nodes, joints = wheels(0.3, 0.2)
    gear = scene.add_joint(fb.Gear(*joints, ratio))
    felt = 0.3 + ratio**2 * 0.2
    acceleration = 1e-3 / max(1.0, abs(ratio))
    scene.add_moment(nodes[driven], felt * acceleration / (ratio if driven else 1.0))
    motion = fb.simulate(scene, dt=0.1, t_end=1.0)
    assert motion.spin(nodes[0]) == pytest.approx(acceleration * motion.t, rel=1e-6)
    assert motion.spin(nodes[1]) == pytest.approx(ratio * motion.spin(nodes[0]), rel=1e-6)
    # The tooth turns the second wheel, or holds it back.
    moment = 0.2 * ratio * acceleration
    moment -= felt * acceleration / ratio if driven else 0.0
    assert motion.joint(gear).force[1:] == pytest.approx(moment, rel=1e-5)


@pytest.mark.parametrize("count", [1, 30, 1000])
def test_a_chain_of_gears_has_the_sum_of_the_inertias(count):
    ratio = -1.001
    scene, nodes, _, gears = train(count, ratio)
    felt = sum(0.1 * ratio ** (2 * i) for i in range(count + 1))
    scene.add_moment(nodes[0], 0.5 * felt)
    motion = fb.simulate(scene, dt=0.01, t_end=0.1)
    assert motion.spin(nodes[0])[-1] == pytest.approx(0.05, rel=1e-6)
    assert motion.rotation(nodes[-1])[-1] == pytest.approx(
        ratio**count * motion.rotation(nodes[0])[-1], rel=1e-12
    )
    assert motion.joint(gears[-1]).force[-1] == pytest.approx(0.1 * ratio**count * 0.5, rel=1e-5)
    assert motion.stats.newton_iterations < 2 * motion.stats.steps
    # The linear system grows in proportion to the gears, and so does the time of a step.
    assert int(re.search(r"(\d+) entries", str(motion.stats))[1]) < 13 * count


def test_a_planetary_gear_turns_and_accelerates_as_willis_says():
    """Sun, planet and ring by their radii; the carrier has the joints of all wheels."""
    r_s, r_p = 0.1, 0.06
    r_r, place = r_s + 2 * r_p, r_s + r_p
    scene, arm = one_body((0, 0), 2.0, 0.05, {"planet": (place, 0), "axis": (0, 0)})
    carrier = arm.centre
    sun = scene.add_body((0, 0), 1.0, 0.02).centre
    planet = scene.add_body((place, 0), 0.5, 0.01).centre
    held = scene.add_joint(fb.Revolute(fb.GROUND, carrier))
    sun_turn = scene.add_joint(fb.Revolute(arm["axis"], sun))
    planet_turn = scene.add_joint(fb.Revolute(arm["planet"], planet))
    scene.add_joint(fb.Gear(sun_turn, planet_turn, -r_s / r_p))
    # Seen from the carrier the ring turns backwards, as the ground does.
    scene.add_joint(fb.Gear(held, planet_turn, -r_r / r_p))
    scene.add_moment(sun, 0.4)
    motion = fb.simulate(scene, dt=1e-3, t_end=0.2)
    speed, planet_turn = 1 + r_r / r_s, 1 - r_r / r_p
    felt = 0.02 * speed**2 + 0.05 + 0.5 * place**2 + 0.01 * planet_turn**2
    alpha = 0.4 * speed / felt
    assert motion.spin(carrier)[-1] == pytest.approx(alpha * 0.2, rel=1e-5)
    assert motion.rotation(sun) == pytest.approx(speed * motion.rotation(carrier), rel=1e-12)
    expected = planet_turn * motion.rotation(carrier)
    assert motion.rotation(planet) == pytest.approx(expected, rel=1e-12)


# -- Motions against an integrator of its own ------------------------------------------------------


def geared_pendulum(ratio):
    """An arm that falls; a wheel at its end rolls on one that is held, and is out of balance."""
    scene, arm = one_body((0.5, 0), 2.0, 0.1, {"O": (0, 0), "P": (1, 0)}, gravity=(0, -G))
    wheel = scene.add_body((1.2, 0.1), 0.7, 0.03, {"P": (1, 0)})
    joints = scene.add_joint(fb.Revolute(fb.GROUND, arm["O"])), fb.Revolute(arm["P"], wheel["P"])
    gear = scene.add_joint(fb.Gear(joints[0], scene.add_joint(joints[1]), ratio))
    return scene, arm, wheel, gear


def fall(ratio, times):
    """Angles of the arm by Lagrange's equation of one coordinate."""
    k, e, at_rest = 1 + ratio, np.hypot(0.2, 0.1), np.arctan2(0.1, 0.2)
    inertia = 0.1 + 2.0 * 0.25 + 0.7 * (1 + (e * k) ** 2) + 0.03 * k**2

    def rates(_, y):
        c, w = y
        turn = k * c + at_rest
        mass = inertia + 2 * 0.7 * e * k * np.cos(turn - c)
        slope = -2 * 0.7 * e * k * (k - 1) * np.sin(turn - c)
        weight = 2.0 * G * 0.5 * np.cos(c) + 0.7 * G * (np.cos(c) + e * k * np.cos(turn))
        return w, (-weight - slope * w * w / 2) / mass

    return solve_ivp(rates, (0, times[-1]), (0.0, 0.0), t_eval=times, rtol=1e-11, atol=1e-12).y[0]


@pytest.mark.parametrize("ratio", [-2.0, 1.5])
def test_a_geared_pendulum_falls_as_lagrange_says_to_second_order(ratio):
    errors = []
    for dt in (0.01, 0.005):
        scene, arm, wheel, gear = geared_pendulum(ratio)
        motion = fb.simulate(scene, dt=dt, t_end=1.0)
        exact = fall(ratio, motion.t)
        errors.append(abs(motion.rotation(arm.centre) - exact).max())
        assert motion.rotation(wheel.centre) == pytest.approx(
            (1 + ratio) * motion.rotation(arm.centre), abs=1e-12
        )
        assert abs(motion.energy.balance_error).max() < 1e-12 * 2.7 * G
    assert errors[1] < 1e-3
    assert 3.7 < errors[0] / errors[1] < 4.3


@pytest.mark.parametrize("scheme", [fb.Newmark, lambda: fb.EnergyMomentum(order=4)])
def test_other_schemes_go_to_the_same_motion(scheme):
    scene, arm, _, gear = geared_pendulum(-2.0)
    motion = fb.simulate(scene, scheme(), dt=2e-3, t_end=0.5)
    assert motion.rotation(arm.centre) == pytest.approx(fall(-2.0, motion.t), abs=1e-4)
    assert abs(motion.joint(gear).difference).max() < 1e-12


def test_a_geared_five_bar_linkage_goes_straight():
    """A loop of bodies whose cranks turn against each other, as in a Cardan straight line."""
    scene = fb.Scene(gravity=(0, -G))
    cranks = [
        scene.add_body((0.8 * s, 0.3), 1.0, 0.1, {"o": (0.5 * s, 0), "e": (1.1 * s, 0.6)})
        for s in (-1, 1)
    ]
    rods = [
        scene.add_body((0.55 * s, 0.9), 0.5, 0.05, {"e": (1.1 * s, 0.6), "t": (0, 1.6)})
        for s in (-1, 1)
    ]
    shafts = [scene.add_joint(fb.Revolute(fb.GROUND, crank["o"])) for crank in cranks]
    for crank, rod in zip(cranks, rods, strict=True):
        scene.add_joint(fb.Revolute(crank["e"], rod["e"]))
    scene.add_joint(fb.Revolute(rods[0]["t"], rods[1]["t"]))
    scene.add_joint(fb.Gear(*shafts, -1.0))
    scene.set_velocity(cranks[0]["o"])
    motion = fb.simulate(scene, dt=0.01, t_end=0.3)
    top = motion.position(rods[0]["t"])
    assert abs(top[:, 0]).max() < 1e-12
    assert top[-1, 1] < 1.3
    assert abs(motion.energy.balance_error).max() < 1e-12


def test_full_turns_count_over_thousands_of_steps(tmp_path):
    scene, nodes, joints = wheels(0.1, 0.1)
    gear = scene.add_joint(fb.Gear(*joints, 7.0))
    scene.set_velocity(nodes[0], spin=2.0)
    scene.set_velocity(nodes[1], spin=14.0)
    motion = fb.simulate(scene, dt=0.05, t_end=125.0)
    turned = motion.rotation(nodes[1])[-1]
    assert turned > 200 * np.pi
    assert motion.rotation(nodes[0])[-1] == pytest.approx(turned / 7, rel=1e-13)
    motion.save(tmp_path / "turns.npz")
    longer = fb.simulate(scene, dt=0.05, t_end=130.0, start=fb.load(tmp_path / "turns.npz"))
    assert abs(longer.joint(gear).difference).max() < 1e-11
    assert np.ptp(longer.energy.total) < 1e-12 * longer.energy.total[0]


# -- Racks and motors ----------------------------------------------------------------------------


def test_a_belt_drives_a_cart_with_the_mass_that_its_pulley_feels():
    """Also if the axle is on the cart: a wheel on a rail."""
    for cart_joint in (False, True):
        scene, cart = one_body((0, 0), 4.0, 0.1, {"axle": (0.2, 0)}, gravity=(0, -G))
        wheel = scene.add_body((0.2, 0), 0.5, 0.02).centre
        rail = scene.add_joint(fb.Prismatic(fb.GROUND, cart.centre, axis=(3, 4)))
        axle = fb.Revolute(cart["axle"] if cart_joint else fb.GROUND, wheel)
        rack = scene.add_joint(fb.Rack(scene.add_joint(axle), rail, -0.1))
        scene.add_moment(wheel, lambda t: -3.0 * t)
        motion = fb.simulate(scene, dt=2e-3, t_end=0.5)
        mass = 4.5 if cart_joint else 4.0
        felt, weight = mass + 0.02 / 0.1**2, mass * G * 0.8
        slide = motion.joint(rail).slide
        exact = (30.0 * motion.t**3 / 6 - weight * motion.t**2 / 2) / felt
        assert slide == pytest.approx(exact, abs=2e-4 * abs(exact).max())
        assert slide == pytest.approx(-0.1 * motion.rotation(wheel), abs=1e-13)
        expected = mass * np.diff(motion.joint(rail).rate) / 2e-3 + weight
        assert motion.joint(rack).force[1:] == pytest.approx(expected, abs=1e-3 * weight)


@pytest.mark.parametrize("driver", [0, 1])
def test_a_motor_may_be_on_either_side(driver):
    scene = fb.Scene()
    nodes = [scene.add_body((i, 0), 1.0, 0.1).centre for i in range(2)]
    motors = [{"motor": lambda t: 0.3 * t**2} if i == driver else {} for i in range(2)]
    joints = [
        scene.add_joint(fb.Revolute(fb.GROUND, node, **motor))
        for node, motor in zip(nodes, motors, strict=True)
    ]
    scene.add_joint(fb.Gear(*joints, -2.0))
    motion = fb.simulate(scene, dt=0.01, t_end=1.0)
    angle = 0.3 * motion.t**2
    first = angle if driver == 0 else -angle / 2
    assert motion.rotation(nodes[0]) == pytest.approx(first, abs=1e-13)
    assert motion.rotation(nodes[1]) == pytest.approx(-2 * first, abs=1e-13)
    # The motor accelerates 0.1 + 4 * 0.1, or a quarter of it.
    moment = 0.6 * (0.5 if driver == 0 else 0.125)
    assert motion.joint(joints[driver]).motor_force[5:] == pytest.approx(moment, rel=1e-3)
    assert abs(motion.energy.balance_error).max() < 1e-14


# -- Stiffness and play ----------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [-3.0, 0.5])
def test_a_stiff_tooth_has_the_frequency_of_two_rotors_and_bears_any_number_of_turns(ratio):
    scene, nodes, joints = wheels(0.3, 0.2)
    gear = scene.add_joint(fb.Gear(*joints, ratio, spring=fb.Spring(40.0)))
    frequencies = fb.modes(scene, n=2).angular_frequencies
    exact = np.sqrt(40.0 * (1 / 0.2 + ratio**2 / 0.3))
    assert frequencies == pytest.approx([0.0, exact], rel=1e-9, abs=1e-6)
    scene.set_velocity(nodes[0], spin=20.0)
    scene.set_velocity(nodes[1], spin=20.0 * ratio + 0.2)
    motion = fb.simulate(scene, dt=2e-4, t_end=0.4)
    twist = 0.2 / exact * np.sin(exact * motion.t)
    assert motion.joint(gear).difference == pytest.approx(twist, abs=0.03 * 0.2 / exact)
    assert np.ptp(motion.energy.total) < 1e-12 * motion.energy.total[0]


def test_within_its_play_a_gear_drives_nothing_and_then_gives_its_momentum():
    scene, nodes, joints = wheels(0.1, 0.1)
    gear = scene.add_joint(fb.Gear(*joints, -1.0, stop=(-0.1, 0.1, 1e4)))
    scene.set_velocity(nodes[0], spin=1.0)
    motion = fb.simulate(scene, dt=1e-3, t_end=0.2)
    early, late = motion.t < 0.099, motion.t > 0.12
    assert not motion.spin(nodes[1])[early].any()
    assert motion.joint(gear).force[early] == pytest.approx(0.0, abs=0.0)
    # Equal wheels exchange their speeds, as balls do.
    assert motion.spin(nodes[0])[late] == pytest.approx(0.0, abs=1e-9)
    assert motion.spin(nodes[1])[late] == pytest.approx(-1.0, rel=1e-9)


# -- Analyses --------------------------------------------------------------------------------------


def test_statics_modes_and_linear_systems_have_the_ratio():
    scene, nodes, joints = wheels(0.1, 0.1)
    gear = scene.add_joint(fb.Gear(*joints, -3.0))
    scene.add_spring(nodes[1], rotation=fb.Spring(7.0))
    assert fb.modes(scene, n=1).angular_frequencies[0] == pytest.approx(np.sqrt(63.0), rel=1e-9)
    system = fb.linearise(scene, outputs={"angle": fb.Output("rotation", nodes[1])})
    assert abs(np.linalg.eigvals(system.A).imag).max() == pytest.approx(np.sqrt(63.0), rel=1e-9)
    scene.add_moment(nodes[0], 2.0)
    held = fb.static(scene)
    assert held.rotation(nodes[0])[-1] == pytest.approx(2.0 / 63.0, rel=1e-12)
    assert held.joint(gear).force[-1] == pytest.approx(-2.0 / 3.0, rel=1e-12)


def test_geared_columns_tip_over_together_under_the_load_of_the_closed_form():
    """k psi^2 / 2 against both weights, of which one turns twice as far: P = k / (1 + 4)."""
    scene = fb.Scene()
    columns = [scene.add_body((i, 1.0), 1.0, 0.1, {"foot": (i, 0)}) for i in range(2)]
    feet = [scene.add_joint(fb.Revolute(fb.GROUND, column["foot"])) for column in columns]
    scene.add_joint(fb.Gear(*feet, -2.0))
    scene.add_spring(columns[0].centre, rotation=fb.Spring(50.0))
    for column in columns:
        scene.add_force(column.centre, (0, -1.0))
    assert fb.buckling(scene, n=1).load_factors[0] == pytest.approx(10.0, rel=1e-9)


def test_derivatives_by_the_ratio_are_those_of_the_closed_form():
    def build(x):
        scene, nodes, joints = wheels(0.3, 0.2)
        scene.add_joint(fb.Gear(*joints, x[0]))
        scene.add_spring(nodes[1], rotation=fb.Spring(7.0))
        scene.add_moment(nodes[0], 0.4)
        return scene, {"turn": fb.Output("rotation", nodes[0])}

    run = fb.StaticResponse(build)
    _, values = run([-2.0])
    assert values["turn"][-1] == pytest.approx(0.4 / (4 * 7.0), rel=1e-12)
    assert run.jacobian()["turn"][-1] == pytest.approx([0.4 / 28.0], rel=1e-9)


# -- Changes of a scene ----------------------------------------------------------------------------


def test_a_gear_engages_in_a_motion_and_takes_the_energy_of_an_impact():
    scene, nodes, joints = wheels(0.1, 0.1)
    scene.set_velocity(nodes[0], spin=3.0)
    before = fb.simulate(scene, dt=0.01, t_end=0.5)
    gear = scene.add_joint(fb.Gear(*joints, -2.0), at=before)
    after = fb.simulate(scene, dt=0.01, t_end=1.0, start=before)
    assert after.spin(nodes[0])[-1] == pytest.approx(3.0 * 0.1 / 0.5, rel=1e-9)
    assert after.energy.impact[-1] == pytest.approx(0.45 - 0.09, rel=1e-9)
    assert abs(after.joint(gear).difference).max() < 1e-14
    whole = before.then(after)
    assert len(whole.joint(gear).force) == len(whole.t)
    other = pickle.loads(pickle.dumps(copy.deepcopy(scene)))
    again = fb.simulate(other, dt=0.01, t_end=1.0, start=before)
    assert (again.rotation(other.nodes[0]) == after.rotation(nodes[0])).all()
    with pytest.raises(fb.SceneError, match=r"violates joint 3, Gear.*at=solution"):
        wrong = copy.deepcopy(scene)
        wrong.remove(wrong.gears[0])
        wrong.add_joint(fb.Gear(*wrong.joints, -2.5))
        fb.simulate(wrong, dt=0.01, t_end=1.0, start=before)
    scene.remove(gear)
    free = fb.simulate(scene, dt=0.01, t_end=1.5, start=after)
    assert free.spin(nodes[0]) == pytest.approx(0.6, rel=1e-9)
    scene.add_joint(fb.Gear(*joints, 1.0), at=free)
    scene.remove(joints[0])
    assert not scene.gears


def test_no_analysis_starts_where_a_gear_a_rack_or_a_joint_does_not_hold():
    """Instead of a jump of 0.5 rad in the first step."""
    scene, nodes, joints = wheels(0.1, 0.1)
    for node in nodes:
        scene.add_spring(node, rotation=fb.Spring(1.0))
    gear = scene.add_joint(fb.Gear(*joints, -2.0, value=0.5))
    refused = "the scene as drawn violates joint 2, Gear.*deviate by -0.5"
    for analysis in (
        lambda: fb.simulate(scene, dt=0.01, t_end=0.05),
        lambda: fb.Motion(scene, dt=0.01),
        lambda: fb.static(scene),
        lambda: fb.static(scene, linear=True),
        lambda: fb.modes(scene),
        lambda: fb.linearise(scene, outputs={"turn": fb.Output("rotation", nodes[0])}),
    ):
        with pytest.raises(fb.SceneError, match=refused):
            analysis()
    scene.remove(gear)
    scene.add_moment(nodes[0], 1.0)
    turned = fb.static(scene, load_steps=1)
    engaged = scene.add_joint(fb.Gear(*joints, -2.0), at=turned)
    difference = fb.static(scene, start=turned).joint(engaged).difference
    assert difference[-1] == pytest.approx(0, abs=1e-9)
    with pytest.raises(fb.SceneError, match="the scene as drawn violates"):
        fb.simulate(scene, dt=0.01, t_end=0.05)
    scene, body = one_body((0, 0), 1.0, 0.1)
    shaft = scene.add_joint(fb.Revolute(fb.GROUND, body.centre))
    pushed = scene.add_body((1, 0), 1.0, 0.1).centre
    slide = scene.add_joint(fb.Prismatic(fb.GROUND, pushed, axis=(1, 0)))
    scene.add_joint(fb.Gear(shaft, slide, 0.3, driven="slide", value=0.2))
    with pytest.raises(fb.SceneError, match="violates joint 2, Rack.*deviate by -0.2"):
        fb.simulate(scene, dt=0.01, t_end=0.05)
    # With laws on the difference it is where these are at rest.
    scene, nodes, joints = wheels(0.1, 0.1)
    scene.add_joint(fb.Gear(*joints, -2.0, value=0.5, spring=fb.Spring(3.0)))
    energy = fb.simulate(scene, dt=1e-3, t_end=0.05).energy
    assert energy.total == pytest.approx(3.0 * 0.5**2 / 2, rel=1e-9)


@pytest.mark.parametrize("driven", ["slid", 0])
def test_gears_refuse_what_they_cannot_drive(driven):
    joints = wheels(0.1, 0.1)[2]
    with pytest.raises(fb.SceneError, match="must be 'rotation' or 'slide'"):
        fb.Gear(*joints, 1.0, driven=driven)


def test_a_gearbox_is_held_by_the_moment_that_its_wheels_gain():
    """A weld holds the housing of both wheels: J_a and the ratio times J_b, at 2 rad/s^2."""
    ratio, places, inertias = -3.0, ((0.3, 0.0), (-0.4, 0.0)), (0.2, 0.05)
    scene, base = held_body((0, 0), 1.0, 0.1, "x", "y", "rotation")
    housing = scene.add_body((0, 0), 1.0, 0.1, dict(zip("ab", places, strict=True)))
    weld = scene.add_joint(fb.Rigid(base, housing.centre))
    rotors = zip(places, inertias, strict=True)
    wheels = [scene.add_body(place, 0.5, inertia).centre for place, inertia in rotors]
    motor = fb.Revolute(housing["a"], wheels[0], motor=lambda t: t * t)
    shafts = scene.add_joint(motor), scene.add_joint(fb.Revolute(housing["b"], wheels[1]))
    scene.add_joint(fb.Gear(*shafts, ratio))
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    moment = 2.0 * (inertias[0] + ratio * inertias[1])
    for forces in (solution.joint(weld).force, solution.reaction(base)):
        assert forces[1:, 2] == pytest.approx(np.full(10, moment), rel=1e-3)


def test_what_is_no_gear_is_refused():
    scene, nodes, joints = wheels(0.1, 0.1, 0.1)
    slide = scene.add_joint(fb.Prismatic(fb.GROUND, scene.add_body((5, 0), 1.0).centre, (1, 0)))
    for words, call in (
        ("both of its joints", lambda: fb.Gear(joints[0], joints[0], 2.0)),
        ("the ratio is zero", lambda: fb.Gear(*joints[:2], 0.0)),
        ("a joint that turns", lambda: fb.Gear(joints[0], slide, 2.0)),
        ("a joint that slides", lambda: fb.Rack(*joints[:2], 2.0)),
        ("a joint that turns", lambda: fb.Rack(slide, joints[0], 2.0)),
        ("finite", lambda: fb.Gear(*joints[:2], "2:1")),
        ("that add_joint of this scene", lambda: fb.Scene().add_joint(fb.Gear(*joints[:2], 2.0))),
        ("normal force", lambda: fb.Gear(*joints[:2], 1.0, friction=fb.Coulomb(0.1, 9.0, 1.0))),
    ):
        assert_refused(words, call)
    for pair, ratio in (((0, 1), 2.0), ((1, 2), 3.0), ((0, 2), 6.0)):
        scene.add_joint(fb.Gear(joints[pair[0]], joints[pair[1]], ratio))
    with pytest.raises(fb.SceneError, match="over-constrained.*1 of them is redundant.*a spring"):
        fb.simulate(scene, dt=0.1, t_end=0.1)
    held, ends, pair = wheels(0.1, 0.1)
    gear = held.add_joint(fb.Gear(*pair, 2.0))
    held.set_velocity(ends[0], spin=1.0)
    assert_refused(r"joint 2, Gear.*deviate by the rate -2", fb.simulate, held, dt=0.1, t_end=0.1)
    for end in ends:
        held.fix(end, "rotation")
    with pytest.raises(fb.SceneError, match="over-constrained: joint 2, Gear.*are held"):
        fb.simulate(held, dt=0.1, t_end=0.1)
    with pytest.raises(ValueError, match="not in this solution|not a joint of this solution"):
        fb.simulate(wheels(0.1, 0.1)[0], dt=0.1, t_end=0.1).joint(gear)


def test_friction_that_sticks_is_damped_by_the_gears_of_its_own_scene():
    """Also where the set-up has served a scene with another ratio."""

    def damping(ratio):
        scene = fb.Scene()
        wheels = [scene.add_body((x, 0), mass=1.0, inertia=J) for x, J in ((0, 0.1), (2, 0.3))]
        friction = fb.Coulomb(0.5, stiffness=100.0, radius=0.1)
        first = scene.add_joint(fb.Revolute(fb.GROUND, wheels[0].centre, friction=friction))
        second = scene.add_joint(fb.Revolute(fb.GROUND, wheels[1].centre))
        scene.add_joint(fb.Gear(first, second, ratio))
        stats = fb.simulate(scene, dt=0.01, t_end=0.02).stats
        return stats.friction_damping["joint 0 rotation"][0]

    for ratio in (-2.0, -20.0, -3.0):
        inertia = 0.1 + ratio**2 * 0.3
        assert damping(ratio) == pytest.approx(2 * (inertia / 100.0) ** 0.5, rel=1e-12)
