"""Derivatives of random scenes with driven motions by many numbers, in three ways."""

import numpy as np
import pytest
from derivatives import difference
from scenes import one_bar

import fx_beam as fb

COUNT = 10
BASES = "prescribed", "revolute", "prismatic", "pinned"
FRICTIONS = None, fb.SmoothFriction(0.3, speed=0.1), fb.Coulomb


def scene_of(x, rng):
    """A beam on a driven or pinned end with a body, some kind of slide, and loads.

    Which number does what is random, and whether some move the joints. Profiles over time are zero
    outside of a part of it.
    """
    x, moves = x[rng.permutation(COUNT)], rng.random() < 0.4
    length, slope = (x[3], x[8]) if moves else (1.0, 1.0)
    base, friction = rng.choice(BASES), FRICTIONS[rng.integers(3)]
    knots = np.sort(rng.uniform(0.0, 0.1, 3))

    def profile(number):
        return lambda t: np.interp(t, knots, np.stack([0.0, number, 0.0]))

    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[1] * x[3], rhoA=x[2], rhoI=1e-2)
    scene, beam = one_bar((length, 0.2), section, elements=2, gravity=(0.0, -9.81 * x[0]))
    if base == "prescribed":
        scene.prescribe(beam.start, x=profile(0.05 * x[4]), y=0.0)
    elif base == "revolute":
        scene.add_joint(fb.Revolute(fb.GROUND, beam.start, motor=profile(0.3 * x[4])))
    elif base == "prismatic":
        guide = {"axis": (1.0, 0.2), "motor": profile(0.05 * x[4])}
        scene.add_joint(fb.Prismatic(fb.GROUND, beam.start, **guide))
    else:
        scene.pin(beam.start)
    place = {"pin": (length, 0.2)}
    body = scene.add_body((length + 0.2, 0.2), mass=0.5 * x[5], inertia=0.02, points=place)
    motor = profile(0.5 * x[6]) if rng.random() < 0.7 else None
    scene.add_joint(fb.Revolute(beam.end, body["pin"], motor=motor))
    block = scene.add_body((2, 1), mass=1.0, inertia=0.05)
    if friction is fb.Coulomb:
        friction = fb.Coulomb(0.3, 300.0 * x[7])
    axis, spring = (1.0, -0.5 * slope), fb.Spring(30.0, rest=x[9] - 1)
    slide = scene.add_joint(
        fb.Prismatic(fb.GROUND, block.centre, axis, friction=friction, spring=spring)
    )
    scene.add_force(block.centre, lambda t: (3 * x[7] * t, x[8]))
    return scene, {
        "end": fb.Output("position", beam.end),
        "spin": fb.Output("spin", body.centre),
        "slide": fb.Output("slide", slide),
        "work": fb.Output("work", scene),
    }


@pytest.mark.parametrize("seed", range(12))
def test_derivatives_by_ten_numbers_agree_forwards_backwards_and_with_motions(seed):
    def build(x):
        return scene_of(x, np.random.default_rng(seed))

    rng, h = np.random.default_rng(100 + seed), 1e-4
    run = fb.Response(build, dt=0.005, t_end=0.1, record=fb.Record(every=2))
    x, direction = rng.uniform(0.95, 1.05, COUNT), rng.standard_normal(COUNT)
    _, y = run(x)
    weights = {name: rng.standard_normal(rows.shape) for name, rows in y.items()}
    gradient, J = run.vjp(weights), run.jacobian()
    forward = sum(np.tensordot(weights[name], J[name], weights[name].ndim) for name in y)
    size = abs(gradient).max()
    assert abs(forward - gradient).max() < 1e-10 * size
    _, same = run(x)  # by the scene with slopes, which serves the derivatives as well
    for name, rows in y.items():
        assert abs(same[name] - rows).max() <= 1e-10 * abs(rows).max(), name
    assert abs(run.vjp(weights) - gradient).max() < 1e-9 * size

    def total(step):
        _, end = run(x + step * direction)
        return sum((weights[name] * end[name]).sum() for name in y)

    expected = difference(total, h)
    assert gradient @ direction == pytest.approx(expected, abs=1e-6 * size)


def test_a_driven_motion_that_ends_leaves_nothing_in_the_changes_after_it():
    """The only number is the height of a hat over time."""

    def build(x):
        section = fb.Section(EA=1e4, GA=5e3, EI=20.0, rhoA=1.0, rhoI=1e-2)
        scene, beam = one_bar((1, 0), section, elements=2, gravity=(0.0, -9.81))
        path = lambda t: np.interp(t, [0.02, 0.04, 0.06], [0.0, x[0], 0.0])  # noqa: E731
        scene.prescribe(beam.start, x=path, y=0.0)
        return scene, {"end": fb.Output("position", beam.end)}

    run = fb.Response(build, dt=0.01, t_end=0.1)
    _, y = run([0.1])
    J = run.jacobian()["end"][..., 0]
    for row in np.ndindex(J.shape):
        weights = np.zeros(J.shape)
        weights[row] = 1.0
        assert J[row] == pytest.approx(run.vjp({"end": weights})[0], abs=1e-11 * abs(J).max())
