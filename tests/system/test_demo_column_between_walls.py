"""The numbers of demos/column_between_walls.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_force_on_the_wall_is_that_of_small_deflections_where_the_walls_are_near():
    found = numbers("column_between_walls")
    wide, middle, narrow = found["difference from the theory"]["force on the wall"].values()
    assert narrow < 5e-4
    # Of second order in the deflection, but for what the springs of the walls give way.
    assert wide / middle > 3.5 and middle / narrow > 2.5


def test_the_column_lies_flat_from_four_times_its_buckling_load_on():
    found = numbers("column_between_walls")
    assert max(found["difference from the theory"]["flat length"].values()) < 3e-3
    assert found["moment in the middle at 4 P1 over that at 2 P1"] < 0.05


def test_the_forces_across_the_column_are_in_balance():
    assert numbers("column_between_walls")["forces across, out of balance"] < 1e-12
