"""Times of the sub-steps of a run, and the whole steps to which they belong."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError


class WholeSteps(NamedTuple):
    """Some whole steps of a run, with all parts and sub-steps."""

    #: Numbers (n,) of the sub-steps with which they begin, and lengths [s]; 0 for the start itself.
    starts: np.ndarray
    lengths: np.ndarray
    #: Numbers (k,) of all their sub-steps, the steps to which they belong, and their shares.
    sub_steps: np.ndarray
    of: np.ndarray
    shares: np.ndarray


class Times(NamedTuple):
    """Starts, ends and lengths of sub-steps [s], and whether a whole step begins with each.

    Some sub-steps of schemes of order 4 go back in time.
    """

    starts: np.ndarray
    ends: np.ndarray
    lengths: np.ndarray
    begins: np.ndarray
    #: Number of sub-steps of a whole step, or of a part of one that was halved.
    sub_step_count: int = 1

    def steps_to(self, boundaries: np.ndarray) -> WholeSteps:
        """The steps that end before some sub-steps."""
        begins = np.flatnonzero(self.begins)
        last = np.searchsorted(begins, np.maximum(boundaries - 1, 0), side="right") - 1
        starts = np.minimum(begins[last], boundaries)
        counts = boundaries - starts
        rows = np.repeat(np.arange(len(boundaries)), counts)
        sub_steps = np.arange(counts.sum()) + np.repeat(boundaries - counts.cumsum(), counts)
        part_lengths = self.lengths[sub_steps]
        lengths, shares = np.bincount(rows, part_lengths, len(boundaries)), np.ones(len(rows))
        np.divide(part_lengths, lengths[rows], out=shares, where=counts[rows] > 1)
        return WholeSteps(starts, lengths, sub_steps, rows, shares)

    @property
    def first_length(self) -> float:
        """Length of the first step [s]."""
        begins = np.flatnonzero(self.begins)
        return float(self.lengths[: begins[1] if len(begins) > 1 else None].sum())

    def boundaries(self, times: np.ndarray) -> np.ndarray:
        """Numbers of sub-steps before the ends of steps at times (n,) [s].

        SceneError if the tape has a gap, or if a time is inside a step.
        """
        whole = slice(None, None, self.sub_step_count)
        ends = self.ends[self.sub_step_count - 1 :: self.sub_step_count]
        grid = np.concatenate([self.starts[:1], ends])
        least = abs(self.lengths).min(initial=np.inf)
        if (gaps := abs(self.starts[whole] - grid[:-1]) > 1e-3 * least).any():
            raise SceneError(
                f"the step after t = {grid[:-1][gaps][0]:.6g} failed in the compiled loop, so "
                "that there is no derivative. Try a smaller dt"
            )
        rows = np.searchsorted((grid[1:] + grid[:-1]) / 2, times)
        if (misses := abs(grid[rows] - times) > 1e-3 * least).any():
            raise SceneError(
                f"the row at t = {times[misses][0]:.6g} is inside a step, and has no derivative. "
                "Record at ends of steps: with a tolerance, give the times as `breaks` too"
            )
        return self.sub_step_count * rows
