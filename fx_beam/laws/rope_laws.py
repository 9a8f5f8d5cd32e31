"""The length of a rope over circles in a step, with exact work and both momenta, in UFL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from fx_beam.symbolic import Expr, ufl

from .kinematics import tan
from .point_laws import (
    TINY,
    CoordinateKind,
    ForceStep,
    StepCoordinate,
    add,
    dot,
    tangent_quotient,
    total,
    way,
)

# Angle of a span from which half a turn is counted [rad].
_COUNTED = 2.0


class _Span(NamedTuple):
    """A free span between circles over a step, by the vector d between its centres.

    Its part of the length is F(|d|) + q times the angle of d, with the difference q of radii, F' =
    t / |d| and t^2 = |d|^2 - q^2.
    """

    #: F at the start [m], and its increment.
    start: Expr
    path: Expr
    #: Vectors whose products with the increment of d are exactly that of F, and 2 `turn`.
    along: list[Expr]
    turning: list[Expr]
    #: Tan of half the increment of the angle, the angle since the reference, and half turns that it
    #: is measured from, in rad, at the end.
    turn: Expr
    angle: Expr
    counted: Expr
    #: Unit vectors along the span at both ends of the step.
    ends: tuple[list[Expr], list[Expr]]


def _across(a: Sequence[Expr], b: Sequence[Expr]) -> Expr:
    return a[0] * b[1] - a[1] * b[0]


def _half(a: Sequence[Expr], b: Sequence[Expr], size: Expr) -> Expr:
    """Tan of half the angle from a to b, for the product of their lengths."""
    return _across(a, b) / (size + dot(a, b))


def _span(apart: list[Expr], moved: list[Expr], D: list[Expr], q: Expr, counted: Expr) -> _Span:
    d0 = add(apart, 1.0, moved)
    d1 = add(d0, 1.0, D)
    size0, size1, at_rest = (ufl.sqrt(dot(d, d) + TINY) for d in (d0, d1, apart))
    t0, t1 = (ufl.sqrt(size * size - q * q) for size in (size0, size1))
    arm_sum, mean = add(d0, 1.0, d1), [x / 2 for x in add(d0, 1.0, d1)]
    sum_of_sizes, square = size0 + size1, dot(mean, mean)
    longer = dot(arm_sum, D) / sum_of_sizes
    # The quotient of both increments: that of asin(q / |d|) is one of a small angle.
    y = q * longer * sum_of_sizes / ((t0 + t1) * size0 * size1)
    is_small = ufl.lt(y * y, 1e-6)
    y2 = y * y
    bent = ufl.conditional(is_small, 0.0, y)
    far = ufl.asin(bent) / ufl.conditional(is_small, 1.0, y)
    ratio = ufl.conditional(is_small, 1 + y2 / 6 * (1 + 9 / 20 * y2), far)
    quotient = sum_of_sizes / (t0 + t1) * (1 - q * q / (size0 * size1) * ratio)
    turn = _across(d0, D) / (size0 * size1 + dot(d0, d1))
    lean = turn * longer / sum_of_sizes
    sign = ufl.cos(counted)  # of the direction from which the angle is measured
    since = 2 * ufl.atan(_half([sign * x for x in apart], d0, at_rest * size0))
    ahead = since + 2 * ufl.atan(turn)
    passed = ufl.conditional(ufl.gt(abs(ahead), _COUNTED), math.pi * ufl.sign(ahead), 0.0)
    return _Span(
        t0 + q * ufl.asin(q / size0),
        quotient * longer,
        [quotient / sum_of_sizes * x for x in arm_sum],
        [(lean * mean[0] - mean[1]) / square, (lean * mean[1] + mean[0]) / square],
        turn,
        counted + since,
        counted + passed,
        (_along(d0, size0, t0, q), _along(d1, size1, t1, q)),
    )


def _along(d: list[Expr], size: Expr, t: Expr, q: Expr) -> list[Expr]:
    """The unit vector of a span: the derivative of the length by d."""
    square = size * size
    return [(t * d[0] - q * d[1]) / square, (t * d[1] + q * d[0]) / square]


def rope_over(kinds: str) -> CoordinateKind:
    """Length of a rope over points and circles, by their kinds (`RopeOverPulleys.kinds`).

    Numbers: ways between the centres in the reference; radius and arc at the start of each circle.
    """
    count = len(kinds)
    sizes = [{"n": 2, "N": 2, "D": 3}.get(kind, 0) for kind in kinds]
    circles = [i for i, kind in enumerate(kinds) if kind in "NFD"]

    def parts(values: Sequence[Expr]) -> tuple[list[list[Expr]], list[Expr]]:
        """Ways between centres, and rotations of all points, of displacements or rates."""
        numbers, vectors, turns = iter(values), list[Expr](), list[Expr]()
        for size in sizes:
            vectors.append([next(numbers), next(numbers)] if size else None)
            turns.append(next(numbers) if size == 3 else ufl.as_ufl(0.0))
        return [way(*vectors[i : i + 2]) for i in range(count - 1)], turns

    def length(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> StepCoordinate:
        radii, arcs = ([ufl.as_ufl(0.0)] * count for _ in range(2))
        for i, number in zip(circles, range(2 * count - 2, len(numbers), 2), strict=True):
            radii[i], arcs[i] = numbers[number], numbers[number + 1]
        (moved, turned), (ways, turns), (rates, spins) = map(parts, (motion.start, D, motion.rates))
        apart = [[*numbers[2 * i : 2 * i + 2]] for i in range(count - 1)]
        steps = [radii[i] - radii[i + 1] for i in range(count - 1)]
        counted = motion.internal[-len(apart) :]
        arguments = zip(apart, moved, ways, steps, counted, strict=True)
        spans = [_span(*of_span) for of_span in arguments]
        start, path = (total([getattr(span, name) for span in spans]) for name in ("start", "path"))
        pulls = [span.along for span in spans]
        moments = [ufl.as_ufl(0.0)] * count
        for i in circles:
            r, has_last, has_next = radii[i], i > 0, i < count - 1
            body, psi = tan(turns[i] / 2), turned[i]
            # Of the rope behind less that before; a drum is in the place of one of them.
            a, angle_a = (spans[i - 1].turn, spans[i - 1].angle) if has_last else (body, psi)
            b, angle_b = (spans[i].turn, spans[i].angle) if has_next else (body, psi)
            half_a = ufl.atan(a) if has_last else turns[i] / 2
            half_b = ufl.atan(b) if has_next else turns[i] / 2
            x = half_b - half_a
            start = start + r * (arcs[i] + (angle_b - angle_a))
            path = path + 2 * r * x
            share = r * tangent_quotient(a, b, x)
            for k, side in ((i, share), (i - 1, -share)):
                if 0 <= k < count - 1:
                    pulls[k] = add(pulls[k], side, spans[k].turning)
                elif kinds[i] == "D":
                    moments[i] += side
        if not motion.rule.turning:
            level = motion.rule.level
            pulls = [
                [(1 - level) * x + level * y for x, y in zip(*span.ends, strict=True)]
                for span in spans
            ]
            moments = [ufl.as_ufl(0.0)] * count
            moments[0], moments[-1] = moments[0] - radii[0], moments[-1] + radii[-1]
        along = list[Expr]()
        for i, size in enumerate(sizes):
            if size:
                arriving = pulls[max(i - 1, 0) : i]
                leaving = [[-x for x in pull] for pull in pulls[i : i + 1]]
                along += [total(xs) for xs in zip(*arriving, *leaving, strict=True)]
            along += [moments[i]] * (size == 3)
        rate = total([dot(span.ends[0], v) for span, v in zip(spans, rates, strict=True)])
        rate = rate - radii[0] * spins[0] + radii[-1] * spins[-1]
        ends = [span.counted for span in spans]
        return StepCoordinate(start, start + path, along, along, path, rate, ends)

    size, count_of_numbers = sum(sizes), 2 * count - 2 + 2 * len(circles)
    name, spans = f"a rope over {kinds}", count - 1
    return CoordinateKind(name, size, count_of_numbers, length, is_line=True, counters=spans)
