"""Cost of the count of unstable modes along a path of equilibria.

    .venv/bin/python benchmarks/path_stability.py

A shallow arch by load steps, by arc length, and under a force that follows it. Processor times,
each the least of some runs; the share is that of the counts in the time of the rest.
"""

from time import process_time

import numpy as np

import fx_beam as fb
from fx_beam.equilibria.path_equations import SmallMotions

RUNS = {8: 30, 128: 20, 1024: 10}


def arch(elements, follower=False):
    """A pinned sine arch under a force at its top."""
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-4)
    scene = fb.Scene()
    beam = scene.add_beam(lambda f: (f, 0.1 * np.sin(np.pi * f)), section, elements)
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.add_force(beam.node(0.5), (0, -12.0), follower=follower)
    return scene


def seconds(scene, **how):
    """Processor times of a path and of the counts in it, and its number of steps."""
    counting, spent = SmallMotions.note, []

    def timed(self, state, factors):
        start = process_time()
        counting(self, state, factors)
        spent.append(process_time() - start)

    SmallMotions.note = timed
    try:
        start = process_time()
        path = fb.static(scene, 10, progress=False, **how)
        return process_time() - start, sum(spent), path.stats.steps
    finally:
        SmallMotions.note = counting


def main():
    cases = {
        "load steps": ({}, False),
        "arc length": ({"continuation": "arc-length"}, False),
        "force that follows": ({}, True),
    }
    print(f"{'path':20}{'elements':>10}{'steps':>8}{'whole [ms]':>14}{'count':>8}")
    for name, (how, follower) in cases.items():
        for elements, runs in RUNS.items():
            scene = arch(elements, follower)
            seconds(scene, **how)  # compiles
            times = [seconds(scene, **how) for _ in range(runs)]
            whole, counts, steps = (min(part) for part in zip(*times, strict=True))
            share = counts / (whole - counts)
            print(f"{name:20}{elements:10}{steps:8}{1e3 * whole:14.1f}{share:8.1%}", flush=True)


if __name__ == "__main__":
    main()
