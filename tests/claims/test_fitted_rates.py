"""Rates and forces of bodies and of other couplings that change with the motion."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from derivatives import assert_they_are_those_of_the_motion
from jointed import chain, four_bar as linkage
from scenes import assert_refused, clamped_bar, hinged_body, one_body, pinned_bar
from scipy.integrate import solve_ivp

import fx_beam as fb

G = 9.81
# A rigid pendulum: mass, moment of inertia, distance of the centre from the pin, first spin.
M, J, A, SPIN = 2.0, 0.3, 0.8, 4.0


def pendulum():
    scene, body, pin = hinged_body((A, 0), M, J, {"pin": (0, 0)}, gravity=(0, -G))
    scene.set_velocity(body, (0, A * SPIN), SPIN)
    return scene, body, pin


def errors(scheme, dt, t_end=0.4):
    """Largest errors of the pendulum's rates, and those (n, 2) of the mean force of its pin."""
    scene, body, pin = pendulum()
    solution = fb.simulate(scene, scheme, dt=dt, t_end=t_end)

    def slope(t, y):
        return y[1], -M * G * A * np.cos(y[0]) / (J + M * A**2)

    exact = solve_ivp(
        slope, (0, solution.t[-1]), (0, SPIN), "DOP853", solution.t, rtol=1e-13, atol=1e-14
    )
    psi, spin = exact.y
    v = A * spin[:, None] * np.column_stack([-np.sin(psi), np.cos(psi)])
    rates = {
        "velocity": solution.velocity(body.centre) - v,
        "spin": solution.spin(body.centre) - spin,
        "spin of the joint": solution.joint(pin).spin - spin,
        "momentum": solution.linear_momentum - M * v,
        "angular momentum": solution.angular_momentum - (J + M * A**2) * spin,
    }
    mean = M * np.diff(v, axis=0) / dt + (0, M * G)
    forces = solution.joint(pin).force[1:, :2] - mean
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.kinetic[0]
    return {name: abs(error).max() for name, error in rates.items()}, forces


def alternating(errors):
    """The part that changes its sign from row to row."""
    return abs(errors[2:] - 2 * errors[1:-1] + errors[:-2]).max() / 4


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.MidPoint(), fb.ModifiedMidPoint(), fb.EnergyDecaying(0.5)]
)
def test_rates_and_forces_of_a_rigid_pendulum_are_of_order_two_and_do_not_alternate(scheme):
    coarse, fine = (errors(scheme, dt) for dt in (0.01, 0.005))
    for name, error in coarse[0].items():
        assert np.log2(error / fine[0][name]) > 1.9, name
    assert np.log2(abs(coarse[1]).max() / abs(fine[1]).max()) > 1.9
    assert abs(fine[1]).max() < 1e-3  # of 26 N
    assert alternating(fine[1]) < 0.03 * abs(fine[1]).max()


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(order=4), fb.MidPoint(order=4)])
def test_rates_and_forces_of_a_rigid_pendulum_are_of_order_four_with_order_four(scheme):
    coarse, *others, fine = (errors(scheme, dt) for dt in (0.02, 0.01, 0.005, 0.0025))
    for name, error in coarse[0].items():
        assert np.log2(error / fine[0][name]) / 3 > 3.9, name
    assert np.log2(abs(coarse[1]).max() / abs(fine[1]).max()) / 3 > 3.9
    assert abs(others[1][1]).max() < 1e-7  # of 26 N


def mean_forces(scheme, lengths, push):
    """Mean forces (n, 2) of the pin in steps of these lengths; a push begins at 0.2 s."""
    scene, body, pin = pendulum()
    scene.add_force(body.centre, lambda t: (0.0, push * (t > 0.2)))
    computed, forces = None, []
    for dt, end in zip(lengths, np.cumsum(lengths), strict=True):
        computed = fb.simulate(scene, scheme, dt=dt, t_end=end, start=computed)
        forces.append(computed.joint(pin).force[1, :2])
    return np.array(forces)


@pytest.mark.exact_times
@pytest.mark.parametrize(
    ("shares", "push"),
    [([1] * 10 + [0.5] * 20, 0), ([1, 1.3, 0.7, 1.5, 0.5, 1, 1.2, 0.8] * 2, 0), ([1] * 20, 30.0)],
    ids=["half", "varied", "jump"],
)
def test_an_even_number_of_sub_steps_keeps_the_order_of_forces_at_changes(shares, push):
    fractions = (forward := 0.5 / (3 - 3 ** (1 / 3)), forward, forward, 0.5 - 3 * forward)
    plain, errors = fb.EnergyMomentum(), []
    even = fb.Scheme("even", plain.resultants, plain.rates, fractions + fractions[::-1])
    for parts in (1, 2):
        lengths = np.repeat(np.array(shares) * 0.02 / parts, parts)
        exact = mean_forces(even, np.repeat(lengths / 4, 4), push).reshape(-1, 4, 2).mean(axis=1)
        for scheme in (even, fb.EnergyMomentum(order=4)):
            errors.append(abs(mean_forces(scheme, lengths, push) - exact).max())
    assert np.log2(errors[0] / errors[2]) > 3.9
    assert errors[3] > 20 * errors[2]


def place(t):
    return 0.1 * (1 - np.cos(3 * t)) * t


def pushed_pendulum(motor):
    """A motor or a support moves a pendulum's carriage."""
    scene, carriage = one_body((0, 0), 1.0, 0.1, gravity=(0, -G))
    body = scene.add_body((0, -A), M, J, points={"pin": (0, 0)})
    scene.add_joint(fb.Revolute(carriage.centre, body["pin"]))
    if motor:
        scene.add_joint(fb.Prismatic(fb.GROUND, carriage.centre, axis=(1, 0), motor=place))
    else:
        scene.prescribe(carriage.centre, x=place, y=0.0, rotation=0.0)
    return scene


def double_pendulum():
    """Two bodies with a damper between them; the first starts with spin."""
    scene = fb.Scene(gravity=(0, -G))
    first = scene.add_body((0.4, 0), 2.0, 0.1, points={"o": (0, 0), "p": (0.8, 0)})
    second = scene.add_body((1.1, 0), 1.0, 0.05, points={"q": (0.8, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, first["o"]))
    scene.add_joint(fb.Revolute(first["p"], second["q"], damper=fb.Damper(0.05)))
    scene.set_velocity(first, (0, 1.2), 3.0)
    scene.set_velocity(second, (0, 1.5), -3.0)
    return scene


def four_bar():
    return linkage()[0]


def free_chain():
    scene = fb.Scene()
    bars = chain(scene, [(x, 0) for x in range(4)])
    scene.set_velocity(bars[0], (0, 1), 2.0)
    scene.make_velocities_compatible()
    return scene


def slider_crank():
    """A motor turns a crank; its rod moves a slide."""
    scene = fb.Scene(gravity=(0, -G))
    crank = scene.add_body((0.1, 0), 1.0, 0.01, points={"o": (0, 0), "p": (0.2, 0)})
    rod = scene.add_body((0.5, 0), 2.0, 0.05, points={"q": (0.2, 0), "r": (0.8, 0)})
    slide = scene.add_body((0.8, 0), 1.5, 0.01)
    scene.add_joint(fb.Revolute(fb.GROUND, crank["o"], motor=lambda t: 5 * t + t**2))
    scene.add_joint(fb.Revolute(crank["p"], rod["q"]))
    scene.add_joint(fb.Revolute(rod["r"], slide.centre))
    scene.add_joint(fb.Prismatic(fb.GROUND, slide.centre, axis=(1, 0)))
    scene.make_velocities_compatible()
    return scene


SCENES = (double_pendulum, four_bar, free_chain, slider_crank)
KINDS = ("v", "linear_momentum", "angular_momentum", "joint_forces", "motor_forces", "reactions")


def errors_of_rows(build, order, steps):
    """Largest errors in all rows by names, for some lengths of steps."""

    def run(dt, order):
        solution = fb.simulate(build(), fb.EnergyMomentum(order=order), dt=dt, t_end=0.32)
        energy = solution.energy
        if dt > 4e-3:  # round-off grows with the number of steps
            assert abs(energy.balance_error).max() < 1e-12 * (1 + energy.kinetic.max())
        return solution

    finest, solution = min(steps) / 4, []
    exact = run(finest, 4)
    for dt in steps:
        coarse, each = run(dt, order), round(dt / finest)
        rates = {name: getattr(exact, name)[::each] for name in KINDS[:3]}
        for name in KINDS[3:]:
            rows = getattr(exact, name)[1:]
            means = rows.reshape(-1, each, *rows.shape[1:]).mean(axis=1)
            rates[name] = np.concatenate([getattr(coarse, name)[:1], means])
        solution.append({name: abs(getattr(coarse, name) - rates[name]).max() for name in KINDS})
    return solution


@pytest.mark.parametrize(
    ("build", "dt"),
    [
        (double_pendulum, 0.04),
        (four_bar, 0.04),
        (free_chain, 0.08),
        (slider_crank, 0.04),
        (lambda: pushed_pendulum(True), 0.08),
        (lambda: pushed_pendulum(False), 0.08),
    ],
    ids=["double pendulum", "four-bar", "free chain", "slider crank", "motor", "support"],
)
def test_rates_and_forces_of_bodies_are_of_order_two_or_four(build, dt):
    coarse, *_, fine = errors_of_rows(build, 4, dt / 2.0 ** np.arange(4))
    for name, small in fine.items():
        round_off = 3e-9 if name in KINDS[3:] else 1e-10
        assert small < coarse[name] / 8**3.7 + round_off, name
    coarse, fine = errors_of_rows(build, 2, (0.005, 0.0025))
    for name, small in fine.items():
        if small > 1e-8:  # what is kept, and where round-off remains
            assert np.log2(coarse[name] / small) > 1.9, name


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("build", [slider_crank, lambda: pushed_pendulum(False)])
def test_the_kinetic_energy_of_driven_bodies_is_that_of_their_rates_to_order_four(build, order):
    errors = []
    for dt in (0.02, 0.01):
        scene = build()
        solution = fb.simulate(scene, fb.EnergyMomentum(order=order), dt=dt, t_end=0.4)
        kinetic = sum(
            body.mass * (solution.velocity(body.centre) ** 2).sum(axis=1) / 2
            + body.inertia * solution.spin(body.centre) ** 2 / 2
            for body in scene.bodies
        )
        errors.append(abs(solution.energy.kinetic - kinetic).max() / kinetic.max())
        assert solution.energy.work[0] == pytest.approx(0, abs=1e-12)
        assert abs(solution.energy.balance_error).max() < 1e-13 * (1 + kinetic.max())
    assert errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) > 3.8


def test_the_rates_of_the_first_row_are_those_given_with_all_their_momentum():
    scene = free_chain()
    two, four = (
        fb.simulate(scene, fb.EnergyMomentum(order=order), dt=0.02, t_end=0.1) for order in (2, 4)
    )
    for name in KINDS[:3]:
        assert getattr(four, name)[0] == pytest.approx(getattr(two, name)[0], abs=1e-14), name
    # Velocities that are made compatible have the momenta of those that were given.
    assert four.linear_momentum[0] == pytest.approx([0, 1], abs=1e-13)
    assert four.angular_momentum[0] == pytest.approx(0.5 * 1 + 2 / 12, abs=1e-13)
    assert four.energy.kinetic[0] == pytest.approx(two.energy.kinetic[0], rel=1e-9)
    assert four.linear_momentum[-1] == pytest.approx(four.linear_momentum[0], abs=1e-12)
    assert four.angular_momentum[-1] == pytest.approx(four.angular_momentum[0], abs=1e-12)
    assert four.stats.substeps == four.stats.steps == 5


def two_rods():
    """Two bodies on hinges in a row, and their joints."""
    scene = fb.Scene()
    one = scene.add_body((0.5, 0), 2.0, 0.3, points={"near": (0, 0), "far": (1, 0)})
    other = scene.add_body((1.5, 0), 1.0, 0.1, points={"near": (1, 0)})
    first = scene.add_joint(fb.Revolute(fb.GROUND, one["near"]))
    return scene, first, scene.add_joint(fb.Revolute(one["far"], other["near"]))


def test_all_that_follows_the_rate_of_a_joint_has_the_least_kinetic_energy():
    """Of 2 T = A w^2 + 2 B w + ..., w the spin of the first rod and w + 3 that of the other one."""
    scene, first, second = two_rods()
    scene.set_rate(second, 3.0)
    motion = fb.simulate(scene, dt=1e-3, t_end=1e-3)
    A, B = 0.3 + 2 * 0.5**2 + 1.5**2 + 0.1, 3 * (1.5 * 0.5 + 0.1)
    assert motion.joint(second).spin[0] == pytest.approx(3.0, rel=1e-12)
    assert motion.joint(first).spin[0] == pytest.approx(-B / A, rel=1e-12)
    scene.set_rate(first, -1.0)
    motion = fb.simulate(scene, dt=1e-3, t_end=1e-3)
    rates = [motion.joint(joint).spin[0] for joint in (first, second)]
    assert rates == pytest.approx([-1.0, 3.0], rel=1e-12)


def test_a_loop_starts_with_the_rate_of_its_crank_or_of_its_slide():
    scene = fb.Scene()
    crank = scene.add_body((0, 0), 1.0, 1.0, points={"pin": (0, 0.3)})
    rod = scene.add_body((0.4, 0.15), 1.0, 0.1, points={"pin": (0, 0.3), "end": (0.8, 0)})
    block = scene.add_body((0.8, 0), 1.0, 0.1).centre
    shaft = scene.add_joint(fb.Revolute(fb.GROUND, crank.centre))
    scene.add_joint(fb.Revolute(crank["pin"], rod["pin"]))
    scene.add_joint(fb.Revolute(rod["end"], block))
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, block, axis=(1, 0)))
    for joint, rate in ((shaft, 2.0), (guide, -0.6)):
        loop = copy.deepcopy(scene)
        loop.set_rate(loop.joints[joint.number], rate)
        motion = fb.simulate(loop, dt=1e-3, t_end=1e-3)
        assert motion.joint(loop.joints[shaft.number]).spin[0] == pytest.approx(2.0, rel=1e-10)
        assert motion.joint(loop.joints[guide.number]).rate[0] == pytest.approx(-0.6, rel=1e-10)
    scene.set_rate(shaft, 2.0)
    scene.set_rate(guide, 0.6)
    assert_refused("other rates or supports exclude it", fb.simulate, scene, dt=1e-3, t_end=1e-3)


def test_rates_of_joints_leave_the_momentum_of_what_is_free():
    scene = free_chain()
    before = fb.simulate(scene, dt=0.02, t_end=0.02)
    joint = next(joint for joint in scene.joints if joint.rotation is not None)
    scene.set_rate(joint, 4.0)
    after = fb.simulate(scene, dt=0.02, t_end=0.02)
    assert after.joint(joint).rate[0] == pytest.approx(4.0, rel=1e-12)
    assert after.linear_momentum[0] == pytest.approx(before.linear_momentum[0], abs=1e-13)
    assert after.angular_momentum[0] == pytest.approx(before.angular_momentum[0], abs=1e-13)


def test_joints_that_have_no_rate_or_a_motor_are_refused():
    scene, _, _ = two_rods()
    hub = scene.add_body((0, 0), 1.0, 1.0).centre
    driven = scene.add_joint(fb.Revolute(fb.GROUND, hub, motor=lambda t: t**2))
    for joint in (driven, scene.joints[0]):
        assert_refused("without motor", scene.set_rate, joint, 1.0)


def test_derivatives_know_the_rate_of_a_joint():
    def build(x):
        scene, first, second = two_rods()
        scene.set_rate(second, x[0])
        return scene, {"spin": fb.Output("spin", first)}

    response = fb.Response(build, dt=1e-3, t_end=1e-3)
    response([3.0])
    A, B = 0.3 + 2 * 0.5**2 + 1.5**2 + 0.1, 1.5 * 0.5 + 0.1
    assert response.jacobian()["spin"][0] == pytest.approx([-B / A], rel=1e-6)


def turned(spin, arm):
    """Velocity of the end of an arm about its start."""
    return spin[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])


@pytest.mark.parametrize("build", SCENES)
def test_points_of_bodies_move_with_their_centres_and_joints_stay_together(build):
    scene = build()
    solution = fb.simulate(scene, dt=0.01, t_end=0.3)
    for body in scene.bodies:
        v, spin = solution.velocity(body.centre), solution.spin(body.centre)
        for point in body.points.values():
            arm = solution.position(point) - solution.position(body.centre)
            assert solution.velocity(point) == pytest.approx(v + turned(spin, arm), abs=1e-12)
            assert solution.spin(point) == pytest.approx(spin, abs=1e-12)
    for joint in scene.joints:
        if joint.kind == "Revolute" and joint.b is not fb.GROUND:
            gap = solution.velocity(joint.b)
            if joint.a is not fb.GROUND:
                arm = solution.position(joint.b) - solution.position(joint.a)
                gap = gap - solution.velocity(joint.a) - turned(solution.spin(joint.a), arm)
            assert abs(gap).max() < 1e-11


def _pin_in_slot(x):
    """A pin within 1e-4 m of the end of the slot, whose turn alone meets its condition."""
    scene = fb.Scene(gravity=(0, -10 * x[0]))
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0)
    slot, pin = (
        scene.add_beam(ends, section, elements=2) for ends in ([(0, 0), (1, 0)], [(1, 0), (2, 0.2)])
    )
    scene.clamp(slot.start)
    spring = fb.Spring(220 * x[1])
    return scene, slot, fb.PinInSlot(slot.end, pin.start, axis=(1, 0.3), spring=spring)


def _sleeve(x):
    """A sleeve that turns with both nodes of its element: one of their motions has no mass."""
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0)
    scene, carrier = clamped_bar((1, 0), section, elements=2, gravity=(0, -10 * x[0]))
    carried = scene.add_beam([(0.6, 0), (0.6, 1)], replace(section, rhoI=1e-2), elements=2)
    return scene, carrier, fb.Sleeve(carrier, carried.start, damper=fb.Damper(0.3 * x[1]))


@pytest.mark.parametrize("build", [_pin_in_slot, _sleeve])
def test_rates_of_massless_turns_have_their_derivatives(build):
    def outputs(x):
        scene, beam, joint = build(x)
        spins = {f"spin {i}": fb.Output("spin", node) for i, node in enumerate(beam.nodes)}
        return scene, spins | {"force": fb.Output("force", scene.add_joint(joint))}

    run, x = fb.Response(outputs, dt=0.01, t_end=0.12), np.ones(2)
    _, y = run(x)
    # Masses of 1e-8 tell the motion that has none: of round-off eight digits are left.
    J, gradient = run.jacobian(), run.vjp({name: np.ones_like(rows) for name, rows in y.items()})
    sums = sum(rows.reshape(-1, 2).sum(axis=0) for rows in J.values())
    assert gradient == pytest.approx(sums, rel=0, abs=1e-6 * abs(sums).max())
    assert_they_are_those_of_the_motion(run, x, J, h=1e-3)


def test_rows_of_some_steps_without_motion_have_the_same_forces():
    whole = fb.simulate(slider_crank(), dt=0.004, t_end=0.1)
    record = fb.Record(every=4, motion=False, rates=False)
    some = fb.simulate(slider_crank(), dt=0.004, t_end=0.1, record=record)
    assert not some.has_motion
    assert not some.has_rates
    for name in KINDS[1:]:
        rows = getattr(whole, name)[[*range(0, 25, 4), 25]]
        assert getattr(some, name) == pytest.approx(rows, abs=1e-9), name


def jacobian(x):
    """Of the double pendulum's accelerations, by angles and spins, by complex steps."""
    m1, j1, l1, a1, m2, j2, a2, c = 2.0, 0.1, 0.8, 0.4, 1.0, 0.05, 0.3, 0.05

    def slopes(x):
        p1, p2, w1, w2 = x
        m11, m22 = j1 + m1 * a1**2 + m2 * l1**2, j2 + m2 * a2**2
        m12, h = (m2 * l1 * a2 * part(p2 - p1) for part in (np.cos, np.sin))
        f1 = h * w2**2 - (m1 * a1 + m2 * l1) * G * np.cos(p1) + c * (w2 - w1)
        f2 = -h * w1**2 - m2 * a2 * G * np.cos(p2) - c * (w2 - w1)
        return np.array([w1, w2, *np.linalg.solve([[m11, m12], [m12, m22]], [f1, f2])])

    return np.array([slopes(x + 1e-30j * unit).imag / 1e-30 for unit in np.eye(4)]).T


def test_a_double_pendulum_of_bodies_with_a_damper_is_linearised_as_by_hand():
    scene = double_pendulum()
    motion = fb.Motion(scene, dt=0.004)
    motion.run(0.4)
    last = motion.state
    first, second = (body.centre for body in scene.bodies)
    outputs = {
        f"{what}{i}": fb.Output(what, node)
        for what in ("rotation", "spin")
        for i, node in enumerate((first, second))
    }
    system = fb.linearise(scene, motion, outputs=outputs)
    x = np.array(
        [getattr(last, what)(node)[-1] for what in ("rotation", "spin") for node in (first, second)]
    )
    computed = system.C @ system.A @ np.linalg.inv(system.C)
    assert computed == pytest.approx(jacobian(x), abs=1e-9)
    assert abs(system.deviation(motion)).max() < 1e-9


def test_rows_farther_apart_have_the_same_forces_beside_a_slide_that_moves():
    def motion(every):
        section = fb.Section(EA=2e4, GA=5e3, EI=15.0, rhoA=1.0, rhoI=5e-3)
        scene, arm = pinned_bar((1, 0), section, elements=2, gravity=(0.0, -9.81))
        body = scene.add_body((1.1, 0.1), mass=0.5, inertia=0.02)
        guide = {"offset": (0.1, 0.1), "axis": (1, 0.3)}
        joint = scene.add_joint(fb.Prismatic(arm.end, body.centre, **guide))
        return fb.simulate(scene, dt=0.005, t_end=0.3, record=fb.Record(every=every)), joint

    (whole, joint), (rows, same) = motion(1), motion(3)
    force = whole.joint(joint).force[::3]
    assert rows.joint(same).force == pytest.approx(force, rel=0, abs=1e-10 * abs(force).max())
    assert rows.a == pytest.approx(whole.a[::3], rel=0, abs=1e-10 * abs(whole.a).max())
