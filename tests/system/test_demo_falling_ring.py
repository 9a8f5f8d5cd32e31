"""The numbers of demos/falling_ring.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow

every_run = pytest.mark.parametrize("e", ["1", "0.7", "0"])


def ring(e):
    return numbers("falling_ring")[f"e = {e}"]


@every_run
def test_ring_keeps_its_balances_over_all_bounces(e):
    run = ring(e)
    assert run["bounces"] >= 3
    assert run["energy drift"] < 1e-11
    assert run["momentum along the plane"] < 1e-11
    assert abs(run["impulse minus momentum"]) < 1e-10
    assert run["halvings"] == 0


def test_ring_turns_a_part_of_its_fall_into_vibration():
    run = ring("1")
    rise, vibration = (
        run["heights of the first bounces / fall"][0],
        run["vibration after the first bounce / fall"],
    )
    assert run["dissipated / fall"] == 0
    assert rise + vibration == pytest.approx(1, abs=2e-3)
    assert 0.1 < vibration < 0.4


@pytest.mark.parametrize("e", ["0.7", "0"])
def test_ring_bounces_although_its_nodes_hardly_do(e):
    run = ring(e)
    assert run["dissipated / fall"] > 0.3
    assert 0.4 < run["heights of the first bounces / fall"][0] < 0.8
    assert run["depth in the plane at the most"] < 0.02
