"""Outputs read from the present state of a motion, and conditions on them that end it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.errors import SceneError, is_number, shown
from fx_beam.results.state import FORCES, State
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.scene.outputs import SECTION_FORCES, Measured, Output, is_section_force, wraps
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import MEANS, driven_increments, fitted_mean
from fx_beam.step.recorder import Mark, NullRecorder, Recorder, Rows

from .motion_setup import MotionSetup

if TYPE_CHECKING:
    from fx_beam.step.fitted_rates import Fit


# -- Outputs read from the present state of a motion, with rates that fit its joints ------------


Reading = Callable[[], Any]
#: Gives arrays of a state by their names in `State`.
Arrays = Callable[[str], Any]
# Where driven motions are.
_PLACES = "q", "slides"
# Forces that steps compute only for records that have them, and for outputs.
_NOT_ALWAYS = "joint_forces", "line_forces", "contact_forces"


class Instant:
    """The end of a step, or where steps begin: its rates that fit the joints.

    t is its time [s], `length` that of the step [s], negative for one that starts here. Rates of
    driven motions (driven,) are those that are `known`, or follow from functions of time.
    """

    def __init__(
        self,
        forcing: Forcing,
        t: float,
        length: float,
        arrays: Arrays,
        known: np.ndarray | None = None,
        start: Instant | None = None,
    ):
        self._forcing, self._t, self.length, self._arrays = forcing, t, length, arrays
        self._known, straight = known, forcing.straight
        # Inputs go straight from the start of the step.
        self._inputs = np.full(len(straight), np.nan)
        if start is not None and straight.any():
            ends = (np.array([read(name) for read in (start._arrays, arrays)]) for name in _PLACES)
            self._inputs = driven_increments(forcing.model, *ends)[0] / length

    @cached_property
    def driven(self) -> np.ndarray:
        """Rates (driven,) of driven motions; NaN where they are not known."""
        if self._known is not None or not len(self._inputs):
            return self._inputs if self._known is None else self._known
        ends, lengths = np.array([self._t]), np.array([self.length])
        rates = floats(self._forcing.end_rates(ends, lengths))[0]
        return np.where(self._forcing.straight, self._inputs, rates)

    @cached_property
    def fit(self) -> Fit:
        """Rates that fit the joints, and the impulses that make them fit."""
        from fx_beam.step.fitted_rates import rate_fit

        q, v, slides = (self._arrays(name)[None] for name in ("q", "v", "slides"))
        return rate_fit(self._forcing.model).fit(q, v, slides, self.driven[None])


def fitted_value(name: str, arrays: Arrays, start: Instant | None, end: Instant | None) -> Any:
    """An array of `State` at the end of a step: accelerations and forces are means over it.

    Those of a step without a `start` are as they are, and all if rates of steps fit (no `end`).
    """
    value = arrays(name)
    if end is None:
        return value
    if name == "v":
        return end.fit.rates[0]
    if start is None or value is None or name not in MEANS:
        return value
    return fitted_mean(name, value, start.fit, end.fit, end.length)


def fitted_state(state: State, start: Instant | None, end: Instant | None) -> State:
    """The state with the forces of supports and joints, and the rates of the steps."""
    if end is None:
        return state
    arrays = functools.partial(getattr, state)
    means = {name: fitted_value(name, arrays, start, end) for name in MEANS}
    return state.changed(**means, driven_rates=end.driven)


def readings(
    prepared: MotionSetup,
    now: Arrays,
    outputs: Mapping[str, Output],
    last_row: Callable[[], Any] | None = None,
) -> dict[str, Reading]:
    """Functions that read outputs from arrays, with full turns that are missing in rotations.

    Section forces are read from the `last_row` of a record, as `RowBalance` has it.
    """
    sections = {name: output for name, output in outputs.items() if is_section_force(output)}
    for name, output in sections.items():
        if last_row is None:
            raise SceneError(
                f"the output {name!r}, {output}, is a section force, which follows from a step "
                "that is recorded, not from a state: give Motion record=fb.Record(), and `until` "
                "a record of all steps with motion and rates"
            )
    section_readings: dict[str, Reading] = {}
    if sections and last_row is not None:
        from .element_balance import RowBalance

        balance = RowBalance(prepared.model, last_row)
        section_readings = {name: balance.value_of(output) for name, output in sections.items()}
    by_name = {name: Measured(output) for name, output in outputs.items() if name not in sections}
    if any(measured.quantity.of in _NOT_ALWAYS for measured in by_name.values()):
        prepared.loop.problem.keep_joint_forces()
    model, turns = prepared.model, prepared.turn_counter
    read = {name: _reading(model, now, turns, measured) for name, measured in by_name.items()}
    return {name: section_readings.get(name) or read[name] for name in outputs}


def rope_reading(
    prepared: MotionSetup, now: Arrays, rope: ForceBetween
) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """A function that gives angles (1, points) of a rope on its pulleys, and its force (1,)."""
    read = readings(prepared, now, {"force": Output("force", rope)})["force"]
    spans = prepared.model.points.spans_of(Measured(Output("length", rope)))

    def angles_and_force() -> tuple[np.ndarray, np.ndarray]:
        q, counted = now("q"), now("spring_internal")[spans]
        angles = wraps(rope, lambda _, entries: q[None, entries], counted[None])
        return angles, np.array([read()])

    return angles_and_force


def _reading(model: Model, array_of: Arrays, turns: TurnCounter, measured: Measured) -> Reading:
    if measured.law_quantity == "energy":
        return _energy_reading(model, array_of, measured)
    if measured.contact is not None:
        return _contact_reading(model, array_of, measured)
    X, is_single = model.mesh.X.reshape(-1), not measured.shape
    turning = any(name == "q" and (entries % 3 == 2).any() for name, entries in measured.needs)

    def read_now(array: str, entries: np.ndarray) -> Any:
        if array == "X":
            return X[entries]
        if (columns := model.force_columns.get(array)) is None:
            values = array_of(array)
        elif (values := array_of("constraint_forces")) is not None:
            values = np.append(values, 0.0)[columns]
        if values is None:
            return np.zeros(len(entries))
        now = values.reshape(-1)[entries]
        return now + turns.removed[entries] if turning and array == "q" else now

    spans = model.points.spans_of(measured)

    def counted() -> np.ndarray | None:
        """Half turns of the spans of a rope."""
        return None if spans is None else array_of("spring_internal")[spans]

    def read() -> Any:
        value = measured.values(read_now, counted())
        return np.asarray(value).item() if is_single else value

    return read


def _energy_reading(model: Model, array_of: Arrays, measured: Measured) -> Reading:
    """The energy that a line stores, by its own laws."""
    from fx_beam.fem.point_values import PointValues
    from fx_beam.laws.interval import StepBatch

    values = PointValues(model.points, measured.law_quantity, measured.place.number)

    def read() -> float:
        arrays = {name: array_of(name) for name in ("spring_internal", "parameters")}
        return float(values.values(StepBatch.at_rest(array_of("q"), **arrays))[0])

    return read


def _contact_reading(model: Model, array_of: Arrays, measured: Measured) -> Reading:
    """The least gap of a contact, or the sum of its forces."""
    from fx_beam.results.joint_and_contact_motion import columns_of, gaps_and_normals

    scene, mesh, contact = model.scene, model.mesh, measured.contact
    assert contact is not None
    columns, component = columns_of(scene.contacts)[contact.number], measured.component
    nodes_of_beam = {beam.name: mesh.nodes_of(scene, beam) for beam in scene.beams}

    def gap() -> float:
        q = array_of("q")
        gaps = gaps_and_normals(
            contact, mesh.X, nodes_of_beam, lambda nodes: q[mesh.dofs[nodes]][None]
        )
        return float(gaps[0].min())

    def force() -> Any:
        if (values := array_of("contact_forces")) is None:
            return np.zeros(2)[component]
        total = values.reshape(-1, 2)[columns].sum(axis=0)[component]
        return total if measured.shape else float(total)

    return gap if measured.name == "gap" else force


# -- Conditions that end a motion: where within a step they are met, and the step that ends there


# Accuracy of the time of the end, relative to the step, and to the time.
_OF_STEP, _OF_TIME = 1e-13, 4e-16
# A value that is zero: at the start relative to that after the first step, later to that before.
_ZERO = 1e-8
# The shortest last step, relative to the one before; with a shorter one both are one step.
_SHORTEST = 0.1
# A mean force that is met in a shorter step than this part of one has jumped at its start. In such
# steps forces may be round-off.
_JUMP = 1e-6
# Whether loads jump at the end of a step is seen at this distance on both sides, relative to the
# step; the least jump, relative to the size. How far a step may go beyond it and have no jump yet.
_BESIDE, _LEAST_JUMP, _INSIDE = 1e-6, 1e-3, 3e-13
_MOST_TRIALS = 200


class _Start(NamedTuple):
    """The start of a step: its mark and the statistics before it.

    And the means of the step before, by the names of outputs, with its length [s]; 0 at the start.
    """

    mark: Mark
    stats: dict[str, Any]
    means: dict[str, Any]
    length: float

    def with_parts(self, halving: dict[str, Any]) -> _Start:
        """A start of steps with as many parts as the control of halving has."""
        return self._replace(mark=self.mark._replace(halving=halving))


class Ending:
    """Takes the steps of a run one by one, until a condition is met."""

    def __init__(self, prepared: MotionSetup, recorder: Recorder):
        self._prepared, self._stepper, self._recorder = prepared, prepared.stepper, recorder
        self._conditions = prepared.options.until
        self._arrays = prepared.loop.state.arrays.__getitem__
        self._last = start = recorder.end
        self._t0 = start.t
        #: Time over which rates of driven motions are found at the start [s].
        self._ahead = prepared.options.dt or 1e-3 * (prepared.options.t_end - start.t)
        #: Where the step to the state in C starts and ends, if rates are fitted.
        self._step: tuple[Instant | None, Instant | None] = None, None
        outputs, record = prepared.options.outputs or {}, prepared.options.record
        every = record.every == 1 and record.motion and record.rates
        self._readings = readings(prepared, self._value, outputs, self._last_row if every else None)
        #: Whether outputs read the rows of trial steps.
        self._reads_rows = any(map(is_section_force, outputs.values()))
        levels = {key: _level(output, prepared.model) for key, output in outputs.items()}
        #: Levels in a step of outputs that are not those at its end, as means are.
        self._levels = {key: level for key, level in levels.items() if level is not None}
        self._at_ends = all(level == 1 for level in self._levels.values())
        #: Those of them that steps of another length would change.
        self._of_rows = {
            key for key, output in outputs.items() if _is_uneven(output, prepared.model)
        }
        #: What they are in the last step, its end and its length [s].
        self._means: dict[str, Any] = {}
        self._means_at = start.t, 0.0
        self._start_before: _Start | None = None
        #: Length of the last step [s]; zero before the first one.
        self._length = 0.0
        self._values = self._values_after(start, start)
        self._begins = True

    def advance(self, take_steps: Callable[[], None], kinks: list[float]) -> None:
        """Let a run take a step, which ends where a condition is met in it.

        Steps are not joined at `kinks`, times at which the motion is not smooth [s].
        """
        start = self._mark()
        if start.mark is not self._last:
            self._start_before = None  # full turns are counted separately from here on
        take_steps()
        end = self._recorder.end
        if end.t == start.mark.t:
            return  # the step is repeated
        values = self._values_after(start.mark, end)
        if self._begins:
            for name, value in values.items():
                if abs(self._values[name]) <= _ZERO * abs(value):
                    self._values[name] = value  # zero at the start has the sign that comes
            self._begins = False
        met = [name for name, value in values.items() if _changes(self._values[name], value)]
        if met:
            self._end(start, end.t, met, values, kinks)
        self._start_before, self._values, self._last = start, values, self._recorder.end
        self._length = end.t - start.mark.t

    def _end(
        self, start: _Start, t1: float, met: list[str], values: dict[str, float], kinks: list[float]
    ) -> None:
        """End the run where the first of some conditions is met in the step to t1 [s]."""
        # Shorter steps have as many parts as this one.
        halving = dict(vars(self._stepper.halving))
        t0, start, start_before = start.mark.t, start.with_parts(halving), self._start_before
        ends = {name: self._zero(name, start, t0, t1, values[name]) for name in met}
        soon, least = (t0 + part * (t1 - t0) for part in (_JUMP, _SHORTEST))

        def order(name: str) -> tuple[float, float]:
            """Time of a condition; of several at one time that which goes farthest is first."""
            return max(ends[name], soon), -abs(values[name]) / (abs(self._values[name]) or 1e-300)

        first = min(ends, key=order)
        if ends[first] < least and start_before is not None and t0 not in kinks:
            longer = start_before.with_parts(halving)
            if self._jumps(t := start_before.mark.t, t0, t1):
                t1 = t0 + max(_INSIDE * (t0 - t), 2 * np.spacing(t0))
            value = self._at(first, longer, t1)
            if abs(value) <= _ZERO * abs(self._values[first]):
                start, ends[first] = longer, t1  # where round-off decides the sign
            elif _changes(self._values[first], value):
                low = t0 if self._at_ends else start_before.mark.t
                start, ends[first] = longer, self._zero(first, longer, low, t1, value)
            elif ends[first] < soon and _changes(
                self._values[first], self._at(first, start, least)
            ):
                ends[first] = least  # mean forces have jumped from the step before to this one
        elif ends[first] < soon:
            ends[first] = least
        self._return_to(start)
        number = self._stepper.stats.steps + 1
        end = np.array([ends[first]])
        self._recorder.plan(number, end, last=True)
        self._stepper.advance(end, number, self._recorder)
        self._stepper.stats.until = first

    def _jumps(self, t: float, t0: float, t1: float) -> bool:
        """Whether loads or rates of driven motions jump at t0, between steps from t and to t1 [s].

        A step over it would have the mean of both.
        """
        model, forcing = self._prepared.model, self._prepared.forcing
        times = np.array([t0 - _BESIDE * (t0 - t), t0 + _BESIDE * (t1 - t0), t, t1])
        acting = [model.data.loads.series(times), model.forms.parameters.at_times(times)]
        acting.append(forcing.end_rates(np.repeat(t0, 2), t0 - np.array([t, t1])))
        if len(followers := model.points.followers):
            acting.append(followers.series(times, times))
        sizes = ((abs(x[1] - x[0]), abs(x)) for x in map(floats, acting) if x.size)
        return any(jump.max() > _LEAST_JUMP * size.max() for jump, size in sizes)

    def _zero(self, name: str, start: _Start, t0: float, t1: float, last: float) -> float:
        """Time in [t0, t1] at which a condition is met in a step from a start, just behind it.

        By false position with halved weights (Illinois), and bisection every third time.
        """
        a, b, fa, fb = t0, t1, self._values[name], last
        least, side = _OF_STEP * (t1 - start.mark.t) + _OF_TIME * abs(t1), 0
        for trial in range(_MOST_TRIALS):
            if b - a <= least:
                break
            t = (a + b) / 2 if trial % 3 == 2 else (a * fb - b * fa) / (fb - fa)
            t = min(max(t, a + least / 2), b - least / 2)
            value = self._at(name, start, t)
            if _changes(self._values[name], value):
                fa, fb = fa / 2 if side == 1 else fa, value
                b, side = t, 1
            else:
                fa, fb = value, fb / 2 if side == -1 else fb
                a, side = t, -1
        return b

    def _at(self, name: str, start: _Start, t: float) -> float:
        """Value of a condition after a step from a start to a time [s], which is not recorded."""
        self._return_to(start)
        recorder: Rows = self._recorder if self._reads_rows else NullRecorder()
        number, ends = self._stepper.stats.steps + 1, np.array([t])
        recorder.plan(number, ends, last=False)
        self._stepper.advance(ends, number, recorder)
        return self._values_after(start.mark, recorder.end, [name], start)[name]

    def _values_after(
        self,
        start: Mark,
        end: Mark,
        names: Sequence[str] | None = None,
        before: _Start | None = None,
    ) -> dict[str, float]:
        """Values of conditions at the end of a step: numbers, or 1 where they are met, else -1.

        Of means, or of what these lead to at the end, from those `before` the step.
        """
        first = last = None
        if self._prepared.model.fits_rates:
            forcing, dt = self._prepared.forcing, end.t - start.t or self._ahead
            known = self._recorder.first.driven_rates if start.t == self._t0 else None
            copied = self._prepared.loop.state.arrays_of
            last = Instant(forcing, start.t, self._length or -dt, copied(start.state), known)
            if end is not start:
                first = last
                last = Instant(forcing, start.t + dt, dt, copied(end.state), None, first)
        self._step = first, last
        outputs = {key: read() for key, read in self._readings.items()}
        if before is None:
            self._means = {key: outputs[key] for key in self._levels}
            self._means_at = end.t, end.t - start.t
        elif before.length:
            for key, mean in before.means.items():
                value, t, length = outputs[key], end.t, end.t - start.t
                if key in self._of_rows:
                    value, (t, length) = self._means[key], self._means_at
                level = self._levels[key]
                apart = t - start.t - (1 - level) * (length - before.length)
                ahead = end.t - t + (1 - level) * length
                outputs[key] = value + ahead / apart * (value - mean)
        values: dict[str, float] = {}
        for name in self._conditions if names is None else names:
            try:
                value = self._conditions[name](end.t, outputs)
            except (TypeError, KeyError) as error:
                raise SceneError(
                    f"simulate: {name} raised {error!r} at t = {end.t:g}. It is called as "
                    f"{name}(t, y), where y has the outputs {list(outputs)}"
                ) from error
            truth = isinstance(value, bool | np.bool_)
            if not truth and not is_number(value):
                raise SceneError(
                    f"simulate: {name} gives {shown(value)} at t = {end.t:g}; it must be a finite "
                    "number or a truth value"
                )
            if truth and value and end is start:
                raise SceneError(
                    f"simulate: {name} is true at the start, t = {start.t:g}. A condition ends a "
                    "motion where it becomes true; a number, where it changes its sign"
                )
            values[name] = 2.0 * bool(value) - 1.0 if truth else float(value)
        return values

    def _value(self, name: str) -> Any:
        return fitted_value(name, self._arrays, *self._step)

    def _last_row(self) -> tuple[Any, Recorder, np.ndarray]:
        return self._recorder.end, self._recorder, self._value("a")

    def _mark(self) -> _Start:
        stats = self._stepper.stats
        known = vars(stats) | {"ended_by": dict(stats.ended_by)}
        length = self._length if self._recorder.end is self._last else 0.0
        return _Start(self._recorder.end, known, self._means, length)

    def _return_to(self, start: _Start) -> None:
        self._stepper.return_to(start.mark, self._recorder)
        vars(self._stepper.stats).update(start.stats | {"ended_by": dict(start.stats["ended_by"])})


def _quantity(output: Output) -> str:
    return SECTION_FORCES if is_section_force(output) else Measured(output).quantity.of


def _level(output: Output, model: Model) -> float | None:
    """The level in a step of an output that is a force or an acceleration; else None."""
    rates, quantity = model.scheme.rates, _quantity(output)
    if quantity == "a" and not rates.mean_based:
        return 1.0
    forces = "a", "reactions", "motor_forces", SECTION_FORCES, *FORCES
    return float(rates.level) if quantity in forces else None


def _is_uneven(output: Output, model: Model) -> bool:
    """Whether a step of another length has another force or acceleration.

    By Newmark's rule, at nodes that follow others: an error in rates is divided by the length.
    """
    if model.scheme.rates.mean_based or model.couplings.is_selection:
        return False
    return _quantity(output) in ("a", "reactions", "motor_forces", "joint_forces")


def _changes(old: float, value: float) -> bool:
    """Whether a value changes its sign."""
    return (old < 0) != (value < 0)
