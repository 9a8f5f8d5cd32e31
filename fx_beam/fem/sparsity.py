"""Sparse matrices in compressed rows: where their entries are, and with more of them."""

from __future__ import annotations

import numpy as np
import scipy.sparse


def positions_in(
    indptr: np.ndarray, indices: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Indices (n,) of the entries at some rows and columns (n,), in a square matrix."""
    return np.asarray(_numbered(indptr, indices)[rows, columns]).ravel().astype(np.int32) - 1


def _numbered(indptr: np.ndarray, indices: np.ndarray) -> scipy.sparse.csr_matrix:
    """A matrix whose entries are their indices, plus 1 as explicit zeros would be lost."""
    numbers, size = np.arange(1.0, len(indices) + 1), len(indptr) - 1
    return scipy.sparse.csr_matrix((numbers, indices, indptr), (size, size))


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
    marks = scipy.sparse.coo_matrix((np.full(len(pairs), 1e-9), pairs.T), matrix.shape)
    whole = _numbered(matrix.indptr, matrix.indices) + marks.tocsr()
    if whole.nnz == matrix.nnz:
        return matrix, None
    known = np.flatnonzero(whole.data >= 1)
    positions = np.empty(matrix.nnz, dtype=int)
    positions[whole.data[known].astype(int) - 1] = known
    whole.data[:] = 0.0
    whole.data[positions] = matrix.data
    return whole, positions
