"""Recorded rows, read: their histories, and the sub-steps before them, which have the forces."""

from __future__ import annotations

import functools

import numpy as np

from fx_beam.laws.interval import INSTANT, StepBatch

from .model import fact, need_rates
from .recorded_histories import RecordedHistories, fitted
from .recorder import Recorder


def histories_of(recorder: Recorder) -> RecordedHistories:
    """Histories of the rows so far by their names in `Solution`."""
    model, n, fit = recorder.model, recorder.rows, None
    arrays = recorder.arrays.items()  # views would take more memory than small arrays
    rows = {name: array if len(array) == n else array[:n] for name, array in arrays}
    times, steps = recorder.grid.times, recorder.grid.steps[:n]
    if model.fits_rates:
        first, starts = recorder.starts.up_to_row[:n][:-1], None
        if recorder.grid.every > 1:
            starts = tuple(recorder.starts.arrays[f"start_{name}"][first] for name in "qv")
        driven = None if steps[0] else recorder.first.driven_rates
        fit = functools.partial(fitted, model, rows, starts, (times, steps), driven)
    t, impact = recorder.t, recorder.first.impact
    recorded = {name: array for name, array in rows.items() if name not in recorder.serving}

    def t_level() -> np.ndarray:
        return t - (1 - model.scheme.rates.level) * RowSteps(recorder).lengths()

    late = recorder.late_accelerations
    return RecordedHistories(model, recorded, fit, recorder.turns, t, t_level, impact, late)


class RowSteps:
    """The sub-steps before each row of a recorder, from a first row on.

    Of each sub-step: the row, the share in its step, and whether the start is stored. If not, it is
    a whole step, which starts at the row before.
    """

    def __init__(self, recorder: Recorder, first: int = 0):
        self._recorder, self._first = recorder, first
        stored = recorder.starts
        counts = np.diff(stored.up_to_row[: recorder.rows], prepend=0)[first:]
        repeats, rows = np.maximum(counts, 1), np.arange(first, recorder.rows)
        self._row, self._stored = np.repeat(rows, repeats), np.repeat(counts > 0, repeats)
        #: Rows of starts that are stored.
        self._starts = slice(stored.before_row(first), stored.before_row(recorder.rows))
        self._shares = np.ones(len(self._row))
        self._shares[self._stored] = stored.arrays["share"][self._starts]

    def lengths(self) -> np.ndarray:
        """Length (n,) of the step or last part that a row's forces belong to; 0 for row 0."""
        t1, t0 = self._ends(np.arange(self._first, self._recorder.rows))
        return (t1 - t0) * np.bincount(self._row - self._first, self._shares)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Forces (n, ...) of rows, from those of the sub-steps: means over the steps."""
        if len(values) == self._recorder.rows - self._first:  # one sub-step before each row
            return values
        row = self._row - self._first
        weights = self._shares / np.bincount(row, self._shares)[row]
        begins = np.flatnonzero(np.diff(row, prepend=-1))
        return np.add.reduceat(weights.reshape(-1, *[1] * (values.ndim - 1)) * values, begins)

    def batch(self, moves: bool = False) -> StepBatch:
        """The sub-steps, for which forces of rows are evaluated.

        Row 0 has a single one, so short that its forces depend on the rates, but not on a motion;
        with its rates if resultants have some, or if it `moves`.
        """
        recorder, row, stored = self._recorder, self._row, self._stored
        model, arrays, starts = recorder.model, recorder.arrays, recorder.starts.arrays
        beams, at_start = model.forms.beams, not self._first
        assert beams is not None
        previous, last = np.maximum(row - 1, 0), np.flatnonzero(np.diff(row, append=recorder.rows))
        rows, counts, rest = row[last], np.diff(last, prepend=-1), self._shares.copy()

        def begins(name: str) -> np.ndarray:
            values = arrays[name][previous]
            values[stored] = starts[f"start_{name}"][self._starts]
            return values

        def ends(begins: np.ndarray, row_ends: np.ndarray) -> np.ndarray:
            values = np.empty_like(begins)
            values[:-1], values[last] = begins[1:], row_ends
            return values

        for end, count in zip(last[counts > 1], counts[counts > 1], strict=True):
            sub_steps_of_row = slice(end + 1 - count, end + 1)
            rest[sub_steps_of_row] = np.cumsum(rest[sub_steps_of_row][::-1])[::-1]
        t1, t0 = self._ends(row)
        begin = t1 - (t1 - t0) * rest
        dt, level = ends(begin, t1[last]) - begin, model.scheme.rates.level
        t = begin + level * dt
        q = begins("q") + self._missing(np.where(stored, row, previous))
        D = ends(q, arrays["q"][rows] + self._missing(rows)) - q
        if at_start:
            dt[0] = INSTANT * (np.diff(recorder.grid.times[:2]).sum() or 1.0)
            if moves or beams.facts.resultants_move:
                D[0] = dt[0] * recorder.first.v
                q[0] -= level * D[0]
        parts = StepBatch(t, dt, D, q)
        names = [*("v", "a")[: 2 * fact(model, need_rates)]]
        names += ["internal"] * (beams.internal_shape[-1] > 0)
        names += ["natural"] * bool(model.data.natural)
        batch_arrays = {name: begins(name) for name in names}
        if at_start and "a" in batch_arrays:  # there is no motion in row 0
            batch_arrays["a"][0] = 0.0
        if "natural" in batch_arrays:
            batch_arrays["natural_end"] = ends(batch_arrays["natural"], arrays["natural"][rows])
        memory, q_previous = np.zeros(len(row)), q
        if beams.facts.needs_previous:  # all are stored, but for the start
            q_previous = q.copy()
            memory[stored] = starts["memory"][self._starts]
            q_previous[stored] = starts["start_q_previous"][self._starts]
            q_previous[stored] += self._missing(row[stored])
        # Where parameters are inputs of a motion, only the rows know their earlier values.
        if any(function.ramps for function in model.forms.parameters.functions):
            batch_arrays["parameters"] = self._parameters(parts.t)
        return parts._replace(memory=memory, q_previous=q_previous, **batch_arrays)

    def _ends(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends and starts [s] of the steps of rows."""
        times, steps = self._recorder.grid.times, self._recorder.grid.steps[row]
        return times[steps], times[np.maximum(steps - 1, 0)]

    def _missing(self, rows: np.ndarray) -> np.ndarray | float:
        """Full turns (n, size) [rad] that are missing in some rows."""
        if not (turns := self._recorder.turns):
            return 0.0
        turn_rows = np.array([np.zeros(self._recorder.model.size), *turns.values()])
        return turn_rows[np.searchsorted([*turns], rows, side="right")]

    def _parameters(self, t: np.ndarray) -> np.ndarray:
        """Parameters (n, k) at times (n,) in the steps of rows: linear from row to row."""
        recorder, row = self._recorder, self._row
        previous, values = np.maximum(row - 1, 0), recorder.arrays["parameters"]
        t0, t1 = (recorder.grid.times[recorder.grid.steps[rows]] for rows in (previous, row))
        part = (t - t0) / np.where(row > 0, t1 - t0, 1.0)
        return values[previous] + part[:, None] * (values[row] - values[previous])
