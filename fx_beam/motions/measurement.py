"""Outputs read from the present state of a motion, with rates that fit its joints."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.results.state import State
from fx_beam.scene.joints import Joint, NodalMotion
from fx_beam.scene.outputs import Output, definition
from fx_beam.step.forcing import Forcing
from fx_beam.step.measured import measured
from fx_beam.step.model import Model
from fx_beam.step.recorded_histories import driven_increments

from .prepared import Prepared

if TYPE_CHECKING:
    from fx_beam.step.fitted_rates import Fit

Reading = Callable[[], Any]
#: Gives arrays of a state by their names in `State`.
Arrays = Callable[[str], Any]
# Where driven motions are.
_PLACES = "q", "slides"
#: Means over a step, by the parts of a fit that change in it.
_MEANS = {"a": "corrections", "joint_forces": "joints", "constraint_forces": "constraints"}


class Instant:
    """The end of a step, or where steps begin: its rates that fit the joints.

    t is its time [s], `length` that of the step [s], negative for one that starts here. Rates of
    driven motions (driven,) are those that are `known`, or follow from functions of time.
    """

    def __init__(
        self,
        forcing: Forcing,
        t: float,
        length: float,
        arrays: Arrays,
        known: np.ndarray | None = None,
        start: Instant | None = None,
    ):
        self._forcing, self._t, self.length, self._arrays = forcing, t, length, arrays
        self._known, straight = known, forcing.straight
        # Inputs go straight from the start of the step.
        self._inputs = np.full(len(straight), np.nan)
        if start is not None and straight.any():
            ends = (np.array([of(name) for of in (start._arrays, arrays)]) for name in _PLACES)
            self._inputs = driven_increments(forcing.model, *ends)[0] / length

    @cached_property
    def driven(self) -> np.ndarray:
        """Rates (driven,) of driven motions; NaN where they are not known."""
        if self._known is not None or not len(self._inputs):
            return self._inputs if self._known is None else self._known
        ends, lengths = np.array([self._t]), np.array([self.length])
        rates = floats(self._forcing.end_rates(ends, lengths))[0]
        return np.where(self._forcing.straight, self._inputs, rates)

    @cached_property
    def fit(self) -> Fit:
        """Rates that fit the joints, and the impulses that make them fit."""
        from fx_beam.step.fitted_rates import rate_fit

        q, v, slides = (self._arrays(name)[None] for name in ("q", "v", "slides"))
        return rate_fit(self._forcing.model).fit(q, v, slides, self.driven[None])


def fitted_value(name: str, arrays: Arrays, start: Instant | None, end: Instant | None) -> Any:
    """An array of `State` at the end of a step: accelerations and forces are means over it.

    Those of a step without a `start` are as they are, and all if rates of steps fit (no `end`).
    """
    value = arrays(name)
    if end is None:
        return value
    if name == "v":
        return end.fit.rates[0]
    if start is None or value is None or name not in _MEANS:
        return value
    before, after = (getattr(instant.fit, _MEANS[name])[0] for instant in (start, end))
    return value + (after - before) / end.length


def fitted_state(state: State, start: Instant | None, end: Instant | None) -> State:
    """A state with these forces; its rates are those of the steps."""
    if end is None:
        return state
    arrays = functools.partial(getattr, state)
    means = {name: fitted_value(name, arrays, start, end) for name in _MEANS}
    return state.changed(**means, driven_rates=end.driven)


def readings(prepared: Prepared, now: Arrays, outputs: Mapping[str, Output]) -> dict[str, Reading]:
    """Functions that read outputs from arrays, with full turns that are missing in rotations."""
    if any(output.quantity == "force" for output in outputs.values()):
        prepared.stepper.integrator.problem.keep_joint_forces()
    model, turns = prepared.model, prepared.turn_counter.removed
    return {name: _reading(model, now, turns, output) for name, output in outputs.items()}


def _reading(model: Model, now: Arrays, turns: np.ndarray, output: Output) -> Reading:
    defined = definition(output)
    if defined.quantity.is_slide_rate:
        return _rate_of_slide(model, now, defined.of)
    of = measured(model, output)
    array, plus, minus, added = of.array, of.plus, of.minus, of.added
    turning = array == "q" and defined.quantity.column == 2

    def force() -> Any:
        forces = now(array)
        return np.zeros(defined.shape) if forces is None else of.of(forces.reshape(-1))

    def between(values: np.ndarray) -> Any:
        value = 0.0 if plus is None else values[plus]
        return value if minus is None else value - values[minus]

    def motion() -> Any:
        value = between(now(array))
        if turning:
            value = value + between(turns)
        return value if added is None else added + value

    read = force if array.endswith("forces") else motion
    return read if defined.shape else lambda: float(read())


def _rate_of_slide(model: Model, now: Arrays, joint: Joint) -> Reading:
    dofs, number = model.mesh.dofs, joint.number
    at = NodalMotion(
        lambda name, node: now(name)[dofs[node.number]].tolist(),
        lambda name, beam: now(name)[dofs[model.mesh.nodes_of(model.scene, beam)]][None],
    )
    return lambda: joint.kinematics.rate(at, now("slides")[number : number + 1]).item()
