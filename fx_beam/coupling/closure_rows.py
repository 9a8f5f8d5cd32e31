"""On what the closures of closed loops depend: few unknowns, also in long trees."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse

from .graph import Closure, Couplings, Entry
from .sliders import Slide


class ClosureRow(NamedTuple):
    """What one closure depends on."""

    #: Columns other than auxiliary unknowns.
    columns: list[int]
    #: Entries of auxiliary unknowns, in the order in which they are collected.
    auxiliaries: list[int]


def closure_rows(couplings: Couplings, arms: int, slides: Sequence[Slide]) -> list[ClosureRow]:
    """Of each closure. What is common to both ends of a loop goes out.

    `arms` is the number of values of entries. A node on a beam may be at all places of it.
    """
    # Numbers that do not cancel by chance.
    random = np.random.default_rng(0)
    values = random.uniform(1.0, 2.0, arms).tolist()
    values[0] = 1.0
    starts = np.cumsum(
        [0, *(len(auxiliary.entries) for auxiliary in couplings.auxiliaries)]
    ).tolist()
    beams = dict[int, list[Entry]]()
    for slide in slides:
        dofs = slide.dofs.ravel().tolist()
        near = {entry[0] for dof in dofs for entry in couplings.entries(dof)}
        below = {entry[0] for column in near for entry in beams.get(column, ())}
        near = {slide.column, *near, *below} - set(beams)
        for column in slide.columns.tolist():
            beams[column] = [(other, 0, random.uniform(1.0, 2.0)) for other in sorted(near)]
    return [_row(one, couplings, values, starts, beams) for one in couplings.closures]


def _row(
    one: Closure,
    couplings: Couplings,
    values: list[float],
    starts: list[int],
    beams: dict[int, list[Entry]],
) -> ClosureRow:
    first, row, used = couplings.columns, dict[int, float](), list[int]()
    waiting: list[int] = []

    def add(entry: Entry, factor: float) -> None:
        column, position, sign = entry
        if column in beams:
            for other in beams[column]:
                add(other, factor * sign * values[position])
            return
        if column not in row:
            row[column] = 0.0
            if column >= first:
                heapq.heappush(waiting, first - column)
        row[column] += factor * sign * values[position]

    for entry in one.entries:
        add(entry, 1.0)
    while waiting:
        auxiliary = -heapq.heappop(waiting)  # the latest first: others depend on earlier ones only
        factor = row.pop(first + auxiliary)
        for k, entry in enumerate(
            couplings.auxiliaries[auxiliary].entries if factor else [], starts[auxiliary]
        ):
            used.append(k)
            add(entry, factor)
    return ClosureRow([column for column, factor in row.items() if factor], used)


def blocks_of(rows: list[ClosureRow], free: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Closures of loops that share unknowns, directly or through others, and these unknowns.

    Those of neighbouring loops are near to each other.
    """
    entries = [(k, column) for k, row in enumerate(rows) for column in row.columns if column < free]
    k, columns = np.array(entries, dtype=int).reshape(-1, 2).T
    shape = len(rows), free
    depends = scipy.sparse.csr_matrix((np.ones(len(k)), (k, columns)), shape)
    near = (depends @ depends.T).tocsr()
    _, label = scipy.sparse.csgraph.connected_components(near, directed=False)
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(near, symmetric_mode=True)
    order = order[np.argsort(label[order], kind="stable")]
    blocks = []
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        part = depends[members].tocoo()
        columns, at = np.unique(part.col, return_inverse=True)
        place = np.bincount(at, part.row) / np.bincount(at)
        blocks.append((members, columns[np.argsort(place, kind="stable")]))
    return blocks
