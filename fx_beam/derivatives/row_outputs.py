"""Outputs that are columns of recorded rows, for which no solution is needed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.scene.beam import Node
from fx_beam.scene.outputs import Output
from fx_beam.step.model import Model
from fx_beam.step.recorder import Recorder

from .output_values import Wanted

# Rows, and their components at a node, by quantity.
_ROWS: dict[str, tuple[str, slice | int]] = {
    "position": ("q", slice(2)),
    "displacement": ("q", slice(2)),
    "rotation": ("q", 2),
    "velocity": ("v", slice(2)),
    "spin": ("v", 2),
}


class _Columns(NamedTuple):
    """An output as columns of rows."""

    rows: str
    columns: np.ndarray | int
    #: Node whose position is added, and its components; None for none.
    at: tuple[int, slice | int] | None


class RowOutputs:
    """Outputs by name as columns of the rows of a model's motions."""

    def __init__(self, outputs: Mapping[str, Wanted], model: Model):
        self._model, self._kinds = model, _kinds(outputs)
        columns = {name: _columns(of, model) for name, of in outputs.items()}
        #: Whether all of them are columns.
        self.all = None not in columns.values()
        self._columns = {name: of for name, of in columns.items() if of is not None}

    def serve(self, outputs: Mapping[str, Wanted], model: Model) -> bool:
        """Whether these are the outputs of another scene for the same model."""
        return model is self._model and _kinds(outputs) == self._kinds

    def of(self, recorder: Recorder) -> dict[str, np.ndarray]:
        """Their values (n, ...)."""
        found, X = {}, self._model.mesh.X
        for name, (rows, columns, at) in self._columns.items():
            values = recorder.arrays[rows][: recorder.rows].take(columns, axis=1)
            found[name] = values if at is None else X[at] + values
        return found


def _kinds(outputs: Mapping[str, Wanted]) -> list[Any]:
    """What outputs are, whatever scene they belong to."""
    return [
        (name, of.quantity, of.component, of.of.number)
        if isinstance(of, Output) and isinstance(of.of, Node)
        else of
        for name, of in outputs.items()
    ]


def _columns(output: Wanted, model: Model) -> _Columns | None:
    if not (isinstance(output, Output) and isinstance(output.of, Node)):
        return None
    rows, component = _ROWS.get(output.quantity, ("", 0))
    if not rows or (rows == "v" and model.fits_rates):
        return None
    if output.index is not None:
        component = output.index
    number = output.of.number
    at = (number, component) if output.quantity == "position" else None
    return _Columns(rows, model.mesh.dofs[number, component], at)
