"""Time of a step: the compiled loop against Python with PETSc, over sizes and scenes.

    .venv/bin/python benchmarks/steps.py [runs]

The pinned beam with 1 to 2048 elements, the pendulum, and the mechanisms of the demos, by
EnergyMomentum with everything recorded. Runs alternate; set-up is apart. Medians, with the machine
and the versions, go to results/steps/steps.json, and a picture beside it.
"""

import sys
from statistics import median

from demo_scenes import ROOT, scene

import fx_beam as fb
from fx_beam import report

ELEMENTS = (1, 8, 32, 128, 512, 2048)


def cases():
    """Name, scene, step and number of steps by each solver."""
    for elements in ELEMENTS:
        steps = max(50, min(2000, 40000 // elements))
        yield f"pinned beam, {elements}", scene("pinned_beam", elements), 0.001, steps
    yield "pinned beam, 8, dt 0.01", scene("pinned_beam", 8), 0.01, 1000
    yield "pendulum, dt 0.1", scene("pendulum"), 0.1, 500
    yield "pendulum, dt 0.01", scene("pendulum"), 0.01, 1000
    yield "three-bar swing", scene("three_bar_swing"), 5e-4, 1000
    yield "multi-body", scene("multibody"), 1e-3, 1000


def measure(scene, dt, steps, runs):
    found = {"compiled": [], "petsc": []}
    for _ in range(runs):
        for solver, times in found.items():
            # Python takes a tenth of the steps, enough for its average.
            n = steps if solver == "compiled" else max(steps // 10, 20)
            stats = fb.simulate(scene, dt=dt, t_end=n * dt, solver=solver).stats
            times.append((1e6 * stats.seconds / n, stats.newton_iterations / n, stats.solver))
    return {
        solver: {
            "us per step": median(time for time, _, _ in runs),
            "iterations per step": median(count for _, count, _ in runs),
            "solver": runs[0][2],
        }
        for solver, runs in found.items()
    }


def main(runs=5):
    numbers = {
        "machine": report.machine(),
        "runs": runs,
        "cases": {},
    }
    print(f"{'':26} {'compiled':>12} {'PETSc':>12} {'ratio':>7}  iterations")
    for name, case_scene, dt, steps in cases():
        case = numbers["cases"][name] = measure(case_scene, dt, steps, runs)
        loop, python = (case[solver]["us per step"] for solver in ("compiled", "petsc"))
        case["ratio"] = python / loop
        print(
            f"{name:26} {loop:9.2f} us {python:9.1f} us {python / loop:7.1f}  "
            f"{case['compiled']['iterations per step']:.1f}"
        )
    results = ROOT / "results" / "steps"
    report.write_json(results / "steps.json", numbers)
    draw(results / "steps.png", numbers["cases"])


def draw(path, found):
    from fx_beam import plot

    figure, ((ax,),) = plot.figure(1, 1, height=3.5)
    for solver, line, label in (
        ("compiled", "C0o-", "compiled loop"),
        ("petsc", "C1s--", "Python and PETSc"),
    ):
        times = [found[f"pinned beam, {n}"][solver]["us per step"] for n in ELEMENTS]
        ax.loglog(ELEMENTS, times, line, label=label)
    ax.set(xlabel="elements [-]", ylabel="time of a step [us]", xticks=ELEMENTS)
    ax.set_xticklabels([str(n) for n in ELEMENTS])
    ax.minorticks_off()
    plot.save(figure, path)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
