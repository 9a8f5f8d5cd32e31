"""Analysis of a response: its rows, tape and numbers give outputs and derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.equilibria.statics import LoadPath
from fx_beam.results.solution import Solution
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import Output, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .output_values import Wanted, values_of
from .parametrised import Parametrised
from .row_output import numbers_of_outputs
from .section_outputs import numbers_of_sections


class Analysis:
    """Runs scenes of parameters; derivatives of its rows follow a tape of its steps."""

    #: The quantity of the whole run that an output may be, a single number; empty for none.
    single = ""
    #: Whether derivatives of a sum of outputs are taken from those of all rows.
    forwards = False
    #: The equilibrium from which the last run started, if it was computed for it.
    path: LoadPath | None = None
    #: Times or load factors (n,) of the rows of the last run.
    t: np.ndarray
    #: The time of the loads of equilibria [s]; functions of time of the inputs of the scene.
    rest_time: float | None = None
    inputs: Mapping[str, object] | None = None
    #: Accelerations (size,) at the start, if an output has them.
    start_accelerations: np.ndarray | None = None

    def __init__(self, parameters: Parametrised):
        self.parameters = parameters
        self._measured_outputs: tuple[object, dict[str, Measured]] = None, {}

    @property
    def outputs(self) -> dict[str, Wanted]:
        """Outputs of the last scene by name."""
        return self.parameters.besides or {}

    @property
    def measured_by_name(self) -> dict[str, Measured]:
        """Outputs of the last scene that are no functions, measured once."""
        outputs = self.outputs
        if self._measured_outputs[0] is not outputs:
            chosen = {name: each for name, each in outputs.items() if isinstance(each, Output)}
            by_name = {name: Measured(output) for name, output in chosen.items()}
            self._measured_outputs = outputs, by_name
        return self._measured_outputs[1]

    @property
    def measured(self) -> list[Measured]:
        """The same in their order."""
        return [*self.measured_by_name.values()]

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times or load factors (n,) and outputs for parameters."""
        raise NotImplementedError

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """The model of the last run, the tape of its steps, and their derivatives."""
        raise NotImplementedError

    def boundaries(self, tape: Tape) -> np.ndarray:
        """Numbers (n,) of the sub-steps after the rows of the last run."""
        return tape.times.boundaries(self.t)

    def value(self, solution: Solution, name: str) -> np.ndarray:
        """Values (n, ...) of an output in a solution, or its only value."""
        return values_of(solution, self.outputs[name], name)

    def read(self, solution: Solution) -> dict[str, np.ndarray]:
        """The outputs (n, ...) of a solution."""
        return {name: self.value(solution, name) for name in self.outputs}

    def changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of all numbers of the last run."""
        raise NotImplementedError

    def numbers_of_outputs(
        self, scene: Scene, outputs: Mapping[str, Any], known: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Numbers of a scene that its outputs read; those `known` are of the last scene."""
        numbers = numbers_of_outputs(outputs, known)
        if any(map(is_section_force, known.values())):
            model, tape, _ = self.tape_of_last_run("derivatives")
            scene = with_functions(scene, self.inputs, "Response: inputs")
            numbers |= numbers_of_sections(model, tape, self.rest_time, scene, known)
        return numbers

    def known_numbers(self) -> dict[str, np.ndarray]:
        """Numbers of the last scene that its outputs read."""
        outputs = self.outputs
        numbers = self.numbers_of_outputs(self.parameters.scene, outputs, outputs)
        if self.start_accelerations is not None:
            numbers["a"] = self.start_accelerations
        return {name: floats(values) for name, values in numbers.items()}

    def of_single(self) -> np.ndarray:
        """Derivatives (m,) by x of the single quantity."""
        raise NotImplementedError

    def of_length(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Derivatives (n, ..., m) of outputs by a length of steps that depends on x."""
        return {}
