"""Inputs of time steps: loads, driven motions and the like, evaluated for many at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.laws.interval import divided

from .forcing import Forcing
from .tables import ProblemInC

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
