"""Outputs read from the present state of a motion, with rates that fit its joints."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import Output, is_section_force
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.model import Model
from fx_beam.step.recorded_histories import MEANS, driven_increments, fitted_mean

from .prepared import MotionSetup

if TYPE_CHECKING:
    from fx_beam.step.fitted_rates import Fit

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
        from .row_balance import RowBalance

        balance = RowBalance(prepared.model, last_row)
        section_readings = {name: balance.value_of(output) for name, output in sections.items()}
    by_name = {name: Measured(output) for name, output in outputs.items() if name not in sections}
    if any(measured.quantity.of in _NOT_ALWAYS for measured in by_name.values()):
        prepared.loop.problem.keep_joint_forces()
    model, turns = prepared.model, prepared.turn_counter
    read = {name: _reading(model, now, turns, measured) for name, measured in by_name.items()}
    return {name: section_readings.get(name) or read[name] for name in outputs}


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
        return float(value) if is_single else value

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
    from fx_beam.results.contact_gaps import columns_of, gaps_and_normals

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
