"""Stress resultants belong to the same time and step as reactions and joint forces."""

import ufl

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, pinned_bar

import fx_beam as fb

MASS, LENGTH, SPIN = 1.0, 1.0, 40.0
CENTRIPETAL = MASS * SPIN**2 * LENGTH
LIGHT = fb.Section(EA=1e6, GA=1e6, EI=1e4)
ETA = 50.0

rows = pytest.mark.parametrize("every", [4, 1])


def rotor(outwards=0.0):
    """Massless arm on a pin with a mass at its end, which turns too fast for whole steps of 0.1."""
    scene, arm = pinned_bar((LENGTH, 0), LIGHT, elements=1)
    scene.add_mass(arm.end, MASS)
    scene.set_velocity(arm, lambda x, y: (outwards * x, SPIN * x), spin=SPIN)
    return scene, arm


def reaction(solution, node):
    return np.hypot(*solution.reaction(node)[:, :2].T)


# -- Steps taken in parts --------------------------------------------------------------------------


@rows
def test_resultants_and_reactions_of_a_step_in_parts_are_means_over_it(every, tmp_path):
    scene, arm = rotor()
    run = fb.simulate(scene, dt=0.1, t_end=1.0, record=fb.Record(every=every))
    assert run.stats.substeps >= 2 * run.stats.steps
    run.save(tmp_path / "run.npz")
    for solution in (run, fb.load(tmp_path / "run.npz")):
        N = solution.resultants("beam 1").N[1:, 0]
        assert pytest.approx(CENTRIPETAL, rel=0.01) == N
        assert (solution.t - solution.t_level)[1:] == pytest.approx(np.full(len(N), 0.05))
        # The impulse is the change of momentum: the chord of the turn in both halves, in each of
        # which tan(turn/2) is half of spin times length.
        gained = 2 * MASS * SPIN * LENGTH * np.sin(2 * np.arctan(SPIN * 0.05 / 2))
        assert reaction(solution, arm.start)[1:] == pytest.approx(gained / 0.1, rel=1e-3)


@rows
def test_a_joint_bears_the_resultants_of_its_row(every):
    scene, arm = rotor()
    tip = scene.add_beam([(LENGTH, 0), (1.5 * LENGTH, 0)], LIGHT, elements=1)
    joint = scene.add_joint(fb.Revolute(arm.end, tip.start))
    scene.add_mass(tip.end, MASS)
    scene.set_velocity(tip, lambda x, y: (0.0, SPIN * x), spin=SPIN)
    run = fb.simulate(scene, dt=0.05, t_end=0.8)
    assert not run.stats.halvings
    # No bending moment at either end of the massless tip: its force is along its mean director.
    r, psi = run.resultants(tip), run.rotation(tip.start)
    force = np.hypot(*run.joint(joint).force[1:, :2].T)
    assert abs(r.M[1:]).max() < 1e-6 * force.max()
    spin = run.spin(tip.start)[1:]  # without inertia the mean over the step
    mean = np.cos(np.arctan(spin * (run.t - run.t_level)[1:]))
    assert force == pytest.approx(np.hypot(r.N[1:, 0], r.Q[1:, 0]) * mean, rel=1e-6)
    assert abs(psi[2:] - psi[:-2]).max() > 2.0  # more than a step may turn
    # Steps of twice the length are halved: their rows are means over two of these.
    halved = fb.simulate(scene, dt=0.1, t_end=0.8, record=fb.Record(every=every))
    assert halved.stats.substeps == run.stats.steps
    for name in ("N", "Q"):
        pairs = getattr(r, name)[1:].reshape(8, 2, -1).mean(axis=1)[every - 1 :: every]
        assert getattr(halved.resultants(tip), name)[1:] == pytest.approx(pairs, rel=1e-6)
    for computed, each in (
        (halved.joint(joint).force, run.joint(joint).force),
        (halved.reaction(arm.start), run.reaction(arm.start)),
    ):
        pairs = each[1:].reshape(8, 2, 3).mean(axis=1)[every - 1 :: every]
        assert computed[1:] == pytest.approx(pairs, abs=1e-6 * force.max())


def test_full_turns_that_are_counted_apart_are_in_the_starts_of_parts_as_well():
    scene, arm = rotor()
    run = fb.simulate(scene, dt=0.1, t_end=110.0, record=fb.Record(every=50))  # 700 turns
    assert abs(run.rotation(arm.start)[-1]) > 1000.0
    assert run.resultants(arm).N[1:] == pytest.approx(CENTRIPETAL, rel=0.02)


# -- Resultants that depend on rates ---------------------------------------------------------------


def viscous():
    """Newmark's rule, and a viscosity of the axis that grows with time."""

    def resultants(step, law):
        r = fb.Newmark().resultants(step, law).end
        rate = ufl.dot(step.prime(step.v), step.director)
        return r._replace(N=r.N + ETA * (1 + step.t) * rate)

    return fb.Scheme("Viscous", resultants, fb.Newmark().rates)


@rows
@pytest.mark.parametrize("max_turn", [2.0, 0.1])
def test_resultants_of_a_scheme_with_rates_have_rates_and_time(every, max_turn):
    scene, arm = rotor(outwards=3.0)
    options = {"record": fb.Record(every=every)}
    # A step turns by 0.16 rad.
    options["newton"] = fb.NewtonOptions(max_turn=max_turn)
    run = fb.simulate(scene, viscous(), dt=0.004, t_end=0.064, **options)
    assert (run.stats.substeps > run.stats.steps) == (max_turn == 0.1)
    r = run.resultants(arm)
    # The scheme is in equilibrium at the ends of steps: the pin bears what the arm bears.
    assert np.hypot(r.N[1:, 0], r.Q[1:, 0]) == pytest.approx(
        reaction(run, arm.start)[1:], rel=1e-6, abs=1e-6 * abs(r.N).max()
    )
    # At the start nothing is strained, and the arm grows at 3 m/s.
    assert r.N[0, 0] == pytest.approx(ETA * 3.0 / LENGTH, rel=1e-4)


def test_rates_that_resultants_need_and_that_are_not_recorded_are_asked_for():
    scene, arm = rotor(outwards=3.0)
    options = {"dt": 0.004, "t_end": 0.02, "record": fb.Record(rates=False)}
    run = fb.simulate(scene, viscous(), **options)
    assert len(run.position(arm.end)) == 6
    assert_refused(r"Viscous depend on rates: .*rates=True", run.resultants, arm, error=ValueError)
    elastic = fb.simulate(scene, fb.Newmark(), **options)
    assert elastic.resultants(arm).N.shape == (6, 1)


# -- Members that are stiff in shear or along the axis ---------------------------------------------


@pytest.mark.parametrize("stiff", ["EA", "GA"])
@pytest.mark.parametrize(("ratio", "error"), [(1e3, 1e-4), (1e6, 1e-4), (1e9, 1e-2)])
def test_forces_of_a_cantilever_are_right_however_stiff_it_is(stiff, ratio, error):
    """Small forces; rounding errors of the strains times the stiffness are what is left of them."""
    along, across = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    section = fb.Section(**{"EA": 1e6, "GA": 1e6, "EI": 1e4, stiff: ratio * 1e6})
    scene, beam = clamped_bar(tuple(2 * along), section, elements=8)
    scene.add_force(beam.end, tuple(0.1 * along - 0.1 * across))
    r = fb.static(scene, load_steps=1).resultants(beam)
    np.testing.assert_allclose(r.N[-1], 0.1, rtol=error)
    np.testing.assert_allclose(r.Q[-1], -0.1, rtol=error)
    np.testing.assert_allclose(r.M[-1], -0.1 * (2.0 - r.s), rtol=error)
