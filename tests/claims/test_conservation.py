"""What the schemes keep, at every step."""

import numpy as np
import pytest
from scenes import FLYING, free_flight, pendulum, pinned_beam, relative_drift

import fx_beam as fb

# -- Pinned beam -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degree", "dt"), [(1, 0.04), (1, 0.01), (1, 0.001), (2, 0.04), (2, 0.002), (3, 0.01)]
)
def test_energy_and_angular_momentum_of_the_pinned_beam_are_kept(degree, dt):
    scene, _ = pinned_beam(elements=8 if degree == 1 else 4, degree=degree)
    solution = fb.simulate(scene, dt=dt, t_end=10.0 if degree == 1 else 4.0)
    assert solution.angular_momentum[0] == pytest.approx(75_000, rel=1e-6 if degree == 1 else 0.1)
    assert relative_drift(solution.energy.total) < 1e-10
    assert relative_drift(solution.angular_momentum) < 1e-10


def test_the_published_scheme_keeps_angular_momentum_and_drifts_in_energy():
    scene, _ = pinned_beam()
    solution = fb.simulate(scene, fb.ModifiedMidPoint(), dt=0.01, t_end=10.0)
    energy = solution.energy.total
    assert relative_drift(solution.angular_momentum) < 1e-10
    assert 2e-5 < np.ptp(energy) / energy[0] < 2e-4


def test_the_drift_of_the_published_scheme_falls_with_the_square_of_the_element():
    drifts = []
    for elements in (4, 8, 16):
        scene, _ = pinned_beam(elements)
        solution = fb.simulate(scene, fb.ModifiedMidPoint(), dt=0.001, t_end=0.5)
        drifts.append(relative_drift(solution.energy.total))
    orders = np.log2(np.array(drifts[:-1]) / drifts[1:])
    assert orders.min() > 1.9


# Tip positions of independent codes: 8 elements with dt 0.01, and 64 with dt 0.0005.
TIP_COARSE = {
    0.1: (89.71, 33.87),
    0.2: (40.44, 83.24),
    0.5: (-77.46, 58.79),
    1.0: (19.78, -91.60),
    1.4: (91.40, 24.28),
}
TIP_FINE = {
    0.1: (89.59, 33.22),
    0.2: (39.91, 83.21),
    0.5: (-77.93, 55.81),
    1.0: (21.18, -90.09),
    1.4: (89.85, 22.98),
}


def tips(elements, dt, times):
    scene, beam = pinned_beam(elements)
    solution = fb.simulate(scene, dt=dt, t_end=1.4)
    return solution.position(beam.end)[[round(t / dt) for t in times]]


def test_tip_of_the_pinned_beam_agrees_with_independent_codes():
    difference = tips(8, 0.01, TIP_COARSE) - list(TIP_COARSE.values())
    assert np.hypot(*difference.T).max() < 1.0  # 1 % of the length
    # The table has two decimals: on the same mesh and step they are the same numbers.
    assert abs(difference).max() < 0.0051


def test_tip_of_the_pinned_beam_converges_to_the_fine_solution():
    fine = list(TIP_FINE.values())
    errors = [
        np.hypot(*(tips(elements, dt, TIP_FINE) - fine).T).mean()
        for elements, dt in ((8, 0.01), (16, 0.005), (32, 0.001))
    ]
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 0.2


# -- Pendulum ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("dt", "exact"), [(0.01, 1.47547), (0.1, 1.50252)])
def test_energy_and_period_of_the_pendulum_are_those_of_the_conserving_mid_point_rule(dt, exact):
    scene, beam = pendulum()
    solution = fb.simulate(scene, dt=dt, t_end=20.0)
    t, x = solution.t, solution.displacement(beam.end)[:, 0]
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))  # upward zero crossings; the start is one
    crossings = t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])
    assert crossings[-1] / len(crossings) == pytest.approx(exact, abs=1e-4)
    assert solution.energy.total[0] == pytest.approx(1.695**2 / 2)
    assert relative_drift(solution.energy.total) < 1e-11
    assert solution.stats.halvings == 0


def test_force_and_swing_of_the_pendulum_are_those_of_the_rigid_one():
    scene, beam = pendulum()
    solution = fb.simulate(scene, dt=0.01, t_end=5.0)
    N = solution.resultants(beam).N[1:, 0]
    assert N.max() == pytest.approx(15.557, rel=0.01)
    assert N.min() == pytest.approx(6.937, rel=0.01)
    assert abs(solution.displacement(beam.end)[:, 0]).max() == pytest.approx(0.35355, rel=1e-3)
    assert solution.displacement(beam.end)[:, 1].max() == pytest.approx(0.14645, rel=1e-3)


# -- Free flight -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "degree"),
    [(fb.EnergyMomentum(), 2), (fb.ModifiedMidPoint(), 1), (fb.MidPoint(), 1)],
    ids=["EnergyMomentum", "ModifiedMidPoint", "MidPoint"],
)
def test_momenta_are_kept_in_free_flight(scheme, degree):
    scene, _ = free_flight(degree=degree)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=8.0)
    after = solution.t > 2.5 - 1e-6
    assert abs(solution.linear_momentum[after] - (20.0, 0.0)).max() < 20 * 1e-10
    assert relative_drift(solution.angular_momentum[after]) < 1e-10


@pytest.mark.exact_times
@pytest.mark.parametrize("dt", [0.1, 0.05, 0.01, 2.5 / 7])
@pytest.mark.parametrize("last", [lambda t: t < 2.5, lambda t: t <= 2.5])
def test_a_load_that_ends_with_a_step_gives_its_whole_impulse(dt, last):
    scene = fb.Scene()
    beam = scene.add_beam([(6, 0), (0, 8)], FLYING, elements=2)
    scene.add_force(beam.start, lambda t: (8.0 * last(t), 0.0))
    solution = fb.simulate(scene, dt=dt, t_end=10 * 2.5 / 7)
    assert abs(solution.linear_momentum[-1] - (20.0, 0.0)).max() < 20 * 1e-10


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT()], ids=lambda s: s.name)
def test_the_newmark_family_keeps_linear_momentum(scheme):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0.5), (2, 0)], FLYING, elements=6)
    scene.set_velocity(beam, lambda x, y: (1.0 - y, 2.0 + x**2), spin=0.3)
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=1.0)
    drift = abs(solution.linear_momentum - solution.linear_momentum[0]).max()
    assert drift < 1e-10 * abs(solution.linear_momentum[0]).max()
