"""A, B, C and D of a scene: against modes, frequency responses and small differences of motions."""

import ufl

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from scenes import clamped_bar, held_body, one_bar, pinned_bar

import fx_beam as fb

DT = 1e-3


def section(rhoI=1e-2, retardation=0.01):
    return fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=rhoI, retardation=retardation)


def hanging(rhoI=1e-2, retardation=0.01):
    """An arm under gravity on a hinge that slides on a post, with springs and dampers."""
    made = section(rhoI, retardation)
    scene, post = clamped_bar((0.5, 0), made, elements=2, gravity=(0.0, -9.81))
    arm = scene.add_beam([(0.5, 0), (1.3, 0.2)], made, elements=3)
    slide_laws = {"spring": fb.Spring(60.0), "damper": fb.Damper(2.0)}
    hinge = fb.Coordinate(spring=fb.Spring(30.0), damper=fb.Damper(0.8))
    joint = fb.PinInSlot(post.end, arm.start, axis=(0.6, 0.8), hinge=hinge, **slide_laws)
    joint = scene.add_joint(joint)
    scene.add_force(arm.end, fb.Input("push"))
    outputs = {
        "tip": fb.Output("displacement", arm.end),
        "turn": fb.Output("rotation", arm.end),
        "slide": fb.Output("slide", joint),
        "angle": fb.Output("angle", joint),
    }
    return scene, arm, joint, outputs


def swinging():
    """A block that is driven on a rail, on it a turning arm with a slider."""
    made = section(retardation=0.0)
    scene, block = one_bar((0.4, 0), made, elements=1, gravity=(0.0, -9.81))
    rail = fb.Prismatic(fb.GROUND, block.start, axis=(1, 0), motor=fb.Input("place"))
    rail = scene.add_joint(rail)
    arm = scene.add_beam([(0, 0), (0.6, -0.8)], made, elements=2)
    hinge = scene.add_joint(fb.Revolute(block.start, arm.start, damper=fb.Damper(0.1)))
    weight = scene.add_beam([(0.6, -0.8), (0.9, -0.9)], made, elements=1)
    slot = fb.PinInSlot(arm.end, weight.start, axis=(0.6, -0.8), spring=fb.Spring(300.0))
    slot = scene.add_joint(slot)
    scene.add_force(arm.end, fb.Input("thrust"), follower=True)
    scene.add_moment(weight.end, fb.Input("torque"))
    scene.add_moment(arm.start, fb.Input("torque", factor=-1))
    outputs = {
        "end": fb.Output("position", weight.end),
        "turn": fb.Output("rotation", arm.end),
        "v": fb.Output("velocity", weight.end),
        "spin": fb.Output("spin", hinge),
        "slide": fb.Output("slide", slot),
        "rate": fb.Output("rate", slot),
        "x": fb.Output("slide", rail),
        "angle": fb.Output("angle", hinge),
        "vx": fb.Output("velocity", weight.start, "x"),
    }
    return scene, outputs


def flat(outputs):
    return np.hstack(list(outputs.values()))


def assert_has_eigenvalues(A, expected, rel):
    roots = np.linalg.eigvals(A)
    for value in expected:
        assert abs(roots - value).min() < rel * abs(value), value


@pytest.mark.parametrize("case", [{}, {"rhoI": 0.0, "retardation": 0.0}])
def test_eigenvalues_are_those_of_damped_modes_about_a_stressed_state(case):
    scene, _, _, outputs = hanging(**case)
    state = fb.static(scene, load_steps=4)
    system = fb.linearise(scene, state, outputs=outputs)
    modes = fb.modes(scene, state, n=6)
    assert (modes.damping_ratios > 1e-3).all()
    assert_has_eigenvalues(system.A, modes.eigenvalues[modes.damping_ratios < 1], 1e-7)
    states = scipy.signal.StateSpace(system.A, system.B, system.C, system.D)
    assert (states.A == system.state_space().A).all()
    assert system.inputs == ("push.x", "push.y")
    assert system.outputs == ("tip.x", "tip.y", "turn", "slide", "angle")


@pytest.mark.parametrize("rhoI", [0.01, 0.0])
def test_the_transfer_function_is_the_frequency_response(rhoI):
    scene, arm, joint, outputs = hanging(rhoI)
    scene.add_force(arm.end, lambda t: (3.0 * np.cos(5 * t), 1.0), follower=True)
    state, f = fb.static(scene, load_steps=4, t=0.7), [0.0, 0.6, 2.2, 30.0]
    system = fb.linearise(scene, state, outputs=outputs)
    for k, direction in enumerate(np.eye(2)):
        at_end, joint_values = (
            fb.frequency_response(scene, (arm.end, direction), place, f, state=state).values
            for place in (arm.end, joint)
        )
        for i, w in enumerate(2 * np.pi * np.array(f)):
            response = np.linalg.solve(1j * w * np.eye(len(system.A)) - system.A, system.B)
            response = system.C @ response + system.D
            expected = np.concatenate([at_end[i], joint_values[i]])
            assert response[:, k] == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_rates_of_motors_and_prescribed_motions_are_inputs():
    scene, base = one_bar((0.5, 0), section(), elements=2, gravity=(0.0, -9.81))
    scene.fix(base.start, "y", "rotation")
    scene.prescribe(base.start, x=fb.Input("x"))
    arm = scene.add_beam([(0.5, 0), (1.2, 0.3)], section(), elements=2)
    joint = scene.add_joint(fb.Revolute(base.end, arm.start, motor=fb.Input("place", factor=2.0)))
    scene.add_drag(arm, linear=0.3)
    start = fb.static(scene, load_steps=4, inputs={"place": 0.3})
    quantities = {"tip": "displacement", "v": "velocity", "spin": "spin"}
    outputs = {name: fb.Output(quantity, arm.end) for name, quantity in quantities.items()}
    system = fb.linearise(scene, start, outputs=outputs | {"angle": fb.Output("angle", joint)})
    t, shape = DT * np.arange(401), np.array([0.5, 0.3])

    def places(t):
        return shape * np.array([np.sin(6 * t) ** 4, np.sin(4 * t) ** 4])

    rates = np.array([(places(x + 1e-6) - places(x - 1e-6)) / 2e-6 for x in t])
    exact = scipy.signal.lsim(system.state_space(), rates, t)[1]
    errors = []
    for size in (1e-1, 1e-2):
        inputs = {
            "x": lambda t, size=size: size * places(t)[0],
            "place": lambda t, size=size: 0.3 + size * places(t)[1],
        }
        moved = fb.simulate(scene, dt=DT, t_end=0.4, start=start, inputs=inputs)
        q, v = moved.q[:, arm.end.number], moved.v[:, arm.end.number]
        seen = np.column_stack([q[:, :2] - q[0, :2], v, moved.joint(joint).angle - 0.6]) / size
        errors.append(abs(seen - exact).max(axis=0) / abs(exact).max(axis=0))
    assert errors[0].max() < 0.1
    assert (errors[1] < np.maximum(0.2 * errors[0], 1e-4)).all()
    x = system.deviation(moved)
    expected = seen[-1] * size
    assert system.C @ x + system.D @ rates[-1] * size == pytest.approx(expected, abs=1e-2 * size)


def errors_of_systems(scene, outputs, name, place_of_step, first, means, rates, **held):
    """Largest errors by which systems of the instant, step by step, miss small differences.

    Of a motion whose input `name` is place_of_step(k) in step k, and of one whose input from step
    `first` + 1 on is larger by small `means`, which are inputs `rates` of the systems. Relative to
    the largest difference, for rates and for the others; inputs `held` are constant.
    """
    dt, size = 1e-3, 1e-5
    motion = fb.Motion(scene, dt=dt, outputs=outputs)
    for k in range(1, first + 1):
        motion.step({name: place_of_step(k)} | held)
    start = motion.snapshot()

    def run(sign):
        motion.restore(start)
        places = enumerate(sign * size * means, start=first + 1)
        return np.array([flat(motion.step({name: place_of_step(k) + more})) for k, more in places])

    nonlinear = (run(1.0) - run(-1.0)) / (2 * size)
    motion.restore(start)
    now = fb.linearise(scene, motion, [name], outputs)
    x, linear = np.zeros(len(now.A)), []
    for k, rate in enumerate(rates):
        before, u = now, np.array([rate])
        motion.step({name: place_of_step(first + 1 + k)})
        now = fb.linearise(scene, motion, [name], outputs)
        A, B = (before.A + now.A) / 2, (before.B + now.B) / 2
        whole = scipy.linalg.expm(dt * np.block([[A, B], [np.zeros((1, len(A) + 1))]]))
        x = whole[:-1, :-1] @ x + whole[:-1, -1:] @ u
        # The states lack the rates due to a motor, which depend on its place.
        moved = (now.reduction.moved - before.reduction.moved) @ u[: now.reduction.moved.shape[1]]
        x[len(x) - len(moved) :] += moved
        linear.append(now.C @ x + now.D @ u)
    errors, sizes = abs(np.array(linear) - nonlinear).max(axis=0), abs(nonlinear).max(axis=0)
    kinds = np.array([label.startswith(("v", "spin", "rate")) for label in now.outputs])
    return [errors[kind].max() / sizes[kind].max() for kind in (kinds, ~kinds)]


def bump(steps):
    """A smooth bump, which excites no fast vibrations: at the steps' ends, and means."""
    ends = np.sin(np.pi * np.arange(steps + 1) / steps) ** 4
    return ends, (ends[1:] + ends[:-1]) / 2


def test_systems_of_the_instant_add_up_to_small_differences_of_a_fast_motion():
    scene, outputs = swinging()
    ends, _ = bump(40)

    def given(k):
        return 0.05 * (1 - np.cos(15 * k * DT))

    others = {"torque": 3.0, "thrust": (2.0, 1.0)}
    rates = np.diff(ends) / DT
    errors = errors_of_systems(scene, outputs, "place", given, 300, ends[1:], rates, **others)
    assert max(errors) < 0.05


def test_systems_of_the_instant_of_a_closed_loop_in_motion():
    scene = fb.Scene(gravity=(0.0, -9.81))
    crank = scene.add_body((0.1, 0.5), 1.0, 0.01, points={"O": (0, 0.5), "P": (0.2, 0.5)})
    arm = scene.add_body((0.1, 0.3), 1.0, 0.2, points={"O": (0, -0.2)})
    for body in (crank, arm):
        scene.add_joint(fb.Revolute(fb.GROUND, body["O"]))
    slot = fb.PinInSlot(arm["O"], crank["P"], axis=(0.2, 0.7), damper=fb.Damper(0.1))
    slot = scene.add_joint(slot)
    scene.add_moment(crank.centre, fb.Input("torque"))
    hanging = fb.static(scene, load_steps=8)
    modes = fb.modes(scene, hanging, n=1)
    assert_has_eigenvalues(fb.linearise(scene, hanging).A, modes.eigenvalues, 1e-9)
    outputs = {
        "turn": fb.Output("rotation", crank.centre),
        "slide": fb.Output("slide", slot),
        "spin": fb.Output("spin", arm.centre),
    }
    _, means = bump(40)
    errors = errors_of_systems(scene, outputs, "torque", lambda k: 2.0, 400, means, means)
    assert max(errors) < 5e-3


def rods_in_a_row(count, spring, damper):
    """Rods of length 1 on hinges with springs and dampers, along x: their scene and centres."""
    scene, last, centres = fb.Scene(gravity=(0, -9.81)), fb.GROUND, []
    for i in range(count):
        ends = {"a": (i, 0), "b": (i + 1, 0)}
        rod = scene.add_body((i + 0.5, 0), 1.0 + 0.1 * i, 0.1, points=ends)
        laws = {"spring": fb.Spring(spring), "damper": fb.Damper(damper)}
        scene.add_joint(fb.Revolute(last, rod["a"], **laws))
        last, centres = rod["b"], [*centres, rod.centre]
    return scene, centres


def balance_of_rods(count, spring, damper):
    """Lagrange's equations of the same rods: moments of angles, rates and accelerations."""
    masses = 1.0 + 0.1 * np.arange(count)
    reach = np.tril(np.ones((count, count)), -1) + np.eye(count) / 2  # of centres along rods
    inertia, weight = reach.T @ (masses[:, None] * reach), 9.81 * masses @ reach

    def moments(angle, rate, acceleration):
        apart = angle[:, None] - angle
        turned = (inertia * np.cos(apart)) @ acceleration + (inertia * np.sin(apart)) @ rate**2
        hinge = spring * np.diff(angle, prepend=0) + damper * np.diff(rate, prepend=0)
        return (
            turned + weight * np.cos(angle) + 0.1 * acceleration + hinge - np.append(hinge[1:], 0)
        )

    return moments


def by_complex_steps(function, x):
    return np.array([function(x + 1e-30j * e).imag / 1e-30 for e in np.eye(len(x))]).T


@pytest.mark.parametrize("count", [2, 8])
def test_rods_in_motion_have_the_roots_of_lagranges_equations(count):
    """Whose derivatives by complex steps are exact."""
    laws = {"spring": 2.0, "damper": 0.3}
    scene, centres = rods_in_a_row(count, **laws)
    swing = fb.simulate(scene, dt=5e-3, t_end=0.4)
    numbers = [centre.number for centre in centres]
    angle, rate = (rows[-1, numbers, 2] for rows in (swing.q, swing.v))
    assert abs(rate).max() > 1
    moments, still = balance_of_rods(count, **laws), np.zeros(count)
    M = by_complex_steps(lambda x: moments(angle, rate, x), still)
    a = -np.linalg.solve(M, moments(angle, rate, still))
    K = by_complex_steps(lambda x: moments(x, rate, a), angle)
    C = by_complex_steps(lambda x: moments(angle, x, a), rate)
    A = np.block([[0 * M, np.eye(count)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    expected, computed = (np.linalg.eigvals(x) for x in (A, fb.linearise(scene, swing).A))
    for root in expected:
        assert abs(computed - root).min() < 1e-10 * abs(expected).max()


def crank_and_bob(turn):
    """A pendulum on a driven crank: its scene, the bob, and A[1, 0] for a solution at a time."""
    a, b, m, J = 0.5, 0.4, 2.0, 0.1
    scene = fb.Scene(gravity=(0, -9.81))
    crank = scene.add_body((a / 2, 0), 1.0, 0.1, points={"O": (0, 0), "P": (a, 0)})
    bob = scene.add_body((a, -b), m, J, points={"P": (a, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, crank["O"], motor=turn))
    scene.add_joint(fb.Revolute(crank["P"], bob["P"]))

    def slope(solution, t):
        angle, spin, bend = turn(t), turn.deriv()(t), turn.deriv(2)(t)
        phi = solution.rotation(bob.centre)[-1]
        pivot = a * (1j * bend - spin**2) * np.exp(1j * angle) + 9.81j
        return -m * b * (pivot.imag * np.cos(phi) - pivot.real * np.sin(phi)) / (J + m * b**2)

    return scene, slope


TURN = np.polynomial.Polynomial([0, 0, 2, 30])


@pytest.mark.parametrize(
    "scheme",
    [fb.EnergyMomentum(), fb.MidPoint(order=4), fb.EnergyDecaying(), fb.Newmark(), fb.HHT()],
)
def test_a_pendulum_on_a_driven_crank_has_the_stiffness_of_the_cranks_acceleration(scheme):
    """That of the instant, not of the middle of the last step."""
    scene, slope = crank_and_bob(TURN)
    solution = fb.simulate(scene, scheme, dt=0.02, t_end=0.2)
    expected = slope(solution, 0.2)
    A = fb.linearise(scene, solution).A
    assert pytest.approx(np.array([[0, 1], [expected, 0]]), abs=1e-6 * abs(expected)) == A


def test_the_acceleration_of_a_driven_crank_is_no_round_off_after_a_very_short_step():
    scene, slope = crank_and_bob(TURN)
    solution = fb.simulate(scene, dt=0.02, t_end=0.2)
    solution = fb.simulate(scene, dt=0.02, t_end=0.2 + 1e-7, start=solution)
    expected = slope(solution, 0.2 + 1e-7)
    assert fb.linearise(scene, solution).A[1, 0] == pytest.approx(expected, rel=1e-3)


def test_natural_strains_have_their_rate_also_late_after_a_start():
    """Of a state of one row, which knows no other time than its own."""
    systems = []
    for late in (0.0, 1000.0):
        scene, beam = clamped_bar((1, 0), section(), elements=2)
        scene.add_natural_strain(beam, curvature=lambda t, late=late: 0.1 * np.sin(7 * (t - late)))
        motion = fb.Motion(scene, dt=0.01, start=fb.static(scene, t=late))
        for _ in range(3):
            motion.step()
        systems.append(fb.linearise(scene, motion.state).A)
    assert systems[1] == pytest.approx(systems[0], rel=0, abs=1e-8 * abs(systems[0]).max())


def test_a_state_of_motion_is_the_deviation_that_feedback_needs():
    scene, outputs = swinging()
    motion = fb.Motion(scene, dt=DT, outputs=outputs)
    motion.run(0.1, lambda t, y: {"torque": 3.0})
    system, before = fb.linearise(scene, motion, outputs=outputs), flat(motion.outputs)
    assert abs(system.deviation(motion)).max() < 1e-9
    motion.step({"torque": 3.01})
    moved = system.C @ system.deviation(motion)
    seen = flat(motion.outputs) - before
    assert moved == pytest.approx(seen, abs=3e-2 * abs(seen).max())
    assert system.deviation(motion.state) == pytest.approx(system.deviation(motion), abs=1e-12)


def test_a_force_that_follows_pushes_along_the_section_of_the_state():
    """Of a bent cantilever: what it moves slowly is the difference of equilibria."""
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)
    scene, beam = clamped_bar((1, 0), section, elements=4, load=(0.0, -2.0))
    scene.add_force(beam.end, fb.Input("push", factor=(1, 0)), follower=True)
    bent = fb.static(scene, load_steps=4)
    assert bent.rotation(beam.end)[-1] < -0.5
    outputs = {"tip": fb.Output("position", beam.end)}
    system = fb.linearise(scene, bent, inputs=["push"], outputs=outputs)
    gain = system.D - system.C @ np.linalg.solve(system.A, system.B)
    ends = (fb.static(scene, load_steps=4, inputs={"push": x}) for x in (1e-3, -1e-3))
    above, below = (state.position(beam.end)[-1] for state in ends)
    assert gain[:, 0] == pytest.approx((above - below) / 2e-3, rel=1e-5)


def test_the_rate_of_a_massless_node_on_which_an_input_acts_is_refused():
    scene, beam = pinned_bar((1, 0), section(rhoI=0.0, retardation=0.0), elements=2)
    scene.add_moment(beam.start, fb.Input("torque"))
    outputs = {"turn": fb.Output("rotation", beam.start), "v": fb.Output("velocity", beam.end)}
    assert fb.linearise(scene, outputs=outputs).D[0, 0] > 0  # it turns at once
    with pytest.raises(fb.SceneError, match="'spin' is the rate of a node without mass"):
        fb.linearise(scene, outputs={"spin": fb.Output("spin", beam.start)})


def roots_of_modes(scene, state, tolerance):
    """All roots of the linear system, among which are those of the lowest modes."""
    modes, roots = fb.modes(scene, state, n=6), np.linalg.eigvals(fb.linearise(scene, state).A)
    omega, zeta = modes.angular_frequencies, modes.damping_ratios
    assert (omega > 0).all()
    # Of the two roots without vibration modes have the slower.
    for root in omega * (-zeta + np.sqrt(zeta**2 - 1 + 0j)):
        assert abs(roots - root).min() < tolerance * abs(root)
    return roots


DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0}


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("inertia", [0.01, 0.0])
@pytest.mark.parametrize("joint", [fb.Slider, fb.Sleeve])
def test_about_the_reference_a_system_has_the_vibrations_of_modes(joint, inertia, degree):
    """In two elements of degree 3 some levers of a sleeve's turn are round-off."""
    size = {"elements": 2, "degree": degree}
    scene, rail = clamped_bar((1, 0), fb.Section(rhoI=inertia, **DATA), **size)
    mast = scene.add_beam([(0.6, 0), (0.6, 1)], fb.Section(rhoI=0.01, **DATA), **size)
    laws = {"spring": fb.Spring(100.0, rest=0.6), "damper": fb.Damper(0.3)}
    scene.add_joint(joint(rail, mast.start, **laws))
    if joint is fb.Slider:
        for x in (-0.4, 1.6):
            scene.add_force_between(mast.end, (x, 2.0), spring=fb.Spring(50.0, rest=2**0.5))
    roots_of_modes(scene, None, 1e-6)


@pytest.mark.parametrize("on_member", [False, True])
def test_friction_that_sticks_is_a_damped_spring(on_member):
    """Of a ball on a bed, m x'' + kt tau x' + (kt + k) x = 0, as `modes` has it."""
    m, kt, tau, k = 0.2, 1e4, 2e-3, 300.0
    scene, ball = held_body((0.02, 0.02), m, 1e-4, "rotation", gravity=(0.0, -9.81))
    for place in ((0.52, 0.02), (0.02, 0.52)):
        scene.add_force_between(ball, place, spring=fb.Spring(k, rest=0.5))
    law = {"stiffness": 1e4, "friction": fb.Coulomb(5.0, kt, damping=tau)}
    if on_member:
        section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-3)
        bed = scene.add_beam([(-0.5, 0), (0.5, 0)], section, elements=10)
        for node in bed.nodes:
            scene.clamp(node)
        scene.add_contact(ball, bed, radius=(0.01, 0.01), **law)
    else:
        scene.add_contact(ball, fb.Line((0, 0.01), normal=(0, 1)), radius=0.01, **law)
    state = fb.static(scene, load_steps=4)
    decay = kt * tau / (2 * m)
    expected = -decay + 1j * np.sqrt((kt + k) / m - decay**2)
    values = np.linalg.eigvals(fb.linearise(scene, state=state).A)
    assert abs(values - expected).min() < 1e-5 * abs(expected)
    slow = fb.modes(scene, state=state)
    assert abs(slow.damping_ratios - decay / abs(expected)).min() < 1e-5


@pytest.mark.parametrize("kind", ["guide", "floor", "bed"])
def test_friction_that_slips_has_no_stiffness_and_no_damping(kind):
    """A block of 1 kg on a spring, pushed until it slips: x'' + k x = 0."""
    k, mu, kt, push, normal = 50.0, 0.3, 100.0, 20.0, 10.0
    scene, friction = fb.Scene(gravity=(0, -10.0)), fb.Coulomb(mu, kt, damping=0.2)
    block = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    if kind == "guide":
        guide = fb.Prismatic(fb.GROUND, block, axis=(1, 0), spring=fb.Spring(k), friction=friction)
        scene.add_joint(guide)
    else:
        scene.fix(block, "rotation")
        far = 1e4 if kind == "floor" else 1e6  # springs that do not turn
        scene.add_force_between(block, (-far, 0.0), spring=fb.Spring(k, rest=far))
        floor, radius, stiffness = fb.Line((0, 0), normal=(0, 1)), 0.0, 100.0
        if kind == "bed":
            section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-3)
            floor = scene.add_beam([(-1, -0.02), (1, -0.02)], section, elements=40)
            radius, stiffness, held = (0.01, 0.01), 1e6, 2000.0
            normal *= stiffness / (stiffness + held)
            scene.add_force_between(block, (0.0, far), spring=fb.Spring(held, rest=far))
            for node in floor.nodes:
                scene.clamp(node)
        scene.add_contact(block, floor, stiffness, radius=radius, friction=friction)
    scene.add_force(block, (push, 0.0))
    scene.add_force(block, fb.Input("force", factor=(1, 0)))
    state = fb.static(scene, load_steps=4)
    assert state.displacement(block)[-1, 0] == pytest.approx((push - normal * mu) / k, rel=1e-4)
    outputs = {"x": fb.Output("displacement", block, "x")}
    system = fb.linearise(scene, state=state, outputs=outputs)
    values = np.linalg.eigvals(system.A)
    assert abs(values - 1j * np.sqrt(k)).min() < 1e-4
    f = 1.0
    response = fb.frequency_response(scene, (block, (1.0, 0.0)), block, [f], state)
    expected = 1 / (k - (2 * np.pi * f) ** 2)
    assert response.values[0, 0] == pytest.approx(expected, rel=1e-4)
    s = 2j * np.pi * f * np.eye(len(system.A))
    transfer = system.C @ np.linalg.solve(s - system.A, system.B) + system.D
    assert transfer[0, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("retardation", [1e-2, 1e2, 1e6])
def test_a_cantilever_that_creeps_slowly_ends_at_its_elastic_deflection(retardation):
    """L^3 / 3 EI + L / GA, and at each frequency as `frequency_response` has it."""
    scene, beam = clamped_bar((1, 0), section(retardation=retardation), 4, 3)
    scene.add_force(beam.end, fb.Input("push", factor=(0, 1)))
    outputs = {"y": fb.Output("displacement", beam.end, "y")}
    system, f = fb.linearise(scene, outputs=outputs), np.array([0.0, 0.1]) / retardation
    poles = [2j * np.pi * x * np.eye(len(system.A)) - system.A for x in f]
    computed = [(system.C @ np.linalg.solve(pole, system.B) + system.D).item() for pole in poles]
    assert computed[0] == pytest.approx(1 / 60 + 1e-4, rel=1e-8)
    spectra = fb.frequency_response(scene, (beam.end, (0, 1)), beam.end, f).component("y")
    assert computed == pytest.approx(spectra, rel=1e-8)


@pytest.mark.parametrize("elements", [4, 40])
def test_a_rod_in_a_sleeve_on_the_ground_has_the_frequencies_of_its_modes(elements):
    """Forces turn it about the sleeve: part of its stiffness is that of its coupling."""
    made = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.01)
    scene, rod = one_bar((1, 0.3), made, elements, gravity=(0, -9.81))
    scene.add_joint(fb.Sleeve(rod, fb.GROUND, fraction=0.6, spring=fb.Spring(300.0, rest=0.4)))
    scene.add_force(rod.end, (3.0, -20.0))
    state = fb.static(scene)
    values = np.linalg.eigvals(fb.linearise(scene, state=state).A)
    computed = np.sort(values.imag[values.imag > 0])[:3]
    assert computed == pytest.approx(fb.modes(scene, state, n=3).angular_frequencies, rel=1e-6)


@pytest.mark.parametrize("EA", [1e6, 1e10])
def test_turns_without_mass_are_not_damped_by_the_motion_of_a_state(EA):
    """A damped hinge between two arms that swing, in seconds, milliseconds and hours."""

    def roots(unit):
        force = unit**2
        rod = fb.Section(EA=EA * force, GA=EA * force, EI=1e-3 * EA * force, rhoA=1.0)
        scene, upper = clamped_bar((1, 0), rod, elements=2, gravity=(0, -9.81 * force))
        lower = scene.add_beam([(1, 0), (2, 0)], rod, elements=2)
        hinge = {"spring": fb.Spring(20 * force), "damper": fb.Damper(1.0 * unit)}
        scene.add_joint(fb.Revolute(upper.end, lower.start, **hinge))
        swing = fb.simulate(scene, dt=5e-3 / unit, t_end=0.1 / unit)
        computed = np.linalg.eigvals(fb.linearise(scene, swing).A) / unit
        return np.sort(abs(computed))

    expected = roots(1.0)
    # Eight displacements with mass, and the turn of the hinge's other side with damping alone.
    assert len(expected) == 17 and expected[0] > 7
    for unit in (1e-3, 3600.0):
        assert roots(unit) == pytest.approx(expected, rel=1e-5)


def test_at_a_critical_point_pulls_act_with_their_load_factor():
    """A mass on a spring, pushed aside: x'' + 3 l x' + (4 - 8 l) x = 0 at the load factor l."""
    scene, body = held_body((0, 0), mass=1.0, inertia=1.0)
    scene.add_joint(fb.Prismatic(fb.GROUND, body, axis=(1, 0), spring=fb.Spring(4.0)))
    scene.add_force_between(body, (0, -1), force=-8.0)
    scene.add_force_between(body, (-1, 0), force=lambda r, rate, t: 3 * rate)
    path = fb.static(scene, load_steps=4)
    (point,) = path.critical_points
    assert point.load_factor == pytest.approx(0.5, rel=1e-6)
    for state, roots in ((point.solution, [-1.5, 0]), (path, [-4, 1]), (None, [-1.5, -1.5])):
        computed = np.linalg.eigvals(fb.linearise(scene, state).A)
        assert np.sort(computed.real) == pytest.approx(roots, abs=1e-5)
        expected = 7**0.5 / 2 if state is None else 0
        assert abs(computed.imag).max() == pytest.approx(expected, abs=1e-5)
        (mode,) = fb.modes(scene, state, n=1).eigenvalues
        assert abs(computed - mode).min() < 1e-5


def test_at_a_critical_point_forces_that_follow_have_their_load_factor():
    """The pair of Beck's column that meets, and a column on a foundation that pushes it aside."""
    made = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-4)
    scene, beck = clamped_bar((0, 1), made, elements=4, degree=2)
    load = scene.add_force(beck.end, (0, -24.0), follower=True)
    (flutter,) = fb.static(scene, load_steps=6).critical_points
    growth = np.linalg.eigvals(fb.linearise(scene, flutter.solution).A).real
    assert flutter.kind == "flutter" and growth.max() < 0.1
    scene.remove(load)
    scene.add_virtual_work(lambda step: 20 * step.load_factor * ufl.dot(step.u, step.virtual_u))
    divergence = fb.static(scene, load_steps=4).critical_points[0].solution
    lowest = np.sort(abs(np.linalg.eigvals(fb.linearise(scene, divergence).A)))
    assert lowest[1] < 1e-2 and lowest[2] > 10


def test_at_a_critical_point_added_works_damp_with_their_load_factor():
    """In modes and linear systems, as works that have this factor at all loads."""

    def pushed(factor):
        made = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-4)
        scene, _ = clamped_bar((0, 1), made, elements=4, degree=2)

        def work(step):
            push = 20 * ufl.dot(step.u, step.virtual_u) - 3 * ufl.dot(step.v, step.virtual_u)
            return (step.load_factor if factor is None else factor) * push

        scene.add_virtual_work(work)
        return scene

    scene = pushed(None)
    point = fb.static(scene, load_steps=4).critical_points[0]
    assert 0.3 < point.load_factor < 0.9
    expected = fb.modes(pushed(point.load_factor), n=4).eigenvalues[1:]
    assert (expected.real < -0.1).all()
    assert fb.modes(scene, point.solution, n=4).eigenvalues[1:] == pytest.approx(expected, rel=1e-6)
    assert_has_eigenvalues(fb.linearise(scene, point.solution).A, expected, 1e-6)


def test_a_long_chain_of_elements_has_the_frequencies_of_its_modes():
    # Its mass and stiffness have few entries; without inputs, outputs and motors.
    scene, beam = clamped_bar((1, 0), section(retardation=0.0), elements=300)
    A = fb.linearise(scene, inputs=[], outputs={}).A
    stiffness = A[900:, :900]
    assert not A[900:, 900:].any()
    assert np.array_equal(A[:900, 900:], np.eye(900))
    inverse = scipy.linalg.lu_factor(-stiffness)
    x = np.ones((900, 6))
    x[::2, 1], x[::3, 2], x[:450, 3], x[450:, 4], x[1::4, 5] = 0, -1, 0, 2, 3
    for _ in range(60):  # inverse iteration
        x, _ = np.linalg.qr(scipy.linalg.lu_solve(inverse, x))
    omega = np.sqrt(np.sort(np.linalg.eigvals(x.T @ -stiffness @ x).real))
    assert omega[:3] == pytest.approx(2 * np.pi * fb.modes(scene, n=3).frequencies, rel=1e-6)


@pytest.mark.parametrize("support", ["clamp", "pin", "none"])
@pytest.mark.parametrize(("stiffness", "is_thin"), [(1e9, False), (1e14, True)])
def test_beams_so_thin_that_their_stiffness_has_few_digits_are_told_as_by_modes(
    support, stiffness, is_thin, caplog
):
    """The bound is 0.08 for a clamped one of 32 elements with EA L^2/EI = 1e12."""
    section = fb.Section(EA=stiffness, GA=stiffness, EI=1.0, rhoA=1.0, rhoI=1e-4)
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0.3)], section, elements=32)
    if support != "none":
        getattr(scene, support)(beam.start)
    scene.add_force(beam.end, fb.Input("push", factor=(0.0, 1.0)))
    for find in (fb.modes, fb.linearise):
        caplog.clear()
        find(scene)
        assert ("few correct digits" in caplog.text) == is_thin
