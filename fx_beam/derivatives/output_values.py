"""Values of outputs in solutions and in recorded rows, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import dual_array
from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.errors import require
from fx_beam.results.solution import Solution, history
from fx_beam.results.state import HISTORIES
from fx_beam.scene.beam import Beam, BeamPlace, Node
from fx_beam.scene.outputs import (
    CRITICAL_LOAD,
    PERIOD,
    Measured,
    Output,
    is_section_force,
    quantity_of,
)
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.recorder import Record, Recorder

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], Any]


#: Numbers (n, 2) of outputs at places: the part of the element before them, and its length.
OF_PLACES = "places of outputs"


def numbers_of_places(outputs: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers `OF_PLACES`, if there are any, in the elements of outputs that are known."""
    numbers = []
    for name in filter(lambda key: is_at_place(known[key]), known):
        place, (element, _) = outputs[name].of, known[name].of.element
        start, end = place.beam.s[element : element + 2]
        numbers.append(((place.s - start) / (end - start), end - start))
    return {OF_PLACES: dual_array(numbers)} if numbers else {}


def is_at_place(output: Wanted) -> bool:
    """Whether it is an output at a place of a beam."""
    return isinstance(output, Output) and isinstance(output.of, BeamPlace)


class KnownNumbers(NamedTuple):
    """Numbers of outputs of a scene without slopes, and their rows by names of outputs."""

    values: dict[str, Any]
    places: dict[str, int]
    sections: dict[str, int]


def recorded(requested: Record, last: Record, outputs: Mapping[str, Wanted]) -> Record:
    """The `requested` record, reduced to what the outputs need; the `last` one if it is equal."""
    kinds = set[str]()
    for output in outputs.values():
        if not isinstance(output, Output):
            return requested
        kinds.add(record_of(output))
        if isinstance(output.of, Beam):  # resultants may depend on rates
            kinds.add("rates")
    rates, forces = requested.rates and "rates" in kinds, requested.forces and "forces" in kinds
    is_same = (last.rates, last.forces) == (rates, forces)
    return last if is_same else replace(requested, rates=rates, forces=forces)


def record_of(output: Output) -> str:
    """What of a `Record` has an output of a node or a joint: "motion", "rates" or "forces"."""
    if is_section_force(output):
        return "rates"
    history = HISTORIES.get(quantity_of(output).of)
    return "" if history is None else history.record


def values_of(solution: Solution, output: Wanted, name: str) -> np.ndarray:
    """Values (n, ...) of an output."""
    if not isinstance(output, Output):
        values = np.asarray(output(solution))
        expected = "a number or an array of numbers"
        require(values.dtype.kind in "iufb", f"Response: the output {name!r}", values, expected)
        return values
    expected = "that of a PeriodicResponse: other motions and equilibria have no period"
    require(output.quantity != PERIOD, f"Response: the output {name!r}", str(output), expected)
    if output.quantity == CRITICAL_LOAD:
        return np.array(first_critical_point(solution).load_factor)
    if isinstance(output.of, Scene):
        return getattr(solution.energy, quantity_of(output).of)
    if isinstance(output.of, Beam):
        return getattr(solution.resultants(output.of), output.quantity)
    if is_section_force(output):
        place: Any = output.of
        forces = solution.resultants(place.beam).at(place.s)
        return getattr(forces, output.quantity)[:, 0]
    return history(solution, output)


def row_values(model: Model, recorder: Recorder, output: Wanted) -> np.ndarray | None:
    """Values (n, ...) of an output of a node that rows have as it is, else None; a copy of them."""
    if not isinstance(output, Output) or not isinstance(output.of, Node):
        return None
    measured = Measured(output)
    array, X = measured.quantity.of, model.mesh.X.reshape(-1)
    if array not in ("q", "v") or not recorder.has_as_it_is(array):
        return None
    rows = recorder.arrays[array][: recorder.rows]
    return measured.values(lambda name, entries: X[entries] if name == "X" else rows[:, entries])
