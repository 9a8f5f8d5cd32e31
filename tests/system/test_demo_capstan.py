"""The numbers of demos/capstan.py."""

import math

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_ratio_of_the_forces_is_that_of_euler_and_eytelwein():
    found = numbers("capstan")
    for case in found["cases"].values():
        assert abs(case["difference"]) < 6e-4
        assert case["energy balance"] < 1e-10
    normal = found["cases"]["mu = 0.3, 180 degrees"]
    assert normal["exp(mu phi)"] == pytest.approx(2.566, abs=1e-3)
    # The rest belongs to drag and inertia, which are smaller with a slower pull.
    assert abs(found["difference with a slower pull"]) < 0.6 * abs(normal["difference"])


def test_the_held_end_carries_the_inverse_of_it():
    case = numbers("capstan")["cases"]["mu = 0.3, 180 degrees"]
    assert case["held end / T2"] == pytest.approx(math.exp(-0.3 * math.pi), rel=0.02)


def test_the_tension_along_the_rope_has_a_part_that_slides_and_one_that_sticks():
    assert numbers("capstan")["largest difference of the tension along the rope, over T2"] < 0.03
