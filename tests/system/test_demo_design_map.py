"""The numbers of demos/design_map.py."""

import numpy as np
import pytest
from demo_runs import numbers
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow


def test_slow_cranks_may_have_thin_rods_and_fast_ones_none_of_these():
    found = numbers("design_map")
    assert found["points"] == 12 and found["smallest deflection"] < 1e-3
    slow, middle, fast = found["thinnest rod"].values()
    assert slow == approx(2.5e-3) and (middle or np.inf) > 4e-3 and fast is None


@pytest.mark.parametrize("change", [{"height": 5e-3}, {"speed": 7.0}])
def test_a_stiff_rod_bends_with_the_square_of_speed_over_height(change):
    stiff = {"height": 7e-3, "speed": 5.0}
    other = stiff | change
    ratio = other["speed"] / other["height"] * stiff["height"] / stiff["speed"]
    bent = demo("design_map").bent
    found = bent(other)["deflection"] / bent(stiff)["deflection"]
    assert found == approx(ratio**2, rel=0.2)


@pytest.mark.parametrize(
    ("deflection", "height"),
    [
        ([0.02, 0.009, 0.008], 2.0),
        ([0.005, 0.02, 0.008], 3.0),
        ([0.001, 0.002, 0.003], 1.0),
        ([np.nan, 0.009, 0.008], 2.0),
        ([0.001, 0.002, np.nan], None),
    ],
)
def test_the_thinnest_rod_is_that_from_which_on_all_are_stiff_enough(deflection, height):
    assert demo("design_map").thinnest([1.0, 2.0, 3.0], np.array(deflection)) == height
