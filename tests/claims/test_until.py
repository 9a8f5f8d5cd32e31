"""Motions that end where a condition is met: when, with what state, and what comes next."""

import numpy as np
import pytest
from scenes import clamped_bar, guided_body, held_body, hinged_body, one_bar, one_body

import fx_beam as fb


def ball():
    scene = fb.Scene(gravity=(0, -10.0))
    return scene, scene.add_body((0, 5.0), 1.0, 0.1)


def pendulum():
    scene, body, pin = hinged_body((1, 0), 2.0, 0.1, {"pin": (0, 0)}, gravity=(0, -9.81))
    outputs = {
        "x": fb.Output("position", body.centre, "x"),
        "spin": fb.Output("spin", body.centre),
        "force": fb.Output("force", pin),
    }
    return scene, body, pin, outputs


@pytest.mark.parametrize(
    ("scheme", "options"),
    [
        (fb.EnergyMomentum(), {"tolerance": 1e-4}),
        (fb.EnergyMomentum(order=4), {"dt": 0.03}),
        (fb.EnergyDecaying(), {"dt": 0.03}),
        (fb.GeneralizedAlpha(0.6), {"dt": 0.03}),
    ],
    ids=str,
)
def test_a_falling_ball_ends_on_the_floor_at_the_exact_time(scheme, options):
    scene, body = ball()
    outputs = {"place": fb.Output("position", body.centre)}
    until = {"outputs": outputs, "until": lambda t, y: y["place"][1]}
    fall = fb.simulate(scene, scheme, t_end=3.0, **until, **options)
    assert abs(fall.t[-1] - 1.0) < 1e-12
    assert abs(fall.position(body.centre)[-1, 1]) < 1e-11
    assert fall.velocity(body.centre)[-1, 1] == pytest.approx(-10.0, rel=1e-9)
    assert abs(fall.energy.balance_error).max() < 1e-11
    assert fall.stats.until == "until" and "by 'until'" in repr(fall)


@pytest.mark.parametrize("steps", [{"tolerance": 1e-4}, {"dt": 0.03}], ids=str)
def test_the_end_is_a_row_beside_those_at_chosen_times(steps):
    scene, body = ball()
    until = {"outputs": {"place": fb.Output("position", body.centre)}}
    until["until"] = lambda t, y: y["place"][1]
    fall = fb.simulate(scene, t_end=3.0, record=fb.Record(times=[0.0, 0.5, 2.0]), **until, **steps)
    assert fall.t == pytest.approx([0.0, 0.5, 1.0], abs=1e-12)
    assert abs(fall.position(body.centre)[-1, 1]) < 1e-11
    assert fall.then(fb.simulate(scene, dt=0.1, t_end=1.2, start=fall)).t[-1] == 1.2


def test_the_last_step_is_neither_tiny_nor_interpolated():
    """A step that would be shorter than a tenth is joined with the one before."""
    for dt in (0.1, 1 / 10.0001, 1 / 9.999, 1 / 9.95):
        scene, body = ball()
        outputs = {"y": fb.Output("position", body.centre, "y")}
        fall = fb.simulate(scene, dt=dt, t_end=3.0, outputs=outputs, until=lambda t, y: y["y"])
        assert fall.t[-1] == pytest.approx(1.0, abs=1e-12)
        assert 0.09 * dt < fall.t[-1] - fall.t[-2] < 1.2 * dt
        assert abs(fall.energy.balance_error).max() < 1e-12
        assert fall.stats.steps == len(fall.t) - 1


def test_a_value_that_only_a_short_last_step_meets_is_met():
    """A vibration that is not resolved comes back within the longer step of both."""
    scene, mass, _ = guided_body((0, 0), 1.0, 1.0, spring=fb.Spring(3e4))
    scene.add_force(mass, lambda t: (1e4 * t * np.cos(150 * t), 0.0))
    outputs = {"v": fb.Output("velocity", mass, "x")}
    run = fb.simulate(scene, dt=0.01, t_end=0.3, outputs=outputs, until=lambda t, y: y["v"] + 4.3)
    assert 0.06 < run.t[-1] < 0.061
    assert run.velocity(mass)[-1, 0] == pytest.approx(-4.3, rel=1e-9)


@pytest.mark.parametrize("limit", [2.0, 4.0, 6.0, 8.0, 10.0])
def test_a_force_that_is_met_at_the_start_of_a_step_is_met_in_one_about_it(limit):
    """Round-off decides in which of two steps a joint reaches the force at which it breaks."""
    scene = fb.Scene()
    left, right = (scene.add_body((x, 0), m, 0.1).centre for x, m in ((0, 2.0), (1, 3.0)))
    joint = scene.add_joint(fb.Rigid(left, right, offset=(1, 0)))
    scene.add_force(right, lambda t: (10.0 * t, 0.0))
    until = {"outputs": {"force": fb.Output("force", joint)}}
    until["until"] = lambda t, y: np.hypot(*y["force"][:2]) - limit
    run = fb.simulate(scene, dt=0.01, t_end=9.0, **until)
    # The left mass needs 2/5 of the load; means of steps lead to the force at the end.
    assert run.t[-1] == pytest.approx(limit / 4, abs=1e-9)
    assert run.t[-1] - run.t[-2] > 0.009


SCHEMES = {
    "order 2": fb.EnergyMomentum(),
    "order 4": fb.EnergyMomentum(order=4),
    "Newmark": fb.Newmark(),
    "HHT": fb.HHT(),
    "generalised alpha": fb.GeneralizedAlpha(),
}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("dt", "error"), [(2e-2, 3e-3), (2e-3, 3e-5)])
def test_a_ladder_leaves_a_smooth_wall_at_two_thirds_of_its_height(scheme, dt, error):
    """Forces are those within steps; from these follows that at the end, with an error of dt^2."""
    length, angle = 2.0, 1.1
    x, y = length * np.cos(angle), length * np.sin(angle)
    scene = fb.Scene(gravity=(0, -9.81))
    points = {"top": (0, y), "foot": (x, 0)}
    rod = scene.add_body((x / 2, y / 2), 1.0, length**2 / 12, points=points)
    scene.fix(rod["top"], "x"), scene.fix(rod["foot"], "y")
    fall = fb.simulate(
        scene,
        SCHEMES[scheme],
        dt=dt,
        t_end=2.0,
        outputs={"wall": fb.Output("reaction", rod["top"], "x")},
        until=lambda t, y: y["wall"] if t > 0 else 1.0,
    )
    assert fall.position(rod["top"])[-1, 1] / y == pytest.approx(2 / 3, abs=error)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_vibration_ends_where_its_reaction_is_met_with_an_error_of_dt_squared(scheme):
    """A mass on a bar that is its spring: u = 0.1 sin(10 t) / 10, and the reaction is -100 u."""
    section = fb.Section(EA=100.0, GA=100.0, EI=10.0)
    scene, bar = clamped_bar((1, 0), section, 1)
    scene.fix(bar.end, "y", "rotation")
    scene.add_mass(bar.end, 1.0)
    scene.set_velocity(bar.end, (0.1, 0.0))
    options = {"outputs": {"force": fb.Output("reaction", bar.start, "x")}, "t_end": 1.0}
    for dt in (1e-2, 1e-3):
        run = fb.simulate(
            scene, SCHEMES[scheme], dt=dt, until=lambda t, y: y["force"] + 0.5, **options
        )
        assert run.t[-1] == pytest.approx(np.arcsin(0.5) / 10, abs=dt**2)


@pytest.mark.exact_times
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("kind", ["dead force", "follower", "parameter"])
def test_the_last_step_does_not_reach_over_a_jump_of_a_load(kind, order):
    """A body of 1 kg with 1 m/s, on which 100 N act from 0.5 s on: v^2 = 1 + 2 * 100 * 0.5e-3."""
    scene, body = held_body((0, 0), 1.0, 0.1)
    scene.set_velocity(body, (1.0, 0.0))
    push = lambda t: 100.0 * (t >= 0.5)  # noqa: E731
    if kind == "parameter":
        p = fb.Parameter("push", lambda t: -push(t))
        scene.add_force_between(body, (-9, 0), force=lambda r, rate, t: p)
    else:
        scene.add_force(body, lambda t: (push(t), 0.0), follower=kind == "follower")
    until = {"outputs": {"x": fb.Output("position", body, "x")}}
    until["until"] = lambda t, y: y["x"] - 0.5005
    scheme = fb.EnergyMomentum(order)
    solution = fb.simulate(scene, scheme, dt=1 / 128, t_end=1.0, **until)
    assert solution.velocity(body)[-1, 0] == pytest.approx(np.sqrt(1.1), rel=1e-9)
    assert solution.t[-1] == pytest.approx(0.5 + (np.sqrt(1.1) - 1) / 100, abs=1e-12)
    until["until"] = lambda t, y: t > 0.5
    at_jump = fb.simulate(scene, scheme, dt=1 / 128, t_end=1.0, **until)
    assert at_jump.t[-1] == pytest.approx(0.5, abs=1e-13)
    assert at_jump.velocity(body)[-1, 0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("condition", "measured"),
    [
        (lambda t, y: y["x"], lambda s, body, pin: s.position(body.centre)[-1, 0]),
        (lambda t, y: y["x"] < 0.3, lambda s, body, pin: s.position(body.centre)[-1, 0] - 0.3),
        (lambda t, y: y["spin"] + 3.0, lambda s, body, pin: s.spin(body.centre)[-1] + 3),
        (lambda t, y: t - 0.3333, lambda s, body, pin: s.t[-1] - 0.3333),
    ],
    ids=["position", "truth value", "spin", "time"],
)
def test_the_last_row_meets_the_condition(condition, measured):
    scene, body, pin, outputs = pendulum()
    every = fb.Record(every=7)
    run = fb.simulate(scene, dt=0.01, t_end=5.0, until=condition, outputs=outputs, record=every)
    assert run.t[-1] < 1.0
    assert abs(measured(run, body, pin)) < 1e-10
    assert abs(run.energy.balance_error).max() < 1e-11


def test_the_first_of_several_conditions_ends_the_motion_and_is_named(tmp_path):
    scene, body, _, outputs = pendulum()
    until = {"fast": lambda t, y: y["spin"] + 4.0, "below": lambda t, y: y["x"]}
    run = fb.simulate(scene, dt=0.05, t_end=5.0, outputs=outputs, until=until)
    assert run.stats.until == "fast"
    run.save(tmp_path / "run.npz")
    assert fb.load(tmp_path / "run.npz").stats.until == "fast"
    # From a zero at the start on, the motion goes on to the next one.
    swing = {"dt": 0.01, "t_end": 9.0, "outputs": outputs, "until": until["below"]}
    first = fb.simulate(scene, **swing)
    second = fb.simulate(scene, start=first, **swing)
    period = 4 * first.t[-1]
    assert second.t[-1] - first.t[-1] == pytest.approx(period / 2, rel=1e-3)


def test_the_next_motion_may_be_shorter_than_a_step():
    scene, body = ball()
    outputs = {"y": fb.Output("position", body.centre, "y")}
    options = {"dt": 0.3, "t_end": 1.05}
    fall = fb.simulate(scene, outputs=outputs, until=lambda t, y: y["y"], **options)
    scene.fix(body.centre, "y")
    caught = fb.simulate(scene, start=fall, **options)
    assert caught.t == pytest.approx([1.0, 1.05])
    assert caught.energy.impact[-1] == pytest.approx(50.0, rel=1e-12)
    for t_end in (1.05, 1.05 + 1e-10):
        with pytest.raises(fb.SceneError, match="after the start at t = 1.05, by more than"):
            fb.simulate(scene, start=caught, **options | {"t_end": t_end})


@pytest.mark.parametrize("options", [{"dt": 0.01}, {"tolerance": 1e-3}], ids=str)
def test_a_condition_sees_the_rate_of_a_motor_at_the_start(options):
    scene, body = one_body((0.5, 0), 2.0, 0.4, points={"pin": (0, 0)})
    # It starts at once, by which the rates of steps alternate.
    motor = fb.Revolute(fb.GROUND, body["pin"], motor=lambda t: 3.0 * max(0.0, t - 0.5))
    motor, seen = scene.add_joint(motor), []
    begun = fb.simulate(scene, dt=0.01, t_end=0.52)

    def faster(t, y):
        seen.append(y["spin"])
        return y["spin"] > 4.0

    outputs = {"spin": fb.Output("spin", motor)}
    fb.simulate(scene, t_end=0.6, start=begun, until=faster, outputs=outputs, **options)
    assert abs(np.array(seen) - 3.0).max() < 1e-9


def test_a_condition_within_halved_steps():
    scene, arm, _ = hinged_body((1, 0), 1.0, 0.1, {"pin": (0, 0)})
    scene.set_velocity(arm, (0, 5.0), 5.0)
    outputs = {"turn": fb.Output("rotation", arm.centre)}
    until = lambda t, y: y["turn"] - 11.0  # noqa: E731
    run = fb.simulate(scene, dt=1.0, t_end=9.0, outputs=outputs, until=until)
    assert run.stats.halvings > 0
    assert run.rotation(arm.centre)[-1] == pytest.approx(11.0, abs=1e-10)


def every_kind():
    """A pendulum on a motor, with a rope, springs, an obstacle, and a beam that bends."""
    section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=1e-3)
    scene, beam = one_bar((1, 0), section, elements=4, name="arm", gravity=(0, -9.81))
    laws = {"spring": fb.Spring(2.0), "damper": fb.Damper(0.05)}
    pin = scene.add_joint(fb.Revolute(fb.GROUND, beam.start, **laws))
    load = scene.add_body((1.3, 0.2), mass=0.5, inertia=0.02, name="load").centre
    rope = scene.add_rope([beam.end, load, (1.4, 1.0)], spring=fb.Spring(60.0), length=0.9)
    spring = scene.add_force_between(load, beam.end, spring=fb.Spring(30.0, rest=0.3))
    ground = scene.add_spring(load, y=fb.Spring(8.0), rotation=fb.Spring(1.0))
    crank = scene.add_body((3, 0), mass=1.0, inertia=0.1, points={"pin": (0, 0)}).centre
    motor = scene.add_joint(fb.Revolute(fb.GROUND, crank, motor=lambda t: 2.0 * t**2 + t**3))
    contact = scene.add_contact(load, fb.Line((0, 0.15), normal=(0, 1)), stiffness=2e3)
    scene.set_velocity(load, (0, 0), spin=1.0)
    outputs = {
        "joint angle": fb.Output("angle", pin),
        "joint force": fb.Output("force", pin, "y"),
        "motor moment": fb.Output("motor_force", motor),
        "rope force": fb.Output("force", rope),
        "rope length": fb.Output("length", rope),
        "rope rate": fb.Output("rate", rope),
        "rope energy": fb.Output("energy", rope),
        "force between points": fb.Output("force", spring),
        "ground spring": fb.Output("force", ground.y),
        "ground rotation": fb.Output("length", ground.rotation),
        "gap": fb.Output("gap", contact),
        "contact force": fb.Output("force", contact, "y"),
        "place": fb.Output("position", beam.at(0.6), "y"),
        "tip": fb.Output("velocity", beam.end, "y"),
    }
    return scene, outputs


@pytest.fixture(scope="module")
def whole():
    """Steps of a motion without an end: all outputs of each."""
    scene, outputs = every_kind()
    motion = fb.Motion(scene, dt=2e-3, outputs=outputs)
    return [{name: float(value) for name, value in motion.step().items()} for _ in range(500)]


@pytest.mark.parametrize("name", every_kind()[1])
def test_every_kind_of_output_ends_a_motion_where_it_passes_a_value(name, whole):
    """The value is that in the middle of its change in a motion without an end."""
    scene, outputs = every_kind()
    rows = [step[name] for step in whole]
    target = (min(rows) + max(rows)) / 2
    assert np.ptp(rows) > 1e-3
    first = next(i for i, y in enumerate(rows) if (y < target) != (rows[0] < target))
    seen = {}

    def passed(t, y):
        # Before the first step there are no forces yet.
        seen[t] = float(y[name]) if t > 0 else rows[0]
        return seen[t] - target

    until = {"outputs": outputs, "until": passed}
    run = fb.simulate(scene, dt=2e-3, t_end=2.0, **until)
    # Forces are means over steps, and a short last step joins the one before: theirs are others.
    assert run.t[-1] == pytest.approx(2e-3 * (first + 1), abs=3e-3)
    assert run.stats.until == "until"
    last = seen[min(seen, key=lambda t: abs(t - run.t[-1]))]
    assert last == pytest.approx(target, abs=5e-3 * np.ptp(rows))
