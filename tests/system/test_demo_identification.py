"""The numbers of demos/identification.py."""

import numpy as np
import pytest
from demo_runs import numbers
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow
NAMES = demo("identification").NAMES


def test_what_is_left_is_the_noise():
    for how in ("with the Jacobian", "with differences"):
        assert numbers("identification")[how]["chi^2 per value"] == approx(1, abs=0.06)


def test_the_true_numbers_are_near_those_found_in_terms_of_their_intervals():
    found = numbers("identification")
    # Each is outside of its interval once in 20 times, and beyond twice its width once in 10 000.
    assert sum(found[name]["inside"] for name in NAMES) >= 5
    for name in NAMES:
        own = found[name]
        error = abs(np.log(own["found"] / own["true"]))
        assert error < 2 * own["relative half width of 95 %"] < 0.8


def test_the_jacobian_takes_an_eighth_of_the_motions_to_the_same_numbers():
    found = numbers("identification")
    motions = [found[f"with {how}"]["motions"] for how in ("the Jacobian", "differences")]
    assert 7 * motions[0] < motions[1]
    narrowest = min(found[name]["relative half width of 95 %"] for name in NAMES)
    assert found["largest difference of z"] < narrowest
