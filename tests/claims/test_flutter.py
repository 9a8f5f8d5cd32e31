"""Loads at which vibrations begin to grow: Pflueger's column and Ziegler's, and their modes."""

import warnings

import numpy as np
import pytest
from scenes import clamped_bar, one_bar, one_body

import fx_beam as fb

SLENDER = 1e6


def column(load, tip_mass, elements, degree):
    """A cantilever with EI = rhoA = L = 1 under a force along its end, which carries a mass."""
    section = fb.Section(EA=SLENDER, GA=SLENDER, EI=1.0, rhoA=1.0, rhoI=1 / SLENDER)
    scene, beam = clamped_bar((0, 1), section, elements, degree)
    if tip_mass:
        scene.add_mass(beam.end, tip_mass)
    scene.add_force(beam.end, (0, -load), follower=True)
    return scene


def flutter_load(load, steps, *sizes):
    point, *_ = fb.static(column(load, *sizes), load_steps=steps).critical_points
    assert point.kind == "flutter"
    return load * point.load_factor


@pytest.mark.parametrize(("tip_mass", "exact"), [(0, 20.05095), (0.5, 16.06156), (2, 16.71679)])
def test_pfluegers_column_flutters_at_its_load(tip_mass, exact):
    # Members that strain and shear by P/EA and P/GA flutter that much before.
    assert flutter_load(24.0, 5, tip_mass, 6, 3) == pytest.approx(exact, rel=2 * 20 / SLENDER)


@pytest.mark.parametrize(("tip_mass", "elements", "degree"), [(0, 8, 3), (0.5, 4, 2), (2, 6, 3)])
def test_the_load_of_flutter_depends_on_neither_steps_nor_loads(tip_mass, elements, degree):
    ways = [(30.0, 7), (22.0, 5), (20.6, 4), (24.0, 1)]
    sizes = tip_mass, elements, degree
    loads = [flutter_load(*way, *sizes) for way in ways]
    assert loads == pytest.approx(loads[:1] * len(ways), rel=1e-8)
    for side, grow in ((-1e-8, 0), (1e-8, 1)):
        path = fb.static(column(loads[0] * (1 + side), *sizes), load_steps=2)
        assert path.unstable_modes[-1] == grow


def test_each_of_many_paths_finds_the_point_and_its_mode():
    """At the double root K - w^2 M is singular but for round-off, and on some paths exactly."""
    section = fb.Section(EA=1e5, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)
    loads, shapes = [], []
    for load in np.linspace(20.0, 28.0, 41):
        scene, beam = one_bar((np.cos(0.7), np.sin(0.7)), section, 5, 2)
        scene.add_joint(fb.Revolute(fb.GROUND, beam.start, spring=fb.Spring(20.0)))
        scene.add_mass(beam.end, 0.1)
        scene.add_force(beam.end, (-load * np.cos(0.7), -load * np.sin(0.7)), follower=True)
        (point,) = fb.static(scene, load_steps=3).critical_points
        assert point.kind == "flutter"
        loads.append(load * point.load_factor)
        turns = point.modes.shapes[:, :, 2]
        shapes.append(turns / abs(turns).max())
    assert loads == pytest.approx(loads[:1] * 41, rel=1e-8)
    assert np.array(shapes) == pytest.approx(np.array(shapes[:1] * 41), abs=1e-3)


def test_two_equal_columns_flutter_at_one_point_with_two_modes():
    scene = column(24.0, 0.5, 4, 2)
    other = scene.add_beam([(1, 0), (1, 1)], scene.beams[0].section, 4, 2)
    scene.clamp(other.start)
    scene.add_mass(other.end, 0.5)
    scene.add_force(other.end, (0, -24.0), follower=True)
    (point,) = fb.static(scene, load_steps=4).critical_points
    assert 24 * point.load_factor == pytest.approx(flutter_load(24.0, 4, 0.5, 4, 2), rel=1e-8)
    tops = [beam.end.number for beam in scene.beams]
    across = point.modes.shapes[:, tops, 0]
    assert abs(np.linalg.det(across / abs(across).max())) > 0.1


def ziegler(load, dampers=(0.0, 0.0)):
    """Two light rods of 1 m with 2 kg and 1 kg at their ends, hinges of 1 N m, and a follower."""
    scene, one = one_body((1, 0), 2.0, 1e-12, points={"O": (0, 0), "A": (1, 0)})
    two = scene.add_body((2, 0), 1.0, 1e-12, points={"A": (1, 0)})
    laws = [{"spring": fb.Spring(1.0), "damper": fb.Damper(b) if b else None} for b in dampers]
    scene.add_joint(fb.Revolute(fb.GROUND, one["O"], **laws[0]))
    scene.add_joint(fb.Revolute(one["A"], two["A"], **laws[1]))
    scene.add_force(two.centre, (-load, 0), follower=True)
    return scene


def test_zieglers_column_flutters_between_two_loads_and_then_diverges():
    """Two rods, 2 kg and 1 kg at their ends: flutter for |P L/c - 7/2| < sqrt(2)."""
    path = fb.static(ziegler(6.0), load_steps=10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first, second = path.critical_points
    loads = [6 * point.load_factor for point in (first, second)]
    assert loads == pytest.approx([3.5 - np.sqrt(2), 3.5 + np.sqrt(2)], rel=1e-8)
    # det(K - w^2 M) = 2 w^4 - (7 - 2 P) w^2 + 1 has a double root there.
    assert first.modes.angular_frequencies**2 == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert second.modes.unstable.all()
    assert second.modes.eigenvalues**2 == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert path.unstable_modes[-1] == 2
