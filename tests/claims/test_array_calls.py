"""Functions of time that take arrays are called once for all times, however these are rounded."""

import numpy as np
import pytest

import fx_beam as fb

STEPS = 200
X = np.array([1.0, 0.5])


def response(kind, function):
    """A bar that a force, a motor or a prescribed rotation moves as a function of t and x."""

    def build(x):
        def driven(t):
            return function(t, x)

        scene = fb.Scene()
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        bar = scene.add_beam([(0, 0), (1, 0)], section, elements=1)
        if kind == "force":
            scene.pin(bar.start)
            scene.add_force(bar.end, lambda t: (x[1] * t, driven(t)))
        elif kind == "motor":
            scene.add_joint(fb.Revolute(fb.GROUND, bar.start, motor=driven))
        else:
            scene.prescribe(bar.start, x=0.0, y=0.0, rotation=driven)
        return scene, {"speed": fb.Output("velocity", bar.end)}

    return fb.Response(build, dt=1 / STEPS, t_end=1.0)


def ramp(t, x):
    """A smooth ramp that is rounded otherwise for an array, as powers are by some processors."""
    q = t / 0.7
    smooth = x[0] * (10 * q**3 - 15 * q**4 + 6 * q**5)
    return smooth * (1 + 4 * np.finfo(float).eps * (np.size(t) > 1))


def gradient(run, x):
    t, _ = run(x)
    return run.vjp({"speed": np.column_stack([np.cos(t), np.sin(t)])})


@pytest.mark.parametrize("kind", ["force", "motor", "prescribed"])
def test_functions_whose_arrays_are_rounded_otherwise_are_called_once_for_all_times(kind):
    sizes = []

    def counted(t, x):
        sizes.append(np.size(t))
        return ramp(t, x)

    run = response(kind, counted)
    run(X)
    for x in (1.1 * X, 1.2 * X):
        sizes.clear()
        run(x)
        assert sizes.count(1) < 40  # for the start, and to compare some
    sizes.clear()
    slopes = gradient(run, X)
    assert sizes.count(1) < STEPS
    alone = response(kind, lambda t, x: ramp(float(t), x))
    assert slopes == pytest.approx(gradient(alone, X), rel=1e-9)
