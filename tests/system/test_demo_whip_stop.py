"""The numbers of demos/whip_stop.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def runs(kind):
    return numbers("whip_stop")[kind]


def test_whip_gets_back_what_stops_and_peg_take_for_each_stiffness():
    for run in (runs("schemes")["EnergyMomentum"], *runs("stiffness").values()):
        assert run["energy drift"] < 1e-11
        assert run["energy at the end / start"] == pytest.approx(1, abs=1e-11)
        assert run["times that the peg is met"] >= 1


def test_whip_stops_at_its_limit_and_at_the_peg():
    run = runs("schemes")["EnergyMomentum"]
    assert 1.0 < run["angle at the most"] < 1.01
    assert 0 < run["depth in the peg at the most"] < 2e-3
    depths = [run["depth in the peg at the most"] for run in runs("stiffness").values()]
    assert depths == sorted(depths, reverse=True)


def test_whip_loses_what_its_restitution_takes():
    for run in runs("restitution").values():
        assert run["energy drift"] < 1e-11
        assert run["dissipated / start"] > 0.01
        lost = 1 - run["energy at the end / start"]
        assert run["dissipated / start"] == pytest.approx(lost, rel=1e-9)


def test_whip_by_other_schemes_does_not_balance():
    for name in ("Newmark (trapezoidal)", "HHT, alpha = -0.1"):
        assert runs("schemes")[name]["energy drift"] > 1e-3


def test_whip_with_a_tolerance_takes_short_steps_at_impacts_only():
    for run in runs("tolerance").values():
        assert run["longest step"] > 20 * run["shortest step"]
        assert run["energy drift"] < 1e-10
