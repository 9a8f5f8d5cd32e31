"""The numbers of demos/plasticity.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_loops_of_the_bar_are_exact():
    for bar in numbers("plasticity")["bar"].values():
        assert bar["error of the moment"] < 1e-12
        assert bar["least loss of a step"] >= 0


def test_the_frame_carries_its_limit_load():
    found = numbers("plasticity")["frame"]
    over = {int(count): run["relative to limit"] - 1 for count, run in found.items()}
    for count, excess in over.items():
        # Hinges are in the middle of elements; the small hardening adds less than 1 %.
        assert 0.8 / count < excess < 1.4 / count + 0.01
    assert over[80] < over[40] < over[20]
    assert 2 * over[80] - over[40] == pytest.approx(0, abs=0.01)
    assert all(run["relative balance error"] < 1e-11 for run in found.values())


def test_the_frame_on_hinges_carries_its_limit_load_without_mesh_error():
    found = numbers("plasticity")["frame on hinges"]
    # What is left is of second order in the displacements.
    assert abs(found["1"]["relative to limit"] - 1) < 4e-3
    assert abs(found["10"]["relative to limit"] - 1) < 4e-4
    for run in found.values():
        assert run["relative balance error"] < 1e-11
        foot, left, middle, right, other = run["plastic angles"]
        assert foot < 0 < middle and right < 0 < other
        assert abs(left) < 1e-12  # the left corner has no hinge in the mechanism


def test_the_ring_stays_bent():
    ring = numbers("plasticity")["ring"]
    low, high = ring["plastic curvatures"]
    assert low < -3 and high > 3
    assert 0.9 < ring["dissipated"] < 1
    assert ring["least loss of a step"] > -1e-12
    assert ring["relative balance error"] < 1e-11
