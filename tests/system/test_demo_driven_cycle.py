"""The numbers of demos/driven_cycle.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_newtons_method_finds_the_cycle():
    found = numbers("driven_cycle")
    assert found["distance of the states after a cycle"] < 1e-9
    assert found["iterations"] <= 10 and found["stable"]
    assert abs(found["work of the motor over the loss, less 1"]) < 1e-6


def test_a_simulation_decays_to_it_by_the_largest_multiplier():
    found = numbers("driven_cycle")
    assert found["decay of the simulation in a turn"] == pytest.approx(
        found["largest multiplier"], abs=1e-3
    )
    assert found["turns until 1e-9"] > 1000
