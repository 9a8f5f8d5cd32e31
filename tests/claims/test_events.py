"""Steps of a tolerance meet contacts, stops and switches of laws; rows between are as accurate."""

import ufl

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.scene.law import switches
from fx_beam.stepping import adaptive_run
from fx_beam.stepping.events import end_behind_event

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
    scene.add_obstacle(node, fb.Line((0, 0), normal=(0, 1)), k)
    return scene, node


def stop(k):
    """It is guided down to the stop of a slide."""
    scene, node = ball()
    scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), stop=(-HEIGHT, None, k)))
    return scene, node


def law(k):
    """It is guided by a spring whose energy has two pieces."""

    def energy(x):
        return k / 2 * ufl.conditional(ufl.lt(x, -HEIGHT), (x + HEIGHT) ** 2, 0.0)

    scene, node = ball()
    spring = fb.Spring(strain_energy=energy)
    scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), spring=spring))
    return scene, node


def rod(k):
    """It is on a rod of 1 m that resists only when it is shorter than a half."""

    def energy(eps, gamma, kappa):
        short = k / 2 * ufl.conditional(ufl.lt(eps, -HEIGHT), (eps + HEIGHT) ** 2, 0.0)
        return short + 5e5 * gamma**2 + 5e3 * kappa**2

    scene = fb.Scene(gravity=(0, -GRAVITY))
    beam = scene.add_beam([(0, -HEIGHT), (0, 1 - HEIGHT)], fb.Section(strain_energy=energy))
    scene.clamp(beam.start)
    scene.add_mass(beam.end, MASS)
    return scene, beam.end


def ball():
    scene = fb.Scene(gravity=(0, -GRAVITY))
    measure = scene.add_beam([(2, 0), (3, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4))  # size 1 m
    scene.clamp(measure.start)
    return scene, scene.add_body((0, HEIGHT), mass=MASS, inertia=1.0).centre


def errors(make, k, tolerance, order, times=None, **options):
    """Largest errors of the height [m] and the velocity [m/s], and the solution."""
    scene, node = make(k)
    record = None if times is None else fb.Record(times=times)
    scheme = fb.EnergyMomentum(order)
    solution = fb.simulate(
        scene, scheme, t_end=T_END, tolerance=tolerance, record=record, **options
    )
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


@pytest.mark.parametrize("make", [floor, stop, law, rod])
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_obstacles_stops_and_laws_with_pieces_keep_the_tolerance_with_order_four(make, solver):
    for tolerance in (1e-3, 1e-5) if solver == "compiled" else (1e-4,):
        for times in (None, TIMES) if solver == "compiled" else (TIMES,):
            place, velocity, _ = errors(make, 1e4, tolerance, 4, times, solver=solver)
            assert place < 2 * tolerance
            # An error of place in the contact, of the frequency 100 /s; a section has no events.
            assert velocity < (500 if make is rod else 100) * tolerance


def test_steps_of_order_four_end_where_a_contact_begins_and_ends():
    *_, solution = errors(floor, 1e4, 1e-5, 4)
    fall = np.sqrt(2 * HEIGHT / GRAVITY)
    v, w = GRAVITY * fall, 100.0
    contact = 2 * (np.pi - np.arctan2(v / w, GRAVITY / w**2)) / w
    for event in (fall, fall + contact, 3 * fall + contact, 3 * fall + 2 * contact):
        assert abs(solution.t - event).min() < 2e-5
    force = solution.contact(solution.obstacles[0]).force[1:, 0, 1]
    momentum = np.diff(solution.linear_momentum[:, 1])
    assert force * np.diff(solution.t) - GRAVITY * np.diff(solution.t) == pytest.approx(
        momentum, abs=1e-10
    )


def test_rows_between_constant_steps_do_not_reach_over_a_contact():
    def largest(times):
        scene, node = floor(1e4)
        record = fb.Record(times=times)
        solution = fb.simulate(scene, dt=5e-3, t_end=0.319, record=record)
        return abs(solution.position(node)[:, 1] - exact(solution.t, 1e4)[0]).max()

    # In flight steps of order 2 are exact, and so is a polynomial through flight alone.
    assert largest(np.linspace(0.0, 0.3149, 500)) < 1e-12


@pytest.mark.parametrize(
    ("expression", "at"),
    [
        (lambda x: ufl.conditional(ufl.gt(x, 2.0), x**2, 0.0), [2.0]),
        (lambda x: ufl.max_value(x - 1, 0.0) + ufl.min_value(0.0, x + 3), [1.0, -3.0]),
        (lambda x: abs(x - 4), [4.0]),
        (lambda x: x**2 + ufl.sin(x), []),
        (lambda x: ufl.conditional(ufl.And(ufl.gt(x, 1.0), ufl.lt(x, 5.0)), x, 0.0), [1.0, 5.0]),
    ],
)
def test_the_switches_of_an_expression_change_sign_where_its_pieces_meet(expression, at):
    found = [
        [float(value) for value in switches(expression(_Number(x)))]
        for x in sorted({-10.0, 10.0, *(a + side for a in at for side in (-1e-6, 1e-6))})
    ]
    changes = np.diff(np.array(found) < 0, axis=0).any(axis=1) if at else np.zeros(1, bool)
    assert np.count_nonzero(changes) == len(at)


def _Number(x):
    """A number that UFL does not evaluate."""
    return ufl.variable(ufl.as_ufl(x))


@pytest.mark.parametrize("of", ["obstacle", "stop"])
def test_order_four_warns_of_losses_at_impacts(of, caplog):
    for order, loss in ((4, 0.5), (4, 1.0), (2, 0.5)):
        scene, node = ball()
        if of == "obstacle":
            scene.add_obstacle(
                node, fb.Line((0, 0), normal=(0, 1)), 1e4, restitution=loss, speed=0.1
            )
        else:
            end = fb.Stop(-HEIGHT, None, 1e4, restitution=loss, speed=0.1)
            scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(0, 1), stop=end))
        caplog.clear()
        fb.simulate(scene, fb.EnergyMomentum(order), t_end=0.05, tolerance=1e-3)
        assert ("losses at impacts" in caplog.text) is (order == 4 and loss < 1)


@pytest.mark.parametrize("k", [1e4, 1e6])
def test_an_event_is_found_in_a_few_trial_steps(k, monkeypatch):
    trials = []

    def counted(first, values, t0, t1):
        found = []

        def value(t):
            found.append(values(t))
            return found[-1]

        end = end_behind_event(first, value, t0, t1)
        if end is not None:
            trials.append(len(found))
        return end

    monkeypatch.setattr(adaptive_run, "end_behind_event", counted)
    errors(floor, k, 1e-5, 4)
    assert len(trials) == 6 and max(trials) <= 10


def test_the_end_of_a_step_lies_just_behind_the_first_event():
    def gaps(t):  # falls on a stiff floor; a slower one; one that never meets
        return np.array([1 - t**2 if t < 1 else (1 - t) / 100, 1.5 - t, 1 + t])

    for end in (1.1, 1.4, 2.0, 3.0):
        found = end_behind_event(gaps(0.0), gaps, 0.0, end)
        assert 1 < found < 1 + 3e-5 * end
    assert end_behind_event(gaps(0.0), gaps, 0.0, 0.9) is None
