"""Members that turn many times: rotations are counted, and no less exact for it."""

import numpy as np
import pytest
from scenes import pinned_beam, relative_drift

import fx_beam as fb
from fx_beam.model.model import Model
from fx_beam.stepping.full_turns import TurnCounter

STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)


def rotor(**rotation):
    """A stout beam on a hinge, with what acts on its rotation."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], STIFF, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, **rotation))
    return scene, beam


def members(scene):
    return TurnCounter(Model(scene, fb.EnergyMomentum()))._members


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_rotations_go_on_over_many_turns(solver):
    # 1100 steps of 0.57 rad, over the end of a block of 1000.
    scene, beam = rotor()
    scene.set_velocity(beam, lambda x, y: (-60 * y, 60 * x), spin=60.0)
    solution = fb.simulate(scene, dt=0.01, t_end=11.0, solver=solver)
    turned = solution.rotation(beam.end)
    tip = solution.position(beam.end)
    assert turned[-1] > 600
    assert np.diff(turned) == pytest.approx(np.diff(turned)[:1].repeat(1100), rel=0.1)
    # The axis stays within a shear strain of the sections.
    across = tip[:, 1] * np.cos(turned) - tip[:, 0] * np.sin(turned)
    assert abs(across).max() < 0.05
    assert relative_drift(solution.energy.total) < 1e-11


def test_a_beam_that_has_turned_a_thousand_times_keeps_its_energy_as_at_the_start():
    scene, beam = pinned_beam()
    record = fb.Record(rates=False, forces=False)
    solution = fb.simulate(scene, dt=0.02, t_end=1400.0, record=record)
    assert solution.rotation(beam.end)[-1] > 1000 * 2 * np.pi
    # Rotations of 6000 rad, rounded to 5e-13, cost 1e-9 here. Other rounding adds up over the
    # steps to 0.9e-11 to 2.2e-11, by the last digits of dt: a bound of 2e-11 was too close to it.
    assert relative_drift(solution.energy.total) < 1e-10


def test_a_spring_counts_all_turns():
    # An oscillation of 3 turns to each side; the frequency of the rigid rotor is sqrt(k / I).
    inertia = 1 / 3 + 0.1
    amplitude, omega = 6 * np.pi, 2.0
    scene, beam = rotor(spring=fb.Spring(stiffness=inertia * omega**2))
    scene.set_velocity(
        beam,
        lambda x, y: (-amplitude * omega * y, amplitude * omega * x),
        spin=amplitude * omega,
    )
    solution = fb.simulate(scene, dt=0.001, t_end=3.2)
    exact = amplitude * np.sin(omega * solution.t)
    assert abs(solution.rotation(beam.start) - exact).max() < 1e-2 * amplitude
    assert relative_drift(solution.energy.total) < 1e-11


def test_turns_are_taken_off_where_nothing_counts_them():
    assert [len(rotations) for rotations in members(rotor()[0])] == [3]
    for what in (
        {"spring": fb.Spring(1.0)},
        {"damper": fb.Damper(1.0)},
        {"friction": fb.Friction(1.0, 0.1)},
        {"motor": lambda t: t},
    ):
        assert members(rotor(**what)[0]) == []
    clamped, beam = rotor()
    clamped.fix(beam.end, "rotation")
    assert members(clamped) == []
    driven, beam = rotor()
    driven.prescribe(beam.end, rotation=lambda t: 9 * t)
    assert members(driven) == []
    counting, _ = rotor()
    counting.add_virtual_work(lambda step: -step.psi * step.virtual_psi)
    assert members(counting) == []


def test_members_that_turn_together_are_one():
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], STIFF)
    rod = scene.add_beam([(1, 0), (2, 0)], STIFF)
    sleeve = scene.add_beam([(2, 0), (3, 0)], STIFF)
    scene.pin(arm.start)
    scene.add_joint(fb.Revolute(arm.end, rod.start))
    scene.add_joint(fb.Prismatic(rod.end, sleeve.start, axis=(1, 0)))
    assert sorted(len(rotations) for rotations in members(scene)) == [2, 4]
