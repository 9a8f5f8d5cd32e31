"""Rayleigh damping of a scene, and damping ratios of all modes, against closed forms."""

import numpy as np
import pytest
from scenes import clamped_bar, one_bar, pinned_bar

import fx_beam as fb

TAPER = fb.Section(EA=1e5, GA=1e5, EI=20.0, rhoA=lambda f: 1 + f, rhoI=lambda f: 0.02 - 0.01 * f)


def frame():
    """A column with a hinged girder, and a body on it."""
    scene, column = clamped_bar((0, 1), TAPER, elements=3, degree=2)
    girder = scene.add_beam([(0, 1), (1.5, 1.2)], TAPER, elements=2, degree=2)
    scene.clamp(girder.end)
    scene.add_joint(fb.Revolute(column.end, girder.start))
    body = scene.add_body((0.2, 1.3), 0.8, 0.05)
    scene.add_joint(fb.Rigid(column.end, body.centre, offset=(0.2, 0.3)))
    return scene, column


def test_the_damping_matrix_is_that_of_rayleigh():
    """In x' = A x of places and rates: dv'/dv = -alpha - tau M^-1 K."""
    scene, _ = frame()
    scene.add_damping(0.5, 2e-3)
    scene.add_damping(stiffness=1e-3)
    A = fb.linearise(scene).A
    n = len(A) // 2
    expected = -0.5 * np.eye(n) + 3e-3 * A[n:, :n]
    assert A[n:, n:] == pytest.approx(expected, rel=1e-8, abs=1e-9 * abs(expected).max())


def test_ratios_of_modes_are_those_of_both_numbers():
    scene, _ = frame()
    undamped = fb.modes(scene, n=6).angular_frequencies
    scene.add_damping(0.5, 2e-4)
    damped = fb.modes(scene, n=6)
    assert damped.damping_ratios == pytest.approx(0.5 / (2 * undamped) + 1e-4 * undamped, rel=1e-8)


def flying(**damping):
    section = fb.Section(EA=1e6, GA=1e6, EI=30.0, rhoA=1.0, rhoI=1e-2)
    scene, beam = one_bar((1, 0), section, elements=3)
    scene.add_mass(beam.end, 0.7, 0.1)
    scene.add_damping(**damping)
    scene.set_velocity(beam, (0.3, 2.0))
    return fb.simulate(scene, dt=0.01, t_end=1.0)


def test_the_part_of_the_mass_damps_rigid_motions_and_that_of_the_stiffness_does_not():
    alpha = 0.8
    slowed = flying(mass=alpha)
    mean_rates = ((1 - alpha * 0.005) / (1 + alpha * 0.005)) ** np.arange(101)
    assert slowed.v[:, :, 1] == pytest.approx(2 * np.outer(mean_rates, np.ones(4)), abs=1e-10)
    assert mean_rates[-1] == pytest.approx(np.exp(-alpha), rel=1e-5)
    lost = slowed.energy.dissipated[-1]
    assert lost == pytest.approx(1.7 / 2 * 4.09 * (1 - mean_rates[-1] ** 2), rel=1e-10)
    kept = flying(stiffness=0.01)
    assert kept.v[-1] == pytest.approx(kept.v[0], abs=1e-10)


def test_a_beam_of_degree_two_whose_stiffness_and_mass_vary_is_slowed_as_one_mass():
    """Its data stand on Gauss rules of two and of three points, side by side."""
    section = fb.Section.rectangle(lambda f: 0.1 - 0.05 * f, 0.05, **fb.materials.steel)
    scene, beam = one_bar((1, 0), section, elements=2, degree=2)
    scene.add_damping(mass=0.8, stiffness=1e-3)
    scene.set_velocity(beam, (0.3, 2.0))
    slowed = fb.simulate(scene, dt=0.01, t_end=0.1)
    rate = 2 * ((1 - 0.8 * 0.005) / (1 + 0.8 * 0.005)) ** 10
    assert slowed.v[-1, :, 1] == pytest.approx(np.full(5, rate), rel=1e-9)


def test_a_turning_beam_under_the_part_of_the_stiffness_keeps_its_spin():
    section = fb.Section(EA=1e4, GA=1e4, EI=30.0, rhoA=1.0, rhoI=1e-2)
    scene, beam = one_bar([(-0.5, 0), (0.5, 0)], section, elements=4)
    scene.add_damping(stiffness=0.02)
    scene.set_velocity(beam, lambda x, y: (-3 * y, 3 * x), spin=3.0)
    motion = fb.simulate(scene, dt=0.01, t_end=6.0)
    momentum = motion.angular_momentum
    assert np.ptp(momentum) < 1e-12
    energy = motion.energy.total
    # Until it has stretched, and then no more.
    assert energy[300] - energy[-1] < 1e-9 * energy[0] < energy[0] - energy[300]


def test_it_is_the_drag_and_the_retardation_of_each_part():
    data = {"EA": 1e4, "GA": 1e4, "EI": 5.0, "rhoA": 1.2, "rhoI": 1e-2}
    motions = []
    for by_hand in (False, True):
        section = fb.Section(**data, retardation=2e-3 if by_hand else 0.0)
        scene, beam = pinned_bar((1, 0.2), section, elements=3, degree=2, gravity=(0, -9.81))
        scene.add_mass(beam.end, 0.5, 0.01)
        if by_hand:
            scene.add_drag(beam, linear=0.3 * 1.2, rotation=0.3 * 1e-2)
            scene.add_drag(beam.end, linear=0.3 * 0.5, rotation=0.3 * 0.01)
        else:
            damping = scene.add_damping(0.3, 2e-3)
        motions.append(fb.simulate(scene, dt=0.01, t_end=1.0))
        if not by_hand:
            scene.remove(damping)
            assert not fb.simulate(scene, dt=0.01, t_end=0.1).energy.dissipated.any()
    one, two = motions
    assert one.q == pytest.approx(two.q, abs=1e-9)
    assert one.energy.dissipated == pytest.approx(two.energy.dissipated, abs=1e-9)


def test_modal_damping_gives_each_mode_its_ratio():
    """Of three masses on springs: x = sum of phi phi^T F / (w_j^2 + 2 i zeta_j w_j w - w^2).

    A mode above those that are given has the ratio of the last one by its frequency.
    """
    m, k = np.array([1.0, 2.0, 0.5]), np.array([300.0, 500.0, 200.0])
    scene, bodies = fb.Scene(), []
    for number, (mass, stiffness) in enumerate(zip(m, k, strict=True)):
        body = scene.add_body((number, 0), mass).centre
        scene.fix(body, "y", "rotation")
        spring = fb.Spring(stiffness, rest=1.0)
        if bodies:
            scene.add_force_between(body, bodies[-1], spring=spring)
        else:
            scene.add_spring(body, x=fb.Spring(stiffness))
        bodies.append(body)
    K = np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    squares, V = np.linalg.eigh(K / np.sqrt(np.outer(m, m)))
    w, phi = np.sqrt(squares), V / np.sqrt(m)[:, None]
    f = np.array([0.0, 1.0, w[0] / (2 * np.pi), 3.0, w[2] / (2 * np.pi), 8.0])
    load = bodies[2], (1.0, 0.0)
    for ratio, zeta in (
        (0.02, [0.02] * 3),
        ([0.01, 0.05, 0.03], [0.01, 0.05, 0.03]),
        ([0.01, 0.05], [0.01, 0.05, 0.05 * w[2] / w[1]]),
    ):
        response = fb.frequency_response(scene, load, bodies[0], f, damping_ratio=ratio)
        of_modes = w**2 + 2j * np.array(zeta) * w * 2 * np.pi * f[:, None]
        exact = (phi[0] * phi[2] / (of_modes - (2 * np.pi * f[:, None]) ** 2)).sum(axis=1)
        assert response.component("x") == pytest.approx(exact, rel=1e-9)


def test_modal_damping_of_a_frame_on_a_shaken_base_and_beside_a_damping_of_the_scene():
    scene, column = frame()
    lowest = fb.modes(scene, n=12)
    f = lowest.frequencies[:3]

    def shaken(ratio):
        where = {"at": column.end, "frequencies": f, "base": (1, 0)}
        return fb.frequency_response(scene, **where, damping_ratio=ratio).values

    assert shaken(0.03) == pytest.approx(shaken([0.03] * 12), rel=1e-2)
    both = shaken(0.03 + 1.0 / lowest.angular_frequencies)
    assert abs(shaken([0.03] * 12) - both).max() > 0.1 * abs(both).max()
    scene.add_damping(mass=2.0)  # of ratios 2 / (2 w)
    assert shaken([0.03] * 12) == pytest.approx(both, rel=1e-2)
