"""Run time of order four against order two, for equal errors of the pendulum's path.

    .venv/bin/python benchmarks/order_four.py [runs]

For each error the largest step is sought with which the end of the stiff pendulum (EA = 1e10 N)
stays within it over 2 s, relative to its length. The times of the steps alone are then measured in
turn; their medians and the median of their ratios are written.
"""

import sys
from statistics import median

import numpy as np
from demo_scenes import scene

import fx_beam as fb

T_END = 2.0  # [s]
ERRORS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
SCHEMES = {order: fb.EnergyMomentum(order=order) for order in (2, 4)}
SHOWN = 20  # times per run at which paths are compared


def run(pendulum, scheme, steps, record):
    return fb.simulate(pendulum, scheme, dt=T_END / steps, t_end=T_END, record=record)


def path(pendulum, scheme, steps):
    solution = run(pendulum, scheme, steps, fb.Record(every=steps // SHOWN))
    return solution.q[:, -1, :2]


def main(runs=15):
    pendulum = scene("pendulum")
    size = np.ptp(run(pendulum, SCHEMES[4], SHOWN, fb.Record()).X, axis=0).max()
    fine = path(pendulum, SCHEMES[4], 20_000)
    grid = [SHOWN * n for n in np.unique(np.round(2 ** np.arange(0, 14, 0.25)).astype(int))]
    errors = {order: {} for order in SCHEMES}

    def steps_for(order, error):
        for steps in grid:
            if steps not in errors[order]:
                places = path(pendulum, SCHEMES[order], steps)
                errors[order][steps] = abs(places - fine).max() / size
            if errors[order][steps] <= error:
                return steps
        return None

    print("error     steps: order 2, 4       ms: order 2, 4   ratio   iterations a sub-step: 2, 4")
    for error in ERRORS:
        steps = {order: steps_for(order, error) for order in SCHEMES}
        seconds, solves = {2: [], 4: []}, {}
        for _ in range(runs):
            for order, n in steps.items():
                stats = run(pendulum, SCHEMES[order], n, fb.Record(every=n)).stats
                seconds[order].append(1e3 * stats.seconds)
                solves[order] = stats.newton_iterations / sum(stats.ended_by.values())
        two, four = (median(seconds[order]) for order in SCHEMES)
        ratio = median(b / a for a, b in zip(seconds[2], seconds[4], strict=True))
        print(
            f"{error:5.0e} {steps[2]:12} {steps[4]:7} {two:14.2f} {four:7.2f} {ratio:7.3f}"
            f" {solves[2]:18.2f} {solves[4]:7.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
