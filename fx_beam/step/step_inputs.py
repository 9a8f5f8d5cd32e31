"""Inputs of time steps: loads and driven motions for many at once, and those that are held."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError, StepError, require, vector
from fx_beam.laws.interval import divided
from fx_beam.results.state import State
from fx_beam.scene import functions
from fx_beam.scene.functions import InputSignal, Signal, connected, input_slots, values_of, widths
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import Watch

from .forcing import Forcing
from .tables import ProblemInC

# -- Inputs of time steps: loads, driven motions and the like, evaluated for many at once -------


# Inputs of which a single row may stand for all sub-steps.
_REPEATED = "loads", "follower_force", "natural"
_ARRAYS = "loads", "driven", "follower_force", "parameters", "natural"


@dataclass(eq=False)
class StepInputs:
    """Loads, driven motions and the like of sub-steps, and what ended them."""

    loads: np.ndarray
    driven: np.ndarray
    follower_force: np.ndarray
    #: Values (sub-steps, 2, n) at the scheme's level and at the end; (..., 0) if none varies.
    parameters: np.ndarray
    #: Natural strains (sub-steps, n) at the end; (..., 0) if they are set apart.
    natural: np.ndarray
    #: Sub-steps of a step.
    parts: int
    error: BaseException | None = None
    #: In statics the load factor at the end.
    ratio: float = 0.0
    _c: Any = field(default=None, init=False)

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.driven) // self.parts

    @property
    def ends_of_driven(self) -> np.ndarray:
        """Driven motions (steps, driven) at the ends of steps."""
        return self.driven[self.parts - 1 :: self.parts]

    def arrays(self) -> dict[str, Any]:
        """All rows by name."""
        return {name: getattr(self, name) for name in _ARRAYS}

    def after(self, steps: int) -> StepInputs:
        """The inputs of the steps after some."""
        first = steps * self.parts
        return replace(self, **{name: rows[first:] for name, rows in self.arrays().items()})

    def of_step(self, step: int) -> StepInputs:
        """The inputs of a single step, from 0 on."""
        rows = slice(step * self.parts, (step + 1) * self.parts)
        arrays = {name: array[rows] for name, array in self.arrays().items()}
        return StepInputs(parts=self.parts, **arrays)

    def in_c(self, ffi: Any) -> Any:
        """The struct ``Inputs``, which reads the arrays as long as they are kept."""
        if self._c is not None:
            return self._c
        self._c = inputs = ffi.new("Inputs *")
        inputs.ratio = self.ratio
        for name, rows in self.arrays().items():
            if rows.size:
                # The first row is contiguous, also where it stands for all.
                setattr(inputs, name, ffi.from_buffer("double[]", rows[:1]))
                if name in _REPEATED:
                    setattr(inputs, f"{name}_stride", rows.strides[0] // rows.itemsize)
        return inputs


class StepBlock(NamedTuple):
    """Steps that C takes at once, from which they can be repeated."""

    number: int
    dt: float
    #: Parts of a halved step, and those of the first step that were taken before.
    parts: int
    part: int
    inputs: StepInputs
    #: Starts of the steps or parts, and the end of the last [s], as in their inputs.
    times: np.ndarray


def no_inputs(parts: int, steps: int = 0) -> StepInputs:
    """Inputs of steps without any."""
    none, pairs = np.empty((steps * parts, 0)), np.empty((steps * parts, 2, 0))
    return StepInputs(pairs, none, none, pairs, none, parts)


def inputs_of(problem: ProblemInC, forcing: Forcing, t: float, times: np.ndarray) -> StepInputs:
    """Inputs of steps from t to `times` [s]; if a function of time fails, of those before."""
    p, model = problem.c.tables, forcing.model
    inputs = no_inputs(p.scheme.sub_steps, len(times))
    acts = p.loads.count or p.driven or p.loads.follower_forces
    if not (acts or p.parameters.vary or p.natural.count):
        return inputs
    starts = np.concatenate([[t], times[:-1]])
    t0, t1 = divided(starts, times, model.scheme.fractions)
    follow, parameters, strains = model.points.followers, model.forms.parameters, model.data.natural

    def rows(series: Callable[..., Any], constant: bool, *ends: np.ndarray) -> np.ndarray:
        """Rows of all sub-steps; a single row is repeated without copies."""
        values = series(*(end[: 1 if constant else None] for end in ends))
        values = np.ascontiguousarray(floats(values))
        return np.broadcast_to(values, (len(t1), *values.shape[1:])) if constant else values

    try:
        arrays: dict[str, Any] = {}
        if p.loads.count:
            arrays["loads"] = rows(forcing.loads, model.data.loads.constant, t0, t1)
        if follow:
            arrays["follower_force"] = rows(follow.series, follow.constant, t0, t1)
        if parameters.vary:
            level = model.scheme.rates.level
            arrays["parameters"] = floats(parameters.signals.over_steps(t0, t1, level))
        if strains:
            arrays["natural"] = rows(forcing.naturals, strains.constant, t1)
        return replace(inputs, driven=floats(forcing.series(t1)), **arrays)
    except BaseException as raised:
        steps_before = int(np.searchsorted(times, getattr(raised, "time", t)))
        if steps_before:
            inputs = inputs_of(problem, forcing, t, times[:steps_before])
        else:
            inputs = no_inputs(p.scheme.sub_steps)
        return replace(inputs, error=inputs.error or raised)


# -- Inputs of a scene over a step: loads are held; all others are ramps ------------------------


# Steps whose functions of time are evaluated at once.
_BLOCK = 64


class HeldInputs:
    """The inputs of a scene and their present values."""

    def __init__(self, scene: Scene):
        self._watch = Watch(scene)
        #: Number of values of each input, by name.
        self.widths = widths(scene)
        self.names = functions.names_of_values(self.widths)
        #: Present values by name, in arrays that do not change.
        self.values = functions.unset_values(scene)
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
                functions.check_names([name], self.widths, "inputs")
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
