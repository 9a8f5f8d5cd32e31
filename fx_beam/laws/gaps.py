"""Gaps and slips in UFL: of points at shapes, and of nodes at members."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

from fx_beam.symbolic import Expr, ufl

from .point_laws import TINY, CoordinateKind, ForceStep, Slip, StepCoordinate, add, arm_length, dot

# -- Gaps and slips of points at shapes that are fixed or carried by a node, in UFL -------------


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


# -- The gap of a node from a member, in UFL. The C files find the nearest point (member_curve.h)
# A member is a smooth curve through the middles of its elements, with points c = sum N_k P_k of
# its nodes. Let N0 and N1 be the weights of the nearest points at the start and at the end of a
# step, n = (N0 + N1) / 2, d = N1 - N0, and s the slopes of N1 by the place on the member. The
# coordinates are the sums a, t, u, w of the arms from the node to the nodes of the member, with
# n, d, s, and the slopes of N0. With friction there follow the rotation of the node, and the same
# sums of those of the nodes of the member; their increments are those with which couples do work.
# There are no forces on w and its rotations: only derivatives by the start, where they follow the
# nearest point there as well, need them.


# Least change of a . t, relative to |a|^2, for which forces do work on it; the work on a smaller
# change is below round-off.
_SMALL = 1e-12
# Number of coordinates that are sums of arms.
_ARMS = 8

Vector = list[Expr]
# a and t at both ends of a step.
_Ends = tuple[tuple[Vector, Vector], tuple[Vector, Vector]]


def _gap(
    follows: bool, motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]
) -> StepCoordinate:
    """Numbers: 1 / (d^2/ds^2 |arm|^2 / 2) at the end and at the start, sum of the radii.

    The arms to the nearest points are a0 - t0 / 2 and a1 + t1 / 2. Forces along the mean of a do
    work on the change of |a|. The rest of the change of the distance is of third order; forces
    that do work on the change of a . t, which vanishes only with d, account for it. Forces on
    products of arms have no moment.
    """
    nearest = _Nearest(motion, D, numbers, follows)
    first, last = _arms(nearest.ends)
    distance0, distance1 = _length(first), _length(last)
    along = nearest.forces(*_directions(motion, nearest.ends))
    along += [ufl.as_ufl(0.0)] * (len(D) - _ARMS)
    (a, t, *_), path, radius = _vectors(motion.rates), distance1 - distance0, numbers[2]
    rate = dot(first, add(a, -0.5, t)) / distance0
    return StepCoordinate(distance0 - radius, distance1 - radius, along, along, path, rate)


def _slip(follows: bool, motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> Slip:
    """How far the surface of the node slips on that of the member, to the left along the normal.

    Numbers: as of the gap, then the radius R of the node relative to the sum R + r of both. With d
    the length of the mean arm, the surfaces meet at R d / (R + r) from the node and r d / (R + r)
    from the middle of the member: forces and couples there have no moment in all.
    """
    nearest, level, share = _Nearest(motion, D, numbers, follows), motion.rule.level, numbers[3]
    (arm0, t0), (arm1, t1) = nearest.ends
    (change, _), (own, of_member) = nearest.shifted(_vectors(D)), nearest.turn(D[_ARMS:])
    mean = arm = _between(0.5, arm0, arm1)
    beside = level - 0.5
    if beside:
        arm = add(_between(level, arm0, arm1), beside, _between(level, t0, t1))
    apart, length = _length(mean), _length(arm)
    path = (mean[0] * change[1] - mean[1] * change[0]) / apart
    path -= apart * (share * own + (1 - share) * of_member)
    unit, couple = [-arm[1] / length, arm[0] / length], (share - 1) * length
    along = nearest.forces(unit, [beside * x for x in unit])
    along += nearest.couples(-share * length, couple, beside * couple)
    normal, _ = _directions(motion, nearest.ends)
    return Slip(path, along, _length(normal))


class _Nearest:
    """The nearest points of a step, at places on the member that follow the motion.

    The places change by zero in value: only their derivatives matter. The place at the start is
    followed where derivatives by the start are needed.
    """

    def __init__(
        self, motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr], follows: bool
    ):
        start, end = motion.start, add(motion.start, 1.0, D)
        end_factor, start_factor, *_ = numbers
        (arm0, t0, _, w, *_), (arm1, t1, u, *_) = _vectors(start), _vectors(end)
        # A place is a zero of such a residual.
        self.place = -end_factor * dot(add(arm1, 0.5, t1), u)
        self.place_at_start: Expr = ufl.as_ufl(0.0)
        if follows:
            self.place_at_start = -start_factor * dot(add(arm0, -0.5, t0), w)
        #: a and t at both ends.
        self.ends: _Ends = self.shifted(_vectors(start)), self.shifted(_vectors(end))

    def shifted(self, sums: list[Vector]) -> tuple[Vector, Vector]:
        """a and t, or their increments, for the weights of the places that moved."""
        a, t, u, w, *_ = sums
        a, t = add(a, 0.5 * self.place, u), add(t, self.place, u)
        return add(a, 0.5 * self.place_at_start, w), add(t, -self.place_at_start, w)

    def turn(self, turns: Sequence[Expr]) -> tuple[Expr, Expr]:
        """Increments of rotations: of the node, and of the member at the mean of the places."""
        own, a, _, u, w = turns
        return own, a + 0.5 * self.place * u + 0.5 * self.place_at_start * w

    def forces(self, on_a: Vector, on_t: Vector) -> list[Expr]:
        """Forces on all sums of arms, with what changes of the places add."""
        half = [x / 2 for x in on_a]
        on_u = [self.place * x for x in add(half, 1.0, on_t)]
        on_w = [self.place_at_start * x for x in add(half, -1.0, on_t)]
        return [*on_a, *on_t, *on_u, *on_w]

    def couples(self, on_own: Expr, on_a: Expr, on_t: Expr) -> list[Expr]:
        """Couples on all rotations, with what changes of the places add."""
        on_u, on_w = self.place * (on_a / 2 + on_t), self.place_at_start * (on_a / 2 - on_t)
        return [on_own, on_a, on_t, on_u, on_w]


def _arms(ends: _Ends) -> tuple[Vector, Vector]:
    """The arms to the nearest points at both ends."""
    (arm0, t0), (arm1, t1) = ends
    return add(arm0, -0.5, t0), add(arm1, 0.5, t1)


def _directions(motion: ForceStep, ends: _Ends) -> tuple[Vector, Vector]:
    """Directions of the normal force on a and t; that on the point is opposite to the first.

    At mid-step their products with the changes are the change of the distance.
    """
    first, last = _arms(ends)
    if motion.rule.level != 0.5:
        share = motion.rule.level
        unit = _between(share, first, last)
        unit = [x / _length(unit) for x in unit]
        return unit, [(share - 0.5) * x for x in unit]
    (arm0, t0), (arm1, t1) = ends
    lengths = _length(first) + _length(last)
    along0, along1 = dot(arm0, t0), dot(arm1, t1)
    rest, slip = along1 + along0 + (dot(t1, t1) - dot(t0, t0)) / 4, along1 - along0
    moves = ufl.gt(abs(slip), _SMALL * dot(arm0, arm0))
    share = ufl.conditional(moves, rest / ufl.conditional(moves, slip, 1.0), 0.0) / lengths
    arm, t = add(arm0, 1.0, arm1), add(t0, 1.0, t1)
    arm_forces = add([x / lengths for x in arm], 0.5 * share, t)
    return arm_forces, [0.5 * share * x for x in arm]


def _vectors(components: Sequence[Expr]) -> list[Vector]:
    return [list(components[i : i + 2]) for i in range(0, len(components), 2)]


def _between(part: float, a: Vector, b: Vector) -> Vector:
    return add([(1 - part) * x for x in a], part, b)


def _length(a: Vector) -> Expr:
    return ufl.sqrt(dot(a, a) + TINY)


def _kinds(follows: bool) -> tuple[CoordinateKind, CoordinateKind]:
    """The gap without and with friction; for derivatives the nearest point at the start follows."""
    name, gap = " by its start" if follows else "", functools.partial(_gap, follows)
    slip = functools.partial(_slip, follows)
    friction = CoordinateKind(f"the gap and slip of a member{name}", 13, 4, gap, slip=slip)
    return CoordinateKind(f"the gap of a member{name}", 8, 3, gap), friction


MEMBER, MEMBER_WITH_FRICTION = _kinds(False)
FOLLOWED, FOLLOWED_WITH_FRICTION = _kinds(True)
