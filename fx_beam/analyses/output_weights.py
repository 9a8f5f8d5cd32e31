"""From weights of outputs to those of displacements, rates and slides, of which outputs consist."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.outputs import Output

_OF_DISPLACEMENTS = {"position", "displacement", "rotation", "angle"}
_OF_RATES = {"velocity", "spin"}
_TURNING = {"rotation", "angle", "spin"}


def state_weights(
    model: Model, outputs: Mapping[str, Output], weights: Mapping[str, np.ndarray], rows: int
) -> dict[str, np.ndarray]:
    """Weights of "q" and "v" (rows, size) and "slides" (rows, joints) for those of outputs.

    Also of "X" (n_node, 2), the reference positions, which are a part of positions. SceneError for
    an output that is no linear function of them.
    """
    size, joints = model.size, len(model.scene.joints)
    of_state = {name: np.zeros((rows, size)) for name in ("q", "v")}
    of_state |= {"slides": np.zeros((rows, joints)), "X": np.zeros(model.mesh.X.shape)}
    for name, given in weights.items():
        output = outputs[name]
        kind = kind_of(model, output, name)
        if kind == "slides":
            of_state[kind][:, output.of.number] += given  # joints have numbers as well
            continue
        if output.quantity == "position":
            parts = slice(None) if output.index is None else output.index
            of_state["X"][output.of.number, parts] += given.sum(axis=0)
        for dof, part, sign in _entries(model, output):
            of_state[kind][:, dof] += sign * (given if part is None else given[:, part])
    return of_state


def output_derivatives(
    model: Model, output: Output, kind: str, of_state: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivatives (rows, ..., m) of an output of a kind, from those of states.

    These are "q" and "v" (rows, m, size), "slides" (rows, m, joints), and "X" (m, n_node, 2).
    """
    values = of_state[kind]
    if kind == "slides":
        return values[..., output.of.number]
    entries = _entries(model, output)
    parts = {part: np.zeros(values.shape[:2]) for _, part, _ in entries}
    for dof, part, sign in entries:
        parts[part] += sign * values[..., dof]
    if output.quantity == "position":
        for part in parts:
            axis = output.index if part is None else part
            parts[part] += of_state["X"][:, output.of.number, axis]
    return np.stack([*parts.values()], axis=1) if None not in parts else parts[None]


def kind_of(model: Model, output: Output, name: str) -> str:
    """What of the state an output is read from: "q", "v" or "slides"."""
    quantity = output.quantity
    sliding = isinstance(output.of, Joint) and output.of in model.couplings.sliding
    if quantity == "slide":
        return "slides"
    if quantity in _OF_DISPLACEMENTS and not sliding:
        return "q"
    if quantity in _OF_RATES and model.fitted_rates is None:
        return "v"
    advice = "positions, displacements, rotations, angles and slides have"
    if quantity in _OF_RATES and not sliding:
        advice += "; rates have where no joint with an offset, no slide and no motor is"
    raise SceneError(f"the output {name!r}, {output}, has no derivatives: {advice}")


def _entries(model: Model, output: Output) -> list[tuple[int, int | None, float]]:
    """Degrees of freedom of an output, the component of each, and its sign."""
    if isinstance(output.of, Joint):
        ends = ((output.of.b, 1.0), (output.of.a, -1.0))
        return [
            (int(model.mesh.dofs[node.number, 2]), None, sign)
            for node, sign in ends
            if node is not GROUND
        ]
    dofs = model.mesh.dofs[output.of.number].tolist()
    if output.quantity in _TURNING:
        return [(dofs[2], None, 1.0)]
    if output.index is not None:
        return [(dofs[output.index], None, 1.0)]
    return [(dofs[i], i, 1.0) for i in range(2)]
