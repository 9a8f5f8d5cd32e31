"""The linear system in C: factors, entries of both tangents, what borders it, its threads."""

from __future__ import annotations

import os
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.coupling.reduction import ReducedTangent, Reduction
from fx_beam.errors import SceneError
from fx_beam.fem.mesh import blocks_with, starts_of
from fx_beam.mpi import under_mpirun

from .model import Model, fact, massless_dofs
from .newton import NewtonOptions
from .sparse_lu import COSTS, GROUP, NONE, ROW, Factors, factors_of, graph_of, groups_of

if TYPE_CHECKING:
    from fx_beam.coupling.dependent_columns import Slide, Sliders


# -- How many threads share the work of a large scene -------------------------------------------


# More are not faster: they wait for memory.
_MOST = 4
_VARIABLE = "FX_BEAM_THREADS"


def thread_count() -> int:
    """Number of threads: by default that of the cores that the process may use, at most four.

    One for each process of mpirun. SceneError if the environment variable is no such number.
    """
    if text := os.environ.get(_VARIABLE, ""):
        if not (text.isdecimal() and 1 <= int(text) <= 64):
            raise SceneError(f"{_VARIABLE} = {text!r} must be a number of threads from 1 to 64")
        return int(text)
    if under_mpirun():
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, _MOST)


# -- The linear system in C: factors, where entries of both tangents are, and what borders it ---


# Columns of the block of right sides are computed in such lanes.
_LANES = 4


#: From so many elements on, threads share the work: they gain more than they cost.
LARGE = 20_000
# From so many nodes on beams, what slides is in the sparse rows, not beside them.
_MANY_SLIDES = 8


class ProblemKind(NamedTuple):
    """Purpose of a problem of a model in C.

    One of `forces_only` is for `Equations`: it takes no steps. One of `rates` has no forces. It may
    have a part of the `inertia` only; steps of one that is not `inert` are those of statics. The
    scene may rest in a frame that `turns`.
    """

    newton: NewtonOptions = NewtonOptions()
    turns: bool = False
    forces_only: bool = False
    rates: bool = False
    inertia: float = 1.0
    inert: bool = True


class TangentStorage:
    """The linear system of a model in C: its factors, and where entries of both tangents are."""

    def __init__(self, model: Model, kind: ProblemKind):
        self.model, self.kind = model, kind
        #: Whether threads share the work of a large scene, and how many.
        self.is_large, self.threads = len(model.mesh.unknowns.dofs) >= LARGE, 1
        if self.is_large:
            self.threads = thread_count()
        loops = model.reduction.loops
        #: Whether bordering rows are among the sparse rows (c/bordering_rows.h).
        self.inside = kind.forces_only or (
            len(model.couplings.sliding) >= _MANY_SLIDES
            and model.points.members is None
            and (loops is None or not len(loops.carried))
        )
        #: Sparsity of the reduced tangent, and its number of entries.
        self.pattern = model.reduction.tangent.pattern
        self.entries = len(self.pattern[1])
        self.factors = self._factors_of(*self.pattern)
        #: Those in sparse rows, in C.
        self.sparse_factors = np.zeros(0)

    @property
    def features(self) -> str:
        """Features that the library for C must have (c/scene_features.h)."""
        factors, couplings = self.factors, self.model.couplings
        has = {
            "CHAIN": factors.chain,
            "BAND": factors.band and not factors.chain,
            "COUPLED": not couplings.is_selection,
            "LOOPS": couplings.closures,
            "SLIDERS": couplings.sliding,
            "MEMBERS": self.model.points.members is not None,
        }
        return "|".join(name for name, present in has.items() if present) or "0"

    def hand_over(self, problem: Any) -> None:
        """Hand over the couplings, and find the storage index of each entry of both tangents."""
        reduction, factors = self.model.reduction, self.factors
        first_bordering = problem.constants.ON_BORDER
        problem.set(tables=reduction.joints.members, numbers=reduction.joints.numbers)
        places, stored = factors.at, factors.size
        if not factors.band:  # the tangent is stored apart
            indptr, indices = self.pattern
            places, stored = np.arange(len(indices), dtype=np.int32), len(indices)
            worth = 0 if self.kind.rates else factors.worth
            problem.set(
                tables={"system": {"tangent_start": indptr, "tangent_column": indices}},
                work={"factors": {"at": factors.at.astype(np.int32), "reused": {"worth": worth}}},
            )
        if self.model.points.members is not None and not self.kind.rates:
            self._set_changing_rows(problem)
        elif factors.rows and not self.inside:
            self.sparse_factors = np.zeros(factors.size + 1)  # one more: see `factors_of`
            own = {"factors": self.sparse_factors, "threads": self.threads}
            problem.set(work={"factors": {"rows": [factors.rows | own]}})
        if (loops := reduction.loops) is not None:
            diagonal, unit = loops.scales(self.pattern)
            table = {"scales": len(unit), "scale_at": places[diagonal], "scale_unit": unit}
            following = np.zeros(len(loops), dtype=int)
            problem.set(tables={"loops": table}, work={"following": following})
        places, stored, places_of_ones = storage_of(reduction, places, stored)
        tangent = reduction.tangent
        K, alone = self.model.forms.stiffness, alone_in_column(reduction)
        stored_at, place_of_one = storage_of_entries(tangent, K, alone, places, stored)
        stiff = {"stiffness_at": place_of_one + 1, "stiffened": tangent.stiffened}
        problem.set(tables={"tangent": {"stored": place_of_one + 2}, "coupled": stiff})
        if reduction.couplings.sliding:
            diagonal_at = stored_at[self.model.masses.places.diagonal]
            sliders = _sliders(self.model, reduction.sliders, places, diagonal_at)
            tables = bordering_tables(self.model, sliders, places, first_bordering, self.inside)
            problem.set(tables=tables, work={"slider": sliders})
            self.border = tables["border"]
            if self.inside and not self.kind.forces_only:
                self._set_changing_rows(problem, sliders)
        order = factors.order
        if self.inside:
            order = np.arange(len(order) + problem.c.tables.border.rows)
        places_of_ones = np.append(places_of_ones, places[tangent.ones])
        padding = np.concatenate([factors.padding, places_of_ones, [place_of_one]])
        system = {
            "band": factors.band,
            "chain": factors.chain,
            "positions": 3 * factors.chain or len(order),
            "unknowns": len(factors.order),
            "in_order": bool(factors.band and (np.diff(factors.order) == 1).all()),
            "paddings": len(padding),
            "padding": padding,
        }
        reacting = {"reacting": np.count_nonzero(~alone), "reacts": np.flatnonzero(~alone)}
        problem.set(
            tables={"system": system, "tangent": reacting},
            work={"factors": {"order": order.astype(np.int32)}},
        )
        added = stored_at[tangent.direct["from"]] >= stored
        direct = {key: values[added] for key, values in tangent.direct.items()}
        stored_from = np.append(stored_at, [place_of_one, place_of_one + 1])
        products = {"coupled": tangent.coupled, "geometric": tangent.geometric}
        for name, product in {"direct": direct, **products}.items():
            table = {key: stored_from[x] if key == "from" else x for key, x in product.items()}
            table["to"] = places[product["to"]]
            problem.set(tables={name: table | {"count": len(product["to"])}})
        #: Storage indices of the forces on slides, and which these are.
        self.slide_forces = places[tangent.restoring["to"]], tangent.restoring["of"]
        #: Storage index of each entry of the full tangent.
        self.stored_at = stored_at
        self._set_mass(problem)
        self.factors = factors._replace(at=NONE)  # C has what it needs of it
        if self.is_large:
            reduction.forget_tangent()

    def _set_mass(self, problem: Any) -> None:
        """Hand over where the tangent has masses, in blocks of pairs of nodes."""
        model, K = self.model, self.model.forms.stiffness
        weightless = model.scheme.rates.at_rest and not self.kind.turns
        has_mass = np.zeros(K.nnz, bool) if weightless else model.masses.matrix.data != 0
        starts, nodes, blocks = blocks_with(has_mass, K.indptr, K.indices)
        #: Entries (pairs, 3) of the tangent that C has as masses and rotary inertias.
        self.mass_entries = np.ascontiguousarray(blocks.reshape(-1, 9)[:, ::4])
        stored_at = self.stored_at[self.mass_entries]
        #: Pattern of the mass matrix, by its names in C.
        self.mass = mass = {"start": starts, "dof": 3 * nodes, "stored_at": stored_at}
        # In most groups of a chain masses set all entries of two nodes in three rows.
        is_set = np.zeros(problem.c.tables.tangent.stored, bool)
        if chain := problem.c.tables.system.chain:
            first = stored_at[stored_at[:, 2] == stored_at[:, 0] + 2 * (ROW + 1), 0]
            is_set[first[:, None, None] + ROW * np.arange(3)[:, None] + np.arange(4)] = True
            groups = is_set[: GROUP * ROW * chain].reshape(chain, -1)
            groups[:] = groups.all(axis=1)[:, None]
        gap = np.flatnonzero(np.diff(is_set, prepend=True, append=True)).astype(np.int32)
        problem.set(tables={"mass": mass, "tangent": {"gaps": len(gap) // 2, "gap": gap}})
        if model.forms.nodal_rules:
            problem.set(tables={"scheme": {"rule_stored_at": self.stored_at[blocks]}})

    def _set_changing_rows(self, problem: Any, sliders: list[dict[str, Any]] | None = None) -> None:
        """Hand over what a pattern that changes with contact points is found from.

        With tables of `sliders` it changes with what slides.
        """
        reduction, couplings = self.model.reduction, self.model.couplings
        graph = graph_of(*self.pattern)
        groups = groups_of(graph, reduction.auxiliaries.dependent, reduction.forces)
        if sliders is not None:
            groups = with_bordering_rows(groups, self.border, sliders)
        system = *couplings.system, problem.constants.ON_BORDER
        row_of, unknown_of = on_bordering_rows(reduction, *system)
        row = {
            "elimination": groups,
            "window": np.full(len(couplings.sliding), -1),
            "dof_start": couplings.all_entries.starts(self.model.size),
            **couplings.all_entries.members("dof_"),
            "keep": not couplings.closures and not couplings.auxiliaries and not couplings.sliding,
            **{name: getattr(COSTS, name) for name in ("row_entry", "substitution", "least_worth")},
        }
        if sliders is None:
            problem.set(tables={"system": {"row_of": row_of, "unknown_of": unknown_of}})
        problem.set(work={"factors": {"changing": [row]}})
        own = problem.c.work.factors
        own.rows = problem.ffi.addressof(own.changing[0], "elimination", "rows")
        self.free_rows_with(problem, owner=problem.structs)

    def free_rows_with(self, problem: Any, owner: Any) -> None:
        """Free what C allocates for the rows with this object, before what the `owner` keeps."""
        free, rows = problem.library.fx_free_rows, problem.c.work.factors.changing
        self._rows = problem.ffi.gc(rows, lambda rows, owner=owner: free(rows))

    def _factors_of(self, indptr: np.ndarray, indices: np.ndarray) -> Factors:
        reduction, order = self.model.reduction, np.arange(len(indptr) - 1)
        if self.kind.forces_only:
            return Factors(order, np.arange(len(indices)), 0, 0)
        couplings, members = self.model.couplings, self.model.points.members is not None
        # Rows of unknowns that close loops are no forces, by which errors are judged.
        keep = not (couplings.closures or couplings.auxiliaries or (members and couplings.sliding))
        keep = keep and not self.inside
        # In statics the signs of pivots tell modes.
        sparse = members or self.inside or self.model.scheme.rates.at_rest
        dependent, forces = reduction.auxiliaries.dependent, reduction.forces
        parts = self.is_large and not self.inside
        symmetric = (
            self.model.scheme.rates.at_rest
            and self.model.kinks.potential
            and not (self.kind.rates or members or couplings.closures or couplings.auxiliaries)
            and not couplings.sliding
        )
        return factors_of(indptr, indices, dependent, forces, keep, sparse, COSTS, parts, symmetric)

    def bordering_entries(self, problem: Any) -> scipy.sparse.coo_matrix:
        """Entries of the last tangent in bordering rows and columns (n + m, n + m), as pairs."""
        ffi, c = problem.ffi, problem.c
        entries, size = ffi.new("BorderEntries *"), c.tables.system.unknowns + c.tables.border.rows
        problem.library.fx_list_border(c, entries)  # counts them
        places, values = np.empty((2, entries.count), np.int32), np.empty(entries.count)
        entries.row, entries.column = (ffi.from_buffer("int[]", part) for part in places)
        entries.value = ffi.from_buffer("double[]", values)
        problem.library.fx_list_border(c, entries)
        return scipy.sparse.coo_matrix((values, places), (size, size))

    def transposed(self, problem: Any) -> np.ndarray:
        """Storage index of each entry of the tangent in its transpose, among sparse factors.

        Of a chain or a band it is that of each stored value.
        """
        indptr, indices = self.pattern
        n = len(indptr) - 1
        numbered = scipy.sparse.csr_matrix((np.arange(len(indices)), indices, indptr), (n, n))
        turned = numbered.T.tocsr()
        turned.sort_indices()
        places = np.empty(len(indices), dtype=int)
        places[turned.data] = self._factors_of(turned.indptr, turned.indices).at
        if not self.factors.band:
            return places
        stored, own = np.arange(problem.c.tables.tangent.stored), self.tangent_places
        stored[own], stored[places] = places, own
        return stored

    @cached_property
    def tangent_places(self) -> np.ndarray:
        """Storage indices of the entries of `ReducedTangent.pattern`."""
        indptr, indices = self.pattern
        is_band = self.factors.band
        return self._factors_of(indptr, indices).at if is_band else np.arange(len(indices))


def alone_in_column(reduction: Reduction) -> np.ndarray:
    """Whether a degree of freedom equals an unknown on which nothing else depends, (size,).

    No other degree of freedom, no closure of a loop, and no auxiliary unknown.
    """
    row, column, value, sign = reduction.couplings.all_entries
    equal = (value == 0) & (sign == 1) & (column < reduction.free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(reduction.joints.members["dofs"], dtype=bool)
    alone[row[equal & single]] = True
    for name in ("auxiliary", "loops"):
        if "column" in (members := reduction.joints.members[name]):
            alone[np.isin(reduction.couplings.column, members["column"])] = False
    return alone


def storage_of_entries(
    tangent: ReducedTangent, full, alone: np.ndarray, places: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Storage index of each entry of the full tangent, and number of stored values.

    Entries that are entries of the reduced tangent share its storage; the others are behind it.
    """
    direct = np.repeat(alone, np.diff(full.indptr)) & alone[full.indices]
    stored_at, used = np.empty(full.nnz, dtype=np.int32), np.zeros(full.nnz, dtype=bool)
    used[tangent.direct["from"]] = True
    stored_at[tangent.direct["from"]] = places[tangent.direct["to"]]
    other_entries = np.flatnonzero(~(direct & used))
    stored_at[other_entries] = behind + np.arange(len(other_entries))
    return stored_at, behind + len(other_entries)


def storage_of(
    reduction: Reduction, places: np.ndarray, stored: int
) -> tuple[np.ndarray, int, np.ndarray]:
    """Storage indices of a bordered tangent's entries, number of values, indices of entries 1.

    Given are those of the tangent of open loops. Entries on bordering rows are behind them; ones
    are on the diagonal of slides.
    """
    if not reduction.couplings.sliding:
        return places, stored, places[:0]
    bordered = reduction.sliders.bordered
    all_places = np.empty(reduction.sliders.entries_before, dtype=int)
    all_places[bordered.inside] = places[bordered.positions]
    all_places[bordered.border_entries] = stored + np.arange(len(bordered.border_entries))
    return all_places, stored + len(bordered.border_entries), places[bordered.ones]


def on_bordering_rows(
    reduction: Reduction, rows: np.ndarray, columns: np.ndarray, first: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the system for all columns of the scene, with those on bordering rows.

    Bordering rows are numbered downwards from `first`.
    """
    if reduction.sliders is None:
        return rows, columns
    rows, columns, bordering = rows.copy(), columns.copy(), reduction.sliders.outside
    rows[bordering] = columns[bordering] = first - np.arange(len(bordering))
    return rows, columns


def bordering_tables(
    model: Model, tables: list[dict[str, Any]], places: np.ndarray, first: int, inside: bool
) -> dict[str, Any]:
    """The border and its rows, for `tables` of sliding nodes, by the names in c/tables.h.

    `places` are the storage indices of `storage_of`. Bordering rows are numbered downwards from
    `first`; they may be `inside` of the sparse rows.
    """
    reduction, sliders = model.reduction, model.reduction.sliders
    rows, columns = on_bordering_rows(reduction, *reduction.couplings.system, first)
    bordering, bordered = sliders.outside, sliders.bordered
    sizes = [table["components"] + table["products"] for table in tables]
    carriers = len(bordering) + sum(sizes) + sum(table.get("anchors", 0) for table in tables)
    alone, slides = len(sliders.forces), bordering[bordering < reduction.free]
    rows, columns = (np.append(x, first - carriers - np.arange(alone)) for x in (rows, columns))
    pivot = np.arange(carriers + alone)
    for table in tables:  # a column of a node and the force on it are pivots of each other's rows
        column_rows = first - columns[table["carried"]]
        force_rows = table["bordering_row"] + np.arange(table["components"])
        pivot[column_rows], pivot[force_rows] = force_rows, column_rows
    return {
        "system": {"row_of": rows, "unknown_of": columns},
        "sliders": {
            "count": len(tables),
            "path_numbers": sum(guide.path.numbers.size for guide in sliders.guides),
        },
        "border": {
            "rows": carriers + alone,
            "carriers": carriers,
            "block": 0 if inside else -(-(carriers + alone) // _LANES) * _LANES,
            "inside": inside,
            "pivot": pivot,
            "beside": len(bordered.border_entries),
            "beside_row": bordered.rows,
            "beside_column": bordered.columns,
            "beside_at": places[bordered.border_entries],
            "bordered": len(slides) + alone,
            "bordered_unknown": np.append(slides, sliders.forces),
            "bordered_row": np.append(np.arange(len(slides)), carriers + np.arange(alone)),
        },
    }


def with_bordering_rows(
    groups: dict[str, Any], border: dict[str, Any], sliders: list[dict[str, Any]]
) -> dict[str, Any]:
    """Groups of `groups_of` with those of bordering rows, of a `border` and its sliders.

    Slides wait with all others for what holds the nodes on their beams.
    """
    count, slides = groups["groups"], border["bordered"]
    number, total = np.full(border["rows"], -1), count + slides
    number[:slides] = count + np.arange(slides)
    for table in sliders:
        sizes = [table["components"], table["products"], table.get("anchors", 0)]
        column_rows = border["pivot"][table["bordering_row"] :][: sizes[0]]
        behind = table["bordering_row"] + np.cumsum([0, *sizes])
        parts = [column_rows, *(np.arange(*ends) for ends in pairwise(behind))]
        for part in parts:
            for first in range(0, len(part), GROUP):
                number[part[first : first + GROUP]], total = total, total + 1
    group_of = np.append(groups["group_of"], number)
    waiting = groups["waiting"], np.arange(count + slides + 1, total), np.arange(count + slides)
    waits = np.append(groups["waits"], np.zeros(total - count, int))
    waits[: count + slides] += 1
    waits[count + slides + 1 :] = 1
    starts, sums = groups["waiting_start"], np.cumsum([len(part) for part in waiting])
    chain = sums[0] + np.arange(total - count - slides)
    return {
        "groups": total,
        "group_of": group_of,
        "first_unknown": starts_of(np.bincount(group_of)),
        "unknown": np.argsort(group_of, kind="stable"),
        "graph_start": np.append(groups["graph_start"], [len(groups["graph"])] * (total - count)),
        "graph": groups["graph"],
        "waits": waits,
        "waiting_start": np.concatenate([starts[:-1], np.full(slides, sums[0]), chain, sums[-1:]]),
        "waiting": np.concatenate(waiting),
    }


def _sliders(
    model: Model, sliders: Sliders, places: np.ndarray, diagonal_at: np.ndarray
) -> list[dict[str, Any]]:
    """Sliding nodes as ``Slider``."""
    tables, anchored, bordering_row = [], set(), len(sliders.outside)
    starts = starts_of([guide.path.numbers.size for guide in sliders.guides])
    guide_members = {
        guide: {"turn_stored_at": diagonal_at[guide.dofs[:, 2]], "path": start}
        for guide, start in zip(sliders.guides, starts, strict=False)
    }
    rates = model.scheme.rates
    for slide in sliders.all:
        components, guide = len(slide.columns), slide.guide
        table = slide.members() | guide_members[guide]
        # Products of the derivatives of the virtual displacement and rotation (sliders.py).
        table["products"] = 0 if rates.level != 0.5 else 2 if components == 2 else 4
        table["bordering_row"] = bordering_row
        if guide not in anchored:
            anchored.add(guide)
            if rates.at_rest or fact(model, massless_dofs)[slide.dofs[:, :2]].any():
                table |= _anchor_of(slide, sliders, places)
        bordering_row += components + table["products"] + table.get("anchors", 0)
        tables.append(table)
    return tables


def _anchor_of(slide: Slide, sliders: Sliders, places: np.ndarray) -> dict[str, Any]:
    """A node near the middle of a beam that no joint holds, if there is one."""
    columns, positions = sliders.diagonals(slide)
    alone = np.flatnonzero((columns >= 0).all(axis=1))
    if not len(alone):
        return {}
    node = alone[np.argmin(abs(alone - len(columns) // 2))]
    anchor = {"anchor_column": columns[node], "anchor_at": places[positions[node]]}
    return {"anchors": len(anchor["anchor_at"]), **anchor}
