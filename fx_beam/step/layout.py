"""The table of named arrays in the vector of a linearised sub-step (c/blocks.h)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import LinearChanges

from .block import aligned_zeros
from .tables import ProblemInC

#: Arrays by name.
Arrays = Mapping[str, np.ndarray]
_FIRST_OF_STEPS, _FIRST_OF_RESULTS = "loads", "Y1"


class Numbers(NamedTuple):
    """Numbers of a scene with one name: where the vector has them, some more than once."""

    at: np.ndarray
    #: Which of how many numbers these are.
    of: np.ndarray
    size: int

    def sums(self, x: np.ndarray) -> np.ndarray:
        """Sums (size,) of the entries of a vector x that belong to each number."""
        return np.bincount(self.of, x[self.at], self.size)


def all_of(places: np.ndarray) -> Numbers:
    """Numbers in their order."""
    return Numbers(places.ravel(), np.arange(places.size), places.size)


class StepVariables:
    """Where the arrays are, by their names in C with spaces."""

    def __init__(self, problem: ProblemInC, c: Any):
        fields = [name for name, _ in problem.ffi.typeof(c).fields]
        starts = {name.replace("_", " "): getattr(c, name) for name in fields}
        #: The indices of all arrays; length of the vector.
        ends = itertools.pairwise(starts.values())
        self.at = {name: np.arange(*part) for name, part in zip(starts, ends, strict=False)}
        self.size, names = starts["size"], [*self.at]
        first, end = names.index(_FIRST_OF_STEPS), names.index(_FIRST_OF_RESULTS)
        #: Names of the numbers of the scene and of its state.
        self.numbers = names[:first]
        #: Indices of the numbers of each sub-step among these, and how many there are.
        self.steps = {name: self.at[name] - starts[_FIRST_OF_STEPS] for name in names[first:end]}
        self.step_size = starts[_FIRST_OF_RESULTS] - starts[_FIRST_OF_STEPS]
        model, p = problem.model, problem.c.tables
        self._group_size = problem.constants.GROUP_SIZE
        #: Indices of the slides of all joints.
        self.slides = np.full(model.scene.joint_count, starts["nowhere"])
        for joint, column in model.couplings.slides.items():
            self.slides[joint] = starts["Y"] + column
        #: Rows of states, of forces, of configurations at ends, closures and forces on unknowns.
        arrays = "q", "v", "internal", "spring internal", "natural"
        state_places = {name: self.at[name] for name in arrays}
        constrained = self.at["R"][p.free : p.columns]
        self.states = Rows(state_places | {"slides": self.slides})
        self.ends = Rows({"q": self.at["q1"]})
        self.closures = Rows({"closures": self.at["closures"]})
        self.forces = Rows({"constraints": constrained, "joints": self.at["forces"]})
        self.equations = Rows({"equations": self.at["R"][: p.free]})

    def groups(self, count: int, size: int) -> np.ndarray:
        """Zeros (groups, size, group size) for so many columns, side by side in groups."""
        return aligned_zeros(-(-count // self._group_size), size, self._group_size)

    def vector(self, changes: Arrays, numbers: Mapping[str, Numbers], count: int) -> np.ndarray:
        """Changes (count, ...) of some numbers in `groups`, and zeros."""
        x, size = self.groups(count, self.size), self._group_size
        for name in changes.keys() & numbers.keys():
            (places, entries, _), change = numbers[name], changes[name]
            if isinstance(change, LinearChanges):
                for i, column in zip(*change.columns, strict=True):
                    x[i // size, places, i % size] = column[entries]
            elif any(change.strides):  # others are zeros (dual.py)
                put_columns(x, places, np.reshape(change, (count, -1)).T[entries])
        return x


class Rows:
    """Numbers of the vector in rows of a run, in parts by name: ``RowsOfRun`` of c/problem.h."""

    def __init__(self, parts: dict[str, np.ndarray]):
        self._places = np.concatenate([*parts.values()])
        ends = itertools.accumulate([0, *map(len, parts.values())])
        slices = itertools.starmap(slice, itertools.pairwise(ends))
        self._part = dict(zip(parts, slices, strict=True))

    def only(self, entries: Mapping[str, Any] | None) -> Rows:
        """Rows of some entries of some parts, by name; these rows themselves for none."""
        chosen = (entries or {}).items()
        parts = {name: self._places[self._part[name]][entry] for name, entry in chosen}
        return Rows(parts) if parts else self

    def members(
        self, numbers: np.ndarray, count: int, rows: np.ndarray, row_of: np.ndarray | None = None
    ) -> dict[str, Any]:
        """Members for `rows` that belong to some numbers k of a `count`.

        In the order of the numbers, or the i-th to row `row_of[i]`: several may have one row.
        """
        row_numbers = np.full(count, -1)
        row_numbers[numbers] = np.arange(len(numbers)) if row_of is None else row_of
        size = len(self._places)
        return {"at": row_numbers, "size": size, "place": self._places, "rows": never_empty(rows)}

    def filled(self, arrays: Arrays, count: int) -> np.ndarray:
        """Rows (count, size) of the given parts, with zeros in all others."""
        rows = np.zeros((count, len(self._places)))
        for name in arrays.keys() & self._part.keys():
            rows[:, self._part[name]] = np.reshape(arrays[name], (count, -1))
        return rows

    def empty(self, *lengths: int) -> np.ndarray:
        """Rows (*lengths, size) of zeros, to which C adds."""
        return np.zeros((*lengths, len(self._places)))

    def parts(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Parts of rows by name."""
        return {name: rows[..., part] for name, part in self._part.items()}


def put_columns(groups: np.ndarray, rows: Any, columns: np.ndarray) -> None:
    """Put columns (k, n) in these rows of all groups."""
    size = groups.shape[2]
    for group, first in zip(groups, range(0, columns.shape[1], size), strict=True):
        part = columns[:, first : first + size]
        group[rows, : part.shape[1]] = part


def never_empty(array: np.ndarray) -> np.ndarray:
    """An array with an address."""
    return array if array.size else np.zeros(1)
