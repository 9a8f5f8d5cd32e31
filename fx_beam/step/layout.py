"""The table of named arrays in the vector of a linearised sub-step (c/blocks.h)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from .tables import Problem

_FIRST_OF_STEPS, _FIRST_OF_RESULTS = "loads", "Y1"


class Layout:
    """Where the arrays begin and end, by their names in C with spaces."""

    def __init__(self, problem: Problem, c: Any):
        starts = {name.replace("_", " "): getattr(c, name) for name, _ in _fields(problem, c)}
        slices = itertools.starmap(slice, itertools.pairwise(starts.values()))
        #: The slices of all arrays; length of the vector.
        self.of, self.size = dict(zip(starts, slices, strict=False)), starts["size"]
        names = list(self.of)
        first, end = names.index(_FIRST_OF_STEPS), names.index(_FIRST_OF_RESULTS)
        #: Names of the numbers of the scene and of its state, and of those of each sub-step.
        self.numbers, self.steps = names[:first], names[first:end]
        #: Where the latter begin, and how many there are.
        self._first = starts[_FIRST_OF_STEPS]
        self.step_size = starts[_FIRST_OF_RESULTS] - self._first
        model, p = problem.model, problem.c
        self._shapes: dict[str, tuple[int, ...]] = {
            "offset": (p.joints, 2),
            "axis": (p.joints, 2),
            "places": (p.sliders, 3),
            "internal": model.forms.internal_shape,
            "loads": (2, p.loads),
            "follower force": (p.follower_forces, 2),
            "parameters": (2, p.parameter_count),
        }
        slides = np.full(model.scene.joint_count, self.of["nowhere"].start)
        for joint, column in model.couplings.slides.items():
            slides[joint] = starts["Y"] + column
        arrays = {name: np.arange(part.start, part.stop) for name, part in self.of.items()}
        constrained = arrays["R"][p.free : p.columns]
        #: Rows of states and of forces.
        of_state = {name: arrays[name] for name in ("q", "v", "internal", "spring internal")}
        self.states = Rows(of_state | {"slides": slides})
        self.forces = Rows({"constraints": constrained, "joints": arrays["forces"]})
        #: Rows of the forces on unknowns.
        self.equations = Rows({"equations": arrays["R"][: p.free]})

    def named(self, x: np.ndarray, of_steps: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers of the scene in x (size,), and those of all sub-steps (n, step_size), by name."""
        named = {name: self._shaped(name, x[self.of[name]].copy()) for name in self.numbers}
        for name in self.steps:
            named[name] = self._shaped(name, of_steps[:, self.in_step(name)], len(of_steps))
        return named

    def in_step(self, name: str) -> slice:
        """The slice of an array of a sub-step among all numbers of the sub-step."""
        part = self.of[name]
        return slice(part.start - self._first, part.stop - self._first)

    def _shaped(self, name: str, values: np.ndarray, *rows: int) -> np.ndarray:
        return values.reshape(*rows, *self._shapes.get(name, values.shape[len(rows) :]))


class Rows:
    """Numbers of the vector in rows of a run, in parts by name: ``RowsOfRun`` of c/problem.h."""

    def __init__(self, parts: dict[str, np.ndarray]):
        self._places = np.concatenate([*parts.values()])
        ends = itertools.accumulate([0, *map(len, parts.values())])
        self._of = dict(zip(parts, itertools.starmap(slice, itertools.pairwise(ends)), strict=True))

    def members(self, numbers: np.ndarray, every: int, rows: np.ndarray) -> dict[str, Any]:
        """Members for rows with these numbers, of so many."""
        at = np.full(every, -1)
        at[numbers] = np.arange(len(numbers))
        size = len(self._places)
        return {"at": at, "size": size, "place": self._places, "rows": never_empty(rows)}

    def filled(self, given: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        """Rows (count, size) of the given parts, with zeros in all others."""
        rows = np.zeros((count, len(self._places)))
        for name in given.keys() & self._of.keys():
            rows[:, self._of[name]] = np.reshape(given[name], (count, -1))
        return rows

    def empty(self, *lengths: int) -> np.ndarray:
        """Rows (*lengths, size) of zeros."""
        return np.zeros((*lengths, len(self._places)))

    def parts(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Parts of rows by name."""
        return {name: rows[..., part] for name, part in self._of.items()}


def never_empty(array: np.ndarray) -> np.ndarray:
    """An array with an address."""
    return array if array.size else np.zeros(1)


def _fields(problem: Problem, struct: Any) -> Any:
    return problem.ffi.typeof(struct).fields
