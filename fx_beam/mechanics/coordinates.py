"""Coordinates on which forces act: gaps of nodes, angles and slides of joints, in UFL."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import ufl

from .point_laws import TINY, Coordinate, Motion


class Kind(NamedTuple):
    """A kind of coordinate: its number of entries and of numbers, and the coordinate."""

    name: str
    size: int
    numbers: int
    #: From the motion, increments and numbers.
    of: Callable[[Motion, Sequence[Any], Sequence[Any]], Coordinate]
    #: Whether it is zero where all that it is given is zero, and regular there.
    starts_at_zero: bool = False


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


class _Apart(NamedTuple):
    """A point x = sum N_a x_a of nodes, relative to what carries a shape or to the ground."""

    start: Sequence[Any]
    change: Sequence[Any]
    rate: Sequence[Any]
    #: Rotation of the carrier: its start, increment and rate.
    turn: Sequence[Any]
    #: A force on the point and a moment on the carrier, as forces on all entries.
    spread: Callable[[Sequence[Any], Any], list[Any]]


def _apart(
    motion: Motion, D: Sequence[Any], place: Sequence[Any], weights: Sequence[Any]
) -> _Apart:
    """The place of a point over a step; `place` is that in the reference."""
    n = len(weights) or 1

    def relative(values: Sequence[Any]) -> list[Any]:
        points, carrier = [values[2 * a : 2 * a + 2] for a in range(n)], values[2 * n :]
        if weights:
            points = [[N * x for x in point] for N, point in zip(weights, points, strict=True)]
        return [sum(xs) - c for *xs, c in zip(*points, carrier[:2] or (0, 0), strict=True)]

    def spread(force: Sequence[Any], moment: Any) -> list[Any]:
        on_point = [N * f for N in weights for f in force] if weights else list(force)
        on_carrier = [*(-f for f in force), moment][: motion.size - 2 * n]
        return [*on_point, *on_carrier]

    start = [x + q for x, q in zip(place, relative(motion.start), strict=True)]
    turn = [values[2 * n + 2 :] for values in (motion.start, D, motion.rates)]
    return _Apart(
        start, relative(D), relative(motion.rates), [x for of in turn for x in of], spread
    )


@functools.cache
def line_gap(nodes: int = 1, carried: bool = False) -> Kind:
    """Gap of a point of so many nodes from a line, fixed or carried by a node.

    Entries are x and y of each node of the point, then x, y and rotation of the carrier. Numbers:
    the place of the point relative to the line, the normal, and weights of several nodes; if it is
    carried also the half thickness of the member, behind the normal.
    """
    more = int(carried)

    def of(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
        place, normal, weights = numbers[:2], numbers[2:4], numbers[4 + more :]
        apart = _apart(motion, D, place, weights)
        if carried:
            return _from_turning_line(motion, apart, normal, numbers[4])
        start, change = _dot(normal, apart.start), _dot(normal, apart.change)
        along = apart.spread(normal, 0.0)
        return Coordinate(start, start + change, along, along, change, _dot(normal, apart.rate))

    name = "the gap of a line" + _variant(nodes, carried)
    return Kind(name, 2 * nodes + 3 * carried, 4 + more + _count(nodes), of)


def _from_turning_line(
    motion: Motion, apart: _Apart, normal: Sequence[Any], rest: Any
) -> Coordinate:
    """The product of an arm with a normal that turns, minus a rest.

    With Dtheta = 2 tan(Dpsi/2) its change is n.Dr + Dtheta (W n).r, with the means of n and r.
    """
    psi, Dpsi, spin = apart.turn
    n0, n1 = _turned(normal, psi), _turned(normal, psi + Dpsi)
    r0, Dr = apart.start, apart.change
    r1 = _sum(r0, Dr)
    if motion.rule.turning:
        n, r = ([(x + y) / 2 for x, y in zip(*ends, strict=True)] for ends in ((n0, n1), (r0, r1)))
    else:
        n = _turned(normal, motion.at_level(psi, Dpsi))
        r = [motion.at_level(x, d) for x, d in zip(r0, Dr, strict=True)]
    lever = _dot(_normal_to(n), r)
    along = apart.spread(n, lever)
    start, end = _dot(n0, r0) - rest, _dot(n1, r1) - rest
    rate = _dot(n0, apart.rate) + spin * _dot(_normal_to(n0), r0)
    change = _dot(n, Dr) + motion.path(Dpsi) * lever if motion.rule.turning else end - start
    return Coordinate(start, end, along, along, change, rate)


@functools.cache
def circle_gap(nodes: int = 1, carried: bool = False) -> Kind:
    """Gap of a point of so many nodes from a circle, fixed or carried by a node.

    Entries are x and y of each node of the point, then of the carrier. Numbers: the place of the
    point relative to the centre, radius, side, and weights of several nodes.

    The direction is (r0 + r1) / (|r0| + |r1|): its product with Dr is the change of the gap, and it
    has no moment about the centre.
    """

    def of(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
        place, (radius, side), weights = numbers[:2], numbers[2:4], numbers[4:]
        apart = _apart(motion, D, place, weights)
        gap = _distance(motion, apart.start, apart.change, apart.rate, radius, side)
        along = apart.spread(gap.along, 0.0)
        return gap._replace(along=along, across=along)

    name = "the gap of a circle" + _variant(nodes, carried)
    return Kind(name, 2 * nodes + 2 * carried, 4 + _count(nodes), of)


def _count(nodes: int) -> int:
    """Number of weights of a point of so many nodes."""
    return nodes if nodes > 1 else 0


def _variant(nodes: int, carried: bool) -> str:
    return f", of {nodes} nodes" * (nodes > 1) + ", carried" * carried


def _distance(motion: Motion, r0, Dr, rates, rest: Any, side: Any) -> Coordinate:
    """The length of an arm, from a rest, times a side."""
    level, r1 = motion.rule.level, [x + d for x, d in zip(r0, Dr, strict=True)]
    size0, size1 = (ufl.sqrt(_dot(r, r) + TINY) for r in (r0, r1))
    mean = (1 - level) * size0 + level * size1
    along = [side * ((1 - level) * x + level * y) / mean for x, y in zip(r0, r1, strict=True)]
    start, end = side * (size0 - rest), side * (size1 - rest)
    rate = side * _dot(r0, rates) / size0
    return Coordinate(start, end, along, along, end - start, rate)


def _between_nodes(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """Distance of two nodes; numbers: that from the first to the second in the reference."""
    a, b, Da, Db, va, vb = (x[i : i + 2] for x in (motion.start, D, motion.rates) for i in (0, 2))
    r0 = [x + q - p for x, p, q in zip(numbers, a, b, strict=True)]
    Dr, rates = (
        [after - before for before, after in zip(of_a, of_b, strict=True)]
        for of_a, of_b in ((Da, Db), (va, vb))
    )
    distance = _distance(motion, r0, Dr, rates, 0.0, 1.0)
    along = [*(-x for x in distance.along), *distance.along]
    return distance._replace(along=along, across=along)


def _from_point(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """Distance of a node from a fixed point; numbers: from the point to the node."""
    r0 = [x + q for x, q in zip(numbers, motion.start, strict=True)]
    return _distance(motion, r0, D, motion.rates, 0.0, 1.0)


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1]


def _sum(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _normal_to(a: Sequence[Any]) -> list[Any]:
    """W a: a turned by a right angle, anticlockwise."""
    return [-a[1], a[0]]


def _turned(a: Sequence[Any], angle: Any) -> list[Any]:
    c, s = ufl.cos(angle), ufl.sin(angle)
    return [c * a[0] - s * a[1], s * a[0] + c * a[1]]


SLIDE = Kind("a slide", 1, 0, _slide, starts_at_zero=True)
LINE, CIRCLE = line_gap(), circle_gap()
ANGLE = Kind("an angle", 2, 0, _angle, starts_at_zero=True)
DISTANCE = Kind("a distance", 4, 2, _between_nodes)
FROM_POINT = Kind("a distance from a point", 2, 2, _from_point)
