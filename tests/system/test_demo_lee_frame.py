"""The numbers of demos/lee_frame.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_lee_frame_has_the_limit_loads_of_the_literature_and_of_shooting():
    found = numbers("lee_frame")
    shot = found["limit loads by shooting"]
    assert 18.5e3 < shot[0] < 18.6e3 and -9.5e3 < shot[1] < -9.3e3
    for name, loads in found["limit loads"].items():
        assert len(loads) == 2, name
        if name != "degree 1, 10 elements":
            assert loads == pytest.approx(shot, rel=0.015), name
    assert found["limit loads"]["degree 2, 20 elements"] == pytest.approx(shot, rel=2e-5)
    assert found["limit loads"]["degree 3, 10 elements"] == pytest.approx(shot, rel=1e-6)


def test_lee_frame_snaps_back_and_is_followed_to_its_full_load():
    found = numbers("lee_frame")
    assert found["load at the end"] == 20e3
    assert found["largest way back of the loaded point"] > 5
    assert found["steps"] < 60
    assert 0.99 < found["load steps alone end at"] / found["limit loads by shooting"][0] < 1
