"""Friction that sticks, with its damping and without, against rigid friction; restitution by steps.

    .venv/bin/python benchmarks/bristle.py

A bead on the swinging rod of tests/claims/test_bristle_damping.py, a block of 1 kg on a plate that
is shaken by 0.05 m (1 - cos 10 t), and a ball of 1 kg that hits a floor with 1 m/s.
"""

import sys
from itertools import pairwise
from math import cos, pi
from pathlib import Path

import numpy as np

import fx_beam as fb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests/claims"))

from test_bristle_damping import END, GRAVITY, bead, exact

STEPS = 4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5
SHAKE, RATE, MU, SHAKEN = 0.05, 10.0, 0.3, 1.0
SCHEMES = fb.EnergyMomentum(), fb.EnergyDecaying()


def on_plate(stiffness, **damping):
    """A block on a plate whose motion is given, and the joint between them."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    plate, block = (scene.add_body((0, 0), mass=1.0, inertia=0.1).centre for _ in range(2))
    scene.fix(plate, "y", "rotation")
    scene.prescribe(plate, x=lambda t: SHAKE * (1 - cos(RATE * t)))
    friction = fb.Coulomb(MU, stiffness, **damping)
    return scene, scene.add_joint(fb.Prismatic(plate, block, axis=(1, 0), friction=friction))


def exact_on_plate(times):
    """Slides of the block with rigid friction, which brings it to the speed of the plate."""
    dt, v, slides = 5e-6, 0.0, [0.0]
    ends = dt * np.arange(round(times[-1] / dt) + 1)
    rates = (SHAKE * RATE * np.sin(RATE * ends)).tolist()
    most = MU * GRAVITY * dt
    for before, after in pairwise(rates):
        last, v = v, v + min(max(after - v, -most), most)
        slides.append(slides[-1] + dt * (last + v - before - after) / 2)
    return np.interp(times, ends, slides)


def main():
    print("Largest error [m] of the slide")
    print(" " * 50, *(f"{1e3 * dt:8g}" for dt in STEPS), "ms")
    for name, made, end, known in (
        ("bead", bead, END, lambda t: exact(t)[0]),
        ("plate", on_plate, SHAKEN, exact_on_plate),
    ):
        for scheme in SCHEMES:
            for stiffness in (1e5, 1e6):
                for damping in ({}, {"damping": 0.0}):
                    errors = []
                    for dt in STEPS:
                        scene, rail = made(stiffness, **damping)
                        solution = fb.simulate(scene, scheme, dt=dt, t_end=end)
                        errors.append(abs(solution.joint(rail).slide - known(solution.t)).max())
                    row = f"{name} {scheme.name} {stiffness:g} {damping or 'critical'}"
                    print(f"{row:50}", *(f"{error:8.1e}" for error in errors))
    for tolerance in (1e-3, 1e-4, 1e-5):
        for damping in ({}, {"damping": 0.0}):
            scene, rail = bead(1e5, **damping)
            solution = fb.simulate(scene, t_end=END, tolerance=tolerance)
            error = abs(solution.joint(rail).slide - exact(solution.t)[0]).max()
            print(f"bead, tolerance {tolerance:g} {damping}: {error:.1e}, {len(solution.t)} steps")
    print("Restitution: steps a contact, least and largest over the places where steps end")
    for e in (0.8, 0.5, 0.2, 0.0):
        for steps in (0.3, 1, 1.6, 3, 6, 10, 15, 30, 60):
            rebounds = [bounce(e, pi * 1e-3 / steps, part / 20) for part in range(20)]
            print(f"{e:4} {steps:5} {min(rebounds):6.3f} {max(rebounds):6.3f}")


def bounce(restitution, dt, part):
    """Speed of a ball after it hit a floor with 1 m/s, at a part of a step."""
    scene = fb.Scene()
    ball = scene.add_body((0, 0.02 + part * dt), mass=1.0, inertia=0.1).centre
    floor = fb.Line((0, 0), (0, 1))
    scene.add_contact(ball, floor, stiffness=1e6, restitution=restitution, speed=0.01)
    scene.set_velocity(ball, (0, -1.0))
    return fb.simulate(scene, dt=dt, t_end=0.03 + 8 * dt).velocity(ball)[-1, 1]


if __name__ == "__main__":
    main()
