"""The numbers of demos/pendulum.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def pendulum(dt):
    return numbers("pendulum")["schemes"]["EnergyMomentum"][f"dt {dt:g}"]


@pytest.mark.parametrize(("dt", "period"), [(0.01, 1.47547), (0.1, 1.50252)])
def test_pendulum_has_the_period_of_an_energy_conserving_mid_point_rule(dt, period):
    assert pendulum(dt)["period"] == pytest.approx(period, abs=1e-4)


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_pendulum_keeps_its_energy(dt):
    assert numbers("pendulum")["energy"] == pytest.approx(1.43664, rel=1e-4)
    assert pendulum(dt)["energy drift"] < 1e-11


def test_pendulum_on_a_rigid_rod_is_the_exact_one():
    rod = numbers("pendulum")["rigid rod"]
    assert rod["period"] == pytest.approx(1.47521, abs=2e-5)
    assert rod["highest axial force"] == pytest.approx(15.557, abs=2e-3)
    assert rod["lowest axial force"] == pytest.approx(6.937, abs=2e-3)
    assert rod["largest horizontal acceleration"] == pytest.approx(5.888, abs=2e-3)


def test_pendulum_axial_force_and_acceleration_are_those_of_the_rigid_rod():
    run = pendulum(0.01)
    assert run["highest axial force"] == pytest.approx(15.557, rel=0.01)
    assert run["lowest axial force"] == pytest.approx(6.937, rel=0.01)
    assert run["largest horizontal acceleration"] == pytest.approx(5.888, rel=0.01)


def test_pendulum_newmark_rings_and_gains_energy():
    for dt in (0.1, 0.01):
        run = numbers("pendulum")["schemes"]["Newmark (trapezoidal)"][f"dt {dt:g}"]
        assert run["energy drift"] > 1
        assert run["highest axial force"] > 1000


def test_pendulum_published_scheme_is_as_smooth_and_keeps_its_energy_as_well():
    schemes = numbers("pendulum")["schemes"]
    for dt, run in schemes["ModifiedMidPoint (as published)"].items():
        assert run["energy drift"] < 1e-11 and run["lost at"] is None
        ours = schemes["EnergyMomentum"][dt]["largest horizontal acceleration"]
        assert run["largest horizontal acceleration"] == pytest.approx(ours, rel=1e-3)
        assert ours < 6.0 or dt == "dt 0.001"  # a step that sees the rod's own vibration


def test_pendulum_leaves_the_swing_by_newmark_and_later_by_hht_as_in_the_paper():
    newmark, gentle, strong, generalized = (
        numbers("pendulum")["schemes"][name]["dt 0.1"]
        for name in (
            "Newmark (trapezoidal)",
            "HHT, alpha = -0.05",
            "HHT, alpha = -0.1",
            "Generalized alpha, 0.9",
        )
    )
    assert newmark["lost at"] < gentle["lost at"] < 3 and generalized["lost at"] < 3
    assert gentle["highest axial force"] > 100
    # More damping takes a part of the swing itself instead.
    assert strong["lost at"] is None and strong["lowest energy ratio"] < 0.8
