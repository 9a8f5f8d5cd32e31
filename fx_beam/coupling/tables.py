"""Lists of numbers, for the compiled loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.content_cache import cached_by_content

#: Sparsity (indptr, indices) of a matrix in compressed rows.
Pattern = tuple[np.ndarray, np.ndarray]


@cached_by_content
def sparsity(rows: np.ndarray, columns: np.ndarray, n: int):
    """Compressed rows of the given pairs, and the position of each pair in them."""
    keys, position = np.unique(rows * n + columns, return_inverse=True)
    counts = np.bincount(keys // n, minlength=n)
    return (starts_of(counts).astype(np.int32), (keys % n).astype(np.int32)), position


def starts_of(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    """Where each of several parts begins, and the last one ends."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(int)
