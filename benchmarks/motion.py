"""A step by `Motion` against the same step in `simulate`.

    .venv/bin/python benchmarks/motion.py [steps] [runs]

An arm of 8 elements on a hinge with a damper. `Motion` gets a moment and a force from outside and
measures a position, an angle, its rate and the hinge's force in each step; `simulate` has the same
loads as constants. Both record nothing, then all. They take turns; medians of the times per step
and of their differences, and of a return to a snapshot with one step.

Then bodies, whose rates and forces are made to fit the joints: a step with places as outputs, and
with the rate and the force of a joint as well; shortest processor times.
"""

import sys
from statistics import median
from time import perf_counter, process_time

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


def bodies(count, motor=None):
    """A chain of bodies, and outputs of its last joint."""
    scene, before = fb.Scene(gravity=(0.0, -9.81)), None
    for k in range(count):
        body = scene.add_body((k + 0.5, 0), 1.0, 0.1, points={"a": (k, 0), "b": (k + 1, 0)})
        hinge = fb.Revolute(before["b"] if before else fb.GROUND, body["a"], motor=motor)
        joint, before, motor = scene.add_joint(hinge), body, None
    places = {"tip": fb.Output("position", before["b"]), "angle": fb.Output("angle", joint)}
    return scene, places, {"spin": fb.Output("spin", joint), "force": fb.Output("force", joint)}


def simulated(scene, steps, record):
    solution = fb.simulate(scene, dt=DT, t_end=steps * DT, inputs=INPUTS, record=record)
    return solution.stats.seconds / steps


def stepped(motion, start, steps, now=perf_counter):
    motion.restore(start)
    inputs = INPUTS if motion.inputs else {}
    clock = now()
    for _ in range(steps):
        motion.step(dict(inputs))
    return (now() - clock) / steps


def main(steps=4000, runs=15):
    scene, outputs = arm()
    nothing = fb.Record(every=10**6, motion=False, rates=False, forces=False)
    print(f"{'':34}{'simulate':>10}{'Motion':>10}{'more':>10}   [us a step]")
    for name, simulate_time, motion_time in (
        ("nothing recorded", nothing, None),
        ("every step recorded", fb.Record(), fb.Record()),
    ):
        motion = fb.Motion(scene, dt=DT, outputs=outputs, record=motion_time)
        start, step_times = motion.snapshot(), []
        for _ in range(runs):
            pair = simulated(scene, steps, simulate_time), stepped(motion, start, steps)
            step_times.append([1e6 * pair[0], 1e6 * pair[1], 1e6 * (pair[1] - pair[0])])
        print(
            f"{name:34}" + "".join(f"{median(row):10.1f}" for row in zip(*step_times, strict=True))
        )
    motion = fb.Motion(scene, dt=DT, outputs=outputs)
    start, times = motion.snapshot(), []
    for _ in range(1000):
        clock = perf_counter()
        motion.restore(start)
        motion.step(INPUTS)
        times.append(1e6 * (perf_counter() - clock))
    print(f"{'snapshot restored, and a step':34}{'':10}{median(times):10.1f}")
    print(f"{'':34}{'places':>10}{'forces':>10}{'more':>10}   [us a step]")
    for name, count, motor in (
        ("2 bodies", 2, None),
        ("2 bodies, a motor", 2, lambda t: t * t),
        ("30 bodies", 30, None),
        ("1000 bodies", 1000, None),
    ):
        scene, places, forces = bodies(count, motor)
        motions = [fb.Motion(scene, dt=DT, outputs=o) for o in (places, places | forces)]
        starts, step_times = [motion.snapshot() for motion in motions], []
        some = max(1, min(steps, 10000 // count))
        for _ in range(runs):
            pairs = zip(motions, starts, strict=True)
            step_times.append([1e6 * stepped(*pair, some, process_time) for pair in pairs])
        few, all_ = map(min, zip(*step_times, strict=True))
        print(f"{name:34}{few:10.1f}{all_:10.1f}{all_ - few:10.1f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
