"""Steps of a tolerance meet contacts, stops and switches of laws; rows between are as accurate."""

import ufl

import numpy as np
import pytest
from scenes import clamped_bar, held_body
from scipy.integrate import solve_ivp

import fx_beam as fb

HEIGHT, MASS, GRAVITY, T_END = 0.5, 1.0, 9.81, 2.0
TOLERANCES = 1e-2, 1e-3, 1e-4, 1e-5
TIMES = np.linspace(0.0, T_END, 1001)


def exact(t, k):
    """Height above the floor and velocity: flight, and a part of an oscillation with gravity."""
    fall = np.sqrt(2 * HEIGHT / GRAVITY)
    v, w = GRAVITY * fall, np.sqrt(k / MASS)
    rest = GRAVITY / w**2
    contact = 2 * (np.pi - np.arctan2(v / w, rest)) / w
    since = np.mod(t + fall, 2 * fall + contact) - fall  # the last highest place
    c = since - fall
    fly = np.where(c < 0, since, since - 2 * fall - contact)
    inside = (c >= 0) & (c <= contact)
    y = np.where(
        inside, rest * (np.cos(w * c) - 1) - v / w * np.sin(w * c), HEIGHT - GRAVITY * fly**2 / 2
    )
    u = np.where(inside, -rest * w * np.sin(w * c) - v * np.cos(w * c), -GRAVITY * fly)
    return y, u


def floor(k):
    """The ball falls on an obstacle."""
    scene, node = ball()
    scene.fix(node, "x", "rotation")
    scene.add_contact(node, fb.Line((0, 0), normal=(0, 1)), k)
    return scene, node


def stop(k):
    """It is guided down to the stop of a slide."""
    scene, node = ball()
    scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), stop=(-HEIGHT, None, k)))
    return scene, node


#: Ways to write x^2 below 0.
PIECES = {
    "conditional": lambda x: ufl.conditional(ufl.lt(x, 0), x**2, 0.0),
    "least": lambda x: ufl.min_value(x, 0.0) ** 2,
    "absolute": lambda x: (abs(x) - x) ** 2 / 4,
    "both": lambda x: ufl.conditional(ufl.And(ufl.gt(x, -9.0), ufl.lt(x, 0)), x**2, 0.0),
}


def law(k, piece="conditional"):
    """It is guided by a spring whose energy has two pieces."""
    scene, node = ball()
    spring = fb.Spring(strain_energy=lambda x: k / 2 * PIECES[piece](x + HEIGHT))
    scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), spring=spring))
    return scene, node


def rod(k):
    """It is on a rod of 1 m that resists only when it is shorter than a half."""

    def energy(eps, gamma, kappa):
        short = k / 2 * PIECES["conditional"](eps + HEIGHT)
        return short + 5e5 * gamma**2 + 5e3 * kappa**2

    scene, beam = clamped_bar(
        [(0, -HEIGHT), (0, 1 - HEIGHT)],
        fb.Section(strain_energy=energy),
        elements=1,
        gravity=(0, -GRAVITY),
    )
    scene.add_mass(beam.end, MASS)
    return scene, beam.end


def ball():
    scene, measure = clamped_bar(
        [(2, 0), (3, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4), elements=1, gravity=(0, -GRAVITY)
    )
    return scene, scene.add_body((0, HEIGHT), mass=MASS, inertia=1.0).centre


def errors(make, k, tolerance, order, times=None, **options):
    """Largest errors of the height [m] and the velocity [m/s], and the solution."""
    scene, node = make(k)
    record = None if times is None else fb.Record(times=times)
    scheme = fb.EnergyMomentum(order)
    options |= {"tolerance": tolerance, "record": record}
    solution = fb.simulate(scene, scheme, t_end=T_END, **options)
    y, u = exact(solution.t, k)
    place, velocity = solution.position(node)[:, 1], solution.velocity(node)[:, 1]
    return abs(place - y).max(), abs(velocity - u).max(), solution


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("k", [1e4, 1e6])
def test_a_ball_bounces_within_the_tolerance_at_steps_and_at_rows_between(k, order):
    for tolerance in TOLERANCES[order == 2 :]:  # coarse steps of order 2 miss it by 6
        for times in (None, TIMES):
            place, _, solution = errors(floor, k, tolerance, order, times)
            assert place < 2 * tolerance, (tolerance, times is None)
            energy = solution.energy
            assert abs(energy.balance_error).max() < 1e-11 * MASS * GRAVITY * HEIGHT


CASES = [(make, tol) for make in (floor, stop, law, rod) for tol in (1e-3, 1e-5)]


@pytest.mark.parametrize(("make", "tolerance"), CASES)
def test_obstacles_stops_and_laws_with_pieces_keep_the_tolerance_with_order_four(make, tolerance):
    for times in (None, TIMES):
        place, velocity, _ = errors(make, 1e4, tolerance, 4, times)
        assert place < 2 * tolerance
        # An error of place in the contact, of the frequency 100 /s; a section has no events.
        assert velocity < (500 if make is rod else 100) * tolerance


@pytest.mark.parametrize("piece", PIECES)
def test_pieces_of_a_law_meet_in_any_form(piece):
    place, velocity, solution = errors(lambda k: law(k, piece), 1e4, 1e-5, 4)
    assert place < 2e-5 and velocity < 1e-3
    assert abs(solution.t - np.sqrt(2 * HEIGHT / GRAVITY)).min() < 2e-5  # a step ends there


def test_steps_of_order_four_end_where_a_contact_begins_and_ends():
    *_, solution = errors(floor, 1e4, 1e-5, 4)
    fall = np.sqrt(2 * HEIGHT / GRAVITY)
    v, w = GRAVITY * fall, 100.0
    contact = 2 * (np.pi - np.arctan2(v / w, GRAVITY / w**2)) / w
    for event in (fall, fall + contact, 3 * fall + contact, 3 * fall + 2 * contact):
        assert abs(solution.t - event).min() < 2e-5
    force = solution.contact(solution.contacts[0]).force[1:, 0, 1]
    momentum = np.diff(solution.linear_momentum[:, 1])
    assert force * np.diff(solution.t) - GRAVITY * np.diff(solution.t) == pytest.approx(
        momentum, abs=1e-10
    )


@pytest.mark.parametrize("t0", [-2.0, 1e6])
def test_a_contact_is_followed_as_closely_at_any_time(t0):
    k, tolerance = 1e8, 1e-5
    scene, node = floor(k)
    scene.fix(node, "y")
    held = fb.static(scene, t=t0)
    scene.free(node, "y")
    options = {"t_end": t0 + T_END, "tolerance": tolerance, "start": held}
    solution = fb.simulate(scene, fb.EnergyMomentum(4), **options)
    y, _ = exact(solution.t - t0, k)
    assert abs(solution.position(node)[:, 1] - y).max() < 2 * tolerance


@pytest.mark.parametrize("after", np.geomspace(3e-9, 1e-7, 7))
def test_a_contact_just_before_the_end_leaves_no_step_of_round_off(after):
    scene, _ = floor(1e14)
    t_end = np.sqrt(2 * HEIGHT / GRAVITY) + after
    solution = fb.simulate(scene, fb.EnergyMomentum(4), t_end=t_end, tolerance=1e-9)
    assert solution.t[-1] == t_end and np.diff(solution.t).min() > 1e-11


def test_rows_between_constant_steps_do_not_reach_over_a_contact():
    def largest(times):
        scene, node = floor(1e4)
        solution = fb.simulate(scene, dt=5e-3, t_end=0.319, record=fb.Record(times=times))
        return abs(solution.position(node)[:, 1] - exact(solution.t, 1e4)[0]).max()

    # In flight steps of order 2 are exact, and so is a polynomial through flight alone.
    assert largest(np.linspace(0.0, 0.3149, 500)) < 1e-12


@pytest.mark.parametrize("obstacle", ["obstacle", "stop"])
def test_order_four_warns_of_losses_at_impacts(obstacle, caplog):
    for order, loss in ((4, 0.5), (4, 1.0), (2, 0.5)):
        scene, node = ball()
        if obstacle == "obstacle":
            scene.add_contact(
                node, fb.Line((0, 0), normal=(0, 1)), 1e4, restitution=loss, speed=0.1
            )
        else:
            end = fb.Stop(-HEIGHT, None, 1e4, restitution=loss, speed=0.1)
            scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), stop=end))
        caplog.clear()
        fb.simulate(scene, fb.EnergyMomentum(order), t_end=0.05, tolerance=1e-3)
        assert ("losses at impacts" in caplog.text) is (order == 4 and loss < 1)


def test_a_kink_that_a_parameter_moves_is_an_event_of_its_own_time():
    # A rope whose length changes slackens and tightens twice: beside an ODE in its one unknown.
    def length(t):
        return 3.0 + 0.3 * np.sin(6 * t)

    scene, ball = held_body((0, 0), mass=20.0, inertia=0.5, gravity=(0, -9.81))
    L = fb.Parameter("length", length)
    rope = fb.Spring(strain_energy=lambda r: 1e4 * ufl.max_value(r - L, 0) ** 2)
    scene.add_force_between(ball, (0, 3), spring=rope)

    def rates(t, y):
        return [y[1], -9.81 + 1e3 * max(3 - y[0] - length(t), 0.0)]

    accurate = {"rtol": 1e-11, "atol": 1e-11, "max_step": 1e-3}
    for tolerance in (1e-3, 1e-4):
        solution = fb.simulate(scene, fb.EnergyMomentum(order=4), t_end=1.0, tolerance=tolerance)
        exact = solve_ivp(rates, (0, 1.0), [0, 0], t_eval=solution.t, **accurate)
        error = abs(solution.displacement(ball)[:, 1] - exact.y[0]).max()
        assert error < 5 * tolerance
        assert solution.stats.steps + solution.stats.rejected < 500
