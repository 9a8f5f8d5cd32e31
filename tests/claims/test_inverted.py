"""Inverted sections, t . phi' <= 0 at a Gauss point (eq. 4), are reported."""

import numpy as np
import pytest
from scenes import pinned_bar

import fx_beam as fb

EA = 100.0
SOFT = fb.Section(EA=EA, GA=EA, EI=10.0, rhoA=0.1, rhoI=0.1)
GAUSS = {1: [0.0], 2: [-(3**-0.5), 3**-0.5], 3: [-(0.6**0.5), 0.0, 0.6**0.5]}


def stretch(solution, beam, degree):
    """t . phi' times squares of lengths, (n, elements * degree), from nodal values in numpy."""
    vandermonde = np.vander(np.linspace(-1, 1, degree + 1), increasing=True)
    xi = np.array(GAUSS[degree])
    powers = np.arange(degree + 1)
    N = xi[:, None] ** powers @ np.linalg.inv(vandermonde)
    dN = powers * xi[:, None] ** np.maximum(powers - 1, 0) @ np.linalg.inv(vandermonde)
    nodes = solution.nodes_of_beam[beam.name]
    X, q = solution.X[nodes], solution.q[:, nodes]
    values = []
    for first in range(0, len(nodes) - 1, degree):
        own = slice(first, first + degree + 1)
        tx, ty = (dN @ X[own]).T
        psi = q[:, own, 2] @ N.T
        along = np.einsum("gi,nij->ngj", dN, X[own] + q[:, own, :2])
        c, s = np.cos(psi), np.sin(psi)
        values.append((c * tx - s * ty) * along[..., 0] + (s * tx + c * ty) * along[..., 1])
    return np.concatenate(values, axis=1)


def bar(degree, speed=0.0, gravity=0.0):
    """A bar along x on a clamp, with a mass at its guided end that runs into it."""
    scene = fb.Scene(gravity=(gravity, 0.0))
    beam = scene.add_beam(((0, 0), (1, 0)), SOFT, elements=1, degree=degree, name="bar")
    scene.clamp(beam.start)
    scene.fix(beam.end, "y", "rotation")
    if speed:
        scene.add_mass(beam.end, 1.0)
        scene.set_velocity(beam.end, (-speed, 0.0))
    return scene, beam


@pytest.mark.parametrize(("degree", "way"), [(1, None), (2, "arc-length")])
def test_a_bar_pushed_through_its_clamp_is_reported(degree, way, caplog):
    scene, beam = bar(degree)
    scene.add_force(beam.end, (-1.5 * EA, 0.0))
    solution = fb.static(scene, load_steps=10, continuation=way)
    assert solution.resultants(beam).N[-1] == pytest.approx(np.full(degree, -1.5 * EA))
    # The strain is -1.5 of the load factor, and -1 at two thirds.
    assert solution.stats.inverted == np.count_nonzero(solution.load_factor > 2 / 3) > 2
    (message,) = [r.getMessage() for r in caplog.records if "inverted" in r.getMessage()]
    first = solution.load_factor[solution.load_factor > 2 / 3][0]
    assert "beam 'bar' has an inverted section at its arc length" in message
    assert f"load factor = {first:.6g}: there t . phi' is {1 - 1.5 * first:.3g}" in message


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_every_step_that_ends_inverted_is_counted_recorded_or_not(degree, caplog):
    scene, beam = bar(degree, speed=14.0)
    options = {"dt": 0.005, "t_end": 0.2}
    full = fb.simulate(scene, **options)
    assert full.stats.halvings == 0
    inverted = (stretch(full, beam, degree) <= 0).any(axis=1)
    assert 5 < np.count_nonzero(inverted) < 35
    assert full.stats.inverted == np.count_nonzero(inverted)
    (message,) = [r.getMessage() for r in caplog.records]
    assert f" t = {full.t[inverted][0]:.6g}:" in message
    thin = fb.simulate(scene, record=fb.Record(every=30, motion=False), **options)
    assert thin.stats.inverted == full.stats.inverted


def driven(scene, end):
    scene.prescribe(end, x=lambda t: -0.75 * (1 - np.cos(20 * t)))


def pulled(scene, end):
    spring = fb.Spring(strain_energy=lambda r: -100.0 * (r - 2) ** 2)  # which becomes negative
    scene.add_force_between(end, (3.0, 0.0), spring=spring)


# What pushes the bar through its clamp, and the speed with which it begins.
PUSHES = {
    "a load": (lambda scene, end: scene.add_force(end, lambda t: (-1e3 * np.sin(20 * t), 0)), 0.0),
    "a body force": (lambda scene, end: None, 0.0),
    "driven motion": (driven, 0.0),
    "a force between points": (pulled, 1.0),
}


@pytest.mark.parametrize("scheme", [None, fb.EnergyMomentum(order=4), fb.EnergyDecaying()], ids=str)
@pytest.mark.parametrize("push", PUSHES)
def test_all_that_may_invert_sections_counts_between_rows(push, scheme):
    scene, beam = bar(1, speed=PUSHES[push][1], gravity=-120.0 * (push == "a body force"))
    scene.add_mass(beam.end, 1.0)
    PUSHES[push][0](scene, beam.end)
    options = {"scheme": scheme, "dt": 0.005, "t_end": 0.45}
    full = fb.simulate(scene, **options)
    inverted = (stretch(full, beam, 1) <= 0).any(axis=1)
    assert 5 < np.count_nonzero(inverted) < 85 and not inverted[:5].any()
    thin = fb.simulate(scene, record=fb.Record(every=90), **options)
    assert thin.stats.inverted == full.stats.inverted == np.count_nonzero(inverted)


@pytest.mark.parametrize("record", [None, fb.Record(every=30)])
def test_inverted_sections_are_counted_step_by_step_and_after_a_return(record):
    scene, _ = bar(1, speed=14.0)
    number = fb.simulate(scene, dt=0.005, t_end=0.2).stats.inverted
    motion = fb.Motion(scene, dt=0.005, record=record)
    start = motion.snapshot()
    motion.run(0.2)
    assert motion.stats.inverted == number > 5
    motion.restore(start)
    motion.run(0.2)
    assert motion.stats.inverted == 2 * number


def test_beams_that_bend_and_turn_are_not_reported(caplog):
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene, beam = pinned_bar((2, 0), section, elements=6)
    scene.set_velocity(beam, lambda x, y: (-9 * y, 9 * x), spin=9.0)
    scene.add_moment(beam.end, lambda t: 100.0 * np.sin(5 * t))
    solution = fb.simulate(scene, dt=0.01, t_end=2.0)
    assert abs(solution.rotation(beam.end)).max() > 10.0
    assert solution.stats.inverted == 0
    assert not caplog.records
