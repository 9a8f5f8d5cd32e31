"""How motions blow up: dissipation that gains energy, and round-off that grows (the paper)."""

import numpy as np
import pytest
from scenes import hinged_body, pinned_bar

import fx_beam as fb

G, DT, STEPS = 9.81, 0.1, 100


def with_a_multiplier(alpha, dt):
    """Energies of a mass on a rigid rod of 1 m, released beside the hinge, by HHT and a multiplier.

    M a1 + (1 + alpha) (x1 l1 - f) - alpha (x0 l0 - f) = 0, |x1| = 1, and Newmark's formulas.
    """
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    x, v, a, multiplier = np.array([1.0, 0.0]), np.zeros(2), np.array([0.0, -G]), 0.0
    weight, energies = np.array([0.0, -G]), [0.0]
    for _ in range(STEPS):
        start, before = a, x * multiplier - weight
        for _ in range(50):
            x1 = x + dt * v + dt**2 * ((0.5 - beta) * start + beta * a)
            force = a + (1 + alpha) * (x1 * multiplier - weight) - alpha * before
            residual = np.append(force, (x1 @ x1 - 1) / (2 * beta * dt**2))
            tangent = np.zeros((3, 3))
            tangent[:2, :2] = (1 + (1 + alpha) * multiplier * beta * dt**2) * np.eye(2)
            tangent[:2, 2], tangent[2, :2] = (1 + alpha) * x1, x1
            change = np.linalg.solve(tangent, -residual)
            a, multiplier = a + change[:2], multiplier + change[2]
            if abs(change).max() < 1e-11 * (1 + abs(a).max()):
                break
        else:
            return np.array(energies)
        x = x + dt * v + dt**2 * ((0.5 - beta) * start + beta * a)
        v = v + dt * ((1 - gamma) * start + gamma * a)
        energies.append(v @ v / 2 + G * x[1])
    return np.array(energies)


def without_multipliers(scheme, dt):
    """Energies of a body on a hinge, which has one unknown."""
    scene, body, _ = hinged_body((1, 0), 1.0, 0.0, {"pin": (0, 0)}, gravity=(0, -G))
    return fb.simulate(scene, scheme, dt=dt, t_end=STEPS * dt, max_halvings=0).energy.total


@pytest.mark.parametrize("stretch", [1 - 4e-15, 1, 1 + 4e-15])
def test_dissipation_gains_energy_with_multipliers_and_less_without(stretch):
    """In terms of m g L; the same method loses energy where steps are half as long."""
    dt = DT * stretch
    gains = [
        (energies.max() - energies[0]) / G
        for energies in (
            with_a_multiplier(-0.05, dt),
            without_multipliers(fb.HHT(-0.05), dt),
            without_multipliers(fb.EnergyMomentum(), dt),
        )
    ]
    assert gains[0] > 100 and 1 < gains[1] < 100 and gains[2] < 1e-12
    for energies in with_a_multiplier(-0.05, dt / 2), without_multipliers(fb.HHT(-0.05), dt / 2):
        assert energies.max() == energies[0] > energies[-1]


def axial_force(scheme):
    """Deviation of the axial force of a stiff bar that turns steadily with a mass at its end.

    The bar is stretched from the start by a natural strain, and nothing else disturbs the motion.
    """
    length, mass, speed, EA = 3.0443, 10.0, 7.72, 1e10
    force = mass * speed**2 / length
    scene, bar = pinned_bar((length, 0), fb.Section(EA=EA, GA=EA, EI=1e3), elements=1)
    scene.add_mass(bar.end, mass)
    scene.add_natural_strain(bar, axial=-force / EA)
    scene.set_velocity(bar.end, (0.0, speed))
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, scheme, dt=DT, t_end=2 * STEPS * DT, max_halvings=0)
    return abs(solution.resultants(bar).N[1:, 0] / force - 1)


def test_round_off_starts_the_axial_vibration_with_newmark_only():
    vibration = axial_force(fb.Newmark())
    assert vibration[:20].max() < 1e-6  # round-off of EA is 1e-8 of the force
    assert vibration.max() > 1
    assert axial_force(fb.EnergyMomentum()).max() < 1e-6
