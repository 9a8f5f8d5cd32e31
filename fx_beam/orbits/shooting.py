"""The state after a period as a function of that before, and its derivatives (monodromy matrix)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError, as_float, between, real, whole
from fx_beam.laws.schemes import Scheme
from fx_beam.linear.linearisation import check_unknowns
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.numbers import numbers_in_steps
from fx_beam.motions.options import CommonOptions, Options, check_scene
from fx_beam.motions.prepared import MotionSetup, prepare
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.model import Model
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .variables import Variables, slope

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
        return solution_of(recorder, stats, lambda: end)

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
    values = numbers_in_steps(model, model.data, state, times[:-1], times[1:])
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
