"""A tape of sub-steps: what each was given and found, from which a run is followed backwards."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError

from .handover import Problem

# Numbers of a row before its arrays: start, length, memory, and shares of means (c/tape.h).
TAPED_NUMBERS = 5


class Steps(NamedTuple):
    """Some whole steps of a run, with all parts and sub-steps."""

    #: Numbers (n,) of the sub-steps with which they begin, and lengths [s]; 0 for the start itself.
    starts: np.ndarray
    lengths: np.ndarray
    #: Numbers (k,) of all their sub-steps, the steps to which they belong, and their shares.
    sub_steps: np.ndarray
    of: np.ndarray
    shares: np.ndarray


class Tape:
    """Rows of numbers, one for each sub-step, which the compiled loop writes (c/tape.h)."""

    def __init__(self, problem: Problem):
        self._ffi = problem.ffi
        #: The C struct Tape.
        self.c: Any = problem.ffi.new("Tape *")
        self.c.size = problem.library.fx_tape_size(problem.c)
        self._problem = problem.c
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

    def states(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """States (n, ...) at the starts of some sub-steps, by the names of `State`."""
        found, first, p = {}, TAPED_NUMBERS, self._problem
        n, kept = p.dofs, p.dofs * p.keeps_before
        internal = p.cells * p.cell_internal
        sizes = {"q": n, "v": n, "before": kept, "slides": p.scene_joints, "internal": internal}
        for name, size in (sizes | {"spring_internal": p.spring_width}).items():
            found[name] = self._rows[rows, first : first + size]
            first += size
        return found

    def steps_to(self, boundaries: np.ndarray) -> Steps:
        """The steps that end before some sub-steps."""
        begins = np.flatnonzero(self._rows[: self.c.rows, 4] == 0)
        last = np.searchsorted(begins, np.maximum(boundaries - 1, 0), side="right") - 1
        starts = np.minimum(begins[last], boundaries)
        counts = boundaries - starts
        rows = np.repeat(np.arange(len(boundaries)), counts)
        sub_steps = np.concatenate([np.arange(0), *map(np.arange, starts, boundaries)])
        of_parts = self.lengths[sub_steps]
        lengths, shares = np.bincount(rows, of_parts, len(boundaries)), np.ones(len(rows))
        np.divide(of_parts, lengths[rows], out=shares, where=counts[rows] > 1)
        return Steps(starts, lengths, sub_steps, rows, shares)

    @property
    def memories(self) -> np.ndarray:
        """`Step.memory` of all sub-steps."""
        return self._rows[: self.c.rows, 2]

    @property
    def first_length(self) -> float:
        """Length of the first step [s]."""
        begins = np.flatnonzero(self._rows[: self.c.rows, 4] == 0)
        return float(self.lengths[: begins[1] if len(begins) > 1 else None].sum())

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
