"""Strips that are squeezed beyond their buckling loads bow out as exact, or are refused."""

import re

import numpy as np
import pytest
from scenes import benchmark, hinged_body, supported_bar
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import fx_beam as fb

LENGTH, HEIGHT, WIDTH = 1.0, 2e-3, 20e-3
STEEL = {"E": 210e9, "nu": 0.3, "rho": 7850.0}
ALONG = np.array([np.cos(np.radians(37.0)), np.sin(np.radians(37.0))])
ACROSS = np.array([-ALONG[1], ALONG[0]])
WAYS = pytest.mark.parametrize(
    ("load_steps", "way"),
    [(1, None), (10, None), (200, None), (1, "arc-length"), (30, "arc-length")],
)


def strip(clamped=False, weight=0.0, push=1e-3):
    """A strip at 37 degrees on two supports, of which the second slides; pushed to one side."""
    scene = fb.Scene(gravity=tuple(-weight * ACROSS))
    section = fb.Section.rectangle(HEIGHT, WIDTH, **STEEL)
    beam = scene.add_beam([(0, 0), LENGTH * ALONG], section, elements=12, degree=2)
    (scene.clamp if clamped else scene.pin)(beam.start)
    scene.add_force(beam.node(0.5), tuple(-push * ACROSS))
    return scene, beam, section, (2 if clamped else 1) * np.pi / LENGTH


def slides(scene, beam):
    scene.add_joint(fb.PinInSlot(fb.GROUND, beam.end, axis=tuple(ALONG)))


def assert_sags(scene, beam, exact, load_steps, way, rel=2e-3):
    """By how far the middle moves against `ACROSS`. A path in few steps may be refused."""
    try:
        path = fb.static(scene, load_steps, continuation=way)
    except fb.StepError as error:
        assert load_steps < 30 and re.search("load factor .* failed", str(error))
        assert re.search("arc-length|Try more steps|more steps", error.failure.advice)
        return
    assert path.stable[-1]
    assert -path.displacement(beam.node(0.5))[-1] @ ACROSS == pytest.approx(exact, rel=rel)


def elastica(of_force):
    """Sag of a pinned strip where of_force(m) is zero: (P/P_E, shortening) of the elastica."""

    def of(m):
        return (2 * ellipk(m) / np.pi) ** 2, 2 * LENGTH * (1 - ellipe(m) / ellipk(m))

    m = brentq(lambda m: of_force(m, *of(m)), 1e-9, 0.7)
    return LENGTH * np.sqrt(m) / ellipk(m)


@WAYS
@pytest.mark.parametrize("clamped", [False, True])
@pytest.mark.parametrize("weight", [0.0, 9.81])
def test_a_heated_strip_sags_as_far_as_its_length_grows(clamped, weight, load_steps, way):
    """(2 L / pi) sqrt(alpha dT - (k h)^2 / 12), which a small weight makes a little more."""
    scene, beam, _, k = strip(clamped, weight)
    (scene.clamp if clamped else scene.pin)(beam.end)
    strain = fb.thermal(12e-6, 20.0)
    scene.add_natural_strain(beam, axial=strain)
    exact = 2 * LENGTH / np.pi * np.sqrt(strain - (k * HEIGHT) ** 2 / 12)
    assert_sags(scene, beam, exact, load_steps, way, 2e-2 if weight else 3e-3)


@WAYS
def test_a_strip_that_is_pushed_together_bows_as_the_elastica(load_steps, way):
    scene, beam, _, _ = strip(push=0.5)
    scene.prescribe(beam.end, x=-1e-3 * LENGTH * ALONG[0], y=-1e-3 * LENGTH * ALONG[1])
    exact = elastica(lambda m, force, shorter: shorter - 1e-3 * LENGTH)
    assert_sags(scene, beam, exact, load_steps, way)


@WAYS
def test_a_strip_under_a_dead_force_bows_as_the_elastica(load_steps, way):
    scene, beam, section, k = strip()
    slides(scene, beam)
    scene.add_force(beam.end, tuple(-1.1 * section.EI * k**2 * ALONG))
    exact = elastica(lambda m, force, shorter: force - 1.1)
    assert_sags(scene, beam, exact, load_steps, way)


@WAYS
def test_a_strip_under_a_force_that_follows_its_end_bows_as_the_elastica(load_steps, way):
    """Of the force only P cos(psi) is along the strip, with sin(psi / 2) = sqrt(m) at its end."""
    scene, beam, section, k = strip()
    slides(scene, beam)
    force = tuple(-1.3 * section.EI * k**2 * ALONG)
    scene.add_force(beam.end, force, follower=True)
    exact = elastica(lambda m, force, shorter: force - 1.3 * (1 - 2 * m))
    assert_sags(scene, beam, exact, load_steps, way)


@WAYS
def test_a_strip_between_the_ends_of_a_tendon_bows_as_the_elastica(load_steps, way):
    """A spring of half the length: its tension grows with the weight, to 1.5 Euler loads."""
    scene, beam, section, k = strip()
    slides(scene, beam)
    stiffness = 1.5 * section.EI * k**2 / (0.5 * LENGTH)
    scene.add_force_between(beam.start, beam.end, spring=fb.Spring(stiffness, rest=0.5 * LENGTH))
    exact = elastica(lambda m, force, shorter: force - 1.5 * (1 - shorter / (0.5 * LENGTH)))
    assert_sags(scene, beam, exact, load_steps, way)


@pytest.mark.parametrize("load_steps", [1, 3, 10, 100])
def test_a_rod_that_points_inwards_in_a_centrifuge_falls_to_its_side(load_steps):
    """On a hinge at the rim: c psi = M + m Omega^2 R a sin(psi), beyond m Omega^2 R a = c."""
    R, a, m, c, moment, spin = 2.0, 0.5, 3.0, 100.0, 0.5, np.sqrt(1.4 * 100.0 / 3.0)
    scene, rod, hinge = hinged_body((R - a, 0), m, 0.1, {"hinge": (R, 0)}, spring=fb.Spring(c))
    scene.add_moment(rod.centre, moment)
    path = fb.static(scene, load_steps, spin=spin)
    exact = brentq(lambda psi: c * psi - moment - m * spin**2 * R * a * np.sin(psi), 0.1, 3.0)
    assert path.joint(hinge).angle[-1] == pytest.approx(exact, rel=1e-8)
    assert path.stable[-1]


@pytest.mark.parametrize("way", [None, "arc-length"])
@pytest.mark.parametrize(("load", "text"), [(1.5, "1 of its modes grows"), (5.0, "2 of its modes")])
def test_a_path_that_ends_in_an_unstable_equilibrium_says_so_once(load, text, way, caplog):
    scene, beam, section, k = strip(push=0.0)
    slides(scene, beam)
    scene.add_force(beam.end, tuple(-load * section.EI * k**2 * ALONG))
    path = fb.static(scene, 6, continuation=way)
    assert not path.stable[-1]
    (record,) = caplog.records
    assert "unstable" in record.message and text in record.message


def test_the_critical_load_under_springs_that_are_under_tension_has_its_derivatives():
    """Pinned column, squeezed by a tendon and a load: they sum up to l (T + P) = pi^2 EI/L^2."""

    def build(x):
        scene, column = supported_bar((0, 1), fb.Section(1e7, 1e7, x[0]), 8, 3, held="x")
        tendon = fb.Spring(x[1], rest=0.5)
        scene.add_force_between(column.start, column.end, spring=tendon)
        scene.add_force(column.end, (0, -x[2]))
        return scene, {"load": fb.Output("critical_load", scene)}

    run = fb.StaticResponse(build, load_steps=5)
    EI, stiffness, load = x = [1.0, 10.0, 8.0]
    _, y = run(x)
    total = 0.5 * stiffness + load
    exact = np.pi**2 * EI / total
    by_x = exact / EI, -exact * 0.5 / total, -exact / total
    assert y["load"] == pytest.approx(exact, rel=1e-5)
    assert run.jacobian()["load"] == pytest.approx(by_x, rel=1e-5)


@pytest.mark.parametrize("seed", range(24))
def test_no_random_strip_ends_silently_on_another_path(seed):
    script = benchmark("lost_stability")
    assert script.verdict(**script.random_case(seed))[0] in ("right", "refused")
