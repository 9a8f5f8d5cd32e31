"""Parts without mass under loads that are there at the start: in equilibrium from the start on."""

import logging

import numpy as np
import pytest

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.EnergyDecaying(),
    fb.MidPoint(),
    fb.Newmark(),
    fb.HHT(-0.1),
]
NAMED = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
LIGHT = fb.Section(EA=1e4, GA=1e4, EI=10.0)


def bent(**section):
    """A massless cantilever under a moment, and a heavy one, since a motion needs a mass."""
    scene = fb.Scene()
    section = fb.Section(LIGHT.EA, LIGHT.GA, LIGHT.EI, **section)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    other = scene.add_beam([(0, 1), (1, 1)], fb.Section(1e4, 1e4, 10.0, 1.0, 0.01))
    scene.clamp(beam.start)
    scene.clamp(other.start)
    scene.add_moment(beam.end, 20.0)
    return scene, beam


@pytest.mark.parametrize("solver", ["auto", "petsc"])
@NAMED
def test_a_massless_member_has_the_rotation_of_its_moment_in_every_row(scheme, solver):
    scene, beam = bent()
    found = fb.simulate(scene, scheme, dt=0.01, t_end=0.05, solver=solver)
    assert found.rotation(beam.end) == pytest.approx(np.full(6, 2.0), abs=1e-9)
    assert abs(found.energy.balance_error).max() < 1e-12
    assert found.energy.strain[0] == pytest.approx(20.0)


def test_single_steps_start_from_the_same_place():
    scene, beam = bent()
    motion = fb.Motion(scene, dt=0.01)
    assert motion.q[beam.end.number, 2] == pytest.approx(2.0, abs=1e-9)
    motion.step()
    assert motion.q[beam.end.number, 2] == pytest.approx(2.0, abs=1e-9)


@NAMED
def test_what_hangs_on_a_mass_follows_it_at_its_own_stretch(scheme):
    k, force, mass = 40.0, 3.0, 2.0
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=k, GA=1.0, EI=1.0), elements=2)
    middle = bar.node(0.5)
    scene.fix(bar.start, "x", "y", "rotation")
    for node in (middle, bar.end):
        scene.fix(node, "y", "rotation")
    scene.add_mass(middle, mass)
    scene.add_force(bar.end, (force, 0.0))
    found = fb.simulate(scene, scheme, dt=0.01, t_end=1.0)
    x = found.displacement(middle)[:, 0]
    stretch = found.displacement(bar.end)[:, 0] - x
    assert stretch == pytest.approx(np.full(len(x), force / k), rel=1e-3)
    assert abs(x[0]) < 1e-15
    # The force pulls the mass from the first step on.
    assert found.acceleration(middle)[0, 0] == pytest.approx(force / mass)
    omega = np.sqrt(k / mass)
    assert x == pytest.approx(force / k * (1 - np.cos(omega * found.t)), abs=0.02 * force / k)


def test_a_massless_slide_starts_where_its_spring_balances_the_force():
    scene = fb.Scene()
    guide = scene.add_beam([(0, 0), (1, 0)], fb.Section(1e4, 1e4, 10.0, 1.0, 0.1), elements=2)
    tail = scene.add_beam([(1, 0), (2, 0)], LIGHT, elements=2)
    scene.clamp(guide.start)
    joint = fb.Prismatic(guide.end, tail.start, axis=(1, 0), spring=fb.Spring(50.0))
    joint = scene.add_joint(joint)
    scene.add_force(tail.end, (10.0, 0.0))
    found = fb.simulate(scene, dt=1e-3, t_end=0.05)
    assert found.joint(joint).slide == pytest.approx(np.full(51, 0.2), abs=1e-6)
    assert abs(found.energy.balance_error).max() < 1e-12


def test_a_massless_member_with_damping_starts_where_it_is_and_creeps():
    scene, beam = bent(retardation=0.02)
    found = fb.simulate(scene, dt=1e-3, t_end=0.1)
    angle = found.rotation(beam.end)
    assert abs(angle[0]) < 1e-6
    assert angle == pytest.approx(2 * (1 - np.exp(-found.t / 0.02)), abs=2e-3)


def test_a_load_that_begins_at_zero_finds_the_start_as_it_is():
    scene, beam = bent()
    scene.loads.clear()
    scene.add_moment(beam.end, lambda t: 20.0 * t)
    found = fb.simulate(scene, dt=0.01, t_end=0.1)
    assert not found.q[0].any()
    assert found.rotation(beam.end) == pytest.approx(2 * found.t, abs=2e-5)  # of second order


def test_a_massless_hinge_with_a_soft_spring_starts_where_its_moment_is_that_of_the_load():
    # The moment of the spring is 10 x / sqrt(1 + x^2).
    law = fb.Spring(strain_energy=lambda turn: 10 * ((1 + turn**2) ** 0.5 - 1))
    scene, _ = bent()
    flap = scene.add_beam([(0, -1), (1, -1)], LIGHT, elements=1)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, flap.start, spring=law))
    scene.add_moment(flap.end, 8.0)
    found = fb.simulate(scene, dt=0.01, t_end=0.05)
    assert found.joint(hinge).angle == pytest.approx(np.full(6, 8 / 6), abs=1e-8)


def test_a_load_without_equilibrium_is_named_before_the_step_fails(caplog):
    law = fb.Spring(strain_energy=lambda turn: 10 * ((1 + turn**2) ** 0.5 - 1))
    scene, _ = bent()
    flap = scene.add_beam([(0, -1), (1, -1)], LIGHT, elements=1)
    scene.add_joint(fb.Revolute(fb.GROUND, flap.start, spring=law))
    scene.add_moment(flap.end, 12.0)
    with caplog.at_level(logging.WARNING), pytest.raises(fb.StepError):
        fb.simulate(scene, dt=0.01, t_end=0.02)
    assert "no equilibrium was found at the start for nodes without mass" in caplog.text
