"""Derivatives of every scene by nine numbers: forwards, backwards, and against differences."""

import numpy as np
import pytest
from registry import ONES, SCENES

import fx_beam as fb

#: Schemes of the Newmark family have no derivatives.
WITH = [
    case for name, case in SCENES.items() if name not in ("newmark", "hht", "generalized alpha")
]
STEPS = 8
of_every_scene = pytest.mark.parametrize("case", WITH, ids=lambda case: case.name)


@pytest.fixture(scope="module")
def responses():
    """A response of each scene, set up once."""
    return {}


@pytest.fixture
def response(responses, case):
    def build(x):
        scene = case.build(x)
        last = scene.nodes[-1]
        outputs = {
            "position": fb.Output("position", last),
            "velocity": fb.Output("velocity", last),
            "energy": fb.Output("kinetic_energy", scene),
        }
        outputs |= {f"joint {j.number}": fb.Output("force", j) for j in scene.joints}
        return scene, outputs

    if case.name not in responses:
        run = fb.Response(build, case.scheme(), dt=case.dt, t_end=STEPS * case.dt)
        responses[case.name] = run
    return responses[case.name]


def _weights(outputs):
    rng = np.random.default_rng(0)
    return {
        name: rng.standard_normal(rows.shape) / max(abs(rows).max(), 1e-6)
        for name, rows in outputs.items()
    }


@of_every_scene
def test_forward_and_adjoint_agree(case, response):
    _, outputs = response(ONES)
    weights, jacobian = _weights(outputs), response.jacobian()
    forward = sum(
        np.tensordot(weights[name], jacobian[name], axes=weights[name].ndim) for name in weights
    )
    backward = response.vjp(weights)
    assert backward == pytest.approx(forward, rel=0, abs=1e-9 * abs(forward).max())


@of_every_scene
def test_derivatives_are_those_of_the_motion(case, response):
    _, outputs = response(ONES)
    weights = _weights(outputs)
    gradient = response.vjp(weights)

    def value(x):
        _, at_x = response(x)
        return sum((weights[name] * at_x[name]).sum() for name in weights)

    direction, h = np.random.default_rng(1).uniform(0.5, 1.5, len(ONES)), 1e-4
    slopes = [
        (value(ONES + k * h * direction) - value(ONES - k * h * direction)) / (2 * k * h)
        for k in (1, 2)
    ]
    expected = (4 * slopes[0] - slopes[1]) / 3
    assert gradient @ direction == pytest.approx(expected, rel=1e-6, abs=1e-6 * abs(gradient).max())
