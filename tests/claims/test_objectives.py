"""Numbers of whole motions and misfits of measurements, for optimisation; copies of responses."""

import copy
import pickle

import numpy as np
import pytest
from scenes import assert_refused, one_body
from scipy.optimize import least_squares, minimize

import fx_beam as fb


def pushed(x):
    """A body with the mass x[0] that is pushed against a spring of x[1]."""
    scene, body = one_body((0, 0), mass=x[0], inertia=1.0)
    scene.add_force_between(body.centre, (-1.0, 0.0), spring=fb.Spring(x[1]))
    scene.add_force(body.centre, (1.0, 0.0))
    outputs = {"place": fb.Output("position", body.centre)}
    return scene, outputs | {"speed": fb.Output("velocity", body.centre, "x")}


def cost(t, y):
    weights = {name: np.zeros_like(rows) for name, rows in y.items()}
    weights["place"][-1, 0] = gap = y["place"][-1, 0] - 0.1
    weights["speed"][-1] = y["speed"][-1]
    return gap**2 / 2 + y["speed"][-1] ** 2 / 2, weights


def test_a_number_of_a_motion_and_its_derivatives_in_one_call():
    run = fb.Response(pushed, dt=0.05, t_end=1.0)
    objective, x = run.objective(cost), np.array([1.1, 5.0])
    value, gradient = objective(x)
    h = 1e-5
    ends = [[objective(x + s * h * e)[0] for s in (1, -1)] for e in np.eye(2)]
    assert gradient == pytest.approx([(a - b) / (2 * h) for a, b in ends], abs=1e-8)
    best = minimize(objective, x, jac=True)
    assert best.success
    assert best.fun < value
    assert abs(best.jac).max() < 1e-4 * abs(gradient).max()


def test_misfits_of_measurements():
    run, x = fb.Response(pushed, dt=0.05, t_end=1.0), np.array([1.0, 4.0])
    measured = run(x)[1]
    measured["place"][3:5] = np.nan  # the measurement has gaps
    misfit = run.misfit(measured, {"place": 1e-3, "speed": 1e-2})
    fit = least_squares(misfit, [1.2, 5.0], jac=misfit.jacobian)
    assert fit.x == pytest.approx(x, rel=1e-6)
    before = run.stats
    J = misfit.jacobian(fit.x)
    misfit(fit.x)
    other = misfit.jacobian(1.1 * fit.x)
    assert run.stats is not before
    assert abs(misfit.jacobian(fit.x) - J).max() < 1e-9 * abs(J).max()
    assert abs(other - J).max() > 1e-3 * abs(J).max()


def test_a_jacobian_may_be_asked_for_after_another_use_of_its_response_has_failed_and_of_a_copy():
    run = fb.Response(pushed, dt=0.05, t_end=1.0)
    misfit = run.misfit({"speed": np.zeros(21)})
    misfit([1.0, 4.0])
    duplicate, J = copy.deepcopy(misfit), misfit.jacobian([1.0, 4.0])
    assert_refused("mass", run, [-1.0, 4.0])
    for response in misfit, duplicate:
        assert response.jacobian([1.0, 4.0]) == pytest.approx(J, rel=1e-12)


def test_steps_of_a_tolerance_that_end_at_measured_times_have_derivatives():
    times, x = np.linspace(0, 1, 5), np.array([1.0, 4.0])
    ends = {"breaks": times[1:-1], "record": fb.Record(times=times)}
    run = fb.Response(pushed, tolerance=1e-4, t_end=1.0, **ends)
    misfit = run.misfit({"place": run(x)[1]["place"]}, 1e-3)
    fit = least_squares(misfit, [1.2, 5.0], jac=misfit.jacobian)
    assert fit.x == pytest.approx(x, rel=1e-6)


def test_masked_measurements_do_not_count_and_what_was_given_may_change_afterwards():
    run, x = fb.Response(pushed, dt=0.05, t_end=1.0), np.array([1.0, 4.0])
    place = run(x)[1]["place"]
    masked = np.ma.masked_array(place + 1.0, mask=np.ones(place.shape))
    masked[4:] = place[4:]
    scatter = np.full(place.shape, 1e-3)
    misfit = run.misfit({"place": masked}, {"place": scatter})
    masked[:], scatter[:] = 7.0, 7.0
    J = misfit.jacobian(1.1 * x)
    rows = np.repeat(np.arange(len(place)) < 4, 2)
    assert not J[rows].any()
    assert abs(J[~rows]).max() > 1.0
    assert abs(misfit(x)).max() == 0.0


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda run: pickle.loads(pickle.dumps(run))])
def test_copies_know_what_was_given_but_no_motion(duplicate):
    run, x = fb.Response(pushed, dt=0.05, t_end=0.5), [1.0, 4.0]
    _, y = run(x)
    run.jacobian()
    other = duplicate(run)
    assert_refused("called after run", lambda: other.vjp({"place": y["place"]}))
    assert (other(x)[1]["place"] == y["place"]).all()
    assert (other.vjp({"place": y["place"]}) == run.vjp({"place": y["place"]})).all()
