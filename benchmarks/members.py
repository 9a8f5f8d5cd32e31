"""Contact of two members: time of a step against one without contact, by number of nodes.

.venv/bin/python benchmarks/members.py
"""

import time

import numpy as np

import fx_beam as fb

# Steps of a run; each time is the median of the ratios of runs that take turns.
STEPS, RUNS = 200, 3


def scene(elements, way, contact):
    """A rope that falls on another one: "across" its middle, or "along" all of it."""
    made = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=4e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
    below = made.add_beam([(0, 0), (10, 0)], section, elements=elements)
    ends = [(5, 0.15), (7, 9.9)] if way == "across" else [(0, 0.15), (10, 0.15)]
    above = made.add_beam(ends, section, elements=elements)
    for end in (below.start, below.end):
        made.pin(end)
    made.set_velocity(below, lambda x, y: (0.0, 3 * np.sin(0.3 * np.pi * x)))
    made.set_velocity(above, (0.5, -1.0))
    if contact:
        made.add_contact(above, below, stiffness=1e5, radius=0.05)
    return made


def seconds(made):
    """Processor time of a step, without set-up, and the solution."""
    record = fb.Record(every=STEPS)
    fb.simulate(made, dt=1e-3, t_end=1e-3, record=record)
    begin = time.process_time()
    solution = fb.simulate(made, dt=1e-3, t_end=STEPS * 1e-3, record=record)
    return (time.process_time() - begin) / STEPS, solution


def main():
    print("nodes each  way     without [us]  with [us]   ratio  iterations  balance")
    for elements in (100, 200, 500, 1000, 2000):
        for way in ("across", "along"):
            pairs = []
            for _ in range(RUNS):
                pair = []
                for contact in (False, True):
                    made = scene(elements - 1, way, contact)
                    cost, solution = seconds(made)
                    pair.append(cost)
                pairs.append(pair)
            free, touching = np.median(pairs, axis=0)
            ratio = np.median([b / a for a, b in pairs])
            stats, energy = solution.stats, solution.energy
            balance = abs(energy.balance_error).max() / energy.kinetic[0]
            print(
                f"{elements:10} {way:8}{free * 1e6:12.0f}{touching * 1e6:12.0f}{ratio:8.2f}"
                f"{stats.newton_iterations / stats.steps:10.2f}{balance:12.0e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
