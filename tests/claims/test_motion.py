"""A motion step by step: inputs, outputs, snapshots, feedback, energy, errors."""

import copy
import pickle

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, hinged_body, one_bar, pinned_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e5, GA=1e5, EI=20.0, rhoA=1.0, rhoI=1e-2)
DT = 2e-3


def arm(motor=None, gravity=(0.0, -9.81)):
    """An arm on a hinge or a motor, with a moment and a force from outside; its outputs."""
    scene, beam = one_bar((1, 0), SECTION, elements=4, gravity=gravity)
    damper = fb.Damper(0.1) if motor is None else None
    hinge = fb.Revolute(fb.GROUND, beam.start, damper=damper, motor=motor)
    hinge = scene.add_joint(hinge)
    if motor is None:
        scene.add_moment(beam.start, fb.Input("torque"))
    scene.add_force(beam.end, fb.Input("push"))
    outputs = {
        "tip": fb.Output("position", beam.end),
        "vy": fb.Output("velocity", beam.end, "y"),
        "angle": fb.Output("angle", hinge),
        "spin": fb.Output("spin", hinge),
        "force": fb.Output("force", hinge),
    }
    return scene, beam, hinge, outputs


def torque(t):
    return 3 * np.sin(4 * t)


def differences(a, b):
    return max(float(np.abs(np.subtract(a[name], b[name])).max()) for name in a)


# -- Steps -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(order=4), fb.GeneralizedAlpha(0.8)])
def test_a_motor_follows_its_input_along_straight_lines(scheme):
    scene, beam, hinge, outputs = arm(motor=fb.Input("place"), gravity=None)
    outputs["moment"] = fb.Output("motor_force", hinge)
    motion = fb.Motion(scene, scheme, dt=DT, outputs=outputs)
    places = 0.4 * (1 - np.cos(20 * DT * np.arange(41))) ** 2
    places = np.append(0.0, places[:-1])  # the rate at the start is zero
    for place in places[1:]:
        computed = motion.step({"place": place, "push": (0.0, 0.0)})
    grid = DT * np.arange(41)
    same = fb.simulate(
        scene, scheme, dt=DT, t_end=0.08, inputs={"place": lambda t: np.interp(t, grid, places)}
    )
    assert computed["angle"] == pytest.approx(places[-1], abs=1e-14)
    assert computed["tip"] == pytest.approx(same.position(beam.end)[-1], abs=1e-9)
    assert computed["moment"] == pytest.approx(same.joint(hinge).motor_force[-1], rel=1e-5)


def test_the_work_of_inputs_is_in_the_energy_balance():
    for motor in (None, fb.Input("place")):
        scene, _, _, _ = arm(motor)
        motion = fb.Motion(scene, dt=DT, record=fb.Record())
        for k in range(200):
            value = torque(k * DT) if motor is None else 0.2 * (1 - np.cos(3 * DT * (k + 1)))
            name = "torque" if motor is None else "place"
            motion.step({name: value, "push": (np.cos(k / 9), 0.1 * k)})
        energy = motion.solution().energy
        assert abs(energy.work).max() > 0.5
        assert abs(energy.balance_error).max() < 1e-11


def test_functions_of_time_act_beside_inputs():
    def scene(timed, push):
        scene, beam, _, _ = arm()
        scene.add_force(beam.end, timed)
        scene.add_force(beam.end, (0.3, 0.0), follower=True)
        scene.add_force(beam.node(0.5), push, follower=True)
        return scene, beam

    def pull(t):
        return np.cos(9 * t), 2 * np.sin(5 * t)

    plain, beam = scene(pull, (1.0, 2.0))
    solution = fb.simulate(plain, dt=DT, t_end=0.3)
    other, beam_too = scene(pull, fb.Input("thrust", factor=(1, 2)))
    motion = fb.Motion(other, dt=DT, outputs={"tip": fb.Output("position", beam_too.end)})
    motion.step({"thrust": 1.0})
    assert motion.run(0.3)["tip"] == pytest.approx(solution.position(beam.end)[-1], abs=1e-11)


# -- Snapshots -------------------------------------------------------------------------------------


def test_a_thousand_returns_to_a_snapshot_give_the_same_episode():
    scene, _, _, outputs = arm()
    motion = fb.Motion(scene, dt=DT, outputs=outputs)
    motion.run(0.1, lambda t, y: {"torque": torque(t)})
    start = motion.snapshot()

    def episode():
        motion.restore(start)
        for k in range(3):
            computed = motion.step({"torque": -torque(k), "push": (0.5 * k, 0.0)})
        return computed

    first = episode()
    assert max(differences(first, episode()) for _ in range(1000)) < 1e-13
    # The record begins anew at a restored state.
    recorded = fb.Motion(scene, dt=DT, record=fb.Record())
    recorded.run(10 * DT)
    there = recorded.snapshot()
    recorded.run(20 * DT)
    recorded.restore(there)
    recorded.run(25 * DT)
    solution = recorded.solution()
    assert solution.t == pytest.approx(DT * np.arange(10, 26))
    assert abs(np.diff(solution.energy.balance_error)).max() < 1e-11


def test_a_motion_goes_on_from_snapshots_copies_files_and_solutions(tmp_path):
    scene, _, _, outputs = arm()
    motion = fb.Motion(scene, dt=DT, outputs=outputs, record=fb.Record())
    motion.run(0.05, lambda t, y: {"torque": torque(t), "push": (0.0, 1.0)})
    motion.state.save(tmp_path / "state.npz")
    options = {"dt": DT, "outputs": outputs}
    others = [
        copy.deepcopy(motion),
        pickle.loads(pickle.dumps(motion)),
        fb.Motion(scene, start=motion.solution(), **options),
        fb.Motion(scene, start=fb.load(tmp_path / "state.npz"), **options),
        fb.Motion(scene, **options),
    ]
    others[-1].restore(pickle.loads(pickle.dumps(motion.snapshot())))
    assert [other.inputs["push"].tolist() for other in others] == [[0.0, 1.0]] * 5
    expected = motion.run(0.1)
    for other in others:
        assert differences(expected, other.run(0.1)) < 1e-8
        assert differences({"tip": expected["tip"]}, {"tip": other.outputs["tip"]}) < 1e-12


def test_full_turns_are_counted_and_kept():
    scene, bar = pinned_bar((1, 0), SECTION, elements=1)
    scene.set_velocity(bar, lambda x, y: (0.0, 40 * x), spin=40.0)
    outputs = {"angle": fb.Output("rotation", bar.end)}
    motion = fb.Motion(scene, dt=DT, outputs=outputs, record=fb.Record(every=50))
    angle = motion.run(1200 * DT)["angle"]
    assert angle > 2 * np.pi * 10
    start = motion.snapshot()
    assert motion.solution().rotation(bar.end)[-1] == angle == motion.state.q[-1, -1, 2]
    after = motion.run(1300 * DT)["angle"]
    assert motion.restore(start)["angle"] == angle
    assert motion.run(1300 * DT)["angle"] == pytest.approx(after, abs=1e-11)


def test_a_motion_starts_from_an_equilibrium_with_its_inputs():
    scene, beam = one_bar((1, 0), SECTION, elements=4, gravity=(0.0, -9.81))
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, motor=fb.Input("place", factor=0.5)))
    scene.add_force(beam.end, fb.Input("push"))
    held = {"place": 0.8, "push": (0.0, 2.0)}
    equilibrium = fb.static(scene, load_steps=4, inputs=held)
    outputs = {"tip": fb.Output("position", beam.end)}
    motion = fb.Motion(scene, dt=DT, outputs=outputs, start=equilibrium)
    assert motion.inputs == {"place": pytest.approx(0.8), "push": pytest.approx((0.0, 2.0))}
    before = motion.outputs["tip"]
    assert before[1] > 0.2
    assert motion.run(0.1)["tip"] == pytest.approx(before, abs=1e-8)


def test_inputs_keep_their_values_by_name_where_the_scene_gets_another_one(tmp_path):
    """A pendulum that a force of 3 N holds aside, before and after a second input is added."""
    scene, body, hinge = hinged_body((0, -1), 1.0, 0.1, {"pin": (0, 0)}, gravity=(0, -10))
    push = scene.add_force(body.centre, fb.Input("push", factor=(1, 0)))
    angle = {"angle": fb.Output("angle", hinge)}
    state = fb.static(scene, inputs={"push": 3.0})
    expected = np.linalg.eigvals(fb.linearise(scene, state).A)
    scene.remove(push)
    scene.add_force(body.centre, fb.Input("wind", factor=(0, 1)))
    scene.add_force(body.centre, fb.Input("push", factor=(1, 0)))
    state.save(tmp_path / "state.npz")
    for start in (state, fb.load(tmp_path / "state.npz")):
        motion = fb.Motion(scene, dt=0.01, start=start, outputs=angle)
        motion.restore(motion.snapshot())
        assert motion.run(0.2)["angle"] == pytest.approx(np.arctan(3 / 10), abs=1e-9)
        assert motion.inputs == {"wind": 0.0, "push": 3.0}
        for end in (start, motion.state):
            roots = np.linalg.eigvals(fb.linearise(scene, end).A)
            assert roots == pytest.approx(expected, rel=1e-6)
            frequency = fb.modes(scene, end, n=1).angular_frequencies
            assert frequency == pytest.approx(abs(expected[0]), rel=1e-6)


def test_modes_about_a_state_count_the_values_of_its_inputs():
    values = []
    for force in (fb.Input("push"), (-3.0, -2.0)):
        scene, post = clamped_bar((1, 0), SECTION, elements=2)
        arm = scene.add_beam([(1, 0.3), (2, 0.5)], SECTION, elements=2)
        scene.add_joint(fb.Rigid(post.end, arm.start, offset=(0, 0.3)))
        scene.add_force(arm.end, force)
        inputs = {"push": (-3.0, -2.0)} if isinstance(force, fb.Input) else None
        state = fb.static(scene, load_steps=2, inputs=inputs)
        response = fb.frequency_response(scene, (arm.end, (0, 1)), arm.end, [0.5], state=state)
        values.append([fb.modes(scene, state, n=3).frequencies, abs(response.values[0])])
    for with_input, constant in zip(*values, strict=True):
        assert with_input == pytest.approx(constant, rel=1e-9)


# -- Errors ----------------------------------------------------------------------------------------


WRONG = [
    ({"torque": 1.0, "tourqe": 1.0}, "no input 'tourqe'; it has"),
    ({"torque": (1.0, 2.0)}, "input 'torque'.*must be a number"),
    ({"torque": 1.0, "push": (0.0, np.nan)}, "input 'push'.*not finite"),
    ([1.0], "inputs = .* must be a dictionary"),
]


def test_a_failed_or_refused_step_leaves_the_motion_where_it_was():
    scene, _, _, outputs = arm()
    motion = fb.Motion(scene, dt=DT, outputs=outputs, max_halvings=0)
    before = motion.run(10 * DT)
    assert_refused("failed", motion.step, {"torque": 1e9}, error=fb.StepError)
    assert motion.t == pytest.approx(10 * DT)
    assert motion.inputs["torque"] == 0.0
    assert differences(before, motion.outputs) == 0
    for wrong, words in WRONG:
        assert_refused(words, motion.step, wrong)
    assert motion.stats.steps == 10 and motion.inputs["torque"] == 0.0
    motion.step({"torque": 0.0})
    assert motion.stats.steps == 11


def test_steps_that_fail_as_a_whole_are_taken_in_parts():
    scene, beam, _, outputs = arm()
    motion = fb.Motion(scene, dt=0.25, outputs=outputs, record=fb.Record())
    motion.step({"torque": 30.0})
    again = motion.snapshot()
    last = motion.run(1.5)
    assert motion.stats.halvings > 0
    assert abs(motion.solution().energy.balance_error).max() < 1e-9
    motion.restore(again)
    assert motion.run(0.5)["angle"] == pytest.approx(motion.outputs["angle"])
    assert len(last) == 5


def test_inputs_of_one_name_must_fit_together():
    scene, beam, _, _ = arm()
    scene.add_force(beam.start, fb.Input("torque"))
    assert_refused(r"'torque' has 1 value\(s\) as moment on node 0", fb.Motion, scene, dt=DT)
    scene, beam, _, _ = arm()
    scene.prescribe(beam.end, rotation=fb.Input("torque"))
    assert_refused("'torque' is a load as well as a motion", fb.Motion, scene, dt=DT)


def test_a_snapshot_of_another_scene_is_refused():
    motion, other = (fb.Motion(arm(m)[0], dt=DT) for m in (None, fb.Input("place")))
    assert_refused("another scene", lambda: other.restore(motion.snapshot()))


def test_a_scene_without_supports_has_no_reactions():
    scene, beam = one_bar((1, 0), SECTION, elements=1, gravity=(0.0, -9.81))
    outputs = {"all": fb.Output("reaction", beam.end), "x": fb.Output("reaction", beam.end, "x")}
    motion = fb.Motion(scene, dt=DT, outputs=outputs)
    for seen in (motion.outputs, motion.step()):
        assert seen["all"].tolist() == [0.0] * 3
        assert seen["x"] == 0.0
    run = fb.Response(lambda x: (scene, outputs), dt=DT, t_end=5 * DT)
    _, rows = run([1.0])
    assert rows["all"].tolist() == [[0.0] * 3] * 6
