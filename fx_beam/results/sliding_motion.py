"""Motion of nodes that slide on beams, relative to these beams."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.scene.sliders import SlidingJoint


def gap(solution: Any, joint: SlidingJoint, slides: np.ndarray) -> np.ndarray:
    """Distance (n,) of the node from its place on the beam [m]."""
    q = solution.recorded("q")
    place = joint.path.over(_nodes(solution, joint, q)[..., :2] + joint.path.X, slides)
    b = joint.b.number
    return np.hypot(*(place - solution.X[b] - q[:, b, :2]).T)


def angle(solution: Any, joint: SlidingJoint, slides: np.ndarray) -> np.ndarray:
    """Rotation (n,) of the node relative to the beam where it is, since the start [rad]."""
    q = solution.recorded("q")
    return q[:, joint.b.number, 2] - joint.turn(_nodes(solution, joint, q)[..., 2], slides)


def spin(solution: Any, joint: SlidingJoint, slides: np.ndarray) -> np.ndarray:
    """Rate (n,) of the angle [rad/s]."""
    q, v, path = solution.recorded("q"), solution.recorded("v"), joint.path
    turning = path.over(_nodes(solution, joint, v)[..., 2], slides)
    bend = path.over(_nodes(solution, joint, q)[..., 2] + path.angles(), slides, 1)
    return v[:, joint.b.number, 2] - turning - bend * rate(solution, joint, slides)


def rate(solution: Any, joint: SlidingJoint, slides: np.ndarray) -> np.ndarray:
    """Rate (n,) of the arc length [m/s], from the velocities of node and beam."""
    q, v, path = solution.recorded("q"), solution.recorded("v"), joint.path
    along = path.over(_nodes(solution, joint, q)[..., :2] + path.X, slides, 1)
    apart = v[:, joint.b.number, :2] - path.over(_nodes(solution, joint, v)[..., :2], slides)
    return np.sum(apart * along, axis=1) / np.sum(along**2, axis=1)


def _nodes(solution: Any, joint: SlidingJoint, values: np.ndarray) -> np.ndarray:
    """Values (n, nodes, 3) at the nodes of the beam."""
    return values[:, solution.nodes_of_beam[joint.beam.name]]
