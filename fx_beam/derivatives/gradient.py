"""Local derivatives of outputs: followed backwards and forwards by the same blocks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.dual import Dual, LinearChanges
from fx_beam.errors import any_of
from fx_beam.step.layout import Arrays

#: Arrays by name, some of which may have slopes.
DualArrays = dict[str, np.ndarray | Dual]
#: Entries of an array, or places of rows in it.
Chosen = slice | np.ndarray


class DerivativeBlock(NamedTuple):
    """Derivatives (k, e) of an output in rows (k,) by entries of states, forces or numbers."""

    name: str
    #: The entries of each state, or of all numbers of the name, flat: a slice or an array (e,).
    entries: Chosen
    #: Rows of the output in their order.
    rows: np.ndarray
    derivatives: np.ndarray
    #: Places (k,) among the states, forces or sub-steps, each at most once; None for numbers that
    #: do not have a row for each sub-step.
    places: Chosen | None = None
    #: The component that depends on the entries, or (e,) that on each of them, or their slice.
    part: int | Chosen = 0

    def times(self, factor: float) -> DerivativeBlock:
        """Block of a multiple of the output."""
        return self if factor == 1 else self._replace(derivatives=factor * self.derivatives)


def of_rows(
    name: str, rows: np.ndarray, values: np.ndarray, places: Chosen | None = None, first: int = 0
) -> DerivativeBlock:
    """Derivatives (k, ...) of rows by all entries of states, or of numbers, from the `first` on."""
    slopes = values.reshape(len(rows), -1)
    return DerivativeBlock(name, slice(first, first + slopes.shape[1]), rows, slopes, places)


def of_names(rows: np.ndarray, derivatives: Mapping[str, np.ndarray]) -> Iterator[DerivativeBlock]:
    """Blocks of derivatives (k, ...) of rows by all entries, by name."""
    return (of_rows(name, rows, values) for name, values in derivatives.items() if values.size)


def of_entries(
    name: str,
    entries: ArrayLike,
    parts: ArrayLike,
    rows: np.ndarray,
    derivatives: ArrayLike,
    places: Chosen | None = None,
) -> DerivativeBlock:
    """A block where component parts[e] of each row depends on one entry, entries[e], alone."""
    entries, parts = np.atleast_1d(entries), np.atleast_1d(parts)
    values = np.empty((len(rows), len(entries)))
    values[:] = np.reshape(derivatives, (-1, 1))
    return DerivativeBlock(name, entries, rows, values, places, parts)


def vjp(blocks: Iterable[DerivativeBlock], weights: np.ndarray, gradient: Gradient) -> None:
    """Add the derivatives of the sum of weights (n, ...) times an output."""
    weights = weights[:, None] if weights.ndim == 1 else weights
    for name, entries, rows, derivatives, places, part in blocks:
        weight_rows = rows if isinstance(part, slice) else rows[:, None]
        gradient.add(name, entries, places, weights[weight_rows, part] * derivatives)


def jvp(
    blocks: Iterable[DerivativeBlock],
    shape: tuple[int, ...],
    state_changes: Arrays,
    changes: Arrays,
) -> np.ndarray:
    """Changes (*shape, m) of an output from those of states (n, m, ...) and numbers (m, ...)."""
    count = len(changes["X"])
    total = np.zeros((shape[0], *(shape[1:] or (1,)), count))
    for name, entries, rows, derivatives, places, part in blocks:
        if places is None:
            change = changes[name].reshape(count, -1)[:, entries]
            if not any_of(change):
                continue
        else:  # without states, numbers with a row for each sub-step
            change = state_changes[name] if name in state_changes else changes[name].swapaxes(0, 1)
            change = change.reshape(len(change), count, -1)[..., entries][places]
        if isinstance(part, int):  # row by row: to the last digit the same, however many there are
            values = (change @ derivatives[..., None])[..., 0]
        else:
            values = (change * derivatives[:, None]).swapaxes(1, 2)
        if any_of(rows[1:] == rows[:-1]):
            first = np.flatnonzero(np.diff(rows, prepend=-1))
            rows, values = rows[first], np.add.reduceat(values, first)
        total[rows[:, None] if isinstance(part, np.ndarray) else rows, part] += values
    return total.reshape(*shape, count)


class Gradient:
    """Derivatives by states and forces of a run, and by numbers of its scene.

    `sizes` has the numbers of states or forces, and of the values in each, by name. Derivatives by
    numbers are added to those of other parts of the run, `number_slopes`; others are left out.
    """

    def __init__(self, sizes: Mapping[str, tuple[int, ...]], number_slopes: Arrays):
        self._sizes, self._number_slopes = sizes, number_slopes
        #: Derivatives by states and forces (n, size), by name.
        self.state_slopes: dict[str, np.ndarray] = {}

    def derivative_by(self, name: str) -> np.ndarray:
        """Derivatives by all states or forces of a name, to which one adds."""
        if name not in self.state_slopes:
            self.state_slopes[name] = np.zeros(self._sizes[name])
        return self.state_slopes[name]

    def add(self, name: str, entries: Chosen, places: Chosen | None, values: np.ndarray) -> None:
        """Add derivatives (k, e) by entries, as those of a `DerivativeBlock`."""
        if places is not None and name in self._sizes:
            target = self.derivative_by(name)
        elif name in self._number_slopes:
            target = self._number_slopes[name]
        else:
            return
        if places is None:
            target.reshape(-1)[entries] += values.sum(axis=0)
        elif isinstance(entries, slice):
            target.reshape(len(target), -1)[:, entries][places] += values
        else:
            rows = np.arange(len(target))[places]
            target.reshape(len(target), -1)[rows[:, None], entries] += values


def along(changes: np.ndarray | LinearChanges, gradient: np.ndarray) -> np.ndarray:
    """Products (m,) of changes (m, ...) and a gradient."""
    if isinstance(changes, LinearChanges):
        return changes.along(np.ravel(gradient))
    # Without a copy where slopes are side by side, as of dual numbers.
    slopes = changes.transpose(*range(1, changes.ndim), 0)
    return np.ravel(gradient) @ slopes.reshape(-1, len(changes))
