"""Line loads that vary along their beam and in time."""

import numpy as np
import pytest

import fx_beam as fb

LENGTH, EI, RHO_A, LOAD = 2.0, 50.0, 1.5, 0.5
SLENDER = fb.Section(EA=1e5, GA=1e7, EI=EI, rhoA=RHO_A, rhoI=1e-7)
BOTH = "arc length and time"


def simply_supported(load, elements=32, degree=1, **options):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], SLENDER, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    scene.add_line_load(beam, load, **({"of": BOTH} | options))
    return scene, beam


def in_the_middle(t, forces):
    """Deflection of a slender beam: of each mode n, F (n) and W (n), forces sum F cos(W t)."""
    w = np.zeros_like(t)
    for n, parts in forces.items():
        omega = (n * np.pi / LENGTH) ** 2 * np.sqrt(EI / RHO_A)
        for force, W in parts:
            grown = (np.cos(W * t) - np.cos(omega * t)) / (omega**2 - W**2)
            w += np.sin(n * np.pi / 2) * 2 / (RHO_A * LENGTH) * force * grown
    return w


def test_a_load_whose_front_moves_along_a_beam_has_the_deflection_of_the_series_of_modes():
    speed = 3.0
    modes = range(1, 12)
    force = {n: -LOAD * LENGTH / (n * np.pi) for n in modes}
    forces = {n: [(force[n], 0.0), (-force[n], n * np.pi * speed / LENGTH)] for n in modes}

    def front(s, t):
        # The last element is covered by degrees, as the front passes it.
        covered = np.clip((speed * t - s) / (LENGTH / 32) + 0.5, 0.0, 1.0)
        return 0.0, -LOAD * covered

    scene, beam = simply_supported(front)
    solution = fb.simulate(scene, dt=0.004, t_end=LENGTH / speed)
    w = solution.displacement(beam.node(0.5))[:, 1]
    expected = in_the_middle(solution.t, forces)
    np.testing.assert_allclose(w, expected, atol=0.01 * abs(expected).max())
    # Its work is what the beam gains.
    energy = solution.energy
    assert energy.total[-1] > 0
    assert abs(energy.balance_error).max() < 1e-12 * energy.total.max()


def test_a_wave_that_travels_along_a_beam_has_the_deflection_of_the_series_of_modes():
    m, W = 2, 25.0
    k = m * np.pi / LENGTH
    scene, beam = simply_supported(lambda s, t: (0.0, LOAD * np.sin(k * s - W * t)), 8, degree=2)
    solution = fb.simulate(scene, dt=0.002, t_end=0.4)
    quarter = solution.displacement(beam.node(0.25))[:, 1]
    # sin(k s - W t) = sin(k s) cos(W t) - cos(k s) sin(W t): the second part drives the odd modes.
    t, expected = solution.t, 0.0
    for n in (m, *range(1, 20, 2)):
        omega = (n * np.pi / LENGTH) ** 2 * np.sqrt(EI / RHO_A)
        if n == m:
            force, grown = 1.0, np.cos(W * t) - np.cos(omega * t)
        else:
            force = -4 * n / (np.pi * (n**2 - m**2))
            grown = np.sin(W * t) - W / omega * np.sin(omega * t)
        shape = LOAD / RHO_A * force * np.sin(n * np.pi / 4)
        expected = expected + shape * grown / (omega**2 - W**2)
    np.testing.assert_allclose(quarter, expected, atol=0.01 * abs(expected).max())


def test_a_function_of_single_places_gives_what_one_of_arrays_gives():
    called = []

    def by_arrays(s, t):
        called.append(np.size(s))
        return 0.0 * s, -LOAD * np.where(s < t, 1.0, 0.5)

    def one_by_one(s, t):
        return (0.0, -LOAD) if s < t else (0.0, -LOAD / 2)

    pair = [simply_supported(load, elements=4) for load in (by_arrays, one_by_one)]
    called.clear()
    runs = [fb.simulate(scene, dt=0.05, t_end=1.0).displacement(b.node(0.5)) for scene, b in pair]
    np.testing.assert_array_equal(*runs)
    # One call for all 8 Gauss points, at both ends of each of the 20 steps, and a few before them.
    assert set(called) == {8}
    assert 40 <= len(called) < 50


def test_in_statics_the_load_is_that_at_the_given_time():
    scene, beam = simply_supported(lambda s, t: (0.0, -LOAD * t))
    still = fb.static(scene, steps=1, t=3.0)
    total = 3 * LOAD * LENGTH
    assert still.reaction(beam.end)[-1, 1] == pytest.approx(total / 2)


def test_a_motion_step_by_step_takes_such_a_load():
    def wave(s, t):
        return 0.0, LOAD * np.sin(4 * s - 30 * t)

    scene, beam = simply_supported(wave, elements=4)
    whole = fb.simulate(scene, dt=0.01, t_end=0.2)
    motion = fb.Motion(scene, dt=0.01)
    for _ in range(20):
        motion.step()
    place = motion.state.displacement(beam.node(0.5))
    np.testing.assert_allclose(
        np.ravel(place)[-2:], whole.displacement(beam.node(0.5))[-1], rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ((0.0, 1.0), r"must be a function of \(s, t\)"),
        (lambda s, t: 1.0, r"at s = 0, t = 0: 1.0 has the wrong type or shape; it must be 2 num"),
        (lambda s: (0.0, s), r"at s = 0, t = 0: calling it raised TypeError"),
        (lambda s, t: (0.0, np.inf * (s > 1)), "at s = 0, t = 0.*is not finite"),
    ],
)
def test_what_is_no_load_is_refused(load, message):
    with np.errstate(invalid="ignore"), pytest.raises(fb.SceneError, match=message):
        simply_supported(load)


def test_a_load_that_becomes_infinite_names_the_place_and_the_time_and_keeps_the_steps_before():
    def load(s, t):
        return 0.0, np.where((s > 1) & (t > 0.5), np.nan, 1.0)

    scene, _ = simply_supported(load, elements=4)
    with pytest.raises(fb.StepError, match=r"at s = 1\.1.*t = 0\.5") as caught:
        fb.simulate(scene, dt=0.1, t_end=1.0)
    assert caught.value.solution.t[-1] == pytest.approx(0.5)
