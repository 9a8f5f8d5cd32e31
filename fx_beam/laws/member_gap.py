"""The gap of a node from a member, in UFL. The C files find the nearest point (member_curve.h).

A member is a smooth curve through the middles of its elements, with points c = sum N_k P_k of its
nodes. Let N0 and N1 be the weights of the nearest points at the start and at the end of a step,
n = (N0 + N1) / 2, d = N1 - N0, and s the slopes of N1 by the place on the member. The coordinates
are the sums a, t, u, w of the arms from the node to the nodes of the member, with n, d, s, and the
slopes of N0; with friction also with the slopes of w and of u. There are forces on a, t and
u, with friction on w; only derivatives by the start, where they follow the nearest point there as
well, need the others.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

from fx_beam.symbolic import Expr, ufl

from .point_laws import TINY, CoordinateKind, ForceStep, Slip, StepCoordinate, add, dot

# Least change of a . t, relative to |a|^2, for which forces do work on it; the work on a smaller
# change is below round-off.
_SMALL = 1e-12
# Least change of a . w, relative to |w|^2, from which the direction of friction follows.
_STILL = 1e-9

Vector = list[Expr]
# a and t at both ends of a step.
_Ends = tuple[tuple[Vector, Vector], tuple[Vector, Vector]]


def _gap(
    follows: bool, motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]
) -> StepCoordinate:
    """Numbers: 1 / (d^2/ds^2 |arm|^2 / 2) at the end and at the start, numbers of the slip, radii.

    The arms to the nearest points are a0 - t0 / 2 and a1 + t1 / 2. Forces along the mean of a do
    work on the change of |a|. The rest of the change of the distance is of third order; forces
    that do work on the change of a . t, which vanishes only with d, account for it. Forces on
    products of arms have no moment.
    """
    nearest = _Nearest(motion, D, numbers, follows)
    first, last = _arms(nearest.ends)
    distance0, distance1 = _length(first), _length(last)
    along = nearest.sum_forces(*_directions(motion, nearest.ends), len(D))
    (a, t, *_), path, radius = _vectors(motion.rates), distance1 - distance0, numbers[-1]
    rate = dot(first, add(a, -0.5, t)) / distance0
    return StepCoordinate(distance0 - radius, distance1 - radius, along, along, path, rate)


def _slip(follows: bool, motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> Slip:
    """Increment of the arc length of the nearest point in the reference.

    Numbers: two factors of the gap, the slip, and slopes of the slip by the place, at the end and
    at the start. The product a . w, with fixed weights, changes by about minus the way of the
    place. Where this way is zero, the slope of the way by a . w is the first factor, or if the
    start is followed an expression with the same value, which has derivatives.
    """
    end_factor, _, slipped, length, length_at_start, _ = numbers
    nearest = _Nearest(motion, D, numbers, follows)
    path = slipped + length * nearest.place - length_at_start * nearest.place_at_start
    # The quotient of the slip and the change of a . w where there is none.
    still = -length * end_factor
    if follows:
        is_inside = ufl.gt(end_factor, 0)
        rate = ufl.conditional(is_inside, nearest.rate_at_end(), 1.0)
        still = ufl.conditional(is_inside, -length / rate, 0.0)
    (arm0, _), (arm1, t1) = nearest.ends
    normal, _ = _directions(motion, nearest.ends)
    size = len(D)
    if motion.rule.level != 0.5:
        arm_forces = [still * x for x in nearest.u]
        half = [x / 2 for x in arm_forces]
        u_forces = [still * x for x in add(arm1, 0.5, t1)]
        along = nearest.sum_forces(arm_forces, half, size, u_forces=u_forces)
        return Slip(path, along, _relative(normal, arm_forces))
    w0, w1 = nearest.w
    change = dot(arm1, w1) - dot(arm0, w0)
    moves = ufl.gt(abs(change), _STILL * dot(w0, w0))
    factor = ufl.conditional(moves, path / ufl.conditional(moves, change, 1.0), still)
    arm_forces = [factor / 2 * x for x in add(w0, 1.0, w1)]
    w_forces = [factor / 2 * x for x in add(arm0, 1.0, arm1)]
    along = nearest.sum_forces(arm_forces, [0.0, 0.0], size, w_forces=w_forces)
    return Slip(path, along, _relative(normal, arm_forces))


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
        self._sums = (arm0, t0, _, w, *_), (arm1, t1, u, *_) = _vectors(start), _vectors(end)
        # A place is a zero of such a residual.
        self.place = -end_factor * dot(add(arm1, 0.5, t1), u)
        self.place_at_start: Expr = ufl.as_ufl(0.0)
        #: The change of the place at the end by which slopes change, if they follow it.
        self._slope_place: Expr = ufl.as_ufl(0.0)
        if follows:
            self.place_at_start = -start_factor * dot(add(arm0, -0.5, t0), w)
            self._slope_place = self.place
        #: a and t at both ends.
        self.ends: _Ends = self._shifted(self._sums[0]), self._shifted(self._sums[1])

    def _shifted(self, sums: list[Vector]) -> tuple[Vector, Vector]:
        """Sums of arms for weights of other places."""
        a, t, u, w, *_ = sums
        a, t = add(a, 0.5 * self.place, u), add(t, self.place, u)
        return add(a, 0.5 * self.place_at_start, w), add(t, -self.place_at_start, w)

    @property
    def u(self) -> Vector:
        """u at the end."""
        sums = self._sums[1]
        return add(sums[2], self._slope_place, sums[5]) if len(sums) > 5 else sums[2]

    @property
    def w(self) -> tuple[Vector, Vector]:
        """w at both ends."""
        first, last = (add(sums[3], self.place_at_start, sums[4]) for sums in self._sums)
        return first, last

    def rate_at_end(self) -> Expr:
        """The second derivative of |arm|^2 / 2 by the place at the end."""
        arm, t = self.ends[1]
        return dot(self.u, self.u) + dot(add(arm, 0.5, t), self._sums[1][5])

    def sum_forces(
        self,
        arm_forces: Vector,
        tangent_forces: Vector,
        size: int,
        u_forces: Sequence[Expr] = (0, 0),
        w_forces: Sequence[Expr] = (0, 0),
    ) -> list[Expr]:
        """Forces (size,) on all sums, with what changes of the places add."""
        place, place0 = self.place, self.place_at_start
        half = [x / 2 for x in arm_forces]
        vectors = [
            arm_forces,
            tangent_forces,
            add(u_forces, place, add(half, 1.0, tangent_forces)),
            add(w_forces, place0, add(half, -1.0, tangent_forces)),
            [place0 * x for x in w_forces],
            [self._slope_place * x for x in u_forces],
        ]
        return [x for vector in vectors for x in vector][:size]


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
        unit = add([(1 - share) * x for x in first], share, last)
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


def _length(a: Vector) -> Expr:
    return ufl.sqrt(dot(a, a) + TINY)


def _relative(a: Vector, b: Vector) -> Expr:
    """Length of a vector relative to another one; 1 if this is zero: round the ends of members."""
    long = ufl.gt(dot(b, b), TINY)
    return ufl.conditional(long, _length(a) / ufl.conditional(long, _length(b), 1.0), 1.0)


def _kinds(follows: bool) -> tuple[CoordinateKind, CoordinateKind]:
    """The gap without and with friction; for derivatives the nearest point at the start follows."""
    name, gap = " by its start" if follows else "", functools.partial(_gap, follows)
    slip = functools.partial(_slip, follows)
    friction = CoordinateKind(f"the gap and slip of a member{name}", 12, 6, gap, slip=slip)
    return CoordinateKind(f"the gap of a member{name}", 8, 3, gap), friction


MEMBER, MEMBER_WITH_FRICTION = _kinds(False)
FOLLOWED, FOLLOWED_WITH_FRICTION = _kinds(True)
