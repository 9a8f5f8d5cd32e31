"""Forces and energies of lines between points as outputs: their derivatives, by their own laws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.fem.point_values import PointValues
from fx_beam.laws.interval import StepBatch
from fx_beam.scene.outputs import Measured
from fx_beam.step.model import Model

from .gradient import Block, of_entries
from .row_output import Needs, Places, RowOutput

# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"


class LineOutput(RowOutput):
    """Quantities of the laws of a line: its force, energy, length or rate."""

    def __init__(self, places: Places, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._line, self._law = measured.place.number, measured.law_quantity
        self._values = PointValues(self._sub_steps.model.points, self._law, self._line)


class PullOutput(LineOutput):
    """The force of a line at the rows (n,) of a run: the mean over the steps that end there."""

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return super().needs(model, measured)._replace(steps=True)

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, places = self._sub_steps, self._places
        steps = places.steps
        counting = np.flatnonzero(np.isin(steps.of, rows))
        for group in sub_steps.groups(counting):
            which = counting[group]
            row_numbers, shares = steps.of[which], steps.shares[which, None]
            numbers = steps.sub_steps[which]
            blocks = (
                Block(name, entries, row_numbers, shares * slopes)
                for name, entries, slopes in self._values.slopes(sub_steps.point_steps(numbers))
            )
            yield from sub_steps.in_steps(numbers, blocks)
        if len(places.at_start):
            yield of_entries(_AT_START, self._line, 0, places.at_start, 1.0)


class StateOutput(LineOutput):
    """The "energy" that a line stores, its "length" or "rate", at the rows (n,) of a run."""

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, model, moves = self._sub_steps, self._sub_steps.model, self._law == "rate"
        boundaries = sub_steps.boundaries[self._places.ends[rows]]
        if moves and model.scheme.rates.at_rest:
            return
        for group in sub_steps.groups(boundaries):
            states = sub_steps.at(numbers := boundaries[group])
            names = ["q", "parameters"]
            arrays = {name: states[name] for name in names if name in states}
            if moves:
                arrays["v"] = states[sub_steps.rates]
            ones, internal = np.ones(len(numbers)), states["spring internal"]
            steps = StepBatch(0 * ones, ones, spring_internal=internal, **arrays)
            blocks = (
                Block(sub_steps.rates if name == "v" else name, entries, rows[group], slopes)
                for name, entries, slopes in self._values.slopes(steps)
            )
            yield from sub_steps.at_states(numbers, blocks)
