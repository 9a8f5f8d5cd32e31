"""Friction of joints and contacts, and dampers with laws: closed solutions, balances, bad input."""

import math
from math import cos, sin

import ufl

import numpy as np
import pytest
from jointed import pair, pendulum_with_friction
from scenes import assert_refused, clamped_bar, guided_body, held_body, one_bar, one_body
from scipy.integrate import quad

import fx_beam as fb

SCHEMES = [fb.EnergyMomentum(), fb.EnergyDecaying(0.1), fb.Newmark(), fb.HHT(-0.2)]
STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)
BEAM = fb.Section(EA=1e5, GA=1e5, EI=1e3, rhoA=1.0, rhoI=0.1)
G = 9.81


def square(rate):
    return 0.7 * abs(rate) * rate


def block(velocity=2.0, axis=(3, 4), mass=2.0, gravity=None, load=None, **parts):
    """A block on a rail of the ground: its scene, its node and the rail."""
    scene, centre, rail = guided_body((0, 0), mass, 0.1, axis=axis, **parts, gravity=gravity)
    scene.set_velocity(centre, velocity * np.array(axis) / np.hypot(*axis))
    if load:
        scene.add_force(centre, load)
    return scene, centre, rail


def weighted(mu, stiffness=1e5, velocity=3.0, axis=(1, 0), **options):
    """A block with weight on a rail whose friction follows its force."""
    return block(velocity, axis, gravity=(0, -G), friction=fb.Coulomb(mu, stiffness), **options)


def assert_balanced(solution, largest=1e-10):
    """Energy that friction takes never comes back, and the balance closes."""
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < largest


# -- Friction of a given force, and laws of dampers -----------------------------------------------


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_a_block_slides_to_rest_as_the_law_says(scheme):
    # m v' = -F tanh(v / w): sinh(v / w) = sinh(v0 / w) exp(-F t / (m w)).
    m, F, w, v0 = 2.0, 3.0, 0.2, 2.0
    scene, _, joint = block(v0, friction=fb.SmoothFriction(F, w))
    solution = fb.simulate(scene, scheme, dt=0.005, t_end=4.0)
    v = w * np.arcsinh(np.sinh(v0 / w) * np.exp(-F * solution.t / (m * w)))
    assert abs(solution.joint(joint).rate - v).max() < 1e-3
    distance = m * v0**2 / (2 * F)
    longer = np.pi**2 / 6 * (w / v0) ** 2
    assert solution.joint(joint).slide[-1] == pytest.approx(distance * (1 + longer), rel=1e-4)
    assert np.diff(solution.energy.dissipated).min() >= 0


def test_stribecks_friction_stops_a_block_where_its_integral_says():
    law = fb.SmoothFriction(lambda rate: 1 + ufl.exp(-abs(rate) / 0.5), 0.005)
    scene, _, rail = block(2.0, mass=1.0, friction=law)
    solution = fb.simulate(scene, dt=5e-3, t_end=2.5)
    stop, _ = quad(lambda v: v / (1 + np.exp(-v / 0.5)), 0, 2.0)
    assert solution.joint(rail).slide[-1] == pytest.approx(stop, rel=1e-3)
    assert solution.energy.dissipated[-1] == pytest.approx(2.0, rel=1e-6)
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_a_damper_with_a_square_law_brakes_like_one_over_the_time():
    # m v' = -c v^2: v = v0 / (1 + c v0 t / m).
    errors = []
    for dt in (0.02, 0.01):
        scene, _, joint = block(2.0, damper=fb.Damper(law=square))
        solution = fb.simulate(scene, dt=dt, t_end=2.0)
        exact = 2.0 / 0.7 * np.log(1 + 0.7 * 2.0 * solution.t / 2.0)
        errors.append(abs(solution.joint(joint).slide - exact).max())
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert errors[1] < 1e-4


@pytest.mark.parametrize(
    ("parts", "slope"),
    [
        ({"friction": fb.SmoothFriction(0.3, 0.2)}, 1.5),
        ({"damper": fb.Damper(0.5, law=lambda rate: 2 * ufl.sinh(rate))}, 2.5),
        ({"damper": fb.Damper(law=square)}, 0.0),
    ],
    ids=["friction", "law", "square"],
)
def test_modes_and_responses_have_the_slope_at_rest(parts, slope):
    scene, centre, joint = block(0.0, spring=fb.Spring(200.0), **parts)
    modes = fb.modes(scene, n=1)
    assert modes.damping_ratios == pytest.approx([slope / (2 * 2.0 * 10.0)], rel=1e-9)
    hertz = 7.0 / (2 * np.pi)
    force = (centre, (0.6 * 5.0, 0.8 * 5.0))
    amplitude = fb.frequency_response(scene, force, joint, [hertz]).amplitude.ravel()
    assert amplitude == pytest.approx([5.0 / abs(200.0 - 2 * 49.0 + 7.0j * slope)], rel=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_no_step_fails_where_a_joint_stops(scheme):
    # Newton's method on the friction alone would jump from one direction to the other.
    scene, friction = fb.Scene(gravity=(0, -G)), fb.SmoothFriction(1.0, 1e-5)
    upper = scene.add_beam([(0, 0), (1, 0)], STIFF, elements=2)
    lower = scene.add_beam([(1, 0), (2, 0)], STIFF, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, upper.start, friction=friction))
    scene.add_joint(fb.Revolute(upper.end, lower.start, friction=friction, damper=fb.Damper(0.05)))
    solution = fb.simulate(scene, scheme, dt=0.02, t_end=1.5)
    assert solution.stats.halvings == 0
    assert solution.stats.newton_iterations < 8 * solution.stats.steps
    assert np.diff(solution.energy.dissipated).min() >= 0
    if scheme in SCHEMES[:2]:
        assert abs(solution.energy.balance_error).max() < 1e-11 * solution.energy.kinetic.max()


def test_statics_knows_no_friction_and_a_massless_arm_may_hang_on_it():
    def arm(**parts):
        scene, bar = one_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=1)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, **parts))
        scene.add_force(bar.end, (0.0, 0.5))
        return scene, bar

    friction, spring = {"friction": fb.SmoothFriction(2.0, 0.1)}, {"spring": fb.Spring(4.0)}
    each = spring, spring | friction
    turned = [fb.static(arm(**parts)[0], load_steps=1).q[-1] for parts in each]
    assert (turned[0] == turned[1]).all()
    # Friction alone holds nothing: the arm turns into the direction of its force.
    scene, bar = arm(**friction)
    turned = fb.static(scene, load_steps=1).position(bar.end)[-1]
    assert turned == pytest.approx([0, 1 + 0.5 / 1e4], abs=1e-9)
    # In a motion it creeps at the rate whose friction is the moment of the force.
    psi = fb.simulate(scene, dt=0.01, t_end=1.0).rotation(bar.start)
    rate = (psi[-1] - psi[-3]) / 0.02
    assert 2.0 * np.tanh(rate / 0.1) == pytest.approx(0.5 * np.cos(psi[-2]), rel=1e-2)


# -- Friction that follows the force of a joint ---------------------------------------------------


def swing(mu, radius, t_end):
    """Angle and spin of the pendulum before it first stops: by the rule of Runge and Kutta."""

    def rates(state):
        angle, spin = state
        spin_rate = 0.0
        for _ in range(30):  # the force depends on the acceleration
            x = -0.5 * (sin(angle) * spin_rate + cos(angle) * spin**2)
            y = 0.5 * (cos(angle) * spin_rate - sin(angle) * spin**2)
            moment = mu * radius * 2.0 * np.hypot(x, y + G)  # the spin is negative
            spin_rate = (moment - 2.0 * G * 0.5 * cos(angle)) / (0.05 + 2.0 * 0.25)
        return np.array([spin, spin_rate])

    state = np.zeros(2)
    for _ in range(round(t_end / 1e-3)):
        k1 = rates(state)
        k2 = rates(state + 1e-3 / 2 * k1)
        k3 = rates(state + 1e-3 / 2 * k2)
        state = state + 1e-3 / 6 * (k1 + 2 * k2 + 2 * k3 + rates(state + 1e-3 * k3))
    return state


def test_the_friction_is_mu_times_the_force_of_the_same_step():
    """Also in the steps behind a jump of the load."""

    def load(t):
        return (0.0, -10 - 8 * sin(5 * t) - 20 * (t > 0.405))

    scene, _, rail = block(3.0, (1, 0), load=load, friction=fb.Coulomb(0.2, 1e5))
    solution = fb.simulate(scene, dt=0.01, t_end=0.6)
    along, across = abs(solution.joint(rail).force[1:, :2].T)
    assert np.ptp(across) > 20
    assert along == pytest.approx(0.2 * across, rel=1e-12)


@pytest.mark.parametrize(("mu", "speed"), [(0.5, 1.0), (0.3, -3.0), (1.5, -3.0)])
def test_a_force_that_its_own_friction_changes_has_the_exact_acceleration(mu, speed):
    """A block on an inclined rail of a light cart that moves freely on the ground.

    The friction changes the normal force up to 1.3 times as much.
    """
    mass, s, c = 10.0, sin(0.7), cos(0.7)
    scene, cart = held_body((0, 0), mass=1.0, inertia=0.1, gravity=(0, -G))
    rider = scene.add_body((0, 0), mass=mass, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, cart, axis=(1, 0)))
    rail = scene.add_joint(fb.Prismatic(cart, rider, axis=(c, -s), friction=fb.Coulomb(mu, 1e6)))
    scene.set_velocity(rider, (speed * c, -speed * s))
    solution = fb.simulate(scene, dt=2e-3, t_end=0.1)
    signed = mu * np.sign(speed)
    normal = mass * G * c / (1 - mass * s * (signed * c - s))
    gains = normal * (signed * c - s)
    assert solution.stats.halvings == 0
    assert abs(solution.joint(rail).force[1:, :2] @ (s, c)) == pytest.approx(normal, rel=1e-9)
    bends = np.diff(solution.position(cart)[:, 0], 2) / 2e-3**2
    assert bends == pytest.approx(np.full(len(bends), gains), rel=1e-9)
    assert_balanced(solution)
    assert np.ptp(solution.linear_momentum[:, 0]) < 1e-10


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_a_pin_brakes_by_mu_times_its_radius_times_its_force(dt):
    scene, centre, pin = pendulum_with_friction(0.3)
    solution = fb.simulate(scene, dt=dt, t_end=0.8)
    angle, spin = swing(0.3, 0.05, 0.8)
    free_angle, _ = swing(0.0, 0.05, 0.8)
    assert abs(free_angle - angle) > 0.05
    assert solution.joint(pin).angle[-1] == pytest.approx(angle, abs=5 * dt**2)
    assert solution.v[-1, centre.number, 2] == pytest.approx(spin, abs=40 * dt**2)
    assert_balanced(solution, 1e-11)
    if dt == 0.01:  # also in steps of a tolerance
        chosen = fb.simulate(scene, t_end=0.8, tolerance=1e-5)
        assert chosen.rotation(centre)[-1] == pytest.approx(angle, abs=2e-3)
        assert_balanced(chosen)


@pytest.mark.parametrize("kind", [fb.Prismatic, fb.Slider, fb.Sleeve])
@pytest.mark.parametrize("part", [0.9, 1.05])
def test_on_a_steep_rail_or_beam_it_rests_or_slides(kind, part):
    """A body of 2 kg on an incline of 0.3 rad."""
    mu, down = part * np.tan(0.3), -np.array([cos(0.3), sin(0.3)])
    if kind is fb.Prismatic:
        scene, _, joint = weighted(mu, velocity=0.0, axis=down)
    else:
        scene, beam = one_bar([(0, 0), tuple(8 * down)], BEAM, elements=4, gravity=(0, -G))
        for node in beam.nodes:
            scene.clamp(node)
        body = scene.add_body(tuple(down), mass=2.0, inertia=0.1).centre
        joint = scene.add_joint(kind(beam, body, friction=fb.Coulomb(mu, 1e5)))
    solution = fb.simulate(scene, dt=5e-3, t_end=1.0)
    s = solution.joint(joint).slide
    if part > 1:
        assert np.ptp(s[-60:]) < 1e-9
    else:
        slides = G * (sin(0.3) - mu * cos(0.3))
        bends = np.diff(s[50:], 2) / 5e-3**2
        assert bends == pytest.approx(np.full(len(bends), slides), rel=1e-6)
    assert_balanced(solution)


def test_a_block_on_a_spring_turns_and_stops_where_it_should():
    """Half periods of pi / w, each with 2 mu N / k less; at rest below mu N / k."""
    scene, centre, _ = weighted(0.3, 1e6, 0.0, mass=1.0, spring=fb.Spring(100.0, rest=-0.2))
    solution = fb.simulate(scene, dt=5e-4, t_end=1.5)
    x, v, t = solution.position(centre)[:, 0] + 0.2, solution.velocity(centre)[:, 0], solution.t
    lost = 2 * 0.3 * G / 100
    turns = np.flatnonzero(np.sign(v[1:-1]) * np.sign(v[2:]) < 0)[:2] + 1
    assert t[turns] == pytest.approx([np.pi / 10, 2 * np.pi / 10], abs=1e-3)
    assert x[turns] == pytest.approx([-(0.2 - lost), 0.2 - 2 * lost], abs=1e-5)
    assert x[-1] == pytest.approx(-(0.2 - 3 * lost), abs=3e-5)
    sticks = t[np.flatnonzero(abs(v) > 0.01)[-1]]
    assert sticks == pytest.approx(3 * np.pi / 10, abs=0.01)


# -- Friction of contacts -------------------------------------------------------------------------

SETTLES = {"restitution": 0.3, "speed": 0.01}
INCLINE = np.array([sin(0.3), -cos(0.3)])


def ball(mu=0.5, k=1e5, turns=False, **options):
    """A ball of 2 kg and 0.008 kg m^2 on an incline along x, and its contact."""
    scene, centre = held_body((0, 0.1), mass=2.0, inertia=0.008, gravity=10.0 * INCLINE)
    if not turns:
        scene.fix(centre, "rotation")
    options = {"radius": 0.1, "friction": fb.Coulomb(mu, k), **SETTLES, **options}
    contact = scene.add_contact(centre, fb.Line((0, 0), (0, 1)), stiffness=k, **options)
    return scene, centre, contact


def acceleration(history, t):
    """Mean of the second half."""
    half = len(t) // 2
    return (history[-1] - history[half]) / (t[-1] - t[half])


def test_a_block_on_an_incline_rests_below_the_angle_of_friction():
    scene, centre, contact = ball(k=1e6)
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    assert np.ptp(solution.displacement(centre)[500:, 0]) < 1e-12
    pressed = solution.contact(contact)
    assert pressed.tangential[-1, 0] == pytest.approx(20 * np.sin(0.3), rel=1e-9)
    assert pressed.normal[-1, 0] == pytest.approx(20 * np.cos(0.3), rel=1e-6)
    assert np.ptp(pressed.slip[500:]) < 1e-15
    assert_balanced(solution, 1e-13)


def test_a_block_slides_above_the_angle_with_the_exact_acceleration():
    scene, centre, contact = ball(mu=0.2)
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    exact = 10.0 * (np.sin(0.3) - 0.2 * np.cos(0.3))
    assert acceleration(solution.velocity(centre)[:, 0], solution.t) == pytest.approx(exact, 1e-9)
    pressed = solution.contact(contact)
    # Who looks along the normal force, upwards, has x to the right: the slip is negative.
    assert np.diff(pressed.slip[:, 0]).max() <= 0
    assert pressed.tangential[-1] == pytest.approx(0.2 * pressed.normal[-1], rel=1e-9)
    assert pressed.stretch[-1] == pytest.approx(-pressed.tangential[-1] / 1e5, rel=1e-9)
    assert abs(solution.energy.balance_error).max() < 1e-12


def test_a_block_in_a_ring_is_braked_by_mu_times_the_force_that_turns_it():
    """In steps over 11 degrees, in which the middle of its way is well inside of the ring."""
    scene, centre = held_body((0.9, 0), 1.0, 0.1, "rotation")
    law = {"stiffness": 1e4, "radius": 0.1, "friction": fb.Coulomb(0.3, 1e6)}
    contact = scene.add_contact(centre, fb.Circle((0, 0), 1.0, inside=True), **law)
    scene.set_velocity(centre, (0.0, 1.0))
    pressed = fb.simulate(scene, dt=0.2, t_end=1.0).contact(contact)
    assert pressed.normal[1:].min() > 0.5
    assert pressed.tangential == pytest.approx(0.3 * pressed.normal, rel=1e-9)


@pytest.mark.parametrize("mu", [0.5, 0.05])
def test_a_ball_rolls_or_slides_down_an_incline(mu):
    scene, centre, _ = ball(mu=mu, turns=True)
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    rolls = 10.0 * np.sin(0.3) / (1 + 0.008 / (2.0 * 0.1**2))
    slides = 10.0 * (np.sin(0.3) - mu * np.cos(0.3))
    turns = -mu * 20 * np.cos(0.3) * 0.1 / 0.008
    gains = acceleration(solution.v[:, centre.number], solution.t)[[0, 2]]
    exact = [rolls, -rolls / 0.1] if mu == 0.5 else [slides, turns]
    assert gains == pytest.approx(exact, rel=1e-5)


def test_the_energy_of_the_friction_spring_is_lost_when_the_contact_opens():
    # The ball sticks, and a pull lifts it off: what its spring held is lost in that step.
    scene, centre, contact = ball(mu=5.0)
    scene.add_force(centre, lambda t: (0.0, 0.0 if t < 0.5 else 100.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.6)
    pressed, energy = solution.contact(contact), solution.energy
    assert np.flatnonzero(pressed.normal[1:, 0] < 1e-12)[-1] > 500
    assert pressed.gap[-1, 0] > 0.01
    assert not pressed.stretch[-1]
    assert energy.springs[-1] == 0
    assert_balanced(solution, 1e-12)


def test_derivatives_of_equilibria_with_friction_are_those_of_differences():
    def build(x):
        """A strip on half a drum, held at one end and pulled down by 1 N at the other."""
        section = fb.Section(EA=1e3 * x[1], GA=1e3, EI=1e-2)
        arc = [(0.5 * np.cos(a), 0.5 * np.sin(a)) for a in np.linspace(np.pi, 0, 21)]
        scene, strip = clamped_bar([(-0.5, -0.3), *arc, (0.5, -0.3)], section, [2, *[1] * 20, 2])
        law = {"stiffness": 1e5, "friction": fb.Coulomb(0.3 * x[0], 1e6)}
        scene.add_contact(strip, fb.Circle((0, 0), 0.5), **law)
        scene.add_force(strip.end, (0, -1.0))
        return scene, {"place": fb.Output("position", strip.end)}

    run, x, h = fb.StaticResponse(build, load_steps=5), np.ones(2), 1e-6
    weights = np.zeros_like(run(x)[1]["place"])
    weights[-1] = 1.0, 2.0
    gradient = run.vjp({"place": weights})
    ends = [[run(x + s * h * e)[1]["place"][-1] @ (1, 2) for e in np.eye(2)] for s in (1, -1)]
    assert gradient == pytest.approx((np.array(ends[0]) - ends[1]) / (2 * h), rel=1e-6)


def held_block(load, speed=0.0):
    """A block of 2 kg on a floor, with a spring of 100 N/m along it and friction of 10 N."""
    scene, centre = held_body((0, 0), 2.0, 0.1, "rotation", gravity=(0, -10))
    scene.add_force_between(centre, (-1.0, 0), spring=fb.Spring(100.0, rest=1.0))
    scene.add_force_between(centre, (0, -1.0), spring=fb.Spring(1e-3, rest=1.0))
    scene.add_force(centre, (load, 0))
    law = {"stiffness": 1e5, "friction": fb.Coulomb(0.5, 1e4)}
    scene.add_contact(centre, fb.Line((0, 0), (0, 1)), **law)
    scene.set_velocity(centre, (speed, 0.0))
    return scene


def test_small_motions_are_those_of_a_contact_that_sticks_or_slips():
    scene = held_block(5.0)
    held = fb.static(scene, load_steps=4)
    sticks = (100.0 + 1e4) / 2.0
    assert fb.modes(scene, state=held).angular_frequencies[0] ** 2 == pytest.approx(sticks, 1e-6)
    squares = np.abs(np.linalg.eigvals(fb.linearise(scene, held).A)) ** 2
    assert squares.min() == pytest.approx(sticks, rel=1e-6)
    with pytest.raises(fb.SceneError, match="or friction slips"):
        fb.modes(held_block(20.0), state=fb.static(held_block(20.0), load_steps=4))
    scene = held_block(0.0, speed=1.0)
    slides = fb.simulate(scene, dt=1e-3, t_end=0.05)
    squares = np.abs(np.linalg.eigvals(fb.linearise(scene, slides).A)) ** 2
    assert squares.min() == pytest.approx(100.0 / 2.0, rel=1e-4)


# -- Refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        (lambda rate: -rate, r"\(1e-06\) = -1e-06 adds energy"),
        (lambda rate: rate**2, r"\(-1e-06\) = 1e-12 adds energy"),
        (lambda rate: 0.1 + rate, "adds energy"),
        (lambda rate: rate - 0.1 * rate**3, r"\(10\) = -90 adds energy"),
        (lambda rate: 2.0, "depends on the rate"),
        (lambda rate: ufl.as_vector((rate, rate)), "must be a scalar"),
        (lambda rate: np.tanh(rate), "UFL expression"),
        (lambda rate: math.tanh(rate), "UFL expression|depends on the rate"),
        (lambda rate: rate**0.5, "is complex"),
        (3.0, "UFL expression"),
    ],
)
def test_a_law_that_drives_or_is_invalid_is_refused(law, reason):
    assert_refused(f"Damper: law.*({reason})", fb.Damper, law=law)


SPRUNG = {"axis": (1, 0), "spring": fb.Spring(1e3), "friction": fb.Coulomb(0.2, 1e5)}
FOUR = fb.EnergyMomentum(order=4)
PINNED = fb.Coulomb(0.3, 1e4, 0.1)
REFUSED = [
    (lambda n: fb.SmoothFriction(math.nan, 0.1), "SmoothFriction: force = .* must be finite"),
    (lambda n: fb.SmoothFriction(1.0, -0.1), "SmoothFriction: speed = -0.1 must be finite"),
    (lambda n: fb.SmoothFriction(1.0, 0.0), "SmoothFriction: speed = 0 must be positive.*try"),
    (lambda n: fb.SmoothFriction(lambda rate: rate, 0.1), "negative"),
    (lambda n: fb.SmoothFriction(lambda rate: np.exp(rate), 0.1), "UFL"),
    (lambda n: fb.Coulomb(0.1, 0), "stiffness = 0 must be finite and positive"),
    (lambda n: fb.Coulomb(0.1, 1e5, damping=-1), "Coulomb: damping = -1 must be finite"),
    (lambda n: fb.Coulomb(0.3, 1e4, radius=-1), "radius = -1 must be finite and positive"),
    (lambda n: block(friction=1.0), "friction = 1.0 must be an fx_beam.SmoothFriction or "),
    (lambda n: pair("pin in slot", hinge=fb.Coordinate(friction="much")), "friction = 'much' must"),
    (lambda n: ball(friction=0.3), "friction = 0.3 must be an fx_beam.Coulomb"),
    (lambda n: fb.Revolute(fb.GROUND, n, friction=fb.Coulomb(0.3, 1e4)), "needs the radius of the"),
    (lambda n: block(friction=PINNED), "friction of a slide has no radius"),
    (
        lambda n: fb.Slider(
            fb.Scene().add_beam([(0, 0), (1, 0)], BEAM, elements=1), n, friction=PINNED
        ),
        "Slider: friction of a slide has no radius",
    ),
    (
        lambda n: n.scene.add_force_between(n, (1, 0), friction=fb.Coulomb(0.3, 1e4)),
        "needs a normal force",
    ),
    (lambda n: ball(friction=PINNED), "has the radius of a pin"),
    (
        lambda n: fb.static(block(0.0, **SPRUNG)[0], continuation="arc-length"),
        "arc-length steps do not find the force of a joint",
    ),
    (
        lambda n: fb.simulate(pendulum_with_friction(0.3)[0], FOUR, dt=0.01, t_end=0.1),
        "goes back in time",
    ),
    (lambda n: fb.simulate(ball()[0], FOUR, dt=1e-3, t_end=0.1), "friction that sticks"),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_does_not_fit_is_named(wrong, words):
    assert_refused(words, lambda: wrong(fb.Scene().add_body((0, 0), 1.0).centre))


def test_a_contact_without_friction_has_no_slip():
    scene, _, contact = ball(friction=None)
    pressed = fb.simulate(scene, dt=1e-3, t_end=1e-2).contact(contact)
    assert_refused("has no friction", lambda: pressed.slip, error=ValueError)


@pytest.mark.parametrize("mass", (1.0, 2.0, 1e3))
def test_bodies_on_a_pin_with_friction_fall_freely(mass):
    # Of the force in the pin, which friction follows, only round-off of the weights is left.
    scene, a = one_body((0, 0), 1.0, 0.1, points={"pin": (0.5, 0)}, gravity=(0, -G))
    b = scene.add_body((1, 0), mass, 0.1, points={"pin": (0.5, 0)})
    friction = fb.Coulomb(0.3, radius=0.05, stiffness=1e3)
    pin = scene.add_joint(fb.Revolute(a["pin"], b["pin"], friction=friction))
    motion = fb.simulate(scene, dt=0.01, t_end=0.5, max_halvings=0)
    assert abs(motion.joint(pin).force).max() < 1e-12 * mass * G
    fall = motion.displacement(b.centre)[:, 1]
    assert np.allclose(fall, -G * motion.t**2 / 2, rtol=1e-12, atol=1e-15)


def on_a_slope(slope, spacing, along):
    """A wheel, a circle, on a clamped deck along x, with gravity turned by the slope."""
    R, pull = 0.2, 9.81 * np.array([sin(slope), -cos(slope)])
    scene = fb.Scene(gravity=pull)
    wheel = scene.add_body((0, R + 2e-6), 2.0, 0.5 * 2.0 * R**2).centre
    deck = scene.add_beam([(-0.5, 0), (1.0, 0)], STIFF, elements=round(1.5 / spacing))
    for node in deck.nodes:
        scene.clamp(node)
    law = {"stiffness": 5e7, "friction": fb.Coulomb(0.6, 5e7), "along": along, "radius": 1e-6}
    scene.add_contact(deck, fb.Circle(wheel, R), **law)
    return scene, wheel


@pytest.mark.parametrize(("spacing", "along"), [(0.03, 4), (0.015, 2)])
@pytest.mark.parametrize("slope", [0.2, -0.35])
def test_a_wheel_on_a_member_of_short_elements_rolls_down_as_a_rigid_one(
    spacing, along, slope, caplog
):
    """Way g sin / (1 + J/m R^2) t^2 / 2."""
    scene, wheel = on_a_slope(slope, spacing, along)
    rolls = fb.simulate(scene, dt=1e-3, t_end=0.4)
    way = 9.81 * sin(slope) / 1.5 * 0.4**2 / 2
    assert rolls.displacement(wheel)[-1, 0] == pytest.approx(way, rel=2e-2)
    assert rolls.rotation(wheel)[-1] == pytest.approx(-way / 0.2, rel=2e-2)
    assert not caplog.messages


@pytest.mark.parametrize(("spacing", "along"), [(0.1, 2), (0.05, None), (0.05, 1), (0.05, 2)])
def test_a_wheel_that_bumps_over_the_points_of_a_member_says_what_to_do(spacing, along, caplog):
    scene, wheel = on_a_slope(0.2, spacing, along)
    rolls = fb.simulate(scene, dt=1e-3, t_end=0.5)
    way = 9.81 * sin(0.2) / 1.5 / 8
    assert abs(rolls.displacement(wheel)[-1, 0] - way) > 0.03 * way
    (message,) = caplog.messages
    assert "it bumps" in message and "points of at most 0.02" in message
    assert "add_contact(node 0 at (0, 0.200002), beam 'beam 1', radius=(0.2, 1e-06)" in message


# -- Landings without restitution that stick -------------------------------------------------------


def landed(place, points, velocity, spin, inertia, ratio, dt=2e-5, stiffness=1e6):
    """Spin of a body of 1 kg soon after its point "tip" has landed and sticks."""
    scene, body = one_body(place, 1.0, inertia, points=points)
    friction = fb.Coulomb(3.0, ratio * stiffness)
    law = {"stiffness": stiffness, "restitution": 0.0, "speed": 5e-3, "friction": friction}
    scene.add_contact(body["tip"], fb.Line((0, 0), (0, 1)), **law)
    scene.set_velocity(body, velocity, spin=spin)
    return fb.simulate(scene, dt=dt, t_end=0.01).spin(body.centre)[-1]


def fallen_rod(degrees, ratio):
    """Spin of an inclined rod whose tip lands at 2 m/s and sticks, over the exact one."""
    a, inertia = math.radians(degrees), 1 / 12
    centre = np.array([cos(a), sin(a)]) / 2
    exact = -2.0 * centre[0] / (inertia + 1 / 4)
    points = {"tip": (0.0, 1e-5)}
    return landed(centre + [0, 1e-5], points, (0, -2.0), 0.0, inertia, ratio) / exact


def landed_wheel(inertia, ratio, dt=2e-5):
    """Spin of a rimless wheel of eight spokes of 1 m after the next one lands, over the exact one.

    Angular momentum about the point that lands: (cos 2a + J) / (1 + J) of the spin before.
    """
    a, before = np.pi / 8, -1.5
    new, old = (np.array([sign * sin(a), -cos(a)]) for sign in (1, -1))
    place = np.array([0.0, cos(a) + 1e-5])
    arm = -old  # of the centre from the point that stood
    velocity = (-before * arm[1], before * arm[0])
    exact = before * (cos(2 * a) + inertia) / (1 + inertia)
    return landed(place, {"tip": place + new}, velocity, before, inertia, ratio, dt) / exact


@pytest.mark.parametrize("inertia", [0.02, 0.3, 1.0])
def test_a_rimless_wheel_lands_as_momentum_says_on_a_bristle_of_a_hundred_stiffnesses(
    inertia, caplog
):
    assert landed_wheel(inertia, 100) == pytest.approx(1, abs=3e-2)
    assert not any("without restitution" in message for message in caplog.messages)


@pytest.mark.parametrize("dt", [2e-5, 2e-6])
@pytest.mark.parametrize("ratio", [1.0, 0.01])
@pytest.mark.parametrize("inertia", [0.02, 0.3, 1.0])
def test_a_soft_bristle_on_which_a_wheel_lands_is_named_in_steps_of_any_length(
    inertia, ratio, dt, caplog
):
    """Up to a third off; it slides only by what the impact does. Silent at 2e-6 and 0.01."""
    landed_wheel(inertia, ratio, dt)
    assert sum("without restitution" in message for message in caplog.messages) == 1


@pytest.mark.parametrize("degrees", [30, 45, 60, 75])
def test_a_rod_that_lands_and_sticks_turns_as_momentum_says_or_a_warning_names_the_ratio(
    degrees, caplog
):
    assert fallen_rod(degrees, 100) == pytest.approx(1, abs=4e-2)
    assert not any("without restitution" in message for message in caplog.messages)
    caplog.clear()
    fallen_rod(degrees, 1)
    (message,) = [text for text in caplog.messages if "without restitution" in text]
    assert "with a friction of 1 of its stiffness" in message and "hundred times" in message


def test_a_body_that_lands_straight_has_no_friction_to_speak_of(caplog):
    scene, body = one_body((0, 1e-5), 1.0, 0.1)
    law = {"stiffness": 1e6, "restitution": 0.0, "speed": 5e-3, "friction": fb.Coulomb(0.5, 1e6)}
    scene.add_contact(body.centre, fb.Line((0, 0), (0, 1)), **law)
    scene.set_velocity(body, (0.0, -2.0))
    fb.simulate(scene, dt=2e-5, t_end=0.01)
    assert not any("sticks" in message for message in caplog.messages)
