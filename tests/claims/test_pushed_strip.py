"""A strip that is pushed together bows to the side of its side load, however slight both are."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

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
def test_ten_steps_bend_a_strip_to_the_side_of_its_load_with_all_rows_before(EA, turn, caplog):
    """It bends sharply at Euler's load, at a load factor of 2e-4 or less."""
    scene, bar = strip(EA, 0.01, turn=turn)
    path = fb.static(scene, t=1.0)
    assert middle(path, bar, turn) == pytest.approx(0.1401, abs=1e-4)
    assert path.load_factor[0] == 0.0
    assert (np.diff(path.load_factor) > 0).all()
    assert path.stable.all()
    assert not caplog.text


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_strip_that_settles_bows_to_the_side_of_its_load_and_says_so(turn, caplog):
    scene, bar = strip(1e7, 0.01, turn=turn)
    path = fb.static(scene, t=1.0, continuation="arc-length")
    assert middle(path, bar, turn) == pytest.approx(0.1401, abs=1e-4)
    assert path.load_factor[0] == pytest.approx(0.1)
    assert "follows no small part of its loads" in caplog.text


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_no_step_goes_on_straight_where_the_side_load_is_2e_7_of_eulers(turn):
    """As it is at the buckling load. A straight row with two unstable modes came first."""
    scene, bar = strip(1e7, 0.01, turn=turn)
    path = fb.static(scene, load_steps=100, t=1.0)
    assert middle(path, bar, turn) == pytest.approx(0.1401, abs=1e-4)
    assert path.stable.all()


@pytest.mark.parametrize("side", [1e-3, 1e-4])
def test_a_path_that_is_lost_where_it_is_unstable_names_ways_to_the_stable_one(side):
    """Of them fewer load steps. It named limit points and more steps."""
    scene, bar = strip(1e7, side)
    with pytest.raises(
        fb.StepError, match="points.0..branch.*unstable before it.*Fewer load steps"
    ):
        fb.static(scene, load_steps=100, t=1.0)
    path = fb.static(scene, t=1.0)
    assert middle(path, bar) == pytest.approx(0.140, abs=7e-4)
    assert path.stable[-1]


def elastica(EA, side, push):
    """Middle and push of the strip, by Reissner's equations of its left half, by shooting."""

    def rates(s, y, P):
        x, w, turn, moment = y
        c, d, F = math.cos(turn), math.sin(turn), side * EULER / 2
        stretch, shear = 1 + (F * d - P * c) / EA, (F * c + P * d) / EA
        along, across = stretch * c - shear * d, stretch * d + shear * c
        return [along, across, moment, -along * F - across * P]

    def end(guess):
        start = [0, 0, guess[1], 0]
        half = solve_ivp(rates, (0, 0.5), start, args=(guess[0],), rtol=1e-9, atol=1e-11)
        return half.y[:, -1]

    def missing(guess):
        x, _, turn, _ = end(guess)
        return [x - (1 - push) / 2, turn]

    P, start = fsolve(missing, (EULER, 2 * math.sqrt(push)), xtol=1e-10)
    return end((P, start))[1], P


@pytest.mark.parametrize("steps", [1, 10, 100])
@pytest.mark.parametrize(
    ("EA", "side"),
    [(1e3, 1e-6), (1e3, -1e-3), (1e4, 1e-6), (1e4, 0.1), (1e5, 1e-4), (1e5, -0.01), (1e6, 0.1)],
)
def test_a_pushed_strip_is_an_elastica_on_the_side_of_its_load(EA, side, steps):
    scene, bar = strip(EA, side, push=0.1)
    path = fb.static(scene, load_steps=steps, t=1.0)
    across, push = elastica(EA, abs(side), 0.1)
    assert middle(path, bar) == pytest.approx(math.copysign(across, side), rel=1e-4)
    assert abs(path.reaction(bar.end)[-1, 0]) == pytest.approx(push, rel=2e-4)
    assert path.stable[-1]
