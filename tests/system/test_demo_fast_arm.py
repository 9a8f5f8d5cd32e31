"""The numbers of demos/fast_arm.py."""

import numpy as np
import pytest
from demo_runs import numbers
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow
arm = demo("fast_arm")


def test_the_tip_stays_at_its_goal_also_with_finer_steps_and_elements():
    for name in ("40 numbers", "best polynomial", "degree 5"):
        own = numbers("fast_arm")[name]
        assert own["tip off its goal"] <= arm.LIMIT
        assert own["with finer steps and elements"] <= arm.LIMIT
        assert own["energy left"] < 1e-3 * own["largest energy"]
        assert own["largest acceleration"] <= (1 + 1e-9) * arm.A_MAX
        assert own["largest energy error"] < 1e-10 * own["largest energy"]


def test_40_numbers_take_less_time_than_polynomials_and_more_than_a_rigid_arm():
    found = numbers("fast_arm")
    T = found["40 numbers"]["T"]
    assert found["rigid arm"]["T"] < T < 0.85 * found["degree 5"]["T"]
    assert found["degree 5, as fast"]["tip off its goal"] > 0.1
    # No polynomial of degree 9 with the limited acceleration is as fast.
    polynomial = arm.Turn(T, arm.POLYNOMIAL)
    start = np.linalg.lstsq(arm.POLYNOMIAL, arm.quintic(T), rcond=None)[0]
    c = polynomial.best(start)
    # The optimiser keeps the limit to 1e-6 ... 2e-5, by round-off; what is beyond it only helps c.
    assert 0.99 < abs(arm.POLYNOMIAL @ c).max() < 1.001
    assert polynomial.largest(c) > 10 * arm.LIMIT


def test_the_gradient_is_that_of_differences():
    turn = arm.Turn(0.85)
    rng = np.random.default_rng(3)
    c = arm.quintic(0.85) + 0.1 * rng.standard_normal(arm.INTERVALS)
    _, gradient = turn.cost(c)
    for h in (rng.standard_normal(arm.INTERVALS), np.eye(arm.INTERVALS)[7]):
        h *= 1e-4
        ahead, behind = ((turn.off(at) ** 2).sum() for at in (c + h, c - h))
        difference = (ahead - behind) / 2 / (arm.LIMIT**2 * arm.WINDOW / turn.dt)
        assert difference == approx(gradient @ h, rel=1e-5)


def test_the_motor_goes_by_90_degrees_and_stops():
    angle = arm.motor(arm.quintic(1.2), 1.2)
    assert angle(0.0) == 0
    assert angle(0.6) == approx(arm.ANGLE / 2)
    assert (angle(1.2), angle(1.3)) == approx((arm.ANGLE, arm.ANGLE))
    # The polynomial of degree 5 at a fourth of its time.
    s = 0.25
    assert angle(0.3) == approx(arm.ANGLE * s**3 * (10 - 15 * s + 6 * s**2), rel=1e-2)
