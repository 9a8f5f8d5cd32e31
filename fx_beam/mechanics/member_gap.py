"""The gap of a node from a member, in UFL. The C files find the nearest point (member_curve.h).

A member is a smooth curve through the middles of its elements, with points c = sum N_k P_k of its
nodes. Let N0 and N1 be the weights of the nearest points at the start and at the end of a step,
n = (N0 + N1) / 2, d = N1 - N0, and s the slopes of N1 by the place on the member. The coordinates
are the sums a, t, u of the arms from the node to the nodes of the member, with n, d, and s; with
friction also w, with the slopes of N0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl

from .coordinates import Kind, Slip
from .point_laws import TINY, Coordinate, Motion

# Least change of a . t, relative to |a|^2, for which forces do work on it: below it what they
# would add is less than round-off.
_SMALL = 1e-12
# Least change of a . w, relative to |w|^2, from which the direction of friction follows.
_STILL = 1e-9

Vector = list[Any]


def _gap(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Coordinate:
    """Numbers: 1 / the second derivative of |arm|^2 / 2 by the place, and last the radii.

    The arms to the nearest points are a0 - t0 / 2 and a1 + t1 / 2. Forces along the mean of a do
    work on the change of |a|. What the distance changes besides is of third order. It is given to
    forces that do work on the change of a . t, which vanishes only with d. All of these are
    products of arms, whose forces have no moment.
    """
    radius = numbers[-1]
    place, ends = _ends(motion, D, numbers[0])
    first, last = _arms(ends)
    distance0, distance1 = _length(first), _length(last)
    on_arm, on_t = _directions(motion, ends)
    # By the change of the weights with the place.
    on_u = [place * (x / 2 + y) for x, y in zip(on_arm, on_t, strict=True)]
    along = [*on_arm, *on_t, *on_u, *[0.0] * (len(D) - 6)]
    (a, t, *_), path = _vectors(motion.rates), distance1 - distance0
    rate = _dot(first, _add(a, -0.5, t)) / distance0
    return Coordinate(distance0 - radius, distance1 - radius, along, along, path, rate)


def _slip(motion: Motion, D: Sequence[Any], numbers: Sequence[Any]) -> Slip:
    """Increment of the arc length of the nearest point in the reference.

    Numbers: the first of the gap, the slip, its slope by the place. The product a . w, with fixed
    weights, changes by about minus the way of the place, and vanishes only with it.
    """
    per_rate, slipped, length, _ = numbers
    place, ends = _ends(motion, D, per_rate)
    (arm0, _), (arm1, t1) = ends
    path = slipped + length * place
    on_normal, _ = _directions(motion, ends)
    zero = [0.0, 0.0]
    if motion.rule.level != 0.5:
        u = _vectors([x + d for x, d in zip(motion.start, D, strict=True)])[2]
        on_arm = [-length * per_rate * x for x in u]
        on_u = [
            -length * per_rate * x + place * y
            for x, y in zip(_add(arm1, 0.5, t1), on_arm, strict=True)
        ]
        along = [*on_arm, *(x / 2 for x in on_arm), *on_u, *zero]
        return Slip(path, along, _relative(on_normal, on_arm))
    w0, w1 = (
        _vectors(motion.start)[3],
        _vectors([x + d for x, d in zip(motion.start, D, strict=True)])[3],
    )
    change = _dot(arm1, w1) - _dot(arm0, w0)
    moves = ufl.gt(abs(change), _STILL * _dot(w0, w0))
    factor = ufl.conditional(moves, path / ufl.conditional(moves, change, 1.0), -length * per_rate)
    on_arm, on_w = (
        [factor / 2 * (x + y) for x, y in zip(*ends, strict=True)]
        for ends in ((w0, w1), (arm0, arm1))
    )
    on_u = [place / 2 * x for x in on_arm]
    return Slip(path, [*on_arm, *zero, *on_u, *on_w], _relative(on_normal, on_arm))


def _ends(
    motion: Motion, D: Sequence[Any], per_rate: Any
) -> tuple[Any, tuple[tuple[Vector, Vector], tuple[Vector, Vector]]]:
    """The change of the place with the motion, zero in value, and a and t at both ends."""
    start, end = list(motion.start), [x + d for x, d in zip(motion.start, D, strict=True)]
    arm1, t1, u1, *_ = _vectors(end)
    # The place at the end is a zero of this residual.
    place = -per_rate * _dot(_add(arm1, 0.5, t1), u1)
    return place, (_shifted(_vectors(start), place), _shifted(_vectors(end), place))


def _arms(ends: tuple[tuple[Vector, Vector], tuple[Vector, Vector]]) -> tuple[Vector, Vector]:
    """The arms to the nearest points at both ends."""
    (arm0, t0), (arm1, t1) = ends
    return _add(arm0, -0.5, t0), _add(arm1, 0.5, t1)


def _directions(
    motion: Motion, ends: tuple[tuple[Vector, Vector], tuple[Vector, Vector]]
) -> tuple[Vector, Vector]:
    """Directions of the normal force on a and t; that on the point is opposite to the first."""
    first, last = _arms(ends)
    if motion.rule.level == 0.5:
        (arm0, t0), (arm1, t1) = ends
        return _mean_directions((arm0, arm1), (t0, t1), _length(first) + _length(last))
    share = motion.rule.level
    unit = _add([(1 - share) * x for x in first], share, last)
    unit = [x / _length(unit) for x in unit]
    return unit, [(share - 0.5) * x for x in unit]


def _mean_directions(
    arms: tuple[Vector, Vector], shifts: tuple[Vector, Vector], lengths: Any
) -> tuple[Vector, Vector]:
    """Directions on a and t whose products with the changes are that of the distance."""
    (arm0, arm1), (t0, t1) = arms, shifts
    along0, along1 = _dot(arm0, t0), _dot(arm1, t1)
    rest, slip = along1 + along0 + (_dot(t1, t1) - _dot(t0, t0)) / 4, along1 - along0
    moves = ufl.gt(abs(slip), _SMALL * _dot(arm0, arm0))
    share = ufl.conditional(moves, rest / ufl.conditional(moves, slip, 1.0), 0.0) / lengths
    arm, t = (_add(x, 1.0, y) for x, y in (arms, shifts))
    on_arm = _add([x / lengths for x in arm], 0.5 * share, t)
    return on_arm, [0.5 * share * x for x in arm]


def _shifted(sums: list[Vector], place: Any) -> tuple[Vector, Vector]:
    """Sums of arms for weights of another place at the end."""
    a, t, u, *_ = sums
    return _add(a, 0.5 * place, u), _add(t, place, u)


def _vectors(components: Sequence[Any]) -> list[Vector]:
    return [list(components[i : i + 2]) for i in range(0, len(components), 2)]


def _add(a: Vector, factor: Any, b: Vector) -> Vector:
    return [x + factor * y for x, y in zip(a, b, strict=True)]


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1]


def _length(a: Vector) -> Any:
    return ufl.sqrt(_dot(a, a) + TINY)


def _relative(a: Vector, b: Vector) -> Any:
    """Length of a vector relative to another one; 1 if this is zero: round the ends of members."""
    some = ufl.gt(_dot(b, b), TINY)
    return ufl.conditional(some, _length(a) / ufl.conditional(some, _length(b), 1.0), 1.0)


MEMBER = Kind("the gap of a member", 6, 2, _gap)
MEMBER_WITH_FRICTION = Kind("the gap and slip of a member", 8, 4, _gap, slip=_slip)
