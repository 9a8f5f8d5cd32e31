"""The numbers of a scene that steps read: what differs between scenes of one structure."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.results.state import State

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
    numbers: dict[str, Any] = {
        "X": model.mesh.X,
        "mass": model.mass.data,
        "columns": model.loads.columns.data,
        "points": model.points.numbers,
        "loads": forcing.loads(t0, t1),
        "driven": forcing.series(t1),
    }
    if len(parameters := model.forms.parameters):
        numbers["parameters"] = parameters.over_steps(t0, t1, model.scheme.rates.level)
    if len(followers):
        numbers["thrust"] = followers.series(t0, t1)
    if model.weight is not None:
        numbers["weight"] = model.weight
    if model.forms.beams is not None:
        numbers |= model.forms.beams.numbers
    if isinstance(model.reduction, JointReduction):
        joints = model.reduction.joint_tables()
        numbers |= {name: joints[name] for name in ("offset", "axis")}
        own = model.scene.joint_by_number
        numbers["rest"] = [own[joint.number].start()[0] for joint in model.couplings.moving]
    of_state = {name: getattr(state, name) for name in _OF_STATE}
    numbers |= {
        name.replace("_", " "): values for name, values in of_state.items() if values is not None
    }
    return {name: np.array(values, float) for name, values in numbers.items()}
