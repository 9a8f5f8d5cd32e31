"""What borders the tangent of the compiled loop (c/bordering_rows.h), as lists of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.sliders import Slide, Sliders

from .lu_layout import Factors
from .model import Model

# Columns of the block of right sides are computed in such lanes.
_LANES = 4


def storage_of(reduction: JointReduction, at: np.ndarray, stored: int) -> tuple[np.ndarray, int]:
    """Storage indices of the entries of a bordered tangent, and the number of values.

    Given are those of `Reduction.factored`. Entries on bordering rows are behind them.
    """
    if (sliders := reduction.sliders) is None:
        return at, stored
    bordered = sliders.bordered
    of_all = np.empty(sliders.entries_before, dtype=int)
    of_all[bordered.inside] = at[reduction.open_entries()[bordered.positions]]
    of_all[bordered.beside] = stored + np.arange(len(bordered.beside))
    return of_all, stored + len(bordered.beside)


def ones_of(reduction: JointReduction, at: np.ndarray) -> np.ndarray:
    """Storage indices of diagonals of slides in the factorised tangent, which are 1."""
    if (sliders := reduction.sliders) is None:
        return at[:0]
    return at[np.append(reduction.open_entries()[sliders.bordered.ones], reduction.carriers()[0])]


def on_bordering_rows(
    reduction: JointReduction, rows: np.ndarray, columns: np.ndarray, first: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the system for all columns of the scene, with those on bordering rows.

    BorderingRows are numbered downwards from `first`.
    """
    rows, columns = rows.copy(), columns.copy()
    if (sliders := reduction.sliders) is not None:
        outside = sliders.outside
        rows[outside] = columns[outside] = first - np.arange(len(outside))
    return rows, columns


class BorderingTables:
    """The bordering rows of a scene: columns of what slides, and what belongs to them.

    `at` are the storage indices of `storage_of`, `diagonal_at` (size,) those of the diagonal of the
    full tangent.
    """

    def __init__(
        self,
        reduction: JointReduction,
        factors: Factors,
        at: np.ndarray,
        diagonal_at: np.ndarray,
        model: Model,
        first: int,
    ):
        self._reduction, self._factors, self._at = reduction, factors, at
        self._diagonal_at = diagonal_at
        self._model, self._first = model, first

    def all(self) -> dict[str, Any]:
        """Members of ``Problem``; empty without bordering rows."""
        if (sliders := self._reduction.sliders) is None:
            return {}
        order = np.append(self._factors.order, np.full(1 + self._reduction.columns, -1))
        rows, columns = (order[index] for index in self._reduction.system())
        rows, columns = on_bordering_rows(self._reduction, rows, columns, self._first)
        outside, bordered = sliders.outside, sliders.bordered
        tables = self._tables(sliders, len(outside))
        longest = [table.pop("longest") for table in tables]
        sizes = [table["components"] + table["products"] for table in tables]
        carriers = len(outside) + sum(sizes) + sum(table["anchors"] for table in tables)
        alone, closure_entries = self._reduction.carriers()
        entries = sum(n * (1 + k) for n, k in zip(longest, sizes, strict=True))
        return {
            "row_at": rows,
            "unknown_at": columns,
            "sliders": len(tables),
            "slider": tables,
            "beside": len(bordered.beside),
            "beside_row": bordered.rows,
            "beside_column": bordered.columns,
            "beside_at": self._at[bordered.beside],
            "bordering_rows": carriers + len(alone),
            "carrier_bordering": carriers,
            "block": -(-(1 + carriers + len(alone)) // _LANES) * _LANES,
            "most_bordering_entries": entries
            + len(bordered.beside)
            + 3 * len(tables)
            + closure_entries,
        }

    def _tables(self, sliders: Sliders, bordering_row: int) -> list[dict[str, Any]]:
        """Sliding nodes as ``Slider``; each also with the largest number of parts of a window."""
        tables, anchored = [], set()
        for k, slide in enumerate(sliders.all):
            beam, rule = slide.joint.beam, slide.relation
            table = _path_of(slide) | _entries_of(k, sliders) | self._parts_of(slide, sliders)
            # Products of the derivatives of the virtual displacement and rotation (sliding.py).
            table["products"] = 0 if rule.level != 0.5 else 2 if len(slide.columns) == 2 else 4
            table["anchors"] = 0
            at_rest = self._model.scheme.rates.at_rest
            light = at_rest or self._model.massless[slide.dofs[:, :2]].any()
            if beam not in anchored and light:
                anchored.add(beam)
                table |= self._anchor_of(slide, sliders)
            table["bordering_row"] = bordering_row
            bordering_row += table["components"] + table["products"] + table["anchors"]
            tables.append(table)
        return tables

    def _parts_of(self, slide: Slide, sliders: Sliders) -> dict[str, Any]:
        start, column, value, sign = sliders.parts(slide)
        width = 3 * slide.path.width
        firsts = np.arange(0, len(start) - width, 3)
        return {
            "part_start": start,
            "part_column": column,
            "part_value": value,
            "part_sign": sign,
            "turn_stored_at": self._diagonal_at[slide.dofs[:, 2]],
            "longest": int((start[firsts + width] - start[firsts]).max()),
        }

    def _anchor_of(self, slide: Slide, sliders: Sliders) -> dict[str, Any]:
        """A node near the middle of a beam that no joint holds, if there is one."""
        columns, positions = sliders.diagonals(slide)
        alone = np.flatnonzero((columns >= 0).all(axis=1))
        if not len(alone):
            return {}
        node = alone[np.argmin(abs(alone - len(columns) // 2))]
        return {
            "anchors": 3,
            "anchor_column": columns[node],
            "anchor_at": self._at[positions[node]],
        }


def _path_of(slide: Slide) -> dict[str, Any]:
    return slide.relation.table | {
        "joint": slide.joint.number,
        "column": slide.column,
        "carried": slide.columns,
        "node": slide.node_dofs,
        "dofs": slide.dofs,
    }


def _entries_of(k: int, sliders: Sliders) -> dict[str, Any]:
    entries = sliders.entries(k)
    rows, values, signs = (np.concatenate(part) for part in zip(*entries, strict=True))
    return {
        "entry_start": np.cumsum([0, *(len(part[0]) for part in entries)]),
        "entry_row": rows,
        "entry_value": values,
        "entry_sign": signs,
    }
