"""The numbers of demos/parallelogram.py."""

import numpy as np
import pytest
from demo_runs import numbers
from scenes import demo

pytestmark = pytest.mark.slow


def schemes():
    return numbers("parallelogram")["schemes"]


def test_the_decaying_scheme_takes_fewer_wrong_turns_than_the_conserving_one():
    # Which mechanisms these are depends on rounding, how many hardly: 2 and 6 of 52.
    decaying, conserving = (schemes()[f"Energy{name}"] for name in ("Decaying", "Momentum"))
    assert decaying["wrong turns"] < conserving["wrong turns"]
    assert decaying["errors below 1e-2"] > conserving["errors below 1e-2"]


def test_on_the_way_it_is_more_accurate_than_hht():
    assert schemes()["EnergyDecaying"]["median error"] < 5e-3
    assert schemes()["HHT, alpha = -0.1"]["median error"] > 8e-3


def test_the_rigid_mechanism_keeps_its_energy():
    parallelogram = demo("parallelogram")
    t = np.linspace(0, 6, 601)
    angle, mass = parallelogram.SHOWN
    theta, rate = parallelogram.rigid(angle, mass)(t)
    # Energy per J: theta_t^2 / 2 + g a (m a + m b + M) sin(theta) / J.
    a, b, m = parallelogram.CRANK, parallelogram.COUPLER, parallelogram.MASS
    J = 2 / 3 * m * a**3 + 2 * parallelogram.INERTIA * a + (m * b + mass) * a**2
    pull = parallelogram.GRAVITY * a * (m * a + m * b + mass) / J
    energy = rate**2 / 2 + pull * np.sin(theta)
    assert energy == pytest.approx(pull * np.sin(angle), abs=1e-9)
