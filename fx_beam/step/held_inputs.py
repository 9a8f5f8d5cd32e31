"""Inputs of a scene over a step: loads are held; all others are ramps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError, require, vector
from fx_beam.results.state import State
from fx_beam.scene.functions import Signal
from fx_beam.scene.inputs import (
    InputSignal,
    check_names,
    connected,
    input_slots,
    names_of_values,
    unset_values,
    values_of,
    widths,
)
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch

from .forcing import Forcing
from .step_inputs import StepInputs, inputs_of, no_inputs
from .tables import ProblemInC

# Steps whose functions of time are evaluated at once.
_BLOCK = 64


class HeldInputs:
    """The inputs of a scene and their present values."""

    def __init__(self, scene: Scene):
        self._watch = Watch(scene)
        #: Number of values of each input, by name.
        self.widths = widths(scene)
        self.names = names_of_values(self.widths)
        #: Present values by name, in arrays that do not change.
        self.values = unset_values(scene)
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

    def set_times(self, t0: float, t1: float) -> None:
        """Set the times of a step [s]."""
        for ramp in self._ramps:
            ramp.set_times(t0, t1)

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


class SingleInputs:
    """Inputs of single steps, one after the other.

    Functions of time are evaluated for some steps at once, and inputs of a motion for each one.
    """

    def __init__(self, problem: ProblemInC, forcing: Forcing):
        self._problem, self._forcing = problem, forcing
        model, data, none = forcing.model, forcing.model.data, slice(None)
        ends = np.cumsum(model.scheme.fractions)
        ends[-1] = 1.0
        starts, level = np.append(0.0, ends[:-1]), model.scheme.rates.level
        level_and_end = np.column_stack([starts + level * (ends - starts), ends])
        followers = [load.value for load in model.scene.loads if load.follower]
        places: list[tuple[Signal, str, Any, np.ndarray]] = []
        places += [(x, "loads", (none, none, at), ends) for at, x in data.loads.functions]
        places += [(x, "follower_force", (none, i), ends) for i, x in enumerate(followers)]
        places += [(x, "driven", (none, i), ends) for i, x in enumerate(forcing.functions)]
        for i, x in enumerate(model.forms.parameters.functions):
            places.append((x, "parameters", (none, none, i), level_and_end))
        places += [(x, "natural", (none, at.start), ends) for at, x in data.natural.functions]
        #: Inputs of a motion, each with the array of `StepInputs` that has its values, their place
        #: in it, and the parts of a step that have passed at them.
        self._live = [(x, *others) for x, *others in places if isinstance(x, InputSignal)]
        #: Whether other functions change in time.
        self._varies = any(not (x.is_constant or isinstance(x, InputSignal)) for x, *_ in places)
        #: Number, start and end [s] of the next step.
        self._next = 0, math.nan, math.nan

    def start_grid(self, grid: Callable[..., Any]) -> None:
        """Begin with step 1 of a grid, which has the ends of steps by their numbers."""
        self._grid = grid
        # Inputs of some steps, and the number of the first one.
        self._known = no_inputs(1), 0

    def next(self, number: int, t0: float, t1: float) -> None:
        """Have a step of the grid from t0 to t1 [s] as the next one."""
        self._next = number, t0, t1

    def ahead(self, t: float, times: np.ndarray) -> StepInputs:
        """Inputs of the next step, as they are now, or of its parts."""
        number, t0, t1 = self._next
        if t != t0 or times[0] != t1:
            return inputs_of(self._problem, self._forcing, t, times)
        known, first = self._known
        step = number - first if self._varies else 0
        if step >= known.steps:
            ends = self._grid(number + np.arange(_BLOCK if self._varies else 1))
            known, step = inputs_of(self._problem, self._forcing, t, ends), 0
            if known.error is not None and not isinstance(known.error, StepError):
                raise known.error
            if not known.steps:
                return known
            self._known = known, number
        inputs = known.of_step(step) if self._varies else known
        for signal, name, at, passed in self._live:
            rows = getattr(inputs, name)
            if signal.ramps:
                rows[at] = signal.start + (signal.end - signal.start) * passed
            else:
                rows[at] = signal.end
        return inputs


def _fits(value, width: int | None) -> bool:
    """Whether a value is one or two finite floats, which is quickly known."""
    if width == 1:
        return isinstance(value, float) and math.isfinite(value)
    if width == 2 and isinstance(value, tuple | list | np.ndarray) and len(value) == 2:
        x, y = value
        floats = isinstance(x, float) and isinstance(y, float)
        return floats and math.isfinite(x) and math.isfinite(y)
    return False
