"""Forces between two points: closed solutions, statics, small motions, bad input."""

import numpy as np
import pytest
from scenes import held_body

import fx_beam as fb


def balls(distance=1.0):
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), mass=2.0, inertia=0.1) for x in (0, distance)]
    return scene, *(body.centre for body in bodies)


def repelled(dt):
    """Distance of two magnets with the energy c / r^2 that approach each other, and its error."""
    scene, left, right = balls(2.0)
    scene.add_force_between(left, right, spring=fb.Spring(strain_energy=lambda x: 3 / x**2))
    for node, v in ((left, 1.5), (right, -1.5)):
        scene.set_velocity(node, (v, 0.0))
    solution = fb.simulate(scene, dt=dt, t_end=2.0)
    r = np.hypot(*(solution.position(right) - solution.position(left)).T)
    # m r'^2 / 4 + c / r^2 = E, which r^2 = c / E + (4 E / m) (t - t0)^2 solves.
    E = 2.0 * 1.5**2 + 3 / 2.0**2
    turn = np.sqrt((4.0 - 3 / E) / (4 * E / 2.0))
    return solution, abs(r - np.sqrt(3 / E + (4 * E / 2.0) * (solution.t - turn) ** 2)).max()


def test_two_magnets_turn_back_as_the_closed_form_says_with_order_two():
    solution, coarse = repelled(0.02)
    _, fine = repelled(0.01)
    assert coarse / fine == pytest.approx(4, rel=0.15) and fine < 1e-3
    assert abs(solution.energy.balance_error).max() < 1e-12


def test_a_muscle_lifts_a_mass_as_its_law_says():
    # A pull F (1 - shortening rate / w): m v' = F (1 - v / w) - m g from rest.
    scene, mass = held_body((0, 0), mass=2.0, inertia=0.1, gravity=(0, -10))
    scene.add_force_between(mass, (0, 5), force=lambda r, rate, t: 30 * (1 + rate / 4))
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    t, rest = solution.t, 2.0 * 4 / 30
    speed = (30 - 20) * 4 / 30 * (1 - np.exp(-t / rest))
    assert solution.v[:, mass.number, 1] == pytest.approx(speed, abs=1e-6)
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.work[-1]


def test_a_rope_holds_a_pendulum_only_where_it_is_tight():
    scene, mass = held_body((1.0, 0), mass=1.0, inertia=0.1, gravity=(0, -10))
    scene.add_force_between(mass, (0, 0), stop=(None, 2.0, 1e6))
    solution = fb.simulate(scene, dt=1e-3, t_end=3.0)
    x, y = solution.position(mass).T
    falls = solution.t < 0.5
    assert y[falls] == pytest.approx(-5 * solution.t[falls] ** 2, abs=1e-5)
    assert 2.0 < np.hypot(x, y).max() < 2.02
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_a_mass_on_springs_hangs_and_vibrates_as_linear_theory_says():
    scene, mass = held_body((0, -1), 2.0, 0.1, "rotation", gravity=(0, -10))
    for x in (-1.0, 1.0):
        scene.add_force_between(mass, (x, 0.0), fb.Spring(400.0, rest=np.sqrt(2)))
    state = fb.static(scene)
    y = -state.position(mass)[-1, 1]
    r = np.hypot(1, y)
    pull = 400 * (r - np.sqrt(2))
    assert 2 * pull * y / r == pytest.approx(20.0, rel=1e-9)
    frequencies = fb.modes(scene, state=state).frequencies
    # Along and across: k sin^2 + (F / r) cos^2 of each spring, and the same with both exchanged.
    c, s = 1 / r, y / r
    k = 2 * (400 * np.array([c**2, s**2]) + pull / r * np.array([s**2, c**2]))
    assert frequencies == pytest.approx(np.sort(np.sqrt(k / 2.0)) / (2 * np.pi), rel=1e-6)
