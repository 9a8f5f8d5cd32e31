"""Coordinates on which forces act: distances of nodes, angles and slides of joints, in UFL."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import ufl

from .point_laws import TINY, Coordinate, Motion


class Slip(NamedTuple):
    """How far a point slips along the material that it touches, over a step."""

    path: Any
    #: Directions (size,) of the friction, whose product with the increments of work is the path.
    along: Sequence[Any]
    #: Length of the direction of the normal force on the point, relative to that of the friction.
    normal: Any = 1.0


class Kind(NamedTuple):
    """A kind of coordinate: its number of entries and of numbers, and the coordinate."""

    name: str
    size: int
    numbers: int
    #: From the motion, increments and numbers.
    of: Callable[[Motion, Sequence[Any], Sequence[Any]], Coordinate]
    #: Whether it is zero where all that it is given is zero, and regular there.
    starts_at_zero: bool = False
    #: In contact with friction the slip, of the same.
    slip: Callable[[Motion, Sequence[Any], Sequence[Any]], Slip] | None = None


def _slide(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    start, one = motion.start[0], [ufl.as_ufl(1.0)]
    return Coordinate(start, start + D[0], one, one, D[0], motion.rates[0])


def _angle(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """The rotation of the second node minus that of the first.

    A moment with a potential is multiplied by (Dpsi_b - Dpsi_a) / (Dtheta_b - Dtheta_a), so that
    its work on Dtheta is the increment of the potential.
    """
    (a, b), (Da, Db) = motion.start, D
    start, path, ratio = b - a, Db - Da, ufl.as_ufl(1.0)
    if motion.rule.turning:
        by_a, by_b = motion.path(Da), motion.path(Db)
        path = by_b - by_a
        # For small differences the same with cosines, as 1 / cos^2 = 1 + tan^2.
        x = (Db - Da) / 2
        near = ufl.lt(x * x, 4e-4)
        secants = ufl.sqrt((1 + 0.25 * by_a * by_a) * (1 + 0.25 * by_b * by_b))
        above = ufl.conditional(near, _x_over_sin(x), 2 * x)
        ratio = above / ufl.conditional(near, secants, path)
    sides = [ufl.as_ufl(-1.0), ufl.as_ufl(1.0)]
    rate = motion.rates[1] - motion.rates[0]
    return Coordinate(start, start + (Db - Da), [-ratio, ratio], sides, path, rate)


def _x_over_sin(x: Any) -> Any:
    """x / sin(x) for x below 0.02, by a series that is exact to round-off."""
    x2 = x * x
    return 1 + (1 / 6) * x2 * (1 + (7 / 60) * x2 * (1 + (31 / 294) * x2))


def arm_length(motion: Motion, r0, Dr, rates, rest: Any, side: Any) -> Coordinate:
    """The length of an arm, from a rest, times a side."""
    level, r1 = motion.rule.level, [x + d for x, d in zip(r0, Dr, strict=True)]
    size0, size1 = (ufl.sqrt(dot(r, r) + TINY) for r in (r0, r1))
    mean = (1 - level) * size0 + level * size1
    along = [side * ((1 - level) * x + level * y) / mean for x, y in zip(r0, r1, strict=True)]
    start, end = side * (size0 - rest), side * (size1 - rest)
    rate = side * dot(r0, rates) / size0
    return Coordinate(start, end, along, along, end - start, rate)


def _between_nodes(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """Distance of two nodes; numbers: that from the first to the second in the reference."""
    a, b, Da, Db, va, vb = (x[i : i + 2] for x in (motion.start, D, motion.rates) for i in (0, 2))
    r0 = [x + q - p for x, p, q in zip(numbers, a, b, strict=True)]
    Dr, rates = (
        [after - before for before, after in zip(of_a, of_b, strict=True)]
        for of_a, of_b in ((Da, Db), (va, vb))
    )
    distance = arm_length(motion, r0, Dr, rates, 0.0, 1.0)
    along = [*(-x for x in distance.along), *distance.along]
    return distance._replace(along=along, across=along)


def _from_point(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """Distance of a node from a fixed point; numbers: from the point to the node."""
    r0 = [x + q for x, q in zip(numbers, motion.start, strict=True)]
    return arm_length(motion, r0, D, motion.rates, 0.0, 1.0)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """The product of two vectors in the plane."""
    return a[0] * b[0] + a[1] * b[1]


SLIDE = Kind("a slide", 1, 0, _slide, starts_at_zero=True)
ANGLE = Kind("an angle", 2, 0, _angle, starts_at_zero=True)
DISTANCE = Kind("a distance", 4, 2, _between_nodes)
FROM_POINT = Kind("a distance from a point", 2, 2, _from_point)
