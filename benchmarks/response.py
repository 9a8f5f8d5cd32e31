"""Time of a call of `Response` beside its steps, and of `simulate` for the same scenes.

    .venv/bin/python benchmarks/response.py [calls]

Pinned beams of 8, 128 and 2048 elements, whose stiffness and initial speed differ from call to
call, and a body on a flexible arm with a motor, a spring and a damper. Of each the lowest processor
time of many calls, which other programs affect least: of `build`, of the steps in C, and of all
else, in which functions of position that `build` gives are evaluated.
"""

import sys
from time import thread_time

import numpy as np

import fx_beam as fb
from fx_beam.step.stepper import CompiledLoop

STEPS = 50


def pinned(elements):
    """A pinned beam, its stiffness and the speed of its middle as numbers."""

    def build(x):
        section = fb.Section(EA=4e7 * x[0], GA=1e7 * x[0], EI=1.3e7 * x[0], rhoA=0.05, rhoI=1 / 60)
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (100, 0)], section, elements=elements)
        scene.pin(beam.start)
        scene.set_velocity(
            beam,
            lambda px, py: (0.0, x[1] * (1 - abs(px / 50 - 1))),
            spin=lambda px, py: x[1] / 50 * np.sign(50 - px),
        )
        return scene, {"end": fb.Output("position", beam.end)}

    return build


def arm(x):
    """A body at the end of a driven flexible arm: stiffness, mass, spring and damper."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e5 * x[0], GA=5e4 * x[0], EI=50.0 * x[0], rhoA=1.0, rhoI=1e-3)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, motor=lambda t: 2 * x[1] * t**2))
    body = scene.add_body((1.2, 0.0), mass=x[1], inertia=0.02, points={"pin": (1, 0)})
    spring, damper = fb.Spring(stiffness=10 * x[0]), fb.Damper(viscosity=0.1 * x[1])
    scene.add_joint(fb.Revolute(beam.end, body["pin"], spring=spring, damper=damper))
    return scene, {"body": fb.Output("position", body.centre)}


def measured(build, dt, calls):
    """Lowest times [ms] of build, of the steps, and of all else by `simulate` and by `Response`."""
    inside = []
    run_steps = CompiledLoop._steps

    def timed(*arguments):
        clock = thread_time()
        taken = run_steps(*arguments)
        inside.append(thread_time() - clock)
        return taken

    def lowest(call):
        rest, steps = [], []
        for x in 1 + 0.1 * np.random.default_rng(0).random((calls, 2)):
            inside.clear()
            clock = thread_time()
            call(x)
            rest.append(thread_time() - clock - sum(inside))
            steps.append(sum(inside))
        return 1e3 * min(rest), 1e3 * min(steps, default=0.0)

    options = {"dt": dt, "t_end": STEPS * dt}
    run = fb.Response(build, **options)

    def simulated(x):
        scene, outputs = build(x)
        solution = fb.simulate(scene, progress=False, **options)
        return [solution.position(output.of) for output in outputs.values()]

    CompiledLoop._steps = timed
    try:
        run(np.ones(2))
        alone, _ = lowest(build)
        (simulate_time, steps), (response_time, _) = lowest(simulated), lowest(run)
    finally:
        CompiledLoop._steps = run_steps
    return alone, steps, simulate_time - alone, response_time - alone


def main(calls=200):
    row = "{:24} {:>10} {:>12} {:>24} {:>24}".format
    print(f"lowest of {calls} calls with {STEPS} steps, processor time [ms]")
    print(row("", "build", "the steps", "around them: simulate", "Response"))
    cases = {f"pinned beam, {n}": (pinned(n), 0.01) for n in (8, 128, 2048)}
    cases["driven arm with a body"] = arm, 0.005
    for name, (build, dt) in cases.items():
        print(row(name, *(f"{value:.2f}" for value in measured(build, dt, calls))))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
