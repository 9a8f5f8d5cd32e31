"""Cost of nodes that slide: set-up, and time of a Newton iteration, with and without them.

A mass at the end of a small beam slides along a simply supported beam, or is clamped beside it. Two
masses that a stiff beam joins are a carriage; two carriages follow each other.

    .venv/bin/python benchmarks/sliders.py [elements ...]

Processor times: the least of several runs, in which the scenes take turns.
"""

import sys
from time import process_time

import numpy as np

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
SPEED, STEPS, RUNS = 1.0, 200, 3


def guide(elements, degree):
    """A simply supported beam under gravity, and its scene."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (6, 0)], SECTION, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    return scene, beam


def mass(elements, degree, slides):
    scene, beam = guide(elements, degree)
    small = scene.add_beam([(0.5, 0), (0.5, 0.3)], SECTION, degree=degree, elements=1)
    scene.add_mass(small.start, 0.8, inertia=0.05)
    if slides:
        scene.add_joint(fb.Slider(beam, small.start))
        scene.set_velocity(small, (SPEED, 0.0))
    else:
        scene.clamp(small.start)
    return scene


def carriages(elements, degree, number, make=fb.Slider):
    scene, beam = guide(elements, degree)
    spacing = min(1.2, 5.0 / number)
    for place in 0.5 + spacing * np.arange(number):
        axle = scene.add_beam(
            [(place, 0), (place + spacing / 2, 0)], SECTION, degree=degree, elements=1
        )
        for wheel in (axle.start, axle.end):
            scene.add_mass(wheel, 0.4, inertia=0.05)
            scene.add_joint(make(beam, wheel))
        scene.set_velocity(axle, (SPEED, 0.0))
    return scene


SCENES = {
    "without": lambda *size: mass(*size, False),
    "one": lambda *size: mass(*size, True),
    "two": lambda *size: carriages(*size, 1),
    "four": lambda *size: carriages(*size, 2),
    "thirty": lambda *size: carriages(*size, 15),
    "sleeves": lambda *size: carriages(*size, 1, fb.Sleeve),
}


def seconds(scene, steps, elements):
    """Processor time, and number of iterations; a step passes at most half an element."""
    dt, start = min(0.002, 3.0 / elements / SPEED), process_time()
    solution = fb.simulate(scene, dt=dt, t_end=steps * dt, record=fb.Record(every=steps))
    return process_time() - start, solution.stats.newton_iterations


def main(*sizes):
    print("degree elements " + "".join(f"{name:>17}" for name in SCENES))
    print(" " * 16 + "   set-up [s]  ms" * len(SCENES))
    for degree in (1, 2, 3):
        for elements in sizes or (10, 50, 200, 500, 2000):
            if elements * degree > 2000:
                continue
            set_up, scenes, runs = {}, {}, {name: [] for name in SCENES}
            for name, made in SCENES.items():
                start = process_time()
                scenes[name] = made(elements, degree)
                seconds(scenes[name], 1, elements)
                set_up[name] = process_time() - start
            for _ in range(RUNS):
                for name, scene in scenes.items():
                    _, few, all_ = (seconds(scene, n, elements) for n in (1, STEPS // 4, STEPS))
                    runs[name].append([*few, *all_])  # the first one has the set-up of this scene
            best = {}
            for name in SCENES:
                few, first_time, all_, iterations = np.min(runs[name], axis=0)
                best[name] = 1e3 * (all_ - few) / (iterations - first_time)
            row = "".join(f"{set_up[n]:10.2f}{best[n]:7.3f}" for n in SCENES)
            print(f"{degree:6} {elements:8} {row}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
