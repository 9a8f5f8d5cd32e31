"""Steps by dolfinx and PETSc beside those of the engine; large lattices on several processes.

    .venv/bin/python benchmarks/in_dolfinx.py                     medians of steps [ms], in turn
    mpirun -n 2 .venv/bin/python benchmarks/in_dolfinx.py lattice [cells]    (100: 20 200 struts)

On one process times are those of the processor, with OMP_NUM_THREADS=1, on several of the wall.
"""

import sys
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

from mpi4py import MPI

import numpy as np

import fx_beam as fb
from fx_beam import fenicsx

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))
from frames import lattice  # noqa: E402

import multibody  # noqa: E402
import pinned_beam  # noqa: E402


def cantilever(elements):
    """An arc that is shaken at its end."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e5, GA=4e4, EI=10.0, rhoA=1.0, rhoI=0.01)
    beam = scene.add_beam(fb.arc((0, 0), (0.5, 0.35), (1, 0)), section, elements)
    scene.clamp(beam.start)
    scene.add_force(beam.end, lambda t: (0, 20 * np.sin(20 * t)))
    return scene


SCENES = {
    "pinned beam": (lambda: pinned_beam.scene()[0], 0.01),
    "multi-body system": (lambda: multibody.scene()[0], 0.005),
    "1000 elements": (lambda: cantilever(1000), 0.005),
}


def timed(work, clock=thread_time):
    """Seconds that a call takes, by default of its processor."""
    began = clock()
    work()
    return clock() - began


def compare(rounds=5, steps=20):
    """Medians of steps by both, which take turns."""
    print(f"{'':20} {'dolfinx':>9} {'engine':>9} {'ratio':>7} {'iterations':>11}")
    for name, (scene, dt) in SCENES.items():
        problem, motion = fenicsx.Problem(scene(), dt=dt), fb.Motion(scene(), dt=dt)
        problem.advance(), motion.step()
        times, iterations = [], []
        for _ in range(rounds):
            here, there = [], timed(lambda: motion.run(motion.t + steps * dt))  # noqa: B023
            for _ in range(steps):
                here.append(timed(problem.advance))
                iterations.append(problem.snes.getIterationNumber())
            times.append((median(here), there / steps))
        here, there = (1e3 * median(part) for part in zip(*times, strict=True))
        count = sum(iterations) / len(iterations)
        print(f"{name:20} {here:9.2f} {there:9.4f} {here / there:7.0f} {count:11.1f}", flush=True)


def on_processes(cells, steps=5):
    """Steps of a lattice on all processes of mpirun."""
    comm = MPI.COMM_WORLD
    scene = lattice(cells)
    set_up = perf_counter()
    problem = fenicsx.Problem(scene, dt=0.01, comm=comm)
    problem.advance()
    set_up = perf_counter() - set_up
    times = [timed(problem.advance, perf_counter) for _ in range(steps)]
    if comm.rank == 0:
        print(f"{len(scene.beams)} struts on {comm.size}: {median(times):.3f} s a step", end=", ")
        iterations = problem.snes.getIterationNumber()
        print(f"{iterations} iterations, {set_up:.1f} s to the end of the first step")


if __name__ == "__main__":
    if sys.argv[1:2] == ["lattice"]:
        on_processes(int(sys.argv[2]) if len(sys.argv) > 2 else 100)
    else:
        compare()
