"""Load steps: equilibria at rising load factors, with control of the step size; their options."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fx_beam.errors import StepError, flag, is_one_of, real, vector, whole
from fx_beam.laws.interval import Interval
from fx_beam.motions.contact_check import goes_through
from fx_beam.motions.initial_state import reference_state
from fx_beam.motions.options import CommonOptions
from fx_beam.results.records import Stats
from fx_beam.results.state import State
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.load_loop import LoadLoop, StepSolution
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.row_steps import RowSteps
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.step_failures import StepFailed
from fx_beam.step.substeps import MOST_HALVINGS

from .path_equations import PathEquations
from .small_motions import SmallMotions

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
# Largest deviation of half of the path behind a kink.
_OFF_KINK = 0.1
# The step is doubled at most at this deviation and this number of corrections.
_EASY_DEVIATION, _EASY_ITERATIONS = 0.25, 10
# Growth of the displacement per load, relative to the first step, that indicates a limit point.
_SOFTENING = 4.0


# Largest number of load steps.
_MOST_STEPS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class StaticOptions(CommonOptions):
    """Those of `static`; SceneError for all that can be refused without a scene."""

    what: str = "static"
    load_steps: int = whole(1, _MOST_STEPS, default=10)
    t: float = real(default=0.0)
    continuation: str | None = None
    max_cuts: int = whole(0, MOST_HALVINGS, default=8)
    max_steps: int = whole(1, _MOST_STEPS, default=1000)
    spin: float = real(default=0.0)
    pivot: Sequence[float] = (0.0, 0.0)
    branches: int = whole(0, 10, default=0)
    stop_at: str | None = None
    linear: bool = flag(default=False)

    def __post_init__(self):
        super().__post_init__()
        ok = self.continuation is None or is_one_of(self.continuation, ("arc-length",))
        self._require("continuation", ok, '"arc-length" or None')
        by_arc = self.continuation is not None and is_one_of(self.stop_at, ("limit point",))
        expected = '"limit point", with continuation="arc-length", or None'
        self._require("stop_at", self.stop_at is None or by_arc, expected)
        vector(self.pivot, 2, "static: pivot")


class LoadStepper:
    """Takes load steps; the states of a model have the load factor in place of time."""

    def __init__(
        self, forcing: LoadForcing, options: StaticOptions, stats: Stats, alone: bool = True
    ):
        self.forcing, self.options, self.stats = forcing, options, stats
        self.model = forcing.model
        self.model.forms.strain_energy(np.zeros(self.model.size))  # compiled beside the loop
        #: Takes load steps.
        self.loop = LoadLoop(forcing, options.newton, stats, alone)
        self.path = PathEquations(self.loop)
        #: Deviation of the last step from its predictor, relative to this, and its corrections.
        self.deviation, self.iterations = 0.0, 0
        #: Whether a step may be cut: if its work is too inaccurate, or a point jumps over a circle.
        self.may_be_cut = False
        #: Fraction of the loads at the end of the last step tried.
        self._goal = 0.0
        #: Holding forces (free,), besides the loads, at the start and the end of a step.
        self._hold: tuple[np.ndarray, np.ndarray] = (np.zeros(self.model.reduction.free),) * 2
        #: Whether loads act on the stiffness at once; a state and the slope of its path.
        self._stiffening = bool(self.model.natural or self.model.scene.virtual_works)
        self._ahead: tuple[State | None, np.ndarray] = None, np.empty(0)
        #: Displacement per load factor in the first and in the last step.
        self.response: list[float] = []
        #: Small motions about its states.
        self.motions = SmallMotions(self.loop)
        #: Raises StepFailed for two states between which no step of the path can be. Between them
        #: a number of critical points is known.
        self.check: Callable[[State, State, int], None] = lambda old, new, known: None

    def first_state(self) -> State:
        """The reference configuration. Forces that fade hold springs under tension there."""
        start = self.hold_reference()
        self.hold_between(0.0, 0.0)
        try:
            state = self.step(start, 0.0)
            if self.loop.singular:
                raise StepFailed("singular", "the tangent is singular", state.q - start.q)
        except StepFailed as failure:
            what = "without loads there is no equilibrium"
            advice = "Check for a part without support"
            raise self.loop.failures.error(what, 0, start, failure, advice) from failure
        state.work = 0.0
        return state

    def hold_reference(self) -> State:
        """The reference, where springs have yielded; what they lose is dissipated.

        Forces hold it that fade as the loads rise.
        """
        state = self._yielded(reference_state(self.model))
        self.path.held = self.residual(state, 0.0)
        return state

    def _yielded(self, state: State) -> State:
        if not self.model.points.width:
            return state
        y, forces = np.zeros(self.model.reduction.free), np.zeros(self.model.size)
        new = self.loop.finished(state, Interval(0.0, 0.0), y, forces)
        new.dissipated += self.energy(state) - self.energy(new)
        return new

    def residual(self, state: State, factor: float) -> np.ndarray:
        """Forces (free,) that hold a state at a load factor."""
        return self.loop.balance(state, factor).residual[: self.model.reduction.free].copy()

    def start_from(self, state: State) -> State:
        """A state as the start: the forces that hold it there fade as the loads rise."""
        loads = state.loads
        if loads is None:  # those at the end of a motion are not known
            loads = self.forcing.dead(1.0) + self.model.added_force(state, 1.0, self.forcing.time)
        # Virtual works may act at load factor 0 already.
        acting = self.model.added_force(state, 0.0, self.forcing.time)
        self.forcing.start_from(state, loads - acting)
        self.path.held = self.residual(state, 0.0)
        self.hold_between(0.0, 0.0)
        try:
            return replace(self.step(state, 0.0), work=state.work)
        except StepFailed as failure:
            what = "the state to start from is no equilibrium that the scene can hold"
            advice = "Check that the scene has the supports and joints of this state"
            raise self.loop.failures.error(what, 0, state, failure, advice) from failure

    def held_at_nodes(self, state: State) -> np.ndarray:
        """Forces (size,) on nodes that do the work of those that hold the start, in a state."""
        held, model = (1 - state.t) * self.path.held, self.model
        if not held.any():
            return np.zeros(model.size)
        self.motions.stiffness(state)  # the couplings are then those of this state
        T = model.reduction.coupling()[:, : len(held)]
        return T @ pivoted_lu(T.T @ T).solve(held)

    def hold_between(self, before: float, after: float) -> None:
        """Set the forces that hold the start, at both ends of a step."""
        self._hold = (1 - before) * self.path.held, (1 - after) * self.path.held
        self.loop.hold[:] = self._hold[1]

    def step(self, state: State, goal: float) -> State:
        """State after one load step; StepFailed if it leaves the path."""
        interval = Interval(state.t, goal)
        new, step = self.loop.step(state, interval)
        new.work += float((self._hold[0] + self._hold[1]) @ step.y / 2)
        self.motions.note(new, self.loop)
        step = step._replace(predicted=self._predicted(state, step, interval.length))
        self.note(step)
        if self.deviation > _EASY_DEVIATION and self.model.begins(state, new):
            self.deviation = 0.0
        response = self.response
        if interval.length:
            response = [*response[:1], self.size(step.predicted) / interval.length]
        self._check_path(state, new, step, len(response) == 2 and response[1] > response[0])
        if interval.length:
            self.check(state, new, 0)
        self.response = response
        return new

    def _predicted(self, state: State, step: StepSolution, length: float) -> np.ndarray:
        """What the tangent at the start predicts of a step."""
        # The first iteration has the natural strains, and virtual works, of the end.
        if not (self._stiffening and length):
            return step.predicted
        if self._ahead[0] is not state:
            try:
                self.path.begin(state)
                ahead = self.path.with_the_load(0 * step.y, 0.0)
                self._ahead = state, ahead.D / ahead.load
            except StepFailed:
                return step.predicted
        return length * self._ahead[1]

    def note(self, step: StepSolution) -> None:
        """Keep the deviation of a step from its predictor, and its number of corrections."""
        self.stats.add_solve(step.iterations, step.ended_by)
        self.iterations = step.iterations
        self.deviation = self.size(step.D - step.predicted) / (self.size(step.predicted) or 1.0)

    def is_still(self, D: np.ndarray) -> bool:
        """Whether an increment (size,) is zero within the tolerance of Newton's method."""
        return self.size(D) <= self.loop.failures.options.tolerance

    def _check_path(self, old: State, new: State, step: StepSolution, softer: bool) -> None:
        """Reject a step that deviates from its predictor, or whose work differs from its energy."""
        D, forces = step.D, [self.forcing.dead(t) for t in (old.t, new.t)]
        if self.is_still(D):
            return  # its deviation is a rounding error
        if self.may_be_cut:
            self.check_circles(old, new)
        kinked = functools.cache(lambda: self._has_kink(old, new, step))
        if self.deviation > _MAX_DEVIATION and not kinked():
            reason = (
                f"the step deviates from its predictor by {self.deviation:.2g} times the "
                "predictor's length, and so has reached another path"
            )
            raise StepFailed("off the path", reason, D)
        at_start, at_end = (F @ D + H @ step.y for F, H in zip(forces, self._hold, strict=True))
        work, gained, rounding = self.work_and_gain(old, new, D)
        other = work - (at_start + at_end) / 2
        # Where a contact closes, the step is shorter than its predictor.
        snapped = softer and work > gained and self.size(D) > self.size(step.predicted)
        short = self.may_be_cut or (snapped and not kinked())
        allowed = (_SHORT if short else _ON_PATH) * abs(at_end - at_start) / 2
        allowed += (_SHORT_OTHER if short else _ON_PATH_OTHER) * abs(other)
        if abs(gained - work) > allowed + rounding:
            reason = (
                f"the loads do {work:.3g} J of work in it, but the energy rises by {gained:.3g} J: "
                "the step is too long or has reached another path"
            )
            raise StepFailed("off the path", reason, D)

    def check_circles(self, old: State, new: State) -> None:
        """Reject a step in which a point jumps deep into a circle of a contact, or through it."""
        scene, mesh = self.model.scene, self.model.mesh
        q = np.reshape([old.q, new.q], (2, -1, 3))
        for obstacle in scene.contacts:
            if goes_through(obstacle, mesh.X, q, mesh.nodes_of(scene, obstacle.target)):
                reason = f"a point jumps deep into the circle of {obstacle}, or through it"
                raise StepFailed("off the path", reason, new.q - old.q)

    def _has_kink(self, old: State, new: State, step: StepSolution) -> bool:
        """Whether a step that can be cut no more goes along a path of two straight parts.

        The step along the first part and half of the second one must be on it as well, and the
        determinant of the tangent must keep its sign.
        """
        load = new.t - old.t
        if self.may_be_cut or not load or not self.model.nonsmooth:
            return False
        path = self.path
        try:
            path.begin(old)
            before, behind = path.with_the_load(0 * step.y, 0.0), path.with_the_load(step.y, load)
            legs = path.legs(step.D, load, before, behind)
            if legs is None or before.sense != behind.sense:
                return False
            between, ahead = legs[0] * before.load, legs[1] / 2 * behind.load
            middle = Interval(old.t, old.t + between + ahead)
            D = self.loop.step(old, middle)[1].D - legs[0] * before.D
        except StepFailed:
            return False
        half = legs[1] / 2 * behind.D
        return self.is_still(D - half) or self.size(D - half) <= _OFF_KINK * self.size(half)

    def work_and_gain(self, old: State, new: State, D: np.ndarray) -> tuple[float, float, float]:
        """Work of the loads in a step, energy that the scene gains [J], and round-off of both."""
        weight = 0.0 if self.model.weight is None else float(self.model.weight @ D)
        before, after = self.energy(old), self.energy(new)
        # Natural strains do work on forces whose rounding errors are those of places, not strains.
        sizes = abs(old.q) + abs(D) + self.model.unit * bool(self.model.natural)
        rounding = 1e-14 * self.loop.change_of_sizes(D, sizes)
        rounding += 1e-12 * (max(abs(before), abs(after)) + abs(new.work) + abs(weight))
        return new.work - old.work + weight, after - before, rounding

    def energy(self, state: State) -> float:
        """Stored and dissipated energy [J]."""
        model = self.model
        stored = model.forms.strain_energy(state.q, state.internal, state.natural)
        springs = model.points.energy(state.q, state.slides, state.spring_internal)
        return stored + springs + state.dissipated

    def in_members(self, state: State) -> float:
        """The largest force in a member, times the size of the scene, or couple [J]."""
        beams, recorder = self.model.forms.beams, Recorder(self.model, np.zeros(1), Record())
        if beams is None:
            return 0.0
        self.loop.record(state, recorder)
        with self.model.reading:
            N, Q, M = np.moveaxis(abs(beams.resultants(RowSteps(recorder).batch())), -1, 0)
        return float(max(self.model.mesh.size * max(N.max(), Q.max()), M.max()))

    def size(self, D: np.ndarray) -> float:
        """Root mean square of an increment (size,) over the nodes, in units of the scene."""
        scaled = D / self.model.unit
        return math.sqrt(scaled @ scaled / len(self.model.turns))

    # -- Control of the load --------------------------------------------------------------------

    def raise_load(self, states: list[State]) -> None:
        """Append the states from the last one to load factor 1; StepError if a step fails.

        A step is halved if it fails, and doubled after an easy step.
        """
        steps, longest = self.options.load_steps, 2**self.options.max_cuts
        last, stride = steps * longest, longest
        at = round(states[-1].t * steps) * longest
        while at < last:
            self._goal, self.may_be_cut = (at + stride) / last, stride > 1
            self.hold_between(at / last, self._goal)
            try:
                states.append(self.step(states[-1], self._goal))
            except StepFailed as failure:
                if stride == 1:
                    raise self._error(states[-1], failure) from failure
                stride //= 2
                self.stats.halvings += 1
                continue
            self.stats.steps += 1
            at += stride
            easy = self.deviation <= _EASY_DEVIATION and self.iterations <= _EASY_ITERATIONS
            if easy and 2 * stride <= longest and at % (2 * stride) == 0:
                stride *= 2

    def _error(self, state: State, failure: StepFailed) -> StepError:
        what = f"the step from load factor {state.t:.6g} to {self._goal:.6g} failed"
        advice = (
            'If the path has a limit point there, use continuation="arc-length". Otherwise try '
            "more steps, and check the units of loads and stiffnesses"
        )
        if len(self.response) == 2 and self.response[1] > _SOFTENING * self.response[0]:
            advice = (
                f"The displacement per load is {self.response[1] / self.response[0]:.3g} "
                "times that of the first step, which indicates a limit point. Use "
                'continuation="arc-length" to pass it'
            )
        if self.model.couplings.sliding:
            advice += (
                ". A node that slides on a slack cable moves far under a small load: find its "
                "place by a simulation with dampers. Elements longer than sqrt(EI / N), with the "
                "axial force N, hold it as friction would"
            )
        return self.loop.failures.error(what, self.options.max_cuts, state, failure, advice)
