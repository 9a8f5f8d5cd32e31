"""Newton's method: the guard, halving, round-off, and failures that explain themselves."""

import pytest
from scenes import pendulum, pinned_beam, relative_drift, spinner

import fx_beam as fb


def test_a_step_that_turns_a_node_too_far_is_halved():
    # The mid-point rule turns by 2 arctan(spin dt / 2) = 2.2 rad a step, beyond the bound of 2.
    scene, beam = spinner(40.0)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    # Every step needs it, and no longer fails first once that is known.
    assert 1 <= solution.stats.halvings < 10
    assert (solution.stats.steps, solution.stats.substeps) == (10, 20)
    fine = fb.simulate(scene, dt=0.05, t_end=1.0)
    assert abs(solution.q - fine.q[::2]).max() < 1e-9
    assert relative_drift(solution.energy.total) < 1e-10


def test_without_halving_it_is_an_error_that_says_what_happened():
    scene, _ = spinner(40.0)
    with pytest.raises(fb.StepError, match="turns by .* rad in one step") as error:
        fb.simulate(scene, dt=0.1, t_end=1.0, max_halvings=0)
    message = str(error.value)
    for part in ("from t = 0 to 0.1", "rotation of node", "Last corrections", "smaller dt"):
        assert part in message
    assert error.value.time == 0.0
    assert len(error.value.solution.t) == 1


def test_a_turn_just_below_the_bound_is_not_halved():
    scene, _ = spinner(18.0)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    assert solution.stats.halvings == 0
    assert relative_drift(solution.energy.total) < 1e-10


def test_too_few_iterations_are_named():
    scene, _ = pinned_beam()
    options = fb.NewtonOptions(max_iterations=2)
    with pytest.raises(fb.StepError, match="no convergence in 2 iterations"):
        fb.simulate(scene, dt=0.01, t_end=0.1, newton=options, max_halvings=0)


@pytest.mark.parametrize("EA", [1e4, 1e8, 1e12, 1e14, 1e16])
@pytest.mark.parametrize("dt", [0.1, 0.01, 0.05])
def test_a_stiff_step_converges_until_no_energy_is_missing(EA, dt):
    # The rounding of a strain, 1e-16, is a force of 1e-16 EA, up to 1 N of 15 N; the energy that
    # it makes is none. A small correction alone does not end a step here: another one may follow.
    # In one motion of fifteen that differ in the last digit of dt the longest step is halved once.
    scene, _ = pendulum(EA=EA)
    most = 1 if (EA, dt) == (1e16, 0.1) else 0
    solution = fb.simulate(scene, dt=dt, t_end=60 * dt, max_halvings=most)
    assert solution.stats.steps == 60
    assert relative_drift(solution.energy.total) < 1e-11


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying()], ids=lambda s: s.name)
def test_no_step_at_the_limit_of_rounding_ends_before_its_equations_are_solved(scheme):
    # EA is 1e15 / m^2 times EI. Steps that differ in the last digit have other rounding errors.
    for digits in range(-5, 5):
        dt = 0.1 * (1 + digits * 2.0**-51)
        energy = fb.simulate(pendulum(EA=1e18)[0], scheme, dt=dt, t_end=500 * dt).energy
        assert abs(energy.balance_error).max() < 1e-7 * energy.total.max()


def test_a_motion_too_slight_for_its_rounding_still_converges():
    # Strains of 1e-16: what the residual lacks is rounding, however often it is corrected.
    scene, beam = pinned_beam(elements=32)
    scene.velocities.clear()
    scene.set_velocity(beam, lambda x, y: (0.0, 1e-12 * x), spin=1e-12)
    solution = fb.simulate(scene, dt=0.01, t_end=0.2, max_halvings=0)
    assert solution.stats.steps == 20
    assert solution.stats.newton_iterations <= 4 * 20


def test_a_tolerance_below_the_rounding_ends_at_round_off():
    scene, _ = pinned_beam()
    strict = fb.NewtonOptions(tolerance=1e-30)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0, newton=strict)
    assert solution.stats.ended_by == {"round-off": 100}
    assert solution.stats.halvings == 0
    assert relative_drift(solution.energy.total) < 1e-12
    usual = fb.simulate(scene, dt=0.01, t_end=1.0)
    assert usual.stats.ended_by == {"increment": 100}
    assert abs(usual.q - solution.q).max() < 1e-9 * 100


def test_convergence_is_quadratic():
    scene, _ = pinned_beam()
    iterations = [
        fb.simulate(
            scene, dt=0.001, t_end=0.05, newton=fb.NewtonOptions(tolerance=tolerance)
        ).stats.newton_iterations
        for tolerance in (1e-4, 1e-8)
    ]
    # Twice the digits for one more iteration a step, hardly ever two.
    assert iterations[1] - iterations[0] <= 55


def test_large_steps_of_the_pinned_beam_converge_without_halving():
    scene, _ = pinned_beam()
    for dt in (0.015, 0.02, 0.025, 0.03, 0.04):
        assert fb.simulate(scene, dt=dt, t_end=10.0).stats.halvings == 0
