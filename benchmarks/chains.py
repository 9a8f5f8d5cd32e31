"""Set-up, memory and time per step of chains, trees and loops of rigid bodies.

    .venv/bin/python benchmarks/chains.py

Each row runs in a process of its own. Processor times; the memory is what the run adds, with its
record of all steps.
"""

import resource
import subprocess
import sys
from math import cos, pi, sin
from time import process_time

import fx_beam as fb

LENGTH, DT, STEPS = 0.1, 1e-3, 100
SIZES = (1, 30, 100, 300, 1000)


def add_link(scene, start, end):
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    return scene.add_body(middle, 1.0, 1e-3, points={"start": start, "end": end})


def tree(parents, drop=0.0):
    """Links, each of which hangs on the end of another (from 1 on), or on a pin (0)."""
    scene, places, ends = fb.Scene(gravity=(0, -9.81)), [(0.0, 0.0)], [None]
    for k, parent in enumerate(parents):
        x, y = places[parent]
        places.append((x + LENGTH, y - drop * (k % 2)))
        link = add_link(scene, (x, y), places[-1])
        if parent == 0:
            scene.pin(link["start"])
        else:
            scene.add_joint(fb.Revolute(ends[parent], link["start"]))
        ends.append(link["end"])
    return scene


def chain(n):
    return tree(range(n))


def binary_tree(n):
    return tree([k // 2 for k in range(1, n + 1)], drop=LENGTH)


def comb(n):
    """A chain with a link of its own at every second one."""
    return tree([max(0, k - 1) if k % 2 else k for k in range(n)], drop=LENGTH)


def loop(n):
    """A ring of links, pinned at one of its hinges."""
    n = max(3, n)
    corners = [
        (n * LENGTH / 6 * cos(2 * pi * k / n), n * LENGTH / 6 * sin(2 * pi * k / n))
        for k in range(n)
    ]
    scene = fb.Scene(gravity=(0, -9.81))
    links = [add_link(scene, corners[k - 1], corners[k]) for k in range(n)]
    scene.pin(links[0]["start"])
    for k in range(n):
        scene.add_joint(fb.Revolute(links[k - 1]["end"], links[k]["start"]))
    return scene


def four_bars(n):
    """Mechanisms of three links and the ground, beside each other."""
    scene = fb.Scene(gravity=(0, -9.81))
    for k in range((n + 2) // 3):
        x = 5.0 * k * LENGTH
        right = x + 2 * LENGTH
        corners = [(x, 0), (x + 0.3 * LENGTH, LENGTH), (right, 1.2 * LENGTH), (right, 0)]
        links = [add_link(scene, corners[i], corners[i + 1]) for i in range(3)]
        scene.pin(links[0]["start"])
        for first, other in ((0, 1), (1, 2)):
            scene.add_joint(fb.Revolute(links[first]["end"], links[other]["start"]))
        scene.add_joint(fb.Revolute(links[2]["end"], fb.GROUND))
    return scene


def scissors(n):
    """A lift: cells of two crossing bars above each other, on a pin and a slide."""
    scene, ends = fb.Scene(gravity=(0, -9.81)), None
    for k in range((n + 1) // 2):
        low, high, middle = LENGTH * k, LENGTH * (k + 1), (LENGTH, LENGTH * (k + 0.5))
        places = ((0, low), (2 * LENGTH, high)), ((2 * LENGTH, low), (0, high))
        rising, falling = (
            scene.add_body(middle, 1.0, 1e-3, points={"start": a, "end": b, "middle": middle})
            for a, b in places
        )
        scene.add_joint(fb.Revolute(rising["middle"], falling["middle"]))
        if ends is None:
            scene.pin(rising["start"])
            scene.add_joint(fb.PinInSlot(fb.GROUND, falling["start"], axis=(1, 0)))
        else:
            scene.add_joint(fb.Revolute(ends[1], rising["start"]))
            scene.add_joint(fb.Revolute(ends[0], falling["start"]))
        ends = rising["end"], falling["end"]
    return scene


def ladder(n):
    """Two chains on pins, with rungs between them: loops with two links in common."""
    scene, sides = fb.Scene(gravity=(0, -9.81)), [[], []]
    cells = (n + 2) // 3
    for k in range(cells):
        for side, y in zip(sides, (0.0, LENGTH), strict=True):
            side.append(add_link(scene, (LENGTH * k, y), (LENGTH * (k + 1), y)))
            if k:
                scene.add_joint(fb.Revolute(side[-2]["end"], side[-1]["start"]))
            else:
                scene.pin(side[0]["start"])
    for k in range(cells):
        x = LENGTH * (k + 1)
        rung = add_link(scene, (x, 0.0), (x, LENGTH))
        for side, end in zip(sides, ("start", "end"), strict=True):
            scene.add_joint(fb.Revolute(side[k]["end"], rung[end]))
    return scene


# With the most bodies for which the row is run.
MADE = {
    "chain": (chain, 1000),
    "comb": (comb, 1000),
    "binary tree": (binary_tree, 1000),
    "loop": (loop, 1000),
    "four-bars": (four_bars, 300),
    "scissors": (scissors, 300),
    "ladder": (ladder, 1000),
}


def used():
    """Largest memory so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def timed(scene, steps, every=1):
    """Processor time of a run, and its solver."""
    begun = process_time()
    stats = fb.simulate(scene, dt=DT, t_end=steps * DT, record=fb.Record(every=every)).stats
    return process_time() - begun, stats.solver


def measure(name, n):
    make, _ = MADE[name]
    timed(make(3), 1)  # compiles and imports
    before, start = used(), process_time()
    scene = make(n)
    made = process_time()
    (first, _), memory = timed(scene, 1), used()
    # What follows takes the model of the run before: with few steps, the last row only, all rows.
    (few, _), (last, _), (rows, solver) = (
        timed(scene, *arguments) for arguments in ((1,), (STEPS, STEPS), (STEPS,))
    )
    step, row = (last - few) / (STEPS - 1), (rows - last) / STEPS
    times = f"{made - start:8.3f} {first:8.3f} {1e3 * step:8.3f} {1e3 * row:8.3f}"
    print(f"{name:>12} {n:6} {times} {memory - before:9.0f} {used() - before:9.0f} ", solver)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        measure(sys.argv[1], int(sys.argv[2]))
    else:
        print(
            "              bodies   scene   set-up  ms/step   ms/row MB set-up MB in all   solver"
        )
        for name, (_, most) in MADE.items():
            for n in SIZES:
                if n <= most:
                    subprocess.run([sys.executable, __file__, name, str(n)], check=True)
