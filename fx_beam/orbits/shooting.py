"""Periodic motions by shooting: variables, the state after a period, and Newton's method."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.linalg
import scipy.sparse.linalg

from fx_beam.errors import SceneError, StepError, as_float, between, real, whole
from fx_beam.laws.schemes import Scheme
from fx_beam.linear.linearisation import check_unknowns
from fx_beam.motions import motion_setup
from fx_beam.motions.contact_check import check_ropes
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.motion_setup import CommonOptions, MotionSetup, Options, check_scene, prepare
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.step.fitted_rates import Arrays
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.model import Model, fact, massless_dofs
from fx_beam.step.newton import newton
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.state_vector import energy_of
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

# -- Variables of a state in periodic motions: positions, rates and what steps remember ---------


_Value = TypeVar("_Value", float, np.ndarray)
# Change of variables in differences of the energy.
_STEP = 1e-6


class Directions(NamedTuple):
    """Changes of a state, one for each of its variables, in units of their scales."""

    #: Changes (n, ...) of what steps read, by name.
    changes: dict[str, np.ndarray]
    #: Changes (rows, n) in the order of `Variables.rows_of`, over the scales.
    matrix: np.ndarray
    #: Numbers (n,) of the rows that are variables; others follow to close loops.
    independent: np.ndarray
    scale: np.ndarray


class Variables:
    """The variables of the states of a model; errors name the `caller`."""

    def __init__(self, model: Model, caller: str):
        self.model, self._what = model, caller
        fixed = [3 * node + i for node, i in model.scene.fixed]
        #: Rates that steps keep: of what has mass and moves.
        self._rates = np.setdiff1d(np.flatnonzero(~fact(model, massless_dofs)), fixed)

    @property
    def count(self) -> int:
        """Number of rows of a state."""
        return self.movable + sum(self.inside.values())

    @property
    def remembers(self) -> bool:
        """Whether steps depend on earlier ones: by the scheme, or by friction of joints."""
        return self.model.forms.keeps_previous or len(self.model.points.normal_forces) > 0

    @property
    def are_rates(self) -> np.ndarray:
        """Flags (rows,) of the rows of a state that are rates."""
        rows = np.arange(self.count)
        return (rows >= self.model.reduction.free) & (rows < self.movable)

    @property
    def movable(self) -> int:
        """Number of rows of positions and rates."""
        return self.model.reduction.free + len(self._rates)

    def rows_of(self, state: State) -> np.ndarray:
        """Positions, rates and what steps remember of a state, in one row."""
        remembered = {name: _remembered(state, name).ravel() for name in self.inside}
        return self.rows(vars(state) | remembered, remembered)

    def rows(self, arrays: Arrays, remembered: Iterable[str]) -> np.ndarray:
        """Rows (..., rows) from arrays by name, with some of what steps remember."""
        y = self.model.couplings.unknowns(arrays["q"], arrays["slides"])
        parts = [y, arrays["v"][..., self._rates], *(arrays[name] for name in remembered)]
        return np.concatenate(parts, axis=-1)

    def scales(self, state: State, period: float) -> np.ndarray:
        """Units of the rows: of the scene, and of rates in a period."""
        model = self.model
        rates = 2 * np.pi / period * model.units.nodes[self._rates]
        units = {name: np.ones(size) for name, size in self.inside.items()}
        if model.forms.keeps_previous:
            units["q previous"] = model.units.nodes
        if len(model.points.normal_forces):  # forces are large
            units["spring internal"] = np.maximum(1.0, abs(_remembered(state, "spring internal")))
        return np.concatenate([model.units.unknowns, rates, *units.values()])

    def directions(self, state: State, length: float) -> Directions:
        """Changes of all variables at a state, which keep joints and loops closed."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        if reduction.singularity:
            raise SceneError(f"{self._what}: {reduction.singularity}. Start from another state")
        free, scale = reduction.free, self.scales(state, length)
        independent = np.concatenate([reduction.independent, np.arange(free, len(scale))])
        y, n = len(reduction.independent), len(independent)
        matrix = np.zeros((len(scale), n))
        columns = reduction.maps.dependence_matrix().toarray()[:free, independent[:y]]
        columns = columns * scale[independent[:y]]
        matrix[:free, :y], matrix[independent[y:], np.arange(y, n)] = columns, scale[free:]
        rows = matrix.T
        changes = {"slides": model.couplings.free_slides(rows[:, :free], model.scene.joint_count)}
        changes["v"] = np.zeros((n, model.size))
        changes["v"][:, self._rates] = rows[:, free : self.movable]
        first = self.movable
        for name, size in self.inside.items():
            changes[name], first = rows[:, first : first + size], first + size
        spread = reduction.maps.coupling()[:, independent[:y]].toarray() * scale[independent[:y]]
        changes["q"] = np.vstack([spread.T, np.zeros((n - y, model.size))])
        return Directions(changes, matrix / scale[:, None], independent, scale)

    @property
    def inside(self) -> dict[str, int]:
        """Numbers of what steps remember, by their names in the layout.

        Internal variables of members and of springs, and the configuration a step before.
        """
        members, springs = int(np.prod(self.model.forms.internal_shape)), self.model.points.width
        previous = self.model.size * self.model.forms.keeps_previous
        sizes = {"internal": members, "spring internal": springs, "q previous": previous}
        return {name: size for name, size in sizes.items() if size}

    def closing(self, state: State, gaps: np.ndarray) -> dict[str, np.ndarray]:
        """Changes (m, ...) by name of the unknowns that close gaps (m, closures) of loops."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        assert (loops := reduction.loops) is not None
        y, following = np.zeros((len(gaps), reduction.free)), reduction.following
        G = reduction.maps.closure_derivatives()[:, reduction.joints.configuration.following]
        closing = -scipy.sparse.linalg.splu(G.tocsc()).solve((gaps * loops.lengths).T)
        y[:, following] = closing.T * loops.unit[following]
        q, (columns, dofs, _, _) = np.zeros((len(gaps), model.size)), model.couplings.free_columns
        q[:, dofs] = y[:, columns]
        return {"q": q, "slides": model.couplings.free_slides(y, model.scene.joint_count)}

    def moved(self, state: State, directions: Directions, amounts: np.ndarray) -> State:
        """The state after a change of its variables: amounts (n,) of the directions."""
        y = (directions.matrix @ amounts * directions.scale)[: self.model.reduction.free]
        changed = {"v": state.v + amounts @ directions.changes["v"]}
        for name in self.inside:
            values = _remembered(state, name)
            change = (amounts @ directions.changes[name]).reshape(values.shape)
            changed[name.replace(" ", "_")] = values + change
        return self.shifted(state, y).changed(**changed)

    def shifted(self, state: State, y: np.ndarray) -> State:
        """The state after a change of its unknowns (free,)."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        q = state.q + reduction.increment(y, np.zeros(reduction.driven))
        slides = state.slides + model.couplings.free_slides(y, model.scene.joint_count)
        return state.changed(q=q, slides=slides)

    def energy(self, state: State) -> float:
        """Energy of scene and constant loads, zero in the reference configuration [J]."""
        energy, loads = energy_of(self.model, state), self.model.data.loads
        return energy - float(loads.sum_at(0.0) @ state.q) if loads.constant else energy

    def slope_of_energy(self, state: State, directions: Directions) -> np.ndarray:
        """Derivatives (n,) of the energy along directions, by differences."""

        def derivative(unit: np.ndarray) -> float:
            return slope(lambda x: self.energy(self.moved(state, directions, x * unit)), _STEP)

        return np.array([derivative(unit) for unit in np.eye(directions.matrix.shape[1])])


def slope(function: Callable[[float], _Value], h: float) -> _Value:
    """The derivative at zero, by a central difference."""
    low, high = function(-h), function(h)
    return (high - low) / (2 * h)


def _remembered(state: State, name: str) -> np.ndarray:
    """An array that steps remember, by its name in the layout; before a first step q is at rest."""
    values = getattr(state, name.replace(" ", "_"))
    return state.q if values is None else values


# -- The state after a period as a function of that before, and its derivatives (monodromy matrix)


#: Longest step along a family by default.
STEP = 0.25
# Relative change of a period for differences of states by it.
_CHANGE = 1e-6
# Functions of time that differ by less, relative to their size, repeat themselves.
_REPEATS = 1e-8
# Directions that are followed at once: their numbers stay in the cache.
_AT_ONCE = 64
# Largest number of variables of a state, for which the monodromy matrix has all columns.
_MOST = 2000
_NOTHING = Record(every=10**9, motion=False, rates=False, forces=False)
# Motions that are smaller, in units of the scene, are none.
_AT_REST = 1e-10
# Distance of a motion from its start at which it comes back, relative to the largest.
_CLOSE = 0.2
# Least number of steps in which it is looked for.
_FINE = 200
# So many times the steps show whether a motion repeats itself within a period: where it comes back
# to this part of its size.
_FINER, _SAME = 4, 0.03
_TIME_FUNCTIONS = "loads", "driven", "follower force", "parameters", "naturals"


@dataclass(frozen=True, kw_only=True)
class PeriodicOptions(CommonOptions):
    """Options of periodic motions and their families."""

    scheme: Scheme | None = None
    steps: int = whole(9, default=201)
    tolerance: float = between(0, 1, default=1e-9)
    amplitude: float | None = real("positive", optional=True, default=None)
    energy: float | None = real(optional=True, default=None)
    #: Longest step along a family, relative to the size of its motions, and most of these.
    step: float = STEP
    most: int = whole(1, default=1)

    def __post_init__(self):
        super().__post_init__()
        expected = "an odd whole number from 9 on: what alternates from step to step then fades"
        self._require("steps", self.steps % 2 == 1, expected)
        self._require("step", 0 < as_float(self.step) <= 1, "a number between 0 and 1")
        if self.amplitude is not None and self.energy is not None:
            raise SceneError(f"{self.what}: give the amplitude or the energy: each sets the other")
        self.__dict__["step"] = as_float(self.step)


class Period(NamedTuple):
    """A motion over a period, from a state on."""

    start: State
    #: The number on which it depends: its length [s], or the frequency of the loads.
    parameter: float
    length: float
    #: The state at its end, as the start of the next period: without full turns.
    end: State
    #: Rows (rows,) at the end less those at the start, the largest distance of a row from the
    #: start, and the changes (rows,) in the first and in the last step; over the scales.
    gap: np.ndarray
    size: float
    way: np.ndarray
    #: Energy that dampers and friction took [J].
    lost: float

    @property
    def moves(self) -> bool:
        """Whether there is a motion."""
        return self.size > _AT_REST

    @property
    def error(self) -> float:
        """Distance of the states before and after the period, relative to the motion."""
        return float(np.linalg.norm(self.gap)) / (self.size if self.moves else 1.0)


class Shooting:
    """Motions of a scene over a period of an odd number of steps; the parameter is its length.

    In an odd number what alternates from step to step, such as rates that joints do not allow, has
    the multiplier -1: periodic motions have the part of it that does not alternate.
    """

    def __init__(
        self,
        scene: Scene,
        options: PeriodicOptions,
        prepare: Callable[[Scene, Options], MotionSetup] = prepare,
    ):
        check_scene(scene, caller := options.what)
        self.options, self.steps, self.what = options, int(options.steps), caller
        steps = {"scheme": options.scheme, "newton": options.newton, "max_halvings": 0}
        self.prepared = prepare(scene, Options(what=caller, **steps))
        self.model = model = self.prepared.model
        check_unknowns(model, caller)
        loop = self.prepared.loop
        assert loop is not None
        #: The steps of the last run, and what follows their derivatives.
        self.derivatives = TapeDerivatives(loop.problem, "JVP")
        self.tape = loop.tape = Tape(loop.problem)
        self.variables = Variables(model, caller)
        if (n := self.variables.count) > _MOST:
            raise SceneError(
                f"{caller}: a state has {n} variables, and the time for derivatives by all of them "
                f"grows with their square. Use fewer elements, for at most {_MOST}"
            )

    def check_free(self) -> None:
        """Refuse what takes energy from any motion, if no loads give it back."""
        if self.variables.remembers:
            friction = len(self.model.points.normal_forces)
            loss = "friction of joints" if friction else self.model.scheme.name
            raise SceneError(
                f"{self.what}: {loss} takes energy from a free motion, which then does not "
                "repeat itself. Use EnergyMomentum without friction, or give loads"
            )

    # -- States ---------------------------------------------------------------------------------

    def first_state(self, start: Solution | None, dt: float) -> State:
        """The state from which a scene starts, or that at the end of a solution."""
        return self._at_start(self.prepared.first_state(dt, start))

    def _at_start(self, state: State) -> State:
        """The state at the begin of a period, before any work."""
        zero = dict.fromkeys(("work", "dissipated", "numerical", "impact"), 0.0)
        state = state.changed(past=None, parts=None, fitted=None, **zero)
        if self.model.couplings.driven:
            positions = self.prepared.forcing.positions(state.t)
            state = state.changed(motors=positions[len(self.model.prescribed) :])
        return state

    # -- Motions --------------------------------------------------------------------------------

    def length_of(self, parameter: float) -> float:
        """Length of a period [s], by the parameter."""
        return parameter

    def run(self, state: State, parameter: float) -> Period:
        """The motion over a period; StepError if a step fails."""
        length = self.length_of(parameter)
        if self.model.forms.keeps_previous and state.q_previous is not None:
            state = state.changed(length=length / self.steps)
        last = self._advance(state, _times(state, length, self.steps))
        turns, rotations = np.zeros(self.model.size), self.model.mesh.turns  # full turns
        turns[rotations] = 2 * np.pi * np.round((last.q - state.q)[rotations] / (2 * np.pi))
        end = self._at_start(TurnCounter.without(turns, last).changed(t=state.t))
        variables = self.variables
        scale, first = variables.scales(state, length), variables.rows_of(state)
        movable, parts = variables.movable, len(self.model.scheme.fractions)
        apart = (self._taped_rows() - first[:movable]) / scale[:movable]
        way = np.zeros(len(scale))
        way[:movable] = apart[parts] + (variables.rows_of(last) - first)[:movable] / scale[:movable]
        way[:movable] -= apart[-parts]
        size = float(np.linalg.norm(apart, axis=1).max())
        gap = (variables.rows_of(end) - first) / scale
        return Period(state, parameter, length, end, gap, size, way, last.dissipated)

    def _taped_rows(self) -> np.ndarray:
        """Positions and rates at the starts of all sub-steps of the last run."""
        return self.variables.rows(self.tape.states(np.arange(len(self.tape))), ())

    def _advance(self, state: State, times: np.ndarray) -> State:
        """The state after steps, which are on the tape."""
        self.tape.clear()
        recorder = Recorder(self.model, times, _NOTHING)
        self.tape.last = _advanced(self.prepared, state, times, recorder)
        return self.tape.last

    def settled(self, state: State, parameter: float, periods: int) -> State:
        """The state after some periods."""
        for _ in range(periods):
            state = self.run(state, parameter).end
        return state

    def slopes(
        self, changes: Mapping[str, np.ndarray], period: Period
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (rows, n) of the state after the last run, and after its first step.

        Along n changes of the start or of numbers of the scene, by name; over the scales.
        """
        boundaries = np.array([len(self.model.scheme.fractions), len(self.tape)])
        if self.model.forms.keeps_previous:
            boundaries = np.concatenate([boundaries - 1, boundaries])
        blocks = list[np.ndarray]()
        for k in range(0, len(changes["q"]), _AT_ONCE):
            part = {name: rows[k : k + _AT_ONCE] for name, rows in changes.items()}
            ends = self.derivatives.jvp(self.tape, part, boundaries)
            ends = {name: rows[-2:] for name, rows in ends.items()} | {"q previous": ends["q"][:2]}
            blocks.append(self.variables.rows(ends, self.variables.inside))
        scales = self.variables.scales(period.start, period.length)
        first_step, last = np.concatenate(blocks, axis=1) / scales
        return last.T, first_step.T

    def parameter_slope(self, period: Period) -> np.ndarray:
        """Derivative (rows,) of the gap by the logarithm of the parameter."""
        return slope(lambda x: self.run(period.start, period.parameter * (1 + x)).gap, _CHANGE)

    def first_return(self, state: State, longest: float) -> float | None:
        """Time after which a motion comes back near to its start; None if it does not."""
        steps = max(self.steps, _FINE)
        row = nearest_return(self._positions(state, longest, steps))
        return None if row is None else longest / steps * row

    def _positions(self, state: State, length: float, steps: int) -> np.ndarray:
        """Unknowns (steps + 1, free) at the ends of the steps of a motion, over their units."""
        self._advance(state, _times(state, length, steps))
        free = self.model.reduction.free  # rates have vibrations of stiff directions
        rows = self._taped_rows()[:: len(self.model.scheme.fractions), :free]
        return rows / self.model.units.unknowns

    def repeats_within(self, state: State, length: float) -> bool:
        """Whether a motion comes back to its start well before the end of a period."""
        steps = _FINER * self.steps
        apart, k = _minima(self._positions(state, length, steps))
        return bool((apart[k[k < int(0.9 * steps)]] < _SAME * apart.max()).any())

    def solution(self, period: Period) -> Solution:
        """The motion over a period with all that is recorded."""
        self.tape.clear()
        recorder, self.tape.last = self._recorded(self.prepared, period)
        return self._solution_of(recorder, self.tape.last)

    def _recorded(self, prepared: MotionSetup, period: Period) -> tuple[Recorder, State]:
        """The record of a motion over a period, and its end."""
        start = period.start.changed(algorithmic=period.end.algorithmic)
        times = _times(start, period.length, self.steps)
        recorder = Recorder(prepared.model, times, Record())
        prepared.loop.record(start, recorder)
        return recorder, _advanced(prepared, start, times, recorder)

    def _solution_of(self, recorder: Recorder, end: State) -> Solution:
        stats = replace(self.prepared.stats, steps=self.steps)  # without those of the search
        solution = solution_of(recorder, stats, lambda: end)
        check_ropes(solution, self.model.scene)
        return solution

    def depends_on_time(self, state: State, length: float) -> bool:
        """Whether loads, driven motions, parameters or natural strains change in a period."""
        values = _time_functions(self.prepared.model, self.steps, state, state.t, length)
        return bool((np.ptp(values, axis=0) > _REPEATS * abs(values).max(axis=0)).any())

    def check_repeats(self, state: State, length: float) -> None:
        """Refuse functions of time that do not repeat after a period, but for full turns."""
        first, later = (
            _time_functions(self.prepared.model, self.steps, state, t, length)
            for t in (state.t, state.t + length)
        )
        apart, allowed = later - first, _REPEATS * np.maximum(abs(first), abs(later)).max(axis=0)
        turned = apart - 2 * np.pi * np.round(apart[:1] / (2 * np.pi))
        if ((abs(apart) > allowed) & (abs(turned) > allowed)).any():
            raise SceneError(
                f"{self.what}: loads, driven motions or parameters do not repeat after the period "
                f"of {length:.6g} s. Give the period of these functions of time, or a multiple"
            )


def _advanced(prepared: MotionSetup, state: State, times: np.ndarray, recorder: Recorder) -> State:
    """The state after steps."""
    prepared.stepper.load(state)
    prepared.stepper.advance(times[1:], 1, recorder)
    return prepared.loop.state.read()


def _times(state: State, length: float, steps: int) -> np.ndarray:
    return state.t + length / steps * np.arange(steps + 1)


def _time_functions(model: Model, steps: int, state: State, t0: float, length: float) -> np.ndarray:
    """Functions of time (steps, n) in a period."""
    times = t0 + length / steps * np.arange(steps + 1)
    values = motion_setup.numbers_in_steps(model, model.data, state, times[:-1], times[1:])
    parts = [values[name].reshape(steps, -1) for name in _TIME_FUNCTIONS if name in values]
    return np.hstack(parts)


def _minima(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) of rows from the first one, and the places of their minima behind half way."""
    apart = np.linalg.norm(rows - rows[0], axis=1)
    k = np.arange(int(np.argmax(2 * apart > apart.max())) + 1, len(apart) - 1)
    return apart, k[(apart[k] <= apart[k - 1]) & (apart[k] < apart[k + 1])]


def nearest_return(rows: np.ndarray) -> float | None:
    """Number of rows, with a fraction, behind which rows come back near to the first one."""
    apart, least = _minima(rows)
    least = least[2 * apart[least] < apart.max()]
    if not len(least):
        return None
    close = apart[least] <= max(_CLOSE * apart.max(), apart[least].min())
    k = least[close][0]
    below, least_square, above = apart[k - 1 : k + 2] ** 2
    return float(k + (below - above) / (2 * (below - 2 * least_square + above)))


# -- Periodic motions by Newton's method, with a damping that fades (Levenberg and Marquardt) ---


_log = logging.getLogger("fx_beam")

# The damping at the begin, its factors after a success and a failure, and the largest one.
_DAMPED, _LESS, _MORE, _LARGEST = 0.1, 0.1, 10.0, 1e6
# Singular values of the equations that are round-off, relative to the largest.
_ROUNDING = 1e-13
# Growth of changes in a period above which they say nothing about the next state.
_USEFUL = 1e9
# Gaps that are round-off, in units of the scene.
_LOST = 1e-14
#: Gaps, relative to the motion, that are round-off if they have not halved in so many iterations.
ROUND_OFF, _IDLE = 1e-6, 4
# Largest change of the parameter's logarithm in an iteration.
_FAR = 3.0


class Condition(NamedTuple):
    """An equation besides the gap of the period: where a motion begins, or its energy."""

    #: What a motion misses.
    error: Callable[[Period], float]
    #: Derivatives (n + 1,) of it by the directions at the start, and by the parameter's logarithm.
    slopes: Callable[[Period, Directions], np.ndarray]


class Closed(NamedTuple):
    """A periodic motion, and its equations."""

    period: Period
    directions: Directions
    #: Derivatives (rows, n) of the states after a period and after one step.
    monodromy: np.ndarray
    first_step: np.ndarray
    #: Derivatives (rows, n + 1) of the gap, and of the phase of a free motion.
    equations: np.ndarray
    iterations: int = 0
    #: How far its ends are apart, relative to the motion, if round-off leaves more than allowed.
    left_over: float = 0.0


class NotClosed(RuntimeError):
    """No periodic motion was found."""


def _on_its_way(period: Period, directions: Directions) -> np.ndarray:
    row = np.append(period.way @ directions.matrix, 0.0)
    return row / np.linalg.norm(row)


#: That the state does not change along the motion, which only shifts a free motion in time.
NO_SHIFT = Condition(lambda period: 0.0, _on_its_way)


def plane(
    shooting: Shooting,
    scale: np.ndarray,
    normal: np.ndarray,
    place: np.ndarray | float = 0.0,
    parameter: float = 1.0,
) -> Condition:
    """Condition for a start in a plane through the rows of a place, over scales, and a parameter.

    The last entry of its normal (rows + 1,) is for the parameter's logarithm.
    """

    def error(period: Period) -> float:
        rows = (shooting.variables.rows_of(period.start) - place) / scale
        return float(normal @ np.append(rows, np.log(period.parameter / parameter)))

    def slopes(period: Period, directions: Directions) -> np.ndarray:
        rows = directions.matrix * (directions.scale / scale)[:, None]
        return np.append(normal[:-1] @ rows, normal[-1])

    return Condition(error, slopes)


def turning_point(shooting: Shooting, goal: Period) -> Condition:
    """Condition for a start where the speed turns: at rest, if the motion returns on its way.

    The direction of the acceleration there is that of the motion it should be like.
    """
    way = np.where(shooting.variables.are_rates, goal.way, 0.0) / np.linalg.norm(goal.way)
    return plane(shooting, shooting.variables.scales(goal.start, goal.length), np.append(way, 0.0))


def _with_equations(
    shooting: Shooting, period: Period, phase: Condition | None, varies: bool
) -> Closed:
    directions = shooting.variables.directions(period.start, period.length)
    slopes = shooting.slopes(directions.changes, period)
    growth = abs(slopes[0]).max()
    if growth > _USEFUL:
        raise SceneError(
            f"{shooting.what}: changes of the state grow {growth:.1e} times in a period: the "
            "motion is chaotic, or strikes. Give the scene damping, or take another start"
        )
    column = shooting.parameter_slope(period) if varies else np.zeros(len(period.gap))
    matrix = np.column_stack([slopes[0] - directions.matrix, column])
    # What is remembered and does not change, such as plastic strain, is no unknown.
    independent = directions.independent
    constant = (independent >= shooting.variables.movable) & ~matrix[independent].any(axis=1)
    matrix[:, np.flatnonzero(constant)] = 0.0
    if phase is not None:
        matrix = np.vstack([matrix, phase.slopes(period, directions)])
    return Closed(period, directions, *slopes, matrix)


def at_rest(shooting: Shooting, start: State, parameter: float) -> Closed | None:
    """A scene that stays where it is over a period; None if it moves."""
    period = shooting.run(start, parameter)
    return None if period.moves else _with_equations(shooting, period, None, False)


def close(
    shooting: Shooting,
    start: State,
    parameter: float,
    phase: Condition | None,
    conditions: tuple[Condition, ...] = (),
    varies: bool = True,
    most: int = 39,
    damping: float = _DAMPED,
) -> Closed:
    """The periodic motion near a state; free motions need a `phase`, where they begin.

    The parameter `varies`, or is held. Near the motion no `damping` is needed. NotClosed if there
    is none, or StepError.
    """
    search = _Search(shooting, phase, conditions, varies, damping)
    period = shooting.run(start, parameter)
    search.accept(period, search.error_of(period))
    search.best = search.error
    iterations, ended_by = 0, "increment"
    if search.error > search.allowed:
        iterations, ended_by = newton(search.correct, 1.0, most)
    if not ended_by:
        raise search.failure()
    left_over = search.error if search.error > search.allowed else 0.0
    return search.closed._replace(iterations=iterations, left_over=left_over)


@dataclass
class _Search:
    """Newton's method from motion to motion. A damping grows where a correction does not help."""

    shooting: Shooting
    phase: Condition | None
    conditions: tuple[Condition, ...]
    varies: bool
    damping: float
    #: Number of corrections, the least error, and corrections since it was last halved.
    tries: int = 0
    best: float = np.inf
    idle: int = 0

    def accept(self, period: Period, error: float) -> None:
        """Go on from a motion over a period, with its error."""
        #: How far the ends of the motion are apart, relative to its size, and what is allowed.
        self.period, self.error = period, error
        self.allowed = max(self.shooting.options.tolerance, _LOST / period.size)
        #: The motion with its equations.
        self.closed = _with_equations(self.shooting, period, self.phase, self.varies)

    def _missing(self, period: Period) -> np.ndarray:
        """The gap of a motion, and how far it is from the conditions."""
        conditions = self.conditions if self.phase is None else (self.phase, *self.conditions)
        return np.append(period.gap, [condition.error(period) for condition in conditions])

    def error_of(self, period: Period) -> float:
        """How far the ends of a motion are apart, relative to it; NotClosed if it comes to rest."""
        missing = float(np.linalg.norm(self._missing(period)))
        if not period.moves or not np.isfinite(missing):
            raise NotClosed(
                f"{self.shooting.what}: the scene is at rest, or comes to rest. Start from a "
                "motion that goes on"
            )
        return missing / period.size

    def correct(self) -> tuple[float, bool]:
        """The least error so far, over what is allowed, and whether round-off leaves it."""
        shooting, period, directions = self.shooting, self.period, self.closed.directions
        self.tries += 1
        rows = [condition.slopes(period, directions) for condition in self.conditions]
        solve = _damped(np.vstack([self.closed.equations, *rows]), self.damping)
        step = solve(self._missing(period))
        try:
            if abs(step[-1]) > _FAR:
                raise NotClosed("the period changes too much")
            start = shooting.variables.moved(period.start, directions, step[:-1])
            new = shooting.run(start, period.parameter * np.exp(step[-1]))
            error, rest = self.error_of(new), solve(self._missing(new))
            # In stiff scenes the gap may grow on the way to a solution, what is left of steps not.
            better = bool(np.linalg.norm(rest) < np.linalg.norm(step))
        except (StepError, NotClosed):
            better = False
        if better:
            self.accept(new, error)
            self.damping *= _LESS
        else:
            self.damping = _MORE * max(self.damping, 1e-8)
        if self.damping > _LARGEST:
            raise self.failure()
        halved = self.error < self.best / 2
        self.best, self.idle = (self.error, 0) if halved else (self.best, self.idle + 1)
        size = self.error if self.error <= self.allowed else self.best
        return size / self.allowed, self.idle >= _IDLE and self.error < ROUND_OFF

    def failure(self) -> NotClosed:
        """Error of a search that found no periodic motion."""
        advice = ""
        if self.error < 1e-3:
            tolerance = f"{2 * self.error:.0e}"
            advice = f". If that is near enough, as with round-off, give tolerance = {tolerance}"
        return NotClosed(
            f"{self.shooting.what}: no periodic motion was found in {self.tries} iterations: the "
            f"state after a period is still {self.error:.1e} of the motion away from that "
            f"before{advice}"
        )


def least_squares(matrix: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The shortest x (n, ...) with the least matrix x - sides, where round-off is zero."""
    return scipy.linalg.lstsq(matrix, sides, _ROUNDING, lapack_driver="gelsy")[0]


def _damped(matrix: np.ndarray, damping: float) -> Callable[[np.ndarray], np.ndarray]:
    """Gives the step for a gap."""
    n = matrix.shape[1]
    damped = np.vstack([matrix, damping * np.eye(n)])

    def solve(gap: np.ndarray) -> np.ndarray:
        return least_squares(damped, np.append(-gap, np.zeros(n)))

    return solve


def warn_of_round_off(shooting: Shooting, left_over: Sequence[float]) -> None:
    """Warn once of motions whose gap round-off leaves larger than allowed; others have 0."""
    if count := np.count_nonzero(left_over):
        among = f". So it is in {count} of {len(left_over)} motions" * (len(left_over) > 1)
        _log.warning(
            "%s: round-off leaves the state after a period %.1e of the motion away from that "
            "before, where tolerance = %g; a larger tolerance says that this will do%s",
            *(shooting.what, max(left_over), shooting.options.tolerance, among),
        )
