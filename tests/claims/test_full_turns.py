"""Members that turn many times: rotations are counted, and no less exact for it."""

import numpy as np
import pytest
from scenes import held_body, one_bar, pinned_beam, relative_drift

import fx_beam as fb

STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)


def rotor(**rotation):
    """A stout beam on a hinge, with what acts on its rotation."""
    scene, beam = one_bar((1, 0), STIFF, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, **rotation))
    return scene, beam


def test_rotations_go_on_over_many_turns():
    # 1100 steps of 0.57 rad, over the end of a block of 1000.
    scene, beam = rotor()
    scene.set_velocity(beam, lambda x, y: (-60 * y, 60 * x), spin=60.0)
    solution = fb.simulate(scene, dt=0.01, t_end=11.0)
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
        beam, lambda x, y: (-amplitude * omega * y, amplitude * omega * x), spin=amplitude * omega
    )
    solution = fb.simulate(scene, dt=0.001, t_end=3.2)
    exact = amplitude * np.sin(omega * solution.t)
    assert abs(solution.rotation(beam.start) - exact).max() < 1e-2 * amplitude
    assert relative_drift(solution.energy.total) < 1e-11


@pytest.mark.parametrize(("order", "lags"), [(2, (0.0201, 0.0727)), (4, (5.7e-5, 8.4e-4))])
def test_the_angle_of_a_free_spin_lags_behind_by_what_the_page_on_limits_says(order, lags):
    for dt, lag in zip((0.5, 1.0), lags, strict=True):
        scene, body = held_body((0, 0), mass=1.0, inertia=1.0)
        scene.set_velocity(body, spin=1.0)
        solution = fb.simulate(scene, fb.EnergyMomentum(order), dt=dt, t_end=20.0)
        assert 1 - solution.rotation(body)[-1] / 20.0 == pytest.approx(lag, rel=0.01)
        if order == 2:
            assert solution.rotation(body)[1] == pytest.approx(2 * np.arctan(dt / 2), rel=1e-12)
        assert solution.spin(body) == pytest.approx(np.ones(len(solution.t)), abs=1e-12)
