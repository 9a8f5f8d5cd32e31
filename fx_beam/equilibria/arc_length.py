"""Arc-length continuation: equilibrium paths through limit points, up to the full load."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.polynomial import Polynomial
from scipy.sparse import csr_matrix

from fx_beam.errors import Failure, StepError
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.step.newton import ENERGY_FLOOR, SEARCHES, newton
from fx_beam.step.stepper import StepFailed, StepSolution

from .load_steps import LoadStepper, check_circles, corner_in
from .path_equations import PathEquations, Tangent, between

# -- Curves of solutions: steps along their tangents, and the places of events in a step --------
# Paths of equilibria and families of periodic motions are such curves; each has its own
# equations.


Point = TypeVar("Point")


def follow(
    point: Point,
    length: float,
    advance: Callable[[Point, float], tuple[Point, float]],
    shorter: Callable[[Point, float, Exception], float],
    failures: tuple[type[Exception], ...],
) -> Iterator[Point]:
    """Points of a curve behind the first one.

    `advance` takes a step of a length, and gives the point at its end and the length of the next
    one. If it fails, `shorter` gives the length with which it is taken again, or raises.
    """
    while True:
        try:
            point, length = advance(point, length)
        except failures as failure:
            length = shorter(point, length, failure)
            continue
        yield point


class Stretch(Generic[Point]):
    """Points of a curve by their distances along a tangent; each is computed once."""

    def __init__(self, take: Callable[[float], Point], points: dict[float, Point]):
        self._take, self.points = take, points

    def point_at(self, distance: float) -> Point:
        """The point at a distance."""
        if distance not in self.points:
            self.points[distance] = self._take(distance)
        return self.points[distance]


def root_between(
    measure: Callable[[float], float], low: float, high: float, tolerance: float
) -> float:
    """Where a measure changes its sign; ValueError if it has the same one at both ends."""
    # Imported here: most curves have no event, and the import takes time.
    from scipy.optimize import brentq

    return float(brentq(measure, low, high, xtol=tolerance))


@np.errstate(divide="ignore", invalid="ignore")
def root_near(places: np.ndarray, values: np.ndarray) -> float:
    """Root near zero of the polynomial through values at places; not finite if it has none."""
    polynomial = Polynomial(np.linalg.solve(np.vander(places, increasing=True), values))
    slope, root = polynomial.deriv(), 0.0
    for _ in range(20):
        root -= float(polynomial(root) / slope(root))
    return root


# -- The corrector of a step along a path: Newton's method for the unknowns and the load factor -


class Corrector:
    """Increments (y, l) from a state with R(y, l) = 0 and <normal, (y, l)> = distance.

    The predictor is a length along a tangent.
    """

    def __init__(self, path: PathEquations):
        self._path, self._failures = path, path.loop.failures

    def corrected(
        self, start: State, tangent: Tangent, length: float, normal: Tangent, distance: float
    ) -> tuple[StepSolution, float]:
        """The step, and its load factor l; StepFailed if Newton's method does not converge."""
        self._normal, self._distance = normal, distance
        for _ in range(SEARCHES):
            self._path.set_start(start)
            self._y, self._load = length * tangent.y, length * tangent.load
            self._D, self._sizes = length * tangent.D, list[float]()
            try:
                return self._solve(length * tangent.D), self._load
            except StepFailed as failure:
                last = failure
                if failure.kind != "members":  # those near to points are found in a search
                    raise
        raise last

    def _solve(self, predicted: np.ndarray) -> StepSolution:
        """The step from a predictor (size,)."""
        options = self._failures.options
        iterations, ended_by = newton(self._correct, options.tolerance, options.max_iterations)
        if not ended_by:
            raise self._failures.unconverged(self._D, self._sizes)
        r, load_slopes, dy, dload = self._last
        r = r + self._path.loop.equations.change(self._path.spread(dy, 0.0)) + dload * load_slopes
        self._failures.check_places(self._D, self._sizes)
        return StepSolution(self._D, self._y, r, iterations, ended_by, predicted)

    def _correct(self) -> tuple[float, bool]:
        """Size of a correction (dy, dl), and whether it may be round-off."""
        path, failures, normal = self._path, self._failures, self._normal
        (D, f, r, residual), load_slopes, column = path.balance(self._y, self._load)
        residual = residual[: len(self._y)]
        missing = path.along(normal, D, self._load) - self._distance
        dy, dload = path.solve(column, normal, -residual, -missing)
        correction = path.spread(dy, dload)
        factor = failures.shortening(correction)
        size = max((abs(correction) / path.model.units.nodes).max(), abs(dload))
        failures.check_finite(size, self._sizes)
        self._sizes.append(size)
        #: Forces (size,) at nodes before the correction, with their derivatives by the load factor.
        self._last = r, load_slopes, dy, dload
        self._y, self._load = self._y + factor * dy, self._load + factor * dload
        self._D = path.expand(self._y, self._load)
        failures.check_turn(self._D, self._sizes)
        return size, abs(residual @ dy) <= ENERGY_FLOOR * (abs(f) @ abs(self._D))


# -- Arc-length continuation: equilibrium paths through limit points, with an unknown load factor
# Keller's pseudo-arclength method: the predictor is a step of length ds along the unit tangent
# (D', l') of the path. The corrector stays in the plane normal to it,
#
#     R(y, l) = 0,    <D', D> + l' (l - l0) = ds,    <A, B> = mean over the nodes of A.B in units.
#
# The system bordered by this plane is regular at limit points. The angle between the tangents of
# two successive steps is acute; this gives the direction of a tangent. Where plastic flow starts,
# a contact closes or a law of springs has a kink, the path has a corner: a step ends there, and
# the next one goes along the tangent behind it.
#
# At a bifurcation the equations are singular in any plane: near it Newton's method may end on
# either path. No state is computed there. A step goes across, and a row at the point is
# interpolated from states on both sides.


# Turn, in terms of its target, at which a step is rejected.
_REJECTED = 4.0
# A step to a corner ends so far before it, relative to the step.
MARGIN = 1e-7
# Largest length of a step round a corner, relative to its length along the tangent.
_LONG = 2.0
# A corner nearer to the start or the end of a step than this part of it is there.
_NEAR = 1e-4
# Turn of a step without a corner.
_STRAIGHT = 0.01
# Slope of the load factor that is zero within rounding errors: a plastic mechanism.
FLAT = 1e-9
# Tolerance for the position of a limit point, relative to the step. Its load factor is far more
# accurate, since it is an extremum.
_PLACE = 1e-5
# Distance from the first state of a path, relative to a step, of a step that may close it.
_BESIDE = 0.1
# Distances, relative to a step, of states on both sides of a bifurcation; and how far from each
# other points on it may be that are interpolated from six of them, from four, or known.
_SIDES = 0.1 * np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
_ACROSS = 1e-3


@dataclass
class Advance:
    """A step along the path: its rows, the tangent at its end, its turn, number of corrections."""

    rows: list[State]
    ahead: Tangent
    turn: float
    corrections: int
    #: Load factor of a limit point in the step.
    limit: float | None = None
    #: Whether it ends where the path began.
    closes: bool = False


class ArcLength:
    """Follows the equilibrium path of a scene.

    Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
    """

    def __init__(self, stepper: LoadStepper):
        self.stepper, self.model, self._path = stepper, stepper.model, stepper.path
        self._failures = stepper.loop.failures
        # Gives the increments to where the path meets <normal, increment> = distance.
        self._correct = Corrector(self._path).corrected
        #: 1 where the load factor rises along the path, else -1.
        self.rising = 1.0
        #: Load factor at which a path ends.
        self.goal = 1.0

    def state_at(self, state: State, tangent: Tangent, distance: float) -> State:
        """State in the plane normal to a tangent at a distance along it; StepFailed if none."""
        step, load = self._correct(state, tangent, distance, tangent, distance)
        return self._end(state, state.t + load, step)

    def stiffness_at(self, state: State, tangent: Tangent, distance: float) -> csr_matrix:
        """The tangent K (n, n) in that state, for motions on along the path."""
        step, load = self._correct(state, tangent, distance, tangent, distance)
        self._path.balance(step.y, load)
        return self.stepper.loop.equations.tangent()

    # -- Steps ----------------------------------------------------------------------------------

    def advance(
        self, state: State, tangent: Tangent, ds: float, target: float, home: State | None
    ) -> Advance:
        """An arc-length step ds, at most to a limit point, load factor 1 or home on its way."""
        new, ahead = self.step(state, tangent, ds)
        turn = self._turn(state, new, tangent, ahead, ds)
        straight = turn <= _STRAIGHT and ahead.load * tangent.load > 0
        if self.model.kinks.any and ahead.sense != tangent.sense and not straight:
            # At a bifurcation it is so on the way back, too; where flow begins it is not.
            if self.at_start(new, tangent, -_NEAR * ds).sense == tangent.sense:
                raise StepFailed("off the path", "the path turns back", new.q - state.q)
        corrections = self.stepper.iterations
        if turn > _REJECTED * target:
            D = new.q - state.q
            corner = corner_in(self._path, D, new.t - state.t, tangent, ahead)
            known = corner is not None and corner.last <= _NEAR * ds
            if not known or ahead.sense != tangent.sense or self.stepper.is_singular(new, state):
                raise StepFailed("off the path", "the path deviates too far from its tangent", D)
            turn = target  # the path has a corner at the end of the step
        if home and (last := self._last_row(home, state, tangent, ds, new)):
            return Advance([last], ahead, turn, corrections, closes=True)
        limit = None
        if ahead.load * self.rising < -FLAT:
            limit, limit_tangent = self._limit_point(state, tangent, ds, target, (new, ahead))
            if limit_tangent is not None:
                new, ahead = limit, limit_tangent
        if new.t >= self.goal:
            new, limit = self._last_step(state, tangent), None
        rows = [new] if limit is None or limit is new else [limit, new]
        return Advance(rows, ahead, turn, corrections, None if limit is None else limit.t)

    def step(self, state: State, tangent: Tangent, ds: float) -> tuple[State, Tangent]:
        """State after an arc-length step ds along a tangent, and the tangent there."""
        step, load = self._correct(state, tangent, ds, tangent, ds)
        # The tangent of this step: at the start of the next one flow would not have begun.
        ahead = self._path.tangent(step.y, load, tangent)
        return self._finish(state, state.t + load, step), ahead

    def _turn(self, old: State, new: State, tangent: Tangent, ahead: Tangent, ds: float) -> float:
        """Turn of the path in a step, estimated from the tangents at its start and end."""
        if self._path.is_still(D := new.q - old.q):
            return 0.0
        gap = self._path.size(D - ds / 2 * (tangent.D + ahead.D)) / self._path.size(D)
        return max(self.stepper.deviation, 2 * gap)

    def _limit_point(
        self, state: State, tangent: Tangent, ds: float, target: float, end: tuple[State, Tangent]
    ) -> tuple[State, Tangent | None]:
        """Limit point in a step to an end, and the tangent there; none if it is a bifurcation."""
        # On a plateau, as of a plastic mechanism, the slope's sign is round-off.
        rate = tangent.load if abs(tangent.load) > FLAT else self.rising * FLAT
        if rate * end[1].load > 0:
            raise StepFailed("off the path", "the step contains two limit points", ds * tangent.D)
        ends = {0.0: (state, replace(tangent, load=rate)), ds: end}
        stretch = Stretch(lambda length: self.step(state, tangent, length), ends)

        def slope(length: float) -> float:
            return stretch.point_at(length)[1].load

        low, high, side = 0.0, ds, _SIDES[3] * ds
        while high - low > 2.1 * side:
            guess = low + slope(low) / (slope(low) - slope(high)) * (high - low)
            for place in (guess - side, guess + side):
                if low < place < high:
                    low, high = (place, high) if slope(place) * rate > 0 else (low, place)
        if stretch.point_at(low)[1].sense == stretch.point_at(high)[1].sense:
            root = root_between(slope, low, high, _PLACE * ds)
            if slope(root) * rate < 0:  # the row lies before the point, not behind by round-off
                root -= 2 * _PLACE * ds
            new, new_tangent = stretch.point_at(root)
            turn = self._turn(state, new, tangent, new_tangent, root)
            if self.model.kinks.any or turn <= _REJECTED * target:
                return new, new_tangent  # not at a bifurcation with two modes, which keeps the sign
        return self._extremum(state, tangent, (low + high) / 2, ds), None

    def _extremum(self, state: State, tangent: Tangent, middle: float, ds: float) -> State:
        """Where the load factor has an extremum near a distance: at a bifurcation."""
        steps = [self.step(state, tangent, place) for place in middle + ds * _SIDES]
        slopes = np.array([ahead.load for _, ahead in steps])
        return self._between(state, [new for new, _ in steps], root_near(_SIDES, slopes), ds)

    def _between(self, state: State, states: list[State], place: float, ds: float) -> State:
        """The state at a place, from states at _SIDES; StepFailed if they are not on one path."""
        new = between(states, _SIDES, place)
        other = between(states[1:-1], _SIDES[1:-1], place)
        if not self._path.length(new.q - other.q, new.t - other.t) <= _ACROSS * ds:
            reason = "states on both sides of a bifurcation are not on one path"
            raise StepFailed("off the path", reason, new.q - state.q)
        return replace(new, unstable_modes=state.unstable_modes)

    def _last_row(
        self, home: State, state: State, tangent: Tangent, ds: float, new: State
    ) -> State | None:
        """The first state of the path, if a step to a new one passes it on this path; or None."""
        path = self._path
        step, load = new.q - state.q, new.t - state.t
        way, rise = home.q - state.q, home.t - state.t
        length = path.length(step, load)
        part = (float(step @ (path.weight * way)) + load * rise) / length**2
        apart = path.length(way - part * step, rise - part * load)
        if not 0 <= part <= 1 or apart > _BESIDE * length:
            return None
        place = path.along(tangent, way, rise)
        states = [self.state_at(state, tangent, place + ds * side) for side in _SIDES]
        last = self._between(state, states, 0.0, ds)
        if path.length(last.q - home.q, last.t - home.t) > _ACROSS * ds:
            return None
        return replace(last, t=home.t, q=home.q)

    def _last_step(self, state: State, tangent: Tangent) -> State:
        """State at the goal, from the last state before it."""
        missing = self.goal - state.t
        level = Tangent(np.zeros_like(tangent.y), np.zeros_like(tangent.D), 1.0)
        step, _ = self._correct(state, tangent, missing / tangent.load, level, missing)
        return self._finish(state, self.goal, step)

    def _finish(self, state: State, t1: float, step: StepSolution) -> State:
        self.stepper.note(step)
        new = self._end(state, t1, step)
        if self.stepper.may_be_cut:
            check_circles(self.model, state, new)
        return new

    def _end(self, state: State, t1: float, step: StepSolution) -> State:
        """State at the end of a converged step."""
        new = self.stepper.loop.finished(state, Interval(state.t, t1), step.y, step.r)
        new.work += (1 - (state.t + t1) / 2) * float(self._path.held @ step.y)
        self.stepper.motions.note(new, self._path.bordered)
        return new

    def at_start(self, state: State, tangent: Tangent, ds: float = 0.0) -> Tangent:
        """The tangent at the start of a step, or a length ds from it along another one."""
        self._path.set_start(state)
        return self._path.tangent(ds * tangent.y, ds * tangent.load, tangent)

    # -- Corners --------------------------------------------------------------------------------

    def corner(
        self, state: State, tangent: Tangent, ds: float, target: float
    ) -> tuple[float, Advance | None] | None:
        """Distance of a corner in a step ds, and at 0 the step behind it; None without one.

        The tangent behind a corner has the same sense: one leaves by another way than one comes.
        """
        if not self.model.kinks.any:
            return None
        try:
            # Beyond the corner flow has begun.
            onwards = self.at_start(state, tangent, 2 * ds)
        except StepFailed:
            return None
        onwards = onwards if onwards.sense == tangent.sense else -onwards
        # From beyond the corner, where a contact has closed, or along it from the start.
        for way, length in ((tangent, 2 * ds), (onwards, ds)):
            try:
                step, load = self._correct(state, way, length, onwards, ds)
                ahead = self._path.tangent(step.y, load, onwards)
            except StepFailed:
                continue
            corner = corner_in(self._path, step.D, load, tangent, ahead)
            if corner and sum(corner) <= _LONG * ds and ahead.sense == tangent.sense:
                break
        else:
            return None
        if corner.first > _NEAR * ds:
            return corner.first, None
        new = self._finish(state, state.t + load, step)
        if new.t >= self.goal:
            new = self._last_step(state, onwards)
        if self._path.along(onwards, tangent.D, tangent.load) < 0:
            # Back on the way one has come, unless the tangent changes at the start.
            if self.at_start(state, tangent, 2 * _NEAR * ds).sense == tangent.sense:
                return None
        limit = state.t if ahead.load * self.rising < -FLAT else None
        return 0.0, Advance([new], ahead, target, step.iterations, limit)

    def error(self, state: State, failure: StepFailed) -> StepError:
        """Error of a step that failed after all cuts."""
        message = f"the step along the arc length from load factor {state.t:.6g} failed"
        advice = "Try more steps or cuts (max_cuts), and check the units of loads and stiffnesses"
        return self._failures.error(message, self.stepper.options.max_cuts, state, failure, advice)


# -- The equilibrium path of a scene up to its full load: lengths and ends of arc-length steps --


# Target deviation of a step from its tangent, relative to its length, for few load steps; on a
# circle it is half the angle of the step.
_TARGET = 0.1
# Target number of corrections in a step.
_CORRECTIONS = 10
# Load factor at which a path is abandoned. Of 43 arches that snap through, three reached load
# factors between -1 and -1.5 before their full load.
_LOWEST = -10.0
# Displacement, in sizes of the scene, from which on a path leads nowhere if the load factor rises
# along it by less than this part of its mean rise so far.
_FARTHEST, _LEVEL = 1e5, 0.01
# Change of the load factor in a step, relative to that of a load step, at which it is taken again.
# It is not if it is so short that this would not help.
_EXCESS, _SHORTEST = 1 + 1e-6, 1e-12
# Part of a step to a bifurcation, beyond which no step goes on, that is taken in its place.
_BEFORE = 0.7
# Smallest number of states of a closed path.
_ROUND = 6


class _TooLong(Exception):
    """The load factor changes more than in a load step; `length` is that of a shorter step."""

    def __init__(self, length: float):
        super().__init__(length)
        self.length = length


class PathFollowing:
    """Appends the states on a path from the last one to load factor 1.

    `load_steps` limits the length and the turn of a step. The first one goes along rising loads; or
    along a tangent, with a length. Such a path also ends where it returns to its first state.
    """

    def __init__(
        self,
        arc: ArcLength,
        states: list[State],
        start: tuple[Tangent, float] | None = None,
        part: float = 1.0,
    ):
        self._arc, self._states, self._start, self._part = arc, states, start, part
        self._stepper, self._options = arc.stepper, arc.stepper.options
        self._stats, self._home = arc.stepper.stats, states[0] if start else None
        # The error of the work is then of second order in the steps.
        self._target = min(_TARGET, 1 / self._options.load_steps)
        #: Cuts since the last step, and the least length of a step behind a corner.
        self._cuts, self._least_length = 0, 0.0
        #: Distance of a corner in the step that has failed.
        self._corner: float | None = None
        #: The state before the last one that was replaced.
        self._before_replaced: State | None = None

    def run(self) -> None:
        """Append the states."""
        if self._start is None:
            path = self._stepper.path
            path.set_start(self._states[-1])
            tangent = path.with_the_load(np.zeros(self._arc.model.reduction.free), 0.0)
            length = self._part / (self._options.load_steps * tangent.load)
        else:
            tangent, length = self._start
        self._arc.rising = 1.0 if tangent.load >= 0 else -1.0
        steps = self._steps(tangent, length)
        while not self._ends:
            try:
                next(steps)
            except StepError as error:
                if not (isinstance(error.__cause__, StepFailed) and self._may_be_replaced):
                    raise
                self._before_replaced, self._cuts = self._states[-2], 0
                steps = self._steps(*self._before(self._states.pop()))

    def _steps(self, tangent: Tangent, length: float) -> Iterator[object]:
        return follow(tangent, length, self._advance, self._shorter, (StepFailed, _TooLong))

    @property
    def _may_be_replaced(self) -> bool:
        """Whether the last state may be replaced by one at another distance from the one before."""
        states, fewest = self._states, 2 if self._start is None else 3
        is_new = len(states) >= fewest and states[-2] is not self._before_replaced
        return is_new and not self._stats.limit_points

    def _before(self, state: State) -> tuple[Tangent, float]:
        """Tangent and length of a step from the last state, not as far as to another one.

        A state at a bifurcation has no definite tangent from which to go on.
        """
        path, last = self._stepper.path, self._states[-1]
        path.set_start(last)
        tangent = path.with_the_load(np.zeros(self._arc.model.reduction.free), 0.0)
        return tangent, _BEFORE * path.length(state.q - last.q, state.t - last.t)

    @property
    def _ends(self) -> bool:
        states, stats, options = self._states, self._stats, self._options
        return (
            states[-1].t >= self._arc.goal
            or len(states) > options.max_steps
            or stats.closed
            or self._is_behind_limit_point
        )

    @property
    def _is_behind_limit_point(self) -> bool:
        limits, options = self._stats.limit_points, self._options
        stops = options.stop_at or options.continuation is None
        return bool(stops and limits and self._states[-1].t != limits[0])

    def _advance(self, tangent: Tangent, ds: float) -> tuple[Tangent, float]:
        """The tangent at the end of a step, and the length of the next one."""
        states, stats, steps = self._states, self._stats, self._options.load_steps
        step = self._step(tangent, ds)
        end = step.rows[-1]
        excess = steps * abs(end.t - states[-1].t)
        if excess > _EXCESS and ds > _SHORTEST:
            # Where the path gets stiffer, or bends away from a bifurcation.
            raise _TooLong(ds * min(0.9, 1 / excess))
        for row in step.rows:
            states.append(row)  # which a progress bar shows
        stats.closed = step.closes
        if step.limit is not None:
            self._arc.rising = -self._arc.rising
            stats.limit_points.append(step.limit)
        ahead = step.ahead
        if not self._is_behind_limit_point:
            self._check_way(end, ahead)
        ratio = min(self._target / max(step.turn, 1e-6), _CORRECTIONS / step.corrections)
        longer = max(ds * min(2.0, max(0.5, ratio)), self._least_length)
        # The load factor changes at most as much as in a load step, also if its slope grows.
        growth = (ahead.load - tangent.load) / ds
        slope = max(abs(ahead.load), abs(ahead.load + growth * longer), 1e-6)
        self._cuts, self._least_length = 0, 0.0
        return ahead, min(longer, 1 / (steps * slope))

    def _step(self, tangent: Tangent, ds: float) -> Advance:
        """A step from the last state, or one round a corner at it."""
        arc, states, target = self._arc, self._states, self._target
        back, self._corner = self._home if len(states) >= _ROUND else None, None
        self._stepper.may_be_cut = self._cuts < self._options.max_cuts
        try:
            step = arc.advance(states[-1], tangent, ds, target, back)
            if not step.closes:
                self._stepper.check(states[-1], step.rows[-1], int(step.limit is not None))
        except StepFailed:
            corner = arc.corner(states[-1], tangent, ds, target)
            if corner is None or corner[1] is None:
                self._corner = corner and corner[0]
                raise
            return corner[1]
        return step

    def _shorter(self, tangent: Tangent, ds: float, failure: Exception) -> float:
        """Length of a step in place of one that has failed; StepError after all cuts."""
        if isinstance(failure, _TooLong):
            self._least_length = 0.0
            return failure.length
        assert isinstance(failure, StepFailed)
        states, lost = self._states, self._cuts == self._options.max_cuts
        if not self._cuts and self._may_be_replaced:
            # From a bifurcation a shorter step would go along a branch.
            lost = lost or self._stepper.is_singular(states[-1], states[-2])
        if lost:
            raise self._arc.error(states[-1], failure) from failure
        self._cuts, self._stats.halvings = self._cuts + 1, self._stats.halvings + 1
        if self._corner is not None and not self._least_length:
            # From the corner on a step may be as long as the one that has failed.
            self._least_length = ds
            return (1 - MARGIN) * min(ds, self._corner)
        self._least_length = 0.0
        return ds / 2

    def _check_way(self, state: State, ahead: Tangent) -> None:
        """StepError if the load falls for ever, or no force is left that could carry more."""
        limits = self._stats.limit_points
        far = abs(state.q / self._arc.model.units.nodes).max()
        largest = max(map(abs, limits), default=0.0)
        level = far > _FARTHEST and ahead.load * far <= _LEVEL * abs(state.t)
        if state.t < _LOWEST:
            turned = ", ".join(f"{point:.6g}" for point in limits)
            since = f"after limit points at {turned} it has reached {state.t:.6g}"
            reason = f"does not return to load factor 1: {since}"
            advice = (
                "Other paths may lead there: try a simulation with dampers, or loads in other "
                "proportions"
            )
        elif level or max(abs(state.t), abs(ahead.load)) < FLAT * largest:
            reason = f"leads nowhere: at load factor {state.t:.6g} no force is left to carry more"
            advice = "What softens carries no more than the largest load factor: give less load"
        else:
            return
        advice = f"The path so far is in the error's `solution`. {advice}"
        raise StepError(
            Failure("off the path", f"static: the path {reason}", state.t, advice=advice)
        )
