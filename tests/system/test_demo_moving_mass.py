"""The numbers of demos/moving_mass.py."""

import numpy as np
import pytest
from demo_runs import numbers
from scenes import demo

pytestmark = pytest.mark.slow


def test_the_deflection_under_a_moving_mass_is_that_of_the_series():
    for run in numbers("moving_mass")["speeds"].values():
        assert run["error of the deflection"] < 3e-3
        assert run["balance error"] < 1e-10
        assert run["largest gap"] < 1e-13


def test_errors_fall_with_the_mesh():
    errors = numbers("moving_mass")["meshes"]
    first = [errors[f"degree 1, {n} elements"] for n in (10, 20, 40)]
    assert first[0] > 3 * first[1] > 9 * first[2]
    assert errors["degree 2, 20 elements"] < 1e-3


def test_the_series_of_a_force_alone_has_its_closed_form():
    moving = demo("moving_mass")
    speed = moving.SPEEDS["a = 0.5"]
    t = np.linspace(0, moving.duration(speed), 51)
    exact = moving.closed_series(speed, t)
    assert moving.series(speed, 50, 0.0) == pytest.approx(exact, abs=1e-6 * exact.max())


def test_the_inertia_of_the_mass_delays_and_raises_the_deflection():
    run = numbers("moving_mass")["speeds"]["a = 0.25"]
    assert run["deflection / static"] > run["of the force alone"] > 1
    assert run["largest force / weight"] > 1.1
