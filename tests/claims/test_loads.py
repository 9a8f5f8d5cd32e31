"""Loads, supports and prescribed motion against exact answers; loads that vary or follow."""

import math

import numpy as np
import pytest
import scipy.integrate
from scenes import FLYING, assert_refused, clamped_bar, one_bar, pinned_bar, supported_bar

import fx_beam as fb

STIFFNESS = {"EA": 1e4, "GA": 1e4, "EI": 100.0}
MASSLESS = fb.Section(**STIFFNESS)
SECTION = fb.Section(**STIFFNESS, rhoA=1.5, rhoI=0.1)
STIFF = fb.Section(EA=1e9, GA=1e9, EI=1e8, rhoA=1.0, rhoI=1e-3)
BOTH = "arc length and time"

by_name = pytest.mark.parametrize(
    "scheme", [fb.MidPoint(), fb.EnergyMomentum()], ids=lambda scheme: scheme.name
)


def free_beam(degree=1, **options):
    """Free beam of length 3 with four elements, away from the origin, along no axis."""
    scene = fb.Scene(**options)
    direction = np.array([0.6, 0.8])
    ends = [np.array([1.0, -2.0]), np.array([1.0, -2.0]) + 3 * direction]
    return scene, scene.add_beam(ends, SECTION, elements=4, degree=degree)


def cantilever(length=1.0, elements=4, degree=1, section=MASSLESS):
    """Beam along x, clamped at the origin."""
    return clamped_bar((length, 0), section, elements=elements, degree=degree)


# Loads are taken just inside the step, here 1e-9 of it.
STATIC = 1e-8


def static(scene, steps):
    """Steps of a massless scene by Newmark's scheme: each is in equilibrium with its loads."""
    return fb.simulate(scene, fb.Newmark(), dt=1 / steps, t_end=1.0)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# -- Dead loads on free beams ----------------------------------------------------------------


def test_a_free_beam_falls_by_g_t_squared_over_two():
    scene, beam = free_beam(gravity=(1.0, -9.81))
    scene.add_mass(beam.end, 3.0)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    fall = np.outer(solution.t**2 / 2, (1.0, -9.81))
    for node in beam.nodes:
        assert solution.displacement(node) == pytest.approx(fall, abs=1e-12)
        assert solution.rotation(node) == pytest.approx(np.zeros(11), abs=1e-12)
        speed = np.outer(solution.t, (1.0, -9.81))
        assert solution.velocity(node) == pytest.approx(speed, abs=1e-11)
        assert solution.acceleration(node) == pytest.approx(
            np.broadcast_to((1.0, -9.81), (11, 2)), abs=1e-10
        )


def test_a_constant_moment_gives_angular_momentum_in_proportion_to_time():
    scene, beam = free_beam()
    scene.add_moment(beam.node(0.75), 7.0)
    solution = fb.simulate(scene, dt=0.05, t_end=1.0)
    assert solution.angular_momentum == pytest.approx(7.0 * solution.t, abs=7e-12)
    assert solution.linear_momentum == pytest.approx(np.zeros((21, 2)), abs=1e-11)
    assert abs(solution.rotation(beam.end)[-1]) > 0.1


def test_a_line_load_acts_on_the_whole_length_of_its_beam_only():
    scene, beam = free_beam()
    other = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1)
    scene.add_line_load(beam, (2.0, 1.0))
    solution = fb.simulate(scene, dt=0.1, t_end=0.5)
    expected = np.outer(solution.t, (6.0, 3.0))
    assert solution.linear_momentum == pytest.approx(expected, abs=1e-12)
    # It pushes at the centre, and the beam does not turn.
    centre = np.array([1.0, -2.0]) + 1.5 * np.array([0.6, 0.8])
    assert solution.angular_momentum == pytest.approx(cross(centre, expected), abs=1e-12)
    assert solution.displacement(other.end) == pytest.approx(np.zeros((6, 2)), abs=1e-14)


# -- Prescribed motion -----------------------------------------------------------------------


def shake(t):
    return 0.2 * math.sin(6 * t) ** 2


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT()], ids=lambda s: s.name)
def test_a_node_follows_its_prescribed_motion(scheme):
    scene, beam = free_beam()
    crank = lambda t: 3.0 * t**2 - t**3  # noqa: E731
    scene.prescribe(beam.start, x=shake, y=lambda t: -2 * shake(t), rotation=crank)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=1.0)
    moved = [(shake(t), -2 * shake(t)) for t in solution.t]
    assert solution.displacement(beam.start) == pytest.approx(np.array(moved), abs=1e-14)
    assert solution.rotation(beam.start) == pytest.approx(crank(solution.t), abs=1e-14)


def test_a_node_follows_a_prescribed_rotation_of_large_steps():
    scene, beam = free_beam()
    scene.pin(beam.start)
    scene.prescribe(beam.start, rotation=lambda t: 1.5 * t)
    solution = fb.simulate(scene, dt=1.0, t_end=3.0)
    assert solution.stats.halvings == 0
    assert solution.rotation(beam.start) == pytest.approx(1.5 * solution.t, abs=1e-14)


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


def test_a_minute_prescribed_motion_has_the_reaction_of_its_stiffness():
    """A stretch by less than Newton's tolerance still costs EA times the strain."""
    stiff = fb.Section(EA=1e10, GA=1e10, EI=1e3)
    scene, beam = clamped_bar((1, 0), stiff, elements=1)
    scene.fix(beam.end, "y", "rotation")
    scene.prescribe(beam.end, x=lambda t: 1e-11 * t)
    solution = static(scene, 1)
    assert solution.reaction(beam.end)[1] == pytest.approx([0.1, 0, 0], rel=1e-4)
    assert solution.reaction(beam.start)[1] == pytest.approx([-0.1, 0, 0], rel=1e-4)


# -- Reactions -------------------------------------------------------------------------------


def ramp(t):
    return np.array([-3.0, 8.0]) * t


@pytest.mark.parametrize(
    ("scheme", "digits"),
    [(fb.EnergyMomentum(), {"abs": 1e-11}), (fb.Newmark(), {"rel": STATIC})],
    ids=["EnergyMomentum", "Newmark"],
)
def test_reactions_of_a_loaded_cantilever_are_minus_the_load_at_their_time(scheme, digits):
    scene, beam = cantilever(length=2.0)
    scene.add_force(beam.end, ramp)
    scene.add_moment(beam.node(0.5), lambda t: 5 * t)
    solution = fb.simulate(scene, scheme, dt=0.1, t_end=1.0)
    part, place, reaction = solution.stats.level, solution.position(beam.end), solution.reaction
    t = solution.t_level[1:]
    assert t == pytest.approx(solution.t[1:] - (1 - part) * 0.1)
    force, tip = np.outer(t, ramp(1.0)), part * place[1:] + (1 - part) * place[:-1]
    assert reaction(beam.start)[0] == pytest.approx([0, 0, 0], abs=0)
    assert reaction(beam.start)[1:, :2] == pytest.approx(-force, **digits)
    assert reaction(beam.start)[1:, 2] == pytest.approx(-cross(tip, force) - 5 * t, **digits)
    assert tip[-1, 1] > 0.1


def test_impulse_of_reactions_and_loads_is_the_change_of_momentum():
    scene, beam = free_beam(gravity=(0.0, -3.0))
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


# -- Scenes without mass: every step is an equilibrium -----------------------------------------


def test_a_short_cantilever_deflects_by_bending_and_shear():
    length, load = 0.5, 1e-3
    section = fb.Section(EA=1e4, GA=1e3, EI=100.0)
    scene, beam = cantilever(length, 2, 2, section)
    scene.add_force(beam.end, lambda t: (0.0, load * t))
    solution = static(scene, 1)
    bending, shear = load * length**3 / (3 * section.EI), load * length / section.GA
    assert shear > bending
    assert solution.displacement(beam.end)[1] == pytest.approx([0, bending + shear], rel=STATIC)
    # The section turns by bending only.
    turn = load * length**2 / (2 * section.EI)
    assert solution.rotation(beam.end)[1] == pytest.approx(turn, rel=STATIC)


def test_spin_without_rotary_inertia_is_the_mean_over_the_step_and_does_not_swing(dt=0.05):
    scene, beam = pinned_bar(
        (0, -0.5), fb.Section(EA=1e8, GA=1e8, EI=1e3), elements=2, gravity=(0, -9.81)
    )
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


# -- Line loads that vary along their beam ------------------------------------------------------

LENGTH, EI, RHO_A, LOAD = 2.0, 50.0, 1.5, 0.5
SLENDER = fb.Section(EA=1e5, GA=1e7, EI=EI, rhoA=RHO_A, rhoI=1e-7)


def loaded(load, degree=1, **options):
    """A stiff cantilever of 1 m and 2 m, the longer part under a line load."""
    scene, bar = clamped_bar([(-1, 0), (0, 0)], STIFF, elements=2, degree=degree, name="before")
    points = [bar.end, (LENGTH, 0)]
    beam = scene.add_beam(points, STIFF, elements=4, degree=degree, name="loaded")
    scene.add_line_load(beam, load, **options)
    return scene, bar, beam


def simply_supported(load, elements=32, **options):
    scene, beam = supported_bar((LENGTH, 0), SLENDER, elements=elements, degree=1)
    scene.add_line_load(beam, load, **({"of": BOTH} | options))
    return scene, beam


def test_a_function_of_single_places_gives_what_one_of_arrays_gives():
    called = []

    def by_arrays(s, t):
        called.append(np.size(s))
        return 0.0 * s, -LOAD * np.where(t < 0.5, s, s**2)

    def one_by_one(s, t):
        return (0.0, -LOAD * s) if t < 0.5 else (0.0, -LOAD * s**2)

    pair = [simply_supported(load, elements=4) for load in (by_arrays, one_by_one)]
    called.clear()
    runs = [fb.simulate(scene, dt=0.05, t_end=1.0).displacement(b.node(0.5)) for scene, b in pair]
    np.testing.assert_array_equal(*runs)
    # One call for all 8 Gauss points, at both ends of each of the 20 steps, and a few before them.
    # Now and then it is looked at in more places. Two values of some calls are compared with those
    # of single places.
    assert set(called) == {1, 8, 160}
    assert 40 <= called.count(8) < 50
    assert called.count(160) <= 6
    assert called.count(1) <= 16


# -- Loads that jump inside elements ---------------------------------------------------------------

# Places of a load on a part of a beam of 2 m: inside one element, in several, over a node, at ends.
PARTS = [(0.31, 0.33), (0.2, 1.3), (0.49, 0.52), (0.0, 0.04), (1.96, 2.0), (0.5, 1.0), (0.7, 0.71)]


@pytest.mark.parametrize("by_time", [False, True])
@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("part", PARTS)
def test_a_constant_load_on_a_part_of_a_beam_has_its_sum_and_its_centre(part, degree, by_time):
    a, b = part

    def load(s, t=0.0):
        return (1.0, -3.0) if a <= s < b or s == b == LENGTH else (0.0, 0.0)

    options = {"of": BOTH if by_time else "arc length"}
    scene, bar, _ = loaded(load if by_time else lambda s: load(s), degree, **options)
    force, lever = np.array([1.0, -3.0]) * (b - a), 1 + (a + b) / 2
    reaction = fb.static(scene, load_steps=1).reaction(bar.start)[-1]
    np.testing.assert_allclose(reaction[:2], -force, rtol=1e-9)
    assert reaction[2] == pytest.approx(-lever * force[1], rel=1e-6)


@pytest.mark.parametrize("elements", [1, 3, 50])
def test_a_load_of_steps_on_a_beam_of_few_or_many_elements_has_its_sum(elements):
    scene, beam = clamped_bar((1.2, 1.6), STIFF, elements=elements)
    edges, heights = np.array([0.0, 0.3, 0.311, 1.0, 1.77, LENGTH]), np.array([1.0, -2, 0, 5, 0.5])
    scene.add_line_load(
        beam,
        lambda s: (0.0, heights[min(np.searchsorted(edges, s, "right") - 1, 4)]),
        of="arc length",
    )
    total = np.diff(edges) @ heights
    reaction = fb.static(scene, load_steps=1).reaction(beam.start)[-1]
    assert reaction[1] == pytest.approx(-total, rel=1e-9)
    arm = 0.6 * np.diff(edges**2 / 2) @ heights
    assert reaction[2] == pytest.approx(-arm, rel=1e-6)


@pytest.mark.parametrize("comes", [0.0, 0.3])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_jump_that_travels_over_a_free_beam_gives_the_momentum_of_its_sum(degree, comes):
    """Of 0.15 m, which is less than half an element; it is on the beam from a time on."""
    scene, _ = free_beam(degree=degree)
    beam = scene.beams[0]

    def covered(t):
        front = 2 * (t - comes)
        return np.clip(front + 0.15, 0.0, 3.0) - np.clip(front, 0.0, 3.0)

    def passing(s, t):
        front = 2 * (t - comes)
        return 0.0 * s, 5.0 * ((front <= s) & (s < front + 0.15))

    scene.add_line_load(beam, passing, of=BOTH)
    solution = fb.simulate(scene, dt=0.01, t_end=1.2)
    t = solution.t
    # The force of a step is the mean of both of its ends.
    gains = (covered(t[:-1] + 1e-11) + covered(t[1:] - 1e-11)) / 2 * np.diff(t)
    expected = 5.0 * np.append(0.0, np.cumsum(gains))
    np.testing.assert_allclose(solution.linear_momentum[:, 1], expected, atol=1e-9 * expected[-1])


@pytest.mark.parametrize("by_time", [False, True])
@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("part", PARTS)
def test_natural_strains_on_a_part_of_a_beam_have_their_integrals(part, degree, by_time):
    """Nothing holds the end, so that the strains are the natural ones."""
    a, b = (place / LENGTH for place in part)
    scene, beam = cantilever(LENGTH, degree=degree)

    def step(f, t=0.0):
        return 0.1 if a <= f < b or f == b == 1 else 0.0

    strain = step if by_time else lambda f: step(f)
    scene.add_natural_strain(beam, curvature=strain)
    bent = fb.static(scene)
    assert bent.rotation(beam.end)[-1] == pytest.approx(0.1 * LENGTH * (b - a), rel=1e-8)
    scene, beam = cantilever(LENGTH, degree=degree)
    scene.add_natural_strain(beam, axial=strain)
    longer = fb.static(scene).displacement(beam.end)[-1]
    assert longer == pytest.approx([0.1 * LENGTH * (b - a), 0.0], rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("name", ["line load", "natural strain"])
def test_a_function_that_reduces_arrays_is_seen_also_if_it_is_zero_at_the_start(name):
    """A sum over places is zero before the load comes: it then tells nothing."""

    def end(profile):
        section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=1.0, rhoI=1e-2)
        scene, beam = clamped_bar((1, 0), section, elements=6)

        def moving(s, t):
            place = profile(s) - t
            return 0.3 * np.sum([np.maximum(0.0, 1 - 9 * abs(place + d)) for d in (0.2, 0.5)])

        if name == "line load":
            load = {"of": "arc length and time"}
            scene.add_line_load(beam, lambda s, t: (0.0, moving(s, t)), **load)
        else:
            scene.add_natural_strain(beam, curvature=lambda f, t: moving(f, t))
        return fb.simulate(scene, dt=0.02, t_end=0.5).displacement(beam.end)[-1]

    assert end(lambda s: s) == pytest.approx(end(float), abs=1e-12)


def test_in_statics_the_load_is_that_at_the_given_time():
    scene, beam = simply_supported(lambda s, t: (0.0, -LOAD * t))
    still = fb.static(scene, load_steps=1, t=3.0)
    total = 3 * LOAD * LENGTH
    assert still.reaction(beam.end)[-1, 1] == pytest.approx(total / 2)


@pytest.mark.parametrize(
    ("load", "arguments", "message"),
    [
        ((0.0, 1.0), BOTH, r"must be a function of \(s, t\)"),
        (lambda s, t: 1.0, BOTH, r"at s = 0, t = 0: 1.0 has the wrong type or shape; it must be 2"),
        (lambda s: (0.0, s), BOTH, r"at s = 0, t = 0: calling it raised TypeError"),
        (lambda s, t: (0.0, np.inf * (s > 1)), BOTH, "at s = 0, t = 0.*is not finite"),
        (lambda s: (0.0, s), "time", "called with the time t only.*of='arc length'"),
        (lambda x, y: (x, y), "time", "called with the time t only.*of='arc length'"),
    ],
)
def test_what_is_no_load_is_refused(load, arguments, message):
    with np.errstate(invalid="ignore"), pytest.raises(fb.SceneError, match=message):
        loaded(load, of=arguments)


def test_a_load_that_is_not_finite_somewhere_names_the_beam_and_the_place():
    scene, _, _ = loaded(lambda s: (0.0, np.inf if s > 1 else 0.0), of="arc length")
    assert_refused(r"line load on beam 'loaded' at s = 1\.", fb.simulate, scene, dt=0.1, t_end=0.1)


def test_a_load_that_becomes_infinite_names_the_place_and_the_time_and_keeps_the_steps_before():
    def load(s, t):
        return 0.0, np.where((s > 1) & (t > 0.5), np.nan, 1.0)

    scene, _ = simply_supported(load, elements=4)
    with pytest.raises(fb.StepError, match=r"at s = 1\.1.*t = 0\.5") as caught:
        fb.simulate(scene, dt=0.1, t_end=1.0)
    assert caught.value.solution.t[-1] == pytest.approx(0.5)


# -- Follower forces ----------------------------------------------------------------------------


def test_the_shape_under_a_follower_force_is_the_integral_from_the_tip():
    section = fb.Section(EA=300.0, GA=200.0, EI=1.0)
    force = np.array([-1.0, -12.0])
    scene, beam = cantilever(1.0, 16, 2, section)
    scene.add_force(beam.end, force, follower=True)
    solution = fb.static(scene, load_steps=8)

    # Seen from the tip's section the force is constant and everything known: no shooting.
    def slope(_, y):
        t = np.array([np.cos(y[2]), np.sin(y[2])])
        normal = np.array([-t[1], t[0]])
        dphi = (1 + force @ t / 300.0) * t + (force @ normal / 200.0) * normal
        return *(-dphi), -y[3], -(dphi[1] * force[0] - dphi[0] * force[1])

    y = scipy.integrate.solve_ivp(slope, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-11).y[:, -1]
    turn = -y[2]
    c, s = np.cos(turn), np.sin(turn)
    tip = -np.array([c * y[0] - s * y[1], s * y[0] + c * y[1]])
    assert turn < -2  # far beyond a right angle
    assert solution.rotation(beam.end)[-1] == pytest.approx(turn, abs=1e-5)
    assert solution.position(beam.end)[-1] == pytest.approx(tip, abs=1e-5)


@by_name
def test_the_work_counted_is_the_force_along_the_mean_section_times_the_path(scheme):
    scene, beam = one_bar((1, 0), FLYING, elements=3)
    scene.add_force(beam.end, lambda t: (30.0, 80.0 * np.cos(9 * t)), follower=True)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=2.0)
    psi = solution.rotation(beam.end)
    mean = (psi[1:] + psi[:-1]) / 2
    f = (80 * np.cos(9 * solution.t[1:]) + 80 * np.cos(9 * solution.t[:-1])) / 2
    c, s = np.cos(mean), np.sin(mean)
    force = np.column_stack([30 * c - f * s, 30 * s + f * c])
    path = np.diff(solution.position(beam.end), axis=0)
    work = np.concatenate([[0], np.cumsum((force * path).sum(axis=1))])
    assert abs(work).max() > 1
    assert solution.energy.work == pytest.approx(work, abs=1e-11 * abs(work).max())
    if scheme.name == "EnergyMomentum":
        assert abs(solution.energy.balance_error).max() < 1e-11 * abs(work).max()


def test_a_follower_force_that_jumps_belongs_to_the_step_in_which_it_acts():
    scene, beam = one_bar((1, 0), FLYING, elements=1)
    for node in (beam.start, beam.end):
        scene.add_force(node, lambda t: (1.0 if t < 0.1 else 0.0, 0.0), follower=True)
    solution = fb.simulate(scene, dt=0.05, t_end=0.2)
    assert solution.linear_momentum[:, 0] == pytest.approx([0, 0.1, 0.2, 0.2, 0.2], abs=1e-12)
    assert str(scene.loads[0]) == "follower force on node 0 at (0, 0)"
    assert str(scene.loads[0]) in solution.stats.assembled


@pytest.mark.parametrize("kind", ["a jump", "a short load", "a kink"])
def test_a_load_that_travels_is_found_with_few_calls_and_has_its_whole_impulse(kind):
    profile, total = {
        "a jump": (lambda x: float(x < 0), lambda t: 1 + 3 * t),
        "a short load": (lambda x: float(0 < x < 0.03), lambda t: 0.03 + 0 * t),
        "a kink": (lambda x: max(0.0, 1 - 3 * abs(x)), lambda t: 1 / 3 + 0 * t),
    }[kind]
    calls, scene = [], fb.Scene()
    beam = scene.add_beam([(-1, 0), (4, 0)], SECTION, elements=16)

    def load(s, t):
        calls.append(s)
        return 0.0, -profile(s - 1 - 3 * t)

    scene.add_line_load(beam, load, of=BOTH)
    motion = fb.simulate(scene, dt=0.01, t_end=0.5)
    impulse = scipy.integrate.cumulative_trapezoid(total(motion.t), motion.t, initial=0)
    np.testing.assert_allclose(-motion.linear_momentum[:, 1], impulse, rtol=0, atol=1e-12)
    assert len(calls) < 50 * 3500
