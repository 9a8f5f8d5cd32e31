"""Nodes that belong to no beam, such as those of bodies: their rows in vectors and matrices."""

from __future__ import annotations

import numpy as np
import scipy.sparse


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


def fill_blocks(data: np.ndarray, assembled: np.ndarray) -> None:
    """Copy assembled values to those of `with_blocks`, unless it is a view; blocks become zero."""
    if len(data) > len(assembled):
        data[: len(assembled)] = assembled
        data[len(assembled) :] = 0.0
