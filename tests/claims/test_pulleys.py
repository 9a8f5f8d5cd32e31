"""Ropes over pulleys with a radius, and on drums: closed forms, and lengths by taut polygons."""

import numpy as np
import pytest
from scenes import assert_refused, held_body
from scipy.integrate import solve_ivp

import fx_beam as fb

G = 9.81


def taut(a, b, centre, radius, left):
    """Length of a rope from a to b about a circle on its left or right, and its arc [rad].

    By complex numbers: tangents from both points, and the angle between the points of contact.
    """
    turn = 1 if left else -1
    to_a, to_b = complex(*a) - complex(*centre), complex(*b) - complex(*centre)
    lean_a, lean_b = (np.arccos(radius / abs(arm)) for arm in (to_a, to_b))
    touch_a = to_a / abs(to_a) * np.exp(1j * turn * lean_a)
    touch_b = to_b / abs(to_b) * np.exp(-1j * turn * lean_b)
    arc = turn * np.angle(touch_b / touch_a) % (2 * np.pi)
    free = sum(np.sqrt(abs(arm) ** 2 - radius**2) for arm in (to_a, to_b))
    return free + radius * arc, arc


def atwood(spring, inertia=None):
    """Two loads over a pulley that turns freely, or with an inertia under two ropes."""
    scene = fb.Scene(gravity=(0, -G))
    sides = zip((-0.2, 0.2), (1.0, 1.5), strict=True)
    loads = [scene.add_body((x, -1), mass=mass).centre for x, mass in sides]
    for load in loads:
        scene.fix(load, "x", "rotation")
    if inertia is None:
        pulley = fb.Pulley((0, 0), 0.2, side="right")
        return scene, loads, None, [scene.add_rope([loads[0], pulley, loads[1]], spring)]
    wheel = scene.add_body((0, 0), 1.0, inertia).centre
    scene.pin(wheel)
    drum = fb.Pulley(wheel, 0.2, side="right")
    ropes = [scene.add_rope([loads[0], drum], spring), scene.add_rope([drum, loads[1]], spring)]
    return scene, loads, wheel, ropes


# -- Lengths ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("height", [0.7, -0.4])
def test_a_rope_over_a_circle_is_as_long_as_its_tangents_and_its_arc(side, height):
    scene = fb.Scene()
    ball = scene.add_body((2, 0.3), mass=1.0).centre
    pulley = fb.Pulley((1, height), 0.2, side=side)
    exact, arc = taut((0, 0), (2, 0.3), (1, height), 0.2, side == "left")
    if arc > 1.5 * np.pi:  # it would have to push the rope
        with pytest.raises(fb.SceneError, match="on its other side, or does not touch"):
            scene.add_rope([(0, 0), pulley, ball], fb.Spring(1.0))
        return
    rope = scene.add_rope([(0, 0), pulley, ball], fb.Spring(1.0))
    assert rope.length_at_start == pytest.approx(exact, rel=1e-12)
    outline = rope.outline(np.array([(0, 0), (1, height), (2, 0.3)]))
    assert np.hypot(*np.diff(outline, axis=0).T).sum() == pytest.approx(exact, rel=1e-3)


def test_a_crossed_belt_has_the_length_of_the_textbook():
    scene = fb.Scene()
    wheels = [scene.add_body((x, 0), 1.0, 0.1).centre for x in (0, 2.0)]
    # Around the second pulley from the top of the first one to its bottom.
    (R, r), c = (0.3, 0.2), 2.0
    for side, sum_or_difference in (("right", R - r), ("left", R + r)):
        points = [fb.Pulley(wheels[0], R, "right"), fb.Pulley(wheels[1], r, side)]
        rope = scene.add_rope([*points, fb.Pulley(wheels[0], R, "right")], fb.Spring(1.0))
        lean = np.arcsin(sum_or_difference / c)
        arc = np.pi - 2 * lean if side == "right" else np.pi + 2 * lean
        exact = 2 * np.sqrt(c**2 - sum_or_difference**2) + r * arc
        assert rope.length_at_start == pytest.approx(exact, rel=1e-12)


# -- Motions ---------------------------------------------------------------------------------------


def test_a_pulley_without_friction_lets_loads_fall_as_atwood_says():
    tension = 2 * 1.0 * 1.5 * G / 2.5
    scene, loads, _, ropes = atwood(fb.Spring(1e5, rest=2 + 0.2 * np.pi - tension / 1e5))
    fall = fb.simulate(scene, dt=1e-3, t_end=0.4)
    assert fall.position(loads[0])[:, 1] == pytest.approx(-1 + 0.2 * G * fall.t**2 / 2, abs=1e-11)
    assert fall.joint(ropes[0]).force[1:] == pytest.approx(tension, rel=1e-9)
    assert fall.joint(ropes[0]).wrap[:, 1] == pytest.approx(np.pi, rel=1e-12)


def test_a_pulley_with_inertia_on_which_the_rope_sticks_has_two_tensions():
    inertia, k = 0.03, 1e6
    a = 0.5 * G / (2.5 + inertia / 0.2**2)
    pulls = np.array([1.0 * (G + a), 1.5 * (G - a)])
    scene, loads, wheel, ropes = atwood(fb.Spring(k, rest=1 - pulls.mean() / k), inertia=inertia)
    fall = fb.simulate(scene, dt=1e-3, t_end=0.5)
    rise = a * fall.t**2 / 2
    assert fall.position(loads[0])[:, 1] == pytest.approx(-1 + rise, abs=2e-6)
    assert fall.rotation(wheel) == pytest.approx(-rise / 0.2, abs=2e-5)
    for rope, pull in zip(ropes, pulls, strict=True):
        assert fall.joint(rope).force[1:].mean() == pytest.approx(pull, rel=2e-3)
    assert abs(fall.energy.balance_error).max() < 1e-12


def test_a_winch_winds_many_turns_and_does_the_work_of_its_load():
    scene, load = held_body((0.2, -10), 5.0, 0.0, "x", "rotation", gravity=(0, -G))
    drum = scene.add_body((0, 0), 1.0, 0.03).centre
    motor = fb.Revolute(fb.GROUND, drum, motor=lambda t: 5 * t**2)
    motor = scene.add_joint(motor)
    rope = scene.add_rope([fb.Pulley(drum, 0.2, "right"), load], fb.Spring(1e6, 10 - 59.05 / 1e6))
    lift = fb.simulate(scene, fb.EnergyDecaying(), dt=1e-3, t_end=2.0)
    assert lift.rotation(drum)[-1] == pytest.approx(20.0, rel=1e-12)
    assert lift.position(load)[-1, 1] == pytest.approx(-10 + 0.2 * 20, abs=1e-4)
    late = lift.t > 1.0
    assert lift.joint(rope).force[late].mean() == pytest.approx(5 * (G + 2), rel=1e-2)
    moment = lift.joint(motor).motor_force[late].mean()
    assert moment == pytest.approx(0.2 * 5 * (G + 2) + 0.3, rel=1e-2)
    energy = lift.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.work.max()


def test_a_string_that_winds_up_on_a_post_moves_as_lagrange_says_to_second_order():
    """A ball on a string that lies on a circle: a pendulum of the length L + R a."""
    R, L, k = 0.3, 1.5, 1e8
    errors = []
    for dt in (0.02, 0.01):
        scene, ball = held_body((R, -L), 1.0, 0.0, "rotation", gravity=(0, -G))
        string = fb.Spring(k, rest=1 + R * np.pi / 2 + L)
        scene.add_rope([(-1, R), fb.Pulley((0, 0), R, "right"), ball], string)
        scene.set_velocity(ball, (-3.0, 0.0))
        motion = fb.simulate(scene, dt=dt, t_end=0.8)

        # T = (L + R a)^2 a'^2 / 2 for the angle a of the string from the vertical.
        def rates(_, y):
            a, w = y
            return w, -(R * w * w + G * np.sin(a)) / (L + R * a)

        options = {"t_eval": motion.t, "rtol": 1e-11, "atol": 1e-12}
        a = solve_ivp(rates, (0, motion.t[-1]), (0, -3.0 / L), **options).y[0]
        c, s, free = np.cos(a), np.sin(a), L + R * a
        exact = np.stack([R * c + free * s, R * s - free * c], axis=1)
        errors.append(abs(motion.position(ball) - exact).max())
        assert abs(motion.energy.balance_error).max() < 1e-8
    assert errors[1] < 2e-3
    assert 3.3 < errors[0] / errors[1] < 4.6


def tether(order, radius=0.05, length=1.0, speed=2.0, side="left"):
    """A ball on a rope that winds on a pole: turns to the left, or mirrored to the right."""
    sign = 1 if side == "left" else -1
    scene, ball = held_body((length, -sign * radius), 0.3, 0.0, "rotation")
    scene.set_velocity(ball, (0, sign * speed))
    if order == "fixed":
        centre = (0.0, 0.0)
    else:
        centre = scene.add_body((0, 0), 1.0, 1.0).centre
        scene.fix(centre, "x", "y", "rotation")
    points = [fb.Pulley(centre, radius, side), ball]
    if order == "last":
        other = "right" if side == "left" else "left"
        points = [ball, fb.Pulley(centre, radius, other)]
    return scene, ball, scene.add_rope(points, fb.Spring(1e5, rest=length))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("order", ["first", "last", "fixed"])
def test_a_tethered_ball_winds_on_its_pole_over_turns_at_its_speed(order, side):
    """Speed v stays, and the free length falls: b^2 = L^2 - 2 R v t."""
    scene, ball, rope = tether(order, side=side)
    seen = fb.Motion(scene, dt=1e-3, outputs={"length": fb.Output("length", rope)})
    motion = fb.simulate(scene, dt=1e-3, t_end=4.6)
    sign, free = (1 if side == "left" else -1), np.sqrt(1 - 2 * 0.05 * 2 * motion.t)
    angle = (1 - free) / 0.05
    assert angle[-1] > 4 * np.pi
    exact = np.stack([free * np.cos(angle) + 0.05 * np.sin(angle), free * np.sin(angle)], axis=1)
    exact[:, 1] -= 0.05 * np.cos(angle)
    assert motion.position(ball) == pytest.approx(exact * [1, sign], abs=2e-3)
    assert np.hypot(*motion.velocity(ball).T) == pytest.approx(2.0, abs=1e-3)
    assert motion.joint(rope).length == pytest.approx(1.0, abs=1e-4)
    wrap = motion.joint(rope).wrap[:, -1 if order == "last" else 0]
    assert wrap == pytest.approx(angle, abs=2e-3)
    assert abs(motion.energy.balance_error).max() < 1e-12
    for _ in range(2000):
        last = seen.step()["length"]
    assert last == pytest.approx(motion.joint(rope).length[2000], rel=1e-12)


def test_half_turns_of_spans_are_kept_in_files_and_by_a_start(tmp_path):
    scene, ball, rope = tether("first")
    whole = fb.simulate(scene, dt=1e-3, t_end=4.0)
    first = fb.simulate(scene, dt=1e-3, t_end=2.4)
    first.save(tmp_path / "first.npz")
    for start in (first, fb.load(tmp_path / "first.npz")):
        second = fb.simulate(scene, dt=1e-3, t_end=4.0, start=start)
        assert second.position(ball)[-1] == pytest.approx(whole.position(ball)[-1], abs=1e-9)
        joined = start.then(second).joint(rope)
        assert joined.length == pytest.approx(whole.joint(rope).length, abs=1e-9)
        assert joined.wrap == pytest.approx(whole.joint(rope).wrap, abs=1e-8)
    often = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=4e-3, t_end=4.0)
    rows = fb.simulate(scene, dt=1e-3, t_end=4.0, record=fb.Record(every=500))
    assert often.joint(rope).wrap[-1] == pytest.approx(whole.joint(rope).wrap[-1], abs=1e-3)
    assert rows.joint(rope).wrap[-1] == pytest.approx(whole.joint(rope).wrap[-1], abs=1e-9)


@pytest.mark.parametrize("turn", [-2.9, -3.4, -9.0])
def test_the_end_of_a_rope_winds_on_a_pulley_and_lifts_a_weight_by_its_arc(turn):
    R, r = 1.0, 0.1
    scene, end = held_body((R, 0), 1.0, 0.0, "rotation", gravity=(0, -G))

    def angle(t):
        return turn * (t - np.sin(2 * np.pi * t) / (2 * np.pi))

    scene.prescribe(end, x=lambda t: R * (np.cos(angle(t)) - 1), y=lambda t: R * np.sin(angle(t)))
    weight = scene.add_body((-r, -2.0), 2.0).centre
    scene.fix(weight, "x", "rotation")
    length = np.sqrt(R * R - r * r) + r * (np.pi - np.arccos(r / R)) + 2.0
    spring = fb.Spring(1e4, rest=length - 2 * G / 1e4)
    points = [weight, fb.Pulley((0, 0), r, "right"), end]
    rope = scene.add_rope(points, spring, fb.Damper(50.0))
    lift = fb.simulate(scene, dt=1e-3, t_end=1.0)
    assert lift.displacement(weight)[-1, 1] == pytest.approx(-turn * r, abs=2e-4)
    pull = lift.joint(rope)
    assert pull.wrap[-1, 1] - pull.wrap[0, 1] == pytest.approx(-turn, abs=1e-9)
    assert abs(np.diff(pull.length)).max() < 1e-4
    assert abs(lift.energy.balance_error).max() < 1e-12


# -- Statics, vibrations, derivatives --------------------------------------------------------------


def test_a_block_with_sheaves_hangs_and_vibrates_as_its_parts_say():
    """Two parts of the rope, vertical on both sides of the sheave: stiffness 4 k."""

    def build(x):
        radius = 0.1 * x[3]
        scene, load = held_body((radius, -2), 20 * x[1], 0.0, "x", "rotation", gravity=(0, -G))
        points = [(0, 0), fb.Pulley(load, radius), (2 * radius, 0)]
        length = 4.0 * x[2] + 0.1 * np.pi
        rope = scene.add_rope(points, fb.Spring(1e4 * x[0]), length=length)
        return scene, {"y": fb.Output("position", load, "y")}, load, rope

    scene, _, load, rope = build(np.ones(4))
    hanging = fb.static(scene)
    tension = 20 * G / 2
    assert hanging.joint(rope).force[-1] == pytest.approx(tension, rel=1e-9)
    assert hanging.position(load)[-1, 1] == pytest.approx(-2 - tension / 2e4, rel=1e-10)
    w = fb.modes(scene, hanging, n=1).angular_frequencies[0]
    assert w == pytest.approx(np.sqrt(4e4 / 20), rel=1e-8)
    run = fb.StaticResponse(lambda x: build(x)[:2])
    run(np.ones(4))
    exact = [tension / 2e4, -tension / 2e4, -2.0, 0.1 * np.pi / 2]
    assert run.jacobian()["y"][-1] == pytest.approx(exact, rel=1e-6)


def test_a_drum_on_a_rope_is_a_torsion_spring_in_every_analysis():
    k, R, J = 500.0, 0.2, 0.03
    scene, drum = held_body((0, 0), 1.0, J)
    scene.pin(drum)
    rope = scene.add_rope([fb.Pulley(drum, R, "right"), (R, -1)], fb.Spring(k, rest=1.0))
    w = fb.modes(scene, n=1).angular_frequencies[0]
    assert w == pytest.approx(np.sqrt(k * R**2 / J), rel=1e-9)
    scene.add_moment(drum, 0.3)
    held = fb.static(scene)
    assert held.rotation(drum)[-1] == pytest.approx(0.3 / (k * R**2), rel=1e-9)
    assert held.joint(rope).force[-1] == pytest.approx(0.3 / R, rel=1e-9)
    assert held.joint(rope).length[-1] == pytest.approx(1 + 0.3 / R / k, rel=1e-12)


# -- What a rope cannot do -------------------------------------------------------------------------


def lifted(speed=1.0, **length):
    scene, ball = held_body((2, 0.0), 1.0, 0.0, "rotation")
    points = [(0, 0), fb.Pulley((1, -0.1), 0.2, "right"), ball]
    rope = scene.add_rope(points, **length)
    scene.set_velocity(ball, (0.0, speed))
    return scene, rope


def test_a_rope_that_leaves_its_pulley_and_pulls_ends_the_motion_with_a_sentence():
    scene, rope = lifted(spring=fb.Spring(1.0, rest=2.0))
    with pytest.raises(fb.StepError, match="leaves the pulley at point 1 at t = 0.2") as failed:
        fb.simulate(scene, dt=0.01, t_end=1.0)
    assert failed.value.failure.kind == "off the pulley"
    wrap = failed.value.solution.joint(rope).wrap[:, 1]
    first = np.argmax(wrap < 0)
    assert failed.value.time == pytest.approx(0.01 * first)
    scene.add_force(scene.nodes[0], (0.0, 5.0))
    with pytest.raises(fb.StepError, match="leaves the pulley"):
        fb.static(scene)


def test_a_motion_and_a_response_end_as_well_where_a_rope_leaves_its_pulley():
    """The motion stays where the rope is on its pulley still."""
    spring = fb.Spring(1.0, rest=2.0)
    with pytest.raises(fb.StepError) as failed:
        fb.simulate(lifted(spring=spring)[0], dt=0.01, t_end=1.0)
    motion = fb.Motion(lifted(spring=spring)[0], dt=0.01)
    with pytest.raises(fb.StepError, match="leaves the pulley at point 1 at t = 0.2"):
        motion.run(1.0)
    assert motion.t == pytest.approx(failed.value.time - 0.01)

    def build(x):
        scene, rope = lifted(spring=fb.Spring(x[0], rest=2.0))
        return scene, {"place": fb.Output("position", scene.nodes[0])}

    with pytest.raises(fb.StepError, match="leaves the pulley at point 1 at t = 0.2"):
        fb.Response(build, dt=0.01, t_end=1.0)([1.0])


def test_a_periodic_motion_is_not_shown_where_a_rope_leaves_its_pulley():
    scene, _ = lifted(0.0, spring=fb.Spring(1.0, rest=2.0))
    ball = scene.nodes[0]
    scene.add_spring(ball, x=fb.Spring(9.0), y=[fb.Spring(5.0), fb.Damper(0.5)])
    load = scene.add_force(ball, lambda t: (0.0, 0.1 * np.cos(t)))
    assert abs(fb.periodic(scene, period=2 * np.pi).solution.q).max() < 0.1
    scene.change(load, lambda t: (0.0, 2.0 * np.cos(t)))
    motion = fb.periodic(scene, period=2 * np.pi)
    with pytest.raises(fb.StepError, match="leaves the pulley"):
        print(motion.solution)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT()], ids=str)
def test_a_load_that_is_hoisted_into_its_drum_ends_with_a_sentence(scheme):
    scene, R = fb.Scene(), 0.1
    drum, load = (scene.add_body(place, 1.0, 0.1).centre for place in ((0, 0), (R / 2, -0.3)))
    scene.fix(drum, "x", "y")
    scene.prescribe(drum, rotation=lambda t: 5 * t)
    scene.fix(load, "x", "rotation")
    points = [fb.Pulley(drum, R, side="right"), load]
    rope = scene.add_rope(points, spring=fb.Spring(1e4), taut=True)
    with pytest.raises(fb.StepError, match="comes into the circle") as failed:
        fb.simulate(scene, scheme, dt=1e-3, t_end=1.0)
    assert str(rope) in str(failed.value)


def test_a_slack_rope_may_leave_its_pulley():
    scene, rope = lifted(spring=fb.Spring(1.0), length=4.0)
    motion = fb.simulate(scene, dt=0.01, t_end=0.5).joint(rope)
    assert motion.wrap[:, 1].min() < 0 and not motion.force.any()
    steps = fb.Motion(scene, dt=0.01, outputs={"force": fb.Output("force", rope)})
    assert steps.run(0.5)["force"] == 0

    def build(x):
        scene, rope = lifted(spring=fb.Spring(x[0]), length=4.0)
        return scene, {"place": fb.Output("position", scene.nodes[0])}

    assert len(fb.Response(build, dt=0.01, t_end=0.5)([1.0])[0]) == 51


def test_what_is_no_pulley_is_refused():
    scene = fb.Scene()
    ball = scene.add_body((1, 0), mass=1.0).centre
    spring = fb.Spring(1.0)
    for words, call in (
        ("finite and positive", lambda: fb.Pulley(ball, 0.0)),
        ("left or right", lambda: fb.Pulley(ball, 0.1, side="top")),
        (
            "no tangent",
            lambda: scene.add_rope([fb.Pulley((0, 0), 0.5), fb.Pulley(ball, 0.7, "right")], spring),
        ),
        (
            "on its other side",
            lambda: scene.add_rope([(0, 0), fb.Pulley((0.5, 0.5), 0.1), ball], spring),
        ),
        ("2 numbers", lambda: scene.add_rope([(0, 0), fb.Pulley("here", 0.1), ball], spring)),
    ):
        assert_refused(words, call)
    assert not scene.forces_between


def test_the_length_and_its_rate_are_outputs_over_pulleys_and_drums():
    """The rate is the slope of the length, of second order; in a `Motion` as in a solution."""
    scene = fb.Scene(gravity=(0, -9.81))
    drum, wheel, load = (
        scene.add_body(place, mass=1.0, inertia=0.05).centre
        for place in [(0, 0.1), (1.0, 0.3), (2.2, -0.8)]
    )
    scene.fix(load, "rotation")
    scene.pin(drum)
    points = [fb.Pulley(drum, 0.3, side="right"), fb.Pulley(wheel, 0.2, side="right"), load]
    rope = scene.add_rope(points, spring=fb.Spring(50.0))
    scene.set_velocity(drum, spin=-1.0)
    scene.set_velocity(wheel, (0.3, 0.5), 2.0)
    errors = []
    for dt in (2e-3, 1e-3):
        solution = fb.simulate(scene, dt=dt, t_end=0.1)
        length, rate = solution.joint(rope).length, solution.joint(rope).rate
        slope = (length[2:] - length[:-2]) / (2 * dt)
        errors.append(abs(slope - rate[1:-1]).max() / abs(rate).max())
    assert errors[1] < 1e-3
    assert errors[1] < 0.3 * errors[0]
    outputs = {name: fb.Output(name, rope) for name in ("length", "rate")}
    motion = fb.Motion(scene, dt=1e-3, outputs=outputs)
    for _ in range(100):
        last = motion.step()
    assert last["length"] == pytest.approx(length[-1], rel=1e-9)
    assert last["rate"] == pytest.approx(rate[-1], rel=1e-9)

    # The rate is the derivative of the length by time: C' = C A.
    system = fb.linearise(scene, outputs=outputs)
    assert system.C[1] == pytest.approx(system.C[0] @ system.A, abs=1e-9)
    assert abs(system.C[0]).max() > 0.5


def test_outputs_of_a_rope_have_their_derivatives_beyond_half_a_turn():
    """By differences; the length depends on the radius with all turns of the span."""

    def build(x):
        scene, ball = held_body((1.0, -0.05), 0.3 * x[0], 1.0, "rotation")
        scene.set_velocity(ball, (0, 2.0 * x[1]))
        points = [fb.Pulley((0, 0), 0.05 * x[2], "left"), ball]
        rope = scene.add_rope(points, fb.Spring(1e4, rest=x[3]), fb.Damper(0.5))
        names = {"position": ball, "length": rope, "force": rope}
        return scene, {name: fb.Output(name, part) for name, part in names.items()}

    run = fb.Response(build, dt=2e-3, t_end=2.4)
    _, y = run(np.ones(4))
    assert y["position"][-1, 0] ** 2 + y["position"][-1, 1] ** 2 < 0.8
    jacobian = run.jacobian()
    for i, step in enumerate(1e-5 * np.eye(4)):
        ends = [run(np.ones(4) + sign * step)[1] for sign in (1, -1)]
        for name, slopes in jacobian.items():
            expected = (ends[0][name] - ends[1][name]) / 2e-5
            error = abs(slopes[..., i] - expected).max()
            assert error < 1e-5 * abs(expected).max() + 1e-8, (name, i)


@pytest.mark.parametrize("sides", [("left", "left"), ("left", "right"), ("right", "right")])
def test_bodies_that_circle_each_other_on_drums_of_one_rope_keep_energy_and_momenta(sides):
    scene, points = fb.Scene(), []
    for sign, side, radius, spin in zip((-1, 1), sides, (0.1, 0.06), (2.0, 1.0), strict=True):
        body = scene.add_body((0.5 * sign, 0.1), 1.0 + 0.5 * sign, 0.05).centre
        scene.set_velocity(body, (0.2, 3.0 * sign), spin=spin)
        points.append(fb.Pulley(body, radius, side))
    rope = scene.add_rope(points, fb.Spring(200.0, rest=0.8))
    circle = fb.simulate(scene, dt=2e-3, t_end=4.0)
    assert abs(circle.turns_of_line[rope.number]).max() >= np.pi - 1e-9
    assert abs(np.diff(circle.joint(rope).length)).max() < 0.02
    assert abs(circle.energy.balance_error).max() < 1e-11
    for momentum in (circle.linear_momentum, circle.angular_momentum):
        assert abs(momentum - momentum[0]).max() < 1e-11
