"""A piece of a path of equilibria between two rows, and where a measure of it changes its sign."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.results.state import State
from fx_beam.scene.beam import lagrange
from fx_beam.step.step_failures import StepFailed

from .arc_length import ArcLength
from .branches import unknowns_of
from .continuation import Stretch, root_between, root_near
from .path_equations import Tangent, between
from .small_motions import Growing, SmallMotions

# Points so near to each other, relative to the step, are one with several modes.
SAME = 1e-6
FLUTTER, LIMIT_POINT, BIFURCATION = "flutter", "limit point", "bifurcation"
SMOOTH = LIMIT_POINT, BIFURCATION
# States at five distances before a point, of this part of the step each, are extrapolated: no state
# is computed so near to the point that the tangent is singular. They are nearer if another point is
# near: this part of its distance. Before, the point is known to this part of theirs.
_APART, _STATES, _OF_GAP, _PLACE = 0.01, 5, 0.1, 0.1
# The place of flutter, where the tangent is regular, relative to the step.
_FLUTTER = 1e-11
# Where an interval is divided: hardly ever where a point lies.
_SPLIT = 0.4871
# How far beyond the ends of a step one is sought, relative to the step.
_BESIDE_STEP = 0.05
# Where measures may jump: one is smooth if its extrapolation is wrong by less than so many times
# the interval; where smooth parts are short, states are so much nearer.
_SMOOTH, _CLOSE = 3.0, 0.01
# The place of a jump relative to the step; how near to it measures are looked at, and how far from
# zero they are there, relative to their values at the ends.
_JUMP, _BESIDE, _LARGE = 1e-11, 1e-8, 1e-4
# Slope of the load factor, relative to its rise from state to state, which is zero; more where it
# is extrapolated over more than one of their distances.
_FLAT = 0.04
# Distance from the end of a step, relative to it, that is no distance.
_SAME_END = 1e-9
# Where a step begins to flow; how exactly its end must be found again.
_FLOWING, _AGAIN = 1e-9, 1e-5


class PathInterval(Stretch[State]):
    """The path between two states, by the distance along its tangent at the first one.

    Where the path may have corners or branches, the straight way between them is the tangent.
    """

    def __init__(self, arc: ArcLength, motions: SmallMotions, first: State, second: State):
        stepper, self.model = arc.stepper, arc.model
        path, D, load = stepper.path, second.q - first.q, second.t - first.t
        self._arc, self.motions, self._start = arc, motions, first
        #: Whether measures may jump.
        self.kinked = self.model.kinks.any
        path.set_start(first)
        length = path.length(D, load)
        y = unknowns_of(self.model, first, D / length)
        self._tangent = Tangent(y, D / length, load / length)
        if not self.kinked:
            with suppress(StepFailed):  # it is singular: the piece starts at a bifurcation
                self._tangent = arc.at_start(first, self._tangent)
        self.length = path.along(self._tangent, D, load)
        #: Whether something flows in it, and where it begins: at the start itself nothing does.
        self.flows = self.model.kinks.flowed(first, second)
        self.first = _FLOWING * self.length if self.flows else 0.0
        ends = {0.0: first} | ({} if self.kinked else {self.length: second})
        super().__init__(lambda place: arc.state_at(first, self._tangent, place), ends)
        self._tangents: dict[float, csr_matrix] = {}
        with suppress(StepFailed):  # it is singular: the piece ends at a bifurcation
            self.point_at(self.length)
        gap = self.points.setdefault(self.length, second).q - second.q
        if not path.is_still(gap) and path.size(gap) > _AGAIN * path.size(D):
            reason = "its end depends on the way, as where materials creep, or others lie beside it"
            raise StepFailed("off the path", reason, D + gap)

    def stiffness(self, distance: float) -> csr_matrix:
        """The tangent K (n, n) at a distance; where something flows, for motions that go on."""
        if distance not in self._tangents:
            if self.flows:
                K = self._arc.stiffness_at(self._start, self._tangent, distance)
            else:
                K = self.motions.stiffness(self.point_at(distance))
            self._tangents[distance] = K
        return self._tangents[distance]

    def switched(self, low: float, high: float) -> State | None:
        """The state in which a contact between two distances opens or closes; None if unknown.

        The path may turn back there: it is extrapolated from states before.
        """
        arc, h = self._arc, _APART * self.length
        start = self._start if low < h else self.point_at(low)
        tangent = arc.at_start(start, self._tangent)
        signs, last = (np.sign(self.model.kinks.switches(s)) for s in (start, self.point_at(high)))
        changed = signs != last
        for side in (-h, h):
            distances = side * np.arange(_STATES)
            try:
                states = [start, *(arc.state_at(start, tangent, d) for d in distances[1:])]
            except StepFailed:
                continue
            values = np.array([self.model.kinks.switches(state) for state in states])
            if changed.any() and (np.sign(values) == signs).all():
                break
        else:
            return None
        roots = [root_near(distances / h, column) for column in values[:, changed].T]
        nearest = min(roots, key=abs)
        return between(states, distances / h, nearest) if abs(nearest) < 2 else None


@dataclass
class Root:
    """Where a mode becomes unstable."""

    place: float
    state: State
    #: The tangent (n, n) there; where it jumps, the tangent of the unstable side.
    stiffness: csr_matrix
    #: The kind of the point.
    kind: str
    #: Slope of the load factor there, relative to its mean slope in states before it.
    rise: float = 1.0


class Bracket(NamedTuple):
    """An interval of distances in which modes become unstable, or stable again."""

    low: float
    high: float
    #: How far apart states beside it should be; 0 for a jump at the start of the piece.
    apart: float
    #: The smaller and the larger number of modes that diverge; at flutter, of those that vibrate.
    few: int
    many: int
    flutter: bool = False
    #: The end at which more vibrate.
    growing: float = 0.0


class _Counted(NamedTuple):
    """A distance, and how many modes grow there."""

    distance: float
    growing: Growing


def brackets_of(piece: PathInterval, first_count: int, last_count: int) -> list[Bracket]:
    """Where the number of modes that grow changes, from its values in the rows before and after."""
    length, brackets = piece.length, list[Bracket]()

    def counted(distance: float) -> _Counted:
        growing = piece.motions.growing(piece.point_at(distance), piece.stiffness(distance))
        return _Counted(distance, growing)

    def intervals(low: _Counted, high: _Counted, exact: float) -> list[tuple[_Counted, _Counted]]:
        """Intervals in which the numbers change, by one mode if longer than SAME."""
        changed = sum(abs(a - b) for a, b in zip(low.growing, high.growing, strict=True))
        extent = high.distance - low.distance
        if changed == 0:
            return []
        if extent <= (exact if changed == 1 else min(exact, SAME * length)):
            return [(low, high)]
        try:
            middle = counted(low.distance + _SPLIT * extent)
            return [*intervals(low, middle, exact), *intervals(middle, high, exact)]
        except StepFailed:
            # So near to a point with several modes the tangent may be too singular for a state.
            if extent > exact:
                raise
            return [(low, high)]

    # A row may lie at a point.
    end_distance = _PLACE * _APART * length
    low, high = counted(piece.first), counted(length)
    if (count := sum(low.growing)) != first_count:
        if piece.kinked:
            few, many = sorted((first_count, count))
            brackets.append(Bracket(low.distance, length, 0.0, few, many))
        else:  # and another one just before it
            earlier = counted(low.distance - end_distance)
            is_before = sum(earlier.growing) == first_count
            low = earlier if is_before else counted(low.distance - _BESIDE_STEP * length)
    if abs((ahead := sum(high.growing)) - first_count) > abs(last_count - first_count):
        high = counted(length - end_distance)  # a limit point at its end is one of the next step
    elif ahead != last_count and not piece.kinked:
        high = counted(length * (1 + _BESIDE_STEP))
    places = intervals(low, high, end_distance)
    for first, last in places:
        gaps = [max(first.distance - b.distance, a.distance - last.distance) for a, b in places]
        apart = _OF_GAP * min([gap for gap in gaps if gap > SAME * length], default=length)
        apart = min(apart, _APART * length)
        meet = first.growing.vibrating != last.growing.vibrating
        for ends in intervals(first, last, _FLUTTER * length if meet else _PLACE * apart):
            before, after = (end.growing for end in ends)
            flutter = before.vibrating != after.vibrating
            which = 0 if flutter else 1
            numbers = {end.growing[which]: end.distance for end in ends}
            few, many = min(numbers), max(numbers)
            low_end, high_end = (end.distance for end in ends)
            brackets.append(Bracket(low_end, high_end, apart, few, many, flutter, numbers[many]))
    return brackets


def root_of(piece: PathInterval, measure: Callable[[float], float], bracket: Bracket) -> Root:
    """Where a measure changes its sign."""
    low, high = bracket.low, bracket.high
    if bracket.flutter:
        place = bracket.growing
        return Root(place, piece.point_at(place), piece.stiffness(place), FLUTTER)
    if not bracket.apart:
        if abs(measure(low)) > _LARGE * abs(measure(high)):
            return _jump(piece, measure, 0.0, low, high)
        # Round-off has put the row behind a limit point.
        apart = _APART * piece.length * (1 if piece.flows else -1)  # nothing flows back
        return _extrapolated(piece, measure, low, apart, abs(apart))
    guess, apart = (low + high) / 2, -bracket.apart
    if piece.flows and guess + _STATES * apart < piece.first:
        apart = -apart  # nothing flows back
    if not piece.kinked:
        return _extrapolated(piece, measure, guess, apart, _STATES * abs(apart))
    ends = [piece.first, piece.length]
    try:
        return _extrapolated(piece, measure, guess, apart, _SMOOTH * (high - low))
    except StepFailed:
        guess = root_between(measure, low, high, _JUMP * piece.length)
    side = _BESIDE * piece.length
    low, high = max(guess - side, piece.first), min(guess + side, piece.length)
    sizes = [abs(measure(place)) for place in (*ends, low, high)]
    if min(sizes[2:]) > _LARGE * max(sizes[:2]):
        return _jump(piece, measure, guess, low, high)
    apart *= _CLOSE
    return _extrapolated(piece, measure, guess, apart, _STATES * abs(apart))


def end_of(piece: PathInterval, measure: Callable[[float], float], reach: float) -> Root | None:
    """Where a function of the distance vanishes at the end of a smooth step, or so far beyond it.

    `reach` is relative to the step; None if it does not.
    """
    first, last = (measure(place) for place in (piece.first, piece.length))
    # The line through both values, and what a curve may differ from it.
    if abs(last) > 2 * (reach + _PLACE * _APART) * abs(last - first):
        return None
    apart = -max(_APART, min(reach, 1.0) / _STATES) * piece.length
    try:
        root = _extrapolated(piece, measure, piece.length, apart, (reach + _APART) * piece.length)
    except StepFailed:
        return None
    return root if 0 <= root.place / piece.length - 1 + _SAME_END <= reach + _SAME_END else None


def _jump(
    piece: PathInterval, measure: Callable[[float], float], place: float, low: float, high: float
) -> Root:
    """Where a measure jumps between two distances."""
    K, model = piece.stiffness(low if measure(low) < 0 else high), piece.model
    kind = "flow" if piece.flows else "kink"
    if model.kinks.switched(piece.point_at(low), piece.point_at(high)):
        kind = "contact" if model.kinks.has_contact else "kink"
    elif not (piece.flows or model.kinks.bend):
        step = piece.point_at(high).q - piece.point_at(low).q
        raise StepFailed("off the path", "the step reaches another path", step)
    state = None if piece.flows else piece.switched(low, high)
    return Root(place, piece.point_at(place) if state is None else state, K, kind)


def _extrapolated(
    piece: PathInterval,
    measure: Callable[[float], float],
    guess: float,
    apart: float,
    farthest: float,
) -> Root:
    """The root near a distance, extrapolated from states on one side, some length `apart`.

    StepFailed if it is farther away than `farthest`.
    """
    # There sorted eigenvalues are smooth, also if several vanish at once.
    distances = guess + apart * np.arange(1, _STATES + 1)
    values = np.array([measure(distance) for distance in distances])
    scaled = (distances - guess) / apart
    place = root_near(scaled, values)
    if not abs(place * apart) <= farthest:
        raise StepFailed("critical point", "the eigenvalue has no root", np.zeros(1))
    states = [piece.point_at(distance) for distance in distances]
    state = between(states, scaled, place)
    loads = np.array([state.t for state in states])
    slope = np.polynomial.Polynomial.fit(scaled, loads, _STATES - 1).deriv()(place)
    rise = abs(slope) * (_STATES - 1) / max(np.ptp(loads), np.finfo(float).tiny)
    kind = SMOOTH[int(rise > _FLAT * max(1.0, abs(place)))]
    if piece.flows:
        (shares,) = lagrange(scaled, np.array([place]))
        K = sum(w * piece.stiffness(d) for w, d in zip(shares, distances, strict=True))
    else:
        K = piece.motions.stiffness(state)
    return Root(guess + place * apart, state, K, kind, rise)
