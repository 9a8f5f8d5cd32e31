"""Load steps: equilibria at rising load factors, and the corners of their path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fx_beam.errors import StepError, flag, is_one_of, real, vector, whole
from fx_beam.laws.interval import Interval
from fx_beam.motions.contact_check import goes_through
from fx_beam.motions.motion_setup import CommonOptions
from fx_beam.results.records import Stats
from fx_beam.results.state import State
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import RowSteps
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.step_control import MOST_HALVINGS
from fx_beam.step.stepper import LoadLoop, StepFailed, StepSolution

from .path_equations import PathEquations, SmallMotions, Tangent

# -- Options of paths of equilibria -------------------------------------------------------------


# Largest number of load steps.
_MOST_STEPS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class StaticOptions(CommonOptions):
    """Options of `static`; SceneError for all that can be refused without a scene."""

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
        is_arc = is_one_of(self.continuation, ("arc-length",))
        self._require("continuation", self.continuation is None or is_arc, '"arc-length" or None')
        stops = self.continuation is not None and is_one_of(self.stop_at, ("limit point",))
        expected = '"limit point", with continuation="arc-length", or None'
        self._require("stop_at", self.stop_at is None or stops, expected)
        vector(self.pivot, 2, "static: pivot")


# -- Energies of the states of a path, and what the loads do between them -----------------------


class PathEnergy:
    """Energies and member forces of states, and work in the steps between them [J]."""

    def __init__(self, loop: LoadLoop):
        self._loop, self._model = loop, loop.model

    def work_and_gain(self, old: State, new: State, D: np.ndarray) -> tuple[float, float, float]:
        """Work of the loads in a step, energy that the scene gains, and round-off of both."""
        model = self._model
        weight = 0.0 if model.masses.weight is None else float(model.masses.weight @ D)
        start, end = self.energy(old), self.energy(new)
        # Natural strains do work on forces whose rounding errors are those of places, not strains.
        sizes = abs(old.q) + abs(D) + model.units.nodes * bool(model.data.natural)
        rounding = 1e-14 * self._loop.change_of_sizes(D, sizes)
        rounding += 1e-12 * (max(abs(start), abs(end)) + abs(new.work) + abs(weight))
        return new.work - old.work + weight, end - start, rounding

    def energy(self, state: State) -> float:
        """Stored and dissipated energy of a state."""
        model = self._model
        stored = model.forms.strain_energy(state.q, state.internal, state.natural)
        springs = model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
        return stored + springs + state.dissipated

    def largest_force(self, state: State) -> float:
        """The largest force in a member, times the size of the scene, or couple."""
        beams, recorder = self._model.forms.beams, Recorder(self._model, np.zeros(1), Record())
        if beams is None:
            return 0.0
        self._loop.record(state, recorder)
        with self._model.lock:
            N, Q, M = np.moveaxis(abs(beams.resultants(RowSteps(recorder).batch())), -1, 0)
        return float(max(self._model.mesh.size * max(N.max(), Q.max()), M.max()))


# -- Corners of a path: where plastic flow starts, a contact closes or a law of springs has a kink
# A step round a corner consists of a part along the tangent before it and one along that behind
# it.


# Largest part of an increment beside the two tangents of a corner.
_BESIDE = 0.1
# Largest deviation of half of the path behind a corner from its tangent.
_BENT = 0.1


class Corner(NamedTuple):
    """Lengths of a step along the tangents before and behind a corner."""

    first: float
    last: float


def corner_in(
    path: PathEquations, D: np.ndarray, load: float, first: Tangent, last: Tangent
) -> Corner | None:
    """The corner round which an increment (D, l) goes; None if it is not a sum of two tangents.

    Only paths of scenes in which forces may have kinks have corners.
    """
    if not path.model.kinks.any:
        return None
    # Imported here: most paths have no corner, and the import takes time.
    from scipy.optimize import nnls

    root = np.append(np.sqrt(path.weight), 1.0)
    tangents = np.column_stack([root * np.append(t.D, t.load) for t in (first, last)])
    step = root * np.append(D, load)
    lengths, _ = nnls(tangents, step)
    rest = step - tangents @ lengths
    # Displacements alone as well: those of stiff scenes are small beside the load factor.
    fits = (np.linalg.norm(rest[:n]) <= _BESIDE * np.linalg.norm(step[:n]) for n in (-1, None))
    return Corner(*lengths) if all(fits) else None


def has_corner(path: PathEquations, old: State, new: State, step: StepSolution) -> bool:
    """Whether the path has a corner in a load step, and is straight on both sides of it.

    A step round the corner and half of the way behind it must be on the path as well, and the
    determinant of the tangent must keep its sign.
    """
    load = new.t - old.t
    if not (load and path.model.kinks.any):
        return False
    try:
        path.set_start(old)
        first, last = path.with_the_load(0 * step.y, 0.0), path.with_the_load(step.y, load)
        corner = corner_in(path, step.D, load, first, last)
        if corner is None or first.sense != last.sense:
            return False
        middle = old.t + corner.first * first.load + corner.last / 2 * last.load
        D = path.loop.step(old, Interval(old.t, middle))[1].D
    except StepFailed:
        return False
    half = corner.last / 2 * last.D
    rest = D - corner.first * first.D - half
    return path.is_still(rest) or path.size(rest) <= _BENT * path.size(half)


# -- Load steps: equilibria at rising load factors, with a check that they are on the path ------


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
# Cosine of the angle between a predictor and the increment of the last step, at which a step may
# turn off its path.
_TURN = 0.8


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
        #: Increment (size,) in the last step.
        self._last_D = np.zeros(model.size)
        #: Small motions about its states.
        self.motions = SmallMotions(self.loop)
        #: Raises StepFailed for two states between which no step of the path can be, beside a
        #: number of limit points.
        self.check: Callable[[State, State, int], None] = lambda old, new, limits: None
        #: Whether the tangent of a state is singular, beside that of a neighbour.
        self.is_singular: Callable[[State, State], bool] = lambda state, neighbour: False

    def residual(self, state: State, factor: float) -> np.ndarray:
        """Forces (free,) that hold a state at a load factor."""
        return self.loop.balance(state, factor).residual[: self.model.reduction.free].copy()

    def held_at_nodes(self, state: State) -> np.ndarray:
        """Forces on nodes f (size,) with T^T f = (1 - l) `path.held`, in a state."""
        reduced_forces, model = (1 - state.t) * self.path.held, self.model
        if not reduced_forces.any():
            return np.zeros(model.size)
        self.motions.extended(state)  # the couplings are then those of this state
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
            if self._turns(step.predicted) and self.is_singular(state, new):
                reason = "it starts at a bifurcation, where round-off leads it on"
                raise StepFailed("off the path", reason, step.D)
            self._last_D = step.D
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

    def _turns(self, D: np.ndarray) -> bool:
        """Whether a predicted increment D (size,) is at an angle to that of the last step."""
        last, length = self._last_D, self.path.length
        return bool(last @ (self.path.weight * D) < _TURN * length(last, 0.0) * length(D, 0.0))

    @property
    def softens(self) -> bool:
        """Whether the displacement per load has grown as it does before a limit point."""
        return len(self.response) == 2 and self.response[1] > _SOFTENING * self.response[0]

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


# -- The equilibrium path of a scene up to its full load, by steps of the load factor -----------


# The step is doubled at most at this number of corrections.
_EASY_ITERATIONS = 10
# Growth of the displacement per load, relative to the first step, that indicates a limit point.
_SOFTENING = 4.0


def raise_load(stepper: LoadStepper, states: list[State]) -> None:
    """Append the states from the last one up to load factor 1; StepError after all cuts.

    A step is halved if it fails, and doubled after an easy one; `load_steps` limits its length. One
    that starts or ends at a bifurcation goes over it.
    """
    longest = stride = 2**stepper.options.max_cuts
    # Load factors are multiples of 1/count.
    count = stepper.options.load_steps * longest
    place = round(states[-1].t * stepper.options.load_steps) * longest
    while place < count:
        end = place + min(stride, longest - place % longest)
        goal = end / count
        stepper.may_be_cut = stride > 1
        stepper.hold_between(place / count, goal)
        try:
            states.append(stepper.step(states[-1], goal))
        except StepFailed as failure:
            if stride == 1:
                if (reached := _stepped_over(stepper, states, end, count)) is None:
                    raise _error(stepper, states[-1], goal, failure) from failure
                place = reached
                continue
            stepper.stats.halvings += 1
            stride //= 2
            continue
        place = end
        easy = stepper.deviation <= EASY_DEVIATION and stepper.iterations <= _EASY_ITERATIONS
        if easy and 2 * stride <= longest and place % (2 * stride) == 0:
            stride *= 2


def _stepped_over(stepper: LoadStepper, states: list[State], place: int, count: int) -> int | None:
    """Place that a step over a bifurcation reaches, in place of the last states; or None.

    Near the bifurcation round-off is large: a step that fails is taken again, twice as long. A
    longer one must change the number of unstable modes; else it may have reached another path.
    """
    first, reach = len(states) - 2, 1
    while first >= 0 and reach <= 2**stepper.options.max_cuts:
        goal = min(place + reach, count)
        stepper.may_be_cut = reach > 1
        stepper.hold_between(states[first].t, goal / count)
        try:
            new, old = stepper.step(states[first], goal / count), states[first]
            if reach == 1 or stepper.motions.count(new, old) != old.unstable_modes:
                states[first + 1 :] = [new]
                return goal
        except StepFailed:
            if stepper.softens:
                break
        reach *= 2
        while first > 0 and states[first].t * count > place - reach:
            first -= 1
    return None


def _error(stepper: LoadStepper, state: State, goal: float, failure: StepFailed) -> StepError:
    response, most = stepper.response, stepper.options.max_cuts
    message = f"the step from load factor {state.t:.6g} to {goal:.6g} failed"
    advice = (
        'If the path has a limit point there, use continuation="arc-length". Otherwise try '
        "more steps or cuts (max_cuts), and check the units of loads and stiffnesses"
    )
    if stepper.softens:
        advice = (
            f"The displacement per load is {response[1] / response[0]:.3g} times that of the first "
            'step, which indicates a limit point. Use continuation="arc-length" to pass it'
        )
    if state.unstable_modes:
        advice = (
            "The path is unstable before it, as of a strip that is pushed far beyond its buckling "
            "load. Fewer load steps, a larger load to one side, or places a little to that side "
            "may lead it to the stable one"
        )
    if stepper.model.couplings.sliding:
        advice += (
            ". A node that slides on a slack cable moves far under a small load: find its place by "
            "a simulation with dampers. Elements longer than sqrt(EI / N), with the axial force N, "
            "hold it as friction would"
        )
    return stepper.loop.failures.error(message, most, state, failure, advice)
