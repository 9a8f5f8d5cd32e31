"""The numbers of demos/monte_carlo.py."""

import numpy as np
import pytest
from demo_runs import SMALL, numbers
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow


def test_the_scatter_is_that_of_its_parameters():
    found, samples = numbers("monte_carlo"), SMALL["monte_carlo"]["samples"]
    assert found["samples"] == samples
    # Standard errors of a mean and of a standard deviation; the moment is not linear.
    assert abs(found["mean"] - found["nominal"]) < 4 * found["standard error of the mean"]
    assert found["standard deviation"] == approx(found["linear standard deviation"], rel=0.4)
    assert (
        found["mean"] < found["99 % stay below"] < found["mean"] + 4 * found["standard deviation"]
    )


def test_the_scatter_is_mostly_that_of_the_speed():
    effects = numbers("monte_carlo")["effect of one standard deviation"]
    assert effects["T"] < 0 and abs(effects["T"]) == max(map(abs, effects.values()))
    # The inertia forces grow with the square of the speed, here somewhat more.
    nominal = numbers("monte_carlo")["nominal"]
    assert effects["T"] / nominal < -2 * demo("monte_carlo").SCATTER["T"]


def test_samples_are_the_same_in_each_run_and_have_the_scatter_that_is_said():
    module = demo("monte_carlo")
    assert module.sampled(3) == module.sampled(5)[:3]
    for name in module.NOMINAL:
        values = np.array([case[name] for case in module.sampled(4000)]) / module.NOMINAL[name]
        assert values.mean() == approx(1, abs=4 * module.SCATTER[name] / np.sqrt(4000))
        assert values.std() == approx(module.SCATTER[name], rel=0.05)
