"""The numbers of demos/bars.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["wall", "two bars"])
def test_force_and_duration_are_those_of_the_wave(name):
    for elements, found in numbers("bars")[name].items():
        coarse = int(elements) < 100
        assert found["force"] == pytest.approx(found["exact force"], rel=0.02 if coarse else 5e-4)
        assert found["lasts"] == pytest.approx(found["exact"], rel=0.04 if coarse else 0.01)
        assert found["energy balance"] < 1e-10


def test_two_bars_change_their_velocities_and_one_flies_back_from_a_wall():
    found = numbers("bars")
    for elements, expected in (("25", 0.03), ("400", 0.008)):
        one = {str(key): value for key, value in found["two bars"].items()}[elements]
        assert one["velocities"] == pytest.approx([0.0, 1.0], abs=expected)
        wall = {str(key): value for key, value in found["wall"].items()}[elements]
        assert wall["velocities"] == pytest.approx([1.0], abs=expected)
