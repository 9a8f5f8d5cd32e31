"""Modes under forces without a potential: flutter and divergence against closed forms."""

import numpy as np
import pytest
import scipy.optimize
from scenes import assert_refused, clamped_bar, one_bar
from test_flutter import column, ziegler

import fx_beam as fb


def roots_of_ziegler(load, dampers):
    """Of both angles: M = [[3, 1], [1, 1]], K = [[2 - P, P - 1], [-1, 1]]."""
    b, d = dampers
    M, C = np.array([[3.0, 1], [1, 1]]), np.array([[b + d, -d], [-d, d]])
    K = np.array([[2 - load, load - 1], [-1, 1]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    return np.linalg.eigvals(A)


def near(computed, exact, rel):
    """Whether each root that was found, or its conjugate, is one of the exact ones."""
    return all(abs(exact - root).min() <= rel * abs(root) for root in computed)


@pytest.mark.parametrize("dampers", [(0.0, 0.0), (0.02, 0.02), (0.0, 0.1), (0.2, 0.01)])
@pytest.mark.parametrize("load", [0.5, 1.5, 1.9, 2.2, 3.5, 4.5, 6.0])
def test_zieglers_column_has_the_roots_of_its_closed_form(load, dampers):
    scene = ziegler(load, dampers)
    modes = fb.modes(scene, fb.static(scene, load_steps=2), n=2)
    exact = roots_of_ziegler(load, dampers)
    assert near(modes.eigenvalues, exact, 1e-6)
    assert modes.unstable.any() == (exact.real.max() > 1e-6)
    if dampers == (0.0, 0.0):  # stable below 7/2 - sqrt(2), flutter to 7/2 + sqrt(2)
        flutters = abs(load - 3.5) < np.sqrt(2)
        assert modes.unstable.sum() == (1 if flutters else 2 if load > 4.9 else 0)
        if flutters:
            assert modes.damping_ratios.sum() == pytest.approx(0.0, abs=1e-9)
            assert modes.frequencies[0] == pytest.approx(modes.frequencies[1], rel=1e-9)
        elif load < 3:
            assert not modes.damping_ratios.any()


def beck(w, load):
    """Zero if w is a frequency of a cantilever with EI = rhoA = L = 1 under a follower force."""
    r = np.sqrt(-load / 2 + np.array([1, -1]) * np.sqrt(load**2 / 4 + w**2 + 0j) + 0j)
    r = np.array([r[0], -r[0], r[1], -r[1]])
    end = np.exp(r)
    rows = np.array([r**0, r, r**2 * end, r**3 * end])
    return np.linalg.det(rows / abs(rows).max(axis=1)[:, None])


@pytest.mark.parametrize("load", [5.0, 15.0, 19.0, 21.0, 24.0])
def test_becks_column_has_the_frequencies_of_its_characteristic_equation(load):
    scene = column(load, 0, 8, 3)
    modes = fb.modes(scene, fb.static(scene, load_steps=2), n=4)
    for root in modes.eigenvalues:
        w = -1j * root
        exact = scipy.optimize.newton(beck, w, args=(load,), tol=1e-12, maxiter=200)
        # Strain and shear of P/EA, and the rotary inertia, matter most where two modes meet.
        assert abs(w / exact - 1) < (1e-3 if load in (19.0, 21.0) else 2e-4)
    assert modes.unstable[:2].sum() == (load > 20.05)
    # The other columns of a finer mesh are the same; those of linearise, too.
    A = fb.linearise(scene, fb.static(scene, load_steps=2)).A
    exact = np.linalg.eigvals(A)
    assert near(modes.eigenvalues[:2], exact, 1e-5)


def test_many_modes_of_a_large_scene_are_those_of_its_linear_system():
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3, retardation=1e-3)
    scene, beam = clamped_bar((0.6, 0.8), section, elements=40)
    scene.add_force(beam.end, (-0.6 * 25, -0.8 * 25), follower=True)
    state = fb.static(scene, load_steps=4)
    modes = fb.modes(scene, state, n=6)
    assert modes.unstable.sum() == 1
    assert near(modes.eigenvalues, np.linalg.eigvals(fb.linearise(scene, state).A), 1e-6)
    alone = fb.modes(scene, state, n=6, damping=False)
    assert near(modes.eigenvalues.imag[2:] * 1j, 1j * alone.angular_frequencies, 1e-2)


def test_a_free_scene_under_forces_without_a_potential_is_told_what_to_do():
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)
    scene, beam = one_bar((1, 0), section, elements=4)
    scene_of_held = scene
    for end, sign in ((beam.start, 1), (beam.end, -1)):
        scene_of_held.add_force(end, (5.0 * sign, 0), follower=True)
    held, held_beam = clamped_bar((1, 0), section, elements=4)
    for end, sign in ((held_beam.start, 1), (held_beam.end, -1)):
        held.add_force(end, (5.0 * sign, 0), follower=True)
    state = fb.static(held, load_steps=2)
    assert (fb.modes(held, state, n=2).frequencies > 0).all()
    assert_refused("moves freely.*linearise", fb.modes, scene, state)


def test_derivatives_of_such_modes_are_refused():
    run = fb.ModalResponse(lambda x: ziegler(x[0]), state=lambda scene: fb.static(scene, 2))
    assert_refused("not symmetric.*fx_beam.modes has them", run, [1.0])
