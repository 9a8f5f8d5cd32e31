"""Values of outputs in solutions and in recorded rows, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.errors import require
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import CRITICAL_LOAD, PERIOD, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.recorder import Record, Recorder

from .output_kinds import kind_of

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], ArrayLike]


def is_at_node(output: Wanted, scene: Scene) -> bool:
    """Whether it is an output of a node that a scene has."""
    if not isinstance(output, Output) or not isinstance(node := output.of, Node):
        return False
    return node.scene is scene and node.number not in scene.gone


def node_keys(outputs: Mapping[str, Wanted]) -> list[tuple[str, str, str | None, int]]:
    """Name, quantity, component and node of each output; empty if one is not of a node."""
    keys = []
    for name, output in outputs.items():
        if not isinstance(output, Output) or not isinstance(node := output.of, Node):
            return []
        keys.append((name, output.quantity, output.component, node.number))
    return keys


def recorded(requested: Record, last: Record, measured: list[Measured]) -> Record:
    """The `requested` record, reduced to what the outputs need; the `last` one if it is equal."""
    kinds = {kind_of(output).record_of(output) for output in measured}
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
    return solution.value(output)


def row_values(model: Model, recorder: Recorder, measured: Measured) -> np.ndarray | None:
    """Values (n, ...) of an output of a node that rows have as it is, else None; a copy of them."""
    array, rows = measured.quantity.of, recorder.rows
    is_of_node = isinstance(measured.place, Node) and array in ("q", "v")
    fitted = bool(recorder.turns) or (array == "v" and model.fits_rates)
    if not is_of_node or fitted or array in recorder.serving or array not in recorder.arrays:
        return None
    arrays = {"X": model.mesh.X.reshape(1, -1), array: recorder.arrays[array][:rows]}
    return measured.values(lambda name, entries: arrays[name][:, entries])
