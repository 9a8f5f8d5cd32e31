"""Gaps and slips of points at shapes that are fixed or carried by a node, in UFL."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from fx_beam.symbolic import ufl

from .point_laws import TINY, CoordinateKind, ForceStep, Slip, StepCoordinate, add, arm_length, dot


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

    def __str__(self):
        of_nodes = f", of {self.nodes} nodes" * (self.nodes > 1)
        return of_nodes + ", carried" * bool(self.of_carrier) + ", thick" * self.turns


class _Meeting:
    """A point and a shape over a step, seen from the origin of the shape."""

    def __init__(
        self,
        motion: ForceStep,
        D: Sequence[Any],
        numbers: Sequence[Any],
        pair: _Pair,
        of_shape: int,
    ):
        (x, y), rest = numbers[:2], numbers[2 + of_shape :]
        self.motion, self.pair, self._D = motion, pair, D
        #: Numbers of the shape, half thickness of the member, and weights of the nodes.
        self.numbers, self.half = numbers[2 : 2 + of_shape], rest[0]
        self._weights = rest[1:] or [1]
        #: From the shape to the point at the start and at the level, its increment, and its rate.
        self.r0 = add((x, y), 1.0, self._relative(motion.start))
        self.Dr, self.rates = self._relative(D), self._relative(motion.rates)
        self.r = add(self.r0, motion.rule.level, self.Dr)

    def _relative(self, values: Sequence[Any]) -> list[Any]:
        """From the carrier to the point."""
        n = self.pair.nodes
        points, carrier = [values[2 * a : 2 * a + 2] for a in range(n)], values[2 * n :]
        points = [[N * x for x in x_a] for N, x_a in zip(self._weights, points, strict=True)]
        origin = carrier[:2] if self.pair.of_carrier else (0, 0)
        return [sum(xs) - c for *xs, c in zip(*points, origin, strict=True)]

    def turn(self, values: Sequence[Any] | None = None) -> Any:
        """The increment of the carrier's rotation, or another of its values."""
        return (self._D if values is None else values)[2 * self.pair.nodes + 2]

    def spread(self, force: Sequence[Any], on_carrier: Any, on_point: Any = 0.0) -> list[Any]:
        """A force on the point and two moments, as forces on all entries."""
        of_carrier = [*(-f for f in force), on_carrier][: self.pair.of_carrier]
        moments = [N * on_point for N in self._weights] if self.pair.turns else []
        return [*(N * f for N in self._weights for f in force), *of_carrier, *moments]

    def slip(self, n: Sequence[Any], apart: Any, half: Any) -> Slip:
        """Slip of a member's material against that of the shape, along W n.

        The member touches at a distance `half` from its axis, which is `apart` from the origin of
        the shape in the direction n. The rest of this is the arm of the shape: then the friction
        has no moment in all, and a rotation of both is no slip.
        """
        along, on_shape, motion = _normal_to(n), apart - half, self.motion
        path = dot(along, self.Dr)
        if self.pair.turns:
            rotations = self._D[self.pair.size - self.pair.nodes :]
            for N, Dpsi in zip(self._weights, rotations, strict=True):
                path -= half * N * motion.path(Dpsi)
        if self.pair.of_carrier:
            path -= on_shape * motion.path(self.turn())
        return Slip(path, self.spread(along, -on_shape, -half))


class _ShapeLaw(NamedTuple):
    """A kind of shape: its gap and its slip, and how many numbers it has."""

    numbers: int
    #: Whether it turns with its carrier.
    turns: bool
    gap: Callable[[_Meeting], StepCoordinate]
    slip: Callable[[_Meeting], Slip]


@functools.cache
def gap_of(
    shape: str, nodes: int = 1, carried: bool = False, slips: bool = False, thick: bool = False
) -> CoordinateKind:
    """Gap of a point of so many nodes from a shape.

    Numbers: the place of the point relative to the shape, those of the shape, the half thickness
    of the member, and weights of several nodes.
    """
    law = _LAWS[shape]
    pair = _Pair(nodes, (3 if slips or law.turns else 2) * carried, thick)

    def meeting(motion: ForceStep, D: Sequence[Any], numbers: Sequence[Any]) -> _Meeting:
        return _Meeting(motion, D, numbers, pair, law.numbers)

    return CoordinateKind(
        f"the gap of a {shape.lower()}{pair}",
        pair.size,
        3 + law.numbers + (nodes if nodes > 1 else 0),
        lambda *given: law.gap(meeting(*given)),
        slip=(lambda *given: law.slip(meeting(*given))) if slips else None,
    )


def _circle_gap(at: _Meeting) -> StepCoordinate:
    """The direction is (r0 + r1) / (|r0| + |r1|), which has no moment about the centre.

    Its product with Dr is the change of the gap.
    """
    radius, side = at.numbers
    gap = arm_length(at.motion, at.r0, at.Dr, at.rates, radius + side * at.half, side)
    along = at.spread(gap.along, 0.0)
    return gap._replace(along=along, across=along)


def _circle_slip(at: _Meeting) -> Slip:
    level, arms = at.motion.rule.level, (at.r0, add(at.r0, 1.0, at.Dr), at.r)
    start, end, length = (ufl.sqrt(dot(arm, arm) + TINY) for arm in arms)
    mean = (1 - level) * start + level * end
    slip = at.slip([x / length for x in at.r], length, at.numbers[1] * at.half)
    return slip._replace(normal=length / mean)


def _line_normals(at: _Meeting) -> tuple[Sequence[Any], Sequence[Any], Sequence[Any]]:
    """Normals at both ends of the step, and at the level."""
    normal, motion = at.numbers, at.motion
    if not at.pair.of_carrier:
        return normal, normal, normal
    psi, Dpsi = at.turn(motion.start), at.turn()
    n0, n1 = _turned(normal, psi), _turned(normal, psi + Dpsi)
    if motion.rule.turning:
        return n0, n1, [x / 2 for x in add(n0, 1.0, n1)]
    return n0, n1, _turned(normal, motion.at_level(psi, Dpsi))


def _line_gap(at: _Meeting) -> StepCoordinate:
    """If a node carries the line, the change of n.r is n.Dr + Dtheta (W n).r.

    Dtheta = 2 tan(Dpsi/2), with the means of n and r over the step.
    """
    n0, n1, n = _line_normals(at)
    carried, motion = bool(at.pair.of_carrier), at.motion
    lever = dot(_normal_to(n), at.r) if carried else 0.0
    along = at.spread(n, lever)
    start, change, rate = dot(n0, at.r0) - at.half, dot(n, at.Dr), dot(n0, at.rates)
    if not carried:
        return StepCoordinate(start, start + change, along, along, change, rate)
    end = dot(n1, add(at.r0, 1.0, at.Dr)) - at.half
    rate += at.turn(motion.rates) * dot(_normal_to(n0), at.r0)
    exact = change + motion.path(at.turn()) * lever
    return StepCoordinate(
        start, end, along, along, exact if motion.rule.turning else end - start, rate
    )


def _line_slip(at: _Meeting) -> Slip:
    *_, n = _line_normals(at)
    length = ufl.sqrt(dot(n, n)) if at.pair.of_carrier else 1.0
    n = [x / length for x in n]
    return at.slip(n, dot(n, at.r), at.half)._replace(normal=length)


#: By the names of the shapes.
_LAWS = {
    "Circle": _ShapeLaw(2, False, _circle_gap, _circle_slip),
    "Line": _ShapeLaw(2, True, _line_gap, _line_slip),
}


def _normal_to(a: Sequence[Any]) -> list[Any]:
    """W a: a turned by a right angle, anticlockwise."""
    return [-a[1], a[0]]


def _turned(a: Sequence[Any], angle: Any) -> list[Any]:
    c, s = ufl.cos(angle), ufl.sin(angle)
    return [c * a[0] - s * a[1], s * a[0] + c * a[1]]
