"""The numbers of demos/gripper.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_least_friction_by_trials_is_that_of_the_forces_in_a_lift():
    found = numbers("gripper")
    apart = found["least friction, by trials"] - found["least friction, by the forces"]
    assert abs(apart) < 2 * found["between two trials"]


def test_the_fingers_carry_the_weight_and_press_as_bent_strips_do():
    found = numbers("gripper")
    assert found["force of the fingers at rest"] == pytest.approx(found["weight"], rel=1e-3)
    small = found["the same for small rotations"]
    assert found["normal force of a finger"] == pytest.approx(small, rel=0.03)
    assert found["rise of the disc"] == pytest.approx(0.1, rel=2e-3)
    assert found["energy balance"] < 1e-10
