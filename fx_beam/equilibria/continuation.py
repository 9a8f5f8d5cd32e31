"""Curves of solutions: steps along their tangents, and the places of events in a step.

Paths of equilibria and families of periodic motions are such curves; each has its own equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import numpy as np
from numpy.polynomial import Polynomial

Point = TypeVar("Point")


def follow(
    point: Point,
    length: float,
    advance: Callable[[Point, float], tuple[Point, float]],
    shorter: Callable[[Point, float, Exception], float],
    failures: tuple[type[Exception], ...],
) -> Iterator[Point]:
    """Points of a curve behind the first one.

    `advance` takes a step of a length, and gives the point at its end and the length of the next
    one. If it fails, `shorter` gives the length with which it is taken again, or raises.
    """
    while True:
        try:
            point, length = advance(point, length)
        except failures as failure:
            length = shorter(point, length, failure)
            continue
        yield point


class Stretch(Generic[Point]):
    """Points of a curve by their distances along a tangent; each is computed once."""

    def __init__(self, take: Callable[[float], Point], points: dict[float, Point]):
        self._take, self.points = take, points

    def point_at(self, distance: float) -> Point:
        """The point at a distance."""
        if distance not in self.points:
            self.points[distance] = self._take(distance)
        return self.points[distance]


def root_between(
    measure: Callable[[float], float], low: float, high: float, tolerance: float
) -> float:
    """Where a measure changes its sign; ValueError if it has the same one at both ends."""
    # Imported here: most curves have no event, and the import takes time.
    from scipy.optimize import brentq

    return float(brentq(measure, low, high, xtol=tolerance))


@np.errstate(divide="ignore", invalid="ignore")
def root_near(places: np.ndarray, values: np.ndarray) -> float:
    """Root near zero of the polynomial through values at places; not finite if it has none."""
    polynomial = Polynomial(np.linalg.solve(np.vander(places, increasing=True), values))
    slope, root = polynomial.deriv(), 0.0
    for _ in range(20):
        root -= float(polynomial(root) / slope(root))
    return root
