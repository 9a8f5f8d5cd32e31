"""Motions for one thread at a time, responses for several, and solutions that threads read."""

import copy
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes import pinned_bar

import fx_beam as fb


def pendulum(length=1.0):
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene, beam = pinned_bar((length, 0), section, elements=2, gravity=(0, -9.81))
    return scene, {"tip": fb.Output("position", beam.end)}


def elsewhere(call):
    """Result of a call, or raises, in another thread."""
    warnings = []

    def target():
        try:
            warnings.append(call())
        except RuntimeError as error:
            warnings.append(error)

    thread = threading.Thread(target=target)
    thread.start()
    thread.join()
    return warnings[0]


def test_a_motion_refuses_a_second_thread_while_it_steps_and_stays_right():
    scene, outputs = pendulum()
    motion = fb.Motion(scene, dt=0.01, outputs=outputs, record=fb.Record())
    uses = ("t", "q", "v", "slides", "inputs", "outputs", "stats", "state")
    calls = [motion.step, motion.solution, motion.snapshot, lambda: motion.run(1.0)]
    calls += [lambda name=name: getattr(motion, name) for name in uses]
    errors = []

    def controller(t, y):
        errors.extend(elsewhere(call) for call in calls)

    motion.run(0.05, controller)
    assert len(errors) == 5 * len(calls)
    assert all("another thread" in str(error) for error in errors)
    alone = fb.Motion(pendulum()[0], dt=0.01, record=fb.Record())
    alone.run(0.05)
    assert np.array_equal(motion.solution().q, alone.solution().q)


def test_one_motion_may_be_used_by_threads_in_turn_and_copies_at_once():
    motion = fb.Motion(pendulum()[0], dt=0.01)
    other = copy.copy(motion)
    for _ in range(3):
        elsewhere(motion.step)
    motion.run(0.05, lambda t, y: elsewhere(other.step) and None)
    assert motion.t == pytest.approx(0.05) and other.t == pytest.approx(0.02)


@pytest.mark.parametrize("kind", [fb.Response, fb.StaticResponse])
def test_a_second_thread_changes_nothing_between_a_motion_and_its_derivatives(kind):
    """Up to version 1.1 it was refused; now each thread has a state of its own."""

    def build(x):
        return pendulum(x[0])

    options = {"dt": 0.01, "t_end": 0.03} if kind is fb.Response else {"load_steps": 1}
    run, others = kind(build, **options), []
    run([1.0])

    def cost(t, y):
        others.append(elsewhere(lambda: (run([2.0])[1]["tip"], run.jacobian()["tip"])))
        others.append(elsewhere(run.jacobian)["tip"])  # without a call of its own
        return float(y["tip"][-1, 1]), {"tip": np.eye(len(t))[-1][:, None] * (0.0, 1.0)}

    objective = run.objective(cost)
    slope = objective([1.0])[1]
    assert slope == pytest.approx(run.jacobian("tip")["tip"][-1, 1])
    ((tips, rows), own), alone = others, kind(build, **options)
    assert np.array_equal(own, run.jacobian()["tip"])
    assert np.array_equal(alone([2.0])[1]["tip"], tips)
    assert np.array_equal(alone.jacobian()["tip"], rows)


def test_a_solution_that_threads_read_at_once_has_the_same_stress_resultants():
    scene, _ = pendulum()
    other = scene.add_beam([(1, 0), (2, 0)], scene.beams[0].section, elements=40)
    scene.add_joint(fb.Revolute(scene.beams[0].end, other.start))

    def forces(threads):
        solution = fb.simulate(scene, dt=0.01, t_end=0.5)
        with ThreadPoolExecutor(threads) as executor:
            return list(executor.map(lambda beam: solution.resultants(beam).M, scene.beams * 4))

    expected = forces(1)
    for _ in range(5):
        assert all(map(np.array_equal, forces(8), expected))
