"""Arc-length continuation: equilibrium paths through limit points, with an unknown load factor.

Keller's pseudo-arclength method: the predictor is a step of length ds along the unit tangent
(D', l') of the path. The corrector stays in the plane normal to it,

    R(y, l) = 0,    <D', D> + l' (l - l0) = ds,    <A, B> = mean over the nodes of A.B in units.

The system bordered by this plane is regular at limit points. The angle between the tangents of two
successive steps is acute; this gives the direction of a tangent. Where plastic flow starts, a
contact closes or a law of springs has a kink, the path has a corner: a step ends there, and the
next one goes along the tangent behind it.

At a bifurcation the equations are singular in any plane: near it Newton's method may end on either
path. No state is computed there. A step goes across, and a row at the point is interpolated from
states on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.errors import StepError
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.step.load_loop import StepSolution
from fx_beam.step.step_failures import StepFailed

from .continuation import Stretch, root_between, root_near
from .corners import corner_in
from .corrector import Corrector
from .load_steps import LoadStepper, check_circles
from .path_equations import Tangent, between

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
            if corner is None or corner.last > _NEAR * ds or ahead.sense != tangent.sense:
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

    def _correct(
        self, state: State, tangent: Tangent, length: float, normal: Tangent, distance: float
    ) -> tuple[StepSolution, float]:
        """Increments to where the path meets <normal, increment> = distance.

        The predictor is a length along the tangent. StepFailed if it does not converge.
        """
        return Corrector(self._path, state, normal, distance).corrected(tangent, length)

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
