"""What holds for every scene: balances, momenta, and that each way to the same motion gives it."""

import copy

import numpy as np
import pytest
from plain_step import assert_balanced
from registry import ONES, SCENES

import fx_beam as fb

every_scene = pytest.mark.parametrize("case", SCENES.values(), ids=lambda case: case.name)
#: Schemes whose energy is exact for every section.
EXACT = ("EnergyMomentum", "EnergyDecaying")
ROWS = ("t", "q", "v", "a", "slides", "reactions", "joint_forces")


def assert_same(solution, other, digits=1e-10):
    """Equal motion and forces, each to its size."""
    for name in ROWS:
        values = getattr(solution, name)
        size = max(abs(values).max(initial=0.0), 1e-3)
        assert getattr(other, name) == pytest.approx(values, rel=0, abs=digits * size), name
    energy = solution.energy.total
    assert other.energy.total == pytest.approx(
        energy, rel=0, abs=digits * max(abs(energy).max(), 1)
    )


@pytest.fixture(scope="module")
def motions():
    """The motion of each scene, computed once."""
    return {}


@pytest.fixture
def motion(motions, case):
    if case.name not in motions:
        motions[case.name] = case.simulate()
    return motions[case.name]


@every_scene
def test_the_energy_balance_is_exact(case, motion):
    energy = motion.energy
    size = max(energy.kinetic.max(), energy.strain.max())
    exact = case.scheme().name.startswith(EXACT)
    assert abs(energy.balance_error).max() < (1e-12 if exact else 1e-3) * size
    assert (np.diff(energy.dissipated) >= -1e-14 * size).all()
    assert abs(motion.q - motion.q[0]).max() > 1e-3  # it moves


@pytest.mark.parametrize("name", [case.name for case in SCENES.values() if case.free])
def test_what_moves_freely_keeps_both_momenta(name):
    solution = SCENES[name].simulate()
    assert abs(solution.linear_momentum[0]).max() > 0.1
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-12
    assert np.ptp(solution.angular_momentum) < 1e-12


@every_scene
def test_a_step_takes_few_iterations_and_is_not_halved(case, motion):
    # A tangent that is not the derivative of the residual takes tens.
    parts = len(case.scheme().fractions)
    friction = "friction that follows" in case.name  # a fixed point beside Newton
    assert motion.stats.newton_iterations <= (9 if friction else 4.5) * parts * case.steps
    assert motion.stats.halvings == 0


@every_scene
def test_a_motion_in_two_parts_is_the_motion(case, motion):
    half = case.steps // 2
    first = case.simulate(t_end=half * case.dt)
    assert np.array_equal(first.q, motion.q[: half + 1])  # whatever its end
    assert_same(motion, first.then(case.simulate(start=first)), 1e-9)


@every_scene
def test_step_by_step_is_the_motion(case, motion):
    stepwise = fb.Motion(case.build(ONES), case.scheme(), dt=case.dt, record=fb.Record())
    stepwise.run(case.steps * case.dt)
    assert_same(motion, stepwise.solution())


@every_scene
def test_a_file_has_the_motion(case, motion, tmp_path):
    motion.save(tmp_path / "motion.npz")
    assert_same(motion, fb.load(tmp_path / "motion.npz"), 0.0)


@every_scene
def test_copies_of_a_scene_move_as_it(case, motion):
    assert_same(motion, case.simulate(scene=copy.deepcopy(case.build(ONES))), 0.0)


@every_scene
def test_nodes_are_in_balance_with_supports_and_closed_joints(case):
    if len((scheme := case.scheme()).fractions) > 1:
        pytest.skip("sub-steps, of which those without have all parts")
    assert_balanced(case.build(ONES), scheme, dt=case.dt, t_end=case.steps * case.dt)
