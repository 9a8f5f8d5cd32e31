"""Contact of a node or member with a member, or of a member with itself, as it is checked."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import shown

from .beam import Beam, Node
from .loads import label
from .member_curve import may_be_nearer, nearest
from .obstacles import Obstacle, start_of


def check_members(made: Obstacle, size: float) -> None:
    """SceneError if members of a scene of this size [m] touch at the start, or cannot."""
    a, b = made.target, made.shape
    assert isinstance(b, Beam)
    if isinstance(a, Node) and a in b.nodes:
        raise SceneError(f"{made}: the node belongs to the member. Give a node of another one")
    if made.along is not None:
        raise SceneError(
            f"{made}: along = {shown(made.along)}, but members touch at their nodes. Leave it out, "
            "and give the beams more elements"
        )
    pairs = [(a, b)] if a is b or not isinstance(a, Beam) else [(a, b), (b, a)]
    for touching, member in pairs:
        points, nodes = start_of(touching), start_of(member)
        arc = arc_of(nodes) if touching is member else None
        if arc is None:
            points = points[may_be_nearer(points, nodes, made.radii)]
            if not len(points):
                continue
        found = nearest(points, nodes, made.apart, arc)
        gaps = found.distance - made.radii
        deepest = int(np.argmin(gaps))
        if gaps[deepest] < -1e-9 * size:
            x, y = points[deepest]
            other = "itself" if touching is member else label(member)
            raise SceneError(
                f"{made}: the members overlap at the start: at ({x:.6g}, {y:.6g}) "
                f"{label(touching)} lies {-gaps[deepest]:.4g} deep in {other}. Move one of them, "
                "or give a smaller radius. Members that are joined overlap at their joint"
            )


def arc_of(nodes: np.ndarray) -> np.ndarray:
    """Places (n,) of nodes (n, 2) along a member, by straight pieces."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(nodes, axis=0).T))])
