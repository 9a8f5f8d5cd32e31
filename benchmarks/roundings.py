"""The paper's examples with other roundings of the time step: which of them change the result.

    .venv/bin/python benchmarks/roundings.py [number of roundings]

Each step dt is multiplied by 1 + k 2e-15, k = 0, 1, ... (20 by default). Where a motion is
sensitive, this makes it another one after a while. What is said of a scheme must hold for each of
them. The schemes run with a limit of 2 halvings of a failing step, and with the default of 12. The
table shows how many runs fail, the smallest and largest number of halvings, and the largest
relative change of the energy after the loads have ended.
"""

import logging
import sys

from demo_scenes import demo, scene

import fx_beam as fb

SCHEMES = fb.EnergyMomentum(), fb.ModifiedMidPoint(), fb.EnergyDecaying()
RECORD = fb.Record(motion=False, rates=False, forces=False)


def run(example, scheme, dt, limit):
    """Whether a step failed, the halvings, and the largest change of the energy."""
    module, free, t_end, _ = demo("damping_scan").EXAMPLES[example]
    options = {"dt": dt, "t_end": t_end, "max_halvings": limit, "record": RECORD}
    try:
        solution = fb.simulate(scene(module.__name__), scheme, **options)
    except fb.StepError as error:
        solution = error.solution
    after = solution.energy.total[solution.t > free - 1e-9]
    drift = abs(after / after[0] - 1).max() if len(after) else 0.0
    return bool(solution.stats.failure), solution.stats.halvings, drift


def main(number=20):
    logging.getLogger("fx_beam").setLevel("ERROR")
    line = "{:18} {:17} {:>7} {:>6} {:>11} {:>9} {:>8}".format
    print(line("example", "scheme", "dt [s]", "limit", "failed", "halvings", "energy"))
    for example, (_, _, _, steps) in demo("damping_scan").EXAMPLES.items():
        for scheme in SCHEMES:
            for dt in steps:
                for limit in (2, 12):
                    runs = [
                        run(example, scheme, dt * (1 + 2e-15 * k), limit) for k in range(number)
                    ]
                    failed, halvings, drift = zip(*runs, strict=True)
                    count = f"{min(halvings)} to {max(halvings)}"
                    share = f"{sum(failed)} of {number}"
                    print(line(example, scheme.name, dt, limit, share, count, f"{max(drift):.1e}"))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
