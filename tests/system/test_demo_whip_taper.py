"""The numbers of demos/whip_taper.py."""

import numpy as np
import pytest
from demo_runs import numbers
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow
WHIPS = "uniform", "linear", "optimised"


def test_the_tip_becomes_far_faster_than_that_of_the_uniform_and_the_best_linear_whip():
    uniform, linear, best = (numbers("whip_taper")[name]["largest speed"] for name in WHIPS)
    assert best > 2.5 * uniform
    assert best > 1.25 * linear


def test_shorter_steps_and_elements_confirm_the_speeds():
    for name in WHIPS:
        own = numbers("whip_taper")[name]
        assert own["refined"] == approx(own["largest speed"], rel=0.04)


def test_all_whips_have_the_same_mass_and_no_height_below_the_least():
    whip = demo("whip_taper")
    for name in WHIPS:
        own = numbers("whip_taper")[name]
        heights = np.array(own["heights"]) / 1e3
        assert own["mass"] == approx(numbers("whip_taper")["uniform"]["mass"], rel=1e-12)
        assert heights.mean() == approx(whip.HEIGHT, rel=1e-12)
        assert heights.min() >= whip.LEAST * whip.HEIGHT * (1 - 1e-12)


def test_the_smoothed_speed_is_a_little_above_the_largest():
    for name in WHIPS:
        own = numbers("whip_taper")[name]
        assert 1 < own["smoothed"] / own["largest speed"] < 1.12


def test_the_gradient_is_that_of_differences_of_motions():
    assert numbers("whip_taper")["gradient"]["error by differences"] < 1e-6


def test_no_element_of_the_optimised_whip_gains_at_its_mass():
    # First-order conditions: zero where the height is free, not positive where it is the least.
    whip, own = demo("whip_taper"), numbers("whip_taper")["optimised"]
    gain = np.array(own["gain"])
    free = np.array(own["heights"]) > 1.05e3 * whip.LEAST * whip.HEIGHT
    scale = abs(np.array(numbers("whip_taper")["linear"]["gain"])).max()
    assert 4 < free.sum() < free.size
    assert abs(gain[free]).max() < 0.06 * scale
    assert gain[~free].max() < 0
