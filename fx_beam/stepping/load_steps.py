"""Load steps: equilibria at growing load factors, and the control of their size."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from fx_beam.errors import StepError
from fx_beam.mechanics.interval import Interval
from fx_beam.model.model import Model
from fx_beam.results.audit import Stats
from fx_beam.results.state import State

from .forcing import LoadDrive
from .initial_state import reference_state
from .newton import NewtonOptions, StepFailed, StepSolution
from .single_step import SingleStep

# A step may deviate from its prediction by the prediction's own size. Towards a limit point the
# load factor is a parabola of the displacements, and a step that ends on it deviates by just that;
# what deviates more has left the path for another one.
_FARTHEST = 1.0
# On a stable path displacements along the loads grow with these: what is gained in a step lies
# between what the dead loads at its start and those at its end would do. The part of that range,
# from its middle, within which a step is short enough, and within which it may be on the path.
# A response as the cube root of the load, that of a slack cable, gives 1/2, however short the
# first step; a step to a limit point 1/3; one over a snap more than 1, if it is as short as that.
_SHORT, _ON_PATH = 0.2, 1.0
# The same for driven motion and for forces that follow, as parts of their work.
_SHORT_OTHER, _ON_PATH_OTHER = 0.1, 0.7
# Deviation and corrections below which a step may be followed by one twice as long.
_EASY_DEVIATION, _EASY_ITERATIONS = 0.25, 10
# Growth of the motion per load since the first step that tells of a limit point.
_GIVING_WAY = 4.0


class LoadStepper:
    """Takes a model from load factor to load factor, which stand in its states for times."""

    def __init__(self, model: Model, drive: LoadDrive, options: NewtonOptions, stats: Stats):
        self.model, self.drive, self.stats = model, drive, stats
        self.single = SingleStep(model, drive, options, stats)
        #: Deviation of the last step from its prediction, relative to that, and its corrections.
        self.deviation, self.iterations = 0.0, 0
        #: Whether a step that is too long for its work may be cut.
        self._may_be_cut = False
        #: Part of the loads, or of the tension of springs, at the end of the last step tried.
        self._goal = 0.0
        #: Generalised forces (free,) besides the loads, at the start and at the end of a step.
        self._hold: tuple[np.ndarray, np.ndarray] = (np.zeros(self.model.reduction.free),) * 2
        #: Motion per load factor of the first and of the last step.
        self.response: list[float] = []

    def first_state(self, steps: int, max_cuts: int) -> State:
        """Equilibrium without loads: the reference configuration, but for springs under tension.

        What is out of balance there is held by as much, which is let go in steps.
        """
        start = reference_state(self.model)
        equations = self.single.equations
        equations.begin(Interval(0.0, 0.0), start)
        balance = equations.at_start(np.zeros(self.model.size))
        tension = balance.residual[: self.model.reduction.free]
        if self.model.forms.has_added:
            start.added = self.model.forms.added_force()

        def let_go(state: State, before: float, after: float) -> State:
            self._hold = (1 - before) * tension, (1 - after) * tension
            self.single.newton.hold = self._hold[1]
            return self.step(state, 0.0)

        try:
            # All at once is enough where there is no tension, and else less safe than in steps.
            state = let_go(start, 0.0, 1.0)
            done = self.is_still(state.q)
        except StepFailed:
            done = False
        if not done:
            try:
                *_, state = self._in_steps(start, let_go, steps, max_cuts)
            except StepFailed as failure:
                raise self._error_of_first(failure, max_cuts) from failure
        self._hold = np.zeros_like(tension), np.zeros_like(tension)
        state.work = 0.0
        return state

    def step(self, state: State, goal: float) -> State:
        """State at a higher load factor, in one step; StepFailed if it leaves the path."""
        interval = Interval(state.t, goal)
        new, step = self.single.take(state, interval)
        new.work += float((self._hold[0] + self._hold[1]) @ step.y / 2)
        self.note(step)
        response = self.response
        if interval.length:
            response = [*response[:1], self.size(step.predicted) / interval.length]
        self._check_path(state, new, step, len(response) == 2 and response[1] > response[0])
        self.response = response
        return new

    def note(self, step: StepSolution) -> None:
        """Note how far a step is from its prediction, and what it took."""
        self.iterations = step.iterations
        self.deviation = self.size(step.D - step.predicted) / (self.size(step.predicted) or 1.0)

    def is_still(self, D: np.ndarray) -> bool:
        """Whether an increment (size,) is none, to the tolerance of Newton's method."""
        return self.size(D) <= self.single.newton.options.tolerance

    def _check_path(self, old: State, new: State, step: StepSolution, softer: bool) -> None:
        """Refuse a step that ends far from where the tangent leads, or whose work is not stored."""
        D, forces = step.D, self.drive.forces(Interval(old.t, new.t))
        if self.is_still(D):
            return  # what it would be judged by is rounding
        if self.deviation > _FARTHEST:
            reason = (
                f"it ends {self.deviation:.2g} times as far from where the tangent leads as that "
                "is from its start, and so on another path"
            )
            raise StepFailed("off the path", reason, D, [])
        at_start, at_end = (
            F @ D + hold @ step.y for F, hold in zip(forces, self._hold, strict=True)
        )
        weight = 0.0 if self.model.weight is None else self.model.weight @ D
        work, energy = new.work - old.work + weight, self._energy(new)
        other = work - (at_start + at_end) / 2
        gained = energy - self._energy(old)
        snapped = softer and work > gained
        short = self._may_be_cut or snapped
        moved = abs(old.q) + abs(D)
        rounding = 1e-14 * abs(D) @ (abs(self.model.forms.stiffness) @ moved) + 1e-12 * abs(energy)
        allowed = (_SHORT if short else _ON_PATH) * abs(at_end - at_start) / 2
        allowed += (_SHORT_OTHER if short else _ON_PATH_OTHER) * abs(other)
        if abs(gained - work) > allowed + rounding:
            reason = (
                f"the loads do {work:.3g} J of work in it and {gained:.3g} J are gained, so that "
                "it is too long, or ends on another path"
            )
            raise StepFailed("off the path", reason, D, [])

    def _energy(self, state: State) -> float:
        model = self.model
        springs = model.actuators.energy(state.q, state.slides)
        return model.forms.strain_energy(state.q) + springs

    def size(self, D: np.ndarray) -> float:
        """Size of an increment (size,): a mean over the nodes, of displacements over the extent."""
        return float(np.sqrt(np.sum((D / self.model.unit) ** 2) / len(self.model.turns)))

    # -- Control of the load --------------------------------------------------------------------

    def raise_load(self, states: list[State], steps: int, max_cuts: int) -> None:
        """Add the states from the last one to load factor 1, in `steps` where none is cut.

        One may be halved `max_cuts` times; a StepError if it still fails.
        """

        def raised(state: State, _: float, goal: float) -> State:
            return self.step(state, goal)

        try:
            for state in self._in_steps(states[-1], raised, steps, max_cuts):
                states.append(state)
                self.stats.steps += 1
        except StepFailed as failure:
            raise self._error(states[-1], failure, max_cuts) from failure

    def _in_steps(
        self,
        state: State,
        take: Callable[[State, float, float], State],
        steps: int,
        max_cuts: int,
    ) -> Iterator[State]:
        """States on the way from 0 to 1, in steps halved where they fail and doubled where easy."""
        longest = 2**max_cuts
        last, at, stride = steps * longest, 0, longest
        while at < last:
            self._goal, self._may_be_cut = (at + stride) / last, stride > 1
            try:
                state = take(state, at / last, self._goal)
            except StepFailed:
                if stride == 1:
                    raise
                stride //= 2
                self.stats.halvings += 1
                continue
            yield state
            at += stride
            easy = self.deviation <= _EASY_DEVIATION and self.iterations <= _EASY_ITERATIONS
            if easy and 2 * stride <= longest and at % (2 * stride) == 0:
                stride *= 2

    def _error_of_first(self, failure: StepFailed, cuts: int) -> StepError:
        what = "no equilibrium without loads was found"
        return self.single.error(
            f"{what} after {cuts} cuts" if cuts else what,
            0.0,
            failure,
            "Look for a part without support, or a spring far from its rest; up to "
            f"{self._goal:.3g} of their strain were tried",
        )

    def _error(self, state: State, failure: StepFailed, cuts: int) -> StepError:
        what = f"the step from load factor {state.t:.6g} to {self._goal:.6g} failed"
        advice = (
            'If the path has a limit point there, continuation="arc-length" passes it; otherwise '
            "try more steps, and look for a load or a stiffness in the wrong unit"
        )
        if len(self.response) == 2 and self.response[1] > _GIVING_WAY * self.response[0]:
            advice = (
                f"The motion per load has grown to {self.response[1] / self.response[0]:.3g} times "
                'that of the first step, as towards a limit point: continuation="arc-length" '
                "passes it"
            )
        return self.single.error(
            f"{what} after {cuts} cuts" if cuts else what, state.t, failure, advice
        )
