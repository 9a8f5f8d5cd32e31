"""Loads, supports and prescribed motion against exact answers."""

import math

import ufl

import numpy as np
import pytest

import fx_beam as fb

STIFFNESS = {"EA": 1e4, "GA": 1e4, "EI": 100.0}
MASSLESS = fb.Section(**STIFFNESS)
SECTION = fb.Section(**STIFFNESS, rhoA=1.5, rhoI=0.1)

MID_POINT = [fb.MidPoint(), fb.ModifiedMidPoint(), fb.EnergyMomentum()]
by_name = pytest.mark.parametrize("scheme", MID_POINT, ids=lambda scheme: scheme.name)


def free_beam(section=SECTION, degree=1, **options):
    """Free beam of length 3 with four elements, away from the origin, along no axis."""
    scene = fb.Scene(**options)
    direction = np.array([0.6, 0.8])
    ends = [np.array([1.0, -2.0]), np.array([1.0, -2.0]) + 3 * direction]
    return scene, scene.add_beam(ends, section, elements=4, degree=degree)


def cantilever(length=1.0, elements=4, degree=1, section=MASSLESS):
    """Beam along x, clamped at the origin."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (length, 0)], section, elements=elements, degree=degree)
    scene.clamp(beam.start)
    return scene, beam


# Loads are taken just inside the step, here 1e-9 of it.
STATIC = 1e-8


def static(scene, steps):
    """Steps of a massless scene by Newmark's scheme: each is in equilibrium with its loads."""
    return fb.simulate(scene, fb.Newmark(), dt=1 / steps, t_end=1.0)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# -- Dead loads on free beams ----------------------------------------------------------------


@by_name
def test_a_free_beam_falls_by_g_t_squared_over_two(scheme):
    scene, beam = free_beam(gravity=(1.0, -9.81))
    scene.add_mass(beam.end, 3.0)
    solution = fb.simulate(scene, scheme, dt=0.1, t_end=1.0)
    fall = np.outer(solution.t**2 / 2, (1.0, -9.81))
    for node in beam.nodes:
        assert solution.displacement(node) == pytest.approx(fall, abs=1e-12)
        assert solution.rotation(node) == pytest.approx(np.zeros(11), abs=1e-12)
        speed = np.outer(solution.t, (1.0, -9.81))
        assert solution.velocity(node) == pytest.approx(speed, abs=1e-11)
        assert solution.acceleration(node) == pytest.approx(
            np.broadcast_to((1.0, -9.81), (11, 2)), abs=1e-10
        )


@by_name
def test_a_constant_force_gives_momentum_in_proportion_to_time(scheme):
    scene, beam = free_beam()
    scene.add_force(beam.node(0.25), (3.0, -4.0))
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=1.0)
    expected = np.outer(solution.t, (3.0, -4.0))
    assert solution.linear_momentum == pytest.approx(expected, abs=5e-12)
    # The beam turns and bends meanwhile.
    assert abs(solution.rotation(beam.end)[-1]) > 0.1


@by_name
def test_a_constant_moment_gives_angular_momentum_in_proportion_to_time(scheme):
    scene, beam = free_beam()
    scene.add_moment(beam.node(0.75), 7.0)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=1.0)
    assert solution.angular_momentum == pytest.approx(7.0 * solution.t, abs=7e-12)
    assert solution.linear_momentum == pytest.approx(np.zeros((21, 2)), abs=1e-11)
    assert abs(solution.rotation(beam.end)[-1]) > 0.1


@pytest.mark.parametrize("degree", [1, 3])
def test_a_line_load_acts_on_the_whole_length_of_its_beam_only(degree):
    scene, beam = free_beam(degree=degree)
    other = scene.add_beam([(0, 0), (1, 0)], SECTION, degree=degree)
    scene.add_line_load(beam, (2.0, 1.0))
    solution = fb.simulate(scene, dt=0.1, t_end=0.5)
    expected = np.outer(solution.t, (6.0, 3.0))
    assert solution.linear_momentum == pytest.approx(expected, abs=1e-12)
    # It pushes at the centre, and the beam does not turn.
    centre = np.array([1.0, -2.0]) + 1.5 * np.array([0.6, 0.8])
    assert solution.angular_momentum == pytest.approx(cross(centre, expected), abs=1e-12)
    assert solution.displacement(other.end) == pytest.approx(np.zeros((6, 2)), abs=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_line_load_on_a_skew_polyline_is_per_reference_length(degree):
    scene = fb.Scene()
    points = [(0, 0), (3, 4), (3, 5)]
    beam = scene.add_beam(points, SECTION, elements=[1, 2], degree=degree)
    scene.add_line_load(beam, lambda t: (0.0, 2.0))
    solution = fb.simulate(scene, dt=0.01, t_end=0.01)
    assert solution.linear_momentum[1] == pytest.approx([0, 2.0 * 6 * 0.01], abs=1e-14)


def test_gravity_acts_on_lumped_masses():
    scene, beam = free_beam(MASSLESS, gravity=(0.0, -10.0))
    scene.add_mass(beam.start, 2.0)
    scene.add_mass(beam.end, 3.0)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    assert solution.linear_momentum[:, 1] == pytest.approx(-50.0 * solution.t, abs=1e-11)
    assert solution.energy.potential == pytest.approx(-50.0 * 5.0 * solution.t**2, abs=1e-10)
    assert solution.energy.kinetic == pytest.approx(-solution.energy.potential, abs=1e-10)
    assert solution.energy.work == pytest.approx(np.zeros(11), abs=0)


@by_name
@pytest.mark.parametrize(
    ("force", "tolerance"),
    [(lambda t: max(0.0, 8 * t - 2), 1e-12), (lambda t: math.sin(5 * t) + t**2, 1e-9)],
    ids=["ramp", "smooth"],
)
def test_momentum_is_the_trapezoidal_sum_of_a_force_that_changes(scheme, force, tolerance):
    scene, beam = free_beam()
    scene.add_force(beam.start, lambda t: (force(t), -2 * force(t)))
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=1.0)
    values = np.array([force(t) for t in solution.t])
    impulse = np.concatenate(([0.0], np.cumsum((values[1:] + values[:-1]) / 2 * 0.05)))
    expected = np.outer(impulse, (1, -2))
    assert solution.linear_momentum == pytest.approx(expected, abs=tolerance * abs(expected).max())


# -- Prescribed motion -----------------------------------------------------------------------


def crank(t):
    return 3.0 * t**2 - t**3


def shake(t):
    return 0.2 * math.sin(6 * t) ** 2


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT()], ids=["EnergyMomentum", "HHT"])
def test_a_node_follows_its_prescribed_motion(scheme, degree):
    scene, beam = free_beam(degree=degree)
    scene.prescribe(beam.start, x=shake, y=lambda t: -2 * shake(t), rotation=crank)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=1.0)
    shaken = np.array([shake(t) for t in solution.t])
    moved = np.stack([shaken, -2 * shaken], axis=1)
    assert solution.displacement(beam.start) == pytest.approx(moved, abs=1e-14)
    assert solution.rotation(beam.start) == pytest.approx(crank(solution.t), abs=1e-14)


@pytest.mark.parametrize("turn", [0.4, 0.6, 1.5])
def test_a_node_follows_a_prescribed_rotation_of_large_steps(turn):
    scene, beam = free_beam()
    scene.pin(beam.start)
    scene.prescribe(beam.start, rotation=lambda t: turn * t)
    solution = fb.simulate(scene, dt=1.0, t_end=3.0)
    assert solution.stats.halvings == 0
    assert solution.rotation(beam.start) == pytest.approx(turn * solution.t, abs=1e-14)


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.Newmark()], ids=["EnergyMomentum", "Newmark"]
)
def test_a_uniform_prescribed_motion_has_its_velocity_from_the_start(scheme):
    scene, beam = free_beam()
    scene.prescribe(beam.start, x=lambda t: 2 * t, y=lambda t: -3 * t, rotation=lambda t: 0.5 * t)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=0.5)
    uniform = np.broadcast_to((2.0, -3.0), (11, 2))
    # The spin of the mid-point rule is 2 tan(increment/2) / dt.
    spin = 2 * math.tan(0.0125) / 0.05 if scheme.name == "EnergyMomentum" else 0.5
    assert solution.velocity(beam.start) == pytest.approx(uniform, abs=1e-9)
    assert solution.spin(beam.start)[1::2] == pytest.approx(np.full(5, spin), abs=1e-4)


def test_the_torque_of_a_crank_on_a_stiff_beam_turns_its_inertia():
    stiff = fb.Section(EA=1e9, GA=1e9, EI=1e9, rhoA=1.0, rhoI=0.0)
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], stiff)
    scene.pin(beam.start)
    scene.prescribe(beam.start, rotation=lambda t: t**2)
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.0), dt=0.01, t_end=0.5)
    assert solution.reaction(beam.start)[-1, 2] == pytest.approx(2.0 / 3, rel=1e-3)


def test_a_minute_prescribed_motion_has_the_reaction_of_its_stiffness():
    """A stretch by less than Newton's tolerance still costs EA times the strain."""
    stiff = fb.Section(EA=1e10, GA=1e10, EI=1e3)
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], stiff)
    scene.clamp(beam.start)
    scene.fix(beam.end, "y", "rotation")
    scene.prescribe(beam.end, x=lambda t: 1e-11 * t)
    solution = static(scene, 1)
    assert solution.reaction(beam.end)[1] == pytest.approx([0.1, 0, 0], rel=1e-4)
    assert solution.reaction(beam.start)[1] == pytest.approx([-0.1, 0, 0], rel=1e-4)


# -- Reactions -------------------------------------------------------------------------------


def test_the_reaction_of_a_mass_that_hangs_at_rest_is_its_weight():
    # Massless beam and the scheme that damps most: the axial swing about rest dies out.
    scene = fb.Scene(gravity=(0.0, -9.81))
    beam = scene.add_beam([(0, 0), (0, -0.5)], MASSLESS, elements=2)
    scene.pin(beam.start)
    scene.add_mass(beam.end, 2.0)
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.0), dt=0.5, t_end=30.0)
    assert solution.reaction(beam.start)[-1] == pytest.approx([0, 2.0 * 9.81, 0], abs=1e-9)
    assert solution.position(beam.end)[-1] == pytest.approx(
        [0, -0.5 * (1 + 2.0 * 9.81 / STIFFNESS["EA"])], abs=1e-12
    )
    assert solution.reaction(beam.end) == pytest.approx(np.zeros((61, 3)), abs=0)


def ramp(t):
    return np.array([-3.0, 8.0]) * t


def test_reactions_of_a_loaded_cantilever_are_minus_the_load_at_mid_step():
    scene, beam = cantilever(length=2.0)
    scene.add_force(beam.end, ramp)
    scene.add_moment(beam.node(0.5), lambda t: 5 * t)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    half = solution.t[1:] - 0.05
    force = np.array([ramp(t) for t in half])
    tip = (solution.position(beam.end)[1:] + solution.position(beam.end)[:-1]) / 2
    reaction = solution.reaction(beam.start)
    assert reaction[0] == pytest.approx([0, 0, 0], abs=0)
    assert reaction[1:, :2] == pytest.approx(-force, abs=1e-11)
    assert reaction[1:, 2] == pytest.approx(-cross(tip, force) - 5 * half, abs=1e-11)
    assert tip[-1, 1] > 0.1


def test_reactions_of_a_loaded_cantilever_by_newmark_are_minus_the_load_at_the_end_of_the_step():
    scene, beam = cantilever(length=2.0)
    scene.add_force(beam.end, ramp)
    solution = static(scene, 10)
    force = np.array([ramp(t) for t in solution.t])
    tip, reaction = solution.position(beam.end), solution.reaction(beam.start)
    assert reaction[1:, :2] == pytest.approx(-force[1:], rel=STATIC)
    assert reaction[1:, 2] == pytest.approx(-cross(tip, force)[1:], rel=STATIC)


@pytest.mark.parametrize("degree", [1, 2])
def test_impulse_of_reactions_and_loads_is_the_change_of_momentum(degree):
    scene, beam = free_beam(degree=degree, gravity=(0.0, -3.0))
    scene.pin(beam.start)
    scene.fix(beam.end, "x")
    scene.add_force(beam.node(0.5), lambda t: (10 * t, 4.0))
    scene.set_velocity(beam.node(0.5), (0.0, 1.0))
    dt = 0.02
    solution = fb.simulate(scene, dt=dt, t_end=1.0)
    supports = (solution.reaction(beam.start) + solution.reaction(beam.end))[1:, :2]
    half = solution.t[1:] - dt / 2
    loads = np.stack([10 * half, 4.0 - 3.0 * 1.5 * 3 + 0 * half], axis=1)
    change = np.diff(solution.linear_momentum, axis=0)
    assert change == pytest.approx(dt * (supports + loads), abs=1e-11)
    assert abs(supports).max() > 1


# -- Massless scenes: every step is a static solution ----------------------------------------


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("elements", [1, 3])
def test_a_bar_stretches_by_force_over_axial_stiffness(elements, degree):
    scene, beam = cantilever(2.0, elements, degree)
    scene.add_force(beam.end, lambda t: (3e3 * t, 0.0))
    solution = static(scene, 3)
    stretch = 1 + 3e3 * solution.t / STIFFNESS["EA"]
    even = np.linspace(0, 2, elements * degree + 1)
    assert solution.shape(beam)[..., 0] == pytest.approx(np.outer(stretch, even), rel=STATIC)


@pytest.mark.parametrize("degree", [2, 3])
def test_a_short_cantilever_deflects_by_bending_and_shear(degree):
    length, load = 0.5, 1e-3
    section = fb.Section(EA=1e4, GA=1e3, EI=100.0)
    scene, beam = cantilever(length, 2, degree, section)
    scene.add_force(beam.end, lambda t: (0.0, load * t))
    solution = static(scene, 1)
    bending, shear = load * length**3 / (3 * section.EI), load * length / section.GA
    assert shear > bending
    assert solution.displacement(beam.end)[1] == pytest.approx([0, bending + shear], rel=STATIC)
    # The section turns by bending only.
    turn = load * length**2 / (2 * section.EI)
    assert solution.rotation(beam.end)[1] == pytest.approx(turn, rel=STATIC)


def test_a_cantilever_under_a_line_load_deflects_as_the_linear_theory_says():
    scene, beam = cantilever(0.5, 4, degree=2)
    scene.add_line_load(beam, lambda t: (0.0, 1e-3 * t))
    solution = static(scene, 1)
    exact = 1e-3 * 0.5**4 / (8 * 100.0) + 1e-3 * 0.5**2 / (2 * 1e4)
    assert solution.displacement(beam.end)[1, 1] == pytest.approx(exact, rel=1e-6)


# Tip of an inextensible, shear-rigid cantilever under a dead tip force P, by exact integrals:
# load P L^2 / EI, deflection v/L, shortening u/L, slope.
ELASTICA = [
    (1.0, 0.301721, 0.056433, 0.461352),
    (2.0, 0.493457, 0.160642, 0.781750),
    (5.0, 0.713792, 0.387628, 1.215368),
    (10.0, 0.810609, 0.554996, 1.430286),
]


def test_work_on_a_massless_scene_is_its_strain_energy():
    scene, beam = cantilever(2.0)
    scene.add_force(beam.end, ramp)
    scene.add_moment(beam.end, lambda t: 20 * t**2)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    assert (solution.energy.kinetic == 0).all()
    assert solution.energy.work == pytest.approx(solution.energy.strain, rel=1e-9)
    assert solution.energy.strain[-1] > 1


# -- A lumped mass on a massless beam --------------------------------------------------------


def test_a_mass_on_a_massless_bar_swings_with_its_frequency():
    scene, beam = cantilever(2.0, 3)
    scene.add_mass(beam.end, 4.0)
    scene.set_velocity(beam.end, (1.0, 0.0))
    frequency = math.sqrt(STIFFNESS["EA"] / 2.0 / 4.0)
    dt = 0.02 / frequency
    solution = fb.simulate(scene, dt=dt, t_end=200 * dt)
    # The mid-point rule turns the phase by 2 atan(w dt / 2) in a step.
    phase = 2 * math.atan(0.01) * np.arange(201)
    assert solution.displacement(beam.end)[:, 0] * frequency == pytest.approx(
        np.sin(phase), abs=1e-9
    )


@pytest.mark.parametrize("dt", [0.05, 0.01])
def test_spin_without_rotary_inertia_is_the_mean_over_the_step_and_does_not_swing(dt):
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (0, -0.5)], fb.Section(EA=1e8, GA=1e8, EI=1e3), elements=2)
    scene.pin(beam.start)
    scene.add_mass(beam.end, 1.0)
    scene.set_velocity(beam.end, (1.695, 0))
    solution = fb.simulate(scene, dt=dt, t_end=1.5)
    for node in beam.nodes:
        spin = solution.spin(node)[1:]
        turn = np.diff(solution.rotation(node))
        assert spin == pytest.approx(2 * np.tan(turn / 2) / dt, abs=1e-9)
        # A swing that alternates would stand out in the second difference, which for the smooth
        # one is dt^2 times the third derivative of the angle, at most (g / L)^(3/2) and a bit.
        assert abs(np.diff(spin, 2)).max() < 1.5 * (9.81 / 0.5) ** 1.5 * dt**2


# -- Virtual works and loads agree -----------------------------------------------------------


def test_a_dead_force_as_virtual_work_moves_the_beam_as_a_line_load():
    ends = []
    for as_load in (True, False):
        scene, beam = free_beam(degree=2)
        scene.pin(beam.start)
        if as_load:
            scene.add_line_load(beam, lambda t: (2.0, 6 * t))
        else:
            scene.add_virtual_work(
                lambda step: ufl.dot(ufl.as_vector((2.0, 6 * step.t)), step.virtual_u), beam
            )
        solution = fb.simulate(scene, dt=0.05, t_end=0.5)
        ends.append(solution.position(beam.end))
        assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.kinetic.max()
    assert ends[0] == pytest.approx(ends[1], abs=1e-8)
