"""Local derivatives of outputs: followed backwards and forwards by the same blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np


class Block(NamedTuple):
    """Derivatives (k, e) of a component of an output by entries of states, forces or numbers."""

    name: str
    #: The entries of each state, or of all numbers of the name, flat.
    entries: slice
    #: Rows (k,) of the output in their order.
    rows: np.ndarray
    derivatives: np.ndarray
    #: Places (k,) among the states, forces or sub-steps, each at most once; None for numbers that
    #: do not have a row for each sub-step.
    places: np.ndarray | slice | None = None
    part: int = 0

    def times(self, factor: float) -> Block:
        """The same of a multiple of the output."""
        return self if factor == 1 else self._replace(derivatives=factor * self.derivatives)


def of_row(
    name: str, row: int, values: np.ndarray, place: int | None = None, first: int = 0
) -> Block:
    """Derivatives of one row by all entries of a state, or of numbers, from the `first` on."""
    entries = slice(first, first + values.size)
    places = None if place is None else slice(place, place + 1)
    return Block(name, entries, np.array([row]), values.reshape(1, -1), places)


def of_entry(name: str, entry: int, rows: np.ndarray, derivatives: Any, **more: Any) -> Block:
    """Derivatives (k,), or the same one, of rows (k,) by one entry."""
    values = np.broadcast_to(derivatives, rows.shape)[:, None]
    return Block(name, slice(entry, entry + 1), rows, values, **more)


def pull(blocks: Iterable[Block], weights: np.ndarray, to: Gradient) -> None:
    """Add the derivatives of the sum of weights (n, ...) times an output."""
    if weights.ndim == 1:
        weights = weights[:, None]
    for name, entries, rows, derivatives, places, part in blocks:
        to.add(name, entries, places, weights[rows, part][:, None] * derivatives)


def push(
    blocks: Iterable[Block],
    shape: tuple[int, ...],
    of_state: Mapping[str, np.ndarray],
    changes: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Changes (*shape, m) of an output from those of states (n, m, ...) and numbers (m, ...)."""
    count = len(changes["X"])
    found = np.zeros((shape[0], *(shape[1:] or (1,)), count))
    for name, entries, rows, derivatives, places, part in blocks:
        if places is None:
            values = (changes[name].reshape(count, -1)[:, entries] @ derivatives.T).T
        else:
            if name in of_state:
                states = of_state[name]
            else:  # numbers with a row for each sub-step
                states = changes[name].swapaxes(0, 1)
            states = states.reshape(len(states), count, -1)[..., entries][places]
            values = (states @ derivatives[..., None])[..., 0]
        if len(rows) == 1:  # as of energies, in each of their rows
            found[rows[0], part] += values[0]
        else:
            first = np.flatnonzero(np.diff(rows, prepend=-1))
            found[rows[first], part] += np.add.reduceat(values, first)
    return found.reshape(*shape, count)


class Gradient:
    """Derivatives by states and forces of a run, and by numbers of its scene.

    `sizes` has the numbers of states or forces, and of the values in each, by name.
    """

    def __init__(self, sizes: Mapping[str, tuple[int, int]]):
        self._sizes = sizes
        #: Those by states and forces (n, size).
        self.of_state: dict[str, np.ndarray] = {}
        #: Those by entries of numbers, and by numbers with a row for each sub-step.
        self._of_numbers: dict[tuple[str, int, int], np.ndarray] = {}
        self._of_steps: list[tuple[str, slice, Any, np.ndarray]] = []

    def at(self, name: str) -> np.ndarray:
        """Those by all states or forces of a name, to which one adds."""
        if name not in self.of_state:
            self.of_state[name] = np.zeros(self._sizes[name])
        return self.of_state[name]

    def add(self, name: str, entries: slice, places: Any, values: np.ndarray) -> None:
        """Add derivatives (k, e) by entries, as those of a `Block`."""
        if places is None:
            key, total = (name, entries.start, entries.stop), values.sum(axis=0)
            if key in self._of_numbers:
                self._of_numbers[key] += total
            else:
                self._of_numbers[key] = total
        elif name in self._sizes:
            self.at(name)[:, entries][places] += values
        else:
            self._of_steps.append((name, entries, places, values))

    def add_numbers(self, name: str, values: np.ndarray) -> None:
        """Add the derivatives by all numbers of a name."""
        self.add(name, slice(0, values.size), None, values.reshape(1, -1))

    def along(self, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """What is by numbers, times changes (m, ...) of these: (m,)."""
        count = len(changes["X"])
        found = np.zeros(count)
        for (name, start, stop), values in self._of_numbers.items():
            found += changes[name].reshape(count, -1)[:, start:stop] @ values
        for name, entries, places, values in self._of_steps:
            rows = changes[name].reshape(count, changes[name].shape[1], -1)
            found += np.einsum("ke,mke->m", values, rows[..., entries][:, places])
        return found


def along(changes: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Products (m,) of changes (m, ...) and a gradient."""
    return changes.reshape(len(changes), -1) @ np.ravel(gradient)


def weights_of_steps(ends: np.ndarray, weights: np.ndarray, later: float, count: int) -> np.ndarray:
    """Sums (count + 1,) of the weights of all rows from the start on, and from after each step on.

    Rows with weights (n,) are after `ends` (n,) steps; `later` is the sum of those of later rows.
    """
    # Of no rows `bincount` gives integers, to which parts of numbers cannot be added.
    at_ends = np.bincount(np.append(ends, count), np.append(weights, later), count + 1)
    return at_ends[::-1].cumsum()[::-1]
