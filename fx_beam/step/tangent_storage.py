"""Where the loop stores entries of the full tangent, and what borders the reduced one, as lists."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.coupling.reduction import ReducedTangent, Reduction
from fx_beam.fem.sparsity import starts_of

from .lu_layout import GROUP
from .model import Model

if TYPE_CHECKING:
    from fx_beam.coupling.sliders import Slide, Sliders

# Columns of the block of right sides are computed in such lanes.
_LANES = 4


def alone_in_column(reduction: Reduction) -> np.ndarray:
    """Whether a degree of freedom equals an unknown on which nothing else depends, (size,).

    No other degree of freedom, no closure of a loop, and no auxiliary unknown.
    """
    row, column, value, sign = reduction.couplings.all_entries
    equal = (value == 0) & (sign == 1) & (column < reduction.free)
    single = np.bincount(row)[row] * np.bincount(column)[column] == 1
    alone = np.zeros(reduction.members["dofs"], dtype=bool)
    alone[row[equal & single]] = True
    for name in ("auxiliary", "loops"):
        if "column" in (members := reduction.members[name]):
            alone[np.isin(reduction.couplings.column, members["column"])] = False
    return alone


def storage_of_entries(
    tangent: ReducedTangent, full, alone: np.ndarray, places: np.ndarray, behind: int
) -> tuple[np.ndarray, int]:
    """Storage index of each entry of the full tangent, and number of stored values.

    Entries that are entries of the reduced tangent share its storage; the others are behind it.
    """
    direct = np.repeat(alone, np.diff(full.indptr)) & alone[full.indices]
    stored_at, used = np.empty(full.nnz, dtype=int), np.zeros(full.nnz, dtype=bool)
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
    of_all = np.empty(reduction.sliders.entries_before, dtype=int)
    of_all[bordered.inside] = places[bordered.positions]
    of_all[bordered.beside] = stored + np.arange(len(bordered.beside))
    return of_all, stored + len(bordered.beside), places[bordered.ones]


def on_bordering_rows(
    reduction: Reduction, rows: np.ndarray, columns: np.ndarray, first: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the system for all columns of the scene, with those on bordering rows.

    Bordering rows are numbered downwards from `first`.
    """
    rows, columns, bordering = rows.copy(), columns.copy(), reduction.sliders.outside
    rows[bordering] = columns[bordering] = first - np.arange(len(bordering))
    return rows, columns


def bordering_tables(
    model: Model, places: np.ndarray, diagonal_at: np.ndarray, first: int, inside: bool
) -> dict[str, Any]:
    """Tables of sliders, of the border and of its rows, by the names in c/problem.h.

    `places` are the storage indices of `storage_of`, `diagonal_at` (size,) of the diagonal of the
    full tangent. Bordering rows are numbered downwards from `first`; they may be `inside` of the
    sparse rows.
    """
    reduction, sliders = model.reduction, model.reduction.sliders
    rows, columns = on_bordering_rows(reduction, *reduction.couplings.system, first)
    bordering, bordered = sliders.outside, sliders.bordered
    tables = _sliders(model, sliders, places, diagonal_at)
    sizes = [table["components"] + table["products"] for table in tables]
    carriers = len(bordering) + sum(sizes) + sum(table.get("anchors", 0) for table in tables)
    alone, slides = len(sliders.forces), bordering[bordering < reduction.free]
    rows, columns = (np.append(x, first - carriers - np.arange(alone)) for x in (rows, columns))
    pivot = np.arange(carriers + alone)
    for table in tables:  # a column of a node and the force on it are pivots of each other's rows
        of_columns = first - columns[table["carried"]]
        of_forces = table["bordering_row"] + np.arange(table["components"])
        pivot[of_columns], pivot[of_forces] = of_forces, of_columns
    return {
        "system": {"row_of": rows, "unknown_of": columns},
        "sliders": {
            "count": len(tables),
            "path_numbers": sum(guide.path.numbers.size for guide in sliders.guides),
            "slider": tables,
        },
        "border": {
            "rows": carriers + alone,
            "carriers": carriers,
            "block": 0 if inside else -(-(carriers + alone) // _LANES) * _LANES,
            "inside": inside,
            "pivot": pivot,
            "beside": len(bordered.beside),
            "beside_row": bordered.rows,
            "beside_column": bordered.columns,
            "beside_at": places[bordered.beside],
            "bordered": len(slides) + alone,
            "bordered_unknown": np.append(slides, sliders.forces),
            "bordered_row": np.append(np.arange(len(slides)), carriers + np.arange(alone)),
        },
    }


def with_bordering_rows(groups: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """Groups of `groups_of` with those of bordering rows, of which the `tables` are.

    Slides wait with all others for what holds the nodes on their beams.
    """
    count, slides = groups["groups"], tables["border"]["bordered"]
    number, before = np.full(tables["border"]["rows"], -1), count + slides
    number[:slides] = count + np.arange(slides)
    for table in tables["sliders"]["slider"]:
        sizes = [table["components"], table["products"], table.get("anchors", 0)]
        of_columns = tables["border"]["pivot"][table["bordering_row"] :][: sizes[0]]
        behind = table["bordering_row"] + np.cumsum([0, *sizes])
        parts = [of_columns, *(np.arange(*ends) for ends in pairwise(behind))]
        for part in parts:
            for first in range(0, len(part), GROUP):
                number[part[first : first + GROUP]], before = before, before + 1
    group_of = np.append(groups["group_of"], number)
    waiting = groups["waiting"], np.arange(count + slides + 1, before), np.arange(count + slides)
    waits = np.append(groups["waits"], np.zeros(before - count, int))
    waits[: count + slides] += 1
    waits[count + slides + 1 :] = 1
    starts, sums = groups["waiting_start"], np.cumsum([len(part) for part in waiting])
    chain = sums[0] + np.arange(before - count - slides)
    return {
        "groups": before,
        "group_of": group_of,
        "first_unknown": starts_of(np.bincount(group_of)),
        "unknown": np.argsort(group_of, kind="stable"),
        "graph_start": np.append(groups["graph_start"], [len(groups["graph"])] * (before - count)),
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
    of_guides = {
        guide: {"turn_stored_at": diagonal_at[guide.dofs[:, 2]], "path": start}
        for guide, start in zip(sliders.guides, starts, strict=False)
    }
    rates = model.scheme.rates
    for slide in sliders.all:
        components, guide = len(slide.columns), slide.guide
        table = slide.members() | of_guides[guide]
        # Products of the derivatives of the virtual displacement and rotation (sliders.py).
        table["products"] = 0 if rates.level != 0.5 else 2 if components == 2 else 4
        table["bordering_row"] = bordering_row
        if guide not in anchored:
            anchored.add(guide)
            if rates.at_rest or model.massless[slide.dofs[:, :2]].any():
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
    at_node = {"anchor_column": columns[node], "anchor_at": places[positions[node]]}
    return {"anchors": len(at_node["anchor_at"]), **at_node}
