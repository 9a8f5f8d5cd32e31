"""Where the sub-steps of recorded steps start: for forces that are evaluated after the run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fx_beam.results.state import State

from .model import Model


def grown(array: np.ndarray, rows: int, used: int) -> np.ndarray:
    """An array with at least some rows, of which those used are kept."""
    if len(array) >= rows:
        return array
    grown = np.zeros((max(rows, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    if used:
        grown[:used] = array[:used]
    return grown


class SubStepStarts:
    """Starts of the sub-steps of the rows' steps, where these are not the previous row.

    Of forces that are not at mid-step only the last part of a step counts.
    """

    def __init__(self, model: Model, motion: bool, rates: bool):
        self._scheme, n, size, beams = model.scheme, 0, model.size, model.forms.beams
        self._always = len(self._scheme.fractions) > 1 or model.forms.needs_previous
        #: Starts (n, ...) by name, and the shares of the sub-steps in their steps.
        self.arrays = {"share": np.zeros(n)}
        if motion:
            self.arrays["start_q"] = np.zeros((n, size))
            if rates and beams is not None and beams.resultants_need_rates:
                self.arrays |= {f"start_{name}": np.zeros((n, size)) for name in "va"}
            if width := math.prod(model.forms.internal_shape):
                self.arrays["start_internal"] = np.zeros((n, width))
            if model.natural:
                self.arrays["start_natural"] = np.zeros((n, model.natural.size))
            if model.forms.needs_previous:
                self.arrays |= {"start_q_previous": np.zeros((n, size)), "memory": np.zeros(n)}
        if model.fits_rates:
            self.arrays |= {f"start_{name}": np.zeros((n, size)) for name in "qv"}
        #: Their number.
        self.count = 0

    def again(self) -> SubStepStarts:
        """None yet, but room for as many."""
        new = object.__new__(SubStepStarts)
        arrays = {name: np.zeros(of.shape, of.dtype) for name, of in self.arrays.items()}
        new.__dict__.update(self.__dict__, arrays=arrays, count=0)
        return new

    def stored(self, parts: int, every: int) -> bool:
        """Whether those of a step in parts are stored, if every n-th step has a row."""
        return self._always or parts > 1 or every > 1

    def has_room(self, more: int) -> bool:
        """Whether there is room for some more starts."""
        return self.count + more <= min(map(len, self.arrays.values()))

    def make_room(self, more: int) -> None:
        """Make room for some more starts."""
        for name, array in self.arrays.items() if more else ():
            self.arrays[name] = grown(array, self.count + more, self.count)

    def begin(self, complete: int, part: int) -> None:
        """Begin a part of a step; so many starts belong to the rows so far."""
        if part == 0 or self._scheme.rates.level != 0.5:
            self.count = complete

    def add(self, starts: Sequence[State], end: State, parts: int) -> None:
        """Add the starts of the scheme's sub-steps in one of a step's parts."""
        self.make_room(len(starts))
        for start, fraction in zip(starts, self._scheme.fractions, strict=True):
            values = {
                f"start_{name}": getattr(start, name)
                for name in ("q", "v", "a", "internal", "natural")
            }
            values |= {"share": fraction / parts, "memory": start.memory(end.length)}
            values["start_q_previous"] = start.q if start.q_previous is None else start.q_previous
            for name, array in self.arrays.items():
                array[self.count] = np.ravel(values[name]) if array.ndim > 1 else values[name]
            self.count += 1

    def of_rows(self, up_to_row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and rotations, and rates, (n - 1, size) at the starts of the rows' steps.

        `up_to_row` (n,) has the numbers of the starts up to each row, the first of them the start.
        """
        q, v = (self.arrays[f"start_{name}"][up_to_row[:-1]] for name in "qv")
        return q, v
