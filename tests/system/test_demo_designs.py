"""The numbers of the demos that scan, fit and optimise."""

import numpy as np
import pytest
from demo_runs import SMALL
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow


# -- design_map


def test_slow_cranks_may_have_thin_rods_and_fast_ones_none_of_these(design_map):
    assert design_map["points"] == 12 and design_map["smallest deflection"] < 1e-3
    slow, middle, fast = design_map["thinnest rod"].values()
    assert slow == approx(2.5e-3) and (middle or np.inf) > 4e-3 and fast is None


def test_a_stiff_rod_bends_with_the_square_of_speed_over_height():
    bent, stiff = demo("design_map").bent, {"height": 7e-3, "speed": 5.0}
    for other in (stiff | {"height": 5e-3}, stiff | {"speed": 7.0}):
        ratio = other["speed"] / other["height"] * stiff["height"] / stiff["speed"]
        assert bent(other)["deflection"] / bent(stiff)["deflection"] == approx(ratio**2, rel=0.2)


def test_the_thinnest_rod_is_that_from_which_on_all_are_stiff_enough():
    for deflection, height in (
        ([0.005, 0.02, 0.008], 3.0),
        ([0.001, 0.002, 0.003], 1.0),
        ([np.nan, 0.009, 0.008], 2.0),
        ([0.001, 0.002, np.nan], None),
    ):
        assert demo("design_map").thinnest([1.0, 2.0, 3.0], np.array(deflection)) == height


# -- fast_arm


def test_the_tip_stays_at_its_goal_also_with_finer_steps_and_elements(fast_arm):
    arm = demo("fast_arm")
    for name in ("40 numbers", "best polynomial", "degree 5"):
        own = fast_arm[name]
        assert own["tip off its goal"] <= arm.LIMIT
        assert own["with finer steps and elements"] <= arm.LIMIT
        assert own["energy left"] < 1e-3 * own["largest energy"]
        assert own["largest acceleration"] <= (1 + 1e-9) * arm.A_MAX
        assert own["largest energy error"] < 1e-10 * own["largest energy"]


def test_40_numbers_take_less_time_than_polynomials_and_more_than_a_rigid_arm(fast_arm):
    arm, T = demo("fast_arm"), fast_arm["40 numbers"]["T"]
    assert fast_arm["rigid arm"]["T"] < T < 0.85 * fast_arm["degree 5"]["T"]
    assert fast_arm["degree 5, as fast"]["tip off its goal"] > 0.1
    # No polynomial of degree 9 with the limited acceleration is as fast.
    polynomial = arm.Turn(T, arm.POLYNOMIAL)
    start = np.linalg.lstsq(arm.POLYNOMIAL, arm.quintic(T), rcond=None)[0]
    c = polynomial.best(start)
    # The optimiser keeps the limit to 1e-6 ... 2e-5, by round-off; what is beyond it only helps c.
    assert 0.99 < abs(arm.POLYNOMIAL @ c).max() < 1.001
    assert polynomial.largest(c) > 10 * arm.LIMIT


def test_the_gradient_is_that_of_differences():
    arm = demo("fast_arm")
    turn = arm.Turn(0.85)
    rng = np.random.default_rng(3)
    c = arm.quintic(0.85) + 0.1 * rng.standard_normal(arm.INTERVALS)
    _, gradient = turn.cost(c)
    for h in (rng.standard_normal(arm.INTERVALS), np.eye(arm.INTERVALS)[7]):
        h *= 1e-4
        ahead, behind = ((turn.off(numbers) ** 2).sum() for numbers in (c + h, c - h))
        difference = (ahead - behind) / 2 / (arm.LIMIT**2 * arm.WINDOW / turn.dt)
        assert difference == approx(gradient @ h, rel=1e-5)


def test_the_motor_goes_by_90_degrees_and_stops():
    arm = demo("fast_arm")
    angle = arm.motor(arm.quintic(1.2), 1.2)
    assert angle(0.0) == 0 and angle(0.6) == approx(arm.ANGLE / 2)
    assert (angle(1.2), angle(1.3)) == approx((arm.ANGLE, arm.ANGLE))
    # The polynomial of degree 5 at a fourth of its time.
    s = 0.25
    assert angle(0.3) == approx(arm.ANGLE * s**3 * (10 - 15 * s + 6 * s**2), rel=1e-2)


# -- identification


def test_what_is_left_is_the_noise(identification):
    for how in ("with the Jacobian", "with differences"):
        assert identification[how]["chi^2 per value"] == approx(1, abs=0.06)


def test_the_true_numbers_are_near_those_found_in_terms_of_their_intervals(identification):
    numbers = [identification[name] for name in demo("identification").NAMES]
    # Each is outside of its interval once in 20 times, and beyond twice its width once in 10 000.
    assert sum(number["inside"] for number in numbers) >= 5
    for number in numbers:
        error = abs(np.log(number["found"] / number["true"]))
        assert error < 2 * number["relative half width of 95 %"] < 0.8


def test_the_jacobian_takes_an_eighth_of_the_motions_to_the_same_numbers(identification):
    exact, differences = (
        identification[f"with {how}"]["motions"] for how in ("the Jacobian", "differences")
    )
    assert 7 * exact < differences
    names = demo("identification").NAMES
    widths = (identification[n]["relative half width of 95 %"] for n in names)
    assert identification["largest difference of z"] < min(widths)


# -- monte_carlo


def test_the_scatter_is_that_of_its_parameters(monte_carlo):
    assert monte_carlo["samples"] == SMALL["monte_carlo"]["samples"]
    mean, deviation = monte_carlo["mean"], monte_carlo["standard deviation"]
    # Standard errors of a mean and of a standard deviation; the moment is not linear.
    assert abs(mean - monte_carlo["nominal"]) < 4 * monte_carlo["standard error of the mean"]
    assert deviation == approx(monte_carlo["linear standard deviation"], rel=0.4)
    assert mean < monte_carlo["99 % stay below"] < mean + 4 * deviation


def test_the_scatter_is_mostly_that_of_the_speed(monte_carlo):
    effects = monte_carlo["effect of one standard deviation"]
    assert effects["T"] < 0 and abs(effects["T"]) == max(map(abs, effects.values()))
    # The inertia forces grow with the square of the speed, here somewhat more.
    assert effects["T"] / monte_carlo["nominal"] < -2 * demo("monte_carlo").SCATTER["T"]


def test_samples_are_the_same_in_each_run_and_have_the_scatter_that_is_said():
    module = demo("monte_carlo")
    assert module.sampled(3) == module.sampled(5)[:3]
    for name in module.NOMINAL:
        values = np.array([case[name] for case in module.sampled(4000)]) / module.NOMINAL[name]
        assert values.mean() == approx(1, abs=4 * module.SCATTER[name] / np.sqrt(4000))
        assert values.std() == approx(module.SCATTER[name], rel=0.05)


# -- whip_taper

WHIPS = "uniform", "linear", "optimised"


def test_the_tip_becomes_far_faster_than_that_of_the_uniform_and_the_best_linear_whip(whip_taper):
    uniform, linear, best = (whip_taper[name]["largest speed"] for name in WHIPS)
    assert best > 2.5 * uniform and best > 1.25 * linear


def test_all_whips_are_confirmed_by_finer_ones_and_have_one_mass_and_a_least_height(whip_taper):
    whip = demo("whip_taper")
    for own in (whip_taper[name] for name in WHIPS):
        assert own["refined"] == approx(own["largest speed"], rel=0.04)
        assert 1 < own["smoothed"] / own["largest speed"] < 1.12
        assert own["mass"] == approx(whip_taper["uniform"]["mass"], rel=1e-12)
        heights = np.array(own["heights"]) / 1e3
        assert heights.mean() == approx(whip.HEIGHT, rel=1e-12)
        assert heights.min() >= whip.LEAST * whip.HEIGHT * (1 - 1e-12)


def test_the_gradient_is_that_of_differences_of_motions(whip_taper):
    assert whip_taper["gradient"]["error by differences"] < 1e-6


def test_no_element_of_the_optimised_whip_gains_at_its_mass(whip_taper):
    # First-order conditions: zero where the height is free, not positive where it is the least.
    whip, own = demo("whip_taper"), whip_taper["optimised"]
    gain = np.array(own["gain"])
    free = np.array(own["heights"]) > 1.05e3 * whip.LEAST * whip.HEIGHT
    scale = abs(np.array(whip_taper["linear"]["gain"])).max()
    assert 4 < free.sum() < free.size
    assert abs(gain[free]).max() < 0.06 * scale
    assert gain[~free].max() < 0


# -- tuned_damper, strongest_column, band_gap


def test_the_damper_of_a_mass_on_a_spring_is_that_of_the_closed_form(tuned_damper):
    height = tuned_damper["peaks, exact"]
    assert tuned_damper["peaks over static"] == approx([height, height], rel=1e-6)
    assert tuned_damper["stiffness over exact"] == approx(1, rel=1e-4)
    assert tuned_damper["viscosity over exact"] == approx(1, rel=1e-3)
    assert max(tuned_damper["peaks by Den Hartog"]) > height


def test_both_peaks_of_the_mast_are_equal_and_lower_than_by_the_rules(tuned_damper):
    mast = tuned_damper["mast"]
    assert mast["peaks"][0] == approx(mast["peaks"][1], rel=1e-5)
    assert max(mast["peaks"]) < 0.97 * max(mast["peaks by Den Hartog"])


def test_the_strongest_column_goes_to_that_of_keller_with_its_numbers(strongest_column):
    few, some, many = strongest_column.values()
    loads = [4 / 3 - whip["load over uniform"] for whip in (few, some, many)]
    assert 0 < loads[2] < 0.4 * loads[1] < 0.1 * loads[0]
    assert many["largest error of areas"] < 0.05 < few["largest error of areas"]


def test_the_band_is_where_it_was_wanted_as_for_a_chain_of_masses(band_gap):
    lower, upper = band_gap["edges"]
    assert np.sqrt(lower * upper) == approx(1000.0, rel=1e-6)
    assert band_gap["edges"] == approx(band_gap["edges by theory"], rel=0.05)
    assert band_gap["mass of arm and lump over budget"] == approx(1, rel=1e-9)
    at_first = band_gap["least transmission near at first"]
    assert band_gap["largest transmission near"] < 0.05 * at_first
