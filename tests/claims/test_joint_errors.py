"""Joints that cannot be right are refused by their names, before anything runs."""

import math
import re

import pytest
from jointed import MEMBER, pair, throw
from scenes import assert_refused, one_bar, pinned_bar

import fx_beam as fb

MASSLESS = fb.Section(EA=1e4, GA=1e4, EI=100.0)


def beams():
    """Beams that start at the same point."""
    scene = fb.Scene()
    return scene, [
        scene.add_beam([(0, 0), (math.cos(i), math.sin(i))], MEMBER, elements=2) for i in range(3)
    ]


def run(scene, dt=0.1, t_end=0.1, **options):
    return fb.simulate(scene, None, dt=dt, t_end=t_end, **options)


# -- A joint by itself ---------------------------------------------------------------------------


def half(t):
    return t + 0.5


GROUND, OTHER = fb.GROUND, fb.Scene().add_beam([(0, 0), (1, 0)], MEMBER, elements=1)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda a, b: fb.Rigid(a.end, b.start), "Rigid of node 2 .* and node 3 at .*gap of 1 "),
        (lambda a, b: fb.Revolute(a.start, b.start, offset=(0.3, 0.4)), "gap of 0.5 "),
        (lambda a, b: fb.PinInSlot(a.end, b.end, axis=(1, 0)), "PinInSlot of .*gap of 0.8415"),
        (lambda a, b: fb.Revolute(a.start, a.start), r"both of its nodes are node 0 at \(0, 0\)"),
        (lambda a, b: fb.Rigid(GROUND, GROUND), "both of its nodes are the ground"),
        (lambda a, b: fb.Revolute(a.start, (0, 0)), r"Revolute: \(0, 0\) is not a node"),
        (lambda a, b: fb.PinInSlot(a.start, b.start, axis=(math.nan, 0)), r"axis: \(nan, 0\)"),
        (lambda a, b: fb.Rigid(a.start, b.start, offset=1.0), "Rigid: offset: 1.0"),
        (lambda a, b: fb.Rigid(GROUND, b.start, offset=(1, 0)), "the ground takes no offset"),
        (lambda a, b: fb.Revolute(a.start, b.start, spring=30.0), "must be an fx_beam.Spring"),
        (lambda a, b: fb.Revolute(a.start, b.start, damper=fb.Spring(1.0)), "fx_beam.Damper"),
        (lambda a, b: fb.Revolute(a.start, b.start, motor=lambda t: 1 / t), "motor .*: call"),
        (lambda a, b: fb.Revolute(a.start, b.start, motor=lambda t: (t, t)), "motor of a revolute"),
        (lambda a, b: fb.Spring(1.0, rest=math.nan), "rest = nan must be finite"),
        (lambda a, b: fb.Damper("soft"), "viscosity = 'soft' must be finite"),
        (
            lambda a, b: fb.Prismatic(a.start, b.start, axis=(1, 0), motor=half),
            "Prismatic of .*: the motor of its slide is 0.5 at t = 0; it must start from 0",
        ),
        (
            lambda a, b: fb.PinInSlot(a.start, b.start, (1, 0), hinge=fb.Coordinate(motor=half)),
            "PinInSlot of .*: the motor of its rotation is 0.5 at t = 0",
        ),
        (lambda a, b: fb.Revolute(OTHER.start, b.start), "Revolute: node 0 .* to another scene"),
        (lambda a, b: fb.Rigid(GROUND, OTHER.start), "Rigid: node 0 at .* to another scene"),
        (lambda a, b: (a.start, b.start), "add_joint needs a joint such as fx_beam.Revolute"),
    ],
)
def test_an_invalid_joint_is_refused(build, message):
    scene, (a, b, _) = beams()
    assert_refused(message, lambda: scene.add_joint(build(a, b)))


@pytest.mark.parametrize("size", [1e-9, 1e3])
def test_rounding_at_the_start_of_a_motion_is_none_in_any_unit(size):
    def of(start):
        section = fb.Section(EA=1e4, GA=1e4, EI=100.0 * size**2, rhoA=1.0, rhoI=0.1 * size**2)
        scene, beam = one_bar((size, 0), section, elements=1)
        other = scene.add_beam([(0, 0), (0, size)], section, elements=1)
        scene.add_joint(
            fb.Prismatic(fb.GROUND, beam.start, (1, 0), motor=lambda t: size * (start + t**2))
        )
        turn = lambda t: start + t**2  # noqa: E731
        scene.add_joint(fb.Revolute(beam.end, other.end, (-size, size), motor=turn))
        scene.prescribe(beam.end, y=lambda t: size * (start - t**2))
        return scene

    exact, rounded = run(of(0.0)), run(of(1e-16))
    assert rounded.q[:, :, :2] == pytest.approx(exact.q[:, :, :2], rel=0, abs=1e-9 * size)
    assert exact.q[-1, 0, 0] == pytest.approx(0.01 * size)
    assert_refused("motor of its slide is .* at t = 0; it must start from 0", of, 1e-6)
    scene = of(0.0)
    scene.prescribe(scene.beams[1].start, x=lambda t: 1e-4 * size)
    assert_refused("prescribed x of node 2 .* at t = 0", run, scene)


# -- Joints together -----------------------------------------------------------------------------


def guide(a, b):
    return fb.Prismatic(a, b, axis=(1, 0))


def slot_with_two_motors(a, b):
    hinge = fb.Coordinate(motor=lambda t: t)
    return fb.PinInSlot(a, b, axis=(1, 0), motor=lambda t: t, hinge=hinge)


FIXED = {0: ("x", "y"), 2: ("x",)}
TURNS = {0: ("x", "y", "rotation"), 1: ("rotation",)}


@pytest.mark.parametrize(
    ("ends", "fixed", "message"),
    [
        ([(0, 1), (1, 2), (2, 0)], {}, "over-constrained: .*joint 0, .*1, .*2, .*close a loop"),
        ([(0, 1), (1, 0, fb.Rigid)], {}, "joint 0, Revolute of node 0.*1, Rigid of node 3.*a loop"),
        ([(-1, 0), (0, 1), (1, -1)], {}, "joint 0, Revolute of the ground .*a loop"),
        (
            [(0, 1), (1, 2)],
            FIXED,
            "joint 0, .*joint 1, .*the displacement in x of node 0 .* and of node 6 .* both "
            "supported; support one of",
        ),
        ([(-1, 2)], FIXED, "displacement in x of the ground and of node 6 .* both supported"),
        ([(0, 1, fb.Rigid)], TURNS, "rotation of node 0 .* and of node 3 .* are both supported"),
        ([(0, 1, guide)], TURNS, "rotation of node 0 .* and of node 3 .* are both supported"),
        ([(0, 1, slot_with_two_motors)], {}, "joint 0, PinInSlot of .*it has two motors"),
    ],
)
def test_joints_that_hold_a_component_twice_are_refused_with_their_names(ends, fixed, message):
    scene, members = beams()
    for i, components in fixed.items():
        scene.fix(members[i].start, *components)
    nodes = [*(beam.start for beam in members), fb.GROUND]
    for i, j, *make in ends:
        scene.add_joint((make or [fb.Revolute])[0](nodes[i], nodes[j]))
    assert_refused(message, run, scene)


def test_an_arm_that_is_held_names_both_supports_and_with_one_of_them_carries_the_load():
    # A slide in its loop would not help: no motion of the arm is left.
    for twice in (True, False):
        scene = fb.Scene()
        base = scene.add_body((0, 0), 1.0, 1.0).centre
        tip = scene.add_body((2, 0), 1.0, 1.0).centre
        scene.fix(base, "x", "rotation", *["y"] * twice)
        scene.fix(tip, "y")
        scene.add_joint(fb.Revolute(base, tip, offset=(2, 0)))
        scene.add_force(base, (0.0, -3.0))
        if twice:
            message = r"displacement in y of node 0 .* and of node 1 .* are both supported; support"
            assert_refused(message, fb.static, scene)
        else:
            scene.fix(tip, "rotation")
            assert fb.static(scene).reaction(tip)[-1] == pytest.approx([0.0, 3.0, 0.0], abs=1e-12)


def test_rotations_fixed_at_both_ends_of_a_hinge_are_accepted():
    scene, (a, b, _) = beams()
    scene.clamp(a.start)
    scene.fix(b.start, "rotation")
    scene.add_joint(fb.Revolute(a.start, b.start))
    assert run(scene).stats.unknowns == 3 * 9 - 3 - 1 - 2


# -- Runs ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "motor", [lambda t: t**2 if t < 0.35 else math.nan, lambda t: {0: t**2}[int(t > 0.35)]]
)
def test_a_motor_that_fails_later_keeps_the_steps_before(motor):
    scene, (a, b, _) = beams()
    scene.pin(a.start)
    scene.add_joint(fb.Revolute(a.start, b.start, motor=motor))
    with pytest.raises(fb.StepError, match="motor of joint 0, Revolute of .*at t = 0.4") as error:
        run(scene, t_end=1.0)
    assert error.value.solution.t == pytest.approx([0, 0.1, 0.2, 0.3])


def test_histories_of_joints_are_refused_for_what_is_no_joint_of_the_solution():
    scene, (a, b, c) = beams()
    made = fb.Revolute(a.start, b.start)
    hinge = scene.add_joint(made)
    scene.add_joint(fb.PinInSlot(b.start, c.start, axis=(1, 0)))
    solution = run(scene)
    with pytest.raises(ValueError, match="joint 0, Revolute of .* has no slide"):
        _ = solution.joint(hinge).slide
    for history in (lambda joint: solution.joint(joint).force, solution.joint):
        with pytest.raises(ValueError, match="not a joint of this solution; take the one"):
            history(made)
        assert_refused("not a joint of this solution", history, "hinge", error=ValueError)
    with pytest.raises(ValueError, match="not a node of this solution"):
        solution.joint(pair("prismatic with offset")[3])


# -- Mechanisms without mass ---------------------------------------------------------------------


def test_a_massless_mechanism_is_refused_but_may_carry_a_mass():
    # Massless bars from (0, 0) over (1, 1) to a slider on the x axis.
    scene, first = pinned_bar((1, 1), MASSLESS, elements=1, gravity=(0, -9.81))
    second = scene.add_beam([(1, 1), (2, 0)], MASSLESS, elements=1)
    scene.add_joint(fb.Revolute(first.end, second.start))
    scene.add_joint(fb.PinInSlot(fb.GROUND, second.end, axis=(1, 0)))
    assert_refused(r"beam .* can rotate about .*without mass or support", run, scene)
    scene.add_mass(first.end, 1.0)
    solution = run(scene, dt=0.01, t_end=0.3)
    assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.kinetic.max()


def test_an_arm_without_mass_on_a_slide_is_refused_and_on_a_motor_accepted():
    def moved(motor):
        scene, arm = one_bar((0, 1), MASSLESS, elements=1)
        scene.add_joint(fb.Prismatic(fb.GROUND, arm.start, axis=(1, 0), motor=motor))
        return run(scene).displacement(arm.end)[-1]

    assert_refused(r"can move along \(-?1, 0\) .*without mass", moved, None)
    assert moved(lambda t: 0.1 * t**2) == pytest.approx([1e-3, 0.0], abs=1e-12)


# -- Initial velocities --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["rigid", "revolute with offset", "prismatic", "pin in slot"])
def test_velocities_that_violate_a_joint_are_refused_with_the_violation(kind):
    scene, first, second, joint = pair(kind)
    name = re.escape(str(joint))
    throw(scene, first, second, joint)
    run(scene, dt=0.01, t_end=0.01)
    scene.velocities.clear()
    scene.set_velocity(second, (-0.8, 0.6))  # across the guide
    assert_refused(f"{name}: its nodes separate at 1 m/s. .*make_velocities_comp", run, scene)
    scene.velocities.clear()
    if joint.turns_together:
        for beam, spin in ((first, 1.0), (second, 1.0 + 1e-6)):
            scene.set_velocity(beam, lambda x, y: (-y, x), spin=spin)
        assert_refused(f"{name}: the rotation rate of node b deviates by 1e-06", run, scene)


def test_a_motor_that_starts_at_speed_needs_compatible_velocities():
    scene, (a, b, _) = beams()
    scene.pin(a.start)
    scene.add_joint(fb.Revolute(a.start, b.start, motor=lambda t: math.sin(2.0 * t)))
    with pytest.raises(
        fb.SceneError,
        match="the motor of joint 0, Revolute of .* starts with the rate 2 of its rotation",
    ):
        run(scene)
    scene.set_velocity(b, lambda x, y: (-2 * y, 2 * x), spin=2.0)
    assert run(scene).spin(b.end)[0] == pytest.approx(2.0, rel=1e-5)
