"""A step by `Motion` against the same step in `simulate`.

    .venv/bin/python benchmarks/motion.py [steps] [runs]

An arm of 8 elements on a hinge with a damper. `Motion` gets a moment and a force from outside and
measures a position, an angle, its rate and the hinge's force in each step; `simulate` has the same
loads as constants. Both record nothing, then all. They take turns; medians of the times per step
and of their differences, and of a return to a snapshot with one step.
"""

import sys
from statistics import median
from time import perf_counter

import fx_beam as fb

DT = 1e-3
INPUTS = {"torque": 1.5, "push": (0.0, 2.0)}


def arm():
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e5, GA=1e5, EI=20.0, rhoA=1.0, rhoI=1e-2)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, beam.start, damper=fb.Damper(2.0)))
    scene.add_moment(beam.start, fb.Input("torque"))
    scene.add_force(beam.end, fb.Input("push"))
    outputs = {
        "tip": fb.Output("position", beam.end),
        "angle": fb.Output("angle", hinge),
        "spin": fb.Output("spin", hinge),
        "force": fb.Output("force", hinge),
    }
    return scene, outputs


def simulated(scene, steps, record):
    solution = fb.simulate(scene, dt=DT, t_end=steps * DT, inputs=INPUTS, record=record)
    return solution.stats.seconds / steps


def stepped(motion, start, steps):
    motion.restore(start)
    torque = INPUTS["torque"]
    clock = perf_counter()
    for _ in range(steps):
        motion.step({"torque": torque, "push": INPUTS["push"]})
    return (perf_counter() - clock) / steps


def main(steps=4000, runs=15):
    scene, outputs = arm()
    nothing = fb.Record(every=10**6, motion=False, rates=False, forces=False)
    print(f"{'':34}{'simulate':>10}{'Motion':>10}{'more':>10}   [us a step]")
    for name, by_simulate, by_motion in (
        ("nothing recorded", nothing, None),
        ("every step recorded", fb.Record(), fb.Record()),
    ):
        motion = fb.Motion(scene, dt=DT, outputs=outputs, record=by_motion)
        start, found = motion.snapshot(), []
        for _ in range(runs):
            pair = simulated(scene, steps, by_simulate), stepped(motion, start, steps)
            found.append([1e6 * pair[0], 1e6 * pair[1], 1e6 * (pair[1] - pair[0])])
        print(f"{name:34}" + "".join(f"{median(row):10.1f}" for row in zip(*found, strict=True)))
    motion = fb.Motion(scene, dt=DT, outputs=outputs)
    start, times = motion.snapshot(), []
    for _ in range(1000):
        clock = perf_counter()
        motion.restore(start)
        motion.step(INPUTS)
        times.append(1e6 * (perf_counter() - clock))
    print(f"{'snapshot restored, and a step':34}{'':10}{median(times):10.1f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
