"""Scenes a second of a parameter sweep, on processes and under mpirun.

    .venv/bin/python benchmarks/sweep.py [number of scenes]

Pinned beams as in the demo, 8 elements, with other stiffnesses and initial speeds: 2 s each with
dt = 0.01 s. They run on one and two processes, and in pools of mpi4py with one and two workers,
which are two and three ranks. Of each sweep: its whole time; the time until the first scene is
done, in which the workers start and load the forms; scenes a second after that; and the processor
time of a scene, median and lowest, on which other programs have less effect. Forms are in the cache
already.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import monotonic, thread_time

import numpy as np

import fx_beam as fb

LENGTH, SPEED = 100.0, 600.0
T_END, DT, ELEMENTS = 2.0, 0.01, 8


def swing(case):
    """A pinned beam; its end, when it ended and the processor time that it took."""
    clock = thread_time()
    factor, middle = case["stiffness"], LENGTH / 2
    section = fb.Section(
        EA=4e7 * factor, GA=1e7 * factor, EI=1.3e7 * factor, rhoA=0.05, rhoI=1 / 60
    )
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], section, elements=ELEMENTS)
    scene.pin(beam.start)
    scene.set_velocity(
        beam,
        lambda x, y: (0.0, case["speed"] * (1 - abs(x / middle - 1))),
        spin=lambda x, y: case["speed"] / middle * np.sign(middle - x),
    )
    solution = fb.simulate(scene, dt=DT, t_end=T_END)
    return {
        "x": float(solution.position(beam.end)[-1, 0]),
        "call": thread_time() - clock,
        "ended": monotonic(),
    }


def cases(number):
    """Stiffnesses from a half to twice and speeds up to those of the demo, at random."""
    draws = np.random.default_rng(0).random((number, 2)).tolist()
    return [{"stiffness": 2 ** (2 * a - 1), "speed": SPEED * (0.5 + 0.5 * b)} for a, b in draws]


def measured(number, executor):
    """Times of a sweep [s]."""
    began = monotonic()
    table = fb.sweep(swing, cases(number), executor)
    whole = monotonic() - began
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    assert not any(row["error"] for row in rows)
    ended = sorted(row["ended"] for row in rows)
    return {
        "whole": whole,
        "first": ended[0] - began,
        "rate": (number - 1) / (ended[-1] - ended[0]),
        "call": median(row["call"] for row in rows[1:]),
        "least": min(row["call"] for row in rows[1:]),
    }


def under_mpirun(number, ranks):
    """The same in a pool of mpi4py."""
    known = {name: value for name, value in os.environ.items() if not name.startswith("OMPI_")}
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = ["mpirun", "-n", str(ranks), "--oversubscribe", sys.executable, "-m"]
    command += ["mpi4py.futures", str(Path(__file__).resolve()), str(number), "mpi"]
    variables = known | root | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=variables, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main(number=1000):
    measured(4, 1)  # compiles
    print(
        f"{number} scenes of {T_END / DT:.0f} steps; load of the machine: {os.getloadavg()[0]:.1f}"
    )
    row = "{:22} {:>9} {:>16} {:>16} {:>14} {:>12}".format
    names = "whole [s]", "first done [s]", "scenes a second", "a scene [ms]", "lowest [ms]"
    print(row("", *names))
    pools = {
        "1 process": lambda: measured(number, 1),
        "2 processes": lambda: measured(number, 2),
        "mpirun, 1 + 1 ranks": lambda: under_mpirun(number, 2),
        "mpirun, 1 + 2 ranks": lambda: under_mpirun(number, 3),
    }
    for name, run in pools.items():
        found = run()
        shown = found["whole"], found["first"], found["rate"], 1e3 * found["call"]
        print(row(name, *(f"{value:.2f}" for value in (*shown, 1e3 * found["least"]))))


if __name__ == "__main__":
    if sys.argv[2:] == ["mpi"]:
        from mpi4py.futures import MPIPoolExecutor

        with MPIPoolExecutor() as pool:
            print(json.dumps(measured(int(sys.argv[1]), pool)))
    else:
        main(*map(int, sys.argv[1:2]))
