"""Scenes a second of a parameter sweep, on processes, in threads and under mpirun.

    .venv/bin/python benchmarks/sweep.py [number of scenes] [parts or threads]

Pinned beams as in the demo, 8 elements, with other stiffnesses and initial speeds: 2 s each with
dt = 0.01 s. They run on one and two processes, and in pools of mpi4py with one and two workers,
which are two and three ranks. Of each sweep: its whole time; the time until the first scene is
done, in which the workers start and load the forms; scenes a second after that; and the processor
time of a scene, median and lowest, on which other programs have less effect. Forms are in the cache
already.

With `parts`, in one process: the processor time of a scene by what it is spent on; and the most
that lanes could gain, eight scenes in a vector that take their steps together. What goes by blocks
of eight elements, their functions above all, fills the vectors already. So an iteration with 1, 8
and 32 elements takes a + e + c, a + e + 8c and a + 4e + 32c: e for a block, c for each element, a
for all else. Of eight scenes in lanes only a + 8c could be divided, by eight at the most, and each
of them waits for the one with most iterations.

With `threads`, sweeps and calls of a response with 8 and with 128 elements, by one thread and by
two in turns: median and lowest time of a scene, and the ratios of both. Python runs in one thread
at a time: so beside them the part of the processor time that the steps in C take.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import monotonic, perf_counter, thread_time

import numpy as np

import fx_beam as fb
from fx_beam.motions import dynamics
from fx_beam.step.stepper import CompiledLoop

LENGTH, SPEED = 100.0, 600.0
T_END, DT, ELEMENTS = 2.0, 0.01, 8
LANES = 8
# Number of times that one and two threads are compared.
TURNS = 9


def built(case, elements=ELEMENTS):
    """The scene of a case, a pinned beam."""
    factor, middle = case["stiffness"], LENGTH / 2
    section = fb.Section(
        EA=4e7 * factor, GA=1e7 * factor, EI=1.3e7 * factor, rhoA=0.05, rhoI=1 / 60
    )
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], section, elements=elements)
    scene.pin(beam.start)
    scene.set_velocity(
        beam,
        lambda x, y: (0.0, case["speed"] * (1 - abs(x / middle - 1))),
        spin=lambda x, y: case["speed"] / middle * np.sign(middle - x),
    )
    return scene


def swing(case):
    """The end of a pinned beam, when it ended and the processor time that it took."""
    clock = thread_time()
    scene = built(case, case.get("elements", ELEMENTS))
    solution = fb.simulate(scene, dt=DT, t_end=T_END)
    return {
        "x": float(solution.position(scene.beams[0].end)[-1, 0]),
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
    """Sweep in a pool of mpi4py."""
    known = {name: value for name, value in os.environ.items() if not name.startswith("OMPI_")}
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = ["mpirun", "-n", str(ranks), "--oversubscribe", sys.executable, "-m"]
    command += ["mpi4py.futures", str(Path(__file__).resolve()), str(number), "mpi"]
    variables = known | root | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=variables, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def timed(kind, name, times):
    """A method or function that adds its processor time to `times`; the original one."""
    method = getattr(kind, name)

    def call(*arguments):
        clock = thread_time()
        result = method(*arguments)
        times[name] += thread_time() - clock
        return result

    setattr(kind, name, call)
    return method


def times_by_part(number, elements):
    """Processor times [s] to build, set numbers, take steps, of all else; and iterations."""
    times = {"prepare": 0.0, "_steps": 0.0}
    methods = [(kind, name, timed(kind, name, times)) for kind, name in TIMED]
    rows = []
    try:
        for case in cases(number):
            times |= dict.fromkeys(times, 0.0)
            clock = thread_time()
            scene = built(case, elements)
            begun = thread_time()
            solution = fb.simulate(scene, dt=DT, t_end=T_END)
            float(solution.position(scene.beams[0].end)[-1, 0])
            whole = thread_time() - begun
            rest = whole - sum(times.values())
            rows.append([begun - clock, *times.values(), rest, solution.stats.newton_iterations])
    finally:
        for kind, name, method in methods:
            setattr(kind, name, method)
    return np.array(rows[1:])


TIMED = (dynamics, "prepare"), (CompiledLoop, "_steps")


def held_iterations(number):
    """Iterations of a step: the mean, and the mean of the most among as many scenes as lanes."""
    counts = []
    for case in cases(number):
        motion, before = fb.Motion(built(case), dt=DT), 0
        for _ in range(round(T_END / DT)):
            motion.step()
            now = motion.stats.newton_iterations
            counts.append(now - before)
            before = now
    step_counts = np.array(counts).reshape(number, -1)
    return step_counts.mean(), step_counts.reshape(-1, LANES, step_counts.shape[1]).max(
        axis=1
    ).mean()


def parts(number):
    """Print what a scene of a sweep costs by part, and what lanes could change."""
    measures = {}
    for elements in (1, ELEMENTS, 4 * ELEMENTS):
        times_by_part(10, elements)  # compiles
        measures[elements] = times_by_part(number, elements)
    rows = measures[ELEMENTS][:, :-1]
    row = "{:36} {:>10} {:>10}".format
    print(f"a scene of {T_END / DT:.0f} steps, processor time [ms], of {number} scenes")
    print(row("", "median", "lowest"))
    names = "build", "set its numbers", "the steps in C", "all else around them"
    for name, times in zip((*names, "all"), (*rows.T, rows.sum(axis=1)), strict=True):
        print(row(name, f"{1e3 * np.median(times):.3f}", f"{1e3 * times.min():.3f}"))
    single, many, most = (1e6 * (times[:, 2] / times[:, -1]).min() for times in measures.values())
    print("an iteration [us]: " + ", ".join(f"{time:.3f}" for time in (single, many, most)))
    other = (many - single) / (ELEMENTS - 1)
    block = (most - many) / 3 - ELEMENTS * other
    mean, held = held_iterations(10 * LANES)
    print(f"a block of elements {block:.3f} with 8; all else {many - block:.3f}")
    print(f"iterations of a step: {mean:.2f}; of the slowest of {LANES} scenes: {held:.2f}")
    lanes = (block + (many - block) / LANES) * held / mean
    steps, whole = rows[:, 2].min(), rows.sum(axis=1).min()
    print(f"at most in lanes: steps {many / lanes:.1f} times as fast, ", end="")
    print(f"a scene {whole / (whole - steps * (1 - lanes / many)):.1f} times, ", end="")
    print(f"with steps that take no time {whole / (whole - steps):.1f} times")


def compared(number, elements):
    """Times [s] of a scene in sweeps and maps of a response, by one and two threads in turns."""
    given = [case | {"elements": elements} for case in cases(number)]
    response = fb.Response(
        lambda x: of_response({"stiffness": x[0], "speed": x[1]}, elements), dt=DT, t_end=T_END
    )
    X = [[case["stiffness"], case["speed"]] for case in given]
    calls = {
        "sweep": lambda threads: fb.sweep(swing, given, threads=threads),
        "map": lambda threads: response.map(X, threads),
    }
    times = {name: {1: [], 2: []} for name in calls}
    for turn in range(TURNS + 1):  # the first one compiles
        for name, call in calls.items():
            for threads in (1, 2):
                clock = perf_counter()
                call(threads)
                if turn:
                    times[name][threads].append((perf_counter() - clock) / number)
    return times


def of_response(case, elements):
    """The scene of a case, and the output of a response."""
    scene = built(case, elements)
    return scene, {"end": fb.Output("position", scene.beams[0].end)}


def threads(number):
    """Print what two threads gain beside one."""
    print(f"{number} scenes of {T_END / DT:.0f} steps, {TURNS} turns")
    row = "{:20} {:>12} {:>12} {:>8} {:>12} {:>12} {:>8}".format
    print(row("", "1: median", "2: median", "ratio", "1: lowest", "2: lowest", "ratio"))
    for elements in (ELEMENTS, 16 * ELEMENTS):
        for name, times in compared(number, elements).items():
            shown = []
            for measure in (median, min):
                one, two = (1e3 * measure(times[count]) for count in (1, 2))
                shown += [f"{one:.3f} ms", f"{two:.3f} ms", f"{one / two:.2f}"]
            print(row(f"{name}, {elements} elements", *shown))
        rows = times_by_part(number, elements)[:, :-1]
        whole = np.median(rows.sum(axis=1))
        print(f"  steps in C: {np.median(rows[:, 2]) / whole:.0%} of the processor time of a scene")
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


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
        measures = run()
        shown = measures["whole"], measures["first"], measures["rate"], 1e3 * measures["call"]
        print(row(name, *(f"{value:.2f}" for value in (*shown, 1e3 * measures["least"]))))


if __name__ == "__main__":
    if sys.argv[2:] == ["mpi"]:
        from mpi4py.futures import MPIPoolExecutor

        with MPIPoolExecutor() as pool:
            print(json.dumps(measured(int(sys.argv[1]), pool)))
    elif sys.argv[2:] == ["parts"]:
        parts(int(sys.argv[1]))
    elif sys.argv[2:] == ["threads"]:
        threads(int(sys.argv[1]))
    else:
        main(*map(int, sys.argv[1:2]))
