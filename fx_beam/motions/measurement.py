"""Outputs read from the present state of a motion, with rates that fit its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.dual import without_slopes
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
#: Means over a step, by the parts of a fit that change in it.
_MEANS = {"a": "corrections", "joint_forces": "joints", "constraint_forces": "constraints"}


class _Instant(NamedTuple):
    """The state after some steps."""

    #: Number of steps.
    number: int
    q: np.ndarray
    v: np.ndarray
    slides: np.ndarray
    #: Rates (driven,) of driven inputs, by which they went straight in the step; NaN without one.
    inputs: np.ndarray


class FittedState:
    """The present state; rates, and what depends on them, are found when they are asked for.

    Forces and accelerations of a state that was loaded are those that it has. An interrupt may come
    anywhere: the number of steps of `stepper` says which start belongs to the present state.
    """

    def __init__(self, model: Model, forcing: Forcing, stepper: Any):
        self._model, self._forcing = model, forcing
        self._fits = model.fits_rates
        self._stepper = stepper
        inputs = [function.ramps for function in forcing.functions]
        #: Driven motions that are inputs.
        self._inputs = np.array(inputs, dtype=bool)

    def begin(self, state: State, before: float = 0.0) -> None:
        """Begin at a state that was loaded, after a step of a length [s] if there was one."""
        #: Starts of the last step and of that before; fits by the number of steps to the state.
        self._starts: tuple[_Instant | None, _Instant | None] = None, None
        self._fit_by_step: dict[int, Fit] = {}
        self._first, self._length = state.driven_rates, before

    def leave(self) -> None:
        """A step begins in the present state."""
        if self._fits:
            now = self._present()
            copies = now._replace(q=now.q.copy(), v=now.v.copy(), slides=now.slides.copy())
            self._starts = copies, self._start()

    def state(self) -> State:
        """The present state with these forces; its rates are those of the steps."""
        state = self._stepper.state()
        if not self._fits:
            return state
        means = {name: self._with_change(getattr(state, name), of) for name, of in _MEANS.items()}
        return replace(state, **means, driven_rates=self._driven(self._present()))

    def value(self, name: str) -> Any:
        """An array of `State`: accelerations and forces are means over the step."""
        if name in _MEANS:
            return self._with_change(getattr(self._stepper.present, name), _MEANS[name])
        if name == "v" and self._fits:
            return self._fit().rates[0]
        return getattr(self._stepper.present, name)

    def _with_change(self, mean, name: str):
        """A mean of the step, with the change of a part of the fit over it."""
        if not self._fits or mean is None or (start := self._start()) is None:
            return mean
        before, after = (getattr(self._fit(instant), name)[0] for instant in (start, None))
        return mean + (after - before) / self._stepper.grid.dt

    def _fit(self, instant: _Instant | None = None) -> Fit:
        """Fit of a state, by default of the present one."""
        number = self._stepper.number if instant is None else instant.number
        if (fit := self._fit_by_step.get(number)) is None:
            from fx_beam.step.fitted_rates import rate_fit

            m = self._present() if instant is None else instant
            fit = rate_fit(self._model).fit(
                m.q[None], m.v[None], m.slides[None], self._driven(m)[None]
            )
            last = {k: fit for k, fit in self._fit_by_step.items() if number - 2 < k < number + 2}
            self._fit_by_step = last | {number: fit}
        return fit

    def _start(self) -> _Instant | None:
        """The start of the last step that was taken."""
        before = self._stepper.number - 1
        return next((m for m in self._starts if m is not None and m.number == before), None)

    def _present(self) -> _Instant:
        number, now = self._stepper.number, self._stepper.present
        inputs = np.full(len(self._inputs), np.nan)
        start = self._start() if self._inputs.any() else None
        if start is not None:
            q, slides = np.array([start.q, now.q]), np.array([start.slides, now.slides])
            inputs = driven_increments(self._model, q, slides)[0] / self._stepper.grid.dt
        return _Instant(number, now.q, now.v, now.slides, inputs)

    def _driven(self, instant: _Instant) -> np.ndarray:
        """Rates (driven,) of driven motions; NaN where they are not known."""
        if not len(self._inputs):
            return instant.inputs
        if instant.number == 0 and self._first is not None:
            return self._first
        grid = self._stepper.grid
        length = grid.dt if instant.number else self._length or -grid.dt
        ends, lengths = np.array([grid(instant.number)]), np.array([length])
        rates = without_slopes(self._forcing.end_rates(ends, lengths))[0]
        return np.where(self._inputs, instant.inputs, rates)


def readings(
    prepared: Prepared, now: FittedState, outputs: Mapping[str, Output]
) -> dict[str, Reading]:
    """Functions that read outputs, with the full turns that are missing in rotations."""
    if any(output.quantity == "force" for output in outputs.values()):
        prepared.stepper.integrator.problem.keep_joint_forces()
    model, turns = prepared.model, prepared.turn_counter.removed
    return {name: _reading(model, now, turns, output) for name, output in outputs.items()}


def _reading(model: Model, now: FittedState, turns: np.ndarray, output: Output) -> Reading:
    defined = definition(output)
    if defined.quantity.is_slide_rate:
        return _rate_of_slide(model, now, defined.of)
    of = measured(model, output)
    array, plus, minus, added = of.array, of.plus, of.minus, of.added
    turning = array == "q" and defined.quantity.column == 2

    def force() -> Any:
        forces = now.value(array)
        return np.zeros(defined.shape) if forces is None else of.of(forces.reshape(-1))

    def between(values: np.ndarray) -> Any:
        value = 0.0 if plus is None else values[plus]
        return value if minus is None else value - values[minus]

    def motion() -> Any:
        value = between(now.value(array))
        if turning:
            value = value + between(turns)
        return value if added is None else added + value

    read = force if array.endswith("forces") else motion
    return read if defined.shape else lambda: float(read())


def _rate_of_slide(model: Model, now: FittedState, joint: Joint) -> Reading:
    dofs, number = model.mesh.dofs, joint.number
    at = NodalMotion(
        lambda name, node: now.value(name)[dofs[node.number]].tolist(),
        lambda name, beam: now.value(name)[dofs[model.mesh.nodes_of(model.scene, beam)]][None],
    )
    return lambda: joint.kinematics.rate(at, now.value("slides")[number : number + 1]).item()
