"""Storage of the reduced tangent and its LU factors: as a chain, a band matrix or sparse rows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from fx_beam.content_cache import cached_by_content
from fx_beam.coupling.auxiliary_order import auxiliary_fill_in

# Rows in a group: the degrees of freedom of a node.
_GROUP = 3
# Values of a row of a chain, and position of its couplings with its own group (chain.h).
_ROW, _OWN = 12, 4


class Costs(NamedTuple):
    """What decides between a band and sparse rows, and whether factors are kept.

    Times are relative to that of a multiplication in a factorisation. Measured with 18 to 9500
    unknowns (`benchmarks/frames.py storage`).
    """

    #: Up to this half bandwidth a band is always faster: the compiler unrolls its loops.
    narrow: float = 11
    #: Besides the multiplications, time of each entry of half a band and of sparse rows.
    band_entry: float = 17
    row_entry: float = 31
    #: Time of each entry of factors and tangent in a substitution.
    substitution: float = 7
    #: Factors are kept if making them costs as much as so many substitutions; a correction then
    #: costs about as much as so many, also for the new factors now and then.
    least_worth: float = 3
    correction: float = 2.5


COSTS = Costs()


class Groups(NamedTuple):
    """Groups of up to three successive sparse rows with equal columns, usually those of a node."""

    #: First rows (groups + 1,).
    first: np.ndarray
    #: Groups that are subtracted from the rows of each, in one list, and where each begins in it.
    source_start: np.ndarray
    source: np.ndarray
    #: Columns behind each group as runs of successive ones: their first columns and lengths.
    run_start: np.ndarray
    run_column: np.ndarray
    run_length: np.ndarray


class Factors(NamedTuple):
    """Storage layout of the factors L and U of the reduced tangent, without pivoting."""

    #: Position of each unknown (n,) in the elimination, and storage index of each tangent entry
    #: among the factors.
    order: np.ndarray
    at: np.ndarray
    #: Number of stored values.
    size: int
    #: Half bandwidth: number of subdiagonals and of superdiagonals; 0 for sparse rows.
    band: int
    #: Start of each sparse row, and storage index of its diagonal.
    starts: np.ndarray
    diagonals: np.ndarray
    #: Number of groups of three unknowns in a row, and diagonals of those that are not there.
    chain: int = 0
    padding: np.ndarray = np.empty(0, dtype=int)
    groups: Groups | None = None
    #: Substitutions that cost as much as a factorisation; 0 if factors are not kept.
    worth: int = 0
    #: Time of a correction by Newton's method, relative to that of a multiplication.
    cost: float = 0.0

    def rows(self) -> dict[str, Any]:
        """The sparse rows by the names of sparse_rows.h; empty for others."""
        if self.groups is None:
            return {}
        sizes = {"unknowns": len(self.order), "groups": len(self.groups.first) - 1}
        return {**sizes, "start": self.starts, "diagonal": self.diagonals, **self.groups._asdict()}

    def __str__(self):
        if self.chain:
            return "chain"
        if self.band:
            return f"band {self.band}"
        kept = ", kept over several steps" if self.worth else ""
        return f"sparse, {self.size} entries{kept}"


@cached_by_content
def factors_of(
    indptr: np.ndarray,
    indices: np.ndarray,
    keep: bool = True,
    dependent: np.ndarray | None = None,
    costs: Costs = COSTS,
    forces: int = 0,
) -> Factors:
    """Storage in which a correction costs least: a band, or sparse rows, to keep if it pays.

    With auxiliary unknowns (`Reduction.dependent`): sparse rows, from the leaves of trees to the
    roots. The last unknowns may be forces without a stiffness, which come after all with which they
    are coupled.
    """
    none = np.empty(0, dtype=int)
    if len(indptr) == 1:  # nothing is unknown
        return Factors(none, none, 0, 1, none, none)
    graph, rows = _graph(indptr, indices)
    if dependent is not None or forces:
        return _in_rows(graph, rows, indices, dependent, forces)
    banded = _in_band(graph, rows, indices)
    if banded.band <= costs.narrow:
        return banded
    band_cost = len(banded.order) * banded.band * (banded.band + 1 + costs.band_entry)
    sparse = _with_cost(_in_rows(graph, rows, indices), len(indices), keep, costs)
    return banded if band_cost <= sparse.cost else sparse


@cached_by_content
def in_sparse_rows(
    indptr: np.ndarray,
    indices: np.ndarray,
    dependent: np.ndarray | None = None,
    keep: bool = True,
) -> Factors:
    """Storage in sparse rows; with auxiliaries (`Reduction.dependent`) as in `factors_of`."""
    graph, rows = _graph(indptr, indices)
    return _with_cost(_in_rows(graph, rows, indices, dependent), len(indices), keep, COSTS)


def _graph(indptr: np.ndarray, indices: np.ndarray) -> tuple[scipy.sparse.csr_matrix, np.ndarray]:
    """The symmetric graph of a pattern, with diagonal, and the row of each entry of the pattern."""
    n = len(indptr) - 1
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    graph = (graph + graph.T + scipy.sparse.identity(n)).tocsr()
    return graph, np.repeat(np.arange(n), np.diff(indptr))


def _with_cost(sparse: Factors, entries: int, keep: bool, costs: Costs) -> Factors:
    """Sparse rows with their cost, to keep if it pays; the tangent has so many entries."""
    above = sparse.starts[1:] - sparse.diagonals - 1.0
    factorisation = above @ (above + 1) + costs.row_entry * sparse.size
    substitution = costs.substitution * (sparse.size + entries)
    worth = int(factorisation / substitution)
    if keep and worth >= costs.least_worth:
        return sparse._replace(worth=worth, cost=costs.correction * substitution)
    return sparse._replace(cost=factorisation)


def _in_band(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Band storage in reverse Cuthill-McKee order, row by row, with room for the fill-in."""
    n = graph.shape[0]
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    i, j = order[rows], order[columns]
    band = max(1, int(abs(i - j).max(initial=0)))
    if band < 2 * _GROUP and (chained := _chained(graph, order, rows, columns)) is not None:
        return _in_chain(chained, rows, columns)
    width, none = 2 * band + 1, np.empty(0, dtype=int)
    return Factors(order, i * width + band + j - i, n * width, band, none, none)


def _chained(
    graph: scipy.sparse.csr_matrix, order: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray | None:
    """Positions in an order in which each group of three is coupled with the next one only."""
    none, (_, parts) = (
        np.zeros(len(order), dtype=int),
        scipy.sparse.csgraph.connected_components(graph),
    )
    for part in (none, parts):  # first without gaps, then each part for itself
        count = int(part.max()) + 1
        first = np.full(count, len(order))
        np.minimum.at(first, part, order)
        i, j = (order[k] - first[part[k]] for k in (rows, columns))
        apart = np.zeros((_GROUP, count), dtype=int)
        for before in range(_GROUP):
            distance = abs((i + before) // _GROUP - (j + before) // _GROUP)
            np.maximum.at(apart[before], part[rows], distance)
        if (apart.min(axis=0) > 1).any():
            continue
        before = np.argmax(apart <= 1, axis=0)
        groups = -(-(np.bincount(part) + before) // _GROUP)
        by_first, start = np.argsort(first), np.empty(count, dtype=int)
        start[by_first] = _GROUP * (np.cumsum(groups[by_first]) - groups[by_first])
        return order + (start + before - first)[part]
    return None


def _in_chain(order: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Storage of groups of three positions, each coupled with the next group only (chain.h)."""
    # In each group in the order of unknowns, as in the element tangents.
    order[np.argsort(order // _GROUP, kind="stable")] = np.sort(order)
    chain = int(order.max()) // _GROUP + 1
    i, j = order[rows], order[columns]
    at = i * _ROW + _OWN * (1 + j // _GROUP - i // _GROUP) + j % _GROUP
    unused = np.flatnonzero(np.bincount(order, minlength=_GROUP * chain) == 0)
    padding = unused * _ROW + _OWN + unused % _GROUP
    none, size = np.empty(0, dtype=int), _GROUP * chain * _ROW
    return Factors(order, at, size, 2 * _GROUP - 1, none, none, chain, padding)


def _in_rows(
    graph: scipy.sparse.csr_matrix,
    rows: np.ndarray,
    columns: np.ndarray,
    dependent: np.ndarray | None = None,
    forces: int = 0,
) -> Factors:
    """Sparse rows in minimum-degree order, with room for exactly the fill-in."""
    n, group_of = graph.shape[0], _alike(graph, dependent, forces)
    count = int(group_of.max()) + 1
    members = scipy.sparse.csr_matrix((np.ones(n), group_of, np.arange(n + 1)), (n, count))
    of_groups = (members.T @ graph @ members).tocsr()
    last = np.unique(group_of[n - forces :])
    if dependent is None:
        position, starts, filled = fill_in(of_groups, last)
    else:
        parts = np.bincount(group_of), group_of[dependent], last
        position, starts, filled = auxiliary_fill_in(of_groups, *parts)
    group_of = position[group_of]
    sizes = np.bincount(group_of).astype(np.int32)
    first, order = _starts(sizes), np.empty(n, dtype=np.int32)
    order[np.argsort(group_of, kind="stable")] = np.arange(n)
    # For each entry of the pattern of groups: its row, and the columns before it in this row.
    of = np.repeat(np.arange(count, dtype=np.int32), np.diff(starts))
    before = _starts(sizes[filled])
    widths = np.diff(before[starts])
    before = before[:-1] - before[starts[of]]
    row_starts = _starts(np.repeat(widths, sizes))
    diagonals = np.arange(n) - np.repeat(first[:-1] - before[filled == of], sizes) + row_starts[:-1]
    # Rows and their columns are sorted: the entries' positions by bisection.
    keys, to = of.astype(np.int64) * count + filled, group_of[columns]
    entry = np.searchsorted(keys, group_of[rows].astype(np.int64) * count + to)
    at = row_starts[order[rows]] + before[entry] + order[columns] - first[to]
    groups = _groups(first, of, filled)
    return Factors(order, at, int(row_starts[-1]), 0, row_starts, diagonals, groups=groups)


def groups_of(
    indptr: np.ndarray,
    indices: np.ndarray,
    dependent: np.ndarray | None = None,
    forces: int = 0,
) -> dict[str, np.ndarray]:
    """Groups of unknowns with equal columns, and which groups are coupled, for changing_rows.h.

    Also which ones wait until others are eliminated: with auxiliary unknowns and forces as in
    `factors_of`.
    """
    graph, _ = _graph(indptr, indices)
    group_of = _alike(graph, dependent, forces)
    n, count = len(group_of), int(group_of.max()) + 1
    members = scipy.sparse.csr_matrix((np.ones(n), group_of, np.arange(n + 1)), (n, count))
    coupled = (members.T @ graph @ members).tolil()
    coupled.setdiag(0)
    coupled = coupled.tocsr()
    coupled.eliminate_zeros()
    last = np.unique(group_of[n - forces :])
    near = coupled[last].tocoo()
    first, then = near.col, last[near.row]
    if dependent is not None:
        first, then = np.hstack([(first, then), group_of[dependent]])
    apart = first != then
    pairs = first[apart], then[apart]
    waits = scipy.sparse.csr_matrix((np.ones(len(pairs[0])), pairs), (count, count))
    return {
        "group_of": group_of,
        "first_unknown": _starts(np.bincount(group_of)),
        "unknown": np.argsort(group_of, kind="stable"),
        "graph_start": coupled.indptr,
        "graph": coupled.indices,
        "waits": np.bincount(waits.indices, minlength=count),
        "waiting_start": waits.indptr,
        "waiting": waits.indices,
    }


def _starts(counts: np.ndarray) -> np.ndarray:
    """Where each of several parts begins, and the last one ends."""
    return np.concatenate([[0], np.cumsum(counts)])


def _groups(first: np.ndarray, of: np.ndarray, filled: np.ndarray) -> Groups:
    """Groups with these first rows, from the rows and columns of their pattern."""
    below, above = filled < of, filled > of
    numbers = np.arange(len(first))
    source_starts = np.searchsorted(of[below], numbers)
    row, column = of[above], filled[above]
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (row[1:] != row[:-1]) | (column[1:] != column[:-1] + 1)
    run = np.flatnonzero(begins)
    last = np.append(run[1:], len(row))[: len(run)] - 1
    run_starts = np.searchsorted(row[run], numbers)
    columns, ends = first[column[run]], first[column[last] + 1]
    return Groups(first, source_starts, filled[below], run_starts, columns, ends - columns)


def _alike(graph: scipy.sparse.csr_matrix, dependent: np.ndarray | None, forces: int) -> np.ndarray:
    """Group (n,) of each unknown: up to three of a kind, coupled with the same ones."""
    n = graph.shape[0]
    # Sums of random numbers of the columns: equal for equal columns, else hardly ever.
    number = np.random.default_rng(0).integers(1, 2**62, n, dtype=np.int64)
    sums = np.concatenate([[0], np.cumsum(number[graph.indices])])  # modulo 2^64
    sums = sums[graph.indptr[1:]] - sums[graph.indptr[:-1]]
    if dependent is not None:
        sums[np.unique(dependent[0])] += 1
    sums[n - forces :] += 2
    by_sum = np.argsort(sums, kind="stable")
    new = np.diff(sums[by_sum], prepend=sums[by_sum[0]] - 1) != 0
    since = np.arange(n) - np.maximum.accumulate(np.where(new, np.arange(n), 0))
    first = np.flatnonzero(since % _GROUP == 0)
    # Numbered as their first unknowns: minimum degree with auxiliary unknowns leaves less fill-in
    # than otherwise.
    number = np.empty(len(first), dtype=np.int32)
    number[np.argsort(by_sum[first])] = np.arange(len(first))
    group_of = np.empty(n, dtype=np.int32)
    group_of[by_sum] = np.repeat(number, np.diff(first, append=n))
    return group_of


def fill_in(
    graph: scipy.sparse.csr_matrix, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n,) in minimum-degree order, and the pattern of L + U in it: starts, columns.

    Those of `last` come after all with which they are coupled.
    """
    lu = _factors_of_graph(graph, "MMD_AT_PLUS_A")
    position = lu.perm_c
    if len(last):
        after = position.astype(float)
        row = np.repeat(np.arange(len(position)), np.diff(graph.indptr))
        others = np.where(graph.indices == row, -1, position[graph.indices])
        after[last] = np.maximum.reduceat(others, graph.indptr[:-1])[last] + 0.5
        order = np.argsort(after, kind="stable")
        # The pattern's own order of equal fill-in leaves what is coupled in its order.
        lu = _factors_of_graph(graph[order][:, order], "NATURAL")
        position = lu.perm_c[np.argsort(order)]
    lower, upper = lu.L, lu.U
    lower.data[:] = upper.data[:] = 1.0  # small ones may have become zero
    pattern = (lower + upper).tocsr()
    pattern.sort_indices()
    return position, pattern.indptr, pattern.indices


def _factors_of_graph(graph: scipy.sparse.csr_matrix, order: str) -> scipy.sparse.linalg.SuperLU:
    """Factors of a matrix with a graph, which show the fill-in."""
    # It is dominated by its diagonal, so that rows are not exchanged, but hardly: else fill-in
    # would decay from node to node, and vanish. Without relaxed supernodes SuperLU stores what may
    # differ from zero.
    coupled = (graph != 0).astype(float)
    dominant = scipy.sparse.diags(np.diff(graph.indptr) + 1e-6) - coupled
    return splu(
        dominant.tocsc(),
        permc_spec=order,
        diag_pivot_thresh=0.0,
        relax=1,
        options={"SymmetricMode": True},
    )
