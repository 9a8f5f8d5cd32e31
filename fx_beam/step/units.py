"""Sizes of unit increments: of nodes, of their errors, and of unknowns."""

from __future__ import annotations

import numpy as np

from fx_beam.coupling.graph import Couplings
from fx_beam.fem.mesh import Mesh
from fx_beam.fem.sparsity import connected_parts
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene


class Units:
    """Unit increments: the size of a mesh for displacements, 1 for rotations."""

    def __init__(self, mesh: Mesh, couplings: Couplings):
        self._mesh = mesh
        #: Sizes (size,) of unit increments of degrees of freedom.
        self.nodes = np.full(mesh.dofs.size, mesh.size)
        self.nodes[2::3] = 1.0
        turns = np.zeros(couplings.columns + len(couplings.auxiliaries), dtype=bool)
        entries = couplings.all_entries
        turns[entries.column[entries.row % 3 == 2]] = True
        for auxiliary in couplings.auxiliaries:
            if auxiliary.dof % 3 == 2:
                turns[[entry[0] for entry in auxiliary.entries]] = True
        #: Which unknowns (free,) are rotations, and sizes (free,) of their unit increments.
        self.turns = turns[: couplings.free]
        self.unknowns = np.where(self.turns, 1.0, mesh.size)

    def errors(self, scene: Scene) -> np.ndarray:
        """Sizes (size,) of errors: rotations that displace something are seen as displacements.

        In fast vibrations nodes of beams turn, but are hardly displaced.
        """
        unit = self.nodes.copy()
        unit[self._mesh.turns[~only_turn(scene, self._mesh)]] = np.inf
        return unit


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
