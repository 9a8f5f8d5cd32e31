"""The numbers of the demos of the paper's examples."""

import pytest
from pytest import approx
from scenes import demo

import fx_beam as fb

pytestmark = pytest.mark.slow


# -- damping_scan


def scanned(example, scheme):
    """When runs were lost, by step."""
    runs = example[scheme]
    return {float(dt.removeprefix("dt ")): run["lost at"] for dt, run in runs.items()}


def test_no_step_of_any_example_is_lost_by_the_schemes_that_keep_energy(damping_scan):
    for example in damping_scan.values():
        for scheme in ("EnergyMomentum", "ModifiedMidPoint"):
            assert set(scanned(example, scheme).values()) == {None}
        for run in example["EnergyMomentum"].values():
            assert run["lowest energy ratio"] == approx(1, abs=1e-11)


def test_newmark_loses_every_example_at_these_steps(damping_scan):
    for example, steps in {
        "Pendulum": (0.2, 0.1, 0.05, 0.02, 0.01),
        "Three-bar swing": (4e-3,),
        "Multi-body system": (0.01, 0.005, 0.0025),
        "Pinned beam": (0.02, 0.01),
    }.items():
        lost = scanned(damping_scan[example], "HHT, alpha = 0")
        assert all(lost[dt] is not None for dt in steps), example


def test_hht_postpones_the_loss_of_the_pendulum_the_more_the_more_it_damps(damping_scan):
    none, some, more = (
        scanned(damping_scan["Pendulum"], f"HHT, alpha = {alpha}") for alpha in (0, -0.05, -0.1)
    )
    assert none[0.1] == approx(1.4, abs=0.11) and some[0.1] == approx(2.2, abs=0.11)
    assert none[0.2] < some[0.2] < more[0.2] < 5
    assert more[0.1] is None and some[0.01] is None


def test_damping_that_never_loses_a_motion_loses_much_of_its_energy(damping_scan):
    least = {"Pendulum": 0.3, "Three-bar swing": 0.2, "Multi-body system": 0.4, "Pinned beam": 0.3}
    for example, loss in least.items():
        runs = damping_scan[example]["HHT, alpha = -0.33"].values()
        assert all(run["lost at"] is None for run in runs)
        assert min(run["lowest energy ratio"] for run in runs) < 1 - loss


def test_the_two_families_meet_where_both_damp_by_a_half(damping_scan):
    for by_scheme in damping_scan.values():
        hht, generalized = by_scheme["HHT, alpha = -0.33"], by_scheme["Generalized alpha, 0.5"]
        assert hht[list(hht)[-1]]["lost at"] == generalized[list(hht)[-1]]["lost at"]


# -- multibody

OTHERS = "Newmark (trapezoidal)", "HHT, alpha = -0.05", "Generalized alpha, 0.9"


def largest_forces(run):
    return run["largest axial force during the pulse"], run["largest axial force up to 0.7 s"]


def test_multibody_keeps_its_energy_after_the_moment_whose_end_starts_a_vibration(multibody):
    for dt in (0.01, 0.005, 0.0025):
        run = multibody["schemes"]["EnergyMomentum"][f"dt {dt:g}"]
        assert run["failure"] is None and run["steps"] == round(4.0 / dt)
        assert run["energy drift"] < 1e-11
        assert run["balance error"] < 1e-11 * run["energy after the pulse"]
        before, after = largest_forces(run)
        assert after > 5 * before


def test_multibody_keeps_its_energy_whatever_the_last_digit_of_its_step():
    module = demo("multibody")
    for k in range(1, 5):
        solution, _ = module.simulate(fb.EnergyMomentum(), 0.01 * (1 + 2e-15 * k))
        assert solution.stats.failure is None
        _, ratio = module.energy_ratio(solution)
        assert ratio == approx(1, abs=1e-11)


def test_multibody_published_scheme_drifts_a_little(multibody):
    for dt in (0.01, 0.005, 0.0025):
        run = multibody["schemes"]["ModifiedMidPoint (as published)"][f"dt {dt:g}"]
        assert run["lost at"] is None and 1e-5 < run["energy drift"] < 0.1


# What a lost motion comes to is one of the last digit; that it is lost is not. With more damping,
# alpha = -0.1, that too is one of the last digit.
@pytest.mark.parametrize("scheme", OTHERS)
def test_multibody_is_lost_soon_after_the_moment_by_other_schemes(scheme):
    module = demo("multibody")
    for dt in (0.01, 0.005, 0.0025, 0.005 * (1 + 1e-15), 0.005 * (1 - 3e-15)):
        solution, _ = module.simulate(module.SCHEMES[scheme], dt)
        assert 0.6 < module.lost_at(solution) < module.T_END
        after, ratio = module.energy_ratio(solution)
        assert ratio[after < 0.55] == approx(1, abs=0.02)
        assert solution.stats.failure


def test_multibody_is_lost_later_with_more_damping(multibody):
    newmark, hht = (multibody["schemes"][name] for name in OTHERS[:2])
    assert all(newmark[dt]["lost at"] < hht[dt]["lost at"] for dt in newmark)


def test_multibody_with_a_third_of_the_moment_has_no_early_vibration():
    module = demo("multibody")
    module.PULSE = module.PULSE[0], (0.0, -5.0, 0.0)
    module.T_END = 1.0
    before, after = largest_forces(module.audit(*module.simulate(fb.EnergyMomentum(), 0.005)))
    assert after < 2 * before


def test_multibody_joints_are_exact_over_a_long_slide(multibody):
    run = multibody["schemes"]["EnergyMomentum"]["dt 0.005"]
    shortest, longest = run["slide"]
    assert run["largest gap"] < 1e-11 and longest - shortest > 1  # the members are 0.5 and 1 m long


def test_multibody_has_no_unknowns_but_nodes_and_slides(multibody):
    count = multibody["unknowns"]
    left = 3 * count["nodes"] - count["constrained by supports"] - count["constrained by joints"]
    assert count["unknowns"] == left + count["slides"] == 62


# -- pendulum


@pytest.mark.parametrize(("dt", "period"), [("dt 0.01", 1.47547), ("dt 0.1", 1.50252)])
def test_pendulum_has_the_period_and_energy_of_a_conserving_mid_point_rule(dt, period, pendulum):
    run = pendulum["schemes"]["EnergyMomentum"][dt]
    assert run["period"] == approx(period, abs=1e-4)
    assert pendulum["energy"] == approx(1.43664, rel=1e-4) and run["energy drift"] < 1e-11


def test_pendulum_on_a_rigid_rod_is_the_exact_one_and_the_flexible_one_is_near_it(pendulum):
    rod, run = pendulum["rigid rod"], pendulum["schemes"]["EnergyMomentum"]["dt 0.01"]
    assert rod["period"] == approx(1.47521, abs=2e-5)
    for name, exact in {
        "highest axial force": 15.557,
        "lowest axial force": 6.937,
        "largest horizontal acceleration": 5.888,
    }.items():
        assert rod[name] == approx(exact, abs=2e-3) and run[name] == approx(exact, rel=0.01)


def test_pendulum_newmark_rings_and_gains_energy(pendulum):
    for dt in (0.1, 0.01):
        run = pendulum["schemes"]["Newmark (trapezoidal)"][f"dt {dt:g}"]
        assert run["energy drift"] > 1 and run["highest axial force"] > 1000


def test_pendulum_published_scheme_is_as_smooth_and_keeps_its_energy_as_well(pendulum):
    schemes = pendulum["schemes"]
    for dt, run in schemes["ModifiedMidPoint (as published)"].items():
        assert run["energy drift"] < 1e-11 and run["lost at"] is None
        ours = schemes["EnergyMomentum"][dt]["largest horizontal acceleration"]
        assert run["largest horizontal acceleration"] == approx(ours, rel=1e-3)
        assert ours < 6.0 or dt == "dt 0.001"  # a step that sees the rod's own vibration


def test_pendulum_leaves_the_swing_by_newmark_and_later_by_hht_as_in_the_paper(pendulum):
    names = "Newmark (trapezoidal)", *(f"HHT, alpha = {alpha}" for alpha in (-0.05, -0.1))
    runs = (pendulum["schemes"][name]["dt 0.1"] for name in (*names, "Generalized alpha, 0.9"))
    newmark, gentle, strong, generalized = runs
    assert newmark["lost at"] < gentle["lost at"] < 3 and generalized["lost at"] < 3
    assert gentle["highest axial force"] > 100
    # More damping takes a part of the swing itself instead.
    assert strong["lost at"] is None and strong["lowest energy ratio"] < 0.8


# -- pinned_beam


def test_pinned_beam_starts_with_the_papers_energy_and_momentum(pinned_beam):
    assert pinned_beam["angular momentum at the start"] == approx(75_000, rel=1e-12)
    # 300 000 of translation; the spins of the nodes add the rest.
    assert pinned_beam["energy at the start"] == approx(300_100, rel=1e-12)


def test_pinned_beam_keeps_energy_and_angular_momentum_over_ten_seconds(pinned_beam):
    run = pinned_beam["schemes"]["EnergyMomentum"]["dt 0.01"]
    assert run["steps"] == 1000 and run["failure"] is None and run["halvings"] == 0
    assert run["energy drift"] < 1e-10
    assert run["angular momentum drift"] < 1e-10


def test_pinned_beam_published_scheme_keeps_angular_momentum_and_nearly_energy(pinned_beam):
    run = pinned_beam["schemes"]["ModifiedMidPoint (as published)"]["dt 0.01"]
    assert run["angular momentum drift"] < 1e-10
    assert 1e-6 < run["energy drift"] < 1e-3


def test_pinned_beam_newmark_gains_energy_and_fails_and_hht_loses_energy(pinned_beam):
    names = "Newmark (trapezoidal)", "HHT, alpha = -0.1"
    newmark, hht = (pinned_beam["schemes"][name]["dt 0.01"] for name in names)
    assert newmark["failed at"] < 1 and newmark["highest energy ratio"] > 2
    assert hht["failure"] is None and hht["lowest energy ratio"] < 0.95


def test_pinned_beam_tip_is_where_the_reference_has_it(pinned_beam):
    # The reference is rounded to 0.01 in; the beam is 100 in long.
    for mesh in ("8 elements, dt 0.01", "8 elements, dt 0.001", "64 elements, dt 0.0005"):
        assert pinned_beam["tip"][mesh]["largest difference"] < 0.01, mesh


# -- three_bar_swing


def test_swing_moves_and_turns_back_as_the_reference(three_bar_swing):
    for elements, tolerance, time in ((4, 2e-3, 0.6390), (16, 5e-4, 0.6396)):
        difference = three_bar_swing["reference"][f"{elements} elements"]["largest difference"]
        assert difference < tolerance
        assert three_bar_swing["reversal"][f"{elements} elements"] == approx(time, abs=5e-4)


def test_swing_keeps_its_energy_through_the_reversal_and_has_its_largest_force_there(
    three_bar_swing,
):
    runs = three_bar_swing["schemes"]["EnergyMomentum"]
    for dt in (1e-3, 5e-4, 2.5e-4):
        run = runs[f"dt {dt:g}"]
        assert run["failure"] is None and run["halvings"] == 0
        assert run["energy after the pulse"] == approx(0.06389, rel=1e-3)
        assert run["energy drift"] < 1e-10
        assert run["reversal"] == approx(0.639, abs=2e-3)
    assert runs["dt 0.0005"]["largest axial force"] == approx(142, rel=0.03)
    assert runs["dt 0.0005"]["time of the largest axial force"] == approx(0.6406, abs=2e-3)


def test_swing_axial_force_varies_along_the_beam_and_is_not_the_links(three_bar_swing):
    forces = three_bar_swing["axial force at the peak of the pulse"]
    low, high = forces["beam"]
    # The mass is pushed to the right: the half before it is pulled, that behind it pressed.
    assert low < -0.02 < forces["left link"] < 0 < 0.01 < high


def test_swing_links_with_mass_turn_back_later_and_with_less_force(three_bar_swing):
    heavy = three_bar_swing["links with the beam's mass per length"]
    assert heavy["reversal"] == approx(0.645, abs=1e-3)
    assert heavy["largest axial force"] == approx(88, rel=0.03)
    assert heavy["energy drift"] < 1e-10


def test_swing_other_schemes_lose_energy_in_the_reversal(three_bar_swing):
    runs = {scheme: run["dt 0.0005"] for scheme, run in three_bar_swing["schemes"].items()}
    for scheme in ("Newmark (trapezoidal)", "HHT, alpha = -0.1"):
        assert runs[scheme]["lowest energy ratio"] < 0.95
    assert 1e-8 < runs["ModifiedMidPoint (as published)"]["energy drift"] < 1e-4
