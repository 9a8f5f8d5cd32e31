"""A member as a curve: distances of points from it, and the nearest points on it.

It is the quadratic spline of its nodes, as in step/c/member_curve.h.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
        found = _on_pieces(points, nodes, node)
        distance = np.hypot(*(found - points).T)
        if arc is not None:
            distance[abs(arc - arc[node]) < apart] = np.inf
        closer = distance < best.distance
        best = Nearest(
            np.where(closer, distance, best.distance),
            np.where(closer, node, best.node),
            np.where(closer[:, None], found, best.point),
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
