"""Histories at chosen times, between the ends of the steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.model.model import Model
from fx_beam.results.audit import Energy


def at_times(model: Model, steps: dict[str, Any], times: np.ndarray) -> tuple[dict, np.ndarray]:
    """Histories at times (n,) from those of all steps, and the steps' rows (n,) that contain them.

    Displacements and rotations are cubic polynomials in each step, rates their derivatives.
    Energies and momenta are linear, so that balances stay exact. Forces and accelerations are those
    of the step.
    """
    t = steps["t"]
    times = times[(times >= t[0]) & (times <= t[-1])]
    row = np.clip(np.searchsorted(t, times), 1, max(len(t) - 1, 1)) if len(t) > 1 else 0 * times
    row = row.astype(int)
    before = np.maximum(row - 1, 0)
    dt = np.where(row > before, t[row] - t[before], 1.0)
    x = (times - t[before]) / dt
    found = dict(steps)
    q, v = _cubic(steps["q"], _slopes(model, steps), row, before, x, dt)
    found |= {"t": times, "q": q, "v": v}
    for name in ("t_level", "a", "reactions", "joint_forces", "motor_forces"):
        found[name] = steps[name][row] if len(steps[name]) else steps[name]

    def linear(values):
        weight = x.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - weight) * values[before] + weight * values[row]

    for name in ("linear_momentum", "angular_momentum"):
        found[name] = linear(steps[name])
    found["energy"] = Energy(*(linear(part) for part in vars(steps["energy"]).values()))
    found["slides"] = _slides(model, q, linear(steps["slides"]))
    return found, row


def _slopes(model: Model, steps: dict[str, Any]) -> np.ndarray:
    """Rates (n, n_node, 3) at the ends of steps.

    Those of massless degrees of freedom are means over a step; here they are of second order.
    """
    q, v, t = steps["q"], steps["v"], steps["t"]
    free = model.to_nodes(model.massless)
    if len(t) < 3 or not free.any():
        return v
    v = v.copy()
    v[:, free] = np.gradient(q[:, free], t, axis=0, edge_order=2)
    return v


def _cubic(q, v, row, before, x, dt) -> tuple[np.ndarray, np.ndarray]:
    """Hermite's cubic polynomials and their derivatives, at a fraction x (n,) of a step."""
    x, dt = (values[:, None, None] for values in (x, dt))
    rise = q[row] - q[before]
    start, end = dt * v[before] - rise, rise - dt * v[row]
    bend = (1 - x) * start + x * end
    value = q[before] + x * rise + x * (1 - x) * bend
    rate = rise + (1 - 2 * x) * bend + x * (1 - x) * (end - start)
    return value, rate / dt


def _slides(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Slides (n, joints) of the joints [m] in the configurations q (n, n_node, 3)."""
    q, X = np.concatenate([q, 0 * q[:, :1]], axis=1), np.vstack([model.mesh.X, [0.0, 0.0]])
    slides = slides.copy()
    for joint in model.scene.joints:
        if joint.axis is None:
            continue
        a, b = joint.a.number, joint.b.number  # the ground's is -1

        def apart(q, a=a, b=b):
            x, y = np.moveaxis(X[b] + q[:, b, :2] - X[a] - q[:, a, :2], -1, 0)
            c, s = np.cos(q[:, a, 2]), np.sin(q[:, a, 2])
            return np.stack([c * x + s * y, c * y - s * x], axis=-1)

        moved = apart(q) - apart(0 * q[:1])
        slides[:, joint.number] = joint.start()[0] + moved @ joint.axis
    return slides
