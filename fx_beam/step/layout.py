"""The table of named arrays in the vector of a linearised sub-step (c/blocks.h)."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from .tables import Problem

_FIRST_OF_STEPS, _FIRST_OF_RESULTS = "loads", "Y1"


class Layout:
    """Where the arrays begin and end, by their names in C with spaces."""

    def __init__(self, problem: Problem, adjoint: Any):
        c = problem.derivatives.fx_layout(problem.c, adjoint)
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

    def named(self, x: np.ndarray, of_steps: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers of the scene in x (size,), and those of all sub-steps (n, step_size), by name."""
        named = {name: self._shaped(name, x[self.of[name]].copy()) for name in self.numbers}
        for name in self.steps:
            named[name] = self._shaped(name, of_steps[:, self.in_step(name)], len(of_steps))
        return named

    def in_step(self, name: str) -> slice:
        """The slice of an array of a sub-step among all numbers of the sub-step."""
        own = self.of[name]
        return slice(own.start - self._first, own.stop - self._first)

    def _shaped(self, name: str, values: np.ndarray, *rows: int) -> np.ndarray:
        return values.reshape(*rows, *self._shapes.get(name, values.shape[len(rows) :]))


def _fields(problem: Problem, struct: Any) -> Any:
    return problem.ffi.typeof(struct).fields
