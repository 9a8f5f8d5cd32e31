"""Outputs of nodes, joints, beams and lines: derivatives by states, forces and numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from fx_beam.fem.beam_slopes import BeamSlopes
from fx_beam.fem.point_values import PointValues
from fx_beam.laws.interval import StepBatch
from fx_beam.scene.measured import Measured, Read, Slope
from fx_beam.step.model import Model

from .gradient import Chosen, DerivativeBlock, of_entries
from .row_output import Needs, RowOutput, RowPlaces, numbers_of_output

#: Forces in steps, at the start, and of rates that fit, by the names of arrays in `State`.
_FORCES = {
    "joint_forces": ("joints", "forces of joints", "impulses of joints"),
    "constraint_forces": ("constraints", "forces of columns", "impulses of columns"),
}
# Slopes of what has entries of a state as components.
_UNITS = np.eye(3)
# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"


class LocalOutput(RowOutput):
    """An output of a node, a place, a joint or a line, whose `Measured` has it and its slopes.

    Rates that fit the joints are "rates" of the states.
    """

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        sub_steps, self._model = self._sub_steps, self._sub_steps.model
        self._rates, self._name = sub_steps.rates, name
        #: Lengths of a row.
        self.shape = measured.shape

        def read(array: str, entries: np.ndarray) -> np.ndarray:
            if array == "X":
                return np.tile(self._model.mesh.X.reshape(-1)[entries], (len(places.ends), 1))
            states = sub_steps.states[self._rates if array == "v" else array]
            return states[places.ends][:, entries]

        spans, counted = self._model.points.spans_of(measured), None
        if spans is not None:
            counted = sub_steps.states["spring internal"][places.ends][:, spans]
        at_rest = self._model.scheme.rates.at_rest and measured.quantity.of in ("v", "a")
        slopes = () if at_rest or not len(places.ends) else self._slopes_of(measured, read, counted)
        self._blocks = [block for slope in slopes for block in self._blocks_of(*slope)]

    def _slopes_of(
        self, measured: Measured, read: Read, counted: np.ndarray | None
    ) -> Iterable[Slope]:
        if (joint := measured.sliding) is not None:
            return [Slope("rates of slides", np.array([joint.number]), np.ones((1, 1, 1)))]
        return measured.slopes(read, counted)

    def blocks(self, rows: np.ndarray) -> list[DerivativeBlock]:
        """Derivatives of the output, in all rows."""
        return self._blocks

    def _blocks_of(
        self, array: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """Derivatives (n, components, e) by entries of states, forces and numbers."""
        if (columns := self._model.force_columns.get(array)) is not None:
            columns = columns.reshape(-1)[entries]
            have_column = columns >= 0
            array, entries = "constraint_forces", columns[have_column]
            slopes = slopes[..., have_column]
        every, ends = np.arange(len(self._places.ends)), self._places.ends
        if array == "a":
            yield from self._change(self._rates, entries, slopes)
            yield from self._blocks_at("a", entries, self._places.at_start, slopes)
        elif array in _FORCES:
            yield from self._force(*_FORCES[array], entries, slopes)
        elif not array:
            yield from self._blocks_at(numbers_of_output(self._name), entries, every, slopes)
        elif array == "X":
            yield from self._blocks_at(array, entries, every, slopes)
        else:
            name = self._rates if array == "v" else array
            yield from self._blocks_at(name, self._at(name, entries), every, slopes, ends)

    @staticmethod
    def _blocks_at(
        name: str,
        entries: np.ndarray,
        rows: np.ndarray,
        slopes: np.ndarray,
        places: np.ndarray | None = None,
        factors: np.ndarray | None = None,
    ) -> Iterator[DerivativeBlock]:
        """Derivatives in rows (k,): those of each are in `slopes`, or are the same in all."""
        n, count, width = slopes.shape
        if not (len(rows) and width):
            return
        values = slopes if n == 1 else slopes[rows]
        if factors is not None:
            values = values * factors[:, None, None]
        values = np.broadcast_to(values, (len(rows), count, width))
        are_entries = n == 1 and np.array_equal(slopes[0], _UNITS[:count, :count])
        if are_entries or count == width == 1:
            parts = np.arange(count)  # each component by its own entry
            yield DerivativeBlock(name, entries, rows, values[:, parts, parts], places, parts)
            return
        for part in range(count):
            yield DerivativeBlock(name, entries, rows, values[:, part], places, part)

    def _at(self, name: str, entries: np.ndarray) -> np.ndarray:
        known = self._places.entries.get(name)
        return entries if known is None else np.searchsorted(known, entries)

    def _change(
        self, name: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """The change over the steps, by their lengths."""
        places, rows = self._places, self._places.moved
        entries, rate_factor = self._at(name, entries), 1 / places.steps.lengths[rows]
        for boundaries, factor in ((places.ends, rate_factor), (places.starts, -rate_factor)):
            yield from self._blocks_at(name, entries, rows, slopes, boundaries[rows], factor)

    def _force(
        self, name: str, at_start: str, impulse: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """A mean force over the steps, with what rates that fit add to it."""
        steps, forces = self._places.steps, self._places.forces
        yield from self._blocks_at(name, entries, steps.of, slopes, forces, steps.shares)
        yield from self._blocks_at(at_start, entries, self._places.at_start, slopes)
        if self._model.fits_rates:
            yield from self._change(impulse, entries, slopes)


class ResultantOutput(RowOutput):
    """N, Q or M (n, points) of a beam at the rows (n,) of a run: means over their steps."""

    record = "rates"  # on which they may depend

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        model = self._sub_steps.model
        assert model.forms.beams is not None
        self._beams = model.forms.beams
        names = [member.name for member in model.scene.beams]
        self._cells = model.mesh.cells[names.index(measured.place.name)]
        self._component = "NQM".index(measured.name)
        self.shape = (len(self._cells) * model.forms.internal_shape[1],)
        self._rows, self._steps, self._shares = places.means()

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return Needs(steps=True, whole=True)

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps, counting = self._sub_steps, np.flatnonzero(np.isin(self._rows, rows))
        for group in sub_steps.groups(counting):
            chosen = counting[group]
            steps = self._steps[chosen]
            yield from sub_steps.in_steps(steps, self._by_fields(chosen, sub_steps.parts(steps)))

    def _by_fields(self, chosen: np.ndarray, parts: StepBatch) -> Iterator[DerivativeBlock]:
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
                    yield DerivativeBlock(name, entries[k], rows, values, part=int(component))
                continue
            for point, number in np.ndindex(slopes.shape[:2]):
                values, cell_entries = shares * slopes[point, number], _evenly(entries[:, number])
                yield DerivativeBlock(
                    name, cell_entries, rows, values, part=_evenly(components[point])
                )


def _evenly(entries: np.ndarray) -> Chosen:
    """Entries (n,) as a slice, which is quicker, if they are at equal distances."""
    first, step = int(entries[0]), int(entries[-1] - entries[0]) // max(len(entries) - 1, 1)
    even = step > 0 and np.array_equal(entries, first + step * np.arange(len(entries)))
    return slice(first, int(entries[-1]) + 1, step) if even else entries


class LineOutput(RowOutput):
    """Quantities of the laws of a line: its force or energy."""

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._line, self._law = measured.place.number, measured.law_quantity
        self._values = PointValues(self._sub_steps.model.points, self._law, self._line)


class PullOutput(LineOutput):
    """The force of a line at the rows (n,) of a run: the mean over the steps that end there."""

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return super().needs(model, measured)._replace(steps=True)

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps, places = self._sub_steps, self._places
        steps = places.steps
        counting = np.flatnonzero(np.isin(steps.of, rows))
        for group in sub_steps.groups(counting):
            which = counting[group]
            row_numbers, shares = steps.of[which], steps.shares[which, None]
            numbers = steps.sub_steps[which]
            blocks = (
                DerivativeBlock(name, entries, row_numbers, shares * slopes)
                for name, entries, slopes in self._values.slopes(sub_steps.point_steps(numbers))
            )
            yield from sub_steps.in_steps(numbers, blocks)
        if len(places.at_start):
            yield of_entries(_AT_START, self._line, 0, places.at_start, 1.0)


class LineEnergyOutput(LineOutput):
    """The "energy" that a line stores, at the rows (n,) of a run."""

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps = self._sub_steps
        boundaries = sub_steps.boundaries[self._places.ends[rows]]
        for group in sub_steps.groups(boundaries):
            states = sub_steps.states_at(numbers := boundaries[group])
            arrays = {name: states[name] for name in ("q", "parameters") if name in states}
            ones, internal = np.ones(len(numbers)), states["spring internal"]
            steps = StepBatch(0 * ones, ones, spring_internal=internal, **arrays)
            blocks = (
                DerivativeBlock(name, entries, rows[group], slopes)
                for name, entries, slopes in self._values.slopes(steps)
            )
            yield from sub_steps.at_states(numbers, blocks)
