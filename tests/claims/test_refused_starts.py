"""Runs that are refused before they start, with the reason."""

import pytest
from scenes import one_bar, pinned_bar

import fx_beam as fb


def arm(motor):
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene, beam = one_bar((1, 0), section, elements=1)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, motor=motor))
    return scene


@pytest.mark.parametrize("times", [[9.0], [-2.0, -1.0]])
def test_a_record_with_no_time_in_the_run_is_refused(times):
    with pytest.raises(fb.SceneError, match="times.* must be in part within"):
        fb.simulate(arm(None), dt=0.01, t_end=0.1, record=fb.Record(times=times))


@pytest.mark.parametrize("speed", [1e20, 1e40])
def test_speeds_at_which_no_step_turns_little_enough_end_the_run(speed):
    # Corrections that are shortened to a small turn do little work, which is no convergence.
    scene = arm(None)
    scene.set_velocity(scene.beams[0], lambda x, y: (0.0, speed * x), spin=speed)
    with pytest.raises(fb.StepError, match="turns by .* rad in one step"):
        fb.simulate(scene, dt=0.01, t_end=0.02)


def test_a_moment_on_a_node_with_almost_no_inertia_is_said():
    scene, beam = pinned_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=1e-3, rhoA=1.0), elements=1)
    scene.add_moment(beam.start, fb.Input("torque"))
    motion = fb.Motion(scene, dt=0.01, outputs={"angle": fb.Output("rotation", beam.start)})
    with pytest.raises(fb.StepError, match=r"turns by .*almost no inertia.*add_mass\(node, 0.0"):
        motion.run(0.1, lambda t, y: {"torque": 2.0 * (1.0 - y["angle"])})
