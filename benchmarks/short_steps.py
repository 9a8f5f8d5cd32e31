"""Digits of forces and of the energy balance in short steps, of joints with arms and of slides.

    .venv/bin/python benchmarks/short_steps.py

Two bodies in a chain, a loop of three bodies, and a mast whose foot slides on a beam, which start
from rest, each with 40 steps of several lengths. Noise is the third difference of the force of a
joint over the steps, relative to the force: what is smooth has next to none. Then the loop from a
motion, with the largest error of its energy balance in 3000 steps [J].
"""

import numpy as np

import fx_beam as fb

LENGTHS = 1e-5, 1e-6, 1e-7, 1e-8
SCHEMES = fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.Newmark()


def chain(scene):
    first = scene.add_body((0.5, 0.1), 2.0, 0.3, points={"pin": (0, 0), "end": (1, 0)})
    second = scene.add_body((1.5, 0.1), 1.0, 0.1, points={"start": (1, 0)})
    scene.pin(first["pin"])
    return scene.add_joint(fb.Revolute(first["end"], second["start"]))


def loop(scene):
    corners, bars = [(0, 0), (0, 1), (2, 1.5), (2.2, 0)], []
    for start, end in zip(corners, corners[1:], strict=False):
        middle = np.mean([start, end], axis=0) + (0.1, 0)
        bars.append(scene.add_body(middle, 2.0, 0.3, points={"start": start, "end": end}))
    scene.pin(bars[0]["start"])
    scene.pin(bars[2]["end"])
    pairs = zip(bars, bars[1:], strict=False)
    return [scene.add_joint(fb.Revolute(a["end"], b["start"])) for a, b in pairs][0]


def slider(scene):
    section = fb.Section(EA=1e3, GA=1e3, EI=10.0, rhoA=2.0, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (1, 0.3), (2, 0)], section, elements=6)
    mast = scene.add_beam([(0.5, 0.15), (0.5, 1.0)], section, elements=2)
    scene.pin(beam.start)
    return scene.add_joint(fb.Slider(beam, mast.start))


def noise(build, scheme, dt):
    scene = fb.Scene(gravity=(0, -9.81))
    joint = build(scene)
    solution = fb.simulate(scene, scheme, dt=dt, t_end=40 * dt, progress=False)
    force = solution.joint(joint).force[6:]
    return abs(np.diff(force, 3, axis=0)).max() / abs(force).max()


def main():
    row = "{:8} {:28}".format
    print(row("", "noise of forces with dt ="), *(f"{dt:8.0e}" for dt in LENGTHS))
    for build in (chain, loop, slider):
        for scheme in SCHEMES:
            values = (f"{noise(build, scheme, dt):8.0e}" for dt in LENGTHS)
            print(row(build.__name__, scheme.name), *values)
    scene = fb.Scene(gravity=(0, -9.81))
    loop(scene)
    swung = fb.simulate(scene, dt=1e-3, t_end=0.3, progress=False)
    errors = []
    for dt in LENGTHS:
        moved = {"dt": dt, "t_end": 0.3 + 3000 * dt, "start": swung, "progress": False}
        errors.append(abs(fb.simulate(scene, **moved).energy.balance_error).max())
    print(row("loop", "error of the energy [J]"), *(f"{error:8.0e}" for error in errors))


if __name__ == "__main__":
    main()
