"""A strip that is pushed together bows to the side of its side load, however slight both are."""

import math

import pytest

import fx_beam as fb

EULER = math.pi**2


def strip(EA, side, push=0.05, turn=0.0):
    """Hinged, of length 1 and EI = 1; a part `side` of Euler's load acts in the middle."""
    c, s = math.cos(turn), math.sin(turn)
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (c, s)], fb.Section(EA, EA, 1.0), elements=8, degree=3)
    scene.pin(bar.start)
    scene.prescribe(bar.end, x=lambda t: -push * c * t, y=lambda t: -push * s * t)
    scene.add_force(bar.node(0.5), (-s * side * EULER, c * side * EULER))
    return scene, bar


def middle(path, bar, turn=0.0):
    """Displacement of the middle across the strip."""
    x, y = path.displacement(bar.node(0.5))[-1]
    return -math.sin(turn) * x + math.cos(turn) * y


@pytest.mark.parametrize("side", [0.1, -0.1, 0.01, 1e-3])
@pytest.mark.parametrize("EA", [1e5, 1e6])
def test_a_strip_in_one_step_bows_to_the_side_of_its_load(EA, side):
    scene, bar = strip(EA, side)
    path = fb.static(scene, load_steps=1, t=1.0)
    # Of an elastica whose ends come together by 5 %, 0.1397 to 0.1405 with these loads.
    assert middle(path, bar) == pytest.approx(math.copysign(0.140, side), abs=7e-4)
    assert path.stable[-1]


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("EA", [0.99e6, 1e6, 1e7])
def test_a_strip_that_settles_bows_to_the_side_of_its_load_and_says_so(EA, turn, caplog):
    scene, bar = strip(EA, 0.01, turn=turn)
    path = fb.static(scene, t=1.0)
    assert middle(path, bar, turn) == pytest.approx(0.1401, abs=1e-4)
    assert path.load_factor[0] == pytest.approx(0.1)
    assert "follows no small part of its loads" in caplog.text
