"""Storage of the reduced tangent and its LU factors: as a band matrix or in sparse rows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from fx_beam.coupling.index_reduction import Tables

# Up to this half bandwidth a band is always faster: the compiler unrolls its loops.
_NARROW = 11
# Rows in a group: the degrees of freedom of a node.
_GROUP = 3
# Time of a multiplication in sparse rows, by indirect addressing, relative to one in a band.
_INDIRECT = 4


class Groups(NamedTuple):
    """Groups of up to three successive sparse rows with equal columns, usually those of a node."""

    #: First rows (groups + 1,).
    first: np.ndarray
    #: Groups that are subtracted from the rows of each, in one list, and where each begins in it.
    source_starts: np.ndarray
    sources: np.ndarray
    #: Columns behind each group as runs of successive ones: their first columns and lengths.
    run_starts: np.ndarray
    run_columns: np.ndarray
    run_lengths: np.ndarray


class Factors(NamedTuple):
    """Storage layout of the factors L and U of the reduced tangent, without pivoting."""

    #: Position of each unknown (n,) in the elimination, and storage index of each tangent entry.
    order: np.ndarray
    at: np.ndarray
    #: Number of stored values.
    size: int
    #: Half bandwidth: number of subdiagonals and of superdiagonals; 0 for sparse rows.
    band: int
    #: Start of each sparse row, columns of its entries, and storage index of its diagonal.
    starts: np.ndarray
    columns: np.ndarray
    diagonals: np.ndarray
    groups: Groups | None = None

    def __str__(self):
        return f"band {self.band}" if self.band else f"sparse, {self.size} entries"


def factors_of(indptr: np.ndarray, indices: np.ndarray) -> Factors:
    """Band storage if the bandwidth is small enough, otherwise sparse rows."""
    n = len(indptr) - 1
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    graph = (graph + graph.T).tocsr()
    rows = np.repeat(np.arange(n), np.diff(indptr))
    banded = _in_band(graph, rows, indices)
    if banded.band <= _NARROW:
        return banded
    sparse = _in_rows(graph, rows, indices)
    above = sparse.starts[1:] - sparse.diagonals - 1
    few = _INDIRECT * (above @ (above + 1)) < n * banded.band * (banded.band + 1)
    return sparse if few else banded


def _in_band(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Band storage in reverse Cuthill-McKee order, row by row, with room for the fill-in."""
    n = graph.shape[0]
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    i, j = order[rows], order[columns]
    band = max(1, int(abs(i - j).max(initial=0)))
    width, none = 2 * band + 1, np.empty(0, dtype=int)
    return Factors(order, i * width + band + j - i, n * width, band, none, none, none)


def _in_rows(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Sparse rows in minimum-degree order, with room for exactly the fill-in."""
    n = graph.shape[0]
    # Factors of a matrix with this graph show the fill-in: it is dominated by its diagonal, so that
    # rows are not exchanged. Without relaxed supernodes SuperLU stores what may differ from zero.
    dominant = scipy.sparse.diags(np.full(n, 2.0 * n)) - (graph != 0)
    options = {"SymmetricMode": True}
    lu = splu(
        dominant.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        relax=1,
        options=options,
    )
    order = lu.perm_c.astype(int)
    lower, upper = lu.L, lu.U
    lower.data[:] = upper.data[:] = 1.0  # small ones may have become zero
    pattern = (lower + upper).tocsr()
    pattern.sort_indices()
    del lu, lower, upper
    starts, filled = pattern.indptr, pattern.indices
    row = np.repeat(np.arange(n, dtype=np.int32), np.diff(starts))
    diagonals = starts[:-1] + np.bincount(row[filled < row], minlength=n)
    # Rows and their columns are sorted: storage indices by bisection.
    keys = row.astype(np.int64) * n + filled
    at = np.searchsorted(keys, order[rows] * n + order[columns])
    del keys
    groups = _groups(starts, filled, diagonals)
    return Factors(order, at, len(filled), 0, starts, filled, diagonals, groups)


def _groups(starts: np.ndarray, columns: np.ndarray, diagonals: np.ndarray) -> Groups:
    n = len(diagonals)
    row = np.repeat(np.arange(n, dtype=np.int32), np.diff(starts))
    # Sums of random numbers of the columns: equal for equal columns, else hardly ever.
    number = np.random.default_rng(0).integers(1, 2**62, n, dtype=np.int64)
    sums = np.concatenate([[0], np.cumsum(number[columns])])  # modulo 2^64
    below, above = sums[diagonals] - sums[starts[:-1]], sums[starts[1:]] - sums[diagonals + 1]
    low, high = columns < row, columns > row
    like_last = np.zeros(n, dtype=bool)
    like_last[1:] = (below[1:] == below[:-1] + number[:-1]) & (above[:-1] == above[1:] + number[1:])
    since = np.arange(n) - np.maximum.accumulate(np.where(like_last, 0, np.arange(n)))
    first = np.append(np.flatnonzero(since % _GROUP == 0), n)
    group_of = np.repeat(np.arange(len(first) - 1), np.diff(first))
    # Lower columns of the first row of each group.
    mine = np.flatnonzero(low & (first[group_of[row]] == row))
    of, source = group_of[row[mine]], group_of[columns[mine]]
    new = np.ones(len(of), dtype=bool)
    new[1:] = (of[1:] != of[:-1]) | (source[1:] != source[:-1])
    source_starts = np.searchsorted(of[new], np.arange(len(first)))
    # Upper columns of the last row of each group.
    mine = np.flatnonzero(high & (first[group_of[row] + 1] - 1 == row))
    of, column = group_of[row[mine]], columns[mine]
    begins = np.ones(len(of), dtype=bool)
    begins[1:] = (of[1:] != of[:-1]) | (column[1:] != column[:-1] + 1)
    run = np.flatnonzero(begins)
    run_starts = np.searchsorted(of[run], np.arange(len(first)))
    lengths = np.diff(np.append(run, len(of)))
    return Groups(first, source_starts, source[new], run_starts, column[run], lengths)


def alone_in_column(t: Tables, size: int, free: int) -> np.ndarray:
    """Whether a degree of freedom equals an unknown on which no other depends, (size,)."""
    row, column = t.entries["row"], t.entries["column"]
    equal = (t.entries["value"] == 0) & (t.entries["sign"] == 1) & (column < free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(size, dtype=bool)
    alone[row[equal & single]] = True
    return alone


def places_of_entries(
    t: Tables, tangent, alone: np.ndarray, at: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Storage index of each entry of the full tangent, and number of stored values.

    Entries that are entries of the reduced tangent share its storage; the others are behind it.
    """
    direct = np.repeat(alone, np.diff(tangent.indptr)) & alone[tangent.indices]
    place = np.empty(tangent.nnz, dtype=int)
    place[t.plain["source"]] = at[t.plain["to"]]
    others = np.flatnonzero(~direct)
    place[others] = behind + np.arange(len(others))
    return place, behind + len(others)
