"""Sparse matrices in compressed rows: where their entries are, and with more of them."""

from __future__ import annotations

import numpy as np
import scipy.sparse


def positions_in(
    indptr: np.ndarray, indices: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Indices (n,) of the entries at some rows and columns (n,), in a square matrix."""
    size = len(indptr) - 1
    keys = np.repeat(np.arange(size), np.diff(indptr)) * size + indices
    order = None if (np.diff(keys) > 0).all() else np.argsort(keys)
    at = np.searchsorted(keys, rows.astype(int) * size + columns, sorter=order)
    return (at if order is None else order[at]).astype(np.int32)


def with_blocks(
    data: np.ndarray, indices: np.ndarray, indptr: np.ndarray, size: int
) -> scipy.sparse.csr_matrix:
    """A matrix of compressed rows, with a block of 3 x 3 for each node that has no row in it.

    Without such nodes it is a view on the data.
    """
    rows = len(indptr) - 1
    if rows == size:
        return scipy.sparse.csr_matrix((data, indices, indptr), (size, size), copy=False)
    alone = np.arange(rows, size, dtype=indices.dtype).reshape(-1, 1, 3)
    indices = np.concatenate([indices, np.repeat(alone, 3, axis=1).ravel()])
    indptr = np.concatenate([indptr, indptr[-1] + 3 * np.arange(1, size - rows + 1)])
    values = np.zeros(len(indices))
    values[: len(data)] = data
    return scipy.sparse.csr_matrix((values, indices, indptr), (size, size), copy=False)


def with_pairs(
    matrix: scipy.sparse.csr_matrix, pairs: np.ndarray
) -> tuple[scipy.sparse.csr_matrix, np.ndarray | None]:
    """A matrix with entries at some rows and columns (n, 2), and where its own values are.

    If it has all of them, the matrix itself and None.
    """
    if not len(pairs):
        return matrix, None
    size = matrix.shape[0]
    row = np.repeat(np.arange(size), np.diff(matrix.indptr))
    present = row * size + matrix.indices
    missing = np.setdiff1d(pairs[:, 0] * size + pairs[:, 1], present)
    if not len(missing):
        return matrix, None
    keys = np.sort(np.concatenate([present, missing]))
    rows, columns = np.divmod(keys, size)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=size))])
    positions = np.searchsorted(keys, present)
    values = np.zeros(len(keys))
    values[positions] = matrix.data
    indices = columns.astype(matrix.indices.dtype), indptr.astype(matrix.indptr.dtype)
    return scipy.sparse.csr_matrix((values, *indices), matrix.shape, copy=False), positions
