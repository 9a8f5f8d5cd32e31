"""Where the loop stores entries of the full tangent: among those of the reduced one or behind."""

from __future__ import annotations

import numpy as np

from fx_beam.coupling.tables import Tables


def alone_in_column(t: Tables, size: int, free: int) -> np.ndarray:
    """Whether a degree of freedom equals an unknown on which no other depends, (size,)."""
    row, column = t.entries["row"], t.entries["column"]
    equal = (t.entries["value"] == 0) & (t.entries["sign"] == 1) & (column < free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(size, dtype=bool)
    alone[row[equal & single]] = True
    return alone


def storage_of_entries(
    t: Tables, tangent, alone: np.ndarray, at: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Storage index of each entry of the full tangent, and number of stored values.

    Entries that are entries of the reduced tangent share its storage; the others are behind it.
    """
    direct = np.repeat(alone, np.diff(tangent.indptr)) & alone[tangent.indices]
    stored_at, used = np.empty(tangent.nnz, dtype=int), np.zeros(tangent.nnz, dtype=bool)
    used[t.direct["source"]] = True
    stored_at[t.direct["source"]] = at[t.direct["to"]]
    others = np.flatnonzero(~(direct & used))
    stored_at[others] = behind + np.arange(len(others))
    return stored_at, behind + len(others)


def diagonal_of(tangent) -> np.ndarray:
    """Position of each entry of the diagonal of a matrix in compressed rows; -1 without one."""
    rows = np.repeat(np.arange(tangent.shape[0]), np.diff(tangent.indptr))
    positions = np.full(tangent.shape[0], -1)
    (on_diagonal,) = np.nonzero(rows == tangent.indices)
    positions[rows[on_diagonal]] = on_diagonal
    return positions
