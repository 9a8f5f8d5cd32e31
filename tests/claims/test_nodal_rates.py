"""Nodal rules of one's own in UFL: equal to the package's, coupled, in stages, and refusals."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jointed import midpoint, pair
from scenes import assert_refused, clamped_bar, one_bar, with_variables, zener_energy, zener_flow

import fx_beam as fb

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from own_rates import armero_romero, bathe, oscillator_loss


def newmark(D, v0, a0, before, dt):
    a1 = 4 / dt**2 * (D - dt * v0) - a0
    return a1, v0 + dt / 2 * (a0 + a1), a1


def generalized_alpha(D, v0, a0, before, dt):
    """Chung and Hulbert's parameters of the spectral radius 1/2."""
    alpha_m, alpha_f = 0.0, 1 / 3
    beta, gamma = (1 - alpha_m + alpha_f) ** 2 / 4, 0.5 - alpha_m + alpha_f
    a1 = (D - dt * v0) / (beta * dt**2) - (1 / (2 * beta) - 1) * a0
    return (1 - alpha_m) * a1 + alpha_m * a0, v0 + dt * ((1 - gamma) * a0 + gamma * a1), a1


PAIRS = {
    "mid-point": (fb.EnergyMomentum(), fb.NodalRates(midpoint)),
    "newmark": (fb.Newmark(), fb.NodalRates(newmark, level=1.0)),
    "alpha": (fb.GeneralizedAlpha(0.5), fb.NodalRates(generalized_alpha, level=2 / 3)),
    "order 4": (fb.EnergyMomentum(order=4), fb.NodalRates(midpoint)),
}


def mechanism(driven=True):
    """Two bars with a joint, a damper, a motor or none, a mass and a load that is on and off."""
    section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=0.01)
    laws = {"damper": fb.Damper(0.05), "section": section}
    scene, arm, bar, _ = pair("revolute", gravity=(0, -9.81), **laws)
    motor = {"motor": lambda t: 0.2 * (1 - math.cos(3 * t))} if driven else {}
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, **motor))
    scene.add_mass(bar.end, 0.5, 0.01)
    scene.add_force(bar.end, lambda t: (0.0, 2.0 * math.cos(5 * t)))
    return scene, bar


@pytest.mark.parametrize("kind", PAIRS)
def test_the_rules_of_the_package_written_out_are_the_same(kind):
    scheme, rates = PAIRS[kind]
    own = fb.Scheme("own", scheme.resultants, rates, scheme.fractions)
    mean = rates.level == 0.5
    scene, bar = mechanism(driven=mean)  # Newmark's family has no recursion for driven motions
    first, second = (fb.simulate(scene, s, dt=0.01, t_end=0.3) for s in (scheme, own))
    assert len(first.t) > 20
    assert abs(second.q - first.q).max() < 1e-9
    if not mean:  # the rates of the others are fitted to joints
        assert abs(second.v - first.v).max() < 1e-7
    assert abs(second.energy.dissipated - first.energy.dissipated).max() < 1e-9
    if mean:
        assert abs(second.energy.balance_error).max() < 1e-11
    assert abs(second.resultants(bar).M - first.resultants(bar).M).max() < 1e-6
    # Newton's method has the same tangent: as many iterations, up to rounding.
    assert second.stats.newton_iterations <= first.stats.newton_iterations + 2


@pytest.mark.parametrize("level", [0.6, 0.9, 1.0])
def test_a_rule_is_of_second_order_at_each_level_with_loads_in_time_and_drag(level):
    """Drag at the mean rate was of first order: errors 92 and 47 um for 4.7 and 1.2 um."""
    section = fb.Section(EA=400.0, GA=150.0, EI=0.05, rhoA=0.1, rhoI=1e-5, retardation=1e-3)
    scene, arm = clamped_bar((1, 0), section, 4)
    scene.add_drag(arm, linear=0.5, quadratic=0.2, rotation=1e-3)
    scene.add_force(arm.end, lambda t: (0, 0.02 * math.sin(8 * t)))

    def rule(D, v0, a0, before, dt):
        # The linear acceleration, of second order at the level: M a(level) = F(level).
        a1 = (D - dt * v0) * 4 / dt**2 - a0
        return (1 - level) * a0 + level * a1, v0 + dt / 2 * (a0 + a1), a1

    def resultants(step, law):
        return fb.Newmark().resultants(step, law)._replace(level=level)

    own = fb.Scheme("own", resultants, fb.NodalRates(rule, level))
    exact = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=1e-3, t_end=0.2)
    errors = [
        abs(fb.simulate(scene, own, dt=dt, t_end=0.2).q[-1] - exact.q[-1]).max()
        for dt in (4e-3, 2e-3)
    ]
    assert math.log2(errors[0] / errors[1]) > 1.8


def test_two_sub_steps_are_two_steps_of_half_the_length():
    """Forces are those of the last one; they were means of both. What flows is not refused."""
    scene, bar = mechanism()
    relaxing = with_variables(zener_energy, zener_flow, rhoA=1.0, rhoI=0.1)
    strip = scene.add_beam([(0, 1), (1, 1)], relaxing, elements=2)
    scene.clamp(strip.start)
    scene.prescribe(strip.end, y=lambda t: 0.2 * math.sin(3 * t))
    rates = fb.NodalRates(newmark, level=1.0)
    plain = fb.Scheme("own", fb.Newmark().resultants, rates)
    halves = fb.simulate(scene, replace(plain, fractions=(0.5, 0.5)), dt=0.01, t_end=0.1)
    steps = fb.simulate(scene, plain, dt=0.005, t_end=0.1)
    assert halves.t_level == pytest.approx(steps.t_level[::2])
    for name in ("q", "v", "reactions", "joint_forces", "motor_forces"):
        exact = getattr(steps, name)[::2]
        assert abs(getattr(halves, name) - exact)[1:].max() < 1e-8 * abs(exact).max(), name
    for beam in (bar, strip):
        exact = steps.resultants(beam).M[::2]
        assert abs(halves.resultants(beam).M - exact).max() < 1e-8 * abs(exact).max()
    for name in ("work", "dissipated"):
        exact = getattr(steps.energy, name)[::2]
        assert abs(getattr(halves.energy, name) - exact).max() < 1e-8 * abs(exact).max(), name


def test_a_run_of_two_stages_goes_on():
    scene, _ = mechanism()
    whole = fb.simulate(scene, bathe(), dt=0.01, t_end=0.2)
    half = fb.simulate(scene, bathe(), dt=0.01, t_end=0.1)
    rest = fb.simulate(scene, bathe(), dt=0.01, t_end=0.2, start=half)
    assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-10


def test_a_step_of_two_stages_is_of_second_order():
    values = []
    for dt in (0.005, 0.0025, 0.00125):
        scene, bar = mechanism()
        values.append(fb.simulate(scene, bathe(), dt=dt, t_end=0.2).position(bar.end)[-1])
    order = math.log2(np.hypot(*(values[1] - values[0])) / np.hypot(*(values[2] - values[1])))
    assert order == pytest.approx(2, abs=0.25)


@pytest.mark.parametrize("w", [0.5, 3.0])
def test_the_loss_of_the_two_stages_is_that_of_their_amplification_matrix(w):
    # u, v after one step of 1 s: trapezoidal rule over 0.5 s, then the backward difference.
    h, (u0, v0) = 0.5, (0.0, 1.0)
    A = np.array([[1, -h / 2], [w**2 * h / 2, 1]])
    total = [v0**2]
    for _ in range(20):
        u1, v1 = np.linalg.solve(A, [u0 + h / 2 * v0, v0 - h / 2 * w**2 * u0])
        B = np.array([[3, -2 * h], [2 * h * w**2, 3]])
        u0, v0 = np.linalg.solve(B, [4 * u1 - u0, 4 * v1 - v0])
        total.append(v0**2 + w**2 * u0**2)
    assert oscillator_loss(bathe(), w) == pytest.approx(1 - total[-1] ** (1 / 20), rel=1e-4)


def test_the_damped_velocities_lose_what_their_formula_says():
    # A force along a straight flight: the velocity part takes m/2 chi (|v1| - |v0|)^2 of its work.
    chi, m, dt = 0.3, 2.0, 0.1
    scene, rod = one_bar((1, 0), fb.Section(EA=1e3, GA=1e3, EI=1e3), elements=1)
    for node in (rod.start, rod.end):
        scene.add_mass(node, m / 2, 1e-3)
    scene.set_velocity(rod, (1.0, 2.0))
    for node in (rod.start, rod.end):
        scene.add_force(node, (1.5, 1.5 * 2.0))
    solution = fb.simulate(scene, armero_romero(0.0, chi), dt=dt, t_end=0.5)
    speed = np.hypot(*solution.velocity(rod.end).T)
    lost = -np.diff(solution.energy.balance_error)
    work = np.diff(solution.energy.work)
    mean = (speed[1:] + speed[:-1]) / 2
    # The path is that of the mean velocity times 1 + chi (|v1| - |v0|) / (|v1| + |v0|).
    path = dt * mean * (1 + chi * np.diff(speed) / (2 * mean))
    assert work == pytest.approx(3.0 * math.hypot(1, 2) * path, rel=1e-9)
    assert lost == pytest.approx(m / 2 * chi * np.diff(speed) ** 2, rel=1e-6)


# -- Refusals --------------------------------------------------------------------------------------


def test_rules_that_do_not_fit_are_refused():
    scene, _ = mechanism()

    def simulate(rule):
        scheme = fb.Scheme("own", fb.EnergyMomentum().resultants, fb.NodalRates(rule))
        fb.simulate(scene, scheme, dt=0.1, t_end=0.2)

    for rule, text in (
        (lambda D, v0, a0, before, dt: (D, D), "it gave 2 of the shapes"),
        (lambda D, v0, a0, before, dt: (D[0], D, D), "three vectors of x, y and rotation"),
        (lambda D, v0: (D, D, D), "takes 2 positional arguments"),
        (lambda D, v0, a0, before, dt: (math.sqrt(dt), D, D), "math or NumPy"),
        (lambda D, v0, a0, before, dt: (v0 / dt, v0, a0), "does not depend on the increment D"),
    ):
        assert_refused(text, simulate, rule)
    for level in (0.0, 1.01, math.nan, "end"):
        assert_refused("level", fb.NodalRates, midpoint, level)
    with pytest.raises(fb.SceneError, match="2 rules"):
        fb.Scheme("own", fb.EnergyMomentum().resultants, fb.NodalRates((midpoint, midpoint)))
