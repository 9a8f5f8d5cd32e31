"""Set-up time, from the description of a scene to the first step.

    .venv/bin/python benchmarks/setup.py [runs]

The pinned beam with 8 and 2048 elements, the multi-body system of the demos, and chains of revolute
links. For each: the time to describe the scene, the set-up time of `simulate` from
`Stats.setup_seconds`, and the processor time of both, which other programs affect less. Each is
the smallest of several runs, which take turns, after a first run that compiles the forms.
"""

import sys
from functools import partial
from time import perf_counter, process_time

from demo_scenes import scene

import fx_beam as fb

LINK = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.01)


def chain(links):
    """Links of length 1 in a row, hinged to one another and to the ground."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    beams = [scene.add_beam([(k, 0), (k + 1, 0)], LINK) for k in range(links)]
    scene.pin(beams[0].start)
    for first, second in zip(beams[:-1], beams[1:], strict=True):
        scene.add_joint(fb.Revolute(first.end, second.start))
    return scene


CASES = {
    **{f"pinned beam, {n} elements": partial(scene, "pinned_beam", n) for n in (8, 2048)},
    "multi-body": partial(scene, "multibody"),
    **{f"chain of {n} links": partial(chain, n) for n in (50, 100, 200, 400, 800)},
}


def measure(make):
    """Seconds for the scene and for the set-up, and processor time of both with one step."""
    started, used = perf_counter(), process_time()
    case = make()
    described = perf_counter() - started
    solution = fb.simulate(case, dt=1e-5, t_end=1e-5)
    return described, solution.stats.setup_seconds, process_time() - used


def main(runs=5):
    found = {name: [] for name in CASES}
    for _ in range(runs + 1):
        for name, make in CASES.items():
            found[name].append(measure(make))
    print(f"{'':28}{'scene':>10}{'set-up':>10}{'processor':>11}  [s]")
    for name, rows in found.items():
        scene_of, setup, used = (min(times) for times in zip(*rows[1:], strict=True))
        print(f"{name:28}{scene_of:10.3f}{setup:10.3f}{used:11.3f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
