"""Full turns of members, counted separately to limit the rounding errors of rotations."""

from __future__ import annotations

import math

import numpy as np

from fx_beam.fem.mesh import connected_parts
from fx_beam.results.state import State
from fx_beam.scene.joints import GROUND

from .model import Model, fact, turning_together

_ROTATION = 2  # among the components of a node
#: Steps after which full turns are counted.
STEPS = 1000


class TurnCounter:
    """Full turns that were subtracted from the rotations of a state.

    Without this, rounding errors grow with the turns: they are 1e-12 at a rotation of 5000 rad.
    """

    def __init__(self, model: Model):
        self._members = fact(model, _members)
        #: Rotations (size,) subtracted so far [rad], in an array that does not change.
        self.removed = np.zeros(model.size)

    def turns_of(self, q: np.ndarray) -> np.ndarray:
        """Full turns (size,) [rad] of a configuration, where they do not affect the equations."""
        turns = np.zeros_like(self.removed)
        for member in self._members:
            mean = float(np.add.reduce(q[member])) / len(member)
            if number := round(mean / (2 * math.pi)):
                turns[member] = 2 * math.pi * number
        return turns

    @staticmethod
    def without(turns: np.ndarray, state: State) -> State:
        """The state without turns."""
        q_previous = None if state.q_previous is None else state.q_previous - turns
        return state.changed(q=state.q - turns, q_previous=q_previous)

    def with_turns(self, state: State) -> State:
        """The state with the turns that were subtracted."""
        return self.without(-self.removed, state)


def without_turns(model: Model, D: np.ndarray) -> np.ndarray:
    """Increments (..., size) without full turns of rotations."""
    D = D.copy()
    D[..., model.mesh.turns] -= 2 * np.pi * np.round(D[..., model.mesh.turns] / (2 * np.pi))
    return D


def _members(model: Model) -> list[np.ndarray]:
    """Rotations of groups of nodes that turn together, if full turns have no effect on them."""
    scene, mesh = model.scene, model.mesh
    if scene.virtual_works:
        return []  # their expressions may depend on full turns
    ends = turning_together(scene)
    apart = (ends >= 0).all(axis=1)
    pairs = [ends[apart], *(np.stack([nodes[:-1], nodes[1:]], axis=1) for nodes in mesh.nodes)]
    counted = {node for node, part in {*scene.fixed, *scene.prescribed} if part == _ROTATION}
    counted |= {*ends[~apart].ravel().tolist()}
    for joint in scene.joints:
        rotation = joint.rotation
        if rotation is not None and (rotation.acts or rotation.motor):
            counted |= {joint.a.number, joint.b.number}
    counted |= {node.number for gear in scene.gears for node in gear.nodes}
    counted |= {node for f in scene.forces_between for node, _ in getattr(f, "drums", ())}
    counted.discard(GROUND.number)
    group_numbers = connected_parts(np.concatenate(pairs).T, len(mesh.X))
    order = np.argsort(group_numbers, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(group_numbers))[:-1])
    counted_groups = set(group_numbers[list(counted)])
    return [3 * nodes + _ROTATION for i, nodes in enumerate(groups) if i not in counted_groups]
