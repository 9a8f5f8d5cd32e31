"""The numbers of demos/pull_in.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_equilibria_under_a_magnet_are_those_by_hand_until_they_end():
    found = numbers("pull_in")
    assert found["equilibrium at 0.99"] and not found["equilibrium at 1.01"]
    # The formula is for small deflections: its error is the square of their slope.
    for strength, ratio in found["strength / exact"].items():
        slope = 1.5 * found["deflection / gap"][strength] * 0.02 / 0.25
        assert ratio == pytest.approx(1, abs=1e-5 + slope**2)
    assert 0.28 < found["deflection / gap"]["0.99"] < 1 / 3


def test_frequencies_fall_as_the_magnet_softens_the_strip():
    ratios = numbers("pull_in")["frequency / exact"]
    assert len(ratios) == 7
    for strength, ratio in ratios.items():
        assert ratio == pytest.approx(1, abs=0.01 if strength == "0.99" else 0.003)


def test_a_sudden_field_snaps_the_strip_from_27_32_of_the_strength():
    found = numbers("pull_in")
    assert found["snaps from"] == pytest.approx(27 / 32, abs=2e-3)
    swings, snaps = found["largest deflection / gap"].values()
    assert swings < 0.5 and snaps > 0.9


def test_the_energy_of_magnet_and_stop_is_conserved():
    assert max(numbers("pull_in")["relative energy error"].values()) < 1e-9
