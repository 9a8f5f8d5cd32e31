"""The equilibrium path of a scene up to its full load: lengths and ends of arc-length steps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.errors import Failure, StepError
from fx_beam.results.state import State
from fx_beam.step.step_failures import StepFailed

from .arc_length import FLAT, MARGIN, Advance, ArcLength
from .continuation import follow
from .path_equations import Tangent

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
        replaced = None
        while not self._ends:
            try:
                next(steps)
            except StepError as error:
                states, failed = self._states, isinstance(error.__cause__, StepFailed)
                may_be_replaced = len(states) > 2 and states[-2] is not replaced
                if not (failed and may_be_replaced) or self._stats.limit_points:
                    raise
                replaced, self._cuts = states[-2], 0
                steps = self._steps(*self._before(states.pop()))

    def _steps(self, tangent: Tangent, length: float) -> Iterator[object]:
        return follow(tangent, length, self._advance, self._shorter, (StepFailed, _TooLong))

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
        if self._cuts == self._options.max_cuts:
            raise self._arc.error(self._states[-1], failure) from failure
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
