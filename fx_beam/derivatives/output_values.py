"""Values of outputs in a solution, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam
from fx_beam.scene.joints import Joint
from fx_beam.scene.outputs import OF_BEAMS, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.recorder import Record
from fx_beam.validation import require

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], Any]
# Resultants may depend on rates.
_RATES = {"velocity", "acceleration", "spin", "rate", *OF_BEAMS}
_FORCES = {"reaction", "force", "motor_force"}


class Recording:
    """What of a record is recorded: only what the outputs need."""

    def __init__(self, given: Record):
        self._given = given
        #: The records so far, by whether they have rates and forces.
        self._known: dict[tuple[bool, bool], Record] = {}

    def of(self, outputs: Mapping[str, Wanted]) -> Record:
        """The record for some outputs, the same one for those that need the same."""
        given, of = self._given, set()
        for output in outputs.values():
            if not isinstance(output, Output):
                return given
            of.add(output.quantity)
        needs = given.rates and not of.isdisjoint(_RATES), not of.isdisjoint(_FORCES)
        if needs not in self._known:
            rates, forces = needs[0], given.forces and needs[1]
            self._known[needs] = replace(given, rates=rates, forces=forces)
        return self._known[needs]


def values_of(solution: Solution, output: Wanted, name: str) -> np.ndarray:
    """Values (n, ...) of an output."""
    if not isinstance(output, Output):
        values = np.asarray(output(solution))
        wanted = "a number or an array of numbers"
        require(values.dtype.kind in "iufb", f"Response: the output {name!r}", values, wanted)
        return values
    of = output.of
    if isinstance(of, Scene):
        name = output.quantity.removesuffix("_energy")
        rows = getattr(solution.energy, "springs" if name == "spring" else name)
    elif isinstance(of, Beam):
        rows = getattr(solution.resultants(of), output.quantity)
    elif isinstance(of, Joint):
        rows = getattr(solution.joint(of), output.quantity)
    else:
        rows = getattr(solution, output.quantity)(of)
    return rows if output.index is None else rows[:, output.index]
