"""The numbers of demos/ring.py."""

import numpy as np
import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("degree", "meshes", "tolerance", "order"), [(1, (32, 64), 0.04, 2), (2, (16, 32), 2e-3, 4)]
)
def test_ring_has_the_exact_frequencies_with_the_order_of_its_elements(
    degree, meshes, tolerance, order
):
    coarse, fine = (numbers("ring")["meshes"][f"degree {degree}, {n} elements"] for n in meshes)
    for found in (coarse, fine):
        assert found["rigid modes"] == 3
        assert found["largest split of a pair"] < 1e-6
    errors = abs(np.array([found["relative errors"] for found in (coarse, fine)]))
    assert errors[1].max() < tolerance
    assert (np.log2(errors[0] / errors[1]) > order - 0.3).all()


def test_ring_of_cubic_elements_has_the_frequencies_to_a_ten_thousandth():
    errors = numbers("ring")["meshes"]["degree 3, 24 elements"]["relative errors"]
    assert max(map(abs, errors)) < 1e-4


def test_ring_that_is_thin_hardly_stretches():
    found = numbers("ring")
    assert found["exact"] == pytest.approx(found["inextensional"], rel=5e-4)


@pytest.mark.parametrize("dt", [2e-3, 1e-3])
def test_ring_keeps_energy_and_momenta_in_flight(dt):
    run = numbers("ring")["schemes"]["EnergyMomentum"][f"dt {dt:g}"]
    assert run["failure"] is None and run["steps"] == round(1 / dt)
    assert run["energy drift"] < 1e-11
    assert run["angular momentum drift"] < 1e-11
    assert run["linear momentum drift"] < 1e-11


def test_ring_is_squeezed_far_and_other_schemes_gain_or_lose_energy_by_it():
    found = numbers("ring")
    assert found["diameter"][0] < 0.6 and found["diameter"][1] > 1.2
    newmark, hht = (found["schemes"][name]["dt 0.002"] for name in ("Newmark", "HHT"))
    assert newmark["failed at"] < 1 and newmark["highest energy ratio"] > 10
    assert hht["failure"] is None and hht["lowest energy ratio"] < 0.99
