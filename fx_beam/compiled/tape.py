"""A tape of sub-steps: what each was given and found, from which a run is followed backwards."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.errors import SceneError

from .handover import Problem

# Numbers of a row before its arrays, which begin with q and v (c/tape.h).
TAPED_NUMBERS = 5


class Tape:
    """Rows of numbers, one for each sub-step, which the compiled loop writes (c/tape.h)."""

    def __init__(self, problem: Problem):
        self._ffi = problem.ffi
        #: The C struct Tape.
        self.c: Any = problem.ffi.new("Tape *")
        self.c.size = problem.library.fx_tape_size(problem.c)
        self._sub_steps = int(problem.c.sub_steps)
        self._set_rows(np.empty((0, self.c.size)))

    def _set_rows(self, rows: np.ndarray) -> None:
        self._rows = rows
        self.c.row, self.c.room = self._ffi.cast("double *", rows.ctypes.data), len(rows)

    def write(self, rows: np.ndarray) -> None:
        """Have rows that were not written by the loop."""
        self._set_rows(rows)
        self.c.rows = len(rows)

    def __len__(self):
        return self.c.rows

    def clear(self) -> None:
        """Forget all sub-steps; the memory is kept."""
        self.c.rows = 0

    def with_room(self, more: int) -> Any:
        """The C struct, with room for some more sub-steps."""
        if self.c.rows + more > self.c.room:
            rows = np.empty((max(self.c.rows + more, 2 * self.c.room), self.c.size))
            rows[: self.c.rows] = self._rows[: self.c.rows]
            self._set_rows(rows)
        return self.c

    @property
    def starts(self) -> np.ndarray:
        """Times at the starts of all sub-steps [s]."""
        return self._rows[: self.c.rows, 0]

    @property
    def lengths(self) -> np.ndarray:
        """Lengths of all sub-steps; some of schemes of order 4 go back in time [s]."""
        return self._rows[: self.c.rows, 1]

    def states(self, rows: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        """q and v (n, size) at the starts of some sub-steps."""
        q = TAPED_NUMBERS
        return self._rows[rows, q : q + size], self._rows[rows, q + size : q + 2 * size]

    def boundaries(self, times: np.ndarray) -> np.ndarray:
        """Numbers of sub-steps before the ends of steps at times (n,) [s].

        SceneError if the tape has a gap, or if a time is inside a step.
        """
        whole = slice(None, None, self._sub_steps)
        ends = (self.starts + self.lengths)[self._sub_steps - 1 :: self._sub_steps]
        found = np.concatenate([self.starts[:1], ends])
        least = abs(self.lengths).min(initial=np.inf)
        if (gaps := abs(self.starts[whole] - found[:-1]) > 1e-3 * least).any():
            raise SceneError(
                f"the step after t = {found[:-1][gaps][0]:.6g} failed in the compiled loop, so "
                "that there is no derivative. Try a smaller dt"
            )
        rows = np.searchsorted((found[1:] + found[:-1]) / 2, times)
        if (inside := abs(found[rows] - times) > 1e-3 * least).any():
            raise SceneError(
                f"the row at t = {times[inside][0]:.6g} is inside a step, and has no derivative. "
                "Record at ends of steps; `breaks` are such"
            )
        return self._sub_steps * rows
