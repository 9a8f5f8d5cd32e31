"""Values of outputs in solutions and in recorded rows, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.errors import require
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node
from fx_beam.scene.outputs import CRITICAL_LOAD, PERIOD, Measured, Output
from fx_beam.step.model import Model
from fx_beam.step.recorder import Record, Recorder

from .output_kinds import kind_of

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], Any]


def recorded(requested: Record, last: Record, outputs: Mapping[str, Wanted]) -> Record:
    """The `requested` record, reduced to what the outputs need; the `last` one if it is equal."""
    kinds = set[str]()
    for output in outputs.values():
        if not isinstance(output, Output):
            return requested
        measured = Measured(output)
        kinds.add(kind_of(measured).record(measured))
    rates, forces = requested.rates and "rates" in kinds, requested.forces and "forces" in kinds
    is_same = (last.rates, last.forces) == (rates, forces)
    return last if is_same else replace(requested, rates=rates, forces=forces)


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
    measured = Measured(output)
    return kind_of(measured).value(solution, measured)


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
