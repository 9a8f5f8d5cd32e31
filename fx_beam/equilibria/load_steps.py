"""Load steps: equilibria at rising load factors, with a check that they are on the path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.laws.interval import Interval
from fx_beam.motions.contact_check import goes_through
from fx_beam.results.records import Stats
from fx_beam.results.state import State
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.load_loop import LoadLoop, StepSolution
from fx_beam.step.model import Model
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.step_failures import StepFailed

from .corners import has_corner
from .path_energy import PathEnergy
from .path_equations import PathEquations
from .small_motions import SmallMotions
from .static_options import StaticOptions

# Largest deviation of a step from its predictor, relative to the predictor. Near a limit point the
# load factor is a parabola of the displacements; a step that ends at the limit point has the
# deviation 1. A step with a larger deviation has reached another path.
_MAX_DEVIATION = 1.0
# On a stable path displacements along the loads grow with the loads: the energy gained in a step
# lies between the work of the dead loads at its start and the work of those at its end. These are
# fractions of this range, from its middle: a step within the first is short enough; a step within
# the second is on the path. A response as the cube root of the load, as of a slack cable, gives
# 1/2 for any first step; a step to a limit point gives 1/3; a short step over a snap-through gives
# more than 1.
_SHORT, _ON_PATH = 0.2, 1.0
# The same for driven motion and follower forces, as fractions of their work.
_SHORT_OTHER, _ON_PATH_OTHER = 0.1, 0.7
# Deviation of an easy step from its predictor.
EASY_DEVIATION = 0.25
# Growth of the displacement per load, from step to step, at which a step may turn off its path.
_TURN = 100.0


class LoadStepper:
    """Takes load steps; the states of a model have the load factor in place of time."""

    def __init__(self, forcing: LoadForcing, options: StaticOptions, stats: Stats):
        self.options, self.stats, self.model = options, stats, (model := forcing.model)
        model.forms.strain_energy(np.zeros(model.size))  # compiled beside the loop
        self.loop = LoadLoop(forcing, options.newton, stats)
        self.path, self.energies = PathEquations(self.loop), PathEnergy(self.loop)
        #: Deviation of the last step from its predictor, relative to this, and its corrections.
        self.deviation, self.iterations = 0.0, 0
        #: Whether a step may be cut: if its work is too inaccurate, or a point jumps over a circle.
        self.may_be_cut = False
        #: Holding forces (free,), besides the loads, at the start and the end of a step.
        self._hold: tuple[np.ndarray, np.ndarray] = (np.zeros(model.reduction.free),) * 2
        #: A state, and the slope (size,) of its path by the load factor.
        self._slope: tuple[State | None, np.ndarray] = None, np.empty(0)
        #: Displacement per load factor in the first and in the last step.
        self.response: list[float] = []
        #: Small motions about its states.
        self.motions = SmallMotions(self.loop)
        #: Raises StepFailed for two states between which no step of the path can be, beside a
        #: number of limit points.
        self.check: Callable[[State, State, int], None] = lambda old, new, limits: None
        #: The same for a step whose displacement per load is far larger than that of the last one.
        self.check_turn: Callable[[State, State], None] = lambda old, new: None

    def residual(self, state: State, factor: float) -> np.ndarray:
        """Forces (free,) that hold a state at a load factor."""
        return self.loop.balance(state, factor).residual[: self.model.reduction.free].copy()

    def held_at_nodes(self, state: State) -> np.ndarray:
        """Forces on nodes f (size,) with T^T f = (1 - l) `path.held`, in a state."""
        reduced_forces, model = (1 - state.t) * self.path.held, self.model
        if not reduced_forces.any():
            return np.zeros(model.size)
        self.motions.stiffness(state)  # the couplings are then those of this state
        maps, T = model.reduction.maps, self.motions.coupling()
        D = maps.dependence_matrix()[: len(reduced_forces), model.reduction.independent]
        return T @ pivoted_lu(T.T @ T).solve(D.T @ reduced_forces)

    def hold_between(self, start: float, end: float) -> None:
        """Set the forces that hold the start of the path, at both load factors of a step."""
        self._hold = (1 - start) * self.path.held, (1 - end) * self.path.held
        self.loop.hold[:] = self._hold[1]

    def step(self, state: State, goal: float) -> State:
        """State after one load step; StepFailed if it leaves the path."""
        interval = Interval(state.t, goal)
        new, step = self.loop.step(state, interval)
        new.work += float((self._hold[0] + self._hold[1]) @ step.y / 2)
        self.motions.note(new, self.loop)
        step = step._replace(predicted=self._predicted(state, step, interval.length))
        self.note(step)
        if self.deviation > EASY_DEVIATION and self.model.kinks.may_begin(state, new):
            self.deviation = 0.0
        response = self.response
        if interval.length:
            response = [*response[:1], self.path.size(step.predicted) / interval.length]
        self._check_path(state, new, step, len(response) == 2 and response[1] > response[0])
        if interval.length:
            self.check(state, new, 0)
            if len(response) == 2 and response[1] > _TURN * self.response[-1]:
                self.check_turn(state, new)
        self.response = response
        return new

    def _predicted(self, state: State, step: StepSolution, length: float) -> np.ndarray:
        """D (size,) of a step by the tangent at its start."""
        # Natural strains and virtual works of the end are in the first iteration.
        stiffening = self.model.data.natural or self.model.scene.virtual_works
        if not (stiffening and length):
            return step.predicted
        if self._slope[0] is not state:
            try:
                self.path.set_start(state)
                tangent = self.path.with_the_load(0 * step.y, 0.0)
                self._slope = state, tangent.D / tangent.load
            except StepFailed:
                return step.predicted
        return length * self._slope[1]

    def note(self, step: StepSolution) -> None:
        """Keep the deviation of a step from its predictor, and its number of corrections."""
        self.stats.add_solve(step.iterations, step.ended_by)
        self.iterations, size = step.iterations, self.path.size
        self.deviation = size(step.D - step.predicted) / (size(step.predicted) or 1.0)

    def _check_path(self, old: State, new: State, step: StepSolution, softer: bool) -> None:
        """Reject a step that deviates from its predictor, or whose work differs from its energy."""
        path, D = self.path, step.D
        loads = [self.loop.forcing.dead(t) for t in (old.t, new.t)]
        if path.is_still(D):
            return  # its deviation is a rounding error
        if self.may_be_cut:
            check_circles(self.model, old, new)
        work, gained, rounding = self.energies.work_and_gain(old, new, D)
        # Where a contact closes, the step is shorter than its predictor.
        snapped = softer and work > gained and path.size(D) > path.size(step.predicted)
        is_far, may_turn = not self.deviation <= _MAX_DEVIATION, not self.may_be_cut
        turns = (is_far or snapped) and may_turn and has_corner(path, old, new, step)
        if is_far and not turns:
            reason = (
                f"the step deviates from its predictor by {self.deviation:.2g} times the "
                "predictor's length, and so has reached another path"
            )
            raise StepFailed("off the path", reason, D)
        first, last = (F @ D + H @ step.y for F, H in zip(loads, self._hold, strict=True))
        other = work - (first + last) / 2
        short = self.may_be_cut or (snapped and not turns)
        allowed = (_SHORT if short else _ON_PATH) * abs(last - first) / 2
        allowed += (_SHORT_OTHER if short else _ON_PATH_OTHER) * abs(other)
        if not abs(gained - work) <= allowed + rounding:  # nor if it is not finite
            reason = (
                f"the loads do {work:.3g} J of work in it, but the energy rises by {gained:.3g} J: "
                "the step is too long or has reached another path"
            )
            raise StepFailed("off the path", reason, D)


def check_circles(model: Model, old: State, new: State) -> None:
    """Reject a step in which a point jumps deep into a circle of a contact, or through it."""
    q = np.reshape([old.q, new.q], (2, -1, 3))
    for obstacle in model.scene.contacts:
        nodes = model.mesh.nodes_of(model.scene, obstacle.target)
        if goes_through(obstacle, model.mesh.X, q, nodes):
            reason = f"a point jumps deep into the circle of {obstacle}, or through it"
            raise StepFailed("off the path", reason, new.q - old.q)
