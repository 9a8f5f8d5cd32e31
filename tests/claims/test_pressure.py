"""Pressure on beams: its work is that of the area, rings buckle at 3 EI / R^3, closed forms."""

import pickle

import numpy as np
import pytest
from scenes import clamped_bar, one_bar
from scipy.integrate import solve_ivp

import fx_beam as fb

SECTION = fb.Section(EA=3e3, GA=2e3, EI=2.0, rhoA=1.0, rhoI=1e-2)


def polygon(scene):
    """A free ring as a closed polygon of two beams, seen anticlockwise: to the left is inside."""
    angles = 2 * np.pi * np.arange(13) / 12
    points = [*zip(np.cos(angles), 0.7 * np.sin(angles), strict=True)]
    one = scene.add_beam(points[:7], SECTION, elements=[1] * 6)
    two = scene.add_beam([one.end, *points[7:-1], one.start], SECTION, [1] * 6)
    return one, two


def areas(solution, beams):
    """Areas (n,) within closed polygons of nodes."""
    nodes = [node for beam in beams for node in beam.nodes[:-1]]
    x, y = np.stack([solution.position(node) for node in nodes], axis=1).T
    return (x * np.roll(y, -1, axis=0) - np.roll(x, -1, axis=0) * y).sum(axis=0) / 2


@pytest.mark.parametrize("scheme", [None, fb.EnergyDecaying(), fb.MidPoint()])
def test_the_work_on_a_closed_curve_is_pressure_times_the_change_of_area(scheme):
    p, scene = -40.0, fb.Scene()
    beams = polygon(scene)
    for beam in beams:
        scene.add_line_load(beam, p, follower=True)
    scene.set_velocity(beams[0], lambda x, y: (3.0 * y, x * y))
    motion = fb.simulate(scene, scheme, dt=5e-3, t_end=1.0)
    area = areas(motion, beams)
    assert np.ptp(area) > 0.1
    assert motion.energy.work == pytest.approx(-p * (area - area[0]), abs=1e-12)
    if scheme is None:
        assert abs(motion.energy.balance_error).max() < 1e-11
    # A pressure has no resultant on a closed curve.
    assert np.ptp(motion.linear_momentum, axis=0).max() < 1e-11
    assert np.ptp(motion.angular_momentum) < 1e-11


def test_in_time_it_is_the_pressure_in_the_middle_of_the_step():
    scene = fb.Scene()
    beams = polygon(scene)
    p = lambda t: 60 * np.sin(9 * t)  # noqa: E731
    for beam in beams:
        scene.add_line_load(beam, p, follower=True)
    motion = fb.simulate(scene, dt=5e-3, t_end=1.0)
    middle = (motion.t[1:] + motion.t[:-1]) / 2
    work = np.append(0.0, np.cumsum(-p(middle) * np.diff(areas(motion, beams))))
    assert motion.energy.work == pytest.approx(work, abs=1e-13 * abs(work).max())
    assert abs(motion.energy.balance_error).max() < 1e-13 * abs(work).max()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_on_an_open_beam_the_work_is_that_of_the_area_it_sweeps(degree):
    scene, beam = clamped_bar((1, 0), SECTION, elements=3, degree=degree)
    scene.add_line_load(beam, 8.0, follower=True)
    motion = fb.simulate(scene, dt=0.01, t_end=1.0)
    if degree == 1:
        places = np.stack([motion.position(node) for node in beam.nodes], axis=1)
        middle = (places[1:] + places[:-1]) / 2
        along, moved = np.diff(middle, axis=1), np.diff(places, axis=0)
        moved = (moved[:, 1:] + moved[:, :-1]) / 2
        swept = (along[..., 0] * moved[..., 1] - along[..., 1] * moved[..., 0]).sum(axis=1)
        work = np.append(0, 8.0 * np.cumsum(swept))
        assert motion.energy.work == pytest.approx(work, abs=1e-12)
    assert motion.energy.work.max() > 1.0
    assert abs(motion.energy.balance_error).max() < 1e-12


def quarter_ring(add):
    """A quarter of a ring that keeps both axes of symmetry, and its path under a load."""
    stiff = fb.Section(EA=1e7, GA=1e7, EI=2.0)
    ends = (1, 0), (np.sqrt(0.5), np.sqrt(0.5)), (0, 1)
    scene, arc = one_bar(fb.arc(*ends), stiff, elements=8, degree=3)
    scene.fix(arc.start, "y", "rotation")
    scene.fix(arc.end, "x", "rotation")
    add(scene, arc)
    return fb.static(scene, load_steps=10)


def test_a_ring_buckles_at_three_EI_over_R_cubed_under_pressure():  # noqa: N802
    """Levy 1884; under a load that keeps its direction at 4 EI / R^3 (Timoshenko and Gere 7.3)."""

    def pressure(scene, arc):
        scene.add_line_load(arc, 11.0, follower=True)

    def dead(scene, arc):
        scene.add_line_load(arc, lambda s: (-11 * np.cos(s), -11 * np.sin(s)), of="arc length")

    (follows,) = quarter_ring(pressure).critical_points
    (keeps,) = quarter_ring(dead).critical_points
    assert 11 * follows.load_factor == pytest.approx(3 * 2.0, rel=2e-5)
    assert 11 * keeps.load_factor == pytest.approx(4 * 2.0, rel=2e-5)
    assert follows.kind == keeps.kind == "bifurcation"


def cantilever(p, elements=16, section=None, mirrored=False):
    scene = fb.Scene()
    section = section or fb.Section(EA=1e7, GA=1e7, EI=2.0)
    points = [(0, 0), (1, 0)]
    beam = scene.add_beam(points[::-1] if mirrored else points, section, elements, degree=2)
    scene.clamp(beam.end if mirrored else beam.start)
    load = scene.add_line_load(beam, -p if mirrored else p, follower=True)
    return scene, beam, load


def rolled_up(p):
    """Tip (2,) and rotation of the elastica, from its free end, where no force is."""

    def slopes(s, y):  # x, y, angle, curvature, backwards from the tip
        x, y_, angle, kappa = y
        c, si = np.cos(angle), np.sin(angle)
        n = -p * y_ * -1.0, p * x * -1.0  # n = p W (phi(tip) - phi), with phi(tip) = 0
        return -c, -si, -kappa, (c * n[1] - si * n[0]) / 2.0

    end = solve_ivp(slopes, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-13).y[:, -1]
    c, s = np.cos(end[2]), np.sin(end[2])
    back = -np.array([c * end[0] + s * end[1], -s * end[0] + c * end[1]])
    return back, -end[2]


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_cantilever_rolls_up_as_the_elastica_under_pressure(mirrored):
    p = 30.0
    scene, beam, _ = cantilever(p, mirrored=mirrored)
    path = fb.static(scene, load_steps=20)
    tip, turned = rolled_up(p)
    free = beam.start if mirrored else beam.end
    assert path.position(free)[-1] == pytest.approx(tip, abs=1e-4)
    assert path.rotation(free)[-1] == pytest.approx(turned, abs=1e-4)
    assert turned > 1.5


def test_a_part_has_the_resultant_of_its_chord():
    scene, beam, load = cantilever(5.0)
    scene.remove(load)
    assert not scene.parameters
    scene.add_line_load(beam, 5.0, between=beam.s[[3, 9]], follower=True)
    bent = fb.static(scene)
    chord = bent.position(beam.nodes[9])[-1] - bent.position(beam.nodes[3])[-1]
    assert abs(bent.displacement(beam.end)[-1, 1]) > 0.05
    force = 5.0 * np.array([-chord[1], chord[0]])
    assert bent.reaction(beam.start)[-1, :2] == pytest.approx(-force, abs=1e-9)


def test_it_is_an_input_changes_and_is_copied():
    scene, beam, load = cantilever(fb.Input("air"), elements=4, section=SECTION)
    driven = fb.simulate(scene, dt=0.01, t_end=0.5, inputs={"air": lambda t: 9 * t})
    outputs = {"tip": fb.Output("displacement", beam.end, "y")}
    gain = fb.linearise(scene, outputs=outputs)
    static = -gain.C @ np.linalg.solve(gain.A, gain.B) + gain.D
    small = 1 / (8 * 2.0) + 1 / (2 * 2e3)  # L^4/(8 EI) + L^2/(2 GA)
    assert static[0, 0] == pytest.approx(small, rel=1e-2)
    scene.change(load, lambda t: 9 * t)
    twin = pickle.loads(pickle.dumps(cantilever(9.0, elements=4, section=SECTION)[0]))
    assert fb.simulate(scene, dt=0.01, t_end=0.5).q == pytest.approx(driven.q, rel=1e-2, abs=1e-3)
    scene.change(load, 9.0)
    assert fb.simulate(twin, dt=0.01, t_end=0.5).q == pytest.approx(
        fb.simulate(scene, dt=0.01, t_end=0.5).q, abs=1e-13
    )


def test_a_lid_under_pressure_vibrates_slower_and_derivatives_are_those_of_the_closed_form():
    """A clamped ring of pressure p: w^2 of its oval mode falls as 1 - p / (3 EI / R^3)."""
    heavy = fb.Section(EA=1e7, GA=1e7, EI=2.0, rhoA=1.0)

    def lowest(p):
        ends = (1, 0), (np.sqrt(0.5), np.sqrt(0.5)), (0, 1)
        scene, arc = one_bar(fb.arc(*ends), heavy, elements=6, degree=3)
        scene.fix(arc.start, "y", "rotation")
        scene.fix(arc.end, "x", "rotation")
        if p:
            scene.add_line_load(arc, p, follower=True)
        state = fb.static(scene, load_steps=4) if p else None
        return fb.modes(scene, state, n=1).angular_frequencies[0] ** 2

    alone = lowest(0.0)
    assert alone == pytest.approx(2.0 * 4 * 9 / 5, rel=1e-3)  # EI n^2 (n^2-1)^2 / (n^2+1)
    for p in (1.5, -3.0):
        assert lowest(p) / alone == pytest.approx(1 - p / 6, rel=1e-3)
