"""Equilibria of scenes that no support holds: loads in balance among themselves."""

import numpy as np
import pytest
import scipy.linalg
from scenes import one_bar

import fx_beam as fb

L, EI, M, T, K = 4.0, 1e4, 20.0, 2000.0, 1e5


def with_a_rod(turn=0.0, metre=1.0, newton=1.0, place=(0.0, 0.0), scene=None):
    """A beam of 4 m, with a rod between its ends under a tension of 2 kN; in units of force."""
    scene = fb.Scene() if scene is None else scene
    kg, m2 = newton / metre, metre**2
    stiff = {"EA": 1e8 * newton, "GA": 3e7 * newton, "EI": EI * newton * m2}
    section = fb.Section(**stiff, rhoA=M * kg / metre, rhoI=2e-3 * kg * metre)
    place = np.array(place) * metre
    end = place + L * metre * np.array([np.cos(turn), np.sin(turn)])
    beam = scene.add_beam([place, end], section, elements=8, degree=2)
    rod = fb.Spring(K * newton / metre, rest=(L - T / K) * metre)
    scene.add_force_between(beam.start, beam.end, spring=rod)
    return scene, beam


def ritz(n, *ends):
    """Frequencies of bending [Hz] of a beam whose chord the rod presses, by Ritz's method.

    With Legendre polynomials that are zero at some `ends` (-1, 1), and the energy
    EI w'' w'' - P (w' w' - chord^2) with chord = (w(1) - w(-1)) / L.
    """
    x, weight = np.polynomial.legendre.leggauss(30)
    P = T / (1 + K * L / 1e8)  # what is left of it when the beam has shortened
    shapes = [np.polynomial.Legendre.basis(k) for k in range(12)]
    w, w1, w2 = (np.array([s.deriv(k)(x) * (2 / L) ** k for s in shapes]) for k in (0, 1, 2))
    chord = np.array([(s(1) - s(-1)) / L for s in shapes])
    stiffness = L / 2 * (EI * (w2 * weight) @ w2.T - P * (w1 * weight) @ w1.T)
    stiffness += P * L * np.outer(chord, chord)
    mass = L / 2 * M * (w * weight) @ w.T
    at_ends = np.array([[s(end) for s in shapes] for end in ends]).reshape(-1, len(shapes))
    free = scipy.linalg.null_space(at_ends) if ends else np.eye(len(shapes))
    squares = scipy.linalg.eigh(free.T @ stiffness @ free, free.T @ mass @ free, eigvals_only=True)
    rigid = 2 - len(ends)
    assert abs(squares[:rigid]).max(initial=0.0) < 1e-6 * squares[rigid]
    return np.sqrt(squares[rigid : rigid + n]) / (2 * np.pi)


@pytest.mark.parametrize(
    "how",
    [{}, {"turn": 0.646}, {"metre": 1e3, "newton": 1e-3}, {"load_steps": 1}]
    + [{"continuation": "arc-length"}],
)
def test_a_free_beam_with_a_tight_rod_has_its_rigid_modes_at_zero(how, caplog):
    options = {name: how[name] for name in ("load_steps", "continuation") if name in how}
    scene, beam = with_a_rod(**{name: how[name] for name in how.keys() - options.keys()})
    path = fb.static(scene, **options)
    assert path.stable.all() and not path.critical_points
    frequencies = fb.modes(scene, path, n=5).frequencies
    assert frequencies[:3] == pytest.approx([0, 0, 0], abs=1e-4 * frequencies[3])
    assert frequencies[3:] == pytest.approx(ritz(2), rel=2e-3)
    assert not caplog.text


def test_several_free_parts_are_held_each():
    scene, _ = with_a_rod()
    with_a_rod(0.3, place=(0.0, 1.0), scene=scene)
    frequencies = fb.modes(scene, fb.static(scene), n=8).frequencies
    assert frequencies[:6] == pytest.approx(np.zeros(6), abs=1e-3)
    assert frequencies[6:] == pytest.approx(2 * list(ritz(1)), rel=2e-3)


@pytest.mark.parametrize("ends", [(-1,), (-1, 1)])
def test_a_part_that_can_only_turn_or_only_slide_is_held(ends):
    scene, beam = with_a_rod()
    scene.fix(beam.start, *("x", "y")[len(ends) - 1 :])
    if len(ends) == 2:
        scene.fix(beam.end, "y")
    frequencies = fb.modes(scene, fb.static(scene), n=2).frequencies
    assert frequencies[0] == pytest.approx(0, abs=1e-3)
    assert frequencies[1:] == pytest.approx(ritz(1, *ends), rel=2e-3)


@pytest.mark.parametrize("load_steps", [1, 7])
def test_three_forces_in_balance_bend_a_free_beam_as_a_supported_one(load_steps):
    """P L^3 / (48 EI) under the middle, beside the ends."""
    P, scene = 1.0, fb.Scene()
    section = fb.Section(EA=1e8, GA=1e8, EI=EI, rhoA=M)
    beam = scene.add_beam([(1, 2), (1 + L, 2)], section, elements=8, degree=2)
    for node, force in ((beam.start, P / 2), (beam.end, P / 2), (beam.node(0.5), -P)):
        scene.add_force(node, (0.0, force))
    path = fb.static(scene, load_steps)
    first, last, middle = (path.displacement(beam.node(s))[-1, 1] for s in (0.0, 1.0, 0.5))
    assert (first + last) / 2 - middle == pytest.approx(P * L**3 / (48 * EI), rel=2e-3)
    assert path.stable.all()


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_a_free_column_with_a_tendon_buckles_at_eulers_load(continuation):
    scene, beam = one_bar((0, 1), fb.Section(1e6, 1e6, 1.0), elements=8, degree=3)
    scene.add_force_between(beam.start, beam.end, force=12.0)
    path = fb.static(scene, load_steps=7, continuation=continuation)
    (point,) = path.critical_points
    assert point.kind == "bifurcation"
    assert 12 * point.load_factor == pytest.approx(np.pi**2, rel=1e-4)
    assert path.unstable_modes[[0, -1]].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("load", "words"),
    [
        (
            lambda scene, beam: scene.add_force(beam.end, (0.0, 3.0)),
            r"\(0, 3\) N and, about \(2, 0\), 6 N m",
        ),
        (
            lambda scene, beam: scene.add_moment(beam.end, 5.0),
            r"\(0, 0\) N and, about \(2, 0\), 5 N m",
        ),
        (
            lambda scene, beam: [
                scene.add_force(node, (0.0, force))
                for node, force in ((beam.start, -2.0), (beam.end, 2.0))
            ],
            r"\(0, 0\) N and, about \(2, 0\), 8 N m",
        ),
    ],
)
def test_loads_without_balance_are_named(load, words):
    scene, beam = with_a_rod()
    load(scene, beam)
    with pytest.raises(fb.SceneError, match=words) as caught:
        fb.static(scene)
    assert "no support" in str(caught.value) and "Add a support" in str(caught.value)


def test_derivatives_of_an_equilibrium_that_no_support_holds():
    """The beam shortens by T L / (EA + K L)."""

    def build(x):
        scene, beam = one_bar((L, 0), fb.Section(EA=x[0], GA=3e7, EI=EI), elements=2)
        scene.add_force_between(beam.start, beam.end, spring=fb.Spring(K, rest=L - x[1] / K))
        ends = {"start": beam.start, "end": beam.end}
        return scene, {name: fb.Output("position", node) for name, node in ends.items()}

    EA = 1e6
    run = fb.StaticResponse(build, load_steps=2)
    _, y = run([EA, T])
    J = run.jacobian()
    length = y["end"][-1, 0] - y["start"][-1, 0]
    assert length == pytest.approx(L - T * L / (EA + K * L), rel=1e-9)
    slopes = J["end"][-1, 0] - J["start"][-1, 0]
    assert slopes == pytest.approx([T * L / (EA + K * L) ** 2, -L / (EA + K * L)], rel=1e-6)
