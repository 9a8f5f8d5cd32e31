"""What the schemes keep, at every step."""

import numpy as np
import pytest
from scenes import FLYING, free_flight, one_bar, pinned_beam, relative_drift

import fx_beam as fb

# -- Pinned beam -------------------------------------------------------------------------------


def test_the_drift_of_the_published_scheme_falls_with_the_square_of_the_element():
    drifts = []
    for elements in (4, 8, 16):
        scene, _ = pinned_beam(elements)
        solution = fb.simulate(scene, fb.ModifiedMidPoint(), dt=0.001, t_end=0.5)
        drifts.append(relative_drift(solution.energy.total))
    orders = np.log2(np.array(drifts[:-1]) / drifts[1:])
    assert orders.min() > 1.9


# -- Free flight -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "degree"),
    [(fb.EnergyMomentum(), 2), (fb.ModifiedMidPoint(), 1), (fb.MidPoint(), 1)],
    ids=["EnergyMomentum", "ModifiedMidPoint", "MidPoint"],
)
def test_momenta_are_kept_in_free_flight(scheme, degree):
    scene, _ = free_flight(degree=degree)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=8.0)
    after = solution.t > 2.5 - 1e-6
    assert abs(solution.linear_momentum[after] - (20.0, 0.0)).max() < 20 * 1e-10
    assert relative_drift(solution.angular_momentum[after]) < 1e-10


@pytest.mark.exact_times
@pytest.mark.parametrize("dt", [0.1, 0.05, 0.01, 2.5 / 7])
@pytest.mark.parametrize("last", [lambda t: t < 2.5, lambda t: t <= 2.5])
def test_a_load_that_ends_with_a_step_gives_its_whole_impulse(dt, last):
    scene, beam = one_bar([(6, 0), (0, 8)], FLYING, elements=2)
    scene.add_force(beam.start, lambda t: (8.0 * last(t), 0.0))
    solution = fb.simulate(scene, dt=dt, t_end=10 * 2.5 / 7)
    assert abs(solution.linear_momentum[-1] - (20.0, 0.0)).max() < 20 * 1e-10


# -- What does not balance -------------------------------------------------------------------------


def test_a_motion_whose_energies_do_not_balance_says_from_when_on_and_by_how_much(caplog):
    def swing(scheme, dt):
        caplog.clear()
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
        scene, beam = one_bar((1, 0), section, elements=8, gravity=(0, -9.81))
        scene.pin(beam.start)
        return fb.simulate(scene, scheme, dt=dt, t_end=1.0)

    motion = swing(fb.MidPoint(), 0.05)
    (message,) = [text for text in caplog.messages if "do not balance" in text]
    errors, energy = motion.energy.balance_error, motion.energy
    size = max(abs(part).max() for part in (energy.kinetic, energy.potential))
    first = motion.t[np.argmax(errors > 1e-3 * size)]
    assert f"from t = {first:.6g} on the motion gains" in message
    assert f"up to {errors.max():.3g} J" in message
    for scheme, dt in ((fb.EnergyMomentum(), 0.05), (fb.EnergyDecaying(), 0.05)):
        swing(scheme, dt)
        assert not caplog.messages
    swing(fb.MidPoint(), 0.005)
    assert not caplog.messages
