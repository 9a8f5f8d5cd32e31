"""Follower forces: tangents, the exact work in motion, closed forms and flutter."""

import numpy as np
import pytest
import scipy.integrate
from scenes import FLYING

import fx_beam as fb

SCHEMES = [fb.EnergyMomentum(), fb.MidPoint(), fb.Newmark(), fb.HHT(-0.2), fb.Equilibrium()]


def cantilever(section, elements=4, degree=1):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=elements, degree=degree)
    scene.clamp(beam.start)
    return scene, beam


def test_the_shape_under_a_follower_force_is_the_integral_from_the_tip():
    section = fb.Section(EA=300.0, GA=200.0, EI=1.0)
    force = np.array([-1.0, -12.0])
    scene, beam = cantilever(section, 16, 2)
    scene.add_force(beam.end, force, follower=True)
    solution = fb.static(scene, steps=8)

    # Seen from the tip's section the force is constant and everything known: no shooting.
    def slope(_, y):
        t = np.array([np.cos(y[2]), np.sin(y[2])])
        normal = np.array([-t[1], t[0]])
        dphi = (1 + force @ t / 300.0) * t + (force @ normal / 200.0) * normal
        return *(-dphi), -y[3], -(dphi[1] * force[0] - dphi[0] * force[1])

    y = scipy.integrate.solve_ivp(slope, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-11).y[:, -1]
    turn = -y[2]
    c, s = np.cos(turn), np.sin(turn)
    tip = -np.array([c * y[0] - s * y[1], s * y[0] + c * y[1]])
    assert turn < -2  # far beyond a right angle
    assert solution.rotation(beam.end)[-1] == pytest.approx(turn, abs=1e-5)
    assert solution.position(beam.end)[-1] == pytest.approx(tip, abs=1e-5)


def test_a_couple_of_follower_forces_is_a_moment():
    # In the plane a moment is a follower by itself; of a couple only one that follows is the same.
    def rolled(follower):
        scene, beam = cantilever(fb.Section(EA=1e6, GA=1e6, EI=1.0), 8, 2)
        arm = fb.Section(EA=1e9, GA=1e9, EI=1e9)
        for side in (1, -1):
            lever = scene.add_beam([beam.end, (1, 0.1 * side)], arm, degree=2)
            scene.add_force(lever.end, (-20.0 * side, 0.0), follower)
        return fb.static(scene, steps=8).rotation(beam.end)[-1]

    assert rolled(True) == pytest.approx(4.0, rel=1e-6)  # M = 4, EI = 1, L = 1
    assert rolled(False) < 2.5  # the arm of a dead couple shrinks as it turns


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=lambda s: s.name)
def test_the_work_counted_is_the_force_along_the_mean_section_times_the_path(scheme):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=3)
    scene.add_force(beam.end, lambda t: (30.0, 80.0 * np.cos(9 * t)), follower=True)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=2.0)
    psi = solution.rotation(beam.end)
    mean = (psi[1:] + psi[:-1]) / 2
    f = (80 * np.cos(9 * solution.t[1:]) + 80 * np.cos(9 * solution.t[:-1])) / 2
    force = np.column_stack(
        [30 * np.cos(mean) - f * np.sin(mean), 30 * np.sin(mean) + f * np.cos(mean)]
    )
    path = np.diff(solution.position(beam.end), axis=0)
    work = np.concatenate([[0], np.cumsum((force * path).sum(axis=1))])
    assert abs(work).max() > 1
    assert solution.energy.work == pytest.approx(work, abs=1e-11 * abs(work).max())
    if scheme.name == "EnergyMomentum":
        assert abs(solution.energy.balance_error).max() < 1e-11 * abs(work).max()


def test_momentum_grows_by_the_force_of_the_steps():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(1e4, 1e4, 1e3, rhoA=1.0, rhoI=0.1))
    scene.add_force(beam.start, (1.0, 0.0), follower=True)
    scene.add_force(beam.end, (1.0, 0.0), follower=True)
    solution = fb.simulate(scene, dt=0.01, t_end=0.5)
    assert solution.linear_momentum[-1] == pytest.approx([1.0, 0.0], abs=1e-9)
    assert str(scene.loads[0]) == "follower force on node 0 at (0, 0)"
    assert str(scene.loads[0]) in solution.stats.assembled


def test_a_follower_force_that_jumps_belongs_to_the_step_in_which_it_acts():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING)
    for node in (beam.start, beam.end):
        scene.add_force(node, lambda t: (1.0 if t < 0.1 else 0.0, 0.0), follower=True)
    solution = fb.simulate(scene, dt=0.05, t_end=0.2)
    assert solution.linear_momentum[:, 0] == pytest.approx([0, 0.1, 0.2, 0.2, 0.2], abs=1e-12)
