"""Cost of a node that slides: time of a Newton iteration with and without a slider.

A mass at the end of a small beam slides along a simply supported beam, or is clamped beside it. Two
masses that a stiff beam joins, the wheels of a carriage, make the matrix full.

    .venv/bin/python benchmarks/sliders.py [elements ...]
"""

import sys

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
MOST_NODES = 600


def guide(elements, degree):
    """A simply supported beam under gravity, and its scene."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (6, 0)], SECTION, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    return scene, beam


def mass(elements, degree, slides):
    scene, beam = guide(elements, degree)
    small = scene.add_beam([(0.5, 0), (0.5, 0.3)], SECTION, degree=degree)
    scene.add_mass(small.start, 0.8, inertia=0.05)
    if slides:
        scene.add_joint(fb.Slider(beam, small.start))
        scene.set_velocity(small, (2.0, 0.0))
    else:
        scene.clamp(small.start)
    return scene


def carriage(elements, degree):
    scene, beam = guide(elements, degree)
    axle = scene.add_beam([(0.5, 0), (1.1, 0)], SECTION, degree=degree)
    for wheel in (axle.start, axle.end):
        scene.add_mass(wheel, 0.4)
        scene.add_joint(fb.Slider(beam, wheel))
    scene.set_velocity(axle, (2.0, 0.0))
    return scene


def iteration(scene):
    """Milliseconds of an iteration."""
    stats = fb.simulate(scene, dt=0.002, t_end=1.0, record=fb.Record(every=100)).stats
    return 1e3 * stats.seconds / stats.newton_iterations


def main(*sizes):
    print("degree elements   without   with one   carriage   [ms an iteration]")
    for degree in (1, 2, 3):
        for elements in sizes or (10, 50, 200, 500):
            if elements * degree > MOST_NODES:
                continue
            scenes = mass(elements, degree, False), mass(elements, degree, True)
            if elements <= 200:
                scenes = *scenes, carriage(elements, degree)
            print(
                f"{degree:6} {elements:8}", *(f"{iteration(s):10.3f}" for s in scenes), flush=True
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
