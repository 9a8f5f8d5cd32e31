"""Inputs of a scene over a step: loads are held; all others are ramps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError, require, vector
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
from .step_inputs import StepInputs, inputs_of, no_inputs
from .tables import Problem

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


class SingleInputs:
    """Inputs of single steps, one after the other, in arrays that stay.

    Functions of time are evaluated for some steps at once, and inputs of a motion for each one.
    """

    def __init__(self, problem: Problem, forcing: Forcing, dt: float):
        self._problem, self._forcing = problem, forcing
        model, p = forcing.model, problem.c
        sub_steps = p.scheme.sub_steps
        shapes = [(2, p.loads.count), (p.driven,), (len(model.points.followers), 2)]
        shapes += [(2, len(model.forms.parameters)), (len(model.data.natural.starts) - 1,)]
        arrays = [np.zeros((sub_steps, *shape)) for shape in shapes]
        loads, driven, follower_force, parameters, natural = arrays
        self._inputs = StepInputs(
            loads, driven, follower_force, parameters, natural, parts=sub_steps
        )
        ends = np.cumsum(model.scheme.fractions)
        ends[-1] = 1.0
        starts, level = np.append(0.0, ends[:-1]), model.scheme.rates.level
        level_and_end = np.column_stack([starts + level * (ends - starts), ends])
        followers = [load.value for load in model.scene.loads if load.follower]
        data, varying = model.data, enumerate(model.forms.parameters.functions)
        views = [(signal, loads[:, :, columns], ends) for columns, signal in data.loads.functions]
        views += [(signal, follower_force[:, i], ends) for i, signal in enumerate(followers)]
        views += [(signal, driven[:, i], ends) for i, signal in enumerate(forcing.functions)]
        views += [(signal, parameters[:, :, i], level_and_end) for i, signal in varying]
        views += [(signal, natural[:, c.start], ends) for c, signal in data.natural.functions]
        #: Number, start and end [s] of the next step.
        self._next = 0, math.nan, math.nan
        #: Inputs of a motion with their arrays, and the parts of the step that have passed there.
        self._live = [(x, view, passed) for x, view, passed in views if isinstance(x, InputSignal)]
        #: Whether other functions change in time.
        self._varies = any(not (x.is_constant or isinstance(x, InputSignal)) for x, *_ in views)
        if not self._varies:
            self._fill(inputs_of(problem, forcing, 0.0, np.array([dt])), 0)

    def begin(self, grid: Callable[..., Any]) -> None:
        """Begin with step 1 of a grid, which has the ends of steps by their numbers."""
        self._grid = grid
        # Inputs of some steps, and the number of the first one.
        self._known = no_inputs(1), 0

    def next(self, number: int, t0: float, t1: float) -> None:
        """Have a step of the grid from t0 to t1 [s] as the next one."""
        self._next = number, t0, t1

    def ahead(self, t: float, times: np.ndarray) -> StepInputs:
        """Inputs of the next step, in arrays that the one after it overwrites, or of its parts."""
        number, t0, t1 = self._next
        if t != t0 or times[0] != t1:
            return inputs_of(self._problem, self._forcing, t, times)
        if self._varies:
            known, first = self._known
            if (number - first) * known.parts >= len(known.driven):
                ends = self._grid(number + np.arange(_BLOCK))
                known, first = inputs_of(self._problem, self._forcing, t, ends), number
                if known.error is not None and not isinstance(known.error, StepError):
                    raise known.error
                if not len(known.driven):
                    return known
                self._known = known, first
            self._fill(known, number - first)
        for signal, view, passed in self._live:
            if signal.ramps:
                view[...] = signal.start + (signal.end - signal.start) * passed
            else:
                view[...] = signal.end
        return self._inputs

    def _fill(self, inputs: StepInputs, step: int) -> None:
        """Copy the inputs of the sub-steps of one step."""
        sub_steps = slice(step * inputs.parts, (step + 1) * inputs.parts)
        sources = inputs.arrays()
        for name, target in self._inputs.arrays().items():
            if sources[name].size:
                target[...] = sources[name][sub_steps].reshape(target.shape)


def _fits(value, width: int | None) -> bool:
    """Whether a value is one or two finite floats, which is quickly known."""
    if width == 1:
        return isinstance(value, float) and math.isfinite(value)
    if width == 2 and isinstance(value, tuple | list | np.ndarray) and len(value) == 2:
        x, y = value
        floats = isinstance(x, float) and isinstance(y, float)
        return floats and math.isfinite(x) and math.isfinite(y)
    return False
