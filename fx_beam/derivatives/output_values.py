"""Values of outputs in solutions and in recorded rows, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.errors import require
from fx_beam.results.solution import Solution, history
from fx_beam.results.state import HISTORIES
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.outputs import CRITICAL_LOAD, PERIOD, Output, definition
from fx_beam.scene.scene import Scene
from fx_beam.step.measured import Measured, measured
from fx_beam.step.model import Model
from fx_beam.step.recorder import Record, Recorder

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], Any]


class Recording:
    """What of a record is recorded: only what the outputs need."""

    def __init__(self, given: Record):
        self._given = given
        #: The records so far, by whether they have rates and forces.
        self._known: dict[tuple[bool, bool], Record] = {}

    def of(self, outputs: Mapping[str, Wanted]) -> Record:
        """The record for some outputs, the same one for those that need the same."""
        given, kinds = self._given, set[str]()
        for output in outputs.values():
            if not isinstance(output, Output):
                return given
            kinds.add(record_of(output))
            if isinstance(output.of, Beam):  # resultants may depend on rates
                kinds.add("rates")
        needs = given.rates and "rates" in kinds, "forces" in kinds
        if needs not in self._known:
            rates, forces = needs[0], given.forces and needs[1]
            self._known[needs] = replace(given, rates=rates, forces=forces)
        return self._known[needs]


def record_of(output: Output) -> str:
    """What of a `Record` has an output of a node or a joint: "motion", "rates" or "forces"."""
    history = HISTORIES.get(definition(output).quantity.of)
    return "" if history is None else history.record


def values_of(solution: Solution, output: Wanted, name: str) -> np.ndarray:
    """Values (n, ...) of an output."""
    if not isinstance(output, Output):
        values = np.asarray(output(solution))
        wanted = "a number or an array of numbers"
        require(values.dtype.kind in "iufb", f"Response: the output {name!r}", values, wanted)
        return values
    wanted = "that of a PeriodicResponse: other motions and equilibria have no period"
    require(output.quantity != PERIOD, f"Response: the output {name!r}", str(output), wanted)
    if output.quantity == CRITICAL_LOAD:
        return np.array(first_critical_point(solution).load_factor)
    if isinstance(output.of, Scene):
        name = output.quantity.removesuffix("_energy")
        return getattr(solution.energy, "springs" if name == "spring" else name)
    if isinstance(output.of, Beam):
        return getattr(solution.resultants(output.of), output.quantity)
    return history(solution, output)


class RowOutputs:
    """Outputs by name as columns of the rows of a model's motions: no solution is needed."""

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
