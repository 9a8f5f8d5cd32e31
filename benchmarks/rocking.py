"""Impacts of a rocking block by the steps in each contact, against rigid impacts.

    .venv/bin/python benchmarks/rocking.py

A block of 0.2 m x 0.8 m and 1 kg is let go at rest, turned by half of the angle at which it would
fall over, on a floor of 1e6 N/m that takes nearly all energy of an impact (restitution 0), and
whose friction holds the corners. Rigid impacts (Housner 1963): between them
theta'' = -(3 g / 4 R) sin(alpha - theta), and each leaves 1 - 3/2 sin(alpha)^2 of the spin.
"""

import logging

import numpy as np
from scipy.integrate import solve_ivp

import fx_beam as fb

G, WIDTH, HEIGHT, MASS, STIFFNESS = 9.81, 0.2, 0.8, 1.0, 1e6
R, ALPHA = np.hypot(WIDTH, HEIGHT) / 2, np.arctan(WIDTH / HEIGHT)
THETA, IMPACTS = ALPHA / 2, 3
# Of the mass that a corner feels at an impact: 1/m + b^2/J.
INERTIA = MASS * (WIDTH**2 + HEIGHT**2) / 12
FELT = 1 / (1 / MASS + (WIDTH / 2) ** 2 / INERTIA)
CONTACT = np.pi * np.sqrt(FELT / STIFFNESS)
STEPS = 5, 10, 15, 30, 60, 120, 240, 480


def rigid():
    """Times of the impacts on a rigid floor [s]."""
    times, theta, spin, t = [], THETA, 0.0, 0.0
    for _ in range(IMPACTS):

        def turns(t, y):
            return [y[1], -3 * G / (4 * R) * np.sin(ALPHA - y[0])]

        def closes(t, y):
            return y[0] if t > 0 else 1.0

        closes.terminal, closes.direction = True, -1
        fall = solve_ivp(turns, (0, 10), [theta, spin], events=closes, rtol=1e-11, atol=1e-13)
        t, theta = t + fall.t[-1], 0.0
        spin = -fall.y[1, -1] * (1 - 1.5 * np.sin(ALPHA) ** 2)
        times.append(t)
    return np.array(times)


def rocking(dt, t_end):
    """Times of the impacts [s]: where the block is upright, between steps."""
    scene = fb.Scene(gravity=(0, -G))
    c, s = np.cos(THETA), np.sin(THETA)
    corners = {
        name: np.array([x, -HEIGHT / 2]) for name, x in (("l", -WIDTH / 2), ("r", WIDTH / 2))
    }
    turned = {name: np.array([c * x - s * y, s * x + c * y]) for name, (x, y) in corners.items()}
    centre = np.array([0.0, -turned["l"][1]])  # it stands on the left corner, turned to the left
    points = {name: tuple(centre + arm) for name, arm in turned.items()}
    block = scene.add_body(tuple(centre), MASS, INERTIA, points)
    law = {"restitution": 0.0, "speed": 1e-3, "friction": fb.Coulomb(2.0, STIFFNESS)}
    for name in corners:
        scene.add_contact(block[name], fb.Line((0, 0), (0, 1)), stiffness=STIFFNESS, **law)
    solution = fb.simulate(scene, dt=dt, t_end=t_end)
    theta, t = THETA + solution.rotation(block.centre), solution.t
    k = np.flatnonzero(theta[:-1] * theta[1:] < 0)
    return t[k] - theta[k] * (t[k + 1] - t[k]) / (theta[k + 1] - theta[k])


def main():
    logging.getLogger("fx_beam").setLevel(logging.ERROR)
    exact = rigid()
    times = {n: rocking(CONTACT / n, exact[-1] + 0.1)[:IMPACTS] for n in STEPS}
    print("impacts on a rigid floor at", *(f"{1e3 * t:.2f}" for t in exact), "ms")
    print(f"a contact lasts {1e3 * CONTACT:.2f} ms; steps in it, impacts later than with most [ms]")
    for steps, impacts in times.items():
        print(f"{steps:4}", *(f"{1e3 * error:8.3f}" for error in impacts - times[STEPS[-1]]))
    print("and with these later than on a rigid floor", 1e3 * (times[STEPS[-1]] - exact))


if __name__ == "__main__":
    main()
