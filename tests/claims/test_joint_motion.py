"""Coordinates, rates, forces and motors of joints, against what they must be."""

import numpy as np
import pytest

import fx_beam as fb

BAR = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-3)
AXIS = np.array([0.6, 0.8])


# Soft enough for the steps below to resolve all of its vibrations.
SOFT = fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=1.0, rhoI=1e-2)


def arm_with_slider(motor=None, spring=None, section=BAR):
    """An arm that a motor turns, and a bar that slides along its end."""
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=4, name="arm")
    bar = scene.add_beam([(1, 0), (1.6, 0.8)], section, elements=2, name="bar")
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=motor))
    slide = scene.add_joint(fb.PinInSlot(arm.end, bar.start, axis=AXIS, spring=spring))
    return scene, arm, bar, hinge, slide


def turning(t):
    return 0.5 * (1 - np.cos(4 * t))


def test_the_angle_of_a_motor_is_what_it_was_told_and_its_rate_the_derivative():
    scene, arm, _, hinge, _ = arm_with_slider(turning)
    solution = fb.simulate(scene, dt=1e-3, t_end=0.2)
    motion = solution.joint(hinge)
    np.testing.assert_allclose(motion.angle, turning(solution.t), atol=1e-13)
    np.testing.assert_allclose(motion.rate, 2 * np.sin(4 * solution.t), atol=1e-2)
    np.testing.assert_array_equal(motion.rate, motion.spin)
    np.testing.assert_array_equal(motion.force, solution.joint(hinge).force)
    np.testing.assert_array_equal(motion.angle, solution.rotation(arm.start))


def test_the_rate_of_a_slide_is_the_derivative_of_the_slide_on_a_turning_guide():
    spring = fb.Spring(200.0)
    scene, arm, _, _, slide = arm_with_slider(turning, spring, SOFT)
    solution = fb.simulate(scene, dt=1e-4, t_end=0.2)
    motion = solution.joint(slide)
    assert np.ptp(motion.slide) > 0.01 and np.ptp(motion.angle) > 0.1
    for found, of in ((motion.rate, motion.slide), (motion.spin, motion.angle)):
        central = (of[2:] - of[:-2]) / (solution.t[2:] - solution.t[:-2])
        np.testing.assert_allclose(found[1:-1], central, atol=2e-3 * abs(central).max())


def test_the_motors_power_adds_up_to_the_work_and_to_the_energy_gained():
    dt = 1e-3
    scene, *_, hinge, slide = arm_with_slider(turning, fb.Spring(200.0))
    solution = fb.simulate(scene, dt=dt, t_end=0.2)
    work = np.concatenate([[0], np.cumsum(solution.joint(hinge).motor_power[1:] * dt)])
    # The only work there is, to second order in a step's angle.
    np.testing.assert_allclose(work, solution.energy.work, atol=1e-5 * abs(work).max())
    gained = solution.energy.total - solution.energy.total[0]
    np.testing.assert_allclose(work, gained, atol=2e-3 * abs(gained).max())
    with pytest.raises(ValueError, match="has no motor"):
        solution.joint(slide).motor_power  # noqa: B018


def test_the_power_of_a_motor_on_a_slide_is_exact_and_without_its_spring(tmp_path):
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (1, 0)], BAR, elements=2)
    joint = scene.add_joint(
        fb.Prismatic(
            fb.GROUND, bar.start, (1, 0), motor=lambda t: 0.1 * t**2, spring=fb.Spring(30.0)
        )
    )
    solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    solution.save(tmp_path / "run.npz")
    for found in (solution, fb.load(tmp_path / "run.npz")):
        motion = found.joint(joint)
        work = np.cumsum(motion.motor_power * 1e-3)
        np.testing.assert_allclose(work, solution.energy.work, atol=1e-12 * work.max())
    # The motor pushes the bar and its spring; the joint is both of them.
    pushed = solution.joint(joint).motor_force[1:]
    total = solution.joint(joint).force[1:, 0]
    middle = (solution.slide(joint)[1:] + solution.slide(joint)[:-1]) / 2
    np.testing.assert_allclose(pushed - 30.0 * middle, total, atol=1e-9 * abs(pushed).max())


def test_what_was_not_recorded_or_is_not_there_is_named():
    scene, *_, hinge, slide = arm_with_slider(turning)
    thin = fb.simulate(scene, dt=1e-3, t_end=0.01, record=fb.Record(rates=False, every=5))
    with pytest.raises(ValueError, match="rates not recorded"):
        thin.joint(slide).rate  # noqa: B018
    with pytest.raises(ValueError, match=r"needs every step; simulate with record=Record\(every"):
        thin.joint(hinge).motor_power  # noqa: B018
