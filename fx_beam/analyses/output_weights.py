"""From weights of outputs to those of displacements, rates and slides, of which outputs consist."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene

from .energy_gradients import check_energy, energy_gradient

_OF_DISPLACEMENTS = {"position", "displacement", "rotation", "angle"}
_OF_RATES = {"velocity", "spin"}
_TURNING = {"rotation", "angle", "spin"}


#: Displacements and rotations q, and rates v, each (rows, size).
States = tuple[np.ndarray, np.ndarray]


def state_weights(
    model: Model, outputs: Mapping[str, Output], weights: Mapping[str, np.ndarray], states: States
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Weights of "q" and "v" (rows, size) and "slides" (rows, joints) for those of outputs.

    Also the derivatives by numbers of the scene, by name, that outputs have at given states, as
    "X" (n_node, 2) of positions. SceneError for an output that is no function of them.
    """
    of_state = {name: np.zeros_like(states[0]) for name in ("q", "v")}
    of_state["slides"] = np.zeros((len(states[0]), model.scene.joint_count))
    direct = {"X": np.zeros(model.mesh.X.shape)}
    for name, given in weights.items():
        output = outputs[name]
        kind = kind_of(model, output, name)
        if isinstance(output.of, Scene):
            for k in np.flatnonzero(given):
                by_state, by_numbers = energy_gradient(model, output, *(rows[k] for rows in states))
                for which, own in by_state.items():
                    of_state[which][k] += given[k] * own
                for which, own in by_numbers.items():
                    direct[which] = direct.get(which, 0.0) + given[k] * own
            continue
        if kind == "slides":
            of_state[kind][:, output.of.number] += given  # joints have numbers as well
            continue
        if output.quantity == "position":
            parts = slice(None) if output.index is None else output.index
            direct["X"][output.of.number, parts] += given.sum(axis=0)
        for dof, part, sign in _entries(model, output):
            of_state[kind][:, dof] += sign * (given if part is None else given[:, part])
    return of_state, direct


def output_derivatives(
    model: Model,
    output: Output,
    kind: str,
    of_state: Mapping[str, np.ndarray],
    changes: Mapping[str, np.ndarray],
    states: States,
) -> np.ndarray:
    """Derivatives (rows, ..., m) of an output of a kind at some states.

    From those of states, "q" and "v" (rows, m, size) and "slides" (rows, m, joints), and from those
    (m, ...) of the numbers of the scene, such as "X".
    """
    if isinstance(output.of, Scene):
        return _energy_derivatives(model, output, of_state, changes, states)
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
            parts[part] += changes["X"][:, output.of.number, axis]
    return np.stack([*parts.values()], axis=1) if None not in parts else parts[None]


def kind_of(model: Model, output: Output, name: str) -> str:
    """What of the state an output is read from: "q", "v" or "slides"; "energy" of several."""
    if isinstance(output.of, Scene):
        check_energy(model, output, name)
        return "energy"
    quantity = output.quantity
    sliding = isinstance(output.of, Joint) and output.of in model.couplings.sliding
    if quantity == "slide":
        return "slides"
    if quantity in _OF_DISPLACEMENTS and not sliding:
        return "q"
    if quantity in _OF_RATES and model.fitted_rates is None:
        return "v"
    advice = "positions, displacements, rotations, angles, slides and energies have"
    if quantity in _OF_RATES and not sliding:
        advice += "; rates have where no joint with an offset, no slide and no motor is"
    raise SceneError(f"the output {name!r}, {output}, has no derivatives: {advice}")


def _energy_derivatives(
    model: Model,
    output: Output,
    of_state: Mapping[str, np.ndarray],
    changes: Mapping[str, np.ndarray],
    states: States,
) -> np.ndarray:
    rows = []
    for k, state in enumerate(zip(*states, strict=True)):
        by_state, by_numbers = energy_gradient(model, output, *state)
        parts = [of_state[name][k] @ own for name, own in by_state.items()]
        parts += [_along(changes[name], own) for name, own in by_numbers.items()]
        rows.append(sum(parts, np.zeros(len(changes["X"]))))
    return np.array(rows)


def _along(changes: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Products (m,) of changes (m, ...) and a gradient."""
    return changes.reshape(len(changes), -1) @ np.ravel(gradient)


def _entries(model: Model, output: Output) -> list[tuple[int, int | None, float]]:
    """Degrees of freedom of an output, the component of each, and its sign."""
    if isinstance(output.of, Joint):
        ends = ((output.of.b, 1.0), (output.of.a, -1.0))
        return [
            (int(model.mesh.dofs[node.number, 2]), None, sign)
            for node, sign in ends
            if node is not GROUND
        ]
    assert isinstance(output.of, Node)  # energies have none
    dofs = model.mesh.dofs[output.of.number].tolist()
    if output.quantity in _TURNING:
        return [(dofs[2], None, 1.0)]
    if output.index is not None:
        return [(dofs[output.index], None, 1.0)]
    return [(dofs[i], i, 1.0) for i in range(2)]
