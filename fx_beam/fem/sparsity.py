"""Sparse matrices in compressed rows: where their entries are, and with more of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from fx_beam.content_cache import cached_by_content

#: Sparsity (indptr, indices) of a matrix in compressed rows.
Pattern = tuple[np.ndarray, np.ndarray]


def starts_of(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    """Starts (n,) of parts of some counts, and the end of the last one."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(int)


def sparsity(rows: np.ndarray, columns: np.ndarray, n: int) -> tuple[Pattern, np.ndarray]:
    """Compressed rows of the given pairs, and the position of each pair in them."""
    keys = rows.astype(int) * n + columns
    if (keys[1:] > keys[:-1]).all():
        position = np.arange(len(keys), dtype=np.int32)
    else:
        keys, position = np.unique(keys, return_inverse=True)
        rows, columns = np.divmod(keys, n)
    indptr = starts_of(np.bincount(rows, minlength=n)).astype(np.int32)
    return (indptr, columns.astype(np.int32)), position.astype(np.int32, copy=False)


@cached_by_content
def connected_parts(pairs: np.ndarray, count: int) -> np.ndarray:
    """Number (count,) of the part to which each node belongs; pairs (2, n) are connected."""
    graph = scipy.sparse.coo_matrix((np.ones(pairs.shape[1]), tuple(pairs)), (count, count))
    return connected_components(graph, directed=False)[1]


def positions_in(
    indptr: np.ndarray, indices: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Indices (n,) of the entries at some rows and columns (n,), in a square matrix in order."""
    size = len(indptr) - 1
    keys = np.repeat(np.arange(size), np.diff(indptr)) * size + indices
    return np.searchsorted(keys, rows.astype(int) * size + columns).astype(np.int32)


def places_of_cells(dofs: np.ndarray, indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Indices (cells, n * n) of the entries of cells with degrees of freedom (cells, n).

    In each row the three columns of a node are beside each other.
    """
    cells, n = dofs.shape
    if not cells:
        return np.empty((0, n * n), np.int32)
    node, component = np.divmod(dofs[0], 3)
    _, some, number = np.unique(node, return_index=True, return_inverse=True)
    columns = dofs[:, None, some] // 3 * 3
    first = positions_in(indptr, indices, dofs[:, :, None], columns)
    return (first[:, :, number] + component).reshape(cells, n * n)


def blocks_with(
    entries: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of 3 x 3 that have some of the entries: starts of their rows, columns, and positions.

    The latter (n, 3, 3) are those of all entries.
    """
    nodes, places = (len(indptr) - 1) // 3, np.flatnonzero(entries)
    rows = (np.searchsorted(indptr, places, side="right") - 1) // 3
    row, column = np.divmod(np.unique(rows * nodes + indices[places] // 3), nodes)
    block_rows = 3 * row[:, None] + np.arange(3)
    first = positions_in(
        indptr, indices, block_rows, np.broadcast_to(3 * column[:, None], block_rows.shape)
    )
    starts = np.searchsorted(row, np.arange(nodes + 1))
    return starts, column, first[:, :, None] + np.arange(3, dtype=np.int32)


def matrix_between(elements: np.ndarray, nodes: int) -> scipy.sparse.csr_matrix:
    """Sparsity with a block of 3 x 3 for each node, and for each two nodes of an element."""
    numbers, n = np.arange(nodes), elements.shape[1]
    row = np.append(numbers, np.repeat(elements, n, axis=1))
    column = np.append(numbers, np.tile(elements, (1, n)))
    pairs = scipy.sparse.csr_matrix((np.ones(len(row)), (row, column)))
    matrix = scipy.sparse.kron(pairs, np.ones((3, 3)), "bsr").tocsr()
    matrix.data = np.zeros(matrix.nnz, np.int8)
    return matrix


def with_pairs(matrix: scipy.sparse.csr_matrix, pairs: np.ndarray) -> scipy.sparse.csr_matrix:
    """Sparsity with more entries, at some rows and columns (n, 2); itself for none."""
    if not len(pairs):
        return matrix
    existing = np.ones(matrix.nnz), matrix.indices, matrix.indptr
    added = scipy.sparse.csr_matrix((np.ones(len(pairs)), tuple(pairs.T)), matrix.shape)
    union = scipy.sparse.csr_matrix(existing, matrix.shape) + added
    union.data = np.zeros(union.nnz, np.int8)
    return union
