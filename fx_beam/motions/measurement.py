"""Reading of outputs from the present state of a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fx_beam.scene.joint_kinematics import NodalMotion
from fx_beam.scene.outputs import Output, definition
from fx_beam.scene.quantities import Defined
from fx_beam.step.measured import measured
from fx_beam.step.model import Model

from .fitted_state import FittedState

Reading = Callable[[], Any]


def reading(model: Model, now: FittedState, turns: np.ndarray, output: Output) -> Reading:
    """A function that reads an output; `turns` (size,) are missing in the rotations [rad]."""
    defined = definition(output)
    if defined.quantity.law is not None:
        return _by_law(model, now, defined)
    of, single = measured(model, output), not defined.shape
    array, plus, minus, added = of.array, of.plus, of.minus, of.added
    turning = array == "q" and defined.quantity.column == 2

    def force() -> Any:
        forces = getattr(now, array)
        if forces is None:
            return 0.0 if single else np.zeros(len(plus))
        value = of.of(forces.reshape(-1))
        return float(value) if single else value

    def between(values: np.ndarray) -> Any:
        value = 0.0 if plus is None else values[plus]
        return value if minus is None else value - values[minus]

    def number() -> float:
        value = between(getattr(now, array))
        if turning:
            value = value + between(turns)
        return float(value if added is None else added + value)

    def components() -> np.ndarray:
        value = getattr(now, array)[plus]
        return value if added is None else added + value

    if array.endswith("forces"):
        return force
    return number if single else components


def _by_law(model: Model, now: FittedState, of: Defined) -> Reading:
    dofs, number = model.mesh.dofs, of.number
    at = NodalMotion(
        lambda name, node: getattr(now, name)[dofs[node.number]].tolist(),
        lambda name, beam: getattr(now, name)[dofs[model.mesh.nodes_of(model.scene, beam)]][None],
    )
    single = not of.shape

    def read() -> Any:
        value = np.asarray(of.by_law(at, now.slides[number : number + 1]))
        return value.item() if single else value

    return read
