"""The numbers of the demos whose steps dolfinx and PETSc take."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from demo_runs import drawn
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow


# -- in_dolfinx


def test_a_step_by_hand_is_that_of_the_problem(in_dolfinx):
    assert in_dolfinx["by hand less PETSc / largest displacement"] < 1e-11
    assert in_dolfinx["unknowns"] == in_dolfinx["degrees of freedom"] - 2
    # Newton's method converges quadratically: digits double.
    *_, third, fourth, fifth = np.log10(in_dolfinx["corrections by hand"])
    assert fourth < 1.8 * third and fifth < -10


def test_a_motion_by_dolfinx_is_that_of_the_engine_with_each_form(in_dolfinx):
    forms = demo("in_dolfinx").FORMS
    for name in forms:
        run = in_dolfinx[name]
        assert run["largest difference from the engine / length"] < 1e-9
        assert run["relative difference of energies"] < 1e-10
        assert run["angular momentum drift"] < 1e-11


def test_the_divisor_of_the_paper_takes_most_of_the_drift_of_the_energy(in_dolfinx):
    without, published, exact = (
        in_dolfinx[name]["energy drift"]
        for name in ("m without divisor", "as published", "EnergyMomentum")
    )
    assert exact < 1e-11 < published < 0.2 * without < 1e-3


@pytest.mark.usefixtures("in_dolfinx")
def test_the_motion_is_a_file_with_a_grid_for_each_step():
    file = drawn("in_dolfinx") / "motion.xdmf"
    times = [float(time.get("Value")) for time in ET.parse(file).iter("Time")]
    assert times == approx(np.linspace(0, 1.4, 141))


# -- heated_strip


def test_the_strip_snaps_away_and_returns_again_and_again(heated_strip):
    assert heated_strip["snaps"] >= 3
    assert heated_strip["snaps"] - heated_strip["returns"] in (0, 1)
    low, high = heated_strip["lowest and highest [mm]"]
    assert low == approx(-0.6, abs=0.1) and 0.5 < high < 1.5
    assert 0.4 < heated_strip["seconds from snap to snap"] < 0.9


def test_heat_conducted_on_the_mesh_of_a_beam_has_the_closed_form(heated_strip):
    assert heated_strip["steady temperature, relative error"] < 0.02
    assert heated_strip["balance of energy, relative"] < 1e-9


# -- damaged_beam


def test_moments_of_a_damaged_arc_are_those_of_the_law(damaged_beam):
    turned = damaged_beam["turned"]
    assert turned["relative error of moments"] < 1e-12
    assert turned["lost energy"] == approx(turned["closed form, by the same steps"], rel=1e-12)
    assert turned["lost energy"] > 1.0


def test_a_damaged_cantilever_goes_to_its_elastica_with_the_square_of_the_mesh(damaged_beam):
    coarse, middle, fine = damaged_beam["pulled"]["distance from it"].values()
    assert coarse / middle == approx(4, rel=0.1) and middle / fine == approx(4, rel=0.15)
    assert fine < 2e-4


# -- own_form


def test_a_form_and_an_arc_length_of_ones_own_meet_the_closed_form(own_form):
    assert own_form["past both limit points"]
    for what in ("force", "engine", "energy"):
        assert own_form[f"{what} less closed form, relative"] < 1e-11
    limit = own_form["limit point by fb.static [N]"]
    assert limit == approx(own_form["largest force, closed form [N]"], rel=1e-8)
