"""The numbers of demos/shallow_arch.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_arches_snap_and_sway_near_the_loads_of_shallow_arch_theory():
    found = numbers("shallow_arch")
    for name, loads in found["loads"].items():
        limit, sway = found["theory"][name]
        assert loads["limit point"] == pytest.approx(limit, rel=4e-4), name
        assert loads["bifurcation"] == (None if sway is None else pytest.approx(sway, rel=4e-4))
    assert list(found["first"].values()) == ["limit point", "limit point", "bifurcation"]


def test_the_sway_branch_has_the_thrust_of_a_column_with_two_half_waves():
    found = numbers("shallow_arch")
    assert found["branches"] == 4 and found["stable rows of branches"] == 0
    assert found["largest v"] == pytest.approx(found["largest v by theory"], rel=4e-3)
    assert found["error of v^2"] < 0.006
