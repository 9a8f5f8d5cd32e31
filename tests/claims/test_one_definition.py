"""Solutions, motions, conditions, linear systems and derivatives have the same quantities."""

import numpy as np
import pytest

import fx_beam as fb

STEPS, DT = 20, 0.01


def scene_and_outputs():
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=3, degree=2)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start))
    cart = scene.add_body((2.0, 0.0), mass=1.0, inertia=0.1).centre
    rail = scene.add_joint(fb.Prismatic(arm.end, cart, axis=(1, 0.2), offset=(0.5, -0.1)))
    line = scene.add_force_between(arm.end, (1.0, 1.0), spring=fb.Spring(50.0, rest=0.8))
    drum = fb.Pulley(cart, radius=0.2, side="right")
    rope = scene.add_rope([(0.5, 1.5), fb.Pulley((1.5, 2.0), 0.3, "right"), drum], fb.Spring(20.0))
    held = scene.add_spring(cart, x=fb.Spring(10.0), axis=(1, 1)).x
    names = {
        arm.end: "position displacement rotation velocity spin acceleration reaction",
        arm.at(0.4): "position displacement rotation velocity spin N Q M",
        hinge: "angle spin rate force",
        rail: "angle slide rate spin force",
        line: "length rate force energy",
        rope: "length rate force energy",
        held: "length rate force energy",
    }
    outputs = {
        f"{name} of {place}": fb.Output(name, place)
        for place, text in names.items()
        for name in text.split()
    }
    return scene, outputs


@pytest.fixture(scope="module")
def both():
    scene, outputs = scene_and_outputs()
    motion = fb.Motion(scene, dt=DT, outputs=outputs, record=fb.Record())
    rows = [motion.outputs] + [motion.step() for _ in range(STEPS)]
    return motion.solution(), outputs, rows


@pytest.mark.parametrize("name", scene_and_outputs()[1])
def test_solutions_have_what_motions_give_step_by_step(both, name):
    solution, outputs, rows = both
    steps = np.array([row[name] for row in rows])
    first = int(name.startswith(("acceleration", "N of", "Q of", "M of")))  # of the start
    values = solution.value(outputs[name])
    assert values.shape == steps.shape
    assert abs(values - steps)[first:].max() <= 1e-9 * max(1.0, abs(steps).max())


def test_a_motion_ends_where_a_section_force_has_a_value():
    scene, _ = scene_and_outputs()
    beam = scene.beams[0]
    outputs = {"M": fb.Output("M", beam.at(0.4))}
    free = fb.simulate(scene, dt=DT, t_end=0.2).value(outputs["M"])
    goal = (free[10] + free[11]) / 2

    def reached(t, y):
        return y["M"] - goal if t > 9.5 * DT else 1.0 if free[9] > goal else -1.0

    ended = fb.simulate(scene, dt=DT, t_end=0.2, outputs=outputs, until=reached)
    assert 10 * DT < ended.t[-1] < 11 * DT + 1e-12
    assert ended.value(outputs["M"])[-1] == pytest.approx(goal, abs=1e-9 * abs(free).max())


def test_the_length_of_a_spring_to_the_ground_depends_on_its_direction():
    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        ball = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
        axis = np.cos(x[0]), np.sin(x[0])
        held = scene.add_spring(ball, x=fb.Spring(100.0), y=fb.Spring(30.0), axis=axis)
        return scene, {name: fb.Output(name, held.x) for name in ("length", "rate")}

    run, step = fb.Response(build, dt=DT, t_end=0.3), 1e-6
    low, high = (run([0.4 + sign * step])[1] for sign in (-1, 1))
    run([0.4])
    for name, slopes in run.jacobian().items():
        differences = (high[name] - low[name]) / (2 * step)
        assert slopes[:, 0] == pytest.approx(differences, rel=1e-6, abs=1e-7)
