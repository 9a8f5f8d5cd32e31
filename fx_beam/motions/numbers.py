"""The numbers of a scene that steps read: what differs between scenes of one structure."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.dual import dual_array
from fx_beam.results.state import State
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model

from .initial_state import reference_state
from .prepared import Prepared

#: Numbers that no step reads, but outputs; without beams also the positions of nodes.
OF_OUTPUTS = {
    "X",
    "a",
    "forces of columns",
    "forces of joints",
    "axes of slides",
    "offsets of slides",
    "driven rates",
    "parameters at the start",
    "work at the start",
    "dissipated_energy at the start",
}
#: Numbers with a row for each sub-step: values of functions of time.
OF_STEPS = {"loads", "driven", "follower force", "parameters", "naturals", "driven rates"}
# What steps with mean rates read of the state at the start.
_OF_STATE = "q", "q_previous", "v", "slides", "motors", "internal", "spring_internal", "natural"


def numbers_of(
    prepared: Prepared, state: State, t0: np.ndarray, t1: np.ndarray
) -> dict[str, np.ndarray]:
    """All numbers of a prepared scene by name, its initial state, and functions of time in steps.

    The steps, or sub-steps of the scheme, begin at t0 (n,) and end at t1 (n,) [s].
    """
    model, forcing = prepared.model, prepared.forcing
    followers = model.points.followers
    driven = forcing.series(t1) + _before_motors(model)
    of_steps = {"loads": forcing.loads(t0, t1), "driven": driven}
    if len(parameters := model.forms.parameters):
        of_steps["parameters"] = parameters.over_steps(t0, t1, model.scheme.rates.level)
        of_steps["parameters at the start"] = parameters.at_times(t0[:1])[0]
    if len(followers):
        of_steps["follower force"] = followers.series(t0, t1)
    if model.natural:
        of_steps["naturals"] = forcing.naturals(t1)
    return _arrays(_of_model(model) | of_steps) | numbers_of_state(model, state)


def observed_numbers_of(
    prepared: Prepared, state: State, times: np.ndarray, lengths: np.ndarray, at_start: bool
) -> dict[str, np.ndarray]:
    """What outputs read besides: axes of joints, and rates of driven motions.

    These rates are at `times` (n,), by steps of the `lengths` (n,) that end there [s]. With
    `at_start` also accelerations and forces at the start.
    """
    model = prepared.model
    joints, columns = model.sizes["joints"], model.sizes["constraints"]
    observed: dict[str, Any] = {}
    if at_start:
        observed["a"] = state.a
        observed["forces of columns"] = _or_zeros(state.constraint_forces, (columns,))
        observed["forces of joints"] = _or_zeros(state.joint_forces, (joints, 3))
    axes: list[Any] = [(0.0, 0.0)] * joints
    offsets = axes[:]
    for joint in model.scene.joints:
        if joint.axis is not None:
            axes[joint.number], offsets[joint.number] = joint.axis, joint.offset
    for name, rows in (("axes of slides", axes), ("offsets of slides", offsets)):
        observed[name] = dual_array(rows).reshape(-1, 2)
    if model.fits_rates:
        rates = prepared.forcing.end_rates(times, lengths)
        if state.driven_rates is not None:  # those at the start are of the motion before
            rates = dual_array([state.driven_rates, *rates[1:]])
        observed["driven rates"] = rates
    return _arrays(observed)


def _or_zeros(values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    return np.zeros(shape) if values is None else values


def static_numbers_of(
    model: Model, forcing: LoadForcing, factors: np.ndarray
) -> dict[str, np.ndarray]:
    """The same of a static model from its reference configuration, in steps to load factors."""
    followers, rows, t = model.points.followers, len(factors), np.array([forcing.time])
    loads = np.repeat(model.loads.series(t)[None], 2, axis=1)
    of_steps = {
        "loads": factors[:, None, None] * loads,
        "driven": np.stack([forcing.positions(of) for of in factors]) + _before_motors(model),
    }
    if len(parameters := model.forms.parameters):
        at_time = parameters.over_steps(t, t, 1.0)[0, 0]
        of_steps["parameters"] = np.broadcast_to(at_time, (rows, 2, len(parameters)))
    if len(followers):
        of_steps["follower force"] = np.repeat(followers.series(t, t), rows, axis=0)
    if model.natural:
        of_steps["naturals"] = factors[:, None] * forcing.naturals(t)
    of_state = numbers_of_state(model, reference_state(model))
    return _arrays(_of_model(model) | of_steps) | of_state


def _of_model(model: Model) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "X": model.mesh.nodal_positions(model.scene),
        "columns": model.loads.entries,
        "points": model.points.numbers,
    }
    if (members := model.points.members) is not None:
        numbers |= {"members": members.numbers, "arcs": members.arcs}
    if model.natural:
        numbers["natural columns"] = model.natural.entries
    numbers |= model.masses.numbers()
    if model.forms.beams is not None:
        numbers |= model.forms.beams.numbers
    if moving := model.arm_joints:
        axes = [(0.0, 0.0) if joint.axis is None else joint.axis for joint in moving]
        numbers["offset"] = dual_array([joint.offset for joint in moving]).reshape(-1, 2)
        numbers["axis"] = dual_array(axes).reshape(-1, 2)
        numbers["rest"] = [joint.start()[0] for joint in moving]
    if sliding := model.sliding:
        numbers["places"] = [joint.place_at_rest for joint in sliding]
        numbers["paths"] = np.concatenate([joint.path.numbers for joint in sliding])
    return numbers


def numbers_of_state(model: Model, state: State) -> dict[str, Any]:
    """Those of the state at the start."""
    of_state = {name: getattr(state, name) for name in _OF_STATE}
    of_state["work at the start"] = state.work
    of_state["motors"] = state.motors + _before_motors(model)[len(model.prescribed) :]
    named = {name.replace("_", " "): values for name, values in of_state.items()}
    return _arrays(named | {"dissipated_energy at the start": state.dissipated})


def _before_motors(model: Model) -> np.ndarray:
    """Slides (driven,) in the reference configuration, from which motors go on; 0 for others."""
    of_motors = [joint.start()[0] if name == "slide" else 0.0 for joint, name in model.motors]
    return np.append(np.zeros(len(model.prescribed)), of_motors)


def _arrays(numbers: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: dual_array(values) for name, values in numbers.items() if values is not None}
