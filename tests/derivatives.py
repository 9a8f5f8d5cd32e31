"""Outputs of scenes, and checks of their derivatives: forwards, backwards, and by differences."""

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.scene.outputs import lack

OF_NODES = "position", "rotation", "velocity", "spin", "acceleration", "reaction"
OF_JOINTS = "angle", "slide", "spin", "rate", "force", "motor_force"
ENERGIES = "kinetic", "strain", "potential", "spring", "total", "dissipated"


def outputs_of(scene, without=()):
    """All outputs of the first and last node, and of joints, beams and energies of a scene."""
    parts = {"first": scene.nodes[0], "last": scene.nodes[-1]}
    outputs = {
        f"{kind} {name}": fb.Output(kind, node) for name, node in parts.items() for kind in OF_NODES
    }
    for joint in scene.joints[:3]:
        has = [kind for kind in OF_JOINTS if not lack(joint, kind)]
        outputs |= {f"{kind} of joint {joint.number}": fb.Output(kind, joint) for kind in has}
    outputs |= {
        f"{kind} of {beam.name}": fb.Output(kind, beam)
        for beam in scene.beams[:2]
        for kind in "NQM"
    }
    outputs |= {kind: fb.Output(f"{kind}_energy", scene) for kind in ENERGIES}
    outputs["work"] = fb.Output("work", scene)
    return {name: output for name, output in outputs.items() if name not in without}


EXACT = fb.NewtonOptions(tolerance=1e-13)


def size_of(rows):
    return max(abs(rows).max(), 1e-3)


def difference(function, h):
    """Slope of a function at 0, of fourth order, from its values at -2 h, -h, h and 2 h."""
    low2, low, high, high2 = (function(k * h) for k in (-2, -1, 1, 2))
    return (8 * (high - low) - (high2 - low2)) / (12 * h)


def assert_both_ways_agree(run, y, J):
    """For a random sum of all outputs, each to its size: `vjp` after a call against `jacobian`."""
    rng = np.random.default_rng(0)
    weights = {name: rng.standard_normal(rows.shape) / size_of(J[name]) for name, rows in y.items()}
    forward = sum(np.tensordot(weights[name], J[name], weights[name].ndim) for name in y)
    assert run.vjp(weights) == pytest.approx(forward, rel=0, abs=1e-9 * abs(forward).max())


def assert_they_are_those_of_the_motion(run, x, J, h=1e-4):
    """In a random direction of all numbers, by differences that are extrapolated."""
    direction = x * np.random.default_rng(1).uniform(0.5, 1.5, len(x))
    ends = [run(x + k * h * direction)[1] for k in (-2, -1, 1, 2)]
    wrong = {}
    for name in J:
        low2, low, high, high2 = (end[name] for end in ends)
        expected = (8 * (high - low) - (high2 - low2)) / (12 * h)
        errors = abs(J[name] @ direction - expected) / size_of(J[name])
        if not errors.max() < 1e-6:
            wrong[name] = errors.max()
    assert not wrong, wrong


def assert_derivatives(run, x):
    """Of all outputs at x, in both ways and of the motion."""
    x = np.asarray(x, float)
    _, y = run(x)
    J = run.jacobian()
    assert_both_ways_agree(run, y, J)
    assert_they_are_those_of_the_motion(run, x, J, 1e-4)


def assert_left_of_second_order(run, x, odd_part=1e-6):
    """Remainders of the linear change of a response of modes or vibrations; and backwards."""
    direction = np.array([0.3, -0.5, 0.4, 0.6])
    values, J = run(x), run.jacobian()
    weights = np.random.default_rng(0).standard_normal((*values.shape, 2)) @ (1, 1j)
    weights = weights if np.iscomplexobj(values) else weights.real
    by_x = np.tensordot(weights, J, values.ndim).real
    assert run.vjp(weights) == pytest.approx(by_x, rel=1e-6, abs=1e-9 * abs(by_x).max())
    left = [run(x + h * direction) - values - h * J @ direction for h in (2e-3, -2e-3, 1e-3, -1e-3)]
    odd = abs(np.subtract(left[::2], left[1::2])).reshape(2, -1).max(axis=1)
    assert odd[0] < odd_part * abs(values).max()  # of third order: the difference of both sides
    even = abs(np.add(left[::2], left[1::2])).reshape(2, -1).max(axis=1)
    assert even[0] / even[1] == pytest.approx(4.0, rel=0.05)
    return values, J


def differences(function, x, part=1e-4):
    """Central differences (..., m) of fourth order."""
    columns = []
    for unit, h in zip(np.eye(len(x)), part * np.maximum(abs(x), 0.1), strict=True):
        columns.append(difference(lambda step, u=unit: function(x + step * u), h))
    return np.moveaxis(np.array(columns), 0, -1)


def assert_orbit_slopes(run, x, tolerance, multipliers=True, part=1e-4):
    """Of a motion that repeats itself and its multipliers, by differences of other searches."""
    x = np.array(x, float)
    _, y = run(x)
    slopes, sizes = run.jacobian(), dict.fromkeys(y, tolerance)
    if multipliers:
        slopes["multipliers"], sizes["multipliers"] = run.multipliers()[1], 1e-6

    def rows(x):
        """All that a search gives, in one row."""
        values = run(x)[1]
        if multipliers:
            values = values | {"multipliers": run.multipliers()[0]}
        return np.concatenate([np.ravel(values[name]) for name in slopes])

    lengths = [slope.size // len(x) for slope in slopes.values()]
    parts = np.split(differences(rows, x, part), np.cumsum(lengths)[:-1])
    for (name, slope), by_x in zip(slopes.items(), parts, strict=True):
        most = sizes[name] * abs(by_x).max() + 1e-8
        assert slope.reshape(by_x.shape) == pytest.approx(by_x, abs=most), name
