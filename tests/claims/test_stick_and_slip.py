"""A block that sticks and slips on a rail, against exact motions with and without its spring.

Friction has no damping of its own here.
"""

from math import sin

import numpy as np
import pytest
from scenes import guided_body
from scipy.integrate import solve_ivp

import fx_beam as fb

MU, GRAVITY, SPRING, FORCE, RATE = 0.3, 9.81, 20.0, 4.0, 5.2
LIMIT = MU * GRAVITY  # of a block of 1 kg


def phase(sign, stiffness):
    """Rates of place, speed and stretch while it sticks (sign 0) or slips, and what ends it."""

    def rates(t, y):
        x, v, z = y
        friction = sign * LIMIT if sign else stiffness * z
        return v, FORCE * sin(RATE * t) - SPRING * x - friction, 0.0 if sign else v

    def limit(t, y):
        return y[1] if sign else stiffness * abs(y[2]) - LIMIT

    limit.terminal, limit.direction = True, -sign or 1
    return rates, limit


def exact(stiffness, t_end):
    """Places at the ends of a motion from rest, where it sticks, and times at which it changes."""
    t, y, sign, changes = 0.0, np.zeros(3), 0, []
    while t < t_end:
        rates, limit = phase(sign, stiffness)
        options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14, "max_step": 0.01}
        part = solve_ivp(rates, (t, t_end), y, events=limit, **options)
        t, y = part.t[-1], part.y[:, -1]
        if part.status:
            changes.append(t)
            sign = 0 if sign else int(np.sign(y[2]))
            y[2] *= 1 - 1e-13  # not again at the limit that it has just left
    return y[0], np.array(changes)


def block(stiffness):
    own = {"spring": fb.Spring(SPRING), "friction": fb.Coulomb(MU, stiffness, damping=0.0)}
    scene, centre, _ = guided_body((0, 0), 1.0, 0.1, **own, gravity=(0, -GRAVITY))
    scene.add_force(centre, lambda t: (FORCE * sin(RATE * t), 0.0))
    return scene, centre


def test_sticking_and_slipping_is_of_first_order_against_the_exact_motion_with_the_spring():
    """While it sticks, the step damps the spring by kt dt / 2."""
    x, changes = exact(1e4, 1.0)
    assert len(changes) == 5
    errors = []
    for dt in (5e-4, 2.5e-4, 1.25e-4):
        scene, centre = block(1e4)
        errors.append(abs(fb.simulate(scene, dt=dt, t_end=1.0).position(centre)[-1, 0] - x))
    assert errors[-1] < 1e-4
    assert np.divide(errors[:-1], errors[1:]) == pytest.approx(2, abs=0.25)


def rigid(t_end):
    """Motion with a friction without a spring: it sticks until the other forces reach its limit."""
    t, x, changes = 0.0, 0.0, []
    while True:
        times = np.arange(t, t_end, 1e-5)
        pull = FORCE * np.sin(RATE * times) - SPRING * x
        beyond = np.flatnonzero(abs(pull) > LIMIT)
        if not len(beyond):
            return x, np.array(changes)
        rates, stops = phase(int(np.sign(pull[beyond[0]])), 1.0)
        start, options = times[beyond[0]], {"rtol": 1e-10, "atol": 1e-13, "events": stops}
        part = solve_ivp(rates, (start, t_end), [x, 0.0, 0.0], **options)
        t, x = part.t[-1], part.y[0, -1]
        changes += [start, t]


def test_steps_that_damp_the_spring_of_friction_are_nearer_to_rigid_friction_than_shorter_ones():
    """Without damping it vibrates, and slips at its turns."""
    ends = []
    for dt in (2.5e-3, 1e-4):
        scene, centre = block(1e5)
        ends.append(fb.simulate(scene, dt=dt, t_end=1.1).position(centre)[-1, 0])
    (x, changes), (vibrating, slips) = rigid(1.1), exact(1e5, 1.1)
    assert len(changes) < 5 < 12 < len(slips)
    assert abs(ends[0] - x) < 1e-4 < abs(ends[1] - x)
    assert abs(ends[1] - vibrating) < abs(ends[0] - vibrating)
