"""Forces and energies of lines between points as outputs: their derivatives, by their own laws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.fem.line_values import LineSlopes, LineSteps, LineValues
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.step.full_turns import without_turns

from .gradient import Block, RowOutput, of_entries
from .local_outputs import Places
from .sub_steps import SubSteps

# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"


class PullOutput(RowOutput):
    """The force of a line at the rows (n,) of a run: the mean over the steps that end there."""

    def __init__(self, sub_steps: SubSteps, line: ForceBetween, places: Places):
        self._of, self._line, self._places = sub_steps, line, places
        self._values = LineValues(sub_steps.model.points, line.number, "pull")

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
            yield of_entries(_AT_START, self._line.number, 0, places.at_start, 1.0)


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


class StateOutput(RowOutput):
    """The "energy" that a line stores, its "length" or "rate", at the rows (n,) of a run."""

    def __init__(self, sub_steps: SubSteps, line: ForceBetween, quantity: str, places: Places):
        self._of, self._ends = sub_steps, places.ends
        # The name of the rates of nodes.
        self._rates = "rates" if sub_steps.model.fits_rates else "v"
        self._none = quantity == "rate" and sub_steps.model.scheme.rates.at_rest
        self._moves = quantity == "rate"
        self._values = LineValues(sub_steps.model.points, line.number, quantity)

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, boundaries = self._of, self._of.boundaries[self._ends[rows]]
        for group in sub_steps.groups(boundaries) if not self._none else ():
            states = sub_steps.at(numbers := boundaries[group])
            arrays = (states["q"], states["spring internal"], states.get("parameters"))
            steps = LineSteps.of_states(*arrays)
            places = np.searchsorted(sub_steps.boundaries, numbers)
            if self._moves:
                steps = steps._replace(v=states[self._rates])
            for slopes in self._values.slopes(steps):
                yield from self._of_slopes(slopes, rows[group], numbers, places)

    def _of_slopes(
        self, slopes: LineSlopes, rows: np.ndarray, numbers: np.ndarray, places: np.ndarray
    ) -> Iterator[Block]:
        name, entries, derivatives = slopes
        if name == "points":
            yield Block(name, entries, rows, derivatives)
        elif name != "parameters":
            yield Block(self._rates if name == "v" else name, entries, rows, derivatives, places)
        else:
            moved, start = np.flatnonzero(numbers), np.flatnonzero(numbers == 0)
            # Those at the ends of sub-steps are behind those at their levels.
            ends = entries + len(self._of.model.forms.parameters)
            yield Block(name, ends, rows[moved], derivatives[moved], numbers[moved] - 1)
            if len(start):
                yield Block("parameters at the start", entries, rows[start], derivatives[start])
