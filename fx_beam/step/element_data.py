"""Rows of all elements as the compiled loop takes them: several side by side."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fx_beam.content_cache import cached_by_content


def aligned(array: np.ndarray) -> np.ndarray:
    """A copy that begins with a cache line, as vectors of the processor are faster there."""
    line = 64
    space = np.empty(array.nbytes + line, dtype=np.int8)
    begin = -space.ctypes.data % line
    copy = space[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def in_lanes(rows: np.ndarray, lanes: int, behind: int | None = None) -> np.ndarray:
    """Rows in blocks of `lanes`, column by column (blocks, columns, lanes).

    The last block is padded with copies of the last row, or with indices from `behind` on, which
    lie apart: the processor waits where what is stored overlaps.
    """
    missing = -len(rows) % lanes
    if missing:
        more = np.repeat(rows[-1:], missing, axis=0)
        if behind is not None:
            more[:] = behind + 4 * np.arange(missing)[:, None]
        rows = np.concatenate([rows, more])
    blocks = rows.reshape(len(rows) // lanes, lanes, rows.shape[1]).swapaxes(1, 2)
    return aligned(blocks.astype(np.float64 if rows.dtype == np.float64 else np.int32))


class NodeRows(NamedTuple):
    """Where entries of element tangents go in a chain: rows of three of a node, and single ones."""

    #: Storage index of the first entry of each row (cells, n * n / 3), also of missing cells.
    run: np.ndarray
    #: Single entries: first one of each block of elements, tensor entry, storage index.
    single_start: np.ndarray
    single_from: np.ndarray
    single_to: np.ndarray


@cached_by_content
def rows_of_nodes(stored_at: np.ndarray, behind: int, lanes: int) -> NodeRows:
    """Rows of the entries (cells, n * n) of element tangents; those of single ones go behind."""
    cells, n = len(stored_at), math.isqrt(stored_at.shape[1])
    nodes = n // 3
    number = np.arange(n)
    columns = np.column_stack([number[: 2 * nodes].reshape(nodes, 2), number[2 * nodes :]])
    to = stored_at.reshape(cells, n, n)[:, :, columns]  # (cells, n, nodes, 3)
    together = (np.diff(to, axis=-1) == 1).all(axis=-1)
    # Rows behind the end lie apart: the processor waits where stored rows overlap.
    lane = np.arange(cells + -cells % lanes) % lanes
    run = np.empty((len(lane), n, nodes), dtype=int)
    run[:] = behind + 4 * lane[:, None, None]
    run[:cells][together] = to[together][:, 0]
    cell, row, node = np.nonzero(~together)
    source = (row[:, None] * n + columns[node]) * lanes + lane[cell, None]
    start = np.searchsorted(cell, np.arange(0, cells + lanes, lanes))
    single = to[cell, row, node]
    return NodeRows(run.reshape(len(lane), -1), 3 * start, source.ravel(), single.ravel())
