"""Time per step for several sizes and scenes.

    .venv/bin/python benchmarks/steps.py [runs]

The pinned beam with 1 to 2048 elements, the pendulum, and the mechanisms of the demos are run by
EnergyMomentum with everything recorded. The runs alternate; set-up is not included. Also measured:
the time to the end of the first step with and without compilation. Medians, the machine and the
versions are written to results/steps/steps.json, with a picture beside it.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from demo_scenes import ROOT, scene

import fx_beam as fb
from fx_beam.studies import reporting

ELEMENTS = (1, 8, 32, 128, 512, 2048)


def cases():
    """Name, scene, step and number of steps."""
    for elements in ELEMENTS:
        yield f"pinned beam, {elements}", scene("pinned_beam", elements), 0.001, steps_for(elements)
    yield "pinned beam, 8, dt 0.01", scene("pinned_beam", 8), 0.01, 1000
    yield "pendulum, dt 0.1", scene("pendulum"), 0.1, 500
    yield "pendulum, dt 0.01", scene("pendulum"), 0.01, 1000
    yield "three-bar swing", scene("three_bar_swing"), 5e-4, 1000
    yield "multi-body", scene("multibody"), 1e-3, 1000


def measure(scene, dt, steps, runs):
    times = []
    for _ in range(runs):
        stats = fb.simulate(scene, dt=dt, t_end=steps * dt).stats
        seconds = 1e6 * stats.seconds / steps, stats.setup_seconds
        times.append((*seconds, stats.newton_iterations / steps))
    names = "us per step", "set-up seconds", "iterations per step"
    medians = zip(names, map(median, zip(*times, strict=True)), strict=True)
    return dict(medians) | {"solver": stats.solver}


def steps_for(elements):
    return max(50, min(2000, 40000 // elements))


def first_step(runs):
    """Seconds from start to the end of the first step, with empty and with full caches."""
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); from demo_scenes import scene\n"
        "import fx_beam; fx_beam.simulate(scene('pinned_beam', 8), dt=0.01, t_end=0.01)"
    )
    command = [sys.executable, "-c", script, str(Path(__file__).parent)]
    with tempfile.TemporaryDirectory() as cache:
        environment, seconds = os.environ | {"XDG_CACHE_HOME": cache}, []
        for _ in range(runs + 1):
            clock = perf_counter()
            subprocess.run(command, env=environment, check=True)
            seconds.append(perf_counter() - clock)
    return {"compiling": seconds[0], "from caches": median(seconds[1:])}


def main(runs=5):
    numbers = {
        "machine": reporting.machine(),
        "runs": runs,
        "cases": {},
    }
    for name, case_scene, dt, steps in cases():
        case = numbers["cases"][name] = measure(case_scene, dt, steps, runs)
        iterations = case["iterations per step"]
        print(f"{name:26} {case['us per step']:9.2f} us, {iterations:.1f} iterations")
    numbers["first step"] = first_step(runs)
    print("\nfirst step:", *(f"{s:.2f} s {how}," for how, s in numbers["first step"].items()))
    results = ROOT / "results" / "steps"
    reporting.write_json(results / "steps.json", numbers)
    draw(results / "steps.png", numbers["cases"])


def draw(path, found):
    from fx_beam import plot

    figure, ((ax,),) = plot.figure(1, 1, height=3.5)
    times = [found[f"pinned beam, {n}"]["us per step"] for n in ELEMENTS]
    ax.loglog(ELEMENTS, times, "C0o-")
    ax.set(xlabel="elements [-]", ylabel="time of a step [us]", xticks=ELEMENTS)
    ax.set_xticklabels([str(n) for n in ELEMENTS])
    ax.minorticks_off()
    plot.save(figure, path)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
