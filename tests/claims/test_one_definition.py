"""Solutions, motions, conditions, linear systems and derivatives have the same quantities."""

import numpy as np
import pytest
from derivatives import EXACT, assert_derivatives

import fx_beam as fb

STEPS, DT = 20, 0.01
SECTION, SPRING = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01), fb.Spring(20.0)


def scene_and_outputs():
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=3, degree=2)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start))
    cart = scene.add_body((2.0, 0.0), mass=1.0, inertia=0.1).centre
    rail = scene.add_joint(fb.Prismatic(arm.end, cart, axis=(1, 0.2), offset=(0.5, -0.1)))
    line = scene.add_force_between(arm.end, (1.0, 1.0), spring=fb.Spring(50.0, rest=0.8))
    drum = fb.Pulley(cart, radius=0.2, side="right")
    rope = scene.add_rope([(0.5, 1.5), fb.Pulley((1.5, 2.0), 0.3, "right"), drum], SPRING)
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
    # The means of rows 10 and 11 are those at the middle of their steps.
    assert ended.t[-1] == pytest.approx(10 * DT, abs=0.1 * DT)
    before, last = ended.value(outputs["M"])[-2:]
    part = np.diff(ended.t)[-1] / (ended.t[-1] - ended.t[-3])
    assert last + part * (last - before) == pytest.approx(goal, abs=1e-9 * abs(free).max())


def lines_of(x):
    """Lengths and rates of a spring to the ground, a line and a rope over circles, by geometry."""
    way, end, fixed, centre, radius, drum_radius = x
    scene = fb.Scene(gravity=(0, -9.81))
    ball = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    scene.set_velocity(ball, (0.5, 0.2), spin=3.0)
    axis = np.cos(way), np.sin(way)
    held = scene.add_spring(ball, x=fb.Spring(100.0), y=fb.Spring(30.0), axis=axis)
    line = scene.add_force_between(ball, (end, 1.0), spring=fb.Spring(50.0, rest=0.8))
    drum = fb.Pulley(ball, radius=drum_radius, side="right")
    rope = scene.add_rope([(fixed, 1.5), fb.Pulley((centre, 2.0), radius, "right"), drum], SPRING)
    return scene, {
        f"{name} of force {part.number}": fb.Output(name, part)
        for part in (held.x, held.y, line, rope)
        for name in ("length", "rate", "force", "energy")
    }


def joints_of(x):
    """What slides along an axis, and places on a beam, by geometry."""
    way, offset, place, tip = x
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_beam([(0, 0), (tip, 0)], SECTION, elements=2, degree=2)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start))
    cart = scene.add_body((tip + 1.0, np.tan(way) * (1.0 - offset)), mass=1.0, inertia=0.1).centre
    axis = np.cos(way), np.sin(way)
    rail = scene.add_joint(fb.Prismatic(arm.end, cart, axis=axis, offset=(offset, 0.0)))
    outputs = {name: fb.Output(name, arm.at(place)) for name in ("position", "velocity", "M")}
    outputs |= {name: fb.Output(name, hinge) for name in ("angle", "spin")}
    return scene, outputs | {name: fb.Output(name, rail) for name in ("slide", "rate")}


GEOMETRY = {lines_of: (0.4, 1.2, 0.5, 1.5, 0.3, 0.2), joints_of: (0.2, 0.5, 0.37, 1.0)}


@pytest.mark.parametrize("build", GEOMETRY)
def test_outputs_have_derivatives_by_all_numbers_of_their_geometry(build):
    run = fb.Response(build, dt=DT, t_end=0.1, newton=EXACT)
    assert_derivatives(run, GEOMETRY[build])


def lengths_of(x):
    """Of lines, without forces, whose values at the start take differences."""
    scene, outputs = lines_of(x)
    return scene, {name: each for name, each in outputs.items() if each.quantity != "force"}


def places_of(x):
    """A place in an element whose length follows a number."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (x[0], 0.1)], SECTION, elements=3)
    scene.pin(beam.start)
    return scene, {name: fb.Output(name, beam.at(x[1])) for name in ("position", "velocity")}


SMOOTH = {lengths_of: GEOMETRY[lines_of], places_of: (1.0, 0.4)}


@pytest.mark.parametrize("build", SMOOTH)
def test_geometry_of_outputs_has_slopes_without_differences(build):
    run = fb.Response(build, dt=DT, t_end=0.1)
    run(SMOOTH[build])
    run.jacobian()
    assert not run.stats.difference_reason


def test_outputs_say_their_units_and_names():
    scene, outputs = scene_and_outputs()
    arm, (hinge, rail) = scene.beams[0], scene.joints
    turning = scene.add_spring(arm.end, rotation=fb.Spring(1.0)).rotation
    shafts = [
        scene.add_joint(fb.Revolute(fb.GROUND, scene.add_body((x, 5), 1.0, 1.0).centre))
        for x in (0, 1)
    ]
    gear = scene.add_joint(fb.Gear(*shafts, ratio=2.0))
    expected = {
        "m": [("position", arm.end), ("slide", rail), ("length", scene.forces_between[0])],
        "rad": [("rotation", arm.at(0.4)), ("angle", hinge), ("length", turning)],
        "m/s": [("velocity", arm.end, "x"), ("rate", rail), ("rate", scene.forces_between[0])],
        "rad/s": [("spin", arm.end), ("rate", hinge), ("rate", turning)],
        "m/s^2": [("acceleration", arm.end)],
        "N": [("reaction", arm.end, "y"), ("N", arm), ("Q", arm.at(0.4)), ("motor_force", rail)],
        "N m": [("force", hinge, "moment"), ("M", arm), ("motor_force", hinge), ("force", gear)],
        "N, N m": [("reaction", arm.end), ("force", rail)],
        "J": [("energy", turning), ("kinetic_energy", scene), ("work", scene)],
        "1": [("critical_load", scene)],
        "s": [("period", scene)],
    }
    for unit, cases in expected.items():
        assert [fb.Output(*case).unit for case in cases] == [unit] * len(cases)
    assert fb.Output("reaction", arm.end, "y").label == f"reaction y of {arm.end} [N]"
    assert fb.Output("strain_energy", scene).label == "strain energy of the scene [J]"


def test_a_solution_gives_the_rows_of_any_output(both):
    solution, outputs, _ = both
    scene = solution.beams["beam 1"].nodes[0].scene
    energy = solution.value(fb.Output("total_energy", scene))
    assert energy.tolist() == solution.energy.total.tolist()
    N = solution.value(fb.Output("N", scene.beams[0]))
    assert N.tolist() == solution.resultants(scene.beams[0]).N.tolist()
    (rail,) = (joint for joint in scene.joints if joint.slide is not None)
    moment = solution.value(fb.Output("force", rail, "moment"))
    assert moment.tolist() == solution.joint(rail).force[:, 2].tolist()


def test_what_has_no_rows_in_a_solution_is_refused(both):
    solution, _, _ = both
    scene = solution.beams["beam 1"].nodes[0].scene
    other, _ = scene_and_outputs()
    far = fb.Scene().add_body((7, 7), mass=1.0, inertia=1.0).centre
    beam = fb.Scene().add_beam([(0, 3), (1, 3)], SECTION)
    bed = other.add_bed(other.beams[0], normal=1.0).normal
    for output, text in (
        (fb.Output("critical_load", scene), "that of a StaticResponse"),
        (fb.Output("position", far), "is not a node of this solution"),
        (fb.Output("total_energy", far.scene), "is not a node of this solution"),
        (fb.Output("spin", beam.at(0.3)), "is not a beam of this solution"),
        (fb.Output("force", bed), "is not in this solution"),
        (fb.Output("slide", scene.joints[0]), "has no slide"),
    ):
        with pytest.raises((fb.SceneError, ValueError), match=text):
            solution.value(output)
    with pytest.raises(fb.SceneError, match="one of .'force', 'energy'. for force"):
        fb.Output("length", bed)
