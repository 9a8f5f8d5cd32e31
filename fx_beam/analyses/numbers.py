"""The numbers of a scene that steps read: what differs between scenes of one structure."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.model.model import Model
from fx_beam.results.state import State
from fx_beam.scene.constraints import joints_by_number
from fx_beam.stepping.forcing import LoadForcing
from fx_beam.stepping.initial_state import reference_state

from .run_setup import RunSetup

# What steps with mean rates read of the state at the start.
_OF_STATE = "q", "v", "slides", "motors", "internal", "spring_internal"


def numbers_of(
    setup: RunSetup, state: State, t0: np.ndarray, t1: np.ndarray
) -> dict[str, np.ndarray]:
    """All numbers of a set-up by name, of its initial state, and of functions of time in steps.

    The steps, or sub-steps of the scheme, begin at t0 (n,) and end at t1 (n,) [s].
    """
    model, forcing = setup.model, setup.forcing
    followers = model.points.followers
    of_steps = {"loads": forcing.loads(t0, t1), "driven": forcing.series(t1)}
    if len(parameters := model.forms.parameters):
        of_steps["parameters"] = parameters.over_steps(t0, t1, model.scheme.rates.level)
    if len(followers):
        of_steps["thrust"] = followers.series(t0, t1)
    return _arrays(_of_model(model) | of_steps | _of_state(state))


def static_numbers_of(
    model: Model, forcing: LoadForcing, factors: np.ndarray
) -> dict[str, np.ndarray]:
    """The same of a static model from its reference configuration, in steps to load factors."""
    followers, rows, t = model.points.followers, len(factors), np.array([forcing.time])
    loads = np.repeat(model.loads.series(t)[None], 2, axis=1)
    of_steps = {
        "loads": factors[:, None, None] * loads,
        "driven": np.array([forcing.positions(factor) for factor in factors]),
    }
    if len(parameters := model.forms.parameters):
        of_steps["parameters"] = np.broadcast_to(
            parameters.at(forcing.time), (rows, 2, len(parameters))
        )
    if len(followers):
        of_steps["thrust"] = np.repeat(followers.series(t, t), rows, axis=0)
    return _arrays(_of_model(model) | of_steps | _of_state(reference_state(model)))


def _of_model(model: Model) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "X": model.mesh.X,
        "mass": model.mass.data,
        "columns": model.loads.columns.data,
        "points": model.points.numbers,
    }
    if model.weight is not None:
        numbers["weight"] = model.weight
    if model.forms.beams is not None:
        numbers |= model.forms.beams.numbers
    if isinstance(model.reduction, JointReduction):
        joints = model.reduction.joint_tables()
        numbers |= {name: joints[name] for name in ("offset", "axis")}
        own = joints_by_number(model.scene)
        numbers["rest"] = [own[joint.number].start()[0] for joint in model.couplings.moving]
    return numbers


def _of_state(state: State) -> dict[str, Any]:
    of_state = {name: getattr(state, name) for name in _OF_STATE}
    return {
        name.replace("_", " "): values for name, values in of_state.items() if values is not None
    }


def _arrays(numbers: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: np.array(values, float) for name, values in numbers.items()}
