"""Load steps: equilibria at growing load factors, and the control of their size."""

from __future__ import annotations

import numpy as np

from .audit import Stats
from .drive import LoadDrive
from .errors import StepError
from .initial import reference_state
from .model import Model
from .newton import Newton, StepFailed, StepSolution
from .state import State
from .stepping import Stepper

# A step may deviate from its prediction by the prediction's own size. Towards a limit point the
# load factor is a parabola of the displacements, and a step that ends on it deviates by just that;
# what deviates more has left the path for another one.
_FARTHEST = 1.0
# The work of the loads, by the mean of both ends of a step, and the energy gained may differ by
# this part of their sum. A response as the cube root of the load, that of a slack cable, gives
# 1/3; a jump from one path to another releases what the loads have done beyond the energy.
_UNBALANCED = 0.35
# Deviation and corrections below which a step may be followed by one twice as long.
_EASY_DEVIATION, _EASY_ITERATIONS = 0.25, 10
# Growth of the motion per load since the first step that tells of a limit point.
_GIVING_WAY = 4.0


class LoadStepper(Stepper):
    """Takes a model from load factor to load factor, which stand in its states for times.

    Parameters
    ----------
    model : Model
        The compiled scene.
    newton : Newton
        Solver for one step.
    drive : LoadDrive
        Loads and driven motions.
    stats : Stats
        Counts what is done.
    """

    drive: LoadDrive

    def __init__(self, model: Model, newton: Newton, drive: LoadDrive, stats: Stats):
        super().__init__(model, newton, drive, stats, max_halvings=0)
        self.time = drive.time
        #: Deviation of the last step from its prediction, relative to that, and its corrections.
        self.deviation, self.iterations = 0.0, 0
        #: Motion per load factor of the first and of the last step.
        self.response: list[float] = []

    def first_state(self) -> State:
        """Equilibrium without loads: the reference configuration, but for springs under tension.

        Returns
        -------
        State
            The state at load factor 0.

        Raises
        ------
        StepFailed
            If there is none near.
        """
        state = self.step(reference_state(self.model), 0.0)
        state.work = 0.0
        return state

    def begin(self, state: State, t1: float) -> float:
        """Set a load step.

        Parameters
        ----------
        state : State
            Its start.
        t1 : float
            Load factor at its end.

        Returns
        -------
        float
            Length of the step in time: any.
        """
        forms = self.model.forms
        forms.set_step(self.time, 0.0, state.q, state.v, state.a)
        forms.load_factor.value = t1
        self.model.reduction.begin(state.q, state.slides, 1.0)
        return 1.0

    def finish(
        self,
        state: State,
        t1: float,
        step: StepSolution,
        forces: tuple[np.ndarray, np.ndarray],
        places: np.ndarray,
    ) -> State:
        """State at the end of a load step, if that is on the path.

        Parameters
        ----------
        state : State
            Its start.
        t1 : float
            Load factor at its end.
        step : StepSolution
            The increment.
        forces : pair of (size,) float
            Dead forces at the start and at the end.
        places : (driven,) float
            Where driven motions are at the end.

        Returns
        -------
        State
            The end.

        Raises
        ------
        StepFailed
            If the step has left the path.
        """
        new = super().finish(state, t1, step, forces, places)
        predicted = self.size(step.predicted)
        self.iterations = step.iterations
        self.deviation = self.size(step.D - step.predicted) / (predicted or 1.0)
        if t1 != state.t:  # the first equilibrium, without loads, is on no path yet
            self._check_path(state, new, step.D)
            self.response = [*self.response[:1], predicted / abs(t1 - state.t)]
        return new

    def _check_path(self, old: State, new: State, D: np.ndarray) -> None:
        """Refuse a step that ends far from where the tangent leads, or whose work is not stored."""
        reason = ""
        if self.deviation > _FARTHEST:
            reason = (
                f"it ends {self.deviation:.2g} times as far from where the tangent leads as that "
                "is from its start, and so on another path"
            )
        energy, work = self._energy(new), new.work - old.work
        gained = energy - self._energy(old)
        rounding = 1e-14 * abs(D) @ (abs(self.model.forms.stiffness) @ abs(D))
        rounding += 1e-12 * abs(energy)
        if abs(gained - work) > _UNBALANCED * (abs(gained) + abs(work)) + rounding:
            reason = reason or (
                f"the loads do {work:.3g} J of work in it and {gained:.3g} J are gained, so that "
                "it is too long, or ends on another path"
            )
        if reason:
            raise StepFailed(reason, D, [])

    def _energy(self, state: State) -> float:
        model = self.model
        weight = 0.0 if model.weight is None else model.weight @ state.q
        springs = model.actuators.energy(state.q, state.slides)
        return model.forms.strain_energy(state.q) + springs - weight

    def size(self, D: np.ndarray) -> float:
        """Size of an increment (size,): a mean over the nodes, of displacements over the extent."""
        return float(np.sqrt(np.sum((D / self.model.unit) ** 2) / len(self.model.turns)))

    # -- Control of the load --------------------------------------------------------------------

    def raise_load(self, states: list[State], steps: int, max_cuts: int) -> None:
        """Raise the load factor to 1 in steps, halved where they fail and doubled where easy.

        Parameters
        ----------
        states : list of State
            The first state, to which the others are added.
        steps : int
            Steps where none is cut.
        max_cuts : int
            How often a step may be halved.

        Raises
        ------
        StepError
            If a step fails that may be halved no more.
        """
        longest = 2**max_cuts
        last, at, stride = steps * longest, 0, longest
        while at < last:
            goal = (at + stride) / last
            try:
                states.append(self.step(states[-1], goal))
            except StepFailed as failure:
                if stride == 1:
                    raise self.error(states[-1], goal, failure, max_cuts) from failure
                stride //= 2
                self.stats.halvings += 1
                continue
            at += stride
            self.stats.steps += 1
            easy = self.deviation <= _EASY_DEVIATION and self.iterations <= _EASY_ITERATIONS
            if easy and 2 * stride <= longest and at % (2 * stride) == 0:
                stride *= 2

    def error(self, state: State, goal: float, failure: StepFailed, cuts: int) -> StepError:
        """What to raise when a load step has failed."""
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
        return StepError(
            f"static: the step from load factor {state.t:.6g} to {goal:.6g} failed"
            f"{f' after {cuts} cuts' if cuts else ''}: {failure.reason}. "
            f"{self.largest(failure)}. {advice}",
            state.t,
        )
