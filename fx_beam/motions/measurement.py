"""Reading of outputs from the present state of a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fx_beam.scene.beam import Node
from fx_beam.scene.joint_kinematics import NodalMotion
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.outputs import Output
from fx_beam.step.model import Model

from .fitted_state import FittedState

Reading = Callable[[], Any]


def reading(model: Model, now: FittedState, turns: np.ndarray, output: Output) -> Reading:
    """A function that reads an output; `turns` (size,) are missing in the rotations [rad]."""
    if isinstance(output.of, Joint):
        read = _of_joint(model, now, turns, output)
    else:
        read = _of_node(model, now, turns, output)
    index = output.index
    return read if index is None else lambda: float(read()[index])


def _of_node(model: Model, now: FittedState, turns: np.ndarray, output: Output) -> Reading:
    assert isinstance(output.of, Node)
    number = output.of.number
    x, y, turn = model.mesh.dofs[number].tolist()
    plane = np.array([x, y])
    if output.quantity == "reaction":
        return _reaction(model, now, number)
    reference = model.mesh.X[number]
    readings: dict[str, Reading] = {
        "position": lambda: reference + now.q[plane],
        "displacement": lambda: now.q[plane],
        "rotation": lambda: float(now.q[turn] + turns[turn]),
        "velocity": lambda: now.v[plane],
        "spin": lambda: float(now.v[turn]),
        "acceleration": lambda: now.a[plane],
    }
    return readings[output.quantity]


def _reaction(model: Model, now: FittedState, number: int) -> Reading:
    nodes, components, columns = model.supports
    own = np.flatnonzero(nodes == number)

    def read():
        force, forces = np.zeros(3), now.constraint_forces
        if forces is not None:
            force[components[own]] = forces[columns[own]]
        return force

    return read


def _of_joint(model: Model, now: FittedState, turns: np.ndarray, output: Output) -> Reading:
    joint = output.of
    assert isinstance(joint, Joint)
    number, dofs, kinematics = joint.number, model.mesh.dofs, joint.kinematics
    a, b = (dofs[n.number].tolist() if n is not GROUND else None for n in (joint.a, joint.b))

    def between(values: np.ndarray, i: int) -> float:
        after = 0.0 if b is None else values[b[i]]
        return float(after if a is None else after - values[a[i]])

    at = NodalMotion(
        lambda name, node: getattr(now, name)[dofs[node.number]].tolist(),
        lambda name, beam: getattr(now, name)[dofs[model.mesh.nodes_of(model.scene, beam)]][None],
    )

    def rate():
        return np.asarray(kinematics.rate(at, now.slides[number : number + 1])).item()

    motors = [j.number for j, _ in model.motors]
    motor = len(model.prescribed) + motors.index(number) if number in motors else -1
    readings: dict[str, Reading] = {
        "angle": lambda: between(now.q, 2) + between(turns, 2),
        "slide": lambda: float(now.slides[number]),
        "spin": lambda: between(now.v, 2),
        "rate": rate,
        "force": lambda: _row(now.joint_forces, number, np.zeros(3)).copy(),
        "motor_force": lambda: float(_row(now.constraint_forces, motor, 0.0)),
    }
    return readings[output.quantity]


def _row(values: np.ndarray | None, i: int, missing):
    """A row of an array, if there is one."""
    return missing if values is None else values[i]
