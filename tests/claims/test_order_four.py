"""Schemes of order four: compositions of sub-steps, one of which goes back in time."""

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, guided_body, one_bar, pendulum, spinner

import fx_beam as fb

FOUR = fb.EnergyMomentum(order=4)


def order(scene, value, t_end, steps, scheme=FOUR, **options):
    """Order of convergence of a value, from runs with `steps`, twice and four times as many."""
    a, b, c = (
        value(fb.simulate(scene, scheme, dt=t_end / n, t_end=t_end, **options))
        for n in (steps, 2 * steps, 4 * steps)
    )
    return np.log2(abs(a - b).max() / abs(b - c).max())


def last_place(solution):
    return solution.q[-1]


def impulse(node):
    """Impulse of a support: its recorded forces are means over the steps."""
    return lambda solution: np.diff(solution.t) @ solution.reaction(node)[1:, :2]


# -- Order ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", [FOUR, fb.ModifiedMidPoint(order=4)], ids=lambda s: s.name)
def test_the_path_of_the_stiff_pendulum_is_of_order_four(scheme):
    scene, beam = pendulum()
    assert order(scene, lambda s: s.position(beam.end)[-1], 1.0, 20, scheme) > 3.9


def test_the_force_of_an_elastic_pendulum_is_of_order_four():
    # The axial vibration is resolved. That of a rigid rod is not, at any practical step.
    scene, beam = pendulum(EA=400.0, EI=400.0)
    assert order(scene, impulse(beam.start), 1.0, 80) > 3.9
    assert order(scene, impulse(beam.start), 1.0, 80, fb.MidPoint(order=4)) > 3.9

    def of_section(solution):
        return np.diff(solution.t) @ solution.resultants(beam).N[1:]

    assert order(scene, of_section, 1.0, 80) > 3.9


def stiffening(eps, gamma, kappa):
    return 200 * (eps**2 + eps**4) + 100 * gamma**2 + 5 * kappa**2


@pytest.mark.parametrize(
    ("degree", "elements", "energy"), [(1, 2, stiffening), (2, 1, None), (3, 1, None)]
)
def test_elements_of_every_degree_with_loads_and_motors_are_of_order_four(degree, elements, energy):
    stiffness = {"strain_energy": energy} if energy else {"EA": 400.0, "GA": 200.0, "EI": 10.0}
    section = fb.Section(**stiffness, rhoA=1.0, rhoI=0.1)
    scene, upper = one_bar((1, 0), section, elements=elements, degree=degree, gravity=(0, -2.0))
    lower = scene.add_beam([(1, 0), (2, 0)], section, elements=elements, degree=degree)
    scene.add_joint(fb.Revolute(fb.GROUND, upper.start, motor=lambda t: 0.5 * np.sin(t) ** 4))
    spring, damper = fb.Spring(2.0), fb.Damper(0.05)
    scene.add_joint(fb.Revolute(upper.end, lower.start, spring=spring, damper=damper))
    scene.add_force(lower.end, lambda t: (3 * np.sin(2 * t) ** 2, 0.0))
    scene.add_force(lower.end, lambda t: (0.0, np.sin(t) ** 2), follower=True)
    assert order(scene, last_place, 1.0, 120) > 3.6


def test_a_jump_of_a_load_inside_a_step_lowers_the_order():
    def error(jump):
        section = fb.Section(EA=400.0, GA=200.0, EI=10.0, rhoA=1.0, rhoI=0.1)
        scene, beam = clamped_bar((1, 0), section, elements=2)
        scene.add_force(beam.end, lambda t: (0.0, 2.0 * (t > jump)))
        coarse, fine = (fb.simulate(scene, FOUR, dt=dt, t_end=1.0) for dt in (1 / 256, 1 / 4096))
        return abs(coarse.q[-1] - fine.q[-1]).max()

    assert error(jump=0.25 + 0.3 / 256) > 10 * error(jump=0.25)


# -- Parts, starts --------------------------------------------------------------------------------


def test_a_step_whose_sub_step_fails_is_taken_back_and_halved():
    # Mid-point sub-steps turn by 2 arctan(40 f dt / 2): 1.61 rad forwards and 2.34 rad back.
    scene, _ = spinner(40.0)
    halves = fb.simulate(scene, FOUR, dt=0.0625, t_end=1.0)
    run = fb.simulate(scene, FOUR, dt=0.125, t_end=1.0)
    assert run.stats.halvings >= 1
    assert run.stats.substeps == 16
    assert abs(run.q[-1] - halves.q[-1]).max() < 1e-9
    assert abs(run.energy.balance_error).max() < 1e-11 * run.energy.total[0]


# -- Dampers --------------------------------------------------------------------------------------


def braked(rate):
    """A block of 2 kg on a rail, at 3 m/s, with a damper of this damping rate [1/s]."""
    scene, block, joint = guided_body((0, 0), 2.0, 0.1, damper=fb.Damper(2.0 * rate))
    scene.set_velocity(block, (3.0, 0.0))
    return scene, joint


def test_a_damper_is_of_order_four_and_amplification_is_reported(caplog):
    scene, joint = braked(rate=1.0)
    exact = 3.0 * (1 - np.exp(-2.0))
    errors = [
        fb.simulate(scene, FOUR, dt=dt, t_end=2.0).joint(joint).slide[-1] - exact
        for dt in (0.25, 0.125)
    ]
    assert np.log2(errors[0] / errors[1]) > 3.8
    assert not caplog.records
    # The sub-step back of 0.658 dt has a pole at a damping rate of 3.04 / dt.
    lost = fb.simulate(braked(rate=3.03)[0], FOUR, dt=1.0, t_end=3.0)
    # These steps are halved: they gave energy before.
    assert lost.stats.amplified == lost.stats.halvings > 0
    assert np.diff(lost.energy.dissipated).min() > 0
    assert "amplifies" in caplog.records[-1].message
    assert "dt" in caplog.records[-1].message


def test_without_halvings_a_step_in_which_damping_gives_energy_is_an_error():
    with pytest.raises(fb.StepError, match="damping adds energy.*smaller dt") as raised:
        fb.simulate(braked(rate=3.03)[0], FOUR, dt=1.0, t_end=3.0, max_halvings=0)
    assert raised.value.failure.kind == "damping"


@pytest.mark.parametrize("dt", [1e-3, 5e-4])
def test_damped_links_of_fine_elements_gain_nothing_by_damping(dt):
    # A double pendulum. The tip at 1.5 s is from one element of degree 14 a link, by DOP853.
    scene = fb.Scene(gravity=(0, -9.81))
    data = {"EA": 2000.0, "GA": 800.0, "EI": 2.0, "rhoA": 1.0, "rhoI": 1e-3}
    section = fb.Section(**data, retardation=1e-3)
    links = [scene.add_beam([(k, 0), (k + 1, 0)], section, elements=16, degree=3) for k in range(2)]
    scene.pin(links[0].start)
    scene.add_joint(fb.Revolute(links[0].end, links[1].start))
    scene.add_mass(links[1].end, 0.5)
    solution = fb.simulate(scene, FOUR, dt=dt, t_end=1.5, record=fb.Record(rates=False))
    assert solution.stats.amplified > 0
    tip = solution.position(links[1].end)[-1]
    assert tip == pytest.approx([-1.86689843, 0.06713265], abs=5e-6)
    energy = solution.energy
    # Of the energy in motion and strain: the total, with the weight's, is near zero.
    assert np.diff(energy.dissipated).min() > -1e-8 * (energy.kinetic + energy.strain).max()


# -- Refusals -------------------------------------------------------------------------------------


def test_orders_and_fractions_that_do_not_exist_are_refused():
    for order in (3, 6, "four"):
        assert_refused("order = .* must be 2 or 4", fb.EnergyMomentum, order=order)
    plain = fb.MidPoint()
    for fractions in ((), (0.5, 0.4), (1.35, -1.7, 1.35), [0.5, 0.5], (0.5, 0.0, 0.5), (np.nan,)):
        assert_refused("fractions", fb.Scheme, "own", plain.resultants, plain.rates, fractions)
    newmark = fb.Newmark()
    with pytest.raises(fb.SceneError, match="symmetric in time"):
        fb.Scheme("own", newmark.resultants, newmark.rates, (0.5, 0.5))
