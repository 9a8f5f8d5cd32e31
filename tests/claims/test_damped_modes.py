"""Modes of damped scenes: closed solutions, all roots by dense algebra, Rayleigh damping."""

import math

import ufl

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, one_bar, supported_bar

import fx_beam as fb


def oscillator(c, k=100.0):
    """A mass on a guide of the ground; natural frequency 10 rad/s."""
    scene, rod = one_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=1e4), elements=1)
    spring = fb.Spring(k) if k else None
    guide = fb.Prismatic(fb.GROUND, rod.start, axis=(1, 0), spring=spring, damper=fb.Damper(c))
    scene.add_joint(guide)
    scene.add_mass(rod.start, 1.0)
    return scene


def section(tau=0.0, rhoI=1e-4):
    return fb.Section(EA=1e5, GA=4e4, EI=10.0, rhoA=1.0, rhoI=rhoI, retardation=tau)


def supported(tau, elements=8, free=False, rhoI=1e-4):
    scene, beam = one_bar((1, 0), section(tau, rhoI), elements=elements, degree=2)
    if not free:
        scene.pin(beam.start)
        scene.fix(beam.end, "y")
    return scene


def frame(c, elements=14, tau=0.0, free=False, drag=0.0):
    """Two members with a damped hinge; the end slides in a damped guide. 160 unknowns."""
    corner = (0, 1)
    scene, post = one_bar([(0, 0), corner], section(tau), elements=elements, degree=2)
    arm = scene.add_beam([corner, (1, 1.3)], section(tau), elements=elements, degree=2)
    hinge = {"spring": fb.Spring(1.0), "damper": fb.Damper(c)}
    scene.add_joint(fb.Revolute(post.end, arm.start, **hinge))
    if drag:
        scene.add_virtual_work(lambda step: -drag * ufl.dot(step.v, step.virtual_u), post)
    if not free:
        scene.clamp(post.start)
        scene.add_joint(fb.PinInSlot(fb.GROUND, arm.end, axis=(0.6, 0.8), damper=fb.Damper(3 * c)))
    return scene


# -- Closed solutions --------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.15, 2.0, 50.0])
def test_an_oscillator_has_the_roots_of_the_textbook(ratio):
    modes = fb.modes(oscillator(20.0 * ratio))
    assert len(modes) == 1
    assert modes.angular_frequencies == pytest.approx([10.0], rel=1e-9)
    assert modes.damping_ratios == pytest.approx([ratio], rel=1e-9)
    # Of two real roots the slower one.
    root = 10 * (-ratio + np.emath.sqrt(ratio**2 - 1))
    assert modes.eigenvalues == pytest.approx([root], rel=1e-9)
    assert modes.overdamped.tolist() == [ratio > 1]
    assert str(modes).endswith("overdamped") == (ratio > 1)


# With 8 elements by the whole space, with 40 by a subspace.
@pytest.mark.parametrize(("elements", "free", "rhoI"), [(8, True, 0.0), (40, False, 1e-4)])
def test_retardation_alone_damps_each_mode_by_half_of_tau_omega(elements, free, rhoI):
    tau = 4e-3
    scene = supported(tau, elements, free, rhoI)
    modes, plain = fb.modes(scene, n=9), fb.modes(scene, n=9, damping=False)
    assert modes.rigid.tolist() == plain.rigid.tolist()
    assert modes.angular_frequencies == pytest.approx(plain.angular_frequencies, rel=1e-8)
    assert modes.damping_ratios == pytest.approx(tau * plain.angular_frequencies / 2, rel=1e-8)
    assert 0 < modes.overdamped.sum() < 9
    # The shapes are the real ones.
    size = abs(plain.shapes).max()
    assert abs(modes.shapes.imag).max() < 1e-5 * size
    assert abs(abs(modes.shapes[3:6]) - abs(plain.shapes[3:6])).max() < 1e-5 * size


def test_double_modes_of_a_ring_are_both_found():
    scene, half = one_bar(fb.arc((1, 0), (0, 1), (-1, 0)), section(0.002), elements=12, degree=2)
    lower = fb.arc(half.end, (0, -1), half.start)
    scene.add_beam(lower, section(0.002), elements=12, degree=2)
    modes = fb.modes(scene, n=9)
    assert modes.rigid.sum() == 3
    pairs = modes.angular_frequencies[3:].reshape(3, 2)
    assert pairs[:, 0] == pytest.approx(pairs[:, 1], rel=1e-6)
    # Any two shapes of their plane are modes of an equal root, and round-off decides which: an
    # overlap above 0.9 was seen. They must not be the same shape twice.
    pair = modes.shapes.reshape(9, -1)[3:5]
    pair = pair / np.linalg.norm(pair, axis=1)[:, None]
    assert np.linalg.svd(pair, compute_uv=False)[1] > 1e-3


def test_members_under_compression_have_the_roots_of_the_stressed_beam():
    # rhoA lambda^2 + tau EI k^4 lambda + EI k^4 + N k^2 = 0 where shear is small.
    tau, EI = 1e-3, 10.0
    stiff = fb.Section(EA=1e6, GA=1e6, EI=EI, rhoA=1.0, retardation=tau)
    scene, beam = supported_bar((1, 0), stiff, elements=16, degree=2)
    N = -1.5 * math.pi**2 * EI
    scene.add_force(beam.end, (N, 0))
    state = fb.static(scene)
    modes = fb.modes(scene, state, n=3)
    k = math.pi * np.arange(1, 4)
    c, stiffness = tau * EI * k**4, EI * k**4 + N * k**2
    exact = (-c + np.emath.sqrt(c**2 - 4 * stiffness)) / 2
    assert modes.eigenvalues == pytest.approx(exact, rel=2e-3)
    assert modes.unstable.tolist() == [True, False, False]
    assert modes.frequencies[0] == pytest.approx(-exact[0].real / (2 * math.pi), rel=2e-3)
    assert np.isnan(modes.damping_ratios[0]) and "unstable" in str(modes)
    # Damping slows the growth.
    plain = fb.modes(scene, state, n=3, damping=False)
    assert modes.eigenvalues[0].real < 0.99 * plain.eigenvalues[0].real


@pytest.mark.parametrize("drag", [0.0, 0.2])
def test_fewer_modes_than_rigid_ones_are_rigid(drag):
    # A drag on a part of it: the roots at zero are simple instead of double.
    scene = frame(c=0.3, elements=4, free=True, drag=drag)
    for n in (1, 3, 4):
        modes = fb.modes(scene, n=n)
        assert modes.rigid.tolist() == ([True] * 3 + [False])[:n]


def test_a_free_mass_with_a_damper_is_a_rigid_mode():
    modes = fb.modes(oscillator(3.0, k=0.0))
    assert len(modes) == 1 and modes.rigid.all()
    assert modes.eigenvalues == 0


def standard_solid(m, k, series, c, c_of_mass=0.0, elements=1):
    """A mass on a spring k, and on another one in series with a damper; on rods without mass.

    Beside it is a chain of elements that does not take part, for a subspace.
    """
    scene = fb.Scene()
    rod = fb.Section(EA=1e4, GA=1e4, EI=1e4)
    mass, link = (scene.add_beam([(x, 0), (x, 1)], rod, elements=1) for x in (0, 1))
    mass_damper = fb.Damper(c_of_mass) if c_of_mass else None
    ends = (mass.start, fb.Spring(k), mass_damper), (link.start, None, fb.Damper(c))
    for node, spring, damper in ends:
        scene.add_joint(fb.Prismatic(fb.GROUND, node, axis=(1, 0), spring=spring, damper=damper))
    scene.add_force_between(mass.start, link.start, spring=fb.Spring(series))
    scene.add_mass(mass.start, m)
    chain = scene.add_beam([(0, 5), (1, 5)], section(), elements=elements, degree=1)
    scene.clamp(chain.start)
    return scene


@pytest.mark.parametrize("elements", [1, 40])
@pytest.mark.parametrize(
    ("series", "c", "c_of_mass"),
    [(50.0, 1.0, 0.0), (50.0, 1e3, 0.0), (1e9, 1e3, 0.0), (1.0, 1e-2, 1e3), (1.0, 1e2, 1e3)],
    ids=["soft", "slow", "stiff", "faster than a mode", "slower than a mode"],
)
def test_a_node_without_mass_that_relaxes_is_no_mode(series, c, c_of_mass, elements):
    """m s^2 + c_of_mass s + k + series c s / (series + c s) = 0 has three roots.

    A real one alone has no frequency and no ratio; two real ones are those of an overdamped mode.
    """
    scene = standard_solid(1.0, 100.0, series, c, c_of_mass, elements)
    modes, plain = (fb.modes(scene, n=4, damping=damping) for damping in (True, False))
    assert len(modes) == len(plain)
    (root,) = (s for s in modes.eigenvalues if s.real < -1e-9)
    by_s = c * (100.0 + series) + series * c_of_mass
    roots = np.roots([c, series + c * c_of_mass, by_s, 100.0 * series])
    vibrates = roots.imag > 0
    nearest = abs(roots + 0.1).argmin()  # with -0.1 = -k / c of an overdamped mode
    expected = roots[vibrates] if vibrates.any() else roots[[nearest]]
    assert root == pytest.approx(expected[0], rel=1e-6)


# -- Dense algebra -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [{"c": 0.01}, {"c": 0.3, "tau": 1e-3}, {"c": 1e3}, {"c": 0.3, "free": True, "drag": 0.2}],
    ids=str,
)
def test_modes_with_local_dampers_are_those_of_dense_algebra(options):
    scene = frame(**options)
    modes = fb.modes(scene, n=8)
    roots = np.linalg.eigvals(fb.linearise(scene).A)
    moving = modes.eigenvalues[~modes.rigid]
    distance = abs(roots - moving[:, None]).min(axis=1) / abs(moving)
    assert distance.max() < 1e-6
    assert modes.rigid.sum() == (3 if "free" in options else 0)
    # Each vibration below the highest one is there, once.
    highest = abs(moving[~modes.overdamped[~modes.rigid]]).max()
    vibrations = roots[(roots.imag > 1e-6 * abs(roots)) & (abs(roots) < (1 + 1e-6) * highest)]
    vibrations = vibrations[abs(vibrations) > 1e-3]  # double zeros of rigid modes, split
    assert len(vibrations) == (moving.imag > 0).sum()


def test_a_part_of_many_modes_is_the_same_as_all():
    scene = frame(c=0.3, elements=6)
    few, many = fb.modes(scene, n=3), fb.modes(scene, n=1000)
    assert few.eigenvalues == pytest.approx(many.eigenvalues[:3], rel=1e-8)
    assert len(many) == len(fb.modes(scene, n=1000, damping=False))


# -- Shapes, refusals --------------------------------------------------------------------------


def test_a_shape_moves_through_its_phases():
    modes = fb.modes(frame(c=0.3, elements=4), n=3)
    post = "beam 1"
    rest = modes.positions[modes.nodes_of_beam[post]]
    start, quarter, half = (
        modes.shape(post, 1, 0.1, phase) - rest for phase in (0, np.pi / 2, np.pi)
    )
    assert half == pytest.approx(-start, abs=1e-12)
    assert abs(quarter).max() > 1e-3
    everywhere = [
        np.hypot(*(modes.shape(name, 1, 0.1, phase) - modes.positions[nodes]).T).max()
        for name, nodes in modes.nodes_of_beam.items()
        for phase in np.linspace(0, np.pi, 181)
    ]
    assert max(everywhere) == pytest.approx(0.1, rel=1e-3)


def test_damping_without_a_limit_at_rest_is_refused():
    scene = supported(0.0)
    speed = fb.modes(scene, n=1)
    scene.add_virtual_work(
        lambda step: -ufl.sqrt(ufl.dot(step.v, step.v)) * ufl.dot(step.v, step.virtual_u)
    )
    assert_refused("modes: the damping at rest is not finite", fb.modes, scene, n=1)
    assert fb.modes(scene, n=1, damping=False).frequencies == pytest.approx(speed.frequencies)


def test_what_has_neither_mass_nor_damping_adds_no_modes_in_any_unit_of_mass():
    """Turns of the rail have neither: their roots are infinite, and were some 1e10 rad/s."""
    for unit in 10.0 ** -np.arange(0, 10, 0.5):
        rod = fb.Section(EA=1e4 * unit, GA=1e4 * unit, EI=100 * unit, rhoA=unit)
        scene, rail = clamped_bar((2, 0), rod, elements=4)
        scene.pin(rail.end)
        car = scene.add_body((0.7, 0.1), unit, 0.05 * unit, points={"foot": (0.62, 0)})
        spring = fb.Spring(100 * unit, rest=0.62)
        scene.add_joint(fb.Sleeve(rail, car["foot"], spring=spring, damper=fb.Damper(2 * unit)))
        modes, plain = fb.modes(scene, n=60), fb.modes(scene, n=60, damping=False)
        assert len(modes) == len(plain) and not modes.unstable.any()
        assert modes.angular_frequencies == pytest.approx(plain.angular_frequencies, rel=0.01)
