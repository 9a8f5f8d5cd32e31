"""Derivatives of resultants and strain energies in scenes with natural strains."""

import numpy as np
import pytest

import fx_beam as fb

DATA = {"EA": 1e4, "GA": 4e3, "EI": 10.0, "rhoA": 1.0, "rhoI": 1e-3}


def bending(x, over_time):
    """A cantilever that bends itself; numbers: stiffness, two of curvature, strain, length."""
    scene, section = fb.Scene(), fb.Section(**DATA | {"EI": x[0]})
    beam = scene.add_beam([(0, 0), (x[4], 0)], section, elements=3)
    scene.clamp(beam.start)
    scene.set_velocity(beam.end, (0.0, 0.3))
    curvature = lambda f: x[1] + x[2] * f  # noqa: E731
    if over_time:
        curvature = lambda f, t: x[1] + x[2] * t * (1 + f)  # noqa: E731
    scene.add_natural_strain(beam, curvature=curvature, axial=x[3] * 1e-3)
    outputs = {name: fb.Output(name, beam) for name in "NQM"}
    energies = {name: fb.Output(f"{name}_energy", scene) for name in ("strain", "total")}
    return scene, outputs | energies


X = np.array([10.0, 1.0, 2.0, 1.0, 1.0])


def random_sum(run):
    """Derivatives of a random sum of all outputs in both ways, and by extrapolated differences."""
    _, y = run(X)
    weights = {
        name: np.cos(np.arange(rows.size)).reshape(rows.shape) / abs(rows).max()
        for name, rows in y.items()
    }
    backward, changes = run.vjp(weights), run.jacobian()
    forward = sum(np.tensordot(weights[name], changes[name], y[name].ndim) for name in y)

    def value(x):
        rows = run(x)[1]
        return sum((weights[name] * rows[name]).sum() for name in rows)

    found = []
    for i, number in enumerate(X):
        one = np.eye(len(X))[i] * number
        low, high = ((value(X + h * one) - value(X - h * one)) / (2 * h) for h in (1e-4, 2e-4))
        found.append((4 * low - high) / 3 / number)
    return forward, backward, np.array(found)


@pytest.mark.parametrize("over_time", [True, False])
def test_derivatives_of_motions_are_those_of_differences(over_time):
    def build(x):
        return bending(x, over_time)

    run = fb.Response(build, dt=0.01, t_end=0.06)
    forward, backward, expected = random_sum(run)
    assert forward == pytest.approx(backward, rel=1e-10)
    assert backward == pytest.approx(expected, rel=1e-7, abs=1e-8 * abs(expected).max())


def test_derivatives_of_equilibria_are_those_of_differences():
    def build(x):
        scene, outputs = bending(x, False)
        scene.add_force(scene.beams[0].end, (0.0, -3.0))
        return scene, outputs

    run = fb.StaticResponse(build, steps=2)
    forward, backward, expected = random_sum(run)
    assert forward == pytest.approx(backward, rel=1e-10)
    assert backward == pytest.approx(expected, rel=1e-7, abs=1e-8 * abs(expected).max())


def test_derivatives_of_the_energy_with_constant_strains_are_constant():
    run = fb.Response(lambda x: bending(x, False), dt=0.01, t_end=0.2)
    t, _ = run(X)
    energy = run.jacobian("total")["total"]
    assert energy == pytest.approx(np.tile(energy[0], (len(t), 1)), abs=1e-9 * abs(energy).max())
