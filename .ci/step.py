"""Time of one step of the pinned beam, and who takes it: printed as JSON."""

import json

import numpy as np

import fx_beam as fb
from fx_beam.report import machine

STEPS, RUNS = 2000, 5


def main() -> None:
    scene = fb.Scene()
    section = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
    beam = scene.add_beam([(0, 0), (100, 0)], section, elements=8)
    scene.pin(beam.start)
    scene.set_velocity(
        beam, lambda x, y: (0, 12 * min(x, 100 - x)), spin=lambda x, y: 12 * np.sign(50 - x)
    )
    fb.simulate(scene, dt=0.01, t_end=0.1)
    times = []
    for _ in range(RUNS):
        solution = fb.simulate(scene, dt=0.01, t_end=0.01 * STEPS)
        times.append(solution.stats.seconds / STEPS)
    found = {"solver": solution.stats.solver, "microseconds": 1e6 * min(times)}
    print(json.dumps(machine() | found))


if __name__ == "__main__":
    main()
