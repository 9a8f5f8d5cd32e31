"""Time of the differences of `build`, by which derivatives depend on many numbers.

    .venv/bin/python benchmarks/differences.py [steps]

The tip of an arm of 8 elements is loaded by a force over time, whose values at 20, 200 and 1000
times are the numbers. Its function of time accepts arrays, or single times only. Of each the lowest
processor time of three gradients: of `build` alone in as many calls, of all differences, and of the
rest, the steps backwards.
"""

import sys
from time import thread_time

import numpy as np

import fx_beam as fb


def arm(count, at_once, calls):
    """`build` for so many values of the force; it counts its calls."""
    times = np.linspace(0, 1, count)

    def build(x):
        calls.append(0)
        scene = fb.Scene(gravity=(0, -9.81))
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
        scene.clamp(beam.start)

        def force(t):
            return 0.0, np.interp(t if at_once else float(t), times, x)

        scene.add_force(beam.end, force)
        return scene, {"tip": fb.Output("position", beam.end)}

    return build


def lowest(function, times=3):
    """Lowest processor time of some calls [s]."""
    found = []
    for _ in range(times):
        before = thread_time()
        function()
        found.append(thread_time() - before)
    return min(found)


def measured(count, at_once, steps):
    """Calls of build, their time alone, and times of the differences and of the rest [ms]."""
    calls = []
    build = arm(count, at_once, calls)
    run, x = fb.Response(build, dt=1 / steps, t_end=1.0), np.sin(np.arange(1, count + 1))
    weights = {"tip": np.ones((steps + 1, 2))}

    def gradient():
        run.vjp(weights)

    def first():
        run._known_changes = None
        gradient()

    run(x)
    gradient()
    calls.clear()
    first()
    number = len(calls)
    repeats = 3 if at_once else 1
    alone = lowest(lambda: [build(x) for _ in range(number)])
    both, rest = lowest(first, repeats), lowest(gradient)
    return number, 1e3 * alone, 1e3 * (both - rest), 1e3 * rest


def main(steps=1000):
    row = "{:>8} {:>14} {:>10} {:>12} {:>14} {:>10}".format
    print(f"{steps} steps, processor time [ms]")
    print(row("numbers", "function of", "builds", "these alone", "differences", "the rest"))
    for count in (20, 200, 1000):
        for at_once in (True, False)[: 2 if count < 1000 else 1]:
            values = measured(count, at_once, steps)
            kind = "arrays" if at_once else "single times"
            print(row(count, kind, values[0], *(f"{value:.0f}" for value in values[1:])))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
