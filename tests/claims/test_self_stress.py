"""What is drawn under tension presses other parts: both sides count in all linear analyses."""

import math

import numpy as np
import pytest
from scenes import assert_refused

import fx_beam as fb

K, H, T = 50.0, 2.0, 20.0
KINDS = ["line", "rope", "joint"]


def strut(below, load=(0.0, 0.0), taut=True, kind="line"):
    """A stiff hinged bar of height H, with a side spring; its top is pulled to a place below it."""
    scene = fb.Scene()
    section = fb.Section(EA=1e7, GA=1e7, EI=1e6, rhoA=1.0)
    bar = scene.add_beam([(0, 0), (0, H)], section, elements=2, degree=3)
    scene.pin(bar.start)
    scene.add_spring(bar.end, x=fb.Spring(K))
    length, spring = H + below, fb.Spring(10.0, rest=H + below - T / 10.0)
    if taut and kind == "line":
        scene.add_force_between(bar.end, (0, -below), spring)
    elif taut and kind == "rope":
        scene.add_rope([bar.end, (0, -below)], fb.Spring(10.0), length=length - T / 10.0)
    elif taut:  # a rod that telescopes on a hinge, and has no weight
        foot, head = (scene.add_body(place, 0.0).centre for place in ((0, -below), (0, H)))
        scene.add_joint(fb.Revolute(fb.GROUND, foot))
        scene.add_joint(fb.Revolute(bar.end, head))
        law = spring
        scene.add_joint(fb.Prismatic(foot, head, axis=(0, 1), spring=law))
    if any(load):
        scene.add_force(bar.end, load)
    return scene, bar


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("below", [0.0, 0.5, 3.0, -0.5])
def test_a_taut_tie_stiffens_a_strut_by_no_more_than_its_place_below_the_hinge(below, kind):
    """The moment of T about the hinge at a small turn: T b H / (H + b), against the side spring."""
    stiffness = K - T * below / (H + below) / H
    moved, bar = strut(below, (1e-3, 0.0), kind=kind)
    sway = fb.static(moved, linear=True).displacement(bar.end)[-1, 0]
    assert 1e-3 / sway == pytest.approx(stiffness, rel=2e-5)
    pressed, _ = strut(below, (0.0, -1.0), kind=kind)
    factor = fb.buckling(pressed, n=1).load_factors[0]
    assert factor == pytest.approx(stiffness * H, rel=1e-4)
    scene, _ = strut(below, kind=kind)
    square = stiffness / (H / 3)
    system = fb.linearise(scene)
    assert min(abs(np.linalg.eigvals(system.A))) ** 2 == pytest.approx(square, rel=1e-4)
    assert fb.modes(scene, n=1).angular_frequencies[0] ** 2 == pytest.approx(square, rel=1e-4)


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("kind", KINDS[:2])
def test_stays_press_their_mast(kind, turn):
    """Two stays at the foot's level, with T each: Euler's load less what they press."""
    EI, L, B, tension, load = 100.0, 4.0, 2.0, 10.0, 10.0
    c, s = math.cos(turn), math.sin(turn)
    turned = np.array([[c, -s], [s, c]])
    chord = math.hypot(L, B)
    scene = fb.Scene()
    section = fb.Section(EA=1e7, GA=1e7, EI=EI)
    mast = scene.add_beam([(0, 0), turned @ (0, L)], section, elements=8, degree=3)
    scene.pin(mast.start)
    for x in (-B, B):
        place = tuple(turned @ (x, 0.0))
        if kind == "line":
            spring = fb.Spring(50.0, rest=chord - tension / 50.0)
            scene.add_force_between(mast.end, place, spring)
        else:
            scene.add_rope([mast.end, place], fb.Spring(50.0), length=chord - tension / 50.0)
    scene.add_force(mast.end, tuple(turned @ (0.0, -load)))
    exact = (math.pi**2 * EI / L**2 - 2 * tension * L / chord) / load
    assert fb.buckling(scene, n=1).load_factors[0] == pytest.approx(exact, rel=5e-4)


def test_the_first_row_of_first_order_is_the_equilibrium_without_loads():
    scene, bar = strut(0.5, (0.0, -1.0))
    rows = fb.static(scene, linear=True)
    free, top = strut(0.5)
    settled = fb.static(free).displacement(top.end)[-1]
    assert rows.displacement(bar.end)[0] == pytest.approx(settled, abs=1e-12)
    assert abs(rows.energy.balance_error).max() < 1e-9 * rows.energy.springs.max()


def test_ties_that_press_a_strut_beyond_its_load_are_refused():
    """The strut is no equilibrium any more, as H K < T b / (H + b)."""
    scene, _ = strut(0.5, (0.0, -1.0))
    bar = scene.beams[0]
    scene.add_force_between(bar.end, (0, -1e3), fb.Spring(1.0, rest=1e3 + H - 150.0))
    assert_refused("springs are under tension|no stable equilibrium", fb.buckling, scene)
