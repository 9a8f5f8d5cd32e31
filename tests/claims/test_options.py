"""Options of the analyses and parameters of schemes that are refused where they are given."""

import math
from fractions import Fraction

import numpy as np
import pytest

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
NO_NUMBERS = [math.nan, math.inf, -math.inf, "1", None, True, (0.5,), np.array([0.5]), 10**400]
NO_COUNTS = [-1, 2.5, 2.0, math.nan, "2", None, True, np.array([2])]


def cantilever():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, 1.0))
    return scene


def refuses(call, what, wanted):
    """Whether a call is refused with a sentence on one argument and what it may be."""
    with pytest.raises(fb.SceneError) as error:
        call()
    message = str(error.value)
    assert message.startswith(what), message
    assert f"must {wanted}" in message


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("tolerance", [0.0, -1e-10, 1.0, *NO_NUMBERS], "be a number"),
        ("max_iterations", [0, *NO_COUNTS], "be a whole number from 1 on"),
        ("max_turn", [0.0, -1.0, 7, math.pi, *NO_NUMBERS], "be a number between"),
    ],
)
def test_options_of_newtons_method_are_what_they_should_be(name, values, wanted):
    for value in values:
        refuses(
            lambda value=value: fb.NewtonOptions(**{name: value}),
            f"NewtonOptions: {name} = ",
            wanted,
        )


@pytest.mark.parametrize(
    "options",
    [
        fb.NewtonOptions(tolerance=np.float32(1e-6), max_iterations=np.int64(9), max_turn=3),
        fb.NewtonOptions(1e-30, 1, np.float64(0.01)),
    ],
    ids=str,
)
def test_numbers_of_numpy_are_numbers(options):
    scene = cantilever()
    scene.loads.clear()
    for solver in ("compiled", "petsc"):
        fb.simulate(scene, dt=np.float32(0.5), t_end=np.int32(1), newton=options, solver=solver)


# -- simulate ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "kind"), [("dt", "positive"), ("t_end", "finite")])
def test_times_are_finite_numbers(name, kind):
    for value in NO_NUMBERS:
        given = {"dt": 0.1, "t_end": 1.0} | {name: value}
        refuses(
            lambda given=given: fb.simulate(cantilever(), **given),
            f"{name} = ",
            f"be a {kind} number",
        )


def test_a_fraction_is_a_number():
    solution = fb.simulate(cantilever(), dt=Fraction(1, 4), t_end=Fraction(1, 2))
    assert solution.t.tolist() == [0.0, 0.25, 0.5]


def test_more_steps_than_can_be_taken_are_refused():
    with pytest.raises(fb.SceneError, match=r"dt = .* steps to t_end = 1.0 are more than"):
        fb.simulate(cantilever(), dt=1e-12, t_end=1.0)


WRONG = {
    "newton": ["x", 1e-8, True, fb.NewtonOptions, {}],
    "max_halvings": [*NO_COUNTS, 51],
    "record": [True, "motion", fb.Record, 3],
    "solver": [None, "PETSc", 1, np.array(["auto", "petsc"])],
    "progress": ["yes", 1, 0.5],
}


def simulated(**options):
    return fb.simulate(cantilever(), dt=0.1, t_end=0.1, **options)


@pytest.mark.parametrize("name", WRONG)
def test_options_of_simulate_are_what_they_should_be(name):
    for value in WRONG[name]:
        refuses(lambda value=value: simulated(**{name: value}), f"simulate: {name} = ", "be ")


def test_a_start_is_a_solution():
    for value in (3, "run.npz", fb.Solution, True):
        refuses(lambda value=value: simulated(start=value), "start", "be a Solution")


def test_a_start_of_another_scene_is_refused():
    other = fb.Scene()
    other.clamp(other.add_beam([(0, 0), (2, 0)], SECTION).start)
    finer = fb.Scene()
    finer.clamp(finer.add_beam([(0, 0), (1, 0)], SECTION, elements=2).start)
    for scene in (other, finer):
        start = fb.simulate(scene, dt=0.1, t_end=0.1)
        with pytest.raises(fb.SceneError, match="start: the solution has other nodes"):
            fb.simulate(cantilever(), dt=0.1, t_end=0.2, start=start)


# -- static and modes ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("steps", [0, *NO_COUNTS]),
        ("max_steps", [0, *NO_COUNTS]),
        ("max_cuts", [51, *NO_COUNTS]),
        ("t", NO_NUMBERS),
        ("newton", ["x", 3, fb.NewtonOptions]),
        ("continuation", [True, "arc", "", np.array(["arc-length"])]),
    ],
)
def test_options_of_static_are_what_they_should_be(name, values):
    scene = cantilever()
    for value in values:
        refuses(lambda value=value: fb.static(scene, **{name: value}), f"static: {name} = ", "be ")


def test_modes_are_counted_from_1():
    scene = cantilever()
    for value in (0, *NO_COUNTS):
        refuses(
            lambda value=value: fb.modes(scene, n=value), "modes: n = ", "be a whole number from 1"
        )


# -- Schemes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda x: fb.HHT(alpha=x), "HHT: alpha"),
        (lambda x: fb.GeneralizedAlpha(rho_inf=x), "GeneralizedAlpha: rho_inf"),
        (lambda x: fb.Newmark(beta=x), "Newmark: beta"),
        (lambda x: fb.Newmark(gamma=x), "Newmark: gamma"),
    ],
    ids=["alpha", "rho_inf", "beta", "gamma"],
)
def test_parameters_of_schemes_are_numbers(make, name):
    for value in (*NO_NUMBERS, False, 1j):
        refuses(lambda value=value: make(value), f"{name} = ", "lie in")


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("beta", [*NO_NUMBERS, 0.0], "be a number between"),
        ("gamma", NO_NUMBERS, "be a number"),
        ("alpha_m", [*NO_NUMBERS, 1], "be a number between"),
        ("alpha_f", [*NO_NUMBERS, 1.0], "be a number between"),
    ],
)
def test_parameters_of_newmark_rates_are_numbers_with_a_meaning(name, values, wanted):
    for value in values:
        given = {"beta": 0.25, "gamma": 0.5} | {name: value}
        refuses(lambda given=given: fb.NewmarkRates(**given), f"NewmarkRates: {name} = ", wanted)


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("name", (3, lambda step, law: None, fb.MidPointRates())),
        ("resultants", ("own", None, fb.MidPointRates())),
        ("rates", ("own", lambda step, law: None, fb.MidPointRates)),
        ("rates", ("own", lambda step, law: None, 0.5)),
    ],
    ids=["name", "resultants", "rates as a class", "rates as a number"],
)
def test_a_scheme_of_ones_own_needs_its_parts(name, given):
    refuses(lambda: fb.Scheme(*given), f"Scheme: {name} = ", "be ")


@pytest.mark.parametrize("elements", [True, 2.0, "2", 0, [True]], ids=repr)
def test_elements_are_counted(elements):
    with pytest.raises(fb.SceneError, match=r"elements = .* must be positive whole numbers"):
        fb.Scene().add_beam([(0, 0), (1, 0)], SECTION, elements=elements)
