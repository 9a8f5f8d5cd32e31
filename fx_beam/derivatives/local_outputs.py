"""Outputs of nodes, joints, beams and lines: derivatives by states, forces and numbers."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.fem.beam_slopes import BeamSlopes
from fx_beam.fem.point_values import PointValues
from fx_beam.laws.interval import StepBatch
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import BeamPlace
from fx_beam.scene.outputs import Measured
from fx_beam.step.model import Model

from .gradient import Block, Chosen, of_entries
from .row_output import Needs, Places, RowOutput, place_of

#: Forces in steps, at the start, and of rates that fit, by the names of arrays in `State`.
_FORCES = {
    "joint_forces": ("joints", "forces of joints", "impulses of joints"),
    "constraint_forces": ("constraints", "forces of columns", "impulses of columns"),
}
# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"
# Numbers of the scene that outputs read: positions, and those of joints with a slide.
_NUMBERS = "X", "offsets of slides", "axes of slides"


class LocalOutput(RowOutput):
    """An output of a node or a joint; rates that fit the joints are "rates" of the states.

    Or of a place, of which there are numbers.
    """

    def __init__(self, places: Places, name: str, measured: Measured):
        super().__init__(places, name, measured)
        sub_steps, self._model = self._sub_steps, self._sub_steps.model
        self._rates = sub_steps.rates
        #: Lengths of a row.
        self.shape = measured.shape

        def read(array: str, entries: int | np.ndarray) -> np.ndarray:
            if array == "X":
                return self._model.mesh.X.reshape(-1)[entries]
            states = sub_steps.states[self._rates if array == "v" else array]
            return states[places.ends, entries]

        at_rest = self._model.scheme.rates.at_rest and measured.quantity.of in ("v", "a")
        terms = () if at_rest else measured.slopes(read)
        blocks = (block for term in terms for block in self._blocks_of(*term))
        self._blocks = [block for block in blocks if len(block.rows)]
        if isinstance(measured.place, BeamPlace) and not at_rest and len(places.ends):
            self._blocks += self._by_place(measured, read, place_of(name))

    def blocks(self, rows: np.ndarray) -> list[Block]:
        """Derivatives of the output, in all rows."""
        return self._blocks

    def _by_place(self, measured: Measured, read: Callable, numbers: str) -> Iterator[Block]:
        """Derivatives by where the place is in its element."""
        slopes = itertools.cycle(measured.place.shares_and_slopes[1])
        terms = [*zip(measured.terms, slopes, strict=False)]
        rows = np.arange(len(self._places.ends))
        for part in range(np.size(measured.terms[0].entries)):
            slope = sum(
                slope * read(term.array, np.ravel(term.entries)[part]) for term, slope in terms
            )
            yield Block(numbers, slice(1), rows, slope[:, None], part=part)

    def _blocks_of(self, array: str, entries: np.ndarray, factor: ArrayLike) -> Iterator[Block]:
        """Derivatives by entries of states, forces and numbers, one for each component."""
        entries = np.atleast_1d(entries)
        parts = np.arange(len(entries))
        if (columns := self._model.force_columns.get(array)) is not None:
            columns = columns.reshape(-1)[entries]
            have_column = columns >= 0
            array, entries, parts = "constraint_forces", columns[have_column], parts[have_column]
        if array == "a":
            yield from self._change(self._rates, entries, parts)
            yield self._at_start("a", entries, parts)
        elif array in _FORCES:
            yield from self._force(*_FORCES[array], entries, parts)
        elif array in _NUMBERS:
            yield of_entries(array, entries, parts, np.arange(len(self._places.ends)), factor)
        else:
            name, ends = self._rates if array == "v" else array, self._places.ends
            state_entries = self._at(name, entries)
            yield of_entries(name, state_entries, parts, np.arange(len(ends)), factor, ends)

    def _at(self, name: str, entries: np.ndarray) -> np.ndarray:
        known = self._places.entries.get(name)
        return entries if known is None else np.searchsorted(known, entries)

    def _change(self, name: str, entries: np.ndarray, parts: np.ndarray) -> Iterator[Block]:
        """The change over the steps, by their lengths."""
        places, rows = self._places, self._places.moved
        rate_factor = 1 / places.steps.lengths[rows]
        for boundaries, factor in ((places.ends, rate_factor), (places.starts, -rate_factor)):
            yield of_entries(name, self._at(name, entries), parts, rows, factor, boundaries[rows])

    def _at_start(self, name: str, entries: np.ndarray, parts: np.ndarray) -> Block:
        return of_entries(name, entries, parts, self._places.at_start, 1.0)

    def _force(
        self, name: str, at_start: str, impulse: str, entries: np.ndarray, parts: np.ndarray
    ) -> Iterator[Block]:
        """A mean force over the steps, with what rates that fit add to it."""
        steps, forces = self._places.steps, self._places.forces
        yield of_entries(name, entries, parts, steps.of, steps.shares, forces)
        yield self._at_start(at_start, entries, parts)
        if self._model.fits_rates:
            yield from self._change(impulse, entries, parts)


class ResultantOutput(RowOutput):
    """N, Q or M (n, points) of a beam at the rows (n,) of a run: means over their steps."""

    record = "rates"  # on which they may depend

    def __init__(self, places: Places, name: str, measured: Measured):
        super().__init__(places, name, measured)
        model = self._sub_steps.model
        assert model.forms.beams is not None
        self._beams = model.forms.beams
        names = [member.name for member in model.scene.beams]
        self._cells = model.mesh.cells[names.index(measured.place.name)]
        self._component = "NQM".index(measured.name)
        self.shape = (len(self._cells) * model.forms.internal_shape[1],)
        self._rows, self._steps, self._shares = places.means()

    @staticmethod
    def value(solution: Solution, measured: Measured) -> np.ndarray:
        """As of `RowOutput`."""
        return getattr(solution.resultants(measured.place), measured.name)

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return Needs(steps=True, whole=True)

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """As of `RowOutput`."""
        sub_steps, counting = self._sub_steps, np.flatnonzero(np.isin(self._rows, rows))
        for group in sub_steps.groups(counting):
            chosen = counting[group]
            steps = self._steps[chosen]
            yield from sub_steps.in_steps(steps, self._by_fields(chosen, sub_steps.parts(steps)))

    def _by_fields(self, chosen: np.ndarray, parts: StepBatch) -> Iterator[Block]:
        """Derivatives by what forms read of some sub-steps."""
        rows, shares, cells = self._rows[chosen], self._shares[chosen, None], self._cells
        beams, has_places = BeamSlopes(self._beams), self._sub_steps.has_places
        for name, dofs, slopes in beams.resultants(parts, has_places, self._component):
            points, entries = slopes.shape[2], dofs[cells]
            slopes = np.ascontiguousarray(np.moveaxis(slopes[:, cells], (2, 3), (0, 1)))
            components = np.arange(len(cells) * points).reshape(-1, points).T
            if name == "parameters":  # which all elements share
                for (point, k), component in np.ndenumerate(components):
                    values = shares * slopes[point, :, :, k].T
                    yield Block(name, entries[k], rows, values, part=int(component))
                continue
            for point, number in np.ndindex(slopes.shape[:2]):
                values, cell_entries = shares * slopes[point, number], _evenly(entries[:, number])
                yield Block(name, cell_entries, rows, values, part=_evenly(components[point]))


def _evenly(entries: np.ndarray) -> Chosen:
    """Entries (n,) as a slice, which is quicker, if they are at equal distances."""
    first, step = int(entries[0]), int(entries[-1] - entries[0]) // max(len(entries) - 1, 1)
    even = step > 0 and np.array_equal(entries, first + step * np.arange(len(entries)))
    return slice(first, int(entries[-1]) + 1, step) if even else entries


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
