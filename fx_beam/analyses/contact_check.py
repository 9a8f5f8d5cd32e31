"""Check of equilibria in contact: no point may lie deep in a circle, or have gone through it."""

from __future__ import annotations

import logging

import numpy as np

from fx_beam.results.contact import Contact
from fx_beam.results.solution import Solution
from fx_beam.scene.obstacles import Circle

_log = logging.getLogger("fx_beam")
# Depth in a circle, relative to its radius, from which its force says little.
_DEEP = 0.5


def warn_of_depth(solution: Solution) -> None:
    """Warn of the first load step in which a point comes deep into a circle, or goes through it."""
    for obstacle in solution.obstacles:
        shape = obstacle.shape
        if not isinstance(shape, Circle) or shape.inside:
            continue
        contact = Contact(solution, obstacle)
        centre = np.broadcast_to(shape.origin, (len(solution.t), 2))
        if shape.carrier is not None:
            centre = solution.position(shape.carrier)
        arms = contact.points - centre[:, None]
        deep = contact.gap < -_DEEP * shape.radius
        through = np.zeros_like(deep)
        through[1:] = _least_distances(arms[:-1], arms[1:]) < _DEEP * shape.radius
        rows, points = np.nonzero(deep | through)
        if not len(rows):
            continue
        k, i = rows[0], points[0]
        x, y = contact.points[k, i]
        _log.warning(
            "static: %s: at load factor %.6g the point at (%.4g, %.4g) %s. The equilibria from "
            "there on are not those of bodies in contact. Raise the stiffness of the contact, take "
            "more steps, or hold what moves away more firmly",
            obstacle,
            solution.t[k],
            x,
            y,
            f"lies {-contact.gap[k, i]:.3g} deep in the circle, which has the radius "
            f"{shape.radius:.3g}"
            if deep[k, i]
            else "has gone through the circle in one step",
        )


def _least_distances(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Distances (n, m) from the origin of the straight ways between arms (n, m, 2)."""
    way = last - first
    square = np.maximum((way**2).sum(axis=-1), 1e-300)
    part = np.clip(-(first * way).sum(axis=-1) / square, 0.0, 1.0)
    return np.linalg.norm(first + part[..., None] * way, axis=-1)
