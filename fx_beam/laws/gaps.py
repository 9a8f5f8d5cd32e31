"""Gaps and slips of points at lines and circles that are fixed or carried by a node, in UFL."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import ufl

from .coordinates import Kind, Slip, arm_length, dot
from .point_laws import Coordinate, Motion


class _Pair(NamedTuple):
    """Who meets: a point x = sum N_a x_a of some nodes, and a shape that a node may carry.

    Entries are x and y of each node of the point, those of the carrier and its rotation if it
    matters, and in friction the rotations of the nodes of a thick member.
    """

    nodes: int
    of_carrier: int
    turns: bool

    @property
    def size(self) -> int:
        return 2 * self.nodes + self.of_carrier + self.nodes * self.turns

    @property
    def weights(self) -> int:
        """Number of weights."""
        return self.nodes if self.nodes > 1 else 0

    def relative(self, values: Sequence[Any], weights: Sequence[Any]) -> list[Any]:
        """From the carrier to the point."""
        n = self.nodes
        points, carrier = [values[2 * a : 2 * a + 2] for a in range(n)], values[2 * n :]
        points = [[N * x for x in x_a] for N, x_a in zip(weights or [1], points, strict=True)]
        origin = carrier[:2] if self.of_carrier else (0, 0)
        return [sum(xs) - c for *xs, c in zip(*points, origin, strict=True)]

    def turn(self, values: Sequence[Any]) -> Any:
        """The rotation of the carrier."""
        return values[2 * self.nodes + 2]

    def rotations(self, values: Sequence[Any]) -> Sequence[Any]:
        """Those of the nodes of the point."""
        return values[self.size - self.nodes :] if self.turns else []

    def spread(
        self, force: Sequence[Any], on_carrier: Any, weights: Sequence[Any], on_point: Any = 0.0
    ) -> list[Any]:
        """A force on the point and two moments, as forces on all entries."""
        of_carrier = [*(-f for f in force), on_carrier][: self.of_carrier]
        weights = weights or [1]
        moments = [N * on_point for N in weights] if self.turns else []
        return [*(N * f for N in weights for f in force), *of_carrier, *moments]

    def __str__(self):
        of_nodes = f", of {self.nodes} nodes" * (self.nodes > 1)
        return of_nodes + ", carried" * bool(self.of_carrier) + ", thick" * self.turns


@functools.cache
def circle_gap(
    nodes: int = 1, carried: bool = False, slips: bool = False, thick: bool = False
) -> Kind:
    """Gap of a point of so many nodes from a circle.

    Numbers: the place of the point relative to the centre, radius with the half thickness of the
    member, side, if it `slips` the half thickness, and weights of several nodes.

    The direction is (r0 + r1) / (|r0| + |r1|): its product with Dr is the change of the gap, and it
    has no moment about the centre.
    """
    pair = _Pair(nodes, (3 if slips else 2) * carried, thick)

    def of(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
        (*place, radius, side), weights = numbers[:4], numbers[4 + slips :]
        r0 = _sum(place, pair.relative(motion.start, weights))
        Dr, rate = (pair.relative(values, weights) for values in (D, motion.rates))
        gap = arm_length(motion, r0, Dr, rate, radius, side)
        along = pair.spread(gap.along, 0.0, weights)
        return gap._replace(along=along, across=along)

    def slip(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Slip:
        (*place, _, side, half), weights = numbers[:5], numbers[5:]
        r0 = _sum(place, pair.relative(motion.start, weights))
        r = _at_level(motion, r0, pair.relative(D, weights))
        length, level = ufl.sqrt(dot(r, r)), motion.rule.level
        r1 = _sum(r0, pair.relative(D, weights))
        mean = (1 - level) * ufl.sqrt(dot(r0, r0)) + level * ufl.sqrt(dot(r1, r1))
        slip = _slip(motion, D, pair, weights, [x / length for x in r], length, side * half)
        return slip._replace(normal=length / mean)

    name = f"the gap of a circle{pair}"
    return Kind(name, pair.size, 4 + slips + pair.weights, of, slip=slip if slips else None)


@functools.cache
def line_gap(
    nodes: int = 1, carried: bool = False, slips: bool = False, thick: bool = False
) -> Kind:
    """Gap of a point of so many nodes from a line.

    Numbers: the place of the point relative to the line, the normal, if the line is carried or the
    point `slips` the half thickness of the member, and weights of several nodes.

    If a node carries the line, with Dtheta = 2 tan(Dpsi/2), the change of n.r is
    n.Dr + Dtheta (W n).r, with the means of n and r over the step.
    """
    pair, more = _Pair(nodes, 3 * carried, thick), int(carried or slips)

    def ends(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> tuple[Any, ...]:
        """Arm and its increment; normals at both ends; arm and normal at the level; weights."""
        place, normal, weights = numbers[:2], numbers[2:4], numbers[4 + more :]
        r0, Dr = _sum(place, pair.relative(motion.start, weights)), pair.relative(D, weights)
        r = _at_level(motion, r0, Dr)
        if not carried:
            return r0, Dr, normal, normal, r, normal, weights
        psi, Dpsi = pair.turn(motion.start), pair.turn(D)
        n0, n1 = _turned(normal, psi), _turned(normal, psi + Dpsi)
        if motion.rule.turning:
            return r0, Dr, n0, n1, r, [(x + y) / 2 for x, y in zip(n0, n1, strict=True)], weights
        return r0, Dr, n0, n1, r, _turned(normal, motion.at_level(psi, Dpsi)), weights

    def of(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
        r0, Dr, n0, n1, r, n, weights = ends(motion, D, numbers)
        half, rates = numbers[4] if more else 0, pair.relative(motion.rates, weights)
        lever = dot(_normal_to(n), r) if carried else 0.0
        along = pair.spread(n, lever, weights)
        start, end = dot(n0, r0) - half, dot(n1, _sum(r0, Dr)) - half
        change, rate = dot(n, Dr), dot(n0, rates)
        if not carried:
            return Coordinate(start, start + change, along, along, change, rate)
        rate += pair.turn(motion.rates) * dot(_normal_to(n0), r0)
        exact = change + motion.path(pair.turn(D)) * lever
        return Coordinate(
            start, end, along, along, exact if motion.rule.turning else end - start, rate
        )

    def slip(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Slip:
        *_, r, n, weights = ends(motion, D, numbers)
        length = ufl.sqrt(dot(n, n)) if carried else 1.0
        n = [x / length for x in n]
        slip = _slip(motion, D, pair, weights, n, dot(n, r), numbers[4])
        return slip._replace(normal=length)

    name = f"the gap of a line{pair}"
    return Kind(name, pair.size, 4 + more + pair.weights, of, slip=slip if slips else None)


def _slip(
    motion: Motion,
    D: Sequence[Any],
    pair: _Pair,
    weights: Sequence[Any],
    n: Sequence[Any],
    apart: Any,
    half: Any,
) -> Slip:
    """Slip of a member's material against that of the shape, along W n.

    The member touches at a distance `half` from its axis, which is `apart` from the origin of the
    shape in the direction n. The rest of this is the arm of the shape: then the friction has no
    moment in all, and a rotation of both is no slip.
    """
    along, on_shape = _normal_to(n), apart - half
    path = dot(along, pair.relative(D, weights))
    for N, Dpsi in zip(weights or [1], pair.rotations(D), strict=False):
        path -= half * N * motion.path(Dpsi)
    if pair.of_carrier:
        path -= on_shape * motion.path(pair.turn(D))
    return Slip(path, pair.spread(along, -on_shape, weights, -half))


def _at_level(motion: Motion, start: Sequence[Any], change: Sequence[Any]) -> list[Any]:
    return [motion.at_level(x, d) for x, d in zip(start, change, strict=True)]


def _sum(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _normal_to(a: Sequence[Any]) -> list[Any]:
    """W a: a turned by a right angle, anticlockwise."""
    return [-a[1], a[0]]


def _turned(a: Sequence[Any], angle: Any) -> list[Any]:
    c, s = ufl.cos(angle), ufl.sin(angle)
    return [c * a[0] - s * a[1], s * a[0] + c * a[1]]


LINE, CIRCLE = line_gap(), circle_gap()
