"""The numbers of demos/slider_crank.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def slider_crank():
    return numbers("slider_crank")["steps"]["dt 0.0005"]


def test_slider_crank_motor_does_the_work_that_is_gained():
    run = slider_crank()
    assert run["halvings"] == 0 and run["energy at the end"] > 1
    assert run["relative balance error"] < 1e-9
    assert run["relative error of motor work"] < 1e-9
    assert run["largest gap"] < 1e-12


def test_slider_crank_that_is_nearly_rigid_is_the_rigid_mechanism():
    near = numbers("slider_crank")["nearly rigid"]
    assert near["slider"] < 1e-6
    assert near["motor moment"] < 1e-3


def test_slider_crank_bends_and_its_slider_is_a_little_off():
    run = slider_crank()
    assert 0.004 < run["largest deflection of the rod"] < 0.007
    assert 0.0005 < run["slider off the rigid mechanism"] < 0.0012
