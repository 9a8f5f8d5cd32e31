"""The numbers of demos/andrews.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_andrews_angles_are_the_published_ones_to_nine_digits():
    run = numbers("andrews")["order 4"]["1600"]
    assert run["unknowns"] == 1
    assert run["largest relative error of an angle"] < 2e-9
    assert run["largest error of a speed"] < 2e-3


def test_andrews_loops_are_closed_and_its_moment_does_the_work():
    for runs in numbers("andrews").values():
        for run in runs.values():
            assert run["largest gap"] < 1e-14
            assert run["relative balance error"] < 2e-9
