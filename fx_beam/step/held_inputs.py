"""Inputs of a scene over a step: loads are held; all others are ramps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, require, vector
from fx_beam.results.state import State
from fx_beam.scene.inputs import (
    InputSignal,
    check_names,
    connected,
    input_slots,
    names_of_values,
    values_of,
    widths,
)
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch

from .forcing import Forcing


class HeldInputs:
    """The inputs of a scene and their present values."""

    def __init__(self, scene: Scene):
        self._watch = Watch(scene)
        #: Number of values of each input, by name.
        self.widths = widths(scene)
        self.names = names_of_values(self.widths)
        #: Present values by name, in arrays that do not change.
        self.values = {name: np.zeros(width) for name, width in self.widths.items()}
        self._parts: dict[int, InputSignal] = {
            id(slot): slot.over_steps(ramps=kind != "load") for slot, kind in input_slots(scene)
        }
        #: The scene with the held functions in the place of its inputs.
        self.scene = connected(scene, lambda slot: self._parts[id(slot)])
        #: All loads and motions that take the values of each input.
        signals = self._parts.values()
        self.parts = {name: [s for s in signals if s.name == name] for name in self.widths}
        self._ramps = [part for part in self._parts.values() if part.ramps]

    def checked(self, inputs: Mapping) -> dict[str, Any]:
        """Values of some inputs.

        SceneError for what is no input or no value of it, and for a scene that has more than at the
        start.
        """
        if self._watch.has_changed:
            raise SceneError(
                "Motion: something was added to the scene since the motion was created, or removed "
                "from it or changed; the motion does not know it. Create another motion, which "
                "goes on: fb.Motion(scene, dt=..., start=motion.state)"
            )
        if type(inputs) is not dict and not isinstance(inputs, Mapping):  # the first is quick
            require(False, "inputs", inputs, f"a dictionary of {list(self.widths)}")
        values: dict[str, Any] = {}
        for name, value in inputs.items():
            if not _fits(value, self.widths.get(name)):
                check_names([name], self.widths, "inputs")
                value = vector(value, self.widths[name], f"input {name!r}")
            values[name] = value
        return values

    def set(self, values: Mapping[str, Any]) -> None:
        """Set some inputs for the next steps."""
        new = dict(self.values)
        for name, value in values.items():
            new[name] = array = np.array(value, float, ndmin=1)
            for part in self.parts[name]:
                part.set(array)
        self.values = new

    def begin(self, t0: float, t1: float) -> None:
        """Set the times of a step [s]."""
        for ramp in self._ramps:
            ramp.begin(t0, t1)

    def arrive(self) -> None:
        """The end of a step."""
        for ramp in self._ramps:
            ramp.start = ramp.end

    def resume(self, forcing: Forcing, state: State) -> None:
        """Start from a state: loads with its values of all inputs, motions where they are."""
        values = values_of(state, self.widths)
        if values is not None and len(values) == sum(self.widths.values()):
            entries = iter(values)
            self.set({name: [next(entries) for _ in range(n)] for name, n in self.widths.items()})
        for function, position in zip(forcing.functions, forcing.current(state), strict=True):
            if isinstance(function, InputSignal):
                self.set({function.name: float(position) / function.scale})
        self.arrive()

    @property
    def all(self) -> np.ndarray | None:
        """Values of all inputs in their order; None without any."""
        return np.concatenate(list(self.values.values())) if self.values else None


def _fits(value, width: int | None) -> bool:
    """Whether a value is one or two finite floats, which is quickly known."""
    if width == 1:
        return isinstance(value, float) and math.isfinite(value)
    if width == 2 and isinstance(value, tuple | list | np.ndarray) and len(value) == 2:
        x, y = value
        floats = isinstance(x, float) and isinstance(y, float)
        return floats and math.isfinite(x) and math.isfinite(y)
    return False
