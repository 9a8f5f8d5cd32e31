"""LU factors in C: their storage as a chain, a band matrix or sparse rows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse import identity
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee
from scipy.sparse.linalg import SuperLU, splu

from fx_beam import c_library
from fx_beam.c_library import Structs, array_at
from fx_beam.content_cache import cached_by_content, shallow_copy
from fx_beam.fem.mesh import Pattern, starts_of

# -- Storage of the reduced tangent and its LU factors: as a chain, a band matrix or sparse rows


#: Rows in a group: the degrees of freedom of a node.
GROUP = 3
#: Values of a row of a chain (chain.h).
ROW = 12
# Position of its couplings with its own group.
_OWN = 4
NONE = np.empty(0, dtype=int)


class Costs(NamedTuple):
    """Costs that decide between a band and sparse rows, and whether factors are kept.

    Times are relative to that of a multiplication in a factorisation. Measured with 18 to 9500
    unknowns (`benchmarks/frames.py storage`).
    """

    #: Up to this half bandwidth a band is faster: the compiler unrolls its loops.
    narrow: float = 11
    #: Besides the multiplications, time of each entry of sparse rows.
    row_entry: float = 31
    #: Time of each entry of factors and tangent in a substitution.
    substitution: float = 7
    #: Factors are kept if making them costs as much as so many substitutions.
    least_worth: float = 3


COSTS = Costs()


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
    #: The sparse rows by the names of sparse_rows.h; empty for others.
    rows: dict[str, Any] = {}
    #: Number of groups of three unknowns in a row, and diagonals of those that are not there.
    chain: int = 0
    padding: np.ndarray = NONE
    #: Substitutions that cost as much as a factorisation; 0 if factors are not kept.
    worth: int = 0

    def __str__(self):
        if self.chain:
            return "chain"
        if self.band:
            return f"band {self.band}"
        reused = ", kept over several steps" if self.worth else ""
        return f"sparse, {self.size} entries{reused}"


@cached_by_content
def factors_of(
    indptr: np.ndarray,
    indices: np.ndarray,
    dependent: np.ndarray | None = None,
    forces: np.ndarray = NONE,
    keep: bool = True,
    sparse: bool = True,
    costs: Costs = COSTS,
    parts: bool = False,
    symmetric: bool = False,
) -> Factors:
    """Storage in sparse rows, to keep if it pays; or in a band if it is narrow.

    With auxiliary unknowns (`Reduction.dependent`) sparse rows are from the leaves of trees to the
    roots. The last unknowns may be `forces` without a stiffness, given by an unknown on which each
    acts, a different one for each (-1: none). A force comes after this unknown and after all with
    which it is coupled: then a pivot vanishes only by chance. With forces, with auxiliary unknowns,
    or if rows shall be `sparse`, there is no band. Sparse rows may be in `parts` for threads. Those
    of a `symmetric` matrix are its upper half: entries of the lower one have a place behind all.
    """
    if len(indptr) == 1:  # nothing is unknown
        return Factors(NONE, NONE, 0, 1)
    graph, numbers = graph_of(indptr, indices), np.arange(len(indptr) - 1, dtype=np.int32)
    rows = np.repeat(numbers, np.diff(indptr))
    if not (sparse or dependent is not None or len(forces)):
        banded = _in_band(graph, rows, indices)
        if banded.band <= costs.narrow:
            return banded
    groups = groups_of(graph, dependent, forces)
    if dependent is None and not len(forces):
        groups |= _one_by_one(_minimum_degree(groups["graph_start"], groups["graph"]))
    factors = _eliminated(groups, rows, indices, parts, symmetric)
    return factors._replace(worth=_worth(factors, len(indices), costs)) if keep else factors


def graph_of(indptr: np.ndarray, indices: np.ndarray) -> scipy.sparse.csr_matrix:
    """The symmetric graph of a pattern, with diagonal."""
    n = len(indptr) - 1
    graph = scipy.sparse.csr_matrix((np.ones(len(indices), bool), indices, indptr), (n, n))
    return (graph + graph.T + scipy.sparse.identity(n, bool)).tocsr()


def _worth(sparse: Factors, entries: int, costs: Costs) -> int:
    """`Factors.worth` of sparse rows; the tangent has so many entries."""
    upper = sparse.rows["start"][1:] - sparse.rows["diagonal"] - 1.0
    products = upper @ (upper + 1) / (2 if sparse.rows["symmetric"] else 1)
    factorisation = products + costs.row_entry * sparse.size
    substitution = costs.substitution * (2 * upper.sum() + len(upper) + entries)
    worth = int(factorisation / substitution)
    return worth if worth >= costs.least_worth else 0


def _in_band(graph: scipy.sparse.csr_matrix, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Band storage in reverse Cuthill-McKee order, row by row, with room for the fill-in."""
    n = graph.shape[0]
    order = np.empty(n, dtype=np.int32)
    order[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    if n and order[0] > order[-1]:
        order = n - 1 - order  # upwards, as the unknowns
    i, j = order[rows], order[columns]
    band = max(1, int(abs(i - j).max(initial=0)))
    if band < 2 * GROUP and (chained := _chained(graph, order, rows, columns)) is not None:
        return _in_chain(chained, rows, columns)
    width = 2 * band + 1
    return Factors(order, i * width + band + j - i, n * width, band)


def _chained(
    graph: scipy.sparse.csr_matrix, order: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray | None:
    """Positions in an order in which each group of three is coupled with the next one only."""
    _, parts = connected_components(graph)
    for part in (np.zeros_like(parts), parts):  # first without gaps, then each part for itself
        _, first = np.unique(part[np.argsort(order)], return_index=True)
        shifted = order - first.astype(np.int32)[part]
        i, j = shifted[rows], shifted[columns]
        apart = np.zeros((GROUP, len(first)), dtype=bool)
        for offset in range(GROUP):
            distance = abs((i + offset) // GROUP - (j + offset) // GROUP)
            apart[offset, part[rows[distance > 1]]] = True
        if apart.all(axis=0).any():
            continue
        offset = np.argmin(apart, axis=0)
        groups = -(-(np.bincount(part) + offset) // GROUP)
        part_order, start = np.argsort(first), np.empty_like(first)
        start[part_order] = GROUP * (np.cumsum(groups[part_order]) - groups[part_order])
        return order + (start + offset - first)[part].astype(np.int32)
    return None


def _in_chain(order: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Factors:
    """Storage of groups of three positions, each coupled with the next group only (chain.h)."""
    # In each group in the order of unknowns, as in the element tangents.
    order[np.argsort(order // GROUP, kind="stable")] = np.sort(order)
    chain = int(order.max()) // GROUP + 1
    i, j = order[rows], order[columns]
    positions = i * ROW + _OWN * (1 + j // GROUP - i // GROUP) + j % GROUP
    unused = np.flatnonzero(np.bincount(order, minlength=GROUP * chain) == 0)
    padding, size = unused * ROW + _OWN + unused % GROUP, GROUP * chain * ROW
    return Factors(order, positions, size, 2 * GROUP - 1, chain=chain, padding=padding)


def groups_of(
    graph: scipy.sparse.csr_matrix, dependent: np.ndarray | None = None, forces: np.ndarray = NONE
) -> dict[str, Any]:
    """Graph from which an order of elimination is found, by the names of sparse_rows.h.

    With auxiliary unknowns and forces as in `factors_of`.
    """
    group_of = _alike(graph, dependent, len(forces))
    n, count = len(group_of), int(group_of.max()) + 1
    members = scipy.sparse.csr_matrix((np.ones(n), group_of, np.arange(n + 1)), (n, count))
    coupled = (members.T @ graph @ members).tocsr().tocoo()
    apart = coupled.row != coupled.col
    row, column = coupled.row[apart], coupled.col[apart]
    # Forces wait as in `factors_of`, others for auxiliary unknowns.
    force_groups = group_of[n - len(forces) :]
    last = np.unique(force_groups)
    couples_forces = np.isin(row, last) & ~np.isin(column, last)
    acting = forces >= 0
    first = np.append(column[couples_forces], group_of[forces[acting]])
    later = np.append(row[couples_forces], force_groups[acting])
    if dependent is not None:
        auxiliary, needed = group_of[dependent]
        first, later = np.append(first, auxiliary), np.append(later, needed)
    pairs = first.astype(np.int64) * count + later
    first, later = np.divmod(np.unique(pairs[first != later]), count)
    return {
        "groups": count,
        "group_of": group_of,
        "first_unknown": starts_of(np.bincount(group_of)),
        "unknown": np.argsort(group_of, kind="stable"),
        "graph_start": np.searchsorted(row, np.arange(count + 1)),
        "graph": column,
        "waits": np.bincount(later, minlength=count),
        "waiting_start": np.searchsorted(first, np.arange(count + 1)),
        "waiting": later,
    }


def _minimum_degree(indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """An order of minimum degree by SuperLU: of large grids it has less fill-in than that of C."""
    # The matrix is dominated by its diagonal, so that rows are not exchanged.
    degree = np.diff(indptr)
    shape = len(degree), len(degree)
    coupled = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), shape)
    dominant = scipy.sparse.diags(degree + 1e-6) - coupled
    settings = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "relax": 1}
    return np.argsort(splu(dominant.tocsc(), **settings, options={"SymmetricMode": True}).perm_c)


def _one_by_one(order: np.ndarray) -> dict[str, np.ndarray]:
    """Which groups wait in this order of all: each for the one before."""
    waits, waiting = np.ones(len(order), int), np.ones(len(order), int)
    waits[order[0]] = waiting[order[-1]] = 0
    waiting, starts = order[1:][np.argsort(order[:-1])], starts_of(waiting)
    return {"waits": waits, "waiting_start": starts, "waiting": waiting}


def _eliminated(
    groups: dict[str, Any], rows: np.ndarray, columns: np.ndarray, parts: bool, symmetric: bool
) -> Factors:
    """Sparse rows in minimum-degree order, and where entries in rows and columns are in them."""
    ffi, library = c_library.open_library(
        "order of elimination", "elimination.h", "sparse_rows.h", (), (), ("-O1",)
    )
    structs = Structs(ffi)
    search = ffi.gc(ffi.new("Elimination *"), library.fx_free_elimination)
    structs.set(search, **groups, rows={"parts": parts, "symmetric": symmetric})
    positions = np.empty(len(rows), np.int32)
    arrays = (
        ffi.from_buffer("int[]", np.asarray(x, np.int32, "C")) for x in (rows, columns, positions)
    )
    library.fx_find_rows(search, len(rows), *arrays)

    def taken(values: Any, count: int) -> np.ndarray:
        return array_at(ffi, values, count).copy()

    n, count, r = len(groups["group_of"]), groups["groups"], search.rows
    sizes = {"start": n + 1, "diagonal": n}
    sizes |= dict.fromkeys(("first", "source_start", "run_start"), count + 1)
    sizes["source"] = r.source_start[count]
    sizes |= dict.fromkeys(("run_column", "run_length"), r.run_start[count])
    if parts:
        sizes["part_start"] = library.SUBTREES + 1
    layout = {name: taken(getattr(r, name), size) for name, size in sizes.items()}
    stored = int(layout["start"][-1])
    counts = {"unknowns": n, "groups": count, "parts": parts}
    counts["symmetric"] = symmetric
    return Factors(taken(search.order, n), positions, stored, 0, counts | layout)


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
    sorting = np.argsort(sums, kind="stable")
    new = np.diff(sums[sorting], prepend=sums[sorting[0]] - 1) != 0
    run_place = np.arange(n) - np.maximum.accumulate(np.where(new, np.arange(n), 0))
    first = np.flatnonzero(run_place % GROUP == 0)
    # Numbered as their first unknowns: minimum degree with auxiliary unknowns leaves less fill-in
    # than otherwise.
    number = np.empty(len(first), dtype=np.int32)
    number[np.argsort(sorting[first])] = np.arange(len(first))
    group_of = np.empty(n, dtype=np.int32)
    group_of[sorting] = np.repeat(number, np.diff(first, append=n))
    return group_of


# -- LU factors of sparse matrices, in C --------------------------------------------------------


# Change of a singular matrix, relative to its largest entry.
_SHIFT = 1e-13
# Iterations for null vectors, each of which makes other vectors far smaller.
_ITERATIONS = 5


def pivoted_lu(matrix: Any) -> SuperLU:
    """Factors by SciPy of a sparse matrix whose pattern is symmetric, also a complex one.

    Rows are exchanged where a pivot is small. RuntimeError if it is exactly singular.
    """
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)


def null_vectors(matrix: Any, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Left and right vectors (n, count) of the least singular values, by inverse iteration.

    The matrix is one in unit unknowns, nearly singular, or exactly.
    """
    try:
        lu = pivoted_lu(matrix)
    except RuntimeError:
        shift = _SHIFT * abs(matrix.data).max()
        lu = pivoted_lu(matrix + shift * identity(matrix.shape[0]))
    right = np.random.default_rng(0).standard_normal((matrix.shape[0], count))
    for _ in range(_ITERATIONS):
        left = np.linalg.qr(lu.solve(right, "T"))[0]
        right = np.linalg.qr(lu.solve(left))[0]
    return left, right


class LU:
    """Factors in sparse rows (sparse_lu.py) without exchange of rows, for a pattern.

    With auxiliary unknowns and loops, `dependent` and `forces` are as in `factors_of`.
    """

    def __init__(
        self, pattern: Pattern, dependent: np.ndarray | None = None, forces: np.ndarray = NONE
    ):
        files = "sparse_lu.h", "sparse_rows.h"
        ffi, self._library = c_library.open_library("factors of sparse matrices", *files)
        self._ffi, layout = ffi, factors_of(*pattern, dependent, forces)
        self._rows = ffi.new("SparseRows *")
        # Of each unknown; none without unknowns.
        self._diagonals = layout.rows.get("diagonal", layout.order)[layout.order]
        self._structs = Structs(ffi)
        self._factors = np.empty(layout.size)
        self._structs.set(self._rows, **layout.rows, factors=self._factors)
        self._place, self._order = self._ints(layout.at), self._ints(layout.order)
        #: Solutions that cost as much as a factorisation.
        self.worth = layout.worth
        self._double = ffi.typeof("double[]")

    def empty(self) -> LU:
        """Factors for the same pattern, of a matrix to come."""
        other = shallow_copy(self)
        other._factors = np.empty(len(self._factors))
        other._rows = self._ffi.new("SparseRows *", self._rows[0])
        other._rows.factors = self._doubles(other._factors)
        return other

    def _ints(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer("int[]", np.asarray(values, np.int32, "C"))

    def _doubles(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer(self._double, values)

    def factorise(self, values: np.ndarray) -> bool:
        """By elimination without exchange of rows."""
        pointer = self._doubles(np.asarray(values, float, "C"))
        return bool(self._library.fx_factorise(self._rows, len(self._place), self._place, pointer))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """By substitution."""
        b, x = np.asarray(b, float, "C"), np.empty(len(b))
        self._library.fx_solve(self._rows, self._order, self._doubles(b), self._doubles(x))
        return x

    @property
    def pivots(self) -> np.ndarray:
        """Inverses of the pivots of all unknowns."""
        return self._factors[self._diagonals]

    def negative_pivots(self) -> int:
        """Their number: of a symmetric matrix, that of its negative eigenvalues."""
        return int((self.pivots < 0).sum())
