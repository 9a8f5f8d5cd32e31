"""Scenes in which supports, joints and motors leave nothing free."""

import numpy as np
import pytest
from scenes import clamped_bar, one_bar

import fx_beam as fb

MEMBER = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=2.0, rhoI=0.01)
#: Mass of a member of length 1, half of it at each end where these move alike.
MASS = 2.0


def push(t):
    """A motion with the acceleration 0.2, in m or rad."""
    return 0.1 * t**2


def member():
    """A member from (0, 0) to (1, 0) whose end is held by its start."""
    scene, beam = one_bar((1, 0), MEMBER, elements=1)
    scene.add_joint(fb.Rigid(beam.start, beam.end, offset=(1, 0)))
    return scene, beam


def clamped_at_both_ends():
    scene, beam = clamped_bar((1, 0), MEMBER, elements=1)
    scene.clamp(beam.end)
    return scene


def with_a_spring_and_a_damper():
    scene, beam = member()
    laws = {"spring": fb.Spring(3.0), "damper": fb.Damper(2.0)}
    scene.add_joint(fb.Prismatic(fb.GROUND, beam.start, axis=(1, 0), motor=push, **laws))
    return scene


def motor_between_held_members():
    scene = clamped_at_both_ends()
    other = scene.add_beam([(1, 0), (2, 0)], MEMBER, elements=1)
    scene.add_joint(fb.Revolute(scene.beams[0].end, other.start, motor=push))
    scene.clamp(other.end)
    return scene


def driven():
    scene, beam = member()
    scene.add_joint(fb.PinInSlot(fb.GROUND, beam.start, axis=(1, 0), motor=push))
    scene.prescribe(beam.start, rotation=lambda t: push(t) / 2)
    return scene


SCENES = {
    "clamped": clamped_at_both_ends,
    "motor and prescribed": driven,
    "spring, damper and motor": with_a_spring_and_a_damper,
    "motor between held members": motor_between_held_members,
}


@pytest.mark.parametrize("name", SCENES)
def test_it_moves_as_it_is_driven_and_balances_its_energy(name):
    solution = fb.simulate(SCENES[name](), dt=0.05, t_end=0.5)
    assert solution.stats.unknowns == 0
    energy = solution.energy
    assert abs(energy.balance_error).max() <= 1e-14 * max(abs(energy.total).max(), 1.0)
    assert abs(solution.q).max() == pytest.approx(0.0 if name == "clamped" else push(0.5))


@pytest.mark.parametrize("name", SCENES)
def test_its_equilibria_are_where_it_is_driven_to_and_nothing_vibrates(name):
    for continuation in (None, "arc-length"):
        solution = fb.static(SCENES[name](), load_steps=4, t=0.5, continuation=continuation)
        assert solution.load_factor[-1] == 1
        assert abs(solution.q[-1]).max() == pytest.approx(0.0 if name == "clamped" else push(0.5))
    with pytest.raises(fb.SceneError, match="modes: the scene has no unknowns: supports, joints"):
        fb.modes(SCENES[name]())


def test_a_motor_drives_the_mass_that_it_moves():
    scene = SCENES["spring, damper and motor"]()
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    # F = m a + k x + c v, with the mean rate of each step.
    slide = np.diff(push(solution.t))
    spring, damper = 3.0 / 2 * np.diff(push(solution.t) ** 2), 2.0 * slide**2 / 0.05
    work = np.diff(solution.energy.work)
    assert work == pytest.approx(MASS * 0.2 * slide + spring + damper, rel=1e-9)
    assert np.diff(solution.energy.dissipated) == pytest.approx(damper, rel=1e-9)


def test_motors_of_three_bodies_in_a_row_have_the_moments_of_what_they_turn():
    """The first one turns all, as a rigid body of 3 kg; the others hold the bodies behind them."""
    scene, joints, before = fb.Scene(), [], fb.GROUND
    for x, motor in enumerate((push, lambda t: 0.0, lambda t: 0.0)):
        body = scene.add_body((x + 0.5, 0), 1.0, 0.1, points={"a": (x, 0), "b": (x + 1, 0)})
        joints.append(scene.add_joint(fb.Revolute(before, body["a"], motor=motor)))
        before = body["b"]
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    assert solution.stats.unknowns == 0
    for k, joint in enumerate(joints):
        # The rate of the angular momentum about the joint: I + m (r^2 less its part along the arm).
        inertia = sum(0.1 + (x + 0.5) * (x + 0.5 - k) for x in range(k, 3))
        moment = solution.joint(joint).motor_force[1:]
        assert moment == pytest.approx(np.full(10, 0.2 * inertia), rel=1e-9)
    assert abs(solution.energy.balance_error).max() < 1e-13
