"""The numbers of demos/bow.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_draw_curve_is_that_of_the_elastica():
    bow = numbers("bow")
    assert bow["tension, strung [N]"] == pytest.approx(bow["of the elastica [N]"], rel=1e-3)
    assert bow["largest error of the draw curve"] < 1e-3
    assert bow["largest error of the tension"] < 1e-3
    assert bow["area under the draw curve / work"] == pytest.approx(1, abs=1e-3)


def test_heavier_arrows_take_more_of_the_work_of_the_draw():
    shots = numbers("bow")["shots"]
    shares = [shots[f"{grams} g"]["efficiency"] for grams in (10, 20, 40)]
    assert 0.3 < shares[0] < shares[1] < shares[2] < 0.9
    speeds = [shots[f"{grams} g"]["speed [m/s]"] for grams in (10, 20, 40)]
    assert speeds[0] > speeds[1] > speeds[2]


def test_a_bow_without_much_mass_gives_all_its_work_to_the_arrow():
    assert numbers("bow")["light limbs"]["efficiency"] == pytest.approx(1, abs=2e-3)


def test_the_energy_balance_closes_though_the_arrow_leaves():
    bow = numbers("bow")
    for shot in (*bow["shots"].values(), bow["light limbs"]):
        assert shot["balance error"] < 1e-11
        assert 5 < shot["it leaves at [ms]"] < 25
