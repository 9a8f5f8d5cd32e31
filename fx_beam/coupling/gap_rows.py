"""On what the gaps of closed loops depend: few unknowns, also in long trees."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
import scipy.sparse

from .graph import Closure, Couplings, Entry


class GapRow(NamedTuple):
    """What one gap depends on."""

    #: Columns other than ties.
    columns: list[int]
    #: Entries of ties, in the order in which they are collected.
    ties: list[int]


def gap_rows(couplings: Couplings, arms: int) -> list[GapRow]:
    """Of each closure. What is common to both ends of a loop goes out.

    `arms` is the number of values of entries.
    """
    # Numbers that do not cancel by chance.
    values = np.random.default_rng(0).uniform(1.0, 2.0, arms).tolist()
    values[0] = 1.0
    starts = np.cumsum([0, *(len(tie.entries) for tie in couplings.ties)]).tolist()
    return [_row(one, couplings, values, starts) for one in couplings.closures]


def _row(one: Closure, couplings: Couplings, values: list[float], starts: list[int]) -> GapRow:
    first, row, used = couplings.columns, dict[int, float](), list[int]()
    waiting: list[int] = []

    def add(entry: Entry, factor: float) -> None:
        column, position, sign = entry
        if column not in row:
            row[column] = 0.0
            if column >= first:
                heapq.heappush(waiting, first - column)
        row[column] += factor * sign * values[position]

    for entry in one.entries:
        add(entry, 1.0)
    while waiting:
        tie = -heapq.heappop(waiting)  # the latest first: others depend on earlier ones only
        factor = row.pop(first + tie)
        for k, entry in enumerate(couplings.ties[tie].entries if factor else [], starts[tie]):
            used.append(k)
            add(entry, factor)
    return GapRow([column for column, factor in row.items() if factor], used)


def blocks_of(rows: list[GapRow], free: int) -> list[np.ndarray]:
    """Closures of loops that share unknowns, directly or through others."""
    entries = [(k, column) for k, row in enumerate(rows) for column in row.columns if column < free]
    k, columns = np.array(entries, dtype=int).reshape(-1, 2).T
    shape = len(rows), free
    depends = scipy.sparse.csr_matrix((np.ones(len(k)), (k, columns)), shape)
    _, label = scipy.sparse.csgraph.connected_components(depends @ depends.T, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
