"""The numbers of demos/three_bar_swing.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def swing(scheme, dt=5e-4):
    return numbers("three_bar_swing")["schemes"][scheme][f"dt {dt:g}"]


@pytest.mark.parametrize(("elements", "tolerance"), [(4, 2e-3), (16, 5e-4)])
def test_swing_moves_as_the_reference_up_to_the_reversal(elements, tolerance):
    found = numbers("three_bar_swing")["reference"][f"{elements} elements"]
    assert found["largest difference"] < tolerance


@pytest.mark.parametrize(("elements", "time"), [(4, 0.6390), (16, 0.6396)])
def test_swing_right_link_turns_back_when_the_reference_has_it(elements, time):
    found = numbers("three_bar_swing")["reversal"][f"{elements} elements"]
    assert found == pytest.approx(time, abs=5e-4)


@pytest.mark.parametrize("dt", [1e-3, 5e-4, 2.5e-4])
def test_swing_keeps_its_energy_through_the_reversal(dt):
    run = swing("EnergyMomentum", dt)
    assert run["failure"] is None and run["halvings"] == 0
    assert run["energy after the pulse"] == pytest.approx(0.06389, rel=1e-3)
    assert run["energy drift"] < 1e-10
    assert run["reversal"] == pytest.approx(0.639, abs=2e-3)


def test_swing_largest_axial_force_is_that_of_the_reversal():
    run = swing("EnergyMomentum")
    assert run["largest axial force"] == pytest.approx(142, rel=0.03)
    assert run["time of the largest axial force"] == pytest.approx(0.6406, abs=2e-3)


def test_swing_axial_force_varies_along_the_beam_and_is_not_the_links():
    forces = numbers("three_bar_swing")["axial force at the peak of the pulse"]
    low, high = forces["beam"]
    # The mass is pushed to the right: the half before it is pulled, that behind it pressed.
    assert low < -0.02 < forces["left link"] < 0 < 0.01 < high


def test_swing_links_with_mass_turn_back_later_and_with_less_force():
    heavy = numbers("three_bar_swing")["links with the beam's mass per length"]
    assert heavy["reversal"] == pytest.approx(0.645, abs=1e-3)
    assert heavy["largest axial force"] == pytest.approx(88, rel=0.03)
    assert heavy["energy drift"] < 1e-10


def test_swing_other_schemes_lose_energy_in_the_reversal():
    for scheme in ("Newmark (trapezoidal)", "HHT, alpha = -0.1"):
        assert swing(scheme)["lowest energy ratio"] < 0.95
    assert 1e-8 < swing("ModifiedMidPoint (as published)")["energy drift"] < 1e-4
