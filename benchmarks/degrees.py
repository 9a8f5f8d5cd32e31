"""Time per step of elements of degree 1 to 3, by EnergyMomentum and by the published scheme.

    .venv/bin/python benchmarks/degrees.py [runs] [folder of another version ...]

The pinned beam, straight and as an arc, with 12 and 48 nodes besides the first. The schemes take
turns, and so do this version of the package and others, in processes of their own.
Medians of the time per step, Newton iterations per step, halved steps, and the seconds from an
empty cache to the end of the first step.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from statistics import median
from time import perf_counter

ROOT = Path(__file__).parents[1]
SCHEMES = "ModifiedMidPoint", "EnergyMomentum"
CASES = [(degree, nodes, curved) for nodes in (12, 48) for degree in (1, 2, 3) for curved in (0, 1)]
DT, STEPS = 0.01, 500


def scene(fb, degree, nodes, curved):
    section = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
    axis = fb.arc((0, 0), (50, 10), (100, 0)) if curved else [(0, 0), (100, 0)]
    made = fb.Scene()
    beam = made.add_beam(axis, section, elements=nodes // degree, degree=degree)
    made.pin(beam.start)
    made.set_velocity(beam, lambda x, y: (0, 12 * min(x, 100 - x)))
    return made


def measure():
    """Print time per step [us], iterations, halvings and first seconds of each case and scheme."""
    import fx_beam as fb

    measures = {}
    for case in CASES:
        made = scene(fb, *case)
        for name in SCHEMES:
            scheme, clock = getattr(fb, name)(), perf_counter()
            fb.simulate(made, scheme, dt=DT, t_end=DT)
            first = perf_counter() - clock
            loop = fb.simulate(made, scheme, dt=DT, t_end=STEPS * DT).stats
            time, iterations = 1e6 * loop.seconds / loop.steps, loop.newton_iterations / loop.steps
            measures[f"{case} {name}"] = [time, iterations, loop.halvings, first]
    print(json.dumps(measures))


def main(runs=5, *others):
    folders = [str(ROOT), *others]
    measures = defaultdict(list)
    with tempfile.TemporaryDirectory() as caches:
        for _ in range(runs):
            for number, folder in enumerate(folders):
                cache = str(Path(caches) / str(number))
                variables = os.environ | {"PYTHONPATH": folder, "XDG_CACHE_HOME": cache}
                command = [sys.executable, __file__, "measure"]
                done = subprocess.run(command, env=variables, check=True, capture_output=True)
                for name, numbers in json.loads(done.stdout).items():
                    measures[folder, name].append(numbers)
    for folder in folders:
        print(f"\n{folder}\n{'':36}{'step':>8} [us]  iterations  halvings  compiled [s]")
        for case in CASES:
            degree, nodes, curved = case
            for name in SCHEMES:
                rows = list(zip(*measures[folder, f"{case} {name}"], strict=True))
                time, iterations, halvings, _ = (median(row) for row in rows)
                what = f"{nodes} {'arc' if curved else 'line'}, degree {degree}, {name}"
                print(f"{what:36}{time:8.1f}{iterations:17.2f}{halvings:10}", end="")
                print(f"{rows[-1][0]:14.2f}")


if __name__ == "__main__":
    if sys.argv[1:] == ["measure"]:
        measure()
    else:
        main(*map(int, sys.argv[1:2]), *sys.argv[2:])
