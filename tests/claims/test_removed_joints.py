"""Joints that do not exist all the time: what solutions say of them then."""

import numpy as np
import pytest
from scenes import held_body, one_body

import fx_beam as fb


def test_the_slide_of_a_joint_is_nan_where_the_joint_does_not_exist(tmp_path):
    scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
    scene.set_velocity(body, (2.0, 0.0))
    rail = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0)))
    before = fb.simulate(scene, dt=0.1, t_end=0.5)
    scene.remove(rail)
    between = fb.simulate(scene, dt=0.1, t_end=0.8, start=before)
    motion = fb.Motion(scene, dt=0.1, start=before)
    rail_again = scene.add_joint(
        fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=fb.Spring(1.0))
    )
    after = fb.simulate(scene, dt=0.1, t_end=1.0, start=between)

    assert np.isnan(between.joint(rail).slide).all() and np.isnan(motion.slides).all()
    joined = before.then(between).then(after)
    joined.save(tmp_path / "joined.npz")
    read = fb.load(tmp_path / "joined.npz")
    for whole in (joined, read):
        slide = whole.joint(rail).slide
        assert slide[:6] == pytest.approx(2 * whole.t[:6]) and np.isnan(slide[6:]).all()
        assert np.isnan(whole.joint(rail_again).slide[:9]).all()
        assert np.isfinite(whole.joint(rail_again).slide[9:]).all()
    assert not joined.joint(rail).force[6:].any()


def test_a_scene_whose_joints_are_all_removed_goes_on_with_driven_motion():
    scene, driven = held_body((0, 0), mass=2.0, inertia=1.0)
    scene.prescribe(driven, y=lambda t: 3 * t**2)
    bead = scene.add_body((5, 0), mass=1.0, inertia=1.0).centre
    rail = scene.add_joint(fb.Prismatic(fb.GROUND, bead, axis=(1, 0)))
    before = fb.simulate(scene, dt=0.1, t_end=0.2)
    scene.remove(rail)
    after = fb.simulate(scene, dt=0.1, t_end=0.5, start=before)
    assert after.reaction(driven)[1:, 1] == pytest.approx(12.0)
    assert not after.joint(rail).force[1:].any()
