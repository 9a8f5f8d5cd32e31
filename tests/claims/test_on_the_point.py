"""A step that ends on a critical point is taken in another length, and the point is found."""

import numpy as np
import pytest
from scipy.optimize import brentq

import fx_beam as fb

WAYS = [None, "arc-length"]


def half_circle(turn=0.0):
    return fb.Curve(lambda f: (np.cos(turn + np.pi * f), np.sin(turn + np.pi * f)))


def ring(pressure=4.0, degree=3, turn=0.0):
    """A half ring on two pins under pressure; it buckles at 3 EI / R^3 (Timoshenko)."""
    scene = fb.Scene()
    section = fb.Section(EA=1e6, GA=1e6, EI=1.0)
    arch = scene.add_beam(half_circle(turn), section, elements=16, degree=degree)
    scene.pin(arch.start)
    scene.pin(arch.end)
    scene.add_line_load(arch, pressure, follower=True)
    return scene


def arch_under(load, turn=0.3):
    """A half ring on two pins under a load at its top; it sways to a side."""
    scene = fb.Scene()
    section = fb.Section(EA=1e5, GA=1e5, EI=1.0)
    arch = scene.add_beam(half_circle(turn), section, elements=16, degree=2)
    scene.pin(arch.start)
    scene.pin(arch.end)
    scene.add_force(arch.node(0.5), (load * np.sin(turn), -load * np.cos(turn)))
    return scene


def column(load, turn=0.7):
    """A clamped column aslant under an end load along it."""
    along = np.array([np.cos(turn), np.sin(turn)])
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), along], fb.Section(1e6, 1e6, 1.0), elements=8, degree=3)
    scene.clamp(bar.start)
    scene.add_force(bar.end, tuple(-load * along))
    return scene


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("steps", [4, 19, 20])
def test_a_ring_whose_load_step_ends_at_its_buckling_load(steps, way):
    path = fb.static(ring(), load_steps=steps, continuation=way)
    (point,) = path.critical_points
    assert point.kind == "bifurcation"
    assert point.load_factor == pytest.approx(0.75, abs=1e-6)
    assert path.load_factor[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("digits", [3, 8, 13])
def test_the_last_digits_of_a_pressure_lead_no_ring_to_a_side_branch(digits, way):
    """By some of them no point was found, by others no state behind it."""
    path = fb.static(ring(4 * (1 + digits * 2e-15)), load_steps=20, continuation=way)
    (point,) = path.critical_points
    assert point.load_factor == pytest.approx(0.75, abs=1e-6)
    assert not path.stable[-1]


@pytest.mark.parametrize("apart", [0.0, 1e-13, -1e-11, 1e-9])
def test_a_state_on_the_buckling_load_of_a_ring_is_no_corner_of_its_path(apart):
    critical = 4 * fb.static(ring(degree=2, turn=0.4)).critical_points[0].load_factor
    scene = ring(10 / 7 * critical * (1 + apart), degree=2, turn=0.4)
    path = fb.static(scene, continuation="arc-length")
    assert path.critical_points[0].load_factor == pytest.approx(0.7, abs=2e-6)
    assert not path.stable[-1]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("apart", [0.0, 3e-15, 1e-13, 1e-6])
def test_an_arch_whose_load_step_ends_where_it_sways(apart, way):
    """Its step to a side deviates from the predictor by less than this."""
    known = fb.static(arch_under(9.0), load_steps=23).critical_points[0]
    load = 40 / 31 * 9 * known.load_factor * (1 + apart)
    path = fb.static(arch_under(load), load_steps=40, continuation=way)
    assert path.critical_points[0].kind == "bifurcation"
    assert path.critical_points[0].load_factor == pytest.approx(31 / 40, abs=3e-6)
    assert not path.stable[-1]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("apart", [0.0, 1e-9, -1e-9, 1e-7, -1e-7, 1e-6])
def test_a_column_whose_load_step_ends_at_its_critical_load(apart, way):
    critical = 3.0 * fb.static(column(3.0)).critical_points[0].load_factor
    assert critical == pytest.approx(np.pi**2 / 4, rel=1e-4)
    path = fb.static(column(2 * critical * (1 + apart)), continuation=way)
    (point,) = path.critical_points
    assert point.load_factor == pytest.approx(0.5, abs=1e-6)
    assert (np.diff(path.load_factor) > 0).all() and path.load_factor[-1] == pytest.approx(1.0)
    assert not path.stable[-1]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize(("steps", "size"), [(10, 2.0), (3, 3.0), (4, 4.0)])
def test_round_off_leads_no_column_off_its_path_from_its_critical_load(steps, size, degree, way):
    """One on rotation springs: it bowed to either side without a critical point."""

    def column_on_springs(load):
        along = 2.0 * np.array([np.cos(0.7), np.sin(0.7)])
        scene = fb.Scene()
        section = fb.Section(1e3, 1e3, 1e-3)
        bar = scene.add_beam([(0, 0), along], section, elements=8, degree=degree)
        scene.clamp(bar.start)
        for node in bar.nodes[1:]:
            scene.add_spring(node, rotation=fb.Spring(3e-3))
        scene.add_force(bar.end, tuple(-load / 2 * along))
        return scene

    load = 0.036
    critical = load * fb.static(column_on_springs(load)).critical_points[0].load_factor
    path = fb.static(column_on_springs(size * critical), load_steps=steps, continuation=way)
    assert path.critical_points[0].load_factor == pytest.approx(1 / size, abs=1e-6)
    assert path.critical_points[0].kind == "bifurcation"
    assert path.load_factor[-1] == 1 and not path.stable[-1]


def test_a_shallow_truss_whose_step_ends_at_its_limit_point():
    """Of two springs, by von Mises: P = 2 k (L/l - 1) h has its maximum at load factor 0.5."""
    rise, k = 0.2, 1e3
    rest = np.hypot(1.0, rise)

    def force(h):
        return 2 * k * (rest / np.hypot(1.0, h) - 1) * h

    top = brentq(lambda h: force(h + 1e-7) - force(h - 1e-7), 0.05, 0.15)
    scene = fb.Scene()
    ball = scene.add_body((0, rise), 1.0).centre
    scene.fix(ball, "x", "rotation")
    for x in (-1.0, 1.0):
        scene.add_force_between(ball, (x, 0.0), spring=fb.Spring(k, rest=rest))
    scene.add_force(ball, (0.0, -2 * force(top)))
    path = fb.static(scene, load_steps=10, continuation="arc-length")
    first = path.critical_points[0]
    assert first.kind == "limit point"
    assert first.load_factor == pytest.approx(0.5, abs=1e-7)
    assert path.load_factor[-1] == pytest.approx(1.0)
