"""A tolerance chooses the steps: reached errors, stiff vibrations, jumps, rows between steps."""

import functools

import numpy as np
import pytest
from scenes import assert_refused, demo, free_flight, pendulum, pinned_bar
from scipy.interpolate import CubicHermiteSpline

import fx_beam as fb

TOLERANCES = 1e-2, 1e-3, 1e-5
# Scene, its end [s], steps of the reference, where its loads jump [s], where they have kinks [s].
# The references are exact to 6e-7 of the size of the scene: steps half as long change them by no
# more. Their steps end at jumps and kinks.
CASES = {
    "pendulum": (lambda: demo("pendulum").scene()[0], 5.0, 2000, (), ()),
    "free flight": (lambda: free_flight()[0], 3.2, 1920, (2.5,), ()),
    "swing": (lambda: demo("three_bar_swing").scene(), 0.6, 1500, (), (0.128, 0.256)),
    "multi-body system": (lambda: demo("multibody").scene()[0], 0.3, 900, (), (0.25,)),
}


def reference(scene, t_end, steps):
    """Displacements over time from a run with constant steps of order 4."""
    record = fb.Record(forces=False)
    exact = fb.simulate(scene, fb.EnergyMomentum(4), dt=t_end / steps, t_end=t_end, record=record)
    return CubicHermiteSpline(exact.t, exact.q[..., :2], exact.v[..., :2])


@functools.cache
def reference_of(name):
    scene, t_end, steps, *_ = CASES[name]
    return reference(scene(), t_end, steps)


@functools.cache
def controlled(name, order, tolerance, breaks):
    scene, t_end, *_ = CASES[name]
    options = {"t_end": t_end, "tolerance": tolerance, "breaks": breaks}
    return fb.simulate(scene(), fb.EnergyMomentum(order), **options)


def error(solution, exact):
    """Largest error of a displacement over time, relative to the size of the scene."""
    size = np.ptp(solution.X, axis=0).max()
    return abs(solution.q[..., :2] - exact(solution.t)).max() / size


@pytest.fixture(scope="module", params=CASES)
def case(request):
    _, _, _, jumps, kinks = CASES[request.param]
    return request.param, jumps, kinks, reference_of(request.param)


@pytest.mark.exact_times
def test_the_reached_error_follows_the_tolerance_over_four_decades(case):
    name, jumps, _, exact = case
    for tolerance in TOLERANCES:
        solution = controlled(name, 2, tolerance, jumps)
        ratio = error(solution, exact) / tolerance
        # In the swing errors cancel: it is often more accurate than asked.
        assert (0.02 if name == "swing" else 0.2) < ratio < 5, (tolerance, ratio)
        energy = solution.energy
        assert abs(energy.balance_error).max() < 1e-11 * abs(energy.total).max()


@pytest.mark.exact_times
def test_order_four_keeps_the_tolerance_with_fewer_sub_steps(case):
    name, jumps, kinks, exact = case
    for tolerance in TOLERANCES[1:]:
        four = controlled(name, 4, tolerance, (*jumps, *kinks))
        ratio = error(four, exact) / tolerance
        assert (0.02 if name == "swing" else 0.1) < ratio < 5, (tolerance, ratio)
        energy = four.energy
        assert abs(energy.balance_error).max() < 1e-11 * abs(energy.total).max()
    two = controlled(name, 2, tolerance, (*jumps, *kinks))
    assert 5 * four.stats.steps < 0.6 * two.stats.steps


def test_a_stiff_rod_does_not_shorten_the_steps():
    soft, stiff = (
        fb.simulate(pendulum(EA=EA)[0], t_end=3.0, tolerance=1e-3).stats.steps for EA in (1e8, 1e10)
    )
    assert abs(stiff / soft - 1) < 0.05
    solution = fb.simulate(pendulum()[0], t_end=3.0, tolerance=1e-3)
    # A tenth of a period of the rod's vibration is 4e-6 s; a swing takes 1.4 s.
    assert np.diff(solution.t).min() > 2e-3


def test_the_swing_passes_its_reversal_with_far_fewer_steps_than_constant_ones():
    scene, t_end = demo("three_bar_swing").scene, 0.66
    exact = reference(scene(), t_end, 3300)
    solution = fb.simulate(scene(), t_end=t_end, tolerance=1e-3, breaks=(0.128, 0.256))
    steps = solution.stats.steps + solution.stats.rejected
    constant = fb.simulate(scene(), dt=t_end / (3 * steps), t_end=t_end)
    assert error(solution, exact) < error(constant, exact) / 2


def test_steps_change_their_length_rarely_and_by_fixed_ratios():
    solution = fb.simulate(pendulum()[0], t_end=3.0, tolerance=1e-4)
    lengths = np.diff(solution.t)[:-3]  # the last ones end at t_end
    ratios = lengths[1:] / lengths[:-1]
    changed = ratios[abs(ratios - 1) > 1e-6]
    assert 5 < len(changed) < 0.05 * len(lengths)
    levels = 2.5 * np.log2(changed)
    assert abs(levels - levels.round()).max() < 1e-6
    assert solution.stats.rejected < 0.02 * len(lengths)


def test_breaks_are_met_and_other_jumps_are_found_by_rejected_steps():
    scene, beam = pendulum()
    scene.add_force(beam.end, lambda t: (40.0 * (t > 0.5), 0.0))
    options = {"t_end": 1.0, "tolerance": 1e-4}
    with_breaks = fb.simulate(scene, breaks=[0.5, 0.0, 9.0], **options)
    motion = fb.simulate(scene, **options)
    assert 0.5 in with_breaks.t and 0.5 not in motion.t
    at_jump = np.searchsorted(motion.t, 0.5) - 1
    assert np.diff(motion.t)[at_jump] < 0.5 * np.diff(motion.t)[at_jump - 20]
    exact = reference(scene, 1.0, 1000)  # its steps meet the jump
    assert error(with_breaks, exact) < 5e-4
    for solution in (motion, with_breaks):
        energy = solution.energy
        assert abs(energy.balance_error).max() < 1e-11 * abs(energy.total).max()


def test_dt_max_bounds_the_steps_and_dt_is_tried_first():
    scene, _ = pendulum()
    solution = fb.simulate(scene, t_end=1.0, tolerance=1e-2, dt=5e-4, dt_max=2e-3)
    assert np.diff(solution.t).max() <= 2e-3 * (1 + 1e-9)
    assert solution.t[1] == pytest.approx(5e-4)
    # The end is met without a tiny step.
    solution = fb.simulate(scene, t_end=1.0, tolerance=0.1, dt=0.03, dt_max=0.03)
    assert solution.t[-1] == 1.0
    assert 0.02 < np.diff(solution.t).min() and np.diff(solution.t).max() < 0.031


def test_a_step_in_which_newtons_method_fails_is_shortened():
    scene, _ = free_flight()
    few = fb.NewtonOptions(max_iterations=3)
    options = {"t_end": 1.0, "newton": few, "tolerance": 0.1}
    solution = fb.simulate(scene, **options)
    assert solution.stats.halvings > 0 and solution.t[-1] == 1.0
    with pytest.raises(fb.StepError, match="no convergence"):
        fb.simulate(scene, max_halvings=0, **options)


def test_a_jump_of_a_support_that_no_step_can_follow_is_reported():
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene, beam = pinned_bar((1, 0), section, elements=2)
    scene.prescribe(beam.start, rotation=lambda t: 0.3 * (t > 0.5))
    with pytest.raises(fb.StepError, match="breaks") as raised:
        fb.simulate(scene, t_end=1.0, tolerance=1e-3)
    assert raised.value.failure.kind == "too short"
    assert raised.value.solution.t[-1] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(("order", "tolerance"), [(2, 1e-3), (4, 1e-4)])
def test_rows_at_chosen_times_are_as_accurate_as_the_steps(order, tolerance):
    scene, joints = demo("multibody").scene()
    exact, times = reference_of("multi-body system"), np.linspace(0.0, 0.3, 101)
    options = {"t_end": 0.3, "tolerance": tolerance, "breaks": [0.25, 9.0]}
    scheme, record = fb.EnergyMomentum(order), fb.Record(times=times)
    solution = fb.simulate(scene, scheme, record=record, **options)
    steps = fb.simulate(scene, scheme, **options)
    assert solution.t == pytest.approx(times)
    assert error(solution, exact) < 1.5 * error(steps, exact)
    # The gap is that of the interpolation.
    assert max(solution.joint(joint).gap.max() for joint in joints.values()) < 1e-3
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.total.max()
    assert solution.resultants("member 2").N.shape == (101, 5)
    assert solution.joint(joints["A"]).force.shape == (101, 3)
    # The velocities are those of the displacements.
    close = fb.Record(times=[0.2 - 1e-6, 0.2, 0.2 + 1e-6])
    near = fb.simulate(scene, scheme, record=close, **options)
    rate = (near.q[2] - near.q[0]) / 2e-6
    assert near.v[1] == pytest.approx(rate, abs=1e-6 * abs(rate).max())


def test_rows_at_the_ends_of_steps_are_those_of_the_steps():
    scene, _ = pendulum()
    steps = fb.simulate(scene, dt=0.01, t_end=0.5)
    rows = fb.simulate(scene, dt=0.01, t_end=0.5, record=fb.Record(times=steps.t[::5]))
    assert abs(rows.q - steps.q[::5]).max() < 1e-14
    assert rows.energy.kinetic == pytest.approx(steps.energy.kinetic[::5])
    assert rows.reactions[1:] == pytest.approx(steps.reactions[5::5])


def test_newmarks_scheme_follows_a_tolerance_and_schemes_of_order_one_are_refused():
    scene, _ = pendulum(EA=1e4)
    exact = reference(scene, 1.0, 1000)
    for tolerance in (1e-3, 1e-4):
        solution = fb.simulate(scene, fb.Newmark(), t_end=1.0, tolerance=tolerance)
        assert 0.2 < error(solution, exact) / tolerance < 5
    for scheme in (fb.Newmark(gamma=0.6), fb.EnergyDecaying(order=1)):
        assert_refused("order 1", fb.simulate, scene, scheme, t_end=1.0, tolerance=1e-3)


def disc(scene, inertia, *carriers, **laws):
    """A flywheel on the ground, or on another one, about its own axis."""
    body = scene.add_body((0, 0), mass=1.0, inertia=inertia)
    carrier = carriers[0].centre if carriers else fb.GROUND
    return body, scene.add_joint(fb.Revolute(carrier, body.centre, **laws))


@pytest.mark.parametrize("order", [2, 4])
def test_what_only_turns_keeps_the_tolerance_in_radians(order):
    # k theta = -J theta'': w = 20 pi /s, and two equal ones with w^2 = (3 -+ 5^0.5) / 2 k / J.
    J, k, w0, speed = 0.05, 200.0, 10.0, np.sqrt(200.0 / 0.05)
    for tolerance in (1e-3, 1e-4):
        options = {"t_end": 2.0, "tolerance": tolerance}
        scene = fb.Scene()
        one, hinge = disc(scene, J, spring=fb.Spring(k))
        scene.set_velocity(one, spin=w0)
        solution = fb.simulate(scene, fb.EnergyMomentum(order), **options)
        exact = w0 / speed * np.sin(speed * solution.t)
        assert abs(solution.joint(hinge).angle - exact).max() < 5 * tolerance
        two, _ = disc(scene, J, one, spring=fb.Spring(k))
        solution = fb.simulate(scene, fb.EnergyMomentum(order), **options)
        squares, modes = np.linalg.eigh(k / J * np.array([[2.0, -1.0], [-1.0, 1.0]]))
        parts = modes.T @ (w0, 0) / np.sqrt(squares)
        exact = modes @ (parts[:, None] * np.sin(np.sqrt(squares)[:, None] * solution.t))
        turned = [solution.rotation(body.centre) for body in (one, two)]
        assert abs(turned - exact).max() < 5 * tolerance


@pytest.mark.parametrize("order", [2, 4])
def test_a_flywheel_with_play_keeps_the_tolerance_in_radians(order):
    # It turns freely by 0.4 rad between two springs; in these it is half of an oscillation.
    J, k, w0, play = 0.05, 200.0, 10.0, 0.2
    half, free = np.pi / np.sqrt(k / J), 2 * play / w0
    scene = fb.Scene()
    wheel, hinge = disc(scene, J, stop=(-play, play, k))
    scene.set_velocity(wheel, spin=w0)
    for tolerance in (1e-3, 1e-4):
        solution = fb.simulate(scene, fb.EnergyMomentum(order), t_end=0.5, tolerance=tolerance)
        phase = (solution.t - free / 2) % (2 * (free + half))
        since_impact = phase % (free + half)
        rate = np.sqrt(k / J)
        inside = play + w0 / rate * np.sin(np.minimum(since_impact, half) * rate)
        angle = np.where(since_impact < half, inside, play - w0 * (since_impact - half))
        angle = np.where(phase < free + half, angle, -angle)
        assert abs(solution.joint(hinge).angle - angle).max() < 5 * tolerance


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("e", [0.3, 0.6, 0.9])
def test_orbits_keep_the_tolerance_also_in_few_steps(e, order):
    # Kepler's orbit about a mass of 1 in (0, 0), from its pericentre and from its apocentre.
    def place(t, start):
        E = t + start
        for _ in range(100):  # Newton's method for E - e sin E = t, which converges from here
            E = E - np.clip((E - e * np.sin(E) - t - start) / (1 - e * np.cos(E)), -0.5, 0.5)
        return np.column_stack([np.cos(E) - e, np.sqrt(1 - e**2) * np.sin(E)])

    for start in (0.0, np.pi):
        scene, x = fb.Scene(), np.cos(start) - e
        body = scene.add_body((x, 0), mass=1.0, inertia=1.0).centre
        scene.add_force_between(body, (0, 0), spring=fb.Spring(strain_energy=lambda r: -1 / r))
        scene.set_velocity(body, (0, np.sign(x) * np.sqrt(2 / abs(x) - 1)))
        scene.fix(body, "rotation")
        for tolerance in (1e-2, 1e-3, 1e-4):
            solution = fb.simulate(scene, fb.EnergyMomentum(order), t_end=10.0, tolerance=tolerance)
            apart = solution.position(body) - place(solution.t, start)
            assert np.hypot(*apart.T).max() < 6 * tolerance, (start, tolerance)


@pytest.mark.parametrize("law", [lambda t: 0.01 * (t > 0.1), lambda t: 0.01 * (t >= 0.1)])
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("kind", ["spring", "motor"])
def test_driven_motions_that_jump_at_a_break_move_at_once(kind, order, law):
    """Masses keep their rates, but for the impulse c J of a damper; against closed forms."""
    scene = fb.Scene()
    if kind == "spring":  # m x'' + c x' + k x = k J after the jump
        foot, node = (scene.add_body((x, 0), mass=1.0).centre for x in (0.0, 1.0))
        for body in (foot, node):
            scene.fix(body, "y", "rotation")
        scene.prescribe(foot, x=law)
        laws = {"spring": fb.Spring(100.0, rest=1.0), "damper": fb.Damper(1.0)}
        scene.add_force_between(foot, node, **laws)
        component, jump, m, c, k = 0, 0.01, 1.0, 1.0, 100.0
    else:  # an arm that a motor turns at once; its wheel follows by a spring
        arm = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
        wheel = scene.add_body((0, 0), mass=1.0, inertia=0.5)
        node = wheel.centre
        scene.add_joint(fb.Revolute(fb.GROUND, arm, motor=law))
        scene.add_joint(fb.Revolute(arm, node, spring=fb.Spring(50.0), damper=fb.Damper(0.4)))
        component, jump, m, c, k = 2, 0.01, 0.5, 0.4, 50.0
    scheme, tolerance = fb.EnergyMomentum(order=order), 1e-5
    run = fb.simulate(scene, scheme, t_end=0.6, tolerance=tolerance, breaks=[0.1])
    t = np.maximum(run.t - 0.1, 0.0)
    d = c / (2 * m)
    w = np.sqrt(k / m - d * d)
    # Of y = x - J: it starts at -J with the rate c J / m.
    y = jump * np.exp(-d * t) * (-np.cos(w * t) + (c / m - d) / w * np.sin(w * t))
    x = run.rotation(node) if component == 2 else run.displacement(node)[:, component]
    exact = np.where(run.t < 0.1 + 1e-9, 0.0, jump + y)
    assert abs(x - exact).max() < 5 * tolerance
    assert run.stats.steps < 1000
    energy = run.energy
    assert abs(energy.balance_error).max() < 1e-10 * abs(energy.work).max()
    assert energy.kinetic.max() < k * jump**2  # the rates of the jump do not stay


def test_a_driven_motion_that_jumps_has_no_derivatives_and_no_conditions_by_a_tolerance():
    def build(x):
        scene = fb.Scene()
        foot, node = (scene.add_body((i, 0), mass=1.0).centre for i in (0.0, 1.0))
        scene.prescribe(foot, x=lambda t: x[0] * (t > 0.1), y=lambda t: 0.0, rotation=lambda t: 0.0)
        scene.fix(node, "y", "rotation")
        scene.add_force_between(foot, node, spring=fb.Spring(100.0, rest=1.0))
        return scene, {"x": fb.Output("displacement", node, "x")}

    options = {"t_end": 0.3, "tolerance": 1e-4, "breaks": [0.1]}
    with pytest.raises(fb.SceneError, match="jumps at t = 0.1, where there are no derivatives"):
        fb.Response(build, **options)([0.01])
    with pytest.raises(fb.SceneError, match="no conditions"):
        fb.simulate(build([0.01])[0], until=lambda t, y: t - 0.2, **options)


def test_steps_by_a_tolerance_do_not_depend_on_the_direction_of_the_axes():
    def rows(angle):
        c, s = np.cos(angle), np.sin(angle)
        scene = fb.Scene(gravity=(9.81 * s, -9.81 * c))
        section = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
        beam = scene.add_beam([(0, 0), (c, s)], section, elements=2, degree=2)
        scene.pin(beam.start)
        scene.add_mass(beam.end, 2.0)
        run = fb.simulate(scene, t_end=0.3, tolerance=1e-3)
        return len(run.t), np.hypot(*run.displacement(beam.end)[-1])

    (number, along_axes), *turned = map(rows, (0.0, 0.4, np.pi / 4, 2.0))
    assert all(abs(n - number) <= 1 for n, _ in turned)
    assert [size for _, size in turned] == pytest.approx([along_axes] * 3, rel=1e-3)
