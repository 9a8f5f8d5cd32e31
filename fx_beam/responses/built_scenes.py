"""The scenes that a function builds of numbers, and derivatives of what they are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.outputs import Output, check_output
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.validation import numbers, require, shown

from .output_values import Wanted

#: A function of numbers (m,) that gives a scene and its outputs by name.
Build = Callable[[np.ndarray], tuple[Scene, Mapping[str, Wanted]]]
#: Arrays by name, of a scene with a change of x[i]: a function of the scene, i and the change.
NumbersOf = Callable[[Scene, int, float], dict[str, np.ndarray]]

# Differences of `build`: steps relative to a number, and weights. Wide steps keep the round-off of
# its numbers small, and the combination has errors of their fourth power.
_STEPS = {2.0**-11: -1 / 3, 2.0**-12: 4 / 3}


def checked_numbers(x: Any) -> np.ndarray:
    """Numbers (m,) of a scene; SceneError for others."""
    values = numbers(x)
    fits = values.ndim == 1 and values.size > 0 and bool(np.isfinite(values).all())
    require(fits, "Response: x", x, "a sequence of finite numbers")
    return values


class BuiltScenes:
    """The scenes of a function, all of which have outputs of the same names."""

    def __init__(self, build: Build):
        self._build = build
        #: Names of the outputs, from the first scene on.
        self.names: list[str] = []

    def at(self, x: np.ndarray) -> tuple[Scene, dict[str, Wanted]]:
        """The scene of numbers, and its outputs; SceneError if `build` gives something else."""
        built = self._build(x)
        fits = isinstance(built, tuple) and len(built) == 2
        if not fits or not isinstance(built[0], Scene) or not isinstance(built[1], Mapping):
            raise SceneError(
                f"Response: build must give a scene and a dict of outputs, not {shown(built)}"
            )
        scene, outputs = built[0], dict(built[1])
        require(bool(outputs), "Response: outputs", outputs, "at least one output by name")
        for name, output in outputs.items():
            what = f"Response: the output {name!r}"
            if isinstance(output, Output):
                check_output(scene, output, what)
            else:
                wanted = "an fx_beam.Output, or a function of the solution"
                require(callable(output), what, output, wanted)
        self.names = self.names or list(outputs)
        wanted = f"as in the first call, {self.names}"
        require(list(outputs) == self.names, "Response: outputs", list(outputs), wanted)
        return scene, outputs

    def derivatives(self, x: np.ndarray, numbers_of: NumbersOf) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes."""
        parts = []
        for i, value in enumerate(x):
            found: dict[str, np.ndarray] = {}
            for step, weight in _STEPS.items():
                h = step * (abs(value) or 1.0)
                low, high = (self._numbers(x, i, change, numbers_of) for change in (-h, h))
                for name, last in high.items():
                    found[name] = found.get(name, 0.0) + weight * (last - low[name]) / (2 * h)
            parts.append(found)
        return {name: np.array([part[name] for part in parts]) for name in parts[0]}

    def _numbers(
        self, x: np.ndarray, i: int, change: float, numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Numbers of the scene with a change of x[i]."""
        moved, here = x.copy(), shown(x[i])
        moved[i] += change
        there = shown(moved[i])
        try:
            scene, _ = self.at(moved)
        except SceneError as error:
            raise SceneError(
                f"Response: no derivatives by x[{i}] at {here}, since there is no scene at "
                f"{there}: {error}"
            ) from error
        try:
            return numbers_of(scene, i, change)
        except OtherStructureError as other:
            raise SceneError(
                f"Response: the scene at x[{i}] = {there} has another structure than at {here}: "
                f"{other}. There are no derivatives at {here}"
            ) from None
