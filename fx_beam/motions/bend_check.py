"""Check of members that touch: none may bend more sharply than it is thick, where it is touched."""

from __future__ import annotations

import logging

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.loads import label
from fx_beam.scene.member_contact import arc_of, nearest
from fx_beam.scene.obstacles import Obstacle

_log = logging.getLogger("fx_beam")
# Both half thicknesses, relative to the radius of curvature, from which bends are sharp.
_SHARP = 0.95
# Nodes of all rows that are looked at together.
_AT_ONCE = 200_000


def warn_of_sharp_bends(solution: Solution, motion: bool = False) -> None:
    """Warn of the first row in which a member is touched inside a bend sharper than its thickness.

    A contact may begin or end at a depth there: the energy jumps, or a step fails.
    """
    name, row = ("simulate", "t =") if motion else ("static", "load factor")
    for obstacle in solution.obstacles:
        a, b = obstacle.target, obstacle.shape
        if not isinstance(b, Beam):
            continue
        pairs = [(a, b)] if a is b or not isinstance(a, Beam) else [(a, b), (b, a)]
        found = [_first_inside(solution, obstacle, *pair) for pair in pairs]
        first = min((f for f in found if f is not None), key=lambda f: f[0], default=None)
        if first is None:
            continue
        k, (x, y), radius, member = first
        _log.warning(
            "%s: %s: at %s %.6g %s has the radius of curvature %.3g at (%.4g, %.4g), where it is "
            "touched inside its bend; both half thicknesses are %.3g. The energy may jump there, "
            "which energy.balance_error shows, and steps may fail. Raise the stiffness of the "
            "contact or of the member in bending, or give a smaller radius",
            *(name, obstacle, row, solution.t[k], label(member), radius, x, y, obstacle.radii),
        )


def _first_inside(
    solution: Solution, obstacle: Obstacle, touching: Beam | Node, member: Beam
) -> tuple[int, np.ndarray, float, Beam] | None:
    """Row, place and radius of curvature of the first such touch of a member."""
    X, q = solution.X[:, :2], solution.recorded("q")
    own = solution.nodes_of_beam[member.name]
    points = own
    if isinstance(touching, Node):
        points = np.array([touching.number])
    elif touching is not member:
        points = solution.nodes_of_beam[touching.name]
    arc = arc_of(X[own]) if touching is member else None
    rows = max(1, _AT_ONCE // len(own))
    for first in range(0, len(q), rows):
        places = X + q[first : first + rows, :, :2]
        curvature = _curvature(places[:, own])
        sharp = abs(curvature) * obstacle.radii > _SHARP
        for k in np.flatnonzero(sharp.any(axis=1)):
            at = places[k]
            found = nearest(at[points], at[own], obstacle.apart, arc)
            tangent = np.gradient(at[own], axis=0)[found.node]
            arms = at[points] - found.point
            side = tangent[:, 0] * arms[:, 1] - tangent[:, 1] * arms[:, 0]
            inside = side * curvature[k][found.node] > 0
            bad = sharp[k][found.node] & inside & (found.distance < obstacle.radii)
            if bad.any():
                i = int(np.argmax(bad))
                radius = 1 / abs(curvature[k][found.node[i]])
                return first + int(k), found.point[i], float(radius), member
    return None


def _curvature(nodes: np.ndarray) -> np.ndarray:
    """Curvature (rows, n) of a member's curve at its nodes (rows, n, 2), positive to the left."""
    kappa = np.zeros(nodes.shape[:2])
    slope = (nodes[:, 2:] - nodes[:, :-2]) / 2
    bend = nodes[:, 2:] - 2 * nodes[:, 1:-1] + nodes[:, :-2]
    turn = slope[..., 0] * bend[..., 1] - slope[..., 1] * bend[..., 0]
    kappa[:, 1:-1] = turn / np.maximum((slope**2).sum(axis=-1), 1e-300) ** 1.5
    return kappa
