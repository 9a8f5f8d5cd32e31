"""Friction in joints, and dampers with laws of their own: closed solutions, balance, solvers."""

import math

import ufl

import numpy as np
import pytest
from jointed import drift, pair, throw

import fx_beam as fb
from fx_beam.fem import dolfinx_api
from fx_beam.fem.compiled_laws import compiled_law
from fx_beam.mechanics.coordinates import SLIDE
from fx_beam.mechanics.point_laws import REMEMBERED, StepRule
from fx_beam.mechanics.scalar_laws import friction

SOLVERS = pytest.mark.parametrize("solver", ["compiled", "petsc"])
SCHEMES = [fb.EnergyMomentum(), fb.EnergyDecaying(0.1), fb.Newmark(), fb.HHT(-0.2)]
STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)


def square(rate):
    return 0.7 * abs(rate) * rate


def block(velocity=2.0, gravity=None, **parts):
    """A block of 2 kg on a rail along (0.6, 0.8)."""
    scene = fb.Scene(gravity=gravity)
    body = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4))
    scene.add_mass(body.start, 2.0)
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, body.start, axis=(3, 4), **parts))
    scene.set_velocity(body, (0.6 * velocity, 0.8 * velocity))
    return scene, joint


def double_pendulum(moment, speed):
    scene = fb.Scene(gravity=(0, -9.81))
    friction = fb.Friction(moment, speed)
    upper = scene.add_beam([(0, 0), (1, 0)], STIFF, elements=2)
    lower = scene.add_beam([(1, 0), (2, 0)], STIFF, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, upper.start, friction=friction))
    scene.add_joint(fb.Revolute(upper.end, lower.start, friction=friction, damper=fb.Damper(0.05)))
    return scene


# -- Closed solutions -----------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_a_block_slides_to_rest_as_the_law_says(scheme):
    # m v' = -F tanh(v / w): sinh(v / w) = sinh(v0 / w) exp(-F t / (m w)).
    m, F, w, v0 = 2.0, 3.0, 0.2, 2.0
    scene, joint = block(v0, friction=fb.Friction(F, w))
    solution = fb.simulate(scene, scheme, dt=0.005, t_end=4.0)
    v = w * np.arcsinh(np.sinh(v0 / w) * np.exp(-F * solution.t / (m * w)))
    assert abs(solution.joint(joint).rate - v).max() < 1e-3
    distance = m * v0**2 / (2 * F)
    longer = np.pi**2 / 6 * (w / v0) ** 2
    assert solution.slide(joint)[-1] == pytest.approx(distance * (1 + longer), rel=1e-4)
    assert np.diff(solution.energy.dissipated).min() >= 0


def test_an_oscillator_with_friction_loses_four_times_the_force_over_the_stiffness_in_a_period():
    k, F = 200.0, 4.0  # 10 rad/s
    scene, joint = block(0.0, spring=fb.Spring(k, rest=1.0), friction=fb.Friction(F, 1e-3))
    period = 2 * np.pi / 10
    solution = fb.simulate(scene, dt=period / 400, t_end=4 * period)
    amplitudes = abs(solution.slide(joint) - 1.0)[::400]
    assert amplitudes == pytest.approx(1.0 - 4 * F / k * np.arange(5), abs=2e-4)


def test_a_wheel_stops_by_the_friction_of_its_hinge():
    # J = rhoA L^3 / 12 + rhoI L about the middle; it stops after J w^2 / (2 M).
    J, M, spin = 8 / 12 + 0.2, 0.5, 4.0
    scene = fb.Scene()
    wheel = scene.add_beam([(-1, 0), (1, 0)], STIFF, elements=2)
    friction = fb.Friction(M, 0.01)
    joint = scene.add_joint(fb.Revolute(fb.GROUND, wheel.node(0.5), friction=friction))
    scene.set_velocity(wheel, lambda x, y: (-spin * y, spin * x), spin=spin)
    solution = fb.simulate(scene, dt=0.01, t_end=8.0)
    angle = solution.joint(joint).angle[-1]
    assert angle == pytest.approx(J * spin**2 / (2 * M), rel=2e-3)
    assert angle > 2 * np.pi


def test_a_block_creeps_under_less_than_the_friction_and_slides_under_more():
    F, w = 3.0, 0.01
    creep = w * np.arctanh(0.5)
    scene, joint = block(0.0, gravity=(0, 0.5 * F / (2 * 0.8)), friction=fb.Friction(F, w))
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.0), dt=0.02, t_end=4.0)
    assert solution.joint(joint).rate[-1] == pytest.approx(creep, rel=1e-6)
    scene, joint = block(0.0, gravity=(0, 1.5 * F / (2 * 0.8)), friction=fb.Friction(F, w))
    slide = fb.simulate(scene, dt=0.02, t_end=2.0).slide(joint)[-1]
    assert slide == pytest.approx(0.5 * F / 2 * 2.0**2 / 2, rel=1e-2)


@SOLVERS
def test_a_damper_with_a_square_law_brakes_like_one_over_the_time(solver):
    # m v' = -c v^2: v = v0 / (1 + c v0 t / m).
    errors = []
    for dt in (0.02, 0.01):
        scene, joint = block(2.0, damper=fb.Damper(law=square))
        solution = fb.simulate(scene, dt=dt, t_end=2.0, solver=solver)
        exact = 2.0 / 0.7 * np.log(1 + 0.7 * 2.0 * solution.t / 2.0)
        errors.append(abs(solution.slide(joint) - exact).max())
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert errors[1] < 1e-4


@pytest.mark.parametrize(
    ("parts", "slope"),
    [
        ({"friction": fb.Friction(0.3, 0.2)}, 1.5),
        ({"damper": fb.Damper(0.5, law=lambda rate: 2 * ufl.sinh(rate))}, 2.5),
        ({"damper": fb.Damper(law=square)}, 0.0),
    ],
    ids=["friction", "law", "square"],
)
def test_modes_and_responses_have_the_slope_at_rest(parts, slope):
    scene, joint = block(0.0, spring=fb.Spring(200.0), **parts)
    found = fb.modes(scene, n=1)
    assert found.damping_ratios == pytest.approx([slope / (2 * 2.0 * 10.0)], rel=1e-9)
    hertz = 7.0 / (2 * np.pi)
    force = (scene.beams[0].start, (0.6 * 5.0, 0.8 * 5.0))
    amplitude = fb.frequency_response(scene, force, joint, [hertz]).amplitude.ravel()
    assert amplitude == pytest.approx([5.0 / abs(200.0 - 2 * 49.0 + 7.0j * slope)], rel=1e-6)


# -- Balance --------------------------------------------------------------------------------------


@SOLVERS
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "pin in slot with offset"])
def test_friction_and_laws_only_take_energy_and_leave_the_momenta(kind, solver):
    parts = {"friction": fb.Friction(1.5, 0.05), "damper": fb.Damper(0.1, law=square)}
    hinge = {"hinge": fb.Coordinate(**parts)} if "slot" in kind else {}
    scene, first, second, joint = pair(kind, spring=fb.Spring(8.0, 0.3), **parts, **hinge)
    throw(scene, first, second, joint, spin=3.0)
    solution = fb.simulate(scene, dt=0.01, t_end=0.6, solver=solver)
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic.max()
    assert np.diff(energy.dissipated).min() >= 0
    assert energy.dissipated[-1] > 0.02 * energy.total[0]
    assert not energy.work.any()
    assert drift(solution.linear_momentum) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10


@SOLVERS
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_no_step_fails_where_a_joint_stops(scheme, solver):
    # Newton's method on the friction alone would jump from one direction to the other.
    scene = double_pendulum(1.0, 1e-5)
    solution = fb.simulate(scene, scheme, dt=0.02, t_end=1.5, solver=solver)
    assert solution.stats.halvings == 0
    assert solution.stats.newton_iterations < 8 * solution.stats.steps
    assert np.diff(solution.energy.dissipated).min() >= 0
    if scheme.rates.level == 0.5 and not isinstance(scheme.rates, fb.NewmarkRates):
        assert abs(solution.energy.balance_error).max() < 1e-11 * solution.energy.kinetic.max()


def test_the_slope_of_friction_is_the_derivative_where_the_iterations_settle():
    law = compiled_law(friction(SLIDE), StepRule(0.5, True, False))

    def found(x, remembered):
        """Force, slope and what is remembered; force and speed are 1, as the step is."""
        return law(np.array([0.0, x, 0.0, 0.0, 1.0, *remembered, 1.0, 1.0]))

    for x in (0.0, 1e-6, -2e-4, 0.03, -0.7, 3.0, -15.0, 400.0, 1e4):
        none = np.zeros(REMEMBERED)
        for last in (none, found(x - 1e-9, none)[2:]):
            force, slope, *_ = found(x, last)
            assert force == pytest.approx(np.tanh(x), rel=1e-15, abs=0)
            assert slope == pytest.approx(1 - np.tanh(x) ** 2, rel=1e-6, abs=1e-12)


# -- Scenes ---------------------------------------------------------------------------------------


def test_statics_knows_no_friction_and_a_massless_arm_may_hang_on_it():
    def arm(**parts):
        scene = fb.Scene()
        bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=100.0))
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, **parts))
        scene.add_force(bar.end, (0.0, 0.5))
        return scene, bar

    friction, spring = fb.Friction(2.0, 0.1), fb.Spring(4.0)
    turned = [
        fb.static(arm(**parts)[0], steps=1).q[-1]
        for parts in ({"spring": spring}, {"spring": spring, "friction": friction})
    ]
    assert (turned[0] == turned[1]).all()
    # Friction alone holds nothing: the arm turns into the direction of its force.
    scene, bar = arm(friction=friction)
    turned = fb.static(scene, steps=1).position(bar.end)[-1]
    assert turned == pytest.approx([0, 1 + 0.5 / 1e4], abs=1e-9)
    scene, bar = arm(friction=friction)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    # It creeps at the rate whose friction is the moment of the force.
    psi = solution.rotation(bar.start)
    rate = (psi[-1] - psi[-3]) / 0.02
    assert 2.0 * np.tanh(rate / 0.1) == pytest.approx(0.5 * np.cos(psi[-2]), rel=1e-2)


def field(rate):
    return ufl.Constant(dolfinx_api.domain(1)) * rate


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        (lambda rate: -rate, r"\(1e-06\) = -1e-06 adds energy"),
        (lambda rate: rate**2, r"\(-1e-06\) = 1e-12 adds energy"),
        (lambda rate: 0.1 + rate, "adds energy"),
        (lambda rate: rate - 0.1 * rate**3, r"\(10\) = -90 adds energy"),
        (lambda rate: 2.0, "depends on the rate"),
        (lambda rate: ufl.as_vector((rate, rate)), "must be a scalar"),
        (lambda rate: np.tanh(rate), "UFL expression"),
        (lambda rate: math.tanh(rate), "UFL expression|depends on the rate"),
        (lambda rate: rate**0.5, "is complex"),
        (3.0, "UFL expression"),
        (field, "Constant of your own"),
    ],
)
def test_a_law_that_drives_or_is_invalid_is_refused(law, reason):
    with pytest.raises(fb.SceneError, match=f"Damper: law.*({reason})"):
        fb.Damper(law=law)


def test_bad_friction_is_refused():
    for force in (-1.0, math.nan, None):
        with pytest.raises(fb.SceneError, match="Friction: force = .* must be finite"):
            fb.Friction(force, 0.1)
    with pytest.raises(fb.SceneError, match="Friction: speed = -0.1 must be finite"):
        fb.Friction(1.0, -0.1)
    with pytest.raises(fb.SceneError, match="Friction: speed = 0 must be positive.*try"):
        fb.Friction(1.0, 0.0)
    with pytest.raises(fb.SceneError, match="friction = 1.0 must be an fx_beam.Friction"):
        block(friction=1.0)
    with pytest.raises(fb.SceneError, match="friction = 'much' must be an fx_beam.Friction"):
        scene, *_ = pair("pin in slot", hinge=fb.Coordinate(friction="much"))
