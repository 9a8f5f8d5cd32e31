"""Forces at points in UFL: laws over a step, coordinates, and lengths of ropes over circles."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from fx_beam.scene.loads import PARTS_OF_DRAG
from fx_beam.symbolic import Expr, ufl

from .kinematics import tan
from .rates import UpdateRule

# -- Forces at points: their laws over a step, and the coordinates on which they act, in UFL ----


#: Added to the square of a length or a speed, whose root then has a derivative at zero.
TINY = 1e-300
# Tanh of more is 1. Its derivative, as UFL writes it, is not finite from 400 on.
_LARGE = 40.0
# Values that friction remembers from the last iteration: whether there was one, x, y and the slope.
REMEMBERED = 4


class StepRule(NamedTuple):
    """Facts on the rates of a scheme, for forces at points."""

    level: float
    #: Whether forces do work on 2 tan(Dpsi/2).
    turning: bool
    at_rest: bool
    #: Whether the step only serves to find what its forces depend on, at an instant: nothing flows.
    instant: bool = False

    @staticmethod
    def of(rates: UpdateRule, instant: bool = False) -> StepRule:
        """The rule of some rates."""
        return StepRule(float(rates.level), rates.turning, bool(rates.at_rest), instant)


class ForceStep:
    """The coordinates of a force over a step, as UFL scalars, in the order of `arguments`."""

    def __init__(self, values: Expr, law: PointLaw, rule: StepRule):
        n, index = law.size, iter(range(arguments(law)))

        def take(count: int) -> list[Expr]:
            return [values[next(index)] for _ in range(count)]

        self.rule = rule
        #: Values at the start of the step.
        self.start = take(n)
        #: Increments without derivatives, and the same increments with derivatives.
        self.still = take(n)
        self.increment = [ufl.variable(D) for D in self.still]
        #: Rates at the start, none in statics; time at the scheme's level, length of the step.
        self.rates = take(n)
        self.t, self.dt = take(2)
        self._inverse_dt = 1 / self.dt
        if rule.at_rest:
            self.rates, self._inverse_dt = [ufl.as_ufl(0.0)] * n, ufl.as_ufl(0.0)
        #: Internal variables at the start of the step, and what the last iteration left.
        self.internal = take(law.internal)
        self.iteration_memory = take(law.iteration_memory)
        #: Numbers of this force.
        self.numbers = take(law.numbers)

    def at_level(self, start: Expr, increment: Expr) -> Expr:
        """A quantity at the scheme's level in the step."""
        return start + self.rule.level * increment

    def rate_at_level(self, start: Expr, mean: Expr) -> Expr:
        """A rate at the scheme's level, from that at the start and the mean one."""
        if self.rule.level == 0.5:
            return mean
        return start + 2 * self.rule.level * (mean - start)

    def mean_rate(self, path: Expr) -> Expr:
        """The mean rate over the step, from the increment."""
        return path * self._inverse_dt

    def path(self, D: Expr) -> Expr:
        """The increment of a rotation with which moments do work."""
        return 2 * tan(D / 2) if self.rule.turning else D


class LawForces(NamedTuple):
    """Forces and memory of a law in a step."""

    #: Forces (size,) against the motion, as UFL scalars.
    forces: Sequence[Expr]
    #: Internal variables at the end, and what the next iteration remembers.
    internal: Sequence[Expr] = ()
    iteration_memory: Sequence[Expr] = ()
    #: The force against an increase of a single coordinate.
    pull: Expr = 0.0


@dataclass(frozen=True, eq=False)
class PointLaw:
    """A force at points: at nodes, with x, y and rotation of each, or on the slide of a joint.

    Two laws of this package are equal if they have the same `key`, two of a user if they are one.
    """

    name: str
    #: Number of coordinates, and of the numbers of each force.
    size: int
    numbers: int
    forces: Callable[[ForceStep], LawForces]
    #: Energy stored at the start of a step, and lost in it.
    energy: Callable[[ForceStep], Expr] | None = None
    loss: Callable[[ForceStep], Expr] | None = None
    #: Values at the start of a step that change their sign where the force switches.
    switches: Callable[[ForceStep], list] | None = None
    #: Its pull along a line between points, if this is recorded.
    pull: Callable[[ForceStep], Expr] | None = None
    #: Number of internal variables, and of what iterations remember.
    internal: int = 0
    iteration_memory: int = 0
    #: How many internal variables, the last ones, only count, and do not flow.
    counters: int = 0
    #: Whether it has functions of a user, which may have changed since another scene.
    user_defined: bool = False
    #: Whether it is one-sided: a contact that opens.
    unilateral: bool = False
    #: Whether it has friction that sticks, whose damping, mu and stiffness are its last numbers.
    has_stick_state: bool = False
    #: Whether Newton's method may go far too far with it, and is shortened.
    needs_line_search: bool = False
    #: Of a line over points the law of its length, by which its pieces have their forces, and which
    #: points move.
    length_law: PointLaw | None = None
    moves: tuple[bool, ...] = ()
    #: What to say if it is not finite where all coordinates are zero; empty if that may be.
    zero_advice: str = ""

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, PointLaw):
            return self is other
        return not (self.user_defined or other.user_defined) and self.key == other.key

    def __hash__(self) -> int:
        return hash((self.name, self.size, self.numbers))

    @property
    def kind(self) -> object:
        """Identifier that laws of a kind share; functions of a user are compared in the scene."""
        return self.key if self.user_defined else self

    @property
    def key(self) -> tuple:
        """Identifier of a law of this package: what it consists of, without its functions."""
        has = [bool(part) for part in (self.energy, self.loss, self.switches, self.pull)]
        sizes = self.size, self.numbers, self.internal, self.iteration_memory
        return self.name, *sizes, self.unilateral, self.has_stick_state, *has, self.moves

    def over(self, moves: tuple[bool, ...]) -> PointLaw:
        """A law of a length as that of a line over points, of which some move.

        Its numbers begin with the vectors from each point to the next one in the reference. Each
        piece of the line has its own forces along itself, so that momenta are kept.
        """
        numbers = self.numbers + 2 * len(moves) - 2
        return replace(self, size=2 * sum(moves), numbers=numbers, length_law=self, moves=moves)


def arguments(law: PointLaw) -> int:
    """Number of arguments of a law: start, increment, rate, t, dt, internal, memory, numbers."""
    return 3 * law.size + 2 + law.internal + law.iteration_memory + law.numbers


class StepCoordinate(NamedTuple):
    """A scalar over a step, on which a force acts: a gap, a distance, an angle or a slide."""

    start: Expr
    end: Expr
    #: Directions (size,) of a force with a potential, whose product with the increments is exactly
    #: the change of the coordinate.
    along: Sequence[Expr]
    #: Directions (size,) of other forces, and the increment with which they do work.
    across: Sequence[Expr]
    path: Expr
    #: Rate at the start.
    rate: Expr
    #: Counters at the end of the step.
    counters: Sequence[Expr] = ()

    def beyond(self, limit: Expr, sign: float) -> StepCoordinate:
        """The distance from a limit, on the side of a sign."""
        return StepCoordinate(
            sign * (self.start - limit),
            sign * (self.end - limit),
            [sign * a for a in self.along],
            [sign * a for a in self.across],
            sign * self.path,
            sign * self.rate,
        )


def smooth_sign(x: Expr, still: Expr, iteration_memory: Sequence[Expr]) -> tuple[Expr, list[Expr]]:
    """Tanh of x, and what the next iteration remembers; `still` is x without a derivative."""
    y = ufl.tanh(ufl.conditional(ufl.lt(abs(still), _LARGE), still, _LARGE * ufl.sign(still)))
    is_small = ufl.lt(abs(still), 1e-4)
    safe = ufl.conditional(is_small, 1.0, y)
    s = ufl.conditional(is_small, 1.0, still / safe)
    bend = ufl.conditional(is_small, 2 * still / 3, (1 - (1 - y * y) * s) / safe)
    return _with_slope(y, s, bend, x, still, iteration_memory)


def clipped(
    x: Expr, still: Expr, iteration_memory: Sequence[Expr], edge: float = 1.0
) -> tuple[Expr, list[Expr]]:
    """x limited to -1 and 1 (to 1 from the edge on), and what the next iteration remembers."""
    exceeds = ufl.gt(abs(still), edge)
    sign = ufl.conditional(ufl.gt(still, 0), 1.0, -1.0)
    s, bend = ufl.conditional(exceeds, abs(still), 1.0), ufl.conditional(exceeds, sign, 0.0)
    return _with_slope(ufl.conditional(exceeds, sign, still), s, bend, x, still, iteration_memory)


def _with_slope(
    y: Expr, s: Expr, bend: Expr, x: Expr, still: Expr, iteration_memory: Sequence[Expr]
) -> tuple[Expr, list[Expr]]:
    """A bounded y(x) with a derivative with which Newton's method does not jump to and fro.

    With s = x / y the friction is s y = x, whose linear form has the derivative (1 - y s') / s;
    `bend` is s'. For y it takes what the last iteration expected, limited to 1 (Chan, Golub and
    Mulet 1999, doi 10.1137/S1064827596299767). Where both agree it is that of y.
    """
    repeated, last_x, last_y, last_slope = iteration_memory
    guess = last_y + last_slope * (still - last_x)
    bounded = ufl.conditional(
        ufl.gt(guess, 1), 1.0, ufl.conditional(ufl.lt(guess, -1), -1.0, guess)
    )
    expected = ufl.conditional(ufl.gt(repeated, 0), bounded, y)
    slope = (1 - expected * bend) / s
    return y + slope * (x - still), [ufl.as_ufl(1.0), still, y, slope]


def drag(linear: bool, quadratic: bool, rotation: bool) -> PointLaw:
    """(linear + quadratic |v|) v and a moment against the spin, at the scheme's level.

    The law is given only the numbers, and the coordinates, of what it has: without a quadratic part
    there is no root, and no derivative by the other component.
    """
    moves = linear or quadratic

    def against(motion: ForceStep, v: list[Expr]) -> list[Expr]:
        numbers, forces = iter(motion.numbers), []
        if moves:
            along = next(numbers) if linear else ufl.as_ufl(0.0)
            if quadratic:
                along += next(numbers) * ufl.sqrt(v[0] * v[0] + v[1] * v[1] + TINY)
            forces += [along * v[0], along * v[1]]
        return [*forces, next(numbers) * v[-1]] if rotation else forces

    def mean(motion: ForceStep) -> list[Expr]:
        paths = list(motion.increment)
        if rotation:
            paths[-1] = motion.path(paths[-1])
        return [motion.mean_rate(path) for path in paths]

    def forces(motion: ForceStep) -> LawForces:
        rates = zip(motion.rates, mean(motion), strict=True)
        return LawForces(against(motion, [motion.rate_at_level(v0, v) for v0, v in rates]))

    def loss(motion: ForceStep) -> Expr:
        v = mean(motion)
        return sum(f * x for f, x in zip(against(motion, v), v, strict=True)) * motion.dt

    name = "drag " + ", ".join(itertools.compress(PARTS_OF_DRAG, (linear, quadratic, rotation)))
    return PointLaw(name, 2 * moves + rotation, linear + quadratic + rotation, forces, loss=loss)


def _follower(motion: ForceStep) -> LawForces:
    psi = motion.at_level(motion.start[2], motion.increment[2])
    x, y, factor = motion.numbers
    c, s = factor * ufl.cos(psi), factor * ufl.sin(psi)
    return LawForces([s * y - c * x, -s * x - c * y, ufl.as_ufl(0.0)])


#: R(psi) F, with psi and F at the scheme's level; numbers: F, load factor. It has no potential,
#: and its tangent is not symmetric.
FOLLOWER = PointLaw("follower force", 3, 3, _follower)


class Slip(NamedTuple):
    """How far a point slips along the material that it touches, over a step."""

    path: Expr
    #: Directions (size,) of the friction, whose product with the increments of work is the path.
    along: Sequence[Expr]
    #: Length of the direction of the normal force on the point, relative to that of the friction.
    normal: Expr = 1.0


class CoordinateKind(NamedTuple):
    """A kind of coordinate: its number of entries and of numbers, and the coordinate."""

    name: str
    size: int
    numbers: int
    #: From the motion, increments and numbers.
    coordinate: Callable[[ForceStep, Sequence[Expr], Sequence[Expr]], StepCoordinate]
    #: Whether it is zero where all that it is given is zero, and regular there.
    starts_at_zero: bool = False
    #: Whether it is the length of a line between points, whose pull is recorded.
    is_line: bool = False
    #: Number of internal variables that only count, as the half turns of a span.
    counters: int = 0
    #: The slip, from the motion, increments and numbers; None without friction of contact.
    slip: Callable[[ForceStep, Sequence[Expr], Sequence[Expr]], Slip] | None = None


def _slide(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> StepCoordinate:
    start, unit = motion.start[0], [ufl.as_ufl(1.0)]
    return StepCoordinate(start, start + D[0], unit, unit, D[0], motion.rates[0])


def _angle(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> StepCoordinate:
    """The rotation of the second node minus that of the first.

    A moment with a potential is multiplied by (Dpsi_b - Dpsi_a) / (Dtheta_b - Dtheta_a), so that
    its work on Dtheta is the increment of the potential.
    """
    return _turn(motion, motion.start, D, motion.rates)


def _turn(motion: ForceStep, start: Expr, D: Expr, rates: Expr) -> StepCoordinate:
    """The difference b - a of two rotations among more."""
    (a, b), (Da, Db) = start, D
    start, path, ratio = b - a, Db - Da, ufl.as_ufl(1.0)
    if motion.rule.turning:
        a, b = tan(Da / 2), tan(Db / 2)
        path, ratio = 2 * (b - a), tangent_quotient(a, b, (Db - Da) / 2)
    sides = [ufl.as_ufl(-1.0), ufl.as_ufl(1.0)]
    rate = rates[1] - rates[0]
    return StepCoordinate(start, start + (Db - Da), [-ratio, ratio], sides, path, rate)


def _gear(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> StepCoordinate:
    """The angle of the first two nodes less a ratio times that of the others, and a value."""
    ratio, value = numbers
    driven, driver = (
        _turn(motion, *(values[first : first + 2] for values in (motion.start, D, motion.rates)))
        for first in (0, 2)
    )
    along, across = (
        [*x, *(-ratio * y for y in z)]
        for x, z in ((driven.along, driver.along), (driven.across, driver.across))
    )
    start, end = (x - ratio * y - value for x, y in zip(driven[:2], driver[:2], strict=True))
    path, rate = driven.path - ratio * driver.path, driven.rate - ratio * driver.rate
    return StepCoordinate(start, end, along, across, path, rate)


def tangent_quotient(a: Expr, b: Expr, x: Expr) -> Expr:
    """x / (b - a) for the tangents a and b of two angles, and x their difference.

    For small x the same with cosines, as 1 / cos^2 = 1 + tan^2, and x / sin(x) by a series that is
    exact to round-off.
    """
    x2 = x * x
    is_small = ufl.lt(x2, 4e-4)
    x_over_sine = 1 + (1 / 6) * x2 * (1 + (7 / 60) * x2 * (1 + (31 / 294) * x2))
    secants = ufl.sqrt((1 + a * a) * (1 + b * b))
    numerator = ufl.conditional(is_small, x_over_sine, x)
    return numerator / ufl.conditional(is_small, secants, b - a)


def arm_length(motion: ForceStep, r0, Dr, rates, rest: Expr, side: Expr) -> StepCoordinate:
    """The length of an arm, from a rest, times a side."""
    level, r1 = motion.rule.level, add(r0, 1.0, Dr)
    size0, size1 = (ufl.sqrt(dot(r, r) + TINY) for r in (r0, r1))
    mean = (1 - level) * size0 + level * size1
    along = [side * ((1 - level) * x + level * y) / mean for x, y in zip(r0, r1, strict=True)]
    start, end = side * (size0 - rest), side * (size1 - rest)
    rate = side * dot(r0, rates) / size0
    return StepCoordinate(start, end, along, along, end - start, rate)


def way(a: list[Expr] | None, b: list[Expr] | None) -> list[Expr]:
    """From one point to another; None for one that does not move."""
    if a is None or b is None:
        return b or ([-x for x in a] if a else [ufl.as_ufl(0.0)] * 2)
    return add(b, -1.0, a)


def total(parts: Sequence[Expr]) -> Expr:
    """The sum of UFL scalars, without a zero to begin with."""
    return functools.reduce(lambda a, b: a + b, parts)


def add(a: Sequence[Expr], factor: Expr, b: Sequence[Expr]) -> list[Expr]:
    """A vector plus a factor times another one."""
    return [x + factor * y for x, y in zip(a, b, strict=True)]


def dot(a: Sequence[Expr], b: Sequence[Expr]) -> Expr:
    """The product of two vectors in the plane."""
    return a[0] * b[0] + a[1] * b[1]


def _displacement(motion: ForceStep, D: Sequence[Expr], numbers: Sequence[Expr]) -> StepCoordinate:
    """The displacement of a node along a fixed direction, the numbers."""
    start, path, rate = (dot(numbers, values) for values in (motion.start, D, motion.rates))
    return StepCoordinate(start, start + path, numbers, numbers, path, rate)


SLIDE = CoordinateKind("a slide", 1, 0, _slide, starts_at_zero=True)
ANGLE = CoordinateKind("an angle", 2, 0, _angle, starts_at_zero=True)
#: Of a line over points (`PointLaw.over`), with recorded forces.
LENGTH = CoordinateKind("a length", 1, 0, _slide, is_line=True)
#: Between two joints, a and b of one and of the other; numbers: ratio, value.
GEAR = CoordinateKind("a gear", 4, 2, _gear, starts_at_zero=True)
#: Of a node to the ground, with recorded forces.
DISPLACEMENT = CoordinateKind("a displacement", 2, 2, _displacement, True, is_line=True)
ROTATION = ANGLE._replace(name="a rotation", is_line=True)


# -- The length of a rope over circles in a step, with exact work and both momenta, in UFL ------


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
