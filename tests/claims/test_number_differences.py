"""Differences of `build`: what is read for each number, and how often."""

import numpy as np
import pytest

import fx_beam as fb

STEPS, TIMES = 40, np.linspace(0, 1, 5)
X = np.array([0.3, -0.2, 0.5, 0.1, -0.4])


def _response(force, *, motor=lambda t: 0.0):
    """A bar on a driven hinge with a force over time, and how often `build` was called."""
    calls = []

    def build(x):
        calls.append(x)
        scene = fb.Scene()
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        bar = scene.add_beam([(0, 0), (1, 0)], section)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, motor=motor))
        scene.add_force(bar.end, lambda t: force(t, x))
        return scene, {"end": fb.Output("position", bar.end)}

    return fb.Response(build, dt=1 / STEPS, t_end=1.0), calls


def _gradient(run):
    t, _ = run(X)
    return run.vjp({"end": np.column_stack([np.cos(t), np.sin(t)])})


def profile(t, x):
    return x @ [0, 0, 0, 0, 1], np.interp(t, TIMES, x)


def single(t, x):
    return x[4], np.interp(float(t), TIMES, x)


def of_a_vector(t, x):
    return np.array([0, 1]) * np.interp(t, TIMES, x) + np.array([x[4], 0])


def bent(t, x):
    return x[4] ** 3, np.interp(t, TIMES, np.sin(x))


@pytest.mark.parametrize("force", [profile, of_a_vector], ids=lambda own: own.__name__)
def test_functions_that_accept_arrays_are_called_once_for_all_times(force):
    sizes = []

    def counted(t, x):
        sizes.append(np.size(t))
        return force(t, x)

    run, calls = _response(counted)
    found = _gradient(run)
    run(X)
    calls.clear(), sizes.clear()
    _gradient(run)  # with a motion
    at_once = [size for size in sizes if size > 1]
    # In the motion, and once for each scene that is compared: that of the motion, and all others.
    assert at_once == [2 * STEPS] * (len(calls) + 1)
    # Single times: the first scene, then a few of each, to compare.
    assert len(sizes) - len(at_once) < 6 * STEPS + 7 * (len(calls) + 1)
    assert found == pytest.approx(_gradient(_response(single)[0]), rel=1e-11, abs=1e-13)


def test_numbers_on_a_line_take_two_scenes_and_others_four():
    for force, number in ((profile, 2), (bent, 4)):
        run, calls = _response(force)
        _gradient(run)
        calls.clear()
        _gradient(run)
        assert len(calls) == 2 + number * len(X)  # the motion, and the scene at x


def test_derivatives_of_bent_numbers_are_exact():
    found, of_line = (_gradient(_response(own)[0]) for own in (bent, _straightened))
    assert found == pytest.approx(of_line, rel=1e-11, abs=1e-13)


def _straightened(t, x):
    """`bent`, with its tangent at X in the place of its curves."""
    cube = X[4] ** 3 + 3 * X[4] ** 2 * (x[4] - X[4])
    return cube, np.interp(t, TIMES, np.sin(X) + np.cos(X) * (x - X))


def _pulse(t, x):
    """A function that takes an array of times, but for a single time."""
    return (x[0] if np.any(t > 0.9) else 0.0), np.interp(t, TIMES, x)


def _in_place(t, x):
    t *= 1.0
    return x[4], np.interp(t, TIMES, x)


@pytest.mark.parametrize("force", [_pulse, _in_place], ids=lambda own: own.__name__)
def test_functions_that_give_other_values_for_arrays_are_called_one_by_one(force):
    def alone(t, x):
        return force(float(t), x)

    found, known = (_gradient(_response(own)[0]) for own in (force, alone))
    assert found == pytest.approx(known, rel=1e-11, abs=1e-13)


def test_functions_that_differ_from_scene_to_scene_are_compared_at_some_times():
    def switched(t, x):
        return (np.max(t) if x[0] != X[0] else t), np.interp(t, TIMES, x)

    run, _ = _response(switched)
    alone, _ = _response(lambda t, x: switched(float(t), x))
    assert _gradient(run) == pytest.approx(_gradient(alone), rel=1e-11, abs=1e-13)
