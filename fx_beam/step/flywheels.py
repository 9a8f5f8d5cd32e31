"""Nodes whose rotation displaces nothing, such as those of flywheels."""

from __future__ import annotations

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.fem.sparsity import connected_parts
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene


def only_turn(scene: Scene, mesh: Mesh) -> np.ndarray:
    """Which nodes (n,) are in no element, and turn together with none that is or lies elsewhere."""
    pairs = np.array(
        [
            (joint.a.number, joint.b.number)
            for joint in scene.joints
            if joint.turns_together and GROUND not in (joint.a, joint.b)
        ],
        dtype=int,
    ).reshape(-1, 2)
    displacing = np.zeros(len(mesh.X), dtype=bool)
    displacing[mesh.elements.ravel()] = True
    geared = {node.number for gear in scene.gears if gear.is_ideal for node in gear.nodes}
    displacing[[number for number in geared if number >= 0]] = True  # which the others follow
    apart = (mesh.X[pairs[:, 0]] != mesh.X[pairs[:, 1]]).any(axis=1)
    displacing[pairs[apart].ravel()] = True
    part = connected_parts(pairs.T, len(displacing))
    return ~np.bincount(part, displacing).astype(bool)[part]
