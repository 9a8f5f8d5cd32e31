"""Derivatives of a sum of outputs, as they are collected."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Gradient:
    """Derivatives by states and forces of a run, and by numbers of its scene.

    `sizes` has the numbers of states or forces, and of the values in each, by name.
    """

    def __init__(self, sizes: Mapping[str, tuple[int, int]]):
        self._sizes = sizes
        #: Those by states and forces (n, size).
        self.of_state: dict[str, np.ndarray] = {}
        #: Those by whole arrays of numbers.
        self.of_numbers: dict[str, np.ndarray] = {}
        self._picked: list[tuple[str, int, float]] = []

    def at(self, name: str) -> np.ndarray:
        """Those by all states or forces of a name, to which one adds."""
        if name not in self.of_state:
            self.of_state[name] = np.zeros(self._sizes[name])
        return self.of_state[name]

    def add_number(self, name: str, index: int, value: float) -> None:
        """Add the derivative by one of the numbers of a name."""
        self._picked.append((name, index, value))

    def add_numbers(self, name: str, values: np.ndarray) -> None:
        """Add the derivatives by all numbers of a name."""
        self.of_numbers[name] = self.of_numbers.get(name, 0.0) + values

    def along(self, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """What is by numbers, times changes (m, ...) of these: (m,)."""
        found = sum(
            (along(changes[name], values) for name, values in self.of_numbers.items()),
            np.zeros(len(changes["X"])),
        )
        for name, index, value in self._picked:
            found += changes[name].reshape(len(found), -1)[:, index] * value
        return found


def along(changes: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Products (m,) of changes (m, ...) and a gradient."""
    return changes.reshape(len(changes), -1) @ np.ravel(gradient)


def weights_of_steps(ends: np.ndarray, weights: np.ndarray, later: float, count: int) -> np.ndarray:
    """Sums (count,) of the weights (n,) of all rows after each step, which sums over steps have.

    Rows are after `ends` (n,) steps; `later` is the sum of the weights of still later rows.
    """
    # Of no rows `bincount` gives integers, to which parts of numbers cannot be added.
    at_ends = np.bincount(np.append(ends, count), np.append(weights, later), count + 1)
    return at_ends[::-1].cumsum()[::-1][1:]


def sums_after(of_steps: np.ndarray) -> np.ndarray:
    """Sums (k + 1, m) of values (k, m) of steps before the first, and after each."""
    return np.concatenate([np.zeros((1, of_steps.shape[1])), of_steps.cumsum(axis=0)])
