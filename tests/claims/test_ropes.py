"""Ropes over several points: closed forms of tension, length, frequencies, work and momenta."""

import numpy as np
import pytest
from scenes import assert_refused, held_body
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import fx_beam as fb

G = 9.81


def block(k=1e5, length=4.0, **more):
    """A load at a loose pulley between two places 0.2 m apart, which moves up and down."""
    scene, load = held_body((0.1, -2), 20.0, 0.0, "x", "rotation", gravity=(0, -G))
    rope = scene.add_rope([(0, 0), load, (0.2, 0)], fb.Spring(k), length=length, **more)
    return scene, load, rope


def settled(k=1e5, length=4.0):
    """Depth and tension at rest, by bisection: 2 T cos(half the angle) = m g."""
    low, high = 0.0, 10.0
    for _ in range(200):
        depth = (low + high) / 2
        side = np.hypot(0.1, depth)
        tension = max(0.0, k * (2 * side - length))
        low, high = (depth, high) if 2 * tension * depth / side < 20.0 * G else (low, depth)
    return depth, tension


# -- Equilibrium and small vibrations ------------------------------------------------------------


@pytest.mark.parametrize("length", [3.0, 4.0, 4.5])  # stretched, about as long, and slack
def test_a_loose_pulley_hangs_at_the_depth_of_the_closed_form(length):
    scene, load, rope = block(k=1e4, length=length)
    depth, tension = settled(k=1e4, length=length)
    hanging = fb.static(scene)
    assert hanging.position(load)[-1] == pytest.approx([0.1, -depth], rel=1e-9)
    pull = hanging.joint(rope)
    assert pull.force[-1] == pytest.approx(tension, rel=1e-7)
    assert pull.length[-1] == pytest.approx(2 * np.hypot(0.1, depth), rel=1e-12)
    # Stiffness 4 k cos^2 of the stretch, and 2 T sin^2 / s of the turn of both sides.
    side = np.hypot(0.1, depth)
    cosine, sine = depth / side, 0.1 / side
    stiffness = 4 * 1e4 * cosine**2 + 2 * tension * sine**2 / side
    w = fb.modes(scene, hanging, n=1).angular_frequencies[0]
    assert w == pytest.approx(np.sqrt(stiffness / 20.0), rel=1e-7)


@pytest.mark.parametrize("parts", [2, 3, 5])
def test_a_pulley_block_divides_the_weight_by_its_parts(parts):
    """The parts are at one place: the block and the fixed one are there several times."""
    scene, load = held_body((0, -2), 10.0, 0.0, "rotation", gravity=(0, -G))
    points = [load if i % 2 else (0, 0) for i in range(parts + 1)]
    rope = scene.add_rope(points, fb.Spring(1e5), length=2.0 * parts)
    hanging = fb.static(scene)
    tension = 10.0 * G / parts
    assert hanging.joint(rope).force[-1] == pytest.approx(tension, rel=1e-9)
    assert hanging.position(load)[-1, 1] == pytest.approx(-2 - tension / 1e5 / parts, rel=1e-10)


def test_two_weights_over_a_pulley_fall_as_atwoods_machine():
    scene, (m, M) = fb.Scene(gravity=(0, -G)), (1.0, 1.5)
    one, other = (scene.add_body((x, -1), mass=mass).centre for x, mass in ((-0.2, m), (0.2, M)))
    for node in (one, other):
        scene.fix(node, "x", "rotation")
    points = [one, (-0.2, 0.0), (0.2, 0.0), other]
    tension, k = 2 * m * M * G / (m + M), 1e6
    rope = scene.add_rope(points, fb.Spring(k), length=2.4 - tension / k)
    fall = fb.simulate(scene, dt=1e-3, t_end=0.4)
    a = (M - m) / (M + m) * G
    assert fall.joint(rope).force[1:] == pytest.approx(tension, rel=1e-6)
    assert fall.position(one)[:, 1] == pytest.approx(-1 + a * fall.t**2 / 2, abs=1e-8)


# -- Winches -------------------------------------------------------------------------------------


def test_a_winch_does_the_work_of_the_lifted_weight():
    def wound(t):
        return 4.0 - 0.5 * (t - np.sin(2 * np.pi * t) / (2 * np.pi))  # softly from 0 to 1 s

    scene, load, rope = block(k=1e5, length=wound)
    hanging = fb.static(scene)
    lift = fb.simulate(scene, dt=1e-3, t_end=1.0, start=hanging)
    energy = lift.energy
    assert abs(energy.balance_error).max() < 1e-11 * abs(energy.work).max()
    # After the lift it hangs again, but for a vibration that a soft start leaves small.
    raised = [-settled(length=length)[0] for length in (4.0, 3.5)]
    assert lift.position(load)[[0, -1], 1] == pytest.approx(raised, abs=2e-4)
    assert energy.work[-1] - energy.work[0] == pytest.approx(
        20.0 * G * (raised[1] - raised[0]), rel=1e-3
    )
    # In statics the length is that of the time.
    assert fb.static(scene, t=1.0).position(load)[-1, 1] == pytest.approx(raised[1], rel=1e-9)


def test_a_length_from_outside_is_an_input_and_the_tension_an_output():
    scene, load, rope = block(k=1e4, length=fb.Input("winch"))
    outputs = {"tension": fb.Output("force", rope)}
    motion = fb.Motion(scene, dt=1e-3, outputs=outputs, record=fb.Record())
    lengths = [4.0 - 1e-4 * k if k < 150 else 4.5 for k in range(200)]
    seen = [motion.step({"winch": length})["tension"] for length in lengths]
    recorded = motion.solution().joint(rope)
    assert recorded.force[1:] == pytest.approx(seen, rel=1e-12)
    assert max(seen) > 0 and min(seen) == 0.0  # it jumps, and is slack


def test_a_rope_without_tension_lets_its_load_fall():
    scene, load, rope = block(length=9.0)
    fall = fb.simulate(scene, dt=0.01, t_end=0.7)
    assert fall.position(load)[:, 1] == pytest.approx(-2 - G * fall.t**2 / 2, abs=1e-9)
    assert not fall.joint(rope).force.any()


# -- Damped ropes that only pull -----------------------------------------------------------------


def damped(make, resist, start=(0.0, -0.3), k=400.0, **options):
    """A mass on a rope of 1 m from the origin, in the plane or up and down."""
    scene, ball = held_body(start, 1.0, 0.0, "rotation", gravity=(0, -G))
    if make == "length":
        return scene, ball, scene.add_rope([(0, 0), ball], fb.Spring(k), length=1.0, **resist)
    if make == "rope":
        return scene, ball, scene.add_rope([(0, 0), ball], stop=(None, 1.0, k), **resist)
    return scene, ball, scene.add_force_between(ball, (0, 0), stop=(None, 1.0, k), **resist)


RESISTANCES = [
    {"damper": fb.Damper(50.0)},
    {"damper": fb.Damper(law=lambda rate: 30 * abs(rate) * rate)},
    {"friction": fb.SmoothFriction(7.0, 0.01)},
    {"damper": fb.Damper(5.0), "friction": fb.SmoothFriction(lambda rate: 4 + 0.0 * rate, 0.01)},
]


@pytest.mark.parametrize("make", ["length", "rope", "between"])
@pytest.mark.parametrize("resist", RESISTANCES)
def test_a_slack_rope_neither_brakes_nor_pushes_whatever_resists_its_rate(make, resist):
    for speed in (0.0, 1.3):
        scene, ball, rope = damped(make, resist)
        scene.set_velocity(ball, (0.2, speed))
        fall = fb.simulate(scene, dt=1e-3, t_end=0.2)
        place = 0.04, -0.3 + speed * 0.2 - G * 0.02
        assert fall.position(ball)[-1] == pytest.approx(place, abs=1e-12)
        assert not fall.joint(rope).force.any() and not fall.energy.dissipated.any()


@pytest.mark.parametrize("resist", RESISTANCES)
@pytest.mark.parametrize("order", [2, 4, None])
def test_no_damping_or_friction_makes_the_tension_of_a_rope_negative(resist, order):
    scheme = fb.EnergyMomentum(order=order) if order else fb.Newmark()
    scene, ball, rope = damped("length", resist, start=(0.6, 0.2))
    swing = fb.simulate(scene, scheme, dt=2e-3, t_end=2.0)
    force = swing.joint(rope).force
    assert force.min() == 0.0 and force.max() > 15.0
    if order:
        assert abs(swing.energy.balance_error).max() < 1e-11
    if order == 2:
        assert np.diff(swing.energy.dissipated).min() >= 0.0


def caught(x, c, k, end):
    """Place and loss of a mass (1 kg) that falls from rest at x above a rope of 1 m, by events."""

    def rates(_, y, pulls):
        tension = pulls * (k * (y[0] - 1) + c * y[1])
        return y[1], G - tension, pulls * c * y[1] ** 2

    def length(_, y, pulls):
        return y[0] - 1

    def tension(_, y, pulls):
        return k * (y[0] - 1) + c * y[1]

    for event in (length, tension):
        event.terminal = True
    t, y, phase = 0.0, np.array([x, 0.0, 0.0]), "slack"
    ends = {"slack": [(length, 1)], "pull": [(tension, -1)], "limp": [(length, -1), (tension, 1)]}
    while t < end:
        events = [event for event, _ in ends[phase]]
        for event, direction in ends[phase]:
            event.direction = direction
        options = {"rtol": 1e-12, "atol": 1e-13, "max_step": 0.02, "events": events}
        found = solve_ivp(rates, (t, end), y, "DOP853", args=(phase == "pull",), **options)
        t, y = found.t[-1], found.y[:, -1]
        if phase == "limp" and found.status:
            phase = "slack" if len(found.t_events[0]) else "pull"
        else:
            phase = "pull" if phase == "slack" else "limp"
    return y[0], y[2]


def test_a_mass_is_caught_by_a_damped_rope_as_events_say_to_second_order():
    errors = []
    for height in (0.15, 0.31, 0.47, 0.62, 0.78):
        place, _ = caught(height, 10.0, 400.0, 1.2)
        for dt in (8e-3, 4e-3, 2e-3):
            scene, ball, rope = damped("length", {"damper": fb.Damper(10.0)}, (0.0, -height))
            fall = fb.simulate(scene, dt=dt, t_end=1.2)
            errors.append(abs(fall.position(ball)[-1, 1] + place))
            assert fall.joint(rope).force.min() >= 0.0
            assert abs(fall.energy.balance_error).max() < 1e-11
    sizes = np.sqrt(np.mean(np.reshape(errors, (5, 3)) ** 2, axis=0))
    assert sizes[2] < 1e-4
    assert sizes[0] / sizes[2] > 10  # 16 of second order


def test_a_winch_that_pays_out_keeps_its_damped_rope_in_balance():
    def wound(t):
        return 1.0 + 0.3 * np.sin(7 * t)

    scene, ball = held_body((0, -1), 1.0, 0.0, "x", "rotation", gravity=(0, -G))
    rope = scene.add_rope([(0, 0), ball], fb.Spring(5e3), fb.Damper(20.0), length=wound)
    swing = fb.simulate(scene, dt=1e-3, t_end=2.0)
    assert swing.joint(rope).force.min() == 0.0
    assert abs(swing.energy.balance_error).max() < 1e-10
    assert np.diff(swing.energy.dissipated).min() >= 0.0


def test_what_a_drum_winds_at_a_steady_speed_is_not_damped_and_what_a_length_loses_is():
    """c v^2 is lost where the length of a damped rope changes by v, whose damper is on l."""
    m, k, c, v, r = 2.0, 4e3, 50.0, 0.5, 0.1
    taut, lost = 4.0 - m * G / k, []

    def hauled(t):
        return v * (t * t / 2 if t < 1 else t - 0.5)

    for winch in ("drum", "length"):
        scene, load = held_body((r, -4.0), m, 0.0, "x", "rotation", gravity=(0, -G))
        laws = fb.Spring(k), fb.Damper(c)
        if winch == "drum":
            drum = scene.add_body((0, 0), 1.0, 0.1).centre
            scene.add_joint(fb.Revolute(fb.GROUND, drum, motor=lambda t: -hauled(t) / r))
            rope = scene.add_rope([fb.Pulley(drum, r, "left"), load], *laws, length=taut)
        else:
            rope = scene.add_rope([(r, 0), load], *laws, length=lambda t: taut - hauled(t))
        lift = fb.simulate(scene, dt=2e-3, t_end=3.0)
        assert lift.position(load)[-1, 1] == pytest.approx(-4.0 + hauled(3.0), abs=1e-2)
        assert abs(lift.energy.balance_error).max() < 1e-10
        lost.append(lift.energy.dissipated[-1] - lift.energy.dissipated[-501])
        assert lift.joint(rope).force[-1] == pytest.approx(m * G, rel=1e-2)
    assert lost == pytest.approx([0.0, c * v**2], abs=1e-4)


def test_the_stop_of_a_damped_rope_has_no_loss_of_its_own():
    scene, ball = held_body((0, -0.3), 1.0, 0.0)
    stop = fb.Stop(None, 1.0, 1e3, restitution=0.5, speed=0.01)
    options = {"stop": stop, "damper": fb.Damper(1.0)}
    assert_refused("Give one of them", scene.add_rope, [(0, 0), ball], **options)


@pytest.mark.parametrize("length", [0.9, 1.5])
def test_a_damped_rope_damps_small_vibrations_while_it_is_taut(length):
    scene, load = held_body((0, -1.0), 2.0, 0.0, "rotation", "x", gravity=(0, -G))
    scene.add_spring(load, y=fb.Spring(3000.0))
    scene.add_rope([(0, 0), load], fb.Spring(400.0), fb.Damper(20.0), length=length)
    roots = np.linalg.eigvals(fb.linearise(scene, fb.static(scene)).A)
    stiffness, damping = (3400.0, 20.0) if length < 1 else (3000.0, 0.0)
    exact = np.roots([2.0, damping, stiffness])
    assert np.sort_complex(roots) == pytest.approx(np.sort_complex(exact), abs=1e-5)


def test_a_motion_on_a_damped_rope_has_derivatives():
    def build(x):
        scene, ball = held_body((0.6, 0.2), 1.0, 0.0, "rotation", gravity=(0, -G))
        laws = fb.Spring(400.0 * x[0]), fb.Damper(20.0 * x[1]), fb.SmoothFriction(2.0 * x[2], 0.05)
        rope = scene.add_rope([(0, 0), ball], *laws, length=x[3])
        return scene, {"position": fb.Output("position", ball), "force": fb.Output("force", rope)}

    run = fb.Response(build, dt=2e-3, t_end=0.9)
    _, y = run(np.ones(4))
    assert y["force"].max() > 50 and y["force"].min() == 0.0
    jacobian = run.jacobian()
    for i, step in enumerate(1e-6 * np.eye(4)):
        ends = [run(np.ones(4) + sign * step)[1] for sign in (1, -1)]
        for name, slopes in jacobian.items():
            expected = (ends[0][name] - ends[1][name]) / 2e-6
            assert abs(slopes[..., i] - expected).max() < 1e-5 * abs(expected).max(), (name, i)


# -- Momenta, tension, and changes ---------------------------------------------------------------


def test_the_pull_of_all_laws_is_that_of_their_closed_forms():
    """On a driven point: spring, damper, friction, stop and force on a length that grows."""
    scene, ball = held_body((1, 0), 1.0, 0.0, "y", "rotation")
    scene.prescribe(ball, x=lambda t: 0.3 * t)
    line = scene.add_force_between(
        ball,
        (0, 0),
        spring=fb.Spring(20.0, rest=0.5),
        damper=fb.Damper(3.0),
        friction=fb.SmoothFriction(0.7, 1e-3),
        stop=(0.2, 1.1, 500.0),
        force=lambda r, rate, t: 2 * r + rate + t,
    )
    motion = fb.simulate(scene, dt=1e-3, t_end=0.6)
    t, r = motion.t_level[1:], 1 + 0.3 * motion.t_level[1:]
    stretched = np.where(r > 1.1, 500 * (r - 1.1), 0.0)
    exact = 20 * (r - 0.5) + 3 * 0.3 + 0.7 + stretched + 2 * r + 0.3 + t
    assert motion.joint(line).force[1:] == pytest.approx(exact, abs=500 * 0.3e-3 / 4)
    assert motion.joint(line).length == pytest.approx(1 + 0.3 * motion.t, rel=1e-12)
    # A prop pushes: at the lower limit of its stop the pull is negative.
    prop, top = held_body((0, 1), 2.0, 0.0, "x", "rotation", gravity=(0, -G))
    push = prop.add_force_between(top, (0, 0), stop=(1.0, None, 1e5))
    assert fb.static(prop).joint(push).force[-1] == pytest.approx(-2 * G, rel=1e-9)


def test_tensions_are_in_joined_motions():
    scene, load, rope = block(k=1e4)
    first = fb.simulate(scene, dt=1e-3, t_end=0.05)
    assert first.line_forces.any()
    more = scene.add_force_between(load, (0.1, -4), spring=fb.Spring(10.0, rest=1.0))
    second = fb.simulate(scene, dt=1e-3, t_end=0.1, start=first)
    whole = first.then(second)
    assert (whole.joint(more).force[: len(first.t)] == 0).all()
    assert (whole.joint(rope).force[len(first.t) :] == second.joint(rope).force[1:]).all()
    scene.remove(rope)
    third = fb.simulate(scene, dt=1e-3, t_end=0.15, start=second)
    assert not third.joint(rope).force[1:].any() and third.joint(more).force[1:].all()
    assert not [name for name in scene.parameters if "rope" in name]


def test_the_derivative_of_a_hanging_load_is_that_of_the_closed_form():
    """Of its depth by stiffness, mass, length and the place of a pulley, all below one another."""

    def build(x):
        k, m, length, height = x
        scene, load = held_body((0, -2), m, 0.0, "x", "rotation", gravity=(0, -G))
        scene.add_rope([(0, height), load, (0, 0)], fb.Spring(k), length=length)
        return scene, {"y": fb.Output("position", load, "y")}

    # 2 T = m g with T = k (h - 2 y - L), so y = (h - L - m g / 2k) / 2.
    x = np.array([1e4, 20.0, 4.0, 0.1])
    run = fb.StaticResponse(build)
    k, m, *_ = x
    _, values = run(x)
    assert values["y"][-1] == pytest.approx((0.1 - 4.0 - m * G / (2 * k)) / 2, rel=1e-10)
    exact = [m * G / (4 * k**2), -G / (4 * k), -0.5, 0.5]
    assert run.jacobian()["y"][-1] == pytest.approx(exact, rel=1e-6)


# -- Refusals ------------------------------------------------------------------------------------


def test_what_is_no_rope_is_refused():
    scene = fb.Scene()
    ball = scene.add_body((1, 0), mass=1.0).centre
    other = fb.Scene().add_body((1, 0), mass=1.0).centre
    spring = fb.Spring(10.0)
    for words, points, change in (
        ("two or more nodes", [ball], {}),
        ("two or more nodes", ball, {}),
        ("a node among them", [(0, 0), (1, 1)], {}),
        ("same place", [(0, 0), ball, (1, 0)], {}),
        ("another scene", [(0, 0), other], {}),
        ("2 numbers", [(0, 0), ball, 3.0], {}),
        ("linear fx_beam.Spring", [(0, 0), ball], {"spring": None, "length": 1.0}),
        ("linear fx_beam.Spring", [(0, 0), ball], {"spring": fb.Spring(1.0, 2.0), "length": 1.0}),
        ("give a spring", [(0, 0), ball], {"spring": None}),
    ):
        with pytest.raises(fb.SceneError, match=words):
            scene.add_rope(points, **({"spring": spring} | change))
    assert not scene.forces_between and not list(scene.parameters)
    rope = scene.add_rope([(0, 0), ball, (3, 1)], spring=spring)
    scene.fix(ball, "rotation")
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    with pytest.raises(ValueError, match="not in this solution"):
        no_line = fb.Scene()
        no_line.add_body((0, 0), mass=1.0, inertia=1.0)
        fb.simulate(no_line, dt=0.1, t_end=0.1).joint(rope)
    assert solution.joint(rope).force.shape == (2,)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda number: fb.Spring(2e4, rest=number), "Parameter in a strain_energy.*add_rope"),
        (lambda number: fb.Spring(number), "Parameter in a strain_energy"),
        (lambda number: fb.Stop(None, number, 1e3), "Parameter in a strain_energy"),
        (lambda number: fb.Damper(number), "Parameter in the law of a damper"),
    ],
)
def test_numbers_that_may_not_change_in_time_name_the_way_out(make, words):
    for number in (lambda t: 3.0 - t, fb.Parameter("L", lambda t: 3.0 - t), fb.Input("L")):
        assert_refused(words, make, number)


@pytest.mark.parametrize("factor", [None, -0.5])
def test_the_length_of_a_rope_that_an_input_sets_starts_as_drawn(factor):
    """A weight falls from rest into the rope, whatever sets the length, and also without."""

    def hung(length):
        scene = fb.Scene(gravity=(0, -9.81))
        body = scene.add_body((0, -2), mass=10.0).centre
        scene.fix(body, "x", "rotation")
        return scene, body, scene.add_rope([(0, 0), body], spring=fb.Spring(1e4), length=length)

    w, t = np.sqrt(1e3), 1e-3 * np.arange(51)
    exact = -2 - 9.81 / w**2 * (1 - np.cos(w * t))
    winch = fb.Input("winch", factor=factor)
    value = 2.0 / (factor or 1.0)
    for length in (winch, fb.Parameter("length", winch)):
        for given in ({}, {"winch": value}):
            scene, body, rope = hung(length)
            motion = fb.Motion(scene, dt=1e-3, record=fb.Record())
            for _ in range(25):
                motion.step(given)
            middle = motion.solution()
            on = fb.Motion(scene, dt=1e-3, start=middle, record=fb.Record())
            for _ in range(25):
                on.step()
            whole = np.append(middle.position(body)[:, 1], on.solution().position(body)[1:, 1])
            assert abs(whole - exact).max() < 2e-3 * 9.81 / w**2
            assert abs(middle.energy.work).max() < 1e-9
            inputs = given or None
            run = fb.simulate(scene, dt=1e-3, t_end=0.05, inputs=inputs)
            assert run.position(body)[:, 1] == pytest.approx(whole, abs=1e-10)
            assert run.joint(rope).force[0] == pytest.approx(0.0, abs=1e-9)
    # It is hauled in from there, in the first step.
    scene, body, rope = hung(winch)
    motion = fb.Motion(scene, dt=1e-3, record=fb.Record())
    motion.step({"winch": 0.99 * value})
    assert motion.solution().energy.work[-1] == pytest.approx(1e4 * 0.02**2 / 2, rel=2e-2)


# -- Ropes as drawn -------------------------------------------------------------------------------


def braced(**rope):
    """A frame of 6 m by 4 m with two braces that only pull."""
    scene = fb.Scene()
    section = fb.Section.rectangle(0.1, 0.1, **fb.materials.steel)
    left, right = (scene.add_beam([(x, 0), (x, 4)], section, elements=4) for x in (0, 6))
    scene.add_beam([left.end, right.end], section, elements=4)
    scene.pin(left.start)
    scene.pin(right.start)
    ends = (left.start, right.end), (right.start, left.end)
    braces = [scene.add_rope([*pair], spring=fb.Spring(5e6), **rope) for pair in ends]
    return scene, left.end, braces


def test_a_taut_rope_is_as_long_as_drawn_and_only_pulls():
    scene, corner, (tie, other) = braced(taut=True)
    scene.add_force(corner, (1e3, 0))
    solution = fb.static(scene, load_steps=1)
    tension = solution.joint(tie)
    assert tension.length[0] == pytest.approx(np.hypot(6, 4), rel=1e-14)
    assert tension.force[-1] == pytest.approx(5e6 * (tension.length[-1] - np.hypot(6, 4)))
    assert solution.joint(other).force[-1] == 0


def test_a_rope_with_a_pretension_has_it_as_drawn_also_over_a_pulley():
    scene = fb.Scene()
    load = scene.add_body((1, -2), mass=1.0, inertia=0.1).centre
    scene.clamp(load)
    points = [(-1, -2), fb.Pulley((0, 0), 0.3, "right"), load]
    rope = scene.add_rope(points, spring=fb.Spring(1e4), pretension=250.0)
    assert fb.static(scene, load_steps=1).joint(rope).force[0] == pytest.approx(250.0, rel=1e-9)


def test_a_pretension_has_derivatives_by_places_and_by_itself():
    """A mass between two ropes is pulled across: F = 2 T sin a, T = T0 + k (L / cos a - L)."""
    k, F = 1e6, 3.0

    def build(x):
        tension, length = x
        scene = fb.Scene()
        node = scene.add_body((0, 0), mass=2.0, inertia=1.0).centre
        scene.fix(node, "rotation")
        for side in (-1, 1):
            scene.add_rope([(side * length, 0), node], spring=fb.Spring(k), pretension=tension)
        scene.add_force(node, (0.0, F))
        return scene, {"y": fb.Output("displacement", node, "y")}

    def closed(tension, length):
        def balance(y):
            span = np.hypot(length, y)
            return 2 * (tension + k * (span - length)) * y / span - F

        return brentq(balance, 0.0, 1.0, xtol=1e-15)

    run = fb.StaticResponse(build, 1)
    _, y = run([50.0, 1.5])
    assert y["y"][-1] == pytest.approx(closed(50.0, 1.5), rel=1e-9)
    slopes = [(closed(50.1, 1.5) - closed(49.9, 1.5)) / 0.2]
    slopes.append((closed(50.0, 1.5001) - closed(50.0, 1.4999)) / 2e-4)
    assert run.jacobian()["y"][-1] == pytest.approx(slopes, rel=1e-6)
    assert not run.stats.difference_reason


@pytest.mark.parametrize(
    ("rope", "words"),
    [
        ({"taut": True, "length": 3.0}, "length.*left out"),
        ({"pretension": -1.0}, "pretension.*not negative"),
        ({"pretension": 1e9}, "pretension.*less than stiffness times length"),
    ],
)
def test_pretensions_that_cannot_be_are_refused(rope, words):
    assert_refused(words, braced, **rope)


def test_modes_tell_of_a_rope_that_is_just_where_it_pulls(caplog):
    slack = fb.modes(braced(length=7.3)[0], n=1).frequencies
    assert "begins to act" not in caplog.text
    just = fb.modes(braced(taut=True)[0], n=1).frequencies
    assert just == pytest.approx(slack, rel=1e-9)
    assert "force 0" in caplog.text and "begins to act" in caplog.text
    caplog.clear()
    tight = fb.modes(braced(pretension=5.0)[0], n=1).frequencies
    assert tight > 4 * slack
    assert "begins to act" not in caplog.text
