"""Directions of slides in pictures."""

from __future__ import annotations

from typing import Any

import numpy as np


def slide_direction(drawing: Any, joint: Any, k: int) -> np.ndarray:
    """Unit vector (2,) of a slide in row k; on a beam that of the nodes beside the sliding node."""
    if joint.axis is not None:
        return drawing.turned(joint.a, k, joint.axis)
    positions = drawing.positions(drawing.solution.nodes_of_beam[joint.beam.name], k)
    nearest = int(np.argmin(np.hypot(*(positions - drawing.positions(joint.b.number, k)).T)))
    ahead, behind = min(nearest + 1, len(positions) - 1), max(nearest - 1, 0)
    along = positions[ahead] - positions[behind]
    return along / np.hypot(*along)
