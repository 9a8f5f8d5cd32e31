"""A quantity is refined in step and mesh until it is known."""

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, pinned_bar

import fx_beam as fb


def cantilever(elements, degree):
    """A beam under its weight, released at once."""
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
    scene, beam = clamped_bar((1, 0), section, elements, degree, name="arm", gravity=(0, -9.81))
    return scene


def tip(solution):
    return solution.displacement(solution.beams["arm"].end)[-1]


@pytest.fixture(scope="module")
def exact():
    scene = cantilever(32, 2)
    return tip(fb.simulate(scene, fb.EnergyMomentum(4), dt=1e-3, t_end=0.4))


@pytest.mark.parametrize("tolerance", [2e-2, 2e-3, 2e-4])
def test_the_error_of_the_quantity_is_below_the_tolerance_and_the_estimate_says_so(
    tolerance, exact
):
    convergence = fb.converge(cantilever, tip, tolerance, t_end=0.4)
    error = abs(convergence.value - exact).max()
    assert error < tolerance
    assert (
        error / 3
        < convergence.error
        == convergence.step_error + convergence.mesh_error
        <= tolerance
    )
    assert (convergence.value == tip(convergence.solution)).all()
    assert convergence.runs >= 4 and convergence.steps > convergence.solution.stats.steps


def test_the_larger_of_the_two_errors_is_refined():
    # A rigid pendulum: its mesh has no error.
    def scene_of(elements, degree):
        section = fb.Section(EA=1e8, GA=1e8, EI=1e6, rhoA=1.0, rhoI=1e-4)
        scene, bar = pinned_bar((0.5, 0), section, elements, degree, name="arm", gravity=(0, -9.81))
        return scene

    convergence = fb.converge(scene_of, tip, 2e-5, t_end=0.6, elements=2)
    assert convergence.elements == 4 and convergence.tolerance < 1e-3
    assert convergence.mesh_error < convergence.step_error


def test_a_small_change_between_two_runs_may_be_chance():
    """From 8 to 16 elements the quantity hardly changes, after a large change: it goes on."""
    values = {4: 0.0, 8: 1.0, 16: 1.01, 32: 1.25, 64: 1.3125, 128: 1.328125}  # tends to 4/3

    def quantity(solution):
        return values[len(solution.beams["arm"].s) - 1]

    convergence = fb.converge(cantilever, quantity, 0.03, t_end=0.01)
    assert convergence.error < 0.03 and abs(convergence.value - 4 / 3) < convergence.error
    rough = fb.converge(cantilever, quantity, 0.1, t_end=0.01)  # an eighth of the first error
    assert rough.error == 0.5 / 8


def test_a_quantity_that_does_not_converge_is_reported_with_the_last_solution():
    numbers = iter(range(100))
    with pytest.raises(fb.StepError, match="not known") as raised:
        fb.converge(cantilever, lambda s: float(next(numbers)), 1e-3, t_end=0.1, max_runs=4)
    assert raised.value.failure.kind == "not converged"
    assert raised.value.solution.t[-1] == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene_of": cantilever(4, 1)}, "scene_of"),
        ({"quantity": 1.0}, "quantity"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"elements": 0}, "elements"),
        ({"max_runs": 1}, "max_runs"),
        ({"quantity": lambda solution: np.nan}, "finite"),
    ],
)
def test_invalid_options_are_refused(options, message):
    arguments = {"scene_of": cantilever, "quantity": tip, "tolerance": 1e-2, "t_end": 0.1} | options
    assert_refused(message, fb.converge, **arguments)
