"""Gaps and slips of points at shapes that are fixed or carried by a node, in UFL."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from fx_beam.symbolic import Expr, ufl

from .point_laws import TINY, CoordinateKind, ForceStep, Slip, StepCoordinate, add, arm_length, dot


class _Pair(NamedTuple):
    """Who meets: a point x = sum N_a x_a of some nodes, and a shape that a node may carry.

    Entries: x and y of each node of the point; x, y (and rotation, if it matters) of the carrier;
    with friction the rotations of the nodes of a thick member.
    """

    nodes: int
    carrier_size: int
    turns: bool

    @property
    def size(self) -> int:
        return 2 * self.nodes + self.carrier_size + self.nodes * self.turns

    def __str__(self):
        points = f", of {self.nodes} nodes" * (self.nodes > 1)
        return points + ", carried" * bool(self.carrier_size) + ", thick" * self.turns


class _Meeting:
    """A point and a shape over a step, seen from the origin of the shape."""

    def __init__(
        self,
        motion: ForceStep,
        D: Sequence[Expr],
        numbers: Sequence[Expr],
        pair: _Pair,
        shape_numbers: int,
    ):
        (x, y), rest = numbers[:2], numbers[2 + shape_numbers :]
        self.motion, self.pair, self._D = motion, pair, D
        #: Numbers of the shape, half thickness of the member, and weights of the nodes.
        self.numbers, self.half = numbers[2 : 2 + shape_numbers], rest[0]
        self._weights = rest[1:] or [1]
        #: From the shape to the point at the start and at the level, its increment, and its rate.
        self.r0 = add((x, y), 1.0, self._relative(motion.start))
        self.Dr, self.rates = self._relative(D), self._relative(motion.rates)
        self.r = add(self.r0, motion.rule.level, self.Dr)

    def _relative(self, values: Sequence[Expr]) -> list[Expr]:
        """From the carrier to the point."""
        n = self.pair.nodes
        points, carrier = [values[2 * a : 2 * a + 2] for a in range(n)], values[2 * n :]
        points = [[N * x for x in x_a] for N, x_a in zip(self._weights, points, strict=True)]
        origin = carrier[:2] if self.pair.carrier_size else (0, 0)
        return [sum(xs) - c for *xs, c in zip(*points, origin, strict=True)]

    def turn(self, values: Sequence[Expr] | None = None) -> Expr:
        """The increment of the carrier's rotation, or another of its values."""
        return (self._D if values is None else values)[2 * self.pair.nodes + 2]

    def spread(
        self, force: Sequence[Expr], carrier_moment: Expr, point_moment: Expr = 0.0
    ) -> list[Expr]:
        """A force on the point and two moments, as forces on all entries."""
        carrier_forces = [*(-f for f in force), carrier_moment][: self.pair.carrier_size]
        moments = [N * point_moment for N in self._weights] if self.pair.turns else []
        return [*(N * f for N in self._weights for f in force), *carrier_forces, *moments]

    def slip(self, n: Sequence[Expr], apart: Expr, half: Expr) -> Slip:
        """Slip of a member's material against that of the shape, along W n.

        The axis of the member is `apart` from the origin of the shape in the direction n, and the
        member touches at `half` from its axis. With the arm `apart - half` of the shape, friction
        has no moment in all, and a common rotation is no slip.
        """
        along, shape_arm, motion = _normal_to(n), apart - half, self.motion
        path = dot(along, self.Dr)
        if self.pair.turns:
            rotations = self._D[self.pair.size - self.pair.nodes :]
            for N, Dpsi in zip(self._weights, rotations, strict=True):
                path -= half * N * motion.path(Dpsi)
        if self.pair.carrier_size:
            path -= shape_arm * motion.path(self.turn())
        return Slip(path, self.spread(along, -shape_arm, -half))


class _ShapeLaw(NamedTuple):
    """A kind of shape: how many numbers it has, its gap and its slip."""

    numbers: int
    #: Whether it turns with its carrier.
    turns: bool
    gap: Callable[[_Meeting], StepCoordinate]
    slip: Callable[[_Meeting], Slip]


def gap_of(
    shape: str, nodes: int = 1, carried: bool = False, slips: bool = False, thick: bool = False
) -> CoordinateKind:
    """Gap of a point of so many nodes from a shape.

    Numbers: place of the point relative to the shape (2), numbers of the shape, half thickness of
    the member, weights of the nodes if there are several.
    """
    law = _LAWS[shape]
    pair = _Pair(nodes, (3 if slips or law.turns else 2) * carried, thick)

    def meeting(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> _Meeting:
        return _Meeting(motion, D, numbers, pair, law.numbers)

    return CoordinateKind(
        f"the gap of a {shape.lower()}{pair}",
        pair.size,
        3 + law.numbers + (nodes if nodes > 1 else 0),
        lambda *arguments: law.gap(meeting(*arguments)),
        slip=(lambda *arguments: law.slip(meeting(*arguments))) if slips else None,
    )


def _circle_gap(meeting: _Meeting) -> StepCoordinate:
    """The direction is (r0 + r1) / (|r0| + |r1|), which has no moment about the centre.

    Its product with Dr is the change of the gap.
    """
    radius, side = meeting.numbers
    gap = arm_length(
        meeting.motion, meeting.r0, meeting.Dr, meeting.rates, radius + side * meeting.half, side
    )
    along = meeting.spread(gap.along, 0.0)
    return gap._replace(along=along, across=along)


def _circle_slip(meeting: _Meeting) -> Slip:
    level, arms = (
        meeting.motion.rule.level,
        (meeting.r0, add(meeting.r0, 1.0, meeting.Dr), meeting.r),
    )
    start, end, length = (ufl.sqrt(dot(arm, arm) + TINY) for arm in arms)
    mean = (1 - level) * start + level * end
    slip = meeting.slip([x / length for x in meeting.r], length, meeting.numbers[1] * meeting.half)
    return slip._replace(normal=length / mean)


def _line_normals(meeting: _Meeting) -> tuple[Sequence[Expr], Sequence[Expr], Sequence[Expr]]:
    """Normals at both ends of the step, and at the level."""
    normal, motion = meeting.numbers, meeting.motion
    if not meeting.pair.carrier_size:
        return normal, normal, normal
    psi, Dpsi = meeting.turn(motion.start), meeting.turn()
    n0, n1 = _turned(normal, psi), _turned(normal, psi + Dpsi)
    if motion.rule.turning:
        return n0, n1, [x / 2 for x in add(n0, 1.0, n1)]
    return n0, n1, _turned(normal, motion.at_level(psi, Dpsi))


def _line_gap(meeting: _Meeting) -> StepCoordinate:
    """If a node carries the line, the change of n.r is n.Dr + Dtheta (W n).r.

    Dtheta = 2 tan(Dpsi/2), with the means of n and r over the step.
    """
    n0, n1, n = _line_normals(meeting)
    carried, motion = bool(meeting.pair.carrier_size), meeting.motion
    lever = dot(_normal_to(n), meeting.r) if carried else 0.0
    along = meeting.spread(n, lever)
    start, change, rate = (
        dot(n0, meeting.r0) - meeting.half,
        dot(n, meeting.Dr),
        dot(n0, meeting.rates),
    )
    if not carried:
        return StepCoordinate(start, start + change, along, along, change, rate)
    end = dot(n1, add(meeting.r0, 1.0, meeting.Dr)) - meeting.half
    rate += meeting.turn(motion.rates) * dot(_normal_to(n0), meeting.r0)
    exact = change + motion.path(meeting.turn()) * lever
    return StepCoordinate(
        start, end, along, along, exact if motion.rule.turning else end - start, rate
    )


def _line_slip(meeting: _Meeting) -> Slip:
    *_, n = _line_normals(meeting)
    length = ufl.sqrt(dot(n, n)) if meeting.pair.carrier_size else 1.0
    n = [x / length for x in n]
    return meeting.slip(n, dot(n, meeting.r), meeting.half)._replace(normal=length)


#: By the names of the shapes.
_LAWS = {
    "Circle": _ShapeLaw(2, False, _circle_gap, _circle_slip),
    "Line": _ShapeLaw(2, True, _line_gap, _line_slip),
}


def _normal_to(a: Sequence[Expr]) -> list[Expr]:
    """W a: a turned by a right angle, anticlockwise."""
    return [-a[1], a[0]]


def _turned(a: Sequence[Expr], angle: Expr) -> list[Expr]:
    c, s = ufl.cos(angle), ufl.sin(angle)
    return [c * a[0] - s * a[1], s * a[0] + c * a[1]]
