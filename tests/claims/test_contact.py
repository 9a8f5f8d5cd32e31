"""Contact with circles and lines that move: invariants, closed solutions, files, bad input."""

import re

import numpy as np
import pytest

import fx_beam as fb

SOFT = fb.Section(EA=100.0, GA=100.0, EI=10.0, rhoA=1.0, rhoI=0.1)
SHAPES = pytest.mark.parametrize("shape", ["circle", "line"])


def bar_on_plate(shape, **options):
    """A free soft bar of degree 2 that meets a shape off the centre of a free body."""
    scene = fb.Scene()
    plate = scene.add_body((0, 0), mass=2.0, inertia=0.5, points={"edge": (0.1, 0.2)})
    bar = scene.add_beam([(-0.5, 0.9), (0.5, 0.8)], SOFT, elements=3, degree=2, name="bar")
    edge = plate["edge"]
    made = fb.Circle(edge, 0.5) if shape == "circle" else fb.Line(edge, (0.1, 1.0))
    contact = scene.add_contact(bar, made, stiffness=1e4, radius=0.02, **options)
    scene.set_velocity(bar, (0.3, -1.0), spin=0.5)
    scene.set_velocity(plate, (0.1, 0.0), spin=0.7)
    return scene, contact


@SHAPES
@pytest.mark.parametrize("along", [None, 3])
def test_free_members_keep_energy_and_both_momenta_in_contact(shape, along):
    scene, contact = bar_on_plate(shape, along=along)
    solution = fb.simulate(scene, dt=0.005, t_end=2.0)
    assert solution.contact(contact).gap.min() < -1e-3
    assert abs(solution.energy.balance_error).max() < 1e-12
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-13
    assert np.ptp(solution.angular_momentum) < 1e-13
    assert solution.stats.halvings == 0


def test_two_equal_discs_change_their_velocities():
    scene = fb.Scene()
    discs = [scene.add_body((x, 0), mass=3.0, inertia=0.1).centre for x in (0.0, 1.0)]
    scene.add_contact(discs[0], fb.Circle(discs[1], 0.2), stiffness=1e6, radius=0.1)
    scene.set_velocity(discs[0], (2.0, 0.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    assert solution.velocity(discs[1])[-1] == pytest.approx([2.0, 0.0], abs=1e-12)
    assert solution.velocity(discs[0])[-1] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_body_on_a_carried_line_presses_on_what_carries_it():
    scene = fb.Scene(gravity=(0, -10))
    section = fb.Section(EA=1e6, GA=1e6, EI=1e3)
    shelf = scene.add_beam([(0, 0), (1, 0)], section, elements=4, degree=2)
    scene.clamp(shelf.start)
    block = scene.add_body((1, 0.1), mass=2.0, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, block, axis=(0, 1), spring=fb.Spring(1e-3)))
    contact = scene.add_contact(block, fb.Line(shelf.end, (0, 1)), stiffness=1e6, radius=0.1)
    solution = fb.static(scene, steps=4)
    force = solution.contact(contact).force[-1, 0]
    assert force[1] == pytest.approx(20.0, rel=1e-6)
    assert solution.displacement(shelf.end)[-1, 1] == pytest.approx(-20 / 3e3, rel=2e-2)
    normal = force / np.hypot(*force)
    psi = solution.rotation(shelf.end)[-1]
    assert normal == pytest.approx([-np.sin(psi), np.cos(psi)], abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "options", "says"),
    [
        (lambda s, p: fb.Circle(p["edge"], 0.9), {}, r"point at .* starts 0\.2.* behind it"),
        (lambda s, p: fb.Circle(s.beams[0].start, 0.1), {}, "belongs to what it should stop"),
        (lambda s, p: fb.Circle(p["edge"], 0.1, True), {"radius": 0.2}, "above that of the inner"),
        (lambda s, p: fb.Line(p["edge"], (0, 1)), {"along": 0}, "along = 0 must be a whole number"),
        (lambda s, p: fb.Line(p["edge"], (0, 1)), {"radius": -1.0}, "finite and not negative"),
        (lambda s, p: fb.Line(fb.Scene().add_body((0, 0), 1).centre, (0, 1)), {}, "another scene"),
        (lambda s, p: p, {}, "needs an fx_beam.Line, an fx_beam.Circle or a beam"),
    ],
)
def test_what_does_not_fit_is_named(shape, options, says):
    scene, _ = bar_on_plate("line")
    options = {"along": 2} | options
    with pytest.raises(fb.SceneError, match=says):
        made = shape(scene, scene.bodies[0])
        scene.add_contact(scene.beams[0], made, stiffness=1e3, **options)


# -- Friction -------------------------------------------------------------------------------------

GRAVITY = 10.0
SETTLES = {"restitution": 0.3, "speed": 0.01}


def ball(angle=0.3, mu=0.5, k=1e5, radius=0.1, height=0.1, kt=1e5, **options):
    """A ball of 2 kg and 0.008 kg m^2 on an incline along x, and its contact."""
    scene = fb.Scene(gravity=(GRAVITY * np.sin(angle), -GRAVITY * np.cos(angle)))
    centre = scene.add_body((0, height), mass=2.0, inertia=0.008).centre
    options = {"radius": radius, "friction": fb.Coulomb(mu, kt), **SETTLES, **options}
    contact = scene.add_contact(centre, fb.Line((0, 0), (0, 1)), stiffness=k, **options)
    return scene, centre, contact


def acceleration(history, t):
    """Mean of the second half."""
    half = len(t) // 2
    return (history[-1] - history[half]) / (t[-1] - t[half])


def test_a_block_on_an_incline_rests_below_the_angle_of_friction():
    scene, block, contact = ball(mu=0.5, k=1e6, kt=1e6)
    scene.fix(block, "rotation")
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    place = solution.displacement(block)[:, 0]
    assert np.ptp(place[500:]) < 1e-12
    found = solution.contact(contact)
    assert found.tangential[-1, 0] == pytest.approx(20 * np.sin(0.3), rel=1e-9)
    assert found.normal[-1, 0] == pytest.approx(20 * np.cos(0.3), rel=1e-6)
    assert np.ptp(found.slip[500:]) < 1e-15
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-13


def test_a_block_slides_above_the_angle_with_the_exact_acceleration():
    scene, block, contact = ball(mu=0.2)
    scene.fix(block, "rotation")
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    exact = GRAVITY * (np.sin(0.3) - 0.2 * np.cos(0.3))
    assert acceleration(solution.velocity(block)[:, 0], solution.t) == pytest.approx(exact, 1e-9)
    found = solution.contact(contact)
    # Who looks along the normal force, upwards, has x to the right: the slip is negative.
    assert np.diff(found.slip[:, 0]).max() <= 0
    assert found.tangential[-1] == pytest.approx(0.2 * found.normal[-1], rel=1e-9)
    assert found.stretch[-1] == pytest.approx(-found.tangential[-1] / 1e5, rel=1e-9)
    assert abs(solution.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("mu", [0.5, 0.05])
def test_a_ball_rolls_or_slides_down_an_incline(mu):
    scene, centre, _ = ball(mu=mu)
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    rolls = GRAVITY * np.sin(0.3) / (1 + 0.008 / (2.0 * 0.1**2))
    slides = GRAVITY * (np.sin(0.3) - mu * np.cos(0.3))
    turns = -mu * 20 * np.cos(0.3) * 0.1 / 0.008
    found = [acceleration(solution.velocity(centre)[:, 0], solution.t)]
    found.append(acceleration(solution.v[:, centre.number, 2], solution.t))
    exact = [rolls, -rolls / 0.1] if mu == 0.5 else [slides, turns]
    assert found == pytest.approx(exact, rel=1e-5)


@SHAPES
def test_friction_of_free_members_keeps_the_balance_and_both_momenta(shape):
    runs = []
    for solver in ("compiled", "petsc"):
        friction = fb.Coulomb(0.4, 1e5)
        along = 2 if shape == "circle" else None
        scene, contact = bar_on_plate(shape, along=along, friction=friction)
        runs.append(fb.simulate(scene, dt=0.005, t_end=1.0, solver=solver))
    solution = runs[0]
    assert abs(solution.energy.balance_error).max() < 1e-12
    assert np.diff(solution.energy.dissipated).min() > -1e-15
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-13
    assert np.ptp(solution.angular_momentum) < 1e-13
    assert solution.q == pytest.approx(runs[1].q, abs=1e-9)
    found = solution.contact(contact)
    touching = found.normal > 1e-9
    assert touching.any()
    assert (abs(found.tangential) <= 0.4 * (1 + 1e-4) * found.normal)[touching].all()


def test_the_energy_of_the_friction_spring_is_lost_when_the_contact_opens():
    # The ball sticks, and a pull lifts it off: what its spring held is lost in that step.
    scene, centre, contact = ball(mu=5.0, height=0.1)
    scene.fix(centre, "rotation")
    scene.add_force(centre, lambda t: (0.0, 0.0 if t < 0.5 else 100.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.6)
    found, energy = solution.contact(contact), solution.energy
    opens = np.flatnonzero(found.normal[1:, 0] < 1e-12)[-1]
    assert found.gap[-1, 0] > 0.01
    assert not found.stretch[-1]
    assert energy.springs[-1] == 0
    assert np.diff(energy.dissipated).min() >= 0
    assert abs(energy.balance_error).max() < 1e-12
    assert opens > 500


def test_a_strip_on_a_drum_holds_by_the_law_of_the_capstan():
    scene = fb.Scene()
    section = fb.Section(EA=1e5, GA=1e5, EI=1e-2)
    arc = [(0.5 * np.cos(a), 0.5 * np.sin(a)) for a in np.linspace(np.pi, 0, 61)]
    strip = scene.add_beam([(-0.5, -0.3), *arc, (0.5, -0.3)], section, [4, *[1] * 60, 4])
    scene.clamp(strip.start)
    drum, friction = fb.Circle((0, 0), 0.5), fb.Coulomb(0.3, 1e7)
    contact = scene.add_contact(strip, drum, stiffness=1e5, friction=friction)
    scene.add_force(strip.end, (0, -1.0))
    solution = fb.static(scene, steps=10)
    N = solution.resultants(strip).N[-1]
    assert N[-1] / N[0] == pytest.approx(np.exp(0.3 * np.pi), rel=2e-3)
    assert solution.stats.halvings == 0
    held = solution.contact(contact).force[-1].sum(axis=0)
    assert held == pytest.approx([0, N[0] + N[-1]], abs=1e-3)


def test_bad_friction_is_named():
    with pytest.raises(fb.SceneError, match="mu = -0.1 must be finite and not negative"):
        fb.Coulomb(-0.1, 1e5)
    with pytest.raises(fb.SceneError, match="stiffness = 0 must be finite and positive"):
        fb.Coulomb(0.1, 0)
    with pytest.raises(fb.SceneError, match="Coulomb: damping = -1 must be finite and not neg"):
        fb.Coulomb(0.1, 1e5, damping=-1)
    with pytest.raises(fb.SceneError, match=r"friction = 0.3 must be an fx_beam.Coulomb"):
        ball(friction=0.3)
    scene, _, contact = ball()
    with pytest.raises(fb.SceneError, match="friction that sticks"):
        fb.simulate(scene, fb.EnergyMomentum(order=4), dt=1e-3, t_end=0.1)
    scene, _, contact = ball(friction=None)
    found = fb.simulate(scene, dt=1e-3, t_end=1e-2).contact(contact)
    with pytest.raises(ValueError, match="has no friction"):
        print(found.slip)


def test_contacts_that_stay_keep_their_friction_where_a_scene_changes():
    scene, block, contact = ball(mu=0.5, k=1e6, kt=1e6)
    scene.fix(block, "rotation")
    wall = scene.add_contact(block, fb.Line((1, 0), (-1, 0)), stiffness=1e6)
    held = fb.simulate(scene, dt=1e-3, t_end=0.5)
    scene.remove(wall)
    friction = fb.Coulomb(0.5, 1e6)
    scene.add_contact(block, fb.Line((2, 0), (-1, 0)), stiffness=1e6, friction=friction)
    solution = fb.simulate(scene, dt=1e-3, t_end=0.6, start=held)
    assert held.contact(contact).stretch[-1] < -1e-6
    assert solution.contact(contact).stretch[0] == held.contact(contact).stretch[-1]
    assert np.ptp(solution.displacement(block), axis=0).max() < 1e-9


def held_block(load, speed=0.0):
    """A block of 2 kg on a floor, with a spring of 100 N/m along it and friction of 10 N."""
    scene = fb.Scene(gravity=(0, -10))
    block = scene.add_body((0, 0), mass=2.0, inertia=0.1).centre
    scene.fix(block, "rotation")
    scene.add_force_between(block, (-1.0, 0), spring=fb.Spring(100.0, rest=1.0))
    scene.add_force_between(block, (0, -1.0), spring=fb.Spring(1e-3, rest=1.0))
    scene.add_force(block, (load, 0))
    friction = fb.Coulomb(0.5, 1e4)
    scene.add_contact(block, fb.Line((0, 0), (0, 1)), stiffness=1e5, friction=friction)
    scene.set_velocity(block, (speed, 0.0))
    return scene


def test_small_motions_are_those_of_a_contact_that_sticks_or_slips():
    scene = held_block(5.0)
    held = fb.static(scene, steps=4)
    sticks = (100.0 + 1e4) / 2.0
    assert fb.modes(scene, state=held).angular_frequencies[0] ** 2 == pytest.approx(sticks, 1e-6)
    found = np.abs(np.linalg.eigvals(fb.linearise(scene, held).A)) ** 2
    assert found.min() == pytest.approx(sticks, rel=1e-6)
    with pytest.raises(fb.SceneError, match="or friction slips"):
        fb.modes(held_block(20.0), state=fb.static(held_block(20.0), steps=4))
    scene = held_block(0.0, speed=1.0)
    slides = fb.simulate(scene, dt=1e-3, t_end=0.05)
    found = np.abs(np.linalg.eigvals(fb.linearise(scene, slides).A)) ** 2
    assert found.min() == pytest.approx(100.0 / 2.0, rel=1e-4)


def test_derivatives_of_equilibria_with_friction_are_those_of_differences():
    def build(x):
        scene = fb.Scene()
        arc = [(0.5 * np.cos(a), 0.5 * np.sin(a)) for a in np.linspace(np.pi, 0, 21)]
        section = fb.Section(EA=1e3 * x[1], GA=1e3, EI=1e-2)
        strip = scene.add_beam([(-0.5, -0.3), *arc, (0.5, -0.3)], section, [2, *[1] * 20, 2])
        scene.clamp(strip.start)
        friction = fb.Coulomb(0.3 * x[0], 1e6)
        scene.add_contact(strip, fb.Circle((0, 0), 0.5), stiffness=1e5, friction=friction)
        scene.add_force(strip.end, (0, -1.0))
        return scene, {"place": fb.Output("position", strip.end)}

    run, x, h = fb.StaticResponse(build, steps=5), np.ones(2), 1e-6
    weights = np.zeros_like(run(x)[1]["place"])
    weights[-1] = 1.0, 2.0
    gradient = run.vjp({"place": weights})
    ends = [[run(x + s * h * e)[1]["place"][-1] @ (1, 2) for e in np.eye(2)] for s in (1, -1)]
    assert gradient == pytest.approx((np.array(ends[0]) - ends[1]) / (2 * h), rel=1e-6)


def wheel_above_a_beam(spring, stiffness=1e5):
    """A wheel that a spring holds is loaded towards the tip of a cantilever."""
    scene, section = fb.Scene(), fb.Section(EA=1e4, GA=4e3, EI=10.0, rhoA=1.0, rhoI=1e-3)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    scene.clamp(beam.start)
    wheel = scene.add_body((1.0, 0.11), mass=1.0, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, wheel, axis=(0, 1), spring=fb.Spring(spring)))
    scene.add_force(wheel, (0.0, -8.0))
    scene.add_contact(beam, fb.Circle(wheel, 0.1), stiffness=stiffness)
    return scene


@pytest.mark.parametrize(
    ("spring", "stiffness", "says"),
    [
        (1.0, 1e5, "has gone through the circle in one step.*hold what moves away more firmly"),
        (100.0, 20.0, "lies 0.0.* deep in the circle, which has the radius 0.1"),
        (100.0, 1e5, ""),
    ],
)
def test_a_wheel_that_goes_through_a_beam_in_load_steps_is_told(spring, stiffness, says, caplog):
    fb.static(wheel_above_a_beam(spring, stiffness), steps=1)
    assert bool(re.search(says, caplog.text)) and bool(caplog.text) == bool(says)


@pytest.mark.parametrize(
    ("stiffness", "every", "says"),
    [
        (20.0, 1, "at t = 0.* lies 0.0.* deep in the circle, which has the radius 0.1.*shorter"),
        (1e5, 1, ""),
        (1e5, 40, ""),
    ],
)
def test_a_wheel_that_goes_deep_into_a_beam_in_a_motion_is_told(stiffness, every, says, caplog):
    scene = wheel_above_a_beam(100.0, stiffness)
    fb.simulate(scene, dt=5e-3, t_end=0.4, record=fb.Record(every=every))
    assert bool(re.search(says, caplog.text)) and bool(caplog.text) == bool(says)


def test_a_point_whose_rows_lie_on_both_sides_of_a_circle_has_not_gone_through(caplog):
    scene = fb.Scene()
    ball = scene.add_body((1.0, 0.0), mass=1.0, inertia=1.0, points={"hub": (0, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, ball["hub"]))
    scene.set_velocity(ball, (0.0, 1.0), spin=1.0)
    scene.add_contact(ball.centre, fb.Circle((0, 0), 0.8), stiffness=1e3)
    fb.simulate(scene, dt=np.pi / 100, t_end=2 * np.pi, record=fb.Record(every=100))
    assert not caplog.text
