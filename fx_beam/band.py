"""The reduced tangent in a band, and where the entries of the full one stand."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from .reduction import Tables


def in_band(indptr: np.ndarray, indices: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Order of the unknowns that makes the band narrow.

    Parameters
    ----------
    indptr, indices : int
        Sparsity of the reduced tangent in compressed rows.

    Returns
    -------
    band : int
        Number of subdiagonals, and of superdiagonals.
    order : (n,) int
        Place of each unknown.
    at : (entries,) int
        Place of each entry in the band, row by row.
    """
    n = len(indptr) - 1
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)] = np.arange(n)
    rows, columns = order[np.repeat(np.arange(n), np.diff(indptr))], order[indices]
    band = int(abs(rows - columns).max(initial=0))
    return band, order, rows * (2 * band + 1) + band + columns - rows


def alone_in_column(t: Tables, size: int, free: int) -> np.ndarray:
    """Which degrees of freedom are an unknown that nothing else follows.

    Parameters
    ----------
    t : Tables
        The couplings.
    size, free : int
        Numbers of degrees of freedom and of unknowns.

    Returns
    -------
    (size,) bool
        False for those of supports and joints.
    """
    row, column = t.entries["row"], t.entries["column"]
    equal = (t.entries["value"] == 0) & (t.entries["sign"] == 1) & (column < free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(size, dtype=bool)
    alone[row[equal & single]] = True
    return alone


def places_in_band(
    t: Tables, tangent, alone: np.ndarray, at: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Places of the entries of the full tangent: in the band where they are the reduced one's.

    Parameters
    ----------
    t : Tables
        The couplings.
    tangent : scipy.sparse.csr_matrix
        Sparsity of the full tangent.
    alone : (size,) bool
        What `alone_in_column` found.
    at : (entries,) int
        Places of the entries of the reduced tangent.
    behind : int
        First place behind the band.

    Returns
    -------
    place : (tangent.nnz,) int
        Place of each entry, behind the band for those of supports and joints.
    places : int
        Number of places.
    """
    direct = np.repeat(alone, np.diff(tangent.indptr)) & alone[tangent.indices]
    place = np.empty(tangent.nnz, dtype=int)
    place[t.plain["source"]] = at[t.plain["to"]]
    others = np.flatnonzero(~direct)
    place[others] = behind + np.arange(len(others))
    return place, behind + len(others)
