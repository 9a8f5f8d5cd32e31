"""The numbers of demos/pd_arm.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_pd_control_of_the_joint_brings_the_tip_to_rest_and_a_given_angle_does_not():
    found = numbers("pd_arm")
    assert found["tip off its goal in the last second"] < 1e-5
    assert found["the same with a given angle"] > 0.1


def test_the_tip_decays_about_as_fast_as_the_slowest_root_of_the_linearised_arm():
    found = numbers("pd_arm")
    assert found["decay of the tip"] == pytest.approx(found["slowest root by linearise"], rel=0.2)


def test_the_work_of_torque_and_motor_is_in_the_energy_balance():
    assert numbers("pd_arm")["largest energy error"] < 1e-11
