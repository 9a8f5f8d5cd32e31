"""An output of a response: its values, what it reads of a run, and its derivatives, by blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import MaybeDual, dual_array
from fx_beam.motions.numbers import OF_OUTPUT
from fx_beam.results.state import HISTORIES
from fx_beam.scene.beam import BeamPlace, Node
from fx_beam.scene.measured import Measured, numbers_of
from fx_beam.scene.outputs import STRESSES, Output, is_section_force, section_weights
from fx_beam.step.layout import Arrays
from fx_beam.step.model import Model
from fx_beam.step.sub_step_times import WholeSteps

from .gradient import DerivativeBlock, Gradient, jvp, vjp
from .sub_steps import SubSteps


def numbers_of_output(name: str) -> str:
    """The numbers of an output; of a section force the part of its element, and its length."""
    return "numbers" + OF_OUTPUT + name


def numbers_of_outputs(
    outputs: Mapping[str, Any], known: Mapping[str, object]
) -> dict[str, MaybeDual]:
    """Numbers of outputs, at places in the elements of those that are known."""
    numbers = dict[str, MaybeDual]()
    for name, output in known.items():
        if not isinstance(output, Output) or isinstance(output.of, Node):
            continue  # it has none
        if isinstance(output.of, BeamPlace):
            place, (element, _) = outputs[name].of, output.of.element
            start, end = place.beam.s[element : element + 2]
            part, length = (place.s - start) / (end - start), end - start
            values = dual_array([part, length] if is_section_force(output) else [part])
            if output.quantity in STRESSES:
                values = dual_array([part, length, *section_weights(outputs[name])])
        else:
            values = numbers_of(outputs[name])
        if values.size:
            numbers[numbers_of_output(name)] = values
    return numbers


class Needs(NamedTuple):
    """Needs of outputs besides the states at their rows."""

    #: Rates that fit the joints, or forces; accelerations or forces at the start.
    rates: bool = False
    start: bool = False
    #: States around the sub-steps that end in the rows, or around all since the start.
    steps: bool = False
    all_steps: bool = False
    #: A tape that has all steps in memory.
    whole: bool = False


class RowPlaces(NamedTuple):
    """Places of the rows of outputs among the states of a run, and what is known of it."""

    sub_steps: SubSteps
    #: Numbers of the scene, and of its outputs, by name.
    numbers: Arrays
    #: Rows (n,) among the states, and the starts of the steps that end there.
    ends: np.ndarray
    starts: np.ndarray
    #: Numbers of the rows that are the end of a step, and of those at the start of the run.
    moved: np.ndarray
    at_start: np.ndarray
    #: Those steps, and the places of their sub-steps among those of the forces.
    steps: WholeSteps
    forces: np.ndarray
    #: The only entries that the states have, by name; empty if they have all.
    entries: Arrays
    #: Gives forces (k, columns) of columns in all sub-steps on the tape.
    column_forces: Callable[[], np.ndarray]

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (k,), sub-steps (k,) and shares (k,) of means over the steps; -1 for the start."""
        steps, start = self.steps, self.at_start
        sub_steps = np.append(steps.sub_steps, -np.ones(len(start), dtype=int))
        return np.append(steps.of, start), sub_steps, np.append(steps.shares, np.ones(len(start)))


class RowOutput:
    """An output at rows (n,) of a run, whose states are at some `places`."""

    #: Lengths of a row.
    shape: tuple[int, ...] = ()
    #: What of a `Record` it needs if no history has it.
    record = ""
    #: Whether it adds up over the steps since the start.
    is_sum = False

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        self._sub_steps, self._places = places.sub_steps, places

    @classmethod
    def record_of(cls, measured: Measured) -> str:
        """Part of a `Record` that has it: "motion", "rates" or "forces"; empty for nothing."""
        recorded = HISTORIES.get(measured.quantity.of)
        return cls.record if recorded is None else recorded.record

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """Its needs in a run of a model."""
        record = cls.record_of(measured)
        start = record == "forces" or measured.quantity.of == "a"
        return Needs(rates=record in ("rates", "forces"), start=start)

    def blocks(self, rows: np.ndarray) -> Iterable[DerivativeBlock]:
        """Its derivatives in some of the rows, or in all."""
        raise NotImplementedError

    def vjp(self, weights: np.ndarray, later: float, gradient: Gradient) -> None:
        """Add the derivatives of the sum of weights (n, ...) times the output.

        `later` is the sum of the weights of rows in later parts of a tape.
        """
        counting = np.flatnonzero(weights.any(axis=tuple(range(1, weights.ndim))))
        vjp(self.blocks(counting), weights, gradient)

    def jvp(
        self, rows: int, earlier: np.ndarray, state_changes: Arrays, changes: Arrays
    ) -> np.ndarray:
        """Changes (rows, ..., m) from those of the states and of the numbers of the scene.

        `earlier` (m,) is the sum over earlier parts of a tape, to which this one adds.
        """
        return jvp(self.blocks(np.arange(rows)), (rows, *self.shape), state_changes, changes)
