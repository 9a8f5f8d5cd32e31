"""The numbers of demos/multibody.py."""

import pytest
from demo_runs import numbers
from scenes import demo

import fx_beam as fb

pytestmark = pytest.mark.slow


def multibody(scheme, dt=0.005):
    return numbers("multibody")["schemes"][scheme][f"dt {dt:g}"]


@pytest.mark.parametrize("dt", [0.01, 0.005, 0.0025])
def test_multibody_keeps_its_energy_after_the_moment(dt):
    run = multibody("EnergyMomentum", dt)
    assert run["failure"] is None and run["steps"] == round(4.0 / dt)
    assert run["energy drift"] < 1e-11
    assert run["balance error"] < 1e-11 * run["energy after the pulse"]


def test_multibody_keeps_its_energy_whatever_the_last_digit_of_its_step():
    module = demo("multibody")
    for k in range(20):
        solution, _ = module.simulate(fb.EnergyMomentum(), 0.01 * (1 + 2e-15 * k))
        assert solution.stats.failure is None
        _, ratio = module.energy_ratio(solution)
        assert ratio == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize("dt", [0.01, 0.005, 0.0025])
def test_multibody_published_scheme_drifts_a_little(dt):
    run = multibody("ModifiedMidPoint (as published)", dt)
    assert run["lost at"] is None
    assert 1e-5 < run["energy drift"] < 0.1


# What a lost motion comes to is one of the last digit; that it is lost is not. With more damping,
# alpha = -0.1, that too is one of the last digit.
@pytest.mark.parametrize("stretch", [1.0, 1 + 1e-15, 1 - 3e-15])
@pytest.mark.parametrize(
    ("scheme", "steps"),
    [
        ("Newmark (trapezoidal)", (0.01, 0.005, 0.0025)),
        ("HHT, alpha = -0.05", (0.01, 0.005, 0.0025)),
        ("Generalized alpha, 0.9", (0.01, 0.005, 0.0025)),
    ],
)
def test_multibody_is_lost_soon_after_the_moment_by_other_schemes(scheme, steps, stretch):
    module = demo("multibody")
    for dt in steps:
        solution, _ = module.simulate(module.SCHEMES[scheme], stretch * dt)
        assert 0.6 < module.lost_at(solution) < module.T_END
        after, ratio = module.energy_ratio(solution)
        assert ratio[after < 0.55] == pytest.approx(1, abs=0.02)
        assert solution.stats.failure


def test_multibody_is_lost_later_with_more_damping():
    for dt in (0.01, 0.005, 0.0025):
        newmark, hht = (
            multibody(name, dt)["lost at"]
            for name in ("Newmark (trapezoidal)", "HHT, alpha = -0.05")
        )
        assert newmark < hht


def largest_forces(run):
    return run["largest axial force during the pulse"], run["largest axial force up to 0.7 s"]


@pytest.mark.parametrize("dt", [0.01, 0.005, 0.0025])
def test_multibody_axial_vibration_starts_when_the_moment_ends(dt):
    before, after = largest_forces(multibody("EnergyMomentum", dt))
    assert after > 5 * before


def test_multibody_with_a_third_of_the_moment_has_no_early_vibration():
    module = demo("multibody")
    module.PULSE = module.PULSE[0], (0.0, -5.0, 0.0)
    module.T_END = 1.0
    before, after = largest_forces(module.audit(*module.simulate(fb.EnergyMomentum(), 0.005)))
    assert after < 2 * before


def test_multibody_joints_are_exact_over_a_long_slide():
    run = multibody("EnergyMomentum")
    assert run["largest gap"] < 1e-11
    shortest, longest = run["slide"]
    assert longest - shortest > 1  # the members are 0.5 and 1 m long


def test_multibody_has_no_unknowns_but_nodes_and_slides():
    count = numbers("multibody")["unknowns"]
    left = 3 * count["nodes"] - count["constrained by supports"] - count["constrained by joints"]
    assert count["unknowns"] == left + count["slides"] == 62
