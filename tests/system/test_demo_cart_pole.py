"""The numbers of demos/cart_pole.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_pole_falls_without_control_and_is_kept_upright_with_it():
    found = numbers("cart_pole")
    assert not found["none"]["kept upright"]
    assert found["flexible pole"]["kept upright"]
    assert found["flexible pole"]["cart off the goal at the end"] < 1e-3
    assert found["flexible pole"]["tip off the cart at the end"] < 1e-3


def test_gains_for_a_rigid_pole_leave_it_vibrating():
    found = numbers("cart_pole")
    assert found["rigid pole"]["bending in the last second"] > 0.02
    assert found["flexible pole"]["bending in the last second"] < 1e-3


def test_the_work_of_the_push_is_in_the_energy_balance():
    found = numbers("cart_pole")
    assert max(found[name]["largest energy error"] for name in ("flexible pole", "none")) < 1e-11
