"""The numbers of demos/belt_drive.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def belt():
    return numbers("belt_drive")


def test_strip_slips_by_the_law_of_the_capstan():
    found = belt()
    for mu, exact in found["capstan, exact"].items():
        assert found["capstan"][mu] == pytest.approx(exact, rel=1e-3)


def test_belt_carries_pull_and_moment_and_creeps():
    found = belt()
    assert found["sum of tensions / pull"] == pytest.approx(1, abs=0.01)
    assert found["difference of tensions / (moment / radius)"] == pytest.approx(1, abs=0.01)
    assert found["creep"] == pytest.approx(found["creep by the tensions"], rel=5e-3)
    # Nodes are 7.5 degrees apart.
    theory = found["angle of slip by the tensions"]
    assert found["angles of slip"] == pytest.approx([theory] * 2, abs=3.75)


def test_belt_keeps_its_balance_while_nodes_come_and_go():
    found = belt()
    assert found["energy drift"] < 1e-12
    assert found["least loss of a row"] >= 0
    assert found["halvings"] == 0
