"""Where the factors of the reduced tangent stand, in a band or in sparse rows, and its entries."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from fx_beam.coupling.index_reduction import Tables

# Half width up to which a band, whose loops the compiler unrolls, beats sparse rows in any case.
_NARROW = 11
# Time of a multiplication in sparse rows, whose entries are looked up, over one in a band.
_LOOK_UP = 4


class Factors(NamedTuple):
    """Places of the factors L and U of the reduced tangent, which is factored without pivoting."""

    #: Place of each unknown (n,) in the elimination, and of each entry of the tangent.
    order: np.ndarray
    at: np.ndarray
    #: Number of places.
    size: int
    #: Number of subdiagonals, and of superdiagonals; 0 for sparse rows.
    band: int
    #: Where each sparse row starts, columns of its entries, and where its diagonal stands.
    starts: np.ndarray
    columns: np.ndarray
    diagonals: np.ndarray

    def __str__(self):
        return f"band {self.band}" if self.band else f"sparse, {self.size} entries"


def factors_of(indptr: np.ndarray, indices: np.ndarray) -> Factors:
    """Factors in a band where joints and frames leave it narrow, otherwise in sparse rows."""
    n = len(indptr) - 1
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    graph = (graph + graph.T).tocsr()
    rows = np.repeat(np.arange(n), np.diff(indptr))
    banded = _in_band(graph, rows, indices)
    if banded.band <= _NARROW:
        return banded
    sparse = _in_rows(graph, rows, indices)
    above = sparse.starts[1:] - sparse.diagonals - 1
    few = _LOOK_UP * (above @ (above + 1)) < n * banded.band * (banded.band + 1)
    return sparse if few else banded


def _in_band(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """In the order of reverse Cuthill-McKee, row by row with places for what fills in."""
    n = graph.shape[0]
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    i, j = order[rows], order[columns]
    band = max(1, int(abs(i - j).max(initial=0)))
    width, none = 2 * band + 1, np.empty(0, dtype=int)
    return Factors(order, i * width + band + j - i, n * width, band, none, none, none)


def _in_rows(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """In an order of minimum degree, with places for what fills in and no others."""
    n = graph.shape[0]
    dominant = scipy.sparse.diags(np.full(n, 2.0 * n)) - (graph != 0)
    options = {"SymmetricMode": True}
    order = splu(
        dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    ).perm_c.astype(int)
    above: list[set[int]] = [set() for _ in range(n)]
    for a, b in zip(order[rows].tolist(), order[columns].tolist(), strict=True):
        if a != b:
            above[min(a, b)].add(max(a, b))
    below: list[list[int]] = [[] for _ in range(n)]
    # Elimination joins what stands above a pivot; the nearest of it passes that on.
    for k in range(n):
        for j in above[k]:
            below[j].append(k)
        if above[k]:
            nearest = min(above[k])
            above[nearest] |= above[k] - {nearest}
    lengths = np.array([len(below[k]) + 1 + len(above[k]) for k in range(n)])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    diagonals = starts[:-1] + np.array([len(left) for left in below])
    filled = np.array([j for k in range(n) for j in (*below[k], k, *sorted(above[k]))])
    # Rows in order and their columns in order: places by bisection.
    keys = np.repeat(np.arange(n), lengths) * n + filled
    at = np.searchsorted(keys, order[rows] * n + order[columns])
    return Factors(order, at, len(filled), 0, starts, filled, diagonals)


def alone_in_column(t: Tables, size: int, free: int) -> np.ndarray:
    """Which degrees of freedom (size,) are an unknown that nothing else follows."""
    row, column = t.entries["row"], t.entries["column"]
    equal = (t.entries["value"] == 0) & (t.entries["sign"] == 1) & (column < free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(size, dtype=bool)
    alone[row[equal & single]] = True
    return alone


def places_of_entries(
    t: Tables, tangent, alone: np.ndarray, at: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Places of the entries of the full tangent, and their number.

    Those of the factors where an entry is one of the reduced tangent, otherwise behind them.
    """
    direct = np.repeat(alone, np.diff(tangent.indptr)) & alone[tangent.indices]
    place = np.empty(tangent.nnz, dtype=int)
    place[t.plain["source"]] = at[t.plain["to"]]
    others = np.flatnonzero(~direct)
    place[others] = behind + np.arange(len(others))
    return place, behind + len(others)
