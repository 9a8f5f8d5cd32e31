"""The numbers of demos/lattice_impact.py, for a lattice of 30 x 30 cells."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_lattice_keeps_the_energy_and_the_momentum_of_the_blow():
    found = numbers("lattice_impact")
    assert found["struts"] == 2 * 30 * 31
    assert found["solver"].endswith("kept over several steps")
    assert found["relative error of the energy"] < 1e-10
    assert found["momentum / impulse"] == pytest.approx(1, abs=1e-10)


def test_wave_runs_along_the_rows_at_the_speed_by_hand_and_never_faster_than_in_a_bar():
    found = numbers("lattice_impact")
    assert found["speed / c of the peak"] == pytest.approx(0.5**0.5, rel=0.05)
    assert 0.5 < found["fastest front / c"] < 1


def test_lattice_moves_as_its_mirror_image():
    assert numbers("lattice_impact")["asymmetry"] < 1e-8


def test_energies_of_the_struts_by_hand_are_the_strain_energy():
    found = numbers("lattice_impact")
    assert found["strain energy / sum over struts"] == pytest.approx(1, abs=1e-10)
