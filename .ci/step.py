"""Processor time of one step of the pinned beam, and the solver used: printed as JSON."""

import json
import time

import numpy as np

import fx_beam as fb
from fx_beam_studies.reporting import machine

#: Steps of a short and of a long run; the difference of their times does not contain the set-up.
STEPS = 1000, 5000
RUNS = 7


def main() -> None:
    scene = fb.Scene()
    section = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
    beam = scene.add_beam([(0, 0), (100, 0)], section, elements=8)
    scene.pin(beam.start)
    scene.set_velocity(
        beam, lambda x, y: (0, 12 * min(x, 100 - x)), spin=lambda x, y: 12 * np.sign(50 - x)
    )
    solvers, seconds = set(), {steps: [] for steps in STEPS}
    for steps in RUNS * STEPS:
        start = time.process_time()
        solution = fb.simulate(scene, dt=0.01, t_end=0.01 * steps)
        seconds[steps].append(time.process_time() - start)
        solvers.add(solution.stats.solver)
    short, long = (min(seconds[steps]) for steps in STEPS)
    seconds_a_step = (long - short) / (STEPS[1] - STEPS[0])
    measures = {"solver": ", ".join(solvers), "microseconds": 1e6 * seconds_a_step}
    print(json.dumps(machine() | measures))


if __name__ == "__main__":
    main()
