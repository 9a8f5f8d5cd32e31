"""Records of C, whose rows are those of recorders."""

from __future__ import annotations

import weakref

import numpy as np

from .recorder import Rows
from .tables import Problem


class RecordsInC:
    """The structs ``Record`` of recorders, to which C writes rows of its state."""

    def __init__(self, problem: Problem):
        self._ffi, self._state = problem.ffi, problem.c.state
        self._sub_steps = problem.c.scheme.sub_steps
        #: By recorders, each with the recorder's plan and its arrays of rows.
        self._records: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()

    def next(self, recorder: Rows, number: int, first: int = 1, parts: int = 1, done: int = 0):
        """Rows of a recorder, from its next one on, for a number of steps or parts.

        From step `first` on, of which some parts are `done`.
        """
        stores = recorder.stores_starts(parts)
        if stores:
            recorder.make_room(number * self._sub_steps)
        plan, to, _ = self._records.get(recorder, (-1, None, None))
        if plan != recorder.plans:
            to = self._made(recorder)
        to.first, to.last, to.parts, to.part = first, recorder.last, parts, done
        to.stores_starts, to.tape = stores, self._ffi.NULL
        to.rows, to.starts, to.complete = recorder.rows, recorder.starts, recorder.complete
        return to

    def _made(self, recorder: Rows):
        """The same with the arrays that a recorder has now."""
        to = self._ffi.new("Record *")
        rows, starts = dict(recorder.arrays), dict(recorder.arrays_of_starts)
        to.every, to.forces = recorder.every, "constraint_forces" in rows
        if "up_to_row" in rows:
            to.up_to_row = self._ffi.from_buffer("int[]", rows.pop("up_to_row"))
        for name in ("share", "memory"):
            if name in starts:
                setattr(to, name, self._ffi.from_buffer("double[]", starts.pop(name)))
        histories, stored = self._rows(rows), self._rows(starts)
        to.histories, to.history = len(histories), histories
        to.stored, to.start = len(stored), stored
        self._records[recorder] = recorder.plans, to, (histories, stored)
        return to

    def _rows(self, arrays: dict[str, np.ndarray]):
        """Rows of arrays, which C writes from those of the same names, also at `start_`."""
        arrays = {name: array for name, array in arrays.items() if array.shape[1]}
        rows = self._ffi.new("Rows[]", len(arrays))
        for row, (name, array) in zip(rows, arrays.items(), strict=True):
            row.source = getattr(self._state, name.removeprefix("start_"))
            row.size = array.shape[1]
            row.target = self._ffi.from_buffer("double[]", array)
        return rows
