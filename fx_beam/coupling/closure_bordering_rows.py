"""Loops: the derivatives of their closures, with the closing forces, border the linear system.

    [A + k Gv^T G   Gv^T] [dy]   [R]
    [G              0   ] [F ] = [0]

The stiffness k does no work where G dy = 0. With it the first block is regular also if the tree has
no inertia against a motion that the loops do not allow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from .tables import LoopTables, sparsity


class ClosedSystem(NamedTuple):
    """A linear system in which forces close the loops."""

    #: Sparsity (indptr, indices), and the positions of the entries of open loops in it.
    pattern: tuple[np.ndarray, np.ndarray]
    open_entries: np.ndarray
    tables: LoopTables
    #: Positions of entries that are 1: of forces that border the system.
    ones: np.ndarray


class ClosureBorderingRows:
    """The rows, from the entries of closures: closure, column, position of value, and sign."""

    def __init__(
        self,
        entries: tuple[np.ndarray, ...],
        rows: np.ndarray,
        columns: np.ndarray,
        pattern: tuple[np.ndarray, np.ndarray],
        unit: np.ndarray,
        carried: np.ndarray | tuple[int, ...] = (),
    ):
        self._closure, column, *_ = entries
        #: Row and column of each entry in the linear system; -1 if it belongs to no unknown.
        self._rows, self._columns = rows[column], columns[column]
        # Those of loops with nodes on beams border the system (c/bordering_rows.h).
        outside, self._carried = np.isin(self._closure, carried), np.array(carried, dtype=int)
        self._rows[outside] = self._columns[outside] = -1
        self._count = int(self._closure.max()) + 1
        moves = np.flatnonzero(self._columns >= 0)
        shape = len(self._closure), self._count
        of_closure = scipy.sparse.csr_matrix(
            (np.ones(len(moves)), (moves, self._closure[moves])), shape
        )
        #: Pairs of entries of one closure.
        self._left, self._right = (of_closure @ of_closure.T).nonzero()
        indptr, indices = pattern
        self._n = n = len(indptr) - 1
        inner = np.repeat(np.arange(n), np.diff(indptr))
        all_rows = np.concatenate([inner, self._rows[self._left]])
        all_columns = np.concatenate([indices, self._columns[self._right]])
        #: The pattern with the stiffness; the positions of the entries of the given one in it.
        self.pattern, position = sparsity(all_rows, all_columns, n)
        self.open_entries, self._pairs = np.split(position, [len(inner)])
        indptr, indices = self.pattern
        row = np.repeat(np.arange(n), np.diff(indptr))
        self._diagonal = np.flatnonzero((row == indices) & (row < len(unit)))
        self._unit = unit[row[self._diagonal]]

    def system(self) -> ClosedSystem:
        """The linear system in which the forces are unknowns behind the others."""
        n, on = self._n, np.flatnonzero(self._columns >= 0)
        indptr, indices = self.pattern
        of_forces = n + self._closure[on]
        row, alone = np.repeat(np.arange(n), np.diff(indptr)), n + self._carried
        rows = [row, of_forces, self._rows[on], alone]
        columns = [indices, self._columns[on], of_forces, alone]
        pattern, position = sparsity(np.concatenate(rows), np.concatenate(columns), n + self._count)
        cuts = np.cumsum([len(indices), len(on), len(on)])
        inner, equation, balance, ones = np.split(position, cuts)
        values = {
            "closure_unknowns": len(on),
            "closure_entry": on,
            "stiffened": len(self._pairs),
            "stiff_left": self._left,
            "stiff_right": self._right,
            "scales": len(self._diagonal),
            "scale_unit": self._unit,
            "carried": len(self._carried),
            "carried_closure": self._carried,
        }
        at = {
            "closure_equation": equation,
            "closure_balance": balance,
            "stiff_to": inner[self._pairs],
            "scale_at": inner[self._diagonal],
        }
        return ClosedSystem(pattern, inner[self.open_entries], LoopTables(values, at), ones)
