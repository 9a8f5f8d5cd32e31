"""Contact of a node or member with a member, or of a member with itself, as it is checked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import shown

from .beam import Beam, Node
from .loads import label
from .obstacles import Obstacle, start_of

# Iterations for the nearest point of a piece, and pieces on each side of the nearest node.
_ITERATIONS, _ABOUT = 26, 1


class Nearest(NamedTuple):
    """Of points (m,): distances, nodes about which the nearest points lie, and these (m, 2)."""

    distance: np.ndarray
    node: np.ndarray
    point: np.ndarray


def may_be_nearer(points: np.ndarray, nodes: np.ndarray, distance: float) -> np.ndarray:
    """Which points (m,) may be nearer to a member with nodes (n, 2) than a distance [m].

    A piece lies within half an arm of its node.
    """
    arm = np.hypot(*np.diff(nodes, axis=0).T).max()
    square = ((points[:, None] - nodes) ** 2).sum(axis=-1).min(axis=1)
    return square < (distance + arm / 2) ** 2


def nearest(
    points: np.ndarray, nodes: np.ndarray, apart: float = 0.0, arc: np.ndarray | None = None
) -> Nearest:
    """The nearest points of a member with nodes (n, 2) to points (m, 2).

    If these are its own nodes, with places `arc` (n,) along it, parts that are less than `apart`
    away along the member are left out.
    """
    square = ((points[:, None] - nodes) ** 2).sum(axis=-1)
    if arc is not None:
        square[abs(arc[:, None] - arc) < apart] = np.inf
    first = np.argmin(square, axis=1)
    best = Nearest(np.full(len(points), np.inf), first, np.full((len(points), 2), np.nan))
    for step in range(-_ABOUT, _ABOUT + 1):
        node = np.clip(first + step, 0, len(nodes) - 1)
        on_piece = _on_pieces(points, nodes, node)
        distance = np.hypot(*(on_piece - points).T)
        if arc is not None:
            distance[abs(arc - arc[node]) < apart] = np.inf
        closer = distance < best.distance
        best = Nearest(
            np.where(closer, distance, best.distance),
            np.where(closer, node, best.node),
            np.where(closer[:, None], on_piece, best.point),
        )
    return best


def _on_pieces(points: np.ndarray, nodes: np.ndarray, node: np.ndarray) -> np.ndarray:
    """Nearest points (m, 2) of the pieces about some nodes (m,)."""
    last = len(nodes) - 1
    middle, begins, ends = nodes[node], node == 0, node == last
    before, after = nodes[np.maximum(node - 1, 0)], nodes[np.minimum(node + 1, last)]
    before = np.where(begins[:, None], 2 * middle - after, before)
    after = np.where(ends[:, None], 2 * middle - before, after)
    bend, slope = (before - 2 * middle + after) / 2, (after - before) / 2
    value = middle + bend / 4 - points
    low, high = np.where(begins, 0.0, -0.5), np.where(ends, 0.0, 0.5)
    for _ in range(_ITERATIONS):  # bisection: the derivative of the distance has one zero
        x = (low + high) / 2
        at = value + x[:, None] * (slope + x[:, None] * bend)
        rises = (at * (slope + 2 * x[:, None] * bend)).sum(axis=1) > 0
        low, high = np.where(rises, low, x), np.where(rises, x, high)
    x = ((low + high) / 2)[:, None]
    return points + value + x * (slope + x * bend)


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
        closest = nearest(points, nodes, made.apart, arc)
        gaps = closest.distance - made.radii
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
