"""Steps are the same numbers, to the last digit, whatever is asked for besides them."""

import numpy as np
import pytest
from scenes import FLYING, held_body, pinned_bar

import fx_beam as fb

DT, STEPS = 0.1 / 3, 60


def mechanism():
    """An arm on a pin, with a body that turns through full turns, under a load in time."""
    scene, arm = pinned_bar((1, 0), FLYING, elements=4, gravity=(0, -9.81))
    scene.add_force(arm.end, lambda t: (5.0 * np.sin(3 * t), 2.0))
    wheel = scene.add_body((1, 0), mass=0.5, inertia=0.1)
    scene.add_joint(fb.Revolute(arm.end, wheel.centre, damper=fb.Damper(0.01)))
    scene.set_velocity(wheel, spin=15.0)
    return scene


def whole(**options):
    return fb.simulate(mechanism(), dt=DT, t_end=STEPS * DT, **options)


@pytest.fixture(scope="module")
def motion():
    # Some of its steps are halved.
    return whole(newton=fb.NewtonOptions(max_turn=0.45))


def same(rows, motion):
    return np.array_equal(rows, motion.q[: len(rows)])


@pytest.mark.parametrize("steps", [1, 7, 20, 30, 59])
def test_rows_do_not_depend_on_the_end(motion, steps):
    assert motion.stats.halvings > 0
    part = fb.simulate(mechanism(), dt=DT, t_end=steps * DT, newton=fb.NewtonOptions(max_turn=0.45))
    assert len(part.q) == steps + 1
    assert same(part.q, motion)


def test_rows_do_not_depend_on_an_end_within_a_step(motion):
    newton = fb.NewtonOptions(max_turn=0.45)
    # By less than what is taken for a step of its own.
    for t_end in (20.4 * DT, 20.0000005 * DT):
        part = fb.simulate(mechanism(), dt=DT, t_end=t_end, newton=newton)
        assert part.t[-1] == t_end
        assert same(part.q[:20], motion)


def test_rows_do_not_depend_on_the_record_or_on_conditions(motion):
    newton = fb.NewtonOptions(max_turn=0.45)
    some = whole(newton=newton, record=fb.Record(every=7, rates=False, forces=False))
    assert np.array_equal(some.q, motion.q[[*range(0, STEPS, 7), STEPS]])
    ended = whole(newton=newton, until=lambda t, outputs: t - 41.5 * DT)
    assert same(ended.q[:-1], motion)


def test_full_turns_are_taken_out_after_the_same_steps():
    # The times of blocks are those of conditions and of single steps.
    scene, body = held_body((0, 0), mass=1.0, inertia=1.0)
    scene.set_velocity(body, spin=1.0 / 0.7)
    options = {"dt": 0.7, "record": fb.Record(rates=False, forces=False)}
    run = fb.simulate(scene, t_end=1400 * 0.7, **options)
    until = fb.simulate(scene, t_end=1400 * 0.7, until=lambda t, outputs: t - 1e9, **options)
    stepped = fb.Motion(scene, **options)
    for _ in range(1400):
        stepped.step()
    assert np.array_equal(run.q, until.q)
    assert np.array_equal(run.q, stepped.solution().q)
    assert stepped.stats.steps == stepped.stats.substeps == 1400


def test_steps_of_a_motion_are_those_of_a_run(motion):
    newton, record = fb.NewtonOptions(max_turn=0.45), fb.Record()
    steps = fb.Motion(mechanism(), dt=DT, newton=newton, record=record)
    steps.run(STEPS * DT)
    assert steps.stats.halvings == motion.stats.halvings
    assert same(steps.solution().q, motion)
