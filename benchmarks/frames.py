"""Large frames: set-up, steps, statics, modes and pictures of square lattices of struts.

    .venv/bin/python benchmarks/frames.py [cells ...]   (200: 80 400 struts, 2 minutes)
    .venv/bin/python benchmarks/frames.py turning       steps with kept factors and with new ones
    .venv/bin/python benchmarks/frames.py storage       steps with a band and with sparse rows
    .venv/bin/python benchmarks/frames.py threads       steps by one, two and four threads
    .venv/bin/python benchmarks/frames.py large [cells [steps]]   (707: 1 001 112 struts)

Each strut is one element; the struts are rigidly joined. The lattice is clamped at one side and
loaded at the other, or free and turning. Times are those of the processor in seconds, of a step the
mean of the first twenty; the memory is the largest of the process so far.
"""

import os
import resource
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

import fx_beam as fb
from fx_beam.step import stepper, tangent_storage
from fx_beam.step.program import PROGRAMS
from fx_beam.step.sparse_lu import COSTS

SECTION = fb.Section(EA=1e6, GA=1e6, EI=1e2, rhoA=1.0, rhoI=1e-2)


def struts(cells, high=None, degree=1, elements=1, section=lambda column: SECTION):
    """A free lattice of `cells` by as many or `high` ones, and its nodes by their places."""
    columns, rows = cells + 1, (high or cells) + 1
    number = np.arange(columns * rows).reshape(columns, rows)
    points = np.argwhere(number >= 0)
    pairs = (number[:-1], number[1:]), (number[:, :-1], number[:, 1:])
    ends = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in pairs])
    sections = {column: section(column) for column in range(columns)}
    scene, tags = fb.Scene(), points[ends[:, 0], 0]
    beams = scene.add_mesh(points, ends, sections, elements, degree, tags=tags)
    return scene, np.reshape(beams.nodes, number.shape)


def lattice(cells, high=None, **kind):
    """The lattice with supports and loads."""
    scene, nodes = struts(cells, high, **kind)
    for j in range((high or cells) + 1):
        scene.clamp(nodes[0, j])
        scene.add_force(nodes[cells, j], (0.0, 20.0))
    return scene


def turning(cells, spin):
    """The free lattice, which turns about its middle."""
    scene, _ = struts(cells)
    middle = cells / 2
    for beam in scene.beams:
        scene.set_velocity(beam, lambda x, y: (spin * (middle - y), spin * (x - middle)), spin)
    return scene


def timed(march, seconds):
    """A function that takes steps, and adds its time to a list."""

    def marched(*arguments):
        clock = process_time()
        state = march(*arguments)
        seconds.append(process_time() - clock)
        return state

    return marched


def draw(scene, motion):
    """Draw the scene and its last shape, plain and coloured; print the times."""
    pictures = {
        "scene": lambda path: fb.plot.scene(scene, path),
        "shape": lambda path: fb.plot.shapes(motion, path, rows=[1]),
        "in colour": lambda path: fb.plot.shapes(motion, path, rows=[1], colour="strain energy"),
    }
    with tempfile.TemporaryDirectory() as folder:
        fb.plot.scene(lattice(1), Path(folder) / "first.png")  # imports
        for name, picture in pictures.items():
            clock = process_time()
            picture(Path(folder) / "picture.png")
            print(f"  picture, {name} {process_time() - clock:.1f}", flush=True)


def measure(sizes):
    marching: list[float] = []
    stepper.Stepper.advance = timed(stepper.Stepper.advance, marching)
    for cells in sizes:
        clock = process_time()
        scene = lattice(cells)
        made = process_time() - clock
        clock = process_time()
        marching.clear()
        motion = fb.simulate(scene, dt=0.01, t_end=0.2, record=fb.Record(every=20))
        stats, whole, steps = motion.stats, process_time() - clock, sum(marching)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        error = abs(motion.energy.balance_error).max() / motion.energy.kinetic.max()
        print(f"{len(scene.beams)} struts, {stats.unknowns} unknowns: {stats.solver}")
        print(f"  scene {made:.2f}, set-up {whole - steps:.1f}, {memory:.1f} GB")
        iterations = stats.newton_iterations / stats.steps
        print(f"  a step {steps / stats.steps:.3f} ({iterations:.1f} iterations)")
        print(f"  relative error of the energy balance {error:.1e}")
        draw(scene, motion)
        clock = process_time()
        state = fb.static(scene, load_steps=10)
        print(f"  ten load steps {process_time() - clock:.1f}")
        clock = process_time()
        fb.modes(scene, state, n=10)
        print(f"  ten modes {process_time() - clock:.1f}", flush=True)


def choose(costs):
    """Take these costs in the set-ups that follow, of which no earlier one serves again."""
    tangent_storage.COSTS, PROGRAMS.size = costs, 0


def compare_turning(cells=60, dt=0.01, steps=15):
    """Steps of a free lattice with kept factors, and with new ones in each iteration."""
    for turn in (0.001, 0.05, 0.2):
        times = []
        for least in (COSTS.least_worth, sys.maxsize):
            choose(COSTS._replace(least_worth=least))
            scene = turning(cells, turn / dt)
            record = fb.Record(every=steps)
            stats = fb.simulate(scene, dt=dt, t_end=steps * dt, record=record).stats
            times.append(f"{1e3 * stats.seconds / stats.steps:.1f}")
        print(f"{turn:g} rad a step: {times[0]} ms kept, {times[1]} ms new", flush=True)
    choose(COSTS)


def middle_frames():
    """Frames of some hundred to 9500 unknowns by their names."""
    squares = [(n, n) for n in (4, 5, 6, 8, 10, 12, 16, 20, 28, 36, 40)]
    long = [(20, 3), (20, 4), (60, 6), (40, 8), (60, 10), (100, 10), (50, 20), (40, 25), (150, 20)]
    scenes = {f"{a} x {b} cells": lattice(a, b) for a, b in [*squares, *long]}
    for kind in ({"degree": 2}, {"degree": 3}, {"elements": 4}):
        scenes |= {f"{n} x {n} cells, {kind}": lattice(n, **kind) for n in (3, 8)}
    for turn in (0.001, 0.05, 0.2):
        scenes |= {f"{n} x {n} cells, {turn} rad a step": turning(n, turn / 0.01) for n in (6, 12)}
    return scenes


def compare_storage(runs=5, steps=20, dt=0.01):
    """Steps of frames with a band and with sparse rows, in turns, and which of them is chosen."""
    worst, seconds, record = 0.0, [], fb.Record(every=steps)
    sparse = COSTS._replace(narrow=0)
    forced = {"band": COSTS._replace(narrow=sys.maxsize), "sparse": sparse}
    stepper.Stepper.advance = timed(stepper.Stepper.advance, seconds)
    for name, scene in middle_frames().items():
        choose(COSTS)
        stats = fb.simulate(scene, dt=dt, t_end=dt).stats
        chosen = "sparse" if "sparse" in stats.solver else "band"
        step_times = {storage: [] for storage in forced}
        for storage in [*forced] * runs:
            choose(forced[storage])
            seconds.clear()
            fb.simulate(scene, dt=dt, t_end=steps * dt, record=record)
            step_times[storage].append(1e3 * sum(seconds) / steps)
        times = {storage: median(each) for storage, each in step_times.items()}
        ratio = times[chosen] / min(times.values())
        worst = max(worst, ratio)
        said = ", ".join(f"{storage} {time:.3f} ms" for storage, time in times.items())
        print(f"{name}, {stats.unknowns} unknowns: {said}; {chosen}: {ratio:.2f} of the better")
    print(f"worst choice: {worst:.2f} of the better")


def compare_threads(sizes=(100, 200), runs=3, steps=30, dt=0.01):
    """Real time of a step, and of a load step, by the number of threads, in turns."""
    record = fb.Record(every=steps)
    for cells in sizes:
        seconds_by_threads = {}
        for threads in ("1", "2", "4") * runs:
            os.environ["FX_BEAM_THREADS"] = threads
            scene = lattice(cells)
            moving = fb.simulate(scene, dt=dt, t_end=steps * dt, record=record).stats
            resting = fb.static(scene, load_steps=3).stats
            each = seconds_by_threads.setdefault(threads, ([], []))
            for times, stats in zip(each, (moving, resting), strict=True):
                times.append(1e3 * stats.seconds / stats.steps)
        for threads, (moving, resting) in seconds_by_threads.items():
            times = f"a step {min(moving):.0f} ms, a load step {min(resting):.0f} ms"
            print(f"{len(scene.beams)} struts, {threads} threads: {times}", flush=True)


def measure_large(cells=200, steps=10, dt=0.01):
    """Real times of a large lattice: its scene, what comes before the steps, and a step."""
    clock = perf_counter()
    scene, record = lattice(cells), fb.Record(every=steps)
    print(f"{len(scene.beams)} struts, scene {perf_counter() - clock:.1f}", flush=True)
    motion = fb.simulate(scene, dt=dt, t_end=steps * dt, record=record, progress=True)
    stats = motion.stats
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    error = abs(motion.energy.balance_error).max() / motion.energy.kinetic.max()
    print(f"{stats.unknowns} unknowns: {stats.solver}")
    print(f"  set-up {stats.setup_seconds:.1f}, a step {stats.seconds / steps:.3f}")
    print(f"  {stats.newton_iterations} Newton iterations, {memory:.1f} GB")
    print(f"  relative error of the energy balance {error:.1e}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["large"]:
        measure_large(*map(int, sys.argv[2:4]))
    elif sys.argv[1:] == ["turning"]:
        compare_turning()
    elif sys.argv[1:] == ["threads"]:
        compare_threads()
    elif sys.argv[1:] == ["storage"]:
        compare_storage()
    else:
        measure([int(cells) for cells in sys.argv[1:]] or [60, 120, 200])
