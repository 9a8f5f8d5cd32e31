"""Loops in long trees: the derivatives of their gaps border the linear system with ties.

    [A + k Ghat^T G   Ghat^T] [dy]   [R]
    [G                0     ] [F ] = [0]

The stiffness k does no work where G dy = 0. With it the first block is regular also if the tree has
no inertia against a motion that the loops do not allow.
"""

from __future__ import annotations

import numpy as np

from .index_reduction import LoopTables, sparsity


class GapBorders:
    """The borders, from the entries of the gaps: closure, column, place of the value, and sign."""

    def __init__(
        self,
        entries: tuple[np.ndarray, ...],
        rows: np.ndarray,
        columns: np.ndarray,
        pattern: tuple[np.ndarray, np.ndarray],
        unit: np.ndarray,
    ):
        self._gap, self._column, self._place, self._sign = entries
        #: Row and column of each entry in the linear system; -1 if it belongs to no unknown.
        self._rows, self._columns = rows[self._column], columns[self._column]
        self._count = int(self._gap.max()) + 1
        moves = np.flatnonzero(self._columns >= 0)
        left, right = (part.ravel() for part in np.meshgrid(moves, moves, indexing="ij"))
        same = self._gap[left] == self._gap[right]
        #: Pairs of entries of one gap.
        self._left, self._right = left[same], right[same]
        indptr, indices = pattern
        self._n = n = len(indptr) - 1
        inner = np.repeat(np.arange(n), np.diff(indptr))
        all_rows = np.concatenate([inner, self._rows[self._left]])
        all_columns = np.concatenate([indices, self._columns[self._right]])
        #: The pattern with the stiffness; the places of the entries of the given one in it.
        self.pattern, place = sparsity(all_rows, all_columns, n)
        self.places, self._pairs = np.split(place, [len(inner)])
        indptr, indices = self.pattern
        row = np.repeat(np.arange(n), np.diff(indptr))
        self._diagonal = np.flatnonzero((row == indices) & (row < len(unit)))
        self._unit = unit[row[self._diagonal]]

    def stiffen(self, out: np.ndarray, values: np.ndarray, virtual_map: np.ndarray) -> None:
        """Add the stiffness to a tangent, whose diagonal gives its size; for T and That."""
        stiff = (abs(out[self._diagonal]) / self._unit**2).max()
        left, right = self._sign * virtual_map[self._place], self._sign * values[self._place]
        np.add.at(out, self._pairs, stiff * left[self._left] * right[self._right])

    def of(self, values: np.ndarray, virtual_map: np.ndarray) -> np.ndarray:
        """Ghat and G (2, closures, unknowns) in the linear system."""
        found, on = np.zeros((2, self._count, self._n)), self._columns >= 0
        for out, at, entries in zip(
            found, (self._rows, self._columns), (virtual_map, values), strict=True
        ):
            np.add.at(out, (self._gap[on], at[on]), (self._sign * entries[self._place])[on])
        return found

    def tables(self) -> LoopTables:
        """What the gaps' derivatives border."""
        values = {
            "stiffened": len(self._pairs),
            "scales": len(self._diagonal),
            "gap_column": self._column,
            "stiff_left": self._left,
            "stiff_right": self._right,
            "scale_unit": self._unit,
        }
        return LoopTables(values, {"stiff_to": self._pairs, "scale_at": self._diagonal})
