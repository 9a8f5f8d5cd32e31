"""Time per step of the pinned beam, relative to a C program for this one problem (floor.c).

    .venv/bin/python benchmarks/floor.py [runs]

Both take turns in one process. Medians of the processor time of the steps, and of their ratio, for
a step, and for an iteration, as the program predicts increments in its own way; the largest
difference of the displacements at the end, as both compute the same motion; iterations per step.

With 2048 elements an iteration consists of functions of elements (31 of 117 us), their numbers,
forces and tangents, with those of the masses (23), elimination and substitution (24), and forces of
the masses (6). Tried without gain: to eliminate each element as soon as it is assembled spares a
tenth, and takes twice the time, as it cannot go on from both ends.
"""

import ctypes
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import thread_time

import numpy as np
from demo_scenes import demo
from steps import timed_steps

import fx_beam as fb

# Elements, step [s], steps, and the order of the program's prediction, the best for it.
CASES = (8, 0.01, 1000, 0), (8, 0.001, 4000, 3), (2048, 0.001, 60, 3)
ROOM = 1000  # behind the arrays
FLAGS = "-O3", "-march=native", "-ffast-math", "-Wno-psabi", "-shared", "-fPIC", "-lmvec", "-lm"


def compiled(folder):
    """The program as a library."""
    path = Path(folder) / "floor.so"
    source = Path(__file__).with_name("floor.c")
    subprocess.run(["cc", source, "-o", path, *FLAGS], check=True)
    library = ctypes.CDLL(str(path))
    library.fx_floor.restype = ctypes.c_long
    return library


def by_program(library, elements, dt, steps, order):
    """Seconds of the steps, their iterations, and the last displacements (nodes, 3)."""
    pinned = demo("pinned_beam")
    middle, x = pinned.LENGTH / 2, np.linspace(0, pinned.LENGTH, elements + 1)
    rates = np.zeros((3, elements + 1))
    rates[1] = pinned.VELOCITY * (1 - abs(x / middle - 1))
    rates[2] = pinned.VELOCITY / middle * np.sign(middle - x)
    q, v = np.zeros((2, rates.size + ROOM))
    v[: rates.size], data = rates.ravel(), pinned.SECTION
    section = np.array([data.EA, data.GA, data.EI, data.rhoA, data.rhoI])
    arrays = [array.ctypes.data_as(ctypes.c_void_p) for array in (section, q, v)]
    length, dt = ctypes.c_double(pinned.LENGTH / elements), ctypes.c_double(dt)
    started = thread_time()
    iterations = library.fx_floor(elements, length, *arrays, dt, steps, order)
    return thread_time() - started, iterations, q[: rates.size].reshape(rates.shape).T


def by_package(elements, dt, steps):
    """Time by `simulate`."""
    scene, _ = demo("pinned_beam").scene(elements)
    with timed_steps() as seconds:
        solution = fb.simulate(scene, dt=dt, t_end=steps * dt, record=fb.Record(every=steps))
    return sum(seconds), solution.stats.newton_iterations, solution.q[-1]


def main(runs=9):
    by_package(*CASES[0][:3])  # compiles; numpy sees denormal numbers, which the program turns off
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(folder)
    print("elements   dt [s]  program package [us]  ratio, of an iteration  difference  iterations")
    for elements, dt, steps, order in CASES:
        rows = []
        for _ in range(runs):
            floor, package = (
                by_program(library, elements, dt, steps, order),
                by_package(elements, dt, steps),
            )
            ratio = package[0] / floor[0]
            rows.append((floor[0], package[0], ratio, ratio * floor[1] / package[1]))
        least, ours, ratio, one_step = (median(column) for column in zip(*rows, strict=True))
        print(
            f"{elements:8} {dt:8g} {1e6 * least / steps:8.2f} {1e6 * ours / steps:12.2f} "
            f"{ratio:10.2f} {one_step:12.2f} {abs(floor[2] - package[2]).max():18.1e}"
            f"   {floor[1] / steps:.2f} {package[1] / steps:.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
