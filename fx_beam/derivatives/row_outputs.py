"""Outputs that are columns of recorded rows, for which no solution is needed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.scene.beam import Node
from fx_beam.scene.outputs import Output, definition
from fx_beam.step.measured import Measured, measured
from fx_beam.step.model import Model
from fx_beam.step.recorder import Recorder

from .output_values import Wanted


class RowOutputs:
    """Outputs by name as columns of the rows of a model's motions."""

    def __init__(self, outputs: Mapping[str, Wanted], model: Model):
        self._model, self._kinds, self._columns = model, _kinds(outputs), dict[str, Measured]()
        for name, output in outputs.items():
            if isinstance(output, Output) and isinstance(output.of, Node):
                of = definition(output).quantity.of
                if of == "q" or (of == "v" and not model.fits_rates):
                    self._columns[name] = measured(model, output)
        #: Whether all of them are columns.
        self.all = len(self._columns) == len(outputs)

    def serve(self, outputs: Mapping[str, Wanted], model: Model) -> bool:
        """Whether these are the outputs of another scene for the same model."""
        return model is self._model and _kinds(outputs) == self._kinds

    def of(self, recorder: Recorder) -> dict[str, np.ndarray]:
        """Their values (n, ...)."""
        rows, arrays = recorder.rows, recorder.arrays
        return {name: of.of(arrays[of.array][:rows]) for name, of in self._columns.items()}


def _kinds(outputs: Mapping[str, Wanted]) -> list[Any]:
    """What outputs are, whatever scene they belong to."""
    return [
        (name, of.quantity, of.component, of.of.number)
        if isinstance(of, Output) and isinstance(of.of, Node)
        else of
        for name, of in outputs.items()
    ]
