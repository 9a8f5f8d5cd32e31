"""Where parts are in the lists of a scene: found by identity, without a search along a list."""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections.abc import Sequence


class PartIndex:
    """Places of parts in a list, which may also be changed elsewhere.

    Each part has an order by its id. Orders rise along the list, also after `replace` and `remove`.
    """

    def __init__(self, parts: list):
        self.parts = parts
        self._number_anew()

    def _number_anew(self) -> None:
        self._orders: dict[int, int] = {}
        # Number of parts, from the first one on, that have an order; and of those removed since.
        self._count = self._removed = 0

    def find(self, *parts: object) -> slice | None:
        """The shortest range of the list that has some parts; None if the list lacks one."""
        span = self._span(parts)
        if span is None:
            self._number_anew()
            span = self._span(parts)
        return span

    def _span(self, parts: Sequence) -> slice | None:
        """As `find`; None also where orders do not fit a list that was changed elsewhere."""
        new_orders = itertools.count(self._count + self._removed)
        self._orders.update(zip(map(id, self.parts[self._count :]), new_orders, strict=False))
        self._count = len(self.parts)
        ids = {*map(id, parts)}
        orders = [self._orders.get(key, -1) for key in ids]
        span = slice(self._place(min(orders)), self._place(max(orders)) + 1)
        known = min(orders) >= 0 and ids <= {*map(id, self.parts[span])}
        return span if known else None

    def _place(self, order: int) -> int:
        """Place of the part with an order: lower by the number of parts removed before it."""
        low, high = max(order - self._removed, 0), min(order + 1, self._count)
        orders = self._orders
        return bisect_left(self.parts, order, low, high, key=lambda part: orders.get(id(part), -1))

    def replace(self, place: int, part: object) -> None:
        """Put a part in the place of another one."""
        self._orders[id(part)] = self._orders.pop(id(self.parts[place]))
        self.parts[place] = part

    def remove(self, span: slice, parts: Sequence) -> None:
        """Take parts away, which are in a range of the list."""
        gone = {*map(id, parts)}
        self.parts[span] = [part for part in self.parts[span] if id(part) not in gone]
        for key in gone:
            del self._orders[key]
        self._count -= len(gone)
        self._removed += len(gone)


class PartIndices:
    """Indices of the lists of a scene, each made when it is used first."""

    def __init__(self) -> None:
        self._by_name: dict[str, PartIndex] = {}

    def of(self, scene, name: str) -> PartIndex:
        """Index of the list with a name."""
        index, parts = self._by_name.get(name), getattr(scene, name)
        if index is None or index.parts is not parts:
            index = self._by_name[name] = PartIndex(parts)
        return index
