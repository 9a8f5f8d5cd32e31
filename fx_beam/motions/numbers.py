"""The numbers of a scene that steps read, with those of its state and of functions of time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from fx_beam.dual import MaybeDual, dual_array
from fx_beam.fem.scene_data import SceneArrays
from fx_beam.results.state import State
from fx_beam.step.forcing import Forcing
from fx_beam.step.model import Model, fact, numbers_of, sizes_of

from .initial_state import reference_state

#: Numbers that no step reads, but outputs; without beams also the positions of nodes.
OF_OUTPUTS = {
    "X",
    "a",
    "forces of columns",
    "forces of joints",
    "forces of lines",
    "driven rates",
    "parameters at the start",
    "amplitudes of the load",
    "work at the start",
    "dissipated_energy at the start",
}
#: Names of numbers of one output have this between what they are and its name.
OF_OUTPUT = " of the output "
#: Numbers with a row for each sub-step: values of functions of time.
OF_STEPS = {"loads", "driven", "follower force", "parameters", "naturals", "driven rates"}
# What steps with mean rates read of the state at the start.
_OF_STATE = "q", "q_previous", "v", "slides", "motors", "internal", "spring_internal", "natural"


def numbers_in_steps(
    model: Model, data: SceneArrays, state: State, t0: np.ndarray, t1: np.ndarray
) -> dict[str, MaybeDual]:
    """All numbers of a scene by name, its initial state, and functions of time in steps.

    The steps, or sub-steps of the scheme, begin at t0 (n,) and end at t1 (n,) [s].
    """
    forcing, (parameters, *_), followers = Forcing(model, data), data.forms, data.forms.followers
    step_numbers = {"loads": forcing.loads(t0, t1)}
    step_numbers["driven"] = forcing.series(t1) + data.before_motors
    if parameters.names:
        step_numbers["parameters"] = parameters.over_steps(t0, t1, model.scheme.rates.level)
        step_numbers["parameters at the start"] = parameters.series(t0[:1])[0]
    if len(followers):
        step_numbers["follower force"] = followers.series(t0, t1)
    if data.natural:
        step_numbers["naturals"] = forcing.naturals(t1)
    return numbers_of(model, data) | _arrays(step_numbers) | numbers_of_state(data, state)


def observed_numbers_of(
    model: Model,
    data: SceneArrays,
    state: State,
    times: np.ndarray,
    lengths: np.ndarray,
    at_start: bool,
) -> dict[str, MaybeDual]:
    """Numbers that only outputs read: rates of driven motions.

    They are at `times` (n,), by steps of the `lengths` (n,) that end there [s]. With
    `at_start` also accelerations and forces at the start.
    """
    sizes = fact(model, sizes_of)
    joints, columns = sizes["joints"], sizes["constraints"]
    observed: dict[str, Any] = {}
    if at_start:
        observed["a"] = state.a
        observed["forces of columns"] = _or_zeros(state.constraint_forces, (columns,))
        observed["forces of joints"] = _or_zeros(state.joint_forces, (joints, 3))
        if state.line_forces is None:
            observed["forces of lines"] = np.zeros(sizes["lines"])
    if model.fits_rates:
        rates = Forcing(model, data).end_rates(times, lengths)
        if state.driven_rates is not None:  # those at the start are of the motion before
            rates = dual_array([state.driven_rates, *rates[1:]])
        observed["driven rates"] = rates
    return _arrays(observed)


def are_of_outputs(names: Iterable[str]) -> bool:
    """Whether no step reads numbers of some names, but outputs."""
    return all(name in OF_OUTPUTS or OF_OUTPUT in name for name in names)


def _or_zeros(values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    return np.zeros(shape) if values is None else values


def static_numbers_of(
    model: Model, data: SceneArrays, time: float, factors: np.ndarray
) -> dict[str, MaybeDual]:
    """All numbers from the reference configuration, in steps to load factors at a time [s]."""
    forcing, (parameters, *_), followers = Forcing(model, data), data.forms, data.forms.followers
    rows, t = len(factors), np.array([time])
    goal = forcing.series(t)[0]
    step_numbers = {
        "loads": factors[:, None, None] * np.repeat(data.loads.series(t)[None], 2, axis=1),
        "driven": np.stack([factor * goal for factor in factors]) + data.before_motors,
    }
    if parameters.names:
        values = parameters.over_steps(t, t, 1.0)[0, 0]
        step_numbers["parameters"] = np.broadcast_to(values, (rows, 2, len(parameters.names)))
    if len(followers):
        step_numbers["follower force"] = np.repeat(followers.series(t, t), rows, axis=0)
    if data.natural:
        step_numbers["naturals"] = factors[:, None] * forcing.naturals(t)
    state_numbers = numbers_of_state(data, reference_state(model, data.scene))
    return numbers_of(model, data) | _arrays(step_numbers) | state_numbers


def numbers_of_state(data: SceneArrays, state: State) -> dict[str, Any]:
    """Numbers of the state at the start, by name."""
    state_numbers = {name: getattr(state, name) for name in _OF_STATE}
    state_numbers["work at the start"] = state.work
    state_numbers["motors"] = state.motors + data.before_motors[len(data.scene.prescribed) :]
    named = {name.replace("_", " "): values for name, values in state_numbers.items()}
    named |= {"dissipated_energy at the start": state.dissipated}
    return _arrays(named | {"forces of lines": state.line_forces})


def _arrays(numbers: dict[str, Any]) -> dict[str, MaybeDual]:
    return {name: dual_array(values) for name, values in numbers.items() if values is not None}
