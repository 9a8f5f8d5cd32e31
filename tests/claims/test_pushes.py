"""Forces on nodes that a motion takes in single steps, beside its inputs."""

import numpy as np
import pytest
from scenes import assert_refused, one_body, pinned_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
SCHEMES = [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.GeneralizedAlpha(0.8)]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_force_on_a_body_gives_it_the_impulse_of_its_step_only(scheme):
    scene, body = one_body((0, 0), 2.0, 0.1, {"edge": (0.3, 0.0)})
    motion = fb.Motion(scene, scheme, dt=0.1, outputs={"v": fb.Output("velocity", body.centre)})
    motion.step(forces={body.centre: (4.0, -6.0)})
    thrown = motion.step()["v"]
    if scheme.rates.level == 0.5:  # else the step without a force shares the one before
        assert thrown == pytest.approx(np.array([4.0, -6.0]) * 0.1 / 2.0, rel=1e-12)
    resting = motion.restore(fb.Motion(scene, scheme, dt=0.1).snapshot())["v"]
    assert resting == pytest.approx([0.0, 0.0], abs=1e-15)
    # Beside the centre it turns the body: J w' = x Fy - y Fx, for a first step from rest.
    spun = fb.Motion(scene, dt=1e-3, outputs={"w": fb.Output("spin", body.centre)})
    w = spun.step(forces={body["edge"]: (0.0, 5.0)})["w"]
    assert w == pytest.approx(0.3 * 5.0 * 1e-3 / 0.1, rel=1e-4)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_is_the_same_as_an_input_of_the_scene(scheme):
    motions = []
    for has_input in (False, True):
        scene, bar = pinned_bar((1, 0), SECTION, 4, gravity=(0, -9.81))
        if has_input:
            scene.add_force(bar.end, fb.Input("push"))
        hinge = scene.add_joint(fb.Revolute(bar.end, scene.add_body((1, 0), 0.5, 0.1).centre))
        outputs = {"pin": fb.Output("force", hinge)}
        motion = fb.Motion(scene, scheme, dt=0.01, outputs=outputs, record=fb.Record())
        for k in range(20):
            push = 30.0 * np.sin(0.3 * k), 5.0
            if has_input:
                out = motion.step({"push": push})
            else:
                out = motion.step(forces={bar.end: push})
        motions.append((motion.q, out["pin"], motion.solution()))
    (q, pin, solution), (q_input, pin_input, by_input) = motions
    assert q == pytest.approx(q_input, abs=1e-12)
    assert pin == pytest.approx(pin_input, abs=1e-9)
    assert solution.energy.work == pytest.approx(by_input.energy.work, abs=1e-12)
    assert abs(solution.energy.work[-1]) > 0.1


def test_a_support_takes_the_force_on_its_node():
    scene, bar = pinned_bar((0, -1), SECTION, 2, gravity=(0, -10.0))
    reactions = []
    for forces in ({}, {bar.start: (7.0, 3.0)}):
        motion = fb.Motion(scene, dt=0.01, record=fb.Record())
        motion.step(forces=forces)
        reactions.append(motion.solution().reaction(bar.start)[-1])
    assert reactions[1] - reactions[0] == pytest.approx([-7.0, -3.0, 0.0], abs=1e-9)


def test_a_step_that_fails_leaves_no_force_behind():
    scene, body = one_body((0, 0), 1.0, 0.1, {"edge": (1.0, 0.0)})
    motion = fb.Motion(scene, dt=0.1, max_halvings=0)
    with pytest.raises(fb.StepError):
        motion.step(forces={body["edge"]: (0.0, 1e6)})
    motion.step()
    assert abs(motion.q).max() == 0.0


@pytest.mark.parametrize(
    ("forces", "words"),
    [
        ("node", "a dictionary of forces"),
        ({3: (1, 2)}, "not a node"),
        ({"end": 1.0}, "2 numbers"),
        ({"end": (1.0, np.nan)}, "finite"),
        ({"other": (1.0, 0.0)}, "another scene"),
    ],
)
def test_what_is_no_force_on_a_node_of_the_scene_is_refused(forces, words):
    scene, bar = pinned_bar((1, 0), SECTION, 2)
    other_scene, other = pinned_bar((1, 0), SECTION, 2)
    nodes = {"end": bar.end, "other": other.end}
    motion = fb.Motion(scene, dt=0.1)
    if isinstance(forces, dict):
        forces = {nodes.get(node, node): force for node, force in forces.items()}
    assert_refused(words, motion.step, forces=forces)
    assert motion.t == 0.0
