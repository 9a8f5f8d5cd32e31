"""Set-up of scenes with many functions of one's own: springs, obstacles and sections.

    .venv/bin/python benchmarks/own_functions.py [count ...]

Cantilevers in a row, each with a function that is made for it: all give the same, or each has a
number or a parameter of its own. Processor times [s] of a motion of one step, compilation
included, and of the same once more, while the first solution is in use.
"""

import os
import sys
import tempfile

COUNTS = 10, 100
if __name__ == "__main__":  # before the package is imported
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()

import resource  # noqa: E402

import fx_beam as fb  # noqa: E402


def spring(scene, beam, number):
    energy = lambda x: number * x**2 + x**4  # noqa: E731
    place = beam.end.x, 1.0
    scene.add_force_between(beam.end, place, spring=fb.Spring(strain_energy=energy))


def obstacle(scene, beam, number):
    floor = fb.Line((0, -0.1), normal=(0, 1))
    scene.add_contact(beam.end, floor, energy=lambda depth: 100 * number * depth**2.5)


def of_number(i):
    return 5.0 + 0.01 * i


def row(count, add, number):
    scene = fb.Scene(gravity=(0.0, -9.81))
    for i in range(count):
        data = {"EA": 1e4, "GA": 1e4, "EI": 10.0}
        if add is None:
            k = number(i)
            data = {"strain_energy": lambda e, g, c, k=k: 1e3 * k * (e**2 + g**2) + k * c**2}
        section = fb.Section(**data, rhoA=1.0, rhoI=0.01)
        beam = scene.add_beam([(2 * i, 0), (2 * i + 1, 0)], section, elements=1)
        scene.clamp(beam.start)
        if add is not None:
            add(scene, beam, number(i))
    return scene


def processor_time():
    """Processor time [s], that of the compiler included."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(use.ru_utime + use.ru_stime for use in map(resource.getrusage, kinds))


def measured(scene):
    """Times of a motion, and of the same while its solution is in use."""
    times, solutions = [processor_time()], []
    for _ in range(2):
        solutions.append(fb.simulate(scene, dt=1e-3, t_end=1e-3, progress=False))
        times.append(processor_time())
    return times[1] - times[0], times[2] - times[1]


NUMBERS = {
    "the same": lambda i: 5.0,
    "a parameter each": lambda i: fb.Parameter(f"k{i}", of_number(i)),
    "a number each": of_number,
}
KINDS = {"springs": spring, "obstacles": obstacle, "sections": None}


def main(*counts):
    measured(row(1, spring, of_number))
    print(f"{'':34} {'first':>8} {'again':>8}")
    for kind, add in KINDS.items():
        for what, number in NUMBERS.items():
            for count in counts or COUNTS:
                first, again = measured(row(count, add, number))
                print(f"{count:5} {kind + ', ' + what:28} {first:8.2f} {again:8.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
