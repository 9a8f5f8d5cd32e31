"""Values of outputs in a solution, and what of a record they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam
from fx_beam.scene.joints import Joint
from fx_beam.scene.outputs import OF_BEAMS, Output
from fx_beam.scene.scene import Scene
from fx_beam.stepping.recorder import Record
from fx_beam.validation import require

#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], Any]
# Resultants may depend on rates.
_RATES = {"velocity", "acceleration", "spin", "rate", *OF_BEAMS}
_FORCES = {"reaction", "force", "motor_force"}


def recording(given: Record, outputs: Mapping[str, Wanted]) -> Record:
    """What of a record is recorded: only what the outputs need."""
    kinds = [output for output in outputs.values() if isinstance(output, Output)]
    if len(kinds) < len(outputs):
        return given
    of = {output.quantity for output in kinds}
    return Record(
        given.every,
        motion=given.motion,
        rates=given.rates and bool(of & _RATES),
        forces=given.forces and bool(of & _FORCES),
        times=given.times,
    )


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
