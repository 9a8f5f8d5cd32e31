"""Load steps: closed forms, orders, energy, the control of steps, and what statics leaves out."""

import ufl

import numpy as np
import pytest
import scipy.sparse
from registry import ONES, SCENES
from scenes import assert_refused, held_body, one_bar, pinned_bar, supported_bar

import fx_beam as fb
from fx_beam.step.stepper import LoadLoop

ROLLED = fb.Section(EA=1e4, GA=1e4, EI=500.0)
LENGTH = 10.0
# Tip of the elastica under a dead force P: P L^2/EI, then v/L, u/L and slope, from the elliptic
# integrals of the inextensible beam that is rigid in shear.
ELASTICA = [
    (1.0, (0.301721, 0.056433, 0.461352)),
    (5.0, (0.713792, 0.387628, 1.215368)),
    (10.0, (0.810609, 0.554996, 1.430286)),
]


def cantilever(section, elements=8, degree=2, length=1.0, **options):
    scene = fb.Scene(**options)
    beam = scene.add_beam([(0, 0), (length, 0)], section, elements=elements, degree=degree)
    scene.clamp(beam.start)
    return scene, beam


def bent(section, elements, degree, load=5.0, steps=5):
    """Tip displacement and rotation of a cantilever under a dead force, and the solution."""
    scene, beam = cantilever(section, elements, degree)
    scene.add_force(beam.end, (0.0, -load))
    solution = fb.static(scene, load_steps=steps)
    tip = *solution.displacement(beam.end)[-1], solution.rotation(beam.end)[-1]
    return np.array(tip), solution


# -- Closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize(("load", "exact"), ELASTICA)
def test_the_elastica_is_met(load, exact):
    (u, v, turn), solution = bent(fb.Section(EA=1e8, GA=1e8, EI=1.0), 32, 2, load)
    assert solution.t is solution.load_factor and "load factor 1" in repr(solution)
    assert not solution.v.any() and not solution.a.any()
    assert (-v, -u, -turn) == pytest.approx(exact, abs=2e-6)  # of which 1e-6 is the table's


@pytest.mark.parametrize(("degree", "elements"), [(1, 8), (2, 4)])
def test_slenderness_does_not_lock(degree, elements):
    errors = []
    for slenderness in (1e-1, 1e-3, 1e-5):
        EA = 12 / slenderness**2  # of a rectangle with EI = 1
        section = fb.Section(EA=EA, GA=EA * 5 / 6 / 2.6, EI=1.0)
        fine, _ = bent(section, 48, 2)
        errors.append(abs(bent(section, elements, degree)[0] - fine).max())
    assert max(errors) < 2 * min(errors)


# -- Energy ------------------------------------------------------------------------------------


def test_the_work_of_the_loads_is_the_strain_energy_to_second_order_in_the_steps():
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0)
    gaps = []
    for steps in (10, 20, 40):
        energy = bent(section, 4, 2, steps=steps)[1].energy
        gaps.append(abs(energy.balance_error[-1]) / energy.strain[-1])
    assert gaps[0] < 0.01
    assert np.log2(gaps[1] / gaps[2]) == pytest.approx(2, abs=0.05)


def test_weight_is_lowered_in_and_its_potential_counts_in_full():
    scene, beam = cantilever(fb.Section(EA=1e6, GA=1e6, EI=1.0, rhoA=0.02), 4, gravity=(0.0, -10.0))
    scene.add_mass(beam.end, 0.01)
    solution = fb.static(scene, load_steps=20)
    q, P = 0.2, 0.1
    assert -solution.displacement(beam.end)[-1, 1] == pytest.approx(q / 8 + P / 3, rel=1e-2)
    assert solution.reaction(beam.start)[-1, 1] == pytest.approx(q + P)
    energy = solution.energy
    assert energy.potential[-1] < -0.9 * energy.strain[-1]
    assert abs(energy.balance_error).max() < 1e-3 * energy.strain[-1]
    # Nothing of inertia is compiled or assembled.
    always = {"internal forces", "tangent", "strain energy", "inverted sections"}
    assert set(solution.stats.compiled) == always
    assert set(solution.stats.assembled) == {"gravity"}


# -- The same scene ------------------------------------------------------------------------------


def test_prescribed_motion_is_scaled_and_does_the_work():
    scene, beam = cantilever(ROLLED, 4, 2, LENGTH)
    scene.prescribe(beam.end, rotation=lambda t: 2 * np.pi * t)
    scene.add_force(beam.node(0.5), lambda t: (0.0, 1.0 - t))
    solution = fb.static(scene, t=1.0)  # when the force is gone
    assert solution.rotation(beam.end) == pytest.approx(2 * np.pi * solution.load_factor)
    moment = 2 * np.pi * ROLLED.EI / LENGTH
    assert solution.reaction(beam.end)[-1] == pytest.approx([0, 0, moment], abs=1e-8)
    assert solution.energy.work[-1] == pytest.approx(np.pi * moment)
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.strain[-1]


def test_a_slide_on_a_bent_beam_stays_on_it_and_does_no_work():
    section = fb.Section(EA=1e4, GA=1e4, EI=5.0)
    scene, rail = cantilever(section, 4, 1)
    rod = scene.add_beam([(1.3, 0), (2.3, 0)], section, elements=2)
    joint = scene.add_joint(fb.Prismatic(rail.end, rod.start, axis=(1, 0), spring=fb.Spring(40.0)))
    scene.add_force(rod.end, (3.0, -2.0))
    solution = fb.static(scene, load_steps=40)
    assert solution.joint(joint).gap.max() < 1e-14
    along = np.array([np.cos(solution.rotation(rail.end)), np.sin(solution.rotation(rail.end))])
    # The spring is stretched by 0.3 m as it is drawn; what holds it there fades as the load rises.
    pull = solution.load_factor * (np.array([3.0, -2.0]) @ along)
    pull += (1 - solution.load_factor) * 40.0 * 0.3
    assert 40.0 * solution.joint(joint).slide == pytest.approx(pull, rel=1e-9)
    assert abs(solution.energy.balance_error[-1]) < 1e-3 * abs(solution.energy.work[-1])


def test_a_motor_turns_a_crank_against_a_load():
    scene, crank = one_bar((1, 0), fb.Section(EA=1e6, GA=1e6, EI=1e6), elements=1)
    joint = scene.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=lambda t: t))
    scene.add_force(crank.end, (0.0, -3.0))
    solution = fb.static(scene, load_steps=20, t=np.pi / 2)
    assert solution.position(crank.end)[-1] == pytest.approx([0, 1], abs=1e-5)
    factor, angle = solution.load_factor, solution.rotation(crank.end)
    assert solution.joint(joint).force[:, 2] == pytest.approx(3 * factor * np.cos(angle), abs=1e-4)
    # What the motor does, the load takes up.
    assert solution.energy.work[-1] == pytest.approx(solution.energy.strain[-1], abs=1e-2)


WAYS = pytest.mark.parametrize("way", [None, "arc-length"])


def sprung(joint, spring, held=False, **axis):
    """Two cantilevers, or one and an arm, end to end with a spring between them and no load."""
    scene, left = cantilever(fb.Section(EA=1e5, GA=1e5, EI=10.0), 4, 1)
    right = scene.add_beam([(1, 0), (2, 0)], left.section, elements=4)
    if held:
        scene.clamp(right.end)
    made = scene.add_joint(joint(left.end, right.start, **axis, spring=spring))
    return scene, left, right, made


@WAYS
@pytest.mark.parametrize("rest", [0.5, 2.5])
def test_a_spring_without_load_turns_an_arm_to_its_rest(way, rest):
    """The force that holds the spring as it is drawn fades with the load factor."""
    scene, _, arm, _ = sprung(fb.Revolute, fb.Spring(5.0, rest))
    scene.add_force(arm.end, lambda t: (0.0, 3.0 * t))  # none at the time 0
    solution = fb.static(scene, continuation=way)
    assert solution.load_factor[-1] == 1
    assert solution.rotation(arm.end) == pytest.approx(rest * solution.load_factor, abs=1e-12)
    left = 5.0 / 2 * (rest * (1 - solution.load_factor)) ** 2
    assert solution.energy.total == pytest.approx(left, abs=1e-12)
    assert solution.energy.balance_error == pytest.approx(np.zeros(len(solution.t)), abs=1e-12)


@WAYS
def test_a_stiff_spring_is_let_go_in_steps_and_balances_the_beams(way):
    scene, left, right, joint = sprung(fb.Prismatic, fb.Spring(100.0, 0.2), True, axis=(0, 1))
    solution = fb.static(scene, continuation=way)
    slide = solution.joint(joint).slide
    # The spring's force, less what is left of the one that holds it as it is drawn.
    push = 100.0 * (0.2 - slide) - (1 - solution.load_factor) * 100.0 * 0.2
    turned = solution.rotation(left.end)
    across = np.column_stack([-np.sin(turned), np.cos(turned)])
    for beam_end, sign in ((left.start, 1), (right.end, -1)):
        force = solution.reaction(beam_end)[:, :2]
        assert sign * np.sum(force * across, axis=1) == pytest.approx(push, rel=1e-9, abs=1e-9)
    # What the spring gives way, the beams take up: by hand, 24 EI/L^3 for small displacements,
    # and more where these stretch the beams as much as here.
    assert 0.1 < slide[-1] < 0.2 * 100 / (100 + 24 * 10 / 2**3)
    finer = fb.static(scene, load_steps=40).joint(joint).slide
    assert finer[-1] == pytest.approx(slide[-1], rel=1e-9)
    assert (np.diff(slide) > 0).all()
    assert abs(solution.energy.balance_error).max() < 1e-3 * solution.energy.total[0]


def test_a_force_of_ones_own_is_a_load_by_the_load_factor_and_else_a_spring():
    scene, beam = one_bar((1, 0), fb.Section(EA=1e6, GA=1e6, EI=1e6), elements=1)
    scene.fix(beam.start, "x", "rotation")
    scene.fix(beam.end, "rotation")
    scene.add_virtual_work(lambda step: -50.0 * step.u[1] * step.virtual_u[1])
    scene.add_virtual_work(lambda step: -2.0 * step.load_factor * step.virtual_u[1])
    scene.add_virtual_work(lambda step: -7.0 * ufl.dot(step.v, step.virtual_u))  # at rest nothing
    solution = fb.static(scene, load_steps=4)
    assert solution.displacement(beam.end)[:, 1] == pytest.approx(-0.04 * solution.load_factor)
    assert abs(solution.energy.balance_error).max() < 1e-12


# -- What statics leaves out ---------------------------------------------------------------------


def test_dampers_hold_nothing():
    def hinged(**acting):
        scene, beam = cantilever(ROLLED, 1)
        arm = scene.add_beam([(1, 0), (2, 0)], ROLLED, degree=2, elements=1)
        scene.add_joint(fb.Revolute(beam.end, arm.start, **acting))
        scene.add_moment(arm.end, 1.0)
        return fb.static(scene, load_steps=1).rotation(arm.end)[-1]

    spring = fb.Spring(20.0)
    assert hinged(spring=spring, damper=fb.Damper(1e3)) == hinged(spring=spring)
    with pytest.raises(
        fb.SceneError, match="Static analysis is singular: beam 'beam 2' can rotate about"
    ):
        hinged(damper=fb.Damper(1e3))


# -- Control of the steps ------------------------------------------------------------------------


def test_steps_are_cut_where_they_fail_and_grow_where_they_are_easy():
    section = fb.Section(EA=12e8, GA=4e8, EI=1.0)
    tip, solution = bent(section, 8, 2, load=50.0, steps=1)
    sizes = np.diff(solution.load_factor)
    assert solution.load_factor[-1] == 1
    assert solution.stats.halvings >= 3
    assert sizes[0] <= 1 / 8
    assert sizes[-1] >= 8 * sizes[0]
    assert solution.stats.steps == len(sizes)
    even, _ = bent(section, 8, 2, load=50.0, steps=40)
    assert tip == pytest.approx(even, abs=1e-9)


def test_a_step_that_may_be_cut_no_more_ends_in_an_error_with_what_was_found():
    scene, beam = cantilever(ROLLED, 4, 1, LENGTH)
    scene.add_moment(beam.end, lambda t: 4 * np.pi * ROLLED.EI / LENGTH)
    with pytest.raises(fb.StepError, match="turns by .* more than max_turn = 2") as caught:
        fb.static(scene, load_steps=4, max_cuts=0)
    assert caught.value.time == 0
    assert len(caught.value.solution.t) == 1
    assert_refused("after 1 cuts", fb.static, scene, load_steps=2, max_cuts=1, error=fb.StepError)


@pytest.mark.parametrize("steps", [1, 25])
def test_loads_over_a_limit_point_end_in_an_error_that_names_the_continuation(steps):
    # Two bars in a flat triangle, half of it: the limit load of the shallow truss in closed form.
    EA, rise = 1e4, 0.2
    scene, bar = supported_bar((1, rise), fb.Section(EA=EA, GA=EA, EI=1e3), elements=2, held="x")
    length = np.hypot(1, rise)
    at_limit = length ** (1 / 3)
    limit = EA * np.sqrt(at_limit**2 - 1) * (1 / at_limit - 1 / length)
    scene.add_force(bar.end, (0.0, -3 * limit))
    with pytest.raises(fb.StepError, match="limit point.*continuation") as caught:
        fb.static(scene, load_steps=steps)
    error = caught.value
    assert f"from load factor {error.time:.6g}" in str(error)
    assert "times that of the first step, which indicates a limit point" in str(error)
    assert error.time == error.solution.load_factor[-1]
    assert 0.98 < 3 * error.time < 1
    assert (error.solution.position(bar.end)[:, 1] > np.sqrt(at_limit**2 - 1)).all()


@pytest.mark.parametrize("steps", [1, 10, 50])
def test_a_snap_much_shorter_than_a_step_does_not_pass_unseen(steps):
    # A shallow arch, pushed off its middle: at 50 steps it snaps within the second one.
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=5e3, EI=1.0)
    arch = scene.add_beam(lambda f: (f, 0.023 * np.sin(np.pi * f)), section, 8, 2)
    scene.pin(arch.start)
    scene.pin(arch.end)
    scene.add_force(arch.node(0.625), (0.0, -58.64))
    snaps, back = fb.static(scene, continuation="arc-length").stats.limit_points
    assert 0 < snaps - back < 0.1 * snaps + 1e-3
    with pytest.raises(fb.StepError, match="continuation") as caught:
        fb.static(scene, load_steps=steps)
    assert caught.value.time < snaps


@pytest.mark.parametrize("stiffness", [1e3, 1e9])
def test_a_beam_that_stiffens_as_a_cable_needs_no_short_steps(stiffness):
    # For large loads a string: its two halves of length 1/2 pull with EA (1/cos - 1) sin each.
    section = fb.Section(EA=stiffness, GA=stiffness, EI=1e-6 * stiffness)
    scene, string = supported_bar((1, 0), section, elements=16, held="xy")
    load = 0.01 * stiffness
    scene.add_force(string.node(0.5), (0.0, -load))
    solution = fb.static(scene, load_steps=1)
    assert solution.stats.steps < 20
    angle = np.arctan(-2 * solution.displacement(string.node(0.5))[-1, 1])
    assert 2 * stiffness * (1 / np.cos(angle) - 1) * np.sin(angle) == pytest.approx(load, rel=0.05)
    energy = solution.energy
    assert abs(energy.balance_error[-1]) < 0.1 * energy.strain[-1]


def test_rates_are_zero_for_a_force_that_depends_on_them():
    scene, ball = held_body((1, 0), 1.0, 1.0, "y", "rotation")
    scene.add_force_between(ball, (0, 0), fb.Spring(100.0, 1.0), force=lambda r, rate, t: 5 * rate)
    scene.add_force(ball, (10.0, 0.0))
    assert fb.static(scene).displacement(ball)[-1, 0] == pytest.approx(0.1)


# -- Errors --------------------------------------------------------------------------------------


def test_a_load_that_fails_at_its_time_is_named():
    scene, beam = cantilever(ROLLED, 1)
    scene.add_force(beam.end, lambda t: (0.0, 1.0 / (1.0 - t)))
    with pytest.raises(fb.StepError, match="force on node 1 .* at t = 1 raised ZeroDivision"):
        fb.static(scene, t=1.0)


def test_without_equilibrium_at_the_start_the_error_says_so():
    scene, beam = one_bar((1, 0), ROLLED, elements=1)
    scene.add_virtual_work(lambda step: step.load_factor * step.virtual_u[1])
    scene.fix(beam.start, "x")
    assert_refused("can move along .* under its loads it finds no", fb.static, scene)


@pytest.mark.parametrize("down", [0.1, 0.2, 0.5])
def test_an_arch_that_is_pressed_down_stays_on_its_path_however_long_the_steps(down):
    """Its path has no limit point; others that are symmetric as well are unstable."""
    reactions = []
    for steps in (3, 6, 20):
        section = fb.Section(EA=1e4, GA=4e3, EI=1.0)
        scene, left = pinned_bar((1, 0.2), section, elements=6, degree=2)
        right = scene.add_beam([left.end, (2, 0)], section, elements=6, degree=2)
        scene.pin(right.end)
        scene.fix(left.end, "x", "rotation")
        scene.prescribe(left.end, y=lambda t: -down)
        path = fb.static(scene, load_steps=steps)
        assert path.stable.all()
        reactions.append(path.reaction(left.end)[-1, 1])
    assert reactions == [pytest.approx(reactions[-1], rel=1e-6)] * 3


@pytest.mark.parametrize(
    ("name", "has_potential"),
    [
        ("curved tapered beam", True),
        ("natural strains", True),
        ("curved beam on a bed", True),
        ("revolute with spring and damper", True),
        ("stop of a joint", True),
        ("winch on a rope over circles", True),
        ("follower force", False),
        ("line obstacle with friction", False),
    ],
)
def test_factors_are_those_of_a_symmetric_matrix_where_forces_have_a_potential(
    name, has_potential, monkeypatch
):
    tangents, step = [], LoadLoop.step

    def noted(loop, *arguments):
        taken = step(loop, *arguments)
        assert loop.problem.storage.factors.rows["symmetric"] == has_potential
        indptr, indices = loop.model.reduction.tangent.pattern
        tangents.append(scipy.sparse.csr_matrix((loop.values.copy(), indices, indptr)))
        return taken

    monkeypatch.setattr(LoadLoop, "step", noted)
    fb.static(SCENES[name].build(ONES), load_steps=2)
    gaps = [abs(K - K.T).max() / abs(K).max() for K in tangents]
    assert len(gaps) >= 3
    assert (max(gaps) < 1e-14) == has_potential
