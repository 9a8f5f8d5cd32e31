"""Cost of joints: time of a Newton iteration with and without revolute joints.

A chain of members with revolute joints is compared with one beam of as many unknowns. Both are
pinned at one end and swing under gravity. The time of the steps is divided by the number of
iterations. The runs alternate; medians are printed.

    .venv/bin/python benchmarks/joint_overhead.py [runs]
"""

import sys
from statistics import median

import fx_beam as fb

SECTION = fb.Section(EA=1e5, GA=5e4, EI=100.0, rhoA=1.0, rhoI=0.01)


def chain(members, elements):
    scene = fb.Scene(gravity=(0, -9.81))
    beams = [
        scene.add_beam([(i, 0), (i + 1, 0)], SECTION, elements=elements) for i in range(members)
    ]
    scene.pin(beams[0].start)
    for left, right in zip(beams[:-1], beams[1:], strict=True):
        scene.add_joint(fb.Revolute(left.end, right.start))
    return scene


def beam(unknowns, length):
    """One beam; 3 unknowns per node, minus two at the pin."""
    scene = fb.Scene(gravity=(0, -9.81))
    whole = scene.add_beam([(0, 0), (length, 0)], SECTION, elements=(unknowns + 2) // 3 - 1)
    scene.pin(whole.start)
    return scene


def run(scene):
    """Microseconds per iteration, and the number of unknowns."""
    stats = fb.simulate(scene, dt=0.002, t_end=0.4).stats
    return 1e6 * stats.seconds / stats.newton_iterations, stats.unknowns


def main(runs=15):
    for members, elements in ((4, 4), (7, 7), (10, 31)):
        jointed = chain(members, elements)
        unknowns = 3 * members * (elements + 1) - 2 * members
        scenes = {"joints": jointed, "none": beam(unknowns, members)}
        times = {name: [] for name in scenes}
        for _ in range(runs):
            for name, scene in scenes.items():
                time, found = run(scene)
                times[name].append(time)
                assert abs(found - unknowns) <= 1
        ratio = median(a / b for a, b in zip(times["joints"], times["none"], strict=True))
        print(
            f"{unknowns:4} unknowns: {median(times['joints']):6.2f} us/iteration "
            f"with {members - 1} revolute joints, {median(times['none']):6.2f} us with none; "
            f"ratio {ratio:.3f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
