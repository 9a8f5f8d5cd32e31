"""Derivatives through reversals of slip in few steps, against closed forms of rigid friction."""

import numpy as np
import pytest
from scenes import guided_body, held_body

import fx_beam as fb

MU, GRAVITY, PUSH, SPEED, END = 0.2, 10.0, 6.0, 1.0, 0.5
# In them the slip reverses at all places of a step.
NEAR = MU * np.linspace(0.99, 1.01, 7)
STIFF = 1e8


def pushed_back(mu):
    """Place and rate at the end of 1 kg that slips against a push, and their slopes by mu."""
    before, after = PUSH + mu * GRAVITY, PUSH - mu * GRAVITY
    left, by_mu = END - SPEED / before, SPEED * GRAVITY / before**2
    place = (GRAVITY * left**2 - SPEED**2 * GRAVITY / before**2) / 2 - after * left * by_mu
    return place, GRAVITY * left - after * by_mu


def block(scene, place=(0, 0)):
    """A block with the push and the speed."""
    centre = scene.add_body(place, mass=1.0, inertia=1.0).centre
    scene.add_force(centre, (-PUSH, 0.0))
    scene.set_velocity(centre, (SPEED, 0.0))
    return centre


def on_slide(friction):
    scene = fb.Scene(gravity=(0, -GRAVITY))
    centre = block(scene)
    scene.add_joint(fb.Prismatic(fb.GROUND, centre, axis=(1, 0), friction=friction))
    return scene, fb.Output("position", centre, "x"), fb.Output("velocity", centre, "x")


def on_pin(friction):
    scene, centre = held_body((0, 0), mass=4.0, inertia=1.0, gravity=(0, -GRAVITY))
    scene.add_joint(fb.Revolute(fb.GROUND, centre, friction=friction))
    scene.add_moment(centre, -PUSH)
    scene.set_velocity(centre, spin=SPEED)
    return scene, fb.Output("rotation", centre), fb.Output("spin", centre)


def derivatives(make, dt, friction, scheme=None, near=NEAR, **options):
    """Of place and rate at the end by mu, relative to those of rigid friction less 1."""

    def build(x):
        scene, place, rate = make(friction(x[0]))
        return scene, {"place": place, "rate": rate}

    run, errors = fb.Response(build, scheme, dt=dt, t_end=END, **options), []
    for mu in near:
        run([mu])
        J = run.jacobian()
        slopes = np.array([J["place"][-1, 0], J["rate"][-1, 0]])
        errors.append(slopes / pushed_back(mu) - 1)
    weights = {name: np.eye(len(rows))[-1] for name, rows in J.items()}
    by_vjp = [run.vjp({name: weights[name]})[0] for name in J]
    assert by_vjp == pytest.approx(slopes, rel=1e-9)
    return abs(np.array(errors)).max(axis=0)


def stiff(mu):
    return fb.Coulomb(mu, STIFF)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying()], ids=str)
def test_they_converge_with_the_step_on_a_slide(scheme):
    coarse, fine = (derivatives(on_slide, dt, stiff, scheme) for dt in (4e-3, 1e-3))
    assert (coarse < 5e-3).all()
    assert fine[0] < 2e-3 and fine[1] < 1e-4


def pushed_to_and_fro(mu):
    """Place of 1 kg from rest after a push of 0.1 s by 20 N, and one back of 0.4 s by 6 N."""
    speed = (20 - mu * GRAVITY) * 0.1
    left = 0.4 - speed / (PUSH + mu * GRAVITY)
    stopped = speed * 0.1 / 2 + speed**2 / (PUSH + mu * GRAVITY) / 2
    return stopped - (PUSH - mu * GRAVITY) * left**2 / 2


@pytest.mark.exact_times
@pytest.mark.parametrize("member", [False, True], ids=["line", "member"])
def test_they_converge_with_the_step_in_contact(member):
    """On a line or a member, where the block settles before."""

    def build(x):
        law = {"restitution": 0.1, "speed": 0.1}
        scene, centre = held_body((0.01, 0.1), 1.0, 1.0, "rotation", gravity=(0, -GRAVITY))
        scene.add_force(centre, lambda t: (20.0 * (0.2 < t < 0.3) - PUSH * (t > 0.3), 0.0))
        floor = fb.Line((0, 0), (0, 1))
        if member:
            section = fb.Section(EA=1e9, GA=1e9, EI=1e9)
            floor = scene.add_beam([(-1, 0), (1, 0)], section, elements=7)
            for node in floor.nodes:
                scene.clamp(node)
        radius = (0.1, 0) if member else 0.1
        scene.add_contact(centre, floor, 1e5, radius=radius, friction=stiff(x[0]), **law)
        return scene, {"place": fb.Output("position", centre, "x")}

    worst = []
    for dt in (2e-3, 5e-4):
        run, errors = fb.Response(build, dt=dt, t_end=0.7), []
        for mu in NEAR:
            run([mu])
            expected = pushed_to_and_fro(mu + 1e-20j).imag / 1e-20
            errors.append(run.jacobian()["place"][-1, 0] / expected - 1)
        worst.append(abs(np.array(errors)).max())
    assert worst[0] < 0.01 and worst[1] < 2e-3


def test_they_converge_with_the_step_on_a_pin():
    """Its friction is mu R N with the weight of 40 N, as on the slide with 10 N."""
    radius = 0.25
    law = lambda mu: fb.Coulomb(mu, STIFF, radius)  # noqa: E731
    errors = [derivatives(on_pin, dt, law) for dt in (4e-3, 1e-3)]
    assert (errors[0] < 5e-3).all() and (errors[1] < 2e-3).all()


@pytest.mark.parametrize("stiffness", [1e4, 1e5, 1e6, 1e7])
def test_they_are_close_for_any_number_of_steps_in_a_reversal(stiffness):
    """From a part of a step to 30, up to the error of the spring itself."""
    for dt in (2e-3, 5e-4, 1e-4):
        errors = derivatives(on_slide, dt, lambda mu: fb.Coulomb(mu, stiffness), near=NEAR[::3])
        assert (errors < 0.12 * np.sqrt(1e4 / stiffness) + 5e-3).all(), dt


def test_parts_of_a_motion_find_the_same():
    whole = derivatives(on_slide, 1e-3, stiff)
    assert derivatives(on_slide, 1e-3, stiff, memory=2e4) == pytest.approx(whole, rel=1e-6)


def test_an_oscillator_with_friction_loses_as_much_in_each_half_period():
    """The place in the half period n is (-1)^n ((A - (2 n + 1) d) cos(w t - n pi) + d)."""
    w, amplitude, halves = 8.0, 1.0, 4.6

    def build(x):
        law = {"friction": fb.Coulomb(x[0], STIFF), "spring": fb.Spring(w**2, rest=-amplitude)}
        scene, centre, rail = guided_body((0, 0), 1.0, 1.0, **law, gravity=(0, -GRAVITY))
        return scene, {"place": fb.Output("slide", rail)}

    n = int(halves)
    for dt, most in ((2e-3, 0.02), (5e-4, 5e-3)):
        t_end = dt * round(halves * np.pi / w / dt)
        phase = w * t_end - n * np.pi
        run = fb.Response(build, dt=dt, t_end=t_end)
        expected = (-1) ** n * (1 - (2 * n + 1) * np.cos(phase)) * GRAVITY / w**2
        for mu in (0.199, 0.2, 0.2003):
            run([mu])
            assert run.jacobian()["place"][-1, 0] == pytest.approx(expected, rel=most)


def test_a_block_that_stops_has_the_derivative_of_its_way():
    """It is -v^2 / (2 mu^2 g): where slip ends, and none follows, that of the steps converges."""

    def build(x):
        scene, centre = held_body((0, 0), mass=1.0, inertia=1.0, gravity=(0, -GRAVITY))
        scene.set_velocity(centre, (SPEED, 0.0))
        rail = fb.Prismatic(fb.GROUND, centre, axis=(1, 0), friction=stiff(x[0]))
        return scene, {"place": fb.Output("slide", scene.add_joint(rail))}

    worst = []
    for dt in (4e-3, 1e-3):
        run, errors = fb.Response(build, dt=dt, t_end=0.7), []
        for mu in NEAR:
            run([mu])
            expected = -(SPEED**2) / (2 * mu**2 * GRAVITY)
            errors.append(run.jacobian()["place"][-1, 0] / expected - 1)
        worst.append(abs(np.array(errors)).max())
    assert worst[0] < 0.02 and worst[1] < worst[0] / 2


def on_distance(friction):
    scene = fb.Scene()
    centre = block(scene, (1, 0))
    scene.fix(centre, "y")
    post = scene.add_body((0, 0), mass=1.0, inertia=1.0).centre
    scene.fix(post, "x", "y", "rotation")
    scene.add_force_between(post, centre, friction=friction)
    return scene, fb.Output("position", centre, "x"), fb.Output("velocity", centre, "x")


def on_the_ground(friction):
    scene = fb.Scene()
    centre = block(scene)
    scene.fix(centre, "y")
    scene.add_spring(centre, x=friction)
    return scene, fb.Output("position", centre, "x"), fb.Output("velocity", centre, "x")


def on_a_rope(friction):
    scene = fb.Scene()
    centre = block(scene, (1, 0))
    scene.fix(centre, "y")
    corners = [scene.add_body(place, mass=1.0, inertia=1.0).centre for place in ((0, 0), (0, -1))]
    for corner in corners:
        scene.fix(corner, "x", "y", "rotation")
    scene.add_rope([centre, *corners, (1, -1)], friction=friction)
    return scene, fb.Output("displacement", centre, "x"), fb.Output("velocity", centre, "x")


def in_a_gear(friction):
    scene = fb.Scene()
    wheels = [scene.add_body((x, 0), mass=1.0, inertia=1.0).centre for x in (0, 3)]
    shafts = [scene.add_joint(fb.Revolute(fb.GROUND, wheel)) for wheel in wheels]
    scene.add_joint(fb.Gear(*shafts, ratio=0.5, friction=friction))
    scene.fix(wheels[0], "rotation")
    scene.add_moment(wheels[1], -PUSH)
    scene.set_velocity(wheels[1], spin=SPEED)
    return scene, fb.Output("rotation", wheels[1]), fb.Output("spin", wheels[1])


@pytest.mark.parametrize(
    "make, owner",
    [
        (on_slide, "joint 0 slide"),
        (on_pin, "joint 0 rotation"),
        (on_distance, "between"),
        (on_the_ground, "the ground along (1, 0)"),
        (on_a_rope, "over node 0"),
        (in_a_gear, "Gear"),
    ],
)
def test_smooth_friction_warns_where_derivatives_depend_on_the_steps(make, owner, caplog):
    """They are wrong by a tenth or more in half a step, and by a hundredth in six, without it."""

    def smooth(speed):
        return lambda mu: fb.SmoothFriction(mu * GRAVITY, speed)

    fine = derivatives(make, 5e-4, smooth(5e-3))
    assert (fine < 0.01).all() and not caplog.records
    coarse = derivatives(make, 2e-3, smooth(1e-4))
    assert coarse.max() > 0.1
    (record,) = caplog.records
    when = SPEED / (PUSH + MU * GRAVITY)
    assert owner in record.getMessage() and f"t = {when:.2f}"[:-1] in record.getMessage()
    assert "shorter steps" in record.getMessage()


def test_friction_that_sticks_needs_no_warning(caplog):
    derivatives(on_slide, 4e-3, stiff)
    assert not caplog.records
