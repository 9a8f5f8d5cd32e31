"""Time of a whole call around its steps: `simulate` with one step, `static` and `modes`.

    .venv/bin/python benchmarks/setup.py [runs] [folder of another version ...]

The pinned beam with 8 and 2048 elements, the multi-body system of the demos, a chain of 800
revolute links, and a square lattice of 64 x 64 cells; some whose results are kept, as in a list,
and a `Motion` that is dropped. This version of the package and others take
turns, in processes of their own with warm caches. Medians of the processor time of a call, which
other programs affect less than its time; of the first call in a process the time since the script
started, `import fx_beam` included.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

ROOT = Path(__file__).parents[1]
FIRST = "first call in a process [s]"
# Calls in each process, after one that compiles or loads the forms.
CALLS = {"lattice": 1, "chain": 3}


def chain(fb, links):
    """Links of length 1 in a row, hinged to one another and to the ground."""
    link = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.01)
    scene = fb.Scene(gravity=(0.0, -9.81))
    beams = [scene.add_beam([(k, 0), (k + 1, 0)], link, elements=1) for k in range(links)]
    scene.pin(beams[0].start)
    for first, second in zip(beams[:-1], beams[1:], strict=True):
        scene.add_joint(fb.Revolute(first.end, second.start))
    return scene


def lattice(fb, cells, elements=4):
    """Struts of a square lattice, rigidly joined and clamped at one side."""
    strut = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.01)
    scene, nodes = fb.Scene(gravity=(0.0, -9.81)), {}
    for i in range(cells + 1):
        for j in range(cells + 1):
            for end in ((i + 1, j), (i, j + 1)):
                if max(end) <= cells:
                    points = [nodes.get(place, place) for place in ((i, j), end)]
                    beam = scene.add_beam(points, strut, elements=elements)
                    nodes |= {(i, j): beam.start, end: beam.end}
    for i in range(cells + 1):
        scene.clamp(nodes[i, 0])
    return scene


def measure():
    """Print the seconds of each call."""
    from demo_scenes import scene

    import fx_beam as fb

    kept = []

    def simulate(made):
        return fb.simulate(made, dt=1e-5, t_end=1e-5)

    def static(made):
        return fb.static(made, load_steps=1)

    def keeping(call):
        return lambda made: kept.append(call(made))

    cases = {
        "8 elements": (lambda: scene("pinned_beam", 8), simulate),
        "2048 elements": (lambda: scene("pinned_beam", 2048), simulate),
        "multi-body system": (lambda: scene("multibody"), simulate),
        "chain of 800 links": (lambda: chain(fb, 800), simulate),
        "lattice of 64 x 64 cells": (lambda: lattice(fb, 64), simulate),
        "one cell, static": (lambda: lattice(fb, 1), static),
        "one cell, modes": (lambda: lattice(fb, 1), fb.modes),
        "8 elements, kept": (lambda: scene("pinned_beam", 8), keeping(simulate)),
        "2048 elements, kept": (lambda: scene("pinned_beam", 2048), keeping(simulate)),
        "one cell, static, kept": (lambda: lattice(fb, 1), keeping(static)),
        "8 elements, Motion": (
            lambda: scene("pinned_beam", 8),
            lambda made: fb.Motion(made, dt=1e-5).step() and None,
        ),
    }
    times = {}
    for name, (make, call) in cases.items():
        seconds = []
        for _ in range(1 + CALLS.get(name.split()[0], 10)):
            made, used = make(), process_time()
            call(made)
            seconds.append(process_time() - used)
            if not times:
                times[FIRST] = [perf_counter() - STARTED]
        times[name + " [ms]"] = [1e3 * second for second in seconds[1:]]
    print(json.dumps(times))


def main(runs=5, *others):
    folders = [str(ROOT), *others]
    times = defaultdict(list)
    with tempfile.TemporaryDirectory() as caches:
        for turn in range(runs + 1):
            for number, folder in enumerate(folders):
                cache = str(Path(caches) / str(number))
                variables = os.environ | {"PYTHONPATH": folder, "XDG_CACHE_HOME": cache}
                command = [sys.executable, __file__, "measure"]
                done = subprocess.run(command, env=variables, check=True, capture_output=True)
                if turn:  # the first one fills the cache
                    for name, seconds in json.loads(done.stdout).items():
                        times[folder, name] += seconds
    print(f"{'':36}" + "".join(f"{Path(folder).name:>12}" for folder in folders))
    for name in dict.fromkeys(name for _, name in times):
        print(f"{name:36}" + "".join(f"{median(times[folder, name]):12.2f}" for folder in folders))


if __name__ == "__main__":
    STARTED = perf_counter()
    if sys.argv[1:] == ["measure"]:
        measure()
    else:
        main(*map(int, sys.argv[1:2]), *sys.argv[2:])
