"""Forces and energies of lines between points as outputs: their derivatives, by their own laws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.fem.line_values import LineSlopes, LineSteps, LineValues
from fx_beam.scene.outputs import Measured
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model

from .gradient import Block, of_entries
from .row_output import Needs, Places, RowOutput
from .sub_steps import SubSteps

# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"


class LineOutput(RowOutput):
    """What the laws of a line have: its force, energy, length or rate."""

    def __init__(self, places: Places, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._line, self._law = measured.place.number, measured.by_law
        self._values = LineValues(self._of.model.points, self._line, self._law)


class PullOutput(LineOutput):
    """The force of a line at the rows (n,) of a run: the mean over the steps that end there."""

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return super().needs(model, measured)._replace(steps=True)

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, places = self._of, self._places
        steps = places.steps
        counting = np.flatnonzero(np.isin(steps.of, rows))
        for group in sub_steps.groups(counting):
            which = counting[group]
            of_rows, shares = steps.of[which], steps.shares[which, None]
            for block in pull_blocks(sub_steps, self._values, of_rows, steps.sub_steps[which]):
                yield block._replace(derivatives=shares * block.derivatives)
        if len(places.at_start):
            yield of_entries(_AT_START, self._line, 0, places.at_start, 1.0)


def pull_blocks(
    sub_steps: SubSteps, values: LineValues, rows: np.ndarray, steps: np.ndarray
) -> Iterator[Block]:
    """Derivatives of a pull in rows (k,), each of one of k sub-steps."""
    before, after, _ = sub_steps.places(steps)
    for name, entries, slopes in values.slopes(_steps(sub_steps, steps)):
        if name == "increment":
            yield Block("q", entries, rows, slopes, after)
            yield Block("q", entries, rows, -slopes, before)
        elif name == "points":
            yield Block(name, entries, rows, slopes)
        else:
            yield Block(name, entries, rows, slopes, steps if name == "parameters" else before)


def _steps(sub_steps: SubSteps, steps: np.ndarray) -> LineSteps:
    """What forces along lines read of sub-steps."""
    tape, model, states = sub_steps.tape, sub_steps.model, sub_steps.states
    before, after, _ = sub_steps.places(steps)
    q, dt = states["q"][before], tape.times.lengths[steps]
    factor = tape.memories[steps] if model.scheme.rates.at_rest else np.ones(len(steps))
    parameters = sub_steps.parts(steps).parameters
    return LineSteps(
        q,
        without_turns(model, states["q"][after] - q),
        states["v"][before],
        tape.times.starts[steps] + model.scheme.rates.level * dt,
        dt,
        factor,
        states["spring internal"][before],
        parameters if len(parameters) else np.zeros((len(steps), 0)),
    )


class StateOutput(LineOutput):
    """The "energy" that a line stores, its "length" or "rate", at the rows (n,) of a run."""

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, model, moves = self._of, self._of.model, self._law == "rate"
        boundaries = sub_steps.boundaries[self._places.ends[rows]]
        if moves and model.scheme.rates.at_rest:
            return
        for group in sub_steps.groups(boundaries):
            states = sub_steps.at(numbers := boundaries[group])
            arrays = (states["q"], states["spring internal"], states.get("parameters"))
            steps = LineSteps.of_states(*arrays)
            places = np.searchsorted(sub_steps.boundaries, numbers)
            if moves:
                steps = steps._replace(v=states[sub_steps.rates])
            for slopes in self._values.slopes(steps):
                yield from self._of_slopes(slopes, rows[group], numbers, places)

    def _of_slopes(
        self, slopes: LineSlopes, rows: np.ndarray, numbers: np.ndarray, places: np.ndarray
    ) -> Iterator[Block]:
        name, entries, derivatives = slopes
        if name == "points":
            yield Block(name, entries, rows, derivatives)
        elif name != "parameters":
            array = self._of.rates if name == "v" else name
            yield Block(array, entries, rows, derivatives, places)
        else:
            moved, start = np.flatnonzero(numbers), np.flatnonzero(numbers == 0)
            # Those at the ends of sub-steps are behind those at their levels.
            ends = entries + len(self._of.model.forms.parameters)
            yield Block(name, ends, rows[moved], derivatives[moved], numbers[moved] - 1)
            if len(start):
                yield Block("parameters at the start", entries, rows[start], derivatives[start])
