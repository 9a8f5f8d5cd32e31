"""What holds for every scene: balances, momenta, and that each way to the same motion gives it."""

import copy

import numpy as np
import pytest
from plain_step import assert_balanced
from registry import ONES, SCENES
from scenes import clamped_bar

import fx_beam as fb

every_scene = pytest.mark.parametrize("case", SCENES.values(), ids=lambda case: case.name)
#: Schemes whose energy is exact for every section.
EXACT = ("EnergyMomentum", "EnergyDecaying")
ROWS = (
    "t",
    "t_level",
    "q",
    "v",
    "a",
    "slides",
    "linear_momentum",
    "angular_momentum",
    "parameters",
)
FORCES = ("reactions", "motor_forces", "joint_forces", "contact_forces", "line_forces")
ENERGIES = ("total", "kinetic", "springs", "potential", "dissipated", "work", "impact")


def assert_same(solution, other, digits=1e-10):
    """Equal motion and forces, each to its size."""
    for name in ROWS + FORCES:
        values = getattr(solution, name)
        size = max(abs(values).max(initial=0.0), 1e-3)
        assert getattr(other, name) == pytest.approx(values, rel=0, abs=digits * size), name
    size = max(abs(solution.energy.total).max(), 1)
    for name in ENERGIES:
        values = getattr(solution.energy, name)
        assert getattr(other.energy, name) == pytest.approx(values, rel=0, abs=digits * size), name


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
def test_a_motion_in_two_parts_is_the_motion(case, motion, tmp_path):
    half = case.steps // 2
    first = case.simulate(t_end=half * case.dt)
    assert np.array_equal(first.q, motion.q[: half + 1])  # whatever its end
    first.save(tmp_path / "first.npz")
    for start in (first, fb.load(tmp_path / "first.npz")):
        assert_same(motion, start.then(case.simulate(start=start)), 1e-9)


@every_scene
def test_step_by_step_is_the_motion_also_from_a_snapshot_on(case, motion):
    stepwise = fb.Motion(case.build(ONES), case.scheme(), dt=case.dt, record=fb.Record())
    stepwise.run(case.steps // 2 * case.dt)
    middle, first = stepwise.snapshot(), stepwise.solution()
    stepwise.run(case.steps * case.dt)
    assert_same(motion, stepwise.solution())
    stepwise.restore(middle)  # here its record begins anew
    stepwise.run(case.steps * case.dt)
    assert_same(motion, first.then(stepwise.solution()), 1e-9)


@every_scene
def test_a_file_has_the_motion(case, motion, tmp_path):
    motion.save(tmp_path / "motion.npz")
    assert_same(motion, fb.load(tmp_path / "motion.npz"), 0.0)


@every_scene
def test_copies_of_a_scene_move_as_it(case, motion):
    assert_same(motion, case.simulate(scene=copy.deepcopy(case.build(ONES))), 0.0)


@every_scene
def test_what_stands_far_away_changes_nothing(case, motion, monkeypatch):
    """A held body far away changes the size of a scene and numbers of nodes, not the motion."""

    class Beside(fb.Scene):
        def __init__(self, gravity=None):
            super().__init__(gravity)
            self.clamp(self.add_body((0, 30), mass=1.0, inertia=0.1).centre)

    monkeypatch.setattr(fb, "Scene", Beside)
    solution = case.simulate()
    assert solution.stats.halvings == 0
    for name in ("q", "v", "a", "slides", *FORCES):
        values, beside = getattr(motion, name), getattr(solution, name)
        size = max(abs(values).max(initial=0.0), 1e-3)
        beside = beside[:, -values.shape[1] :] if values.size else beside
        assert beside == pytest.approx(values, rel=0, abs=1e-5 * size), name


@every_scene
def test_nodes_are_in_balance_with_supports_and_closed_joints(case):
    if len((scheme := case.scheme()).fractions) > 1:
        pytest.skip("sub-steps, of which those without have all parts")
    assert_balanced(case.build(ONES), scheme, dt=case.dt, t_end=case.steps * case.dt)


def untouched(scene):
    """Arc lengths of inner nodes on which nothing acts, by beam; none beside contact and slides."""
    if scene.contacts or any(type(joint) is not fb.Joint for joint in scene.joints):
        return {}
    touched = {number for line in scene.forces_between for number in line.nodes}
    touched |= {row.node for row in scene.masses}
    ends = [node for joint in scene.joints for node in (joint.a, joint.b)]
    touched |= {node.number for node in ends if node is not fb.GROUND}
    touched |= {n for n, _ in scene.fixed} | {n for n, _ in scene.prescribed}
    targets = (action.target for action in (*scene.loads, *scene.drags))
    acting = [target for target in targets if isinstance(target, fb.Node)]
    touched |= {node.number for node in acting}
    return {
        beam.name: [
            s
            for s, node in zip(beam.s[1:-1], beam.nodes[1:-1], strict=True)
            if node.number not in touched
        ]
        for beam in scene.beams
        if not beam.carriers
    }


@every_scene
def test_section_forces_go_on_through_nodes_on_which_nothing_acts(case, motion):
    """The forces of both elements are one and the other, at a corner in other directions."""
    for name, s in untouched(case.build(ONES)).items():
        forces = motion.resultants(name)
        before, after = (forces.at(s, side) for side in ("before", "after"))
        most = max(abs(rows).max(initial=1e-3) for rows in (forces.N, forces.Q, forces.M))
        for one, other in (
            (np.hypot(before.N, before.Q), np.hypot(after.N, after.Q)),
            (before.M, after.M),
        ):
            assert one == pytest.approx(other, abs=1e-8 * most)


def test_section_forces_of_a_cantilever_and_the_energy_of_what_holds_it():
    """M is P L at the clamp; a spring at the tip takes k w of P and stores k w^2 / 2."""
    scene, beam = clamped_bar((2, 0), fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=1)
    held = scene.add_spring(beam.end, y=fb.Spring(300.0))
    scene.add_force(beam.end, (0.0, 10.0))
    solution = fb.static(scene, linear=True)
    spring_energy, ends = solution.joint(held.y), solution.resultants(beam).ends
    w = spring_energy.length[-1]
    assert spring_energy.force[-1] == pytest.approx(300.0 * w)
    assert spring_energy.energy[-1] == pytest.approx(150.0 * w**2)
    assert ends.Q[-1] == pytest.approx([10.0 - 300.0 * w] * 2)
    assert ends.M[-1] == pytest.approx([2 * (10.0 - 300.0 * w), 0.0], abs=1e-9)
    measured = {name: fb.Output(name, held.y) for name in ("length", "rate", "force")}
    assert all("force 0" in str(output) for output in measured.values())
