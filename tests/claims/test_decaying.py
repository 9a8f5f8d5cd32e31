"""The scheme that takes energy: invariants, balance, amplification, order, stiff mechanisms."""

import numpy as np
import pytest
from scenes import FLYING, assert_refused, clamped_bar, demo, free_flight, pinned_beam

import fx_beam as fb

ORDERS = pytest.mark.parametrize("order", [1, 2])


def rises(values):
    """Largest rise from row to row, relative to the first value."""
    return np.diff(values).max() / abs(values[0])


def relative(values):
    return abs(values - values[0]).max() / abs(values).max()


# -- Invariants and balance -----------------------------------------------------------------------


def stiffening(eps, gamma, kappa):
    return 1e4 * (eps**2 / 2 + eps**4) + 5e3 * gamma**2 + 50 * (kappa**2 + kappa**4)


OWN = fb.Section(strain_energy=stiffening, rhoA=1.0, rhoI=10.0)


@pytest.mark.parametrize(
    ("degree", "section", "order"),
    [(1, FLYING, 1), (2, FLYING, 2), (1, OWN, 1), (1, OWN, 2)],
    ids=["quadratic 1", "quadratic 2", "own energy 1", "own energy 2"],
)
def test_momenta_are_kept_and_the_balance_closes_in_free_flight(degree, section, order):
    scene, _ = free_flight(elements=3, degree=degree, section=section)
    scheme = fb.EnergyDecaying(order=order)
    pushed = fb.simulate(scene, scheme, dt=0.1, t_end=2.5)
    solution = fb.simulate(scene, scheme, dt=0.1, t_end=10.0, start=pushed)
    assert relative(solution.linear_momentum) < 1e-11
    assert relative(solution.angular_momentum) < 1e-11
    for run in (pushed, solution):
        energy = run.energy
        assert abs(energy.balance_error).max() < 1e-11 * energy.total.max()
        assert np.diff(energy.dissipated).min() >= 0
        assert (energy.numerical == energy.dissipated).all()
    assert solution.energy.dissipated[-1] > solution.energy.dissipated[0]
    # What never rises: with memory the energy with that which the scheme holds.
    assert (solution.energy.algorithmic[1:] > 0).all() == (order == 2)
    assert rises(solution.energy.total + solution.energy.algorithmic) < 1e-13


@ORDERS
def test_the_balance_closes_for_steps_in_parts_of_changing_length(order):
    # The bound of the turn halves the steps; they are doubled and halved again.
    scene, beam = pinned_beam()
    newton = fb.NewtonOptions(max_turn=0.05)
    solution = fb.simulate(scene, fb.EnergyDecaying(order=order), dt=0.02, t_end=0.3, newton=newton)
    energy = solution.energy
    assert 1 < solution.stats.halvings
    assert solution.stats.substeps > solution.stats.steps
    assert abs(energy.balance_error).max() < 1e-11 * energy.total[0]
    assert relative(solution.angular_momentum) < 1e-11
    assert rises(energy.total + energy.algorithmic) < 1e-13
    # Forces with the addition of the scheme, against the change of the momentum (no parts).
    whole = fb.simulate(scene, fb.EnergyDecaying(order=order), dt=0.01, t_end=0.2)
    forces = np.diff(whole.linear_momentum, axis=0) / 0.01
    assert abs(whole.reaction(beam.start)[1:, :2] - forces).max() < 1e-9 * abs(forces).max()


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying(order=1)])
def test_what_the_scheme_holds_is_lost_where_another_one_goes_on(scheme):
    scene, _ = free_flight(elements=3)
    pushed = fb.simulate(scene, fb.EnergyDecaying(), dt=0.1, t_end=2.5)
    held = pushed.energy.algorithmic[-1]
    energy = pushed.then(fb.simulate(scene, scheme, dt=0.1, t_end=2.6, start=pushed)).energy
    assert energy.numerical[-1] - energy.numerical[-2] > (1 - 1e-9) * held > 1e-9 * energy.total[-1]
    assert abs(energy.balance_error).max() < 1e-11 * energy.total.max()


# -- Amplification and order ----------------------------------------------------------------------


def amplification(w, damping, order):
    """Matrix of one step for u'' = -w^2 u with dt = 1: (u, v, u_before) after from before."""
    # v1 = v0 - w^2 f,  u1 = u0 + (v0 + v1)/2,
    # f = (u0 + u1)/2 + damping/2 ((u1 - u0) - r (u0 - u_before))
    r = order - 1
    a = (1 + damping) / 2
    b = (1 - damping) / 2 - damping / 2 * r
    c = damping / 2 * r
    # u1 (1 + w^2 a / 2) = u0 (1 - w^2 b / 2) + v0 - w^2 c u_before / 2
    k = 1 + w**2 * a / 2
    u1 = np.array([1 - w**2 * b / 2, 1.0, -(w**2) * c / 2]) / k
    v1 = 2 * (u1 - [1, 0, 0]) - [0, 1, 0]
    return np.array([u1, v1, [1, 0, 0]])


@ORDERS
@pytest.mark.parametrize("w", [0.01, 1, 10, 100, 1e4])
def test_an_oscillator_follows_the_amplification_matrix(w, order):
    # A massless rod of stiffness w^2 with a unit mass at its end, dt = 1.
    scene, rod = clamped_bar((1, 0), fb.Section(EA=w**2, GA=w**2, EI=w**2), elements=1)
    scene.fix(rod.end, "y", "rotation")
    scene.add_mass(rod.end, 1.0)
    speed = 1e-3 * max(1, w) ** 2
    scene.set_velocity(rod.end, (speed, 0.0))
    solution = fb.simulate(scene, fb.EnergyDecaying(order=order), dt=1.0, t_end=40.0)
    A, state = amplification(w, 0.1, order), np.array([0.0, speed, 0.0])
    path = [state := A @ state for _ in range(40)]
    u, v = np.array(path)[:, :2].T
    assert solution.displacement(rod.end)[1:, 0] == pytest.approx(u, abs=1e-9 * abs(u).max())
    assert solution.velocity(rod.end)[1:, 0] == pytest.approx(v, abs=1e-9 * abs(v).max())


# -- Examples -------------------------------------------------------------------------------------


@pytest.mark.parametrize("EA", [1e6, 1e12])
def test_a_stiff_parallelogram_passes_through_its_line_up_four_times(EA):
    parallelogram = demo("parallelogram")
    solution = parallelogram.simulate(EA, fb.EnergyDecaying(), t_end=3.0)
    assert parallelogram.path_error(solution).max() < 1e-2


# -- Refusals -------------------------------------------------------------------------------------


def test_values_out_of_range_are_refused():
    for damping in (0, -0.1, 1.5, np.nan, "much"):
        assert_refused("damping", fb.EnergyDecaying, damping)
    assert_refused("order", fb.EnergyDecaying, order=4)
    decaying = fb.EnergyDecaying()
    composed = fb.Scheme("composed", decaying.resultants, decaying.rates, fractions=(0.5, 0.5))
    with pytest.raises(fb.SceneError, match="cannot have sub-steps"):
        fb.simulate(pinned_beam()[0], composed, dt=0.01, t_end=0.1)
