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

    def __init__(self, mesh: Mesh):
        self._mesh = mesh
        #: Size (size,) of unit increments of degrees of freedom.
        self.nodes = np.full(mesh.dofs.size, mesh.size)
        self.nodes[2::3] = 1.0

    def errors(self, scene: Scene) -> np.ndarray:
        """Sizes (size,) of errors: rotations that displace something are seen as displacements.

        In fast vibrations nodes of beams turn, but are hardly displaced.
        """
        unit = self.nodes.copy()
        unit[self._mesh.turns[~only_turn(scene, self._mesh)]] = np.inf
        return unit

    def unknowns(self, couplings: Couplings) -> np.ndarray:
        """Size of a unit increment of each unknown (free,)."""
        turns = np.arange(self._mesh.dofs.size) % 3 == 2
        unit = np.full(couplings.columns + len(couplings.auxiliaries), self._mesh.size)
        entries = couplings.all_entries
        unit[entries.column[turns[entries.row]]] = 1.0
        for auxiliary in couplings.auxiliaries:
            if turns[auxiliary.dof]:
                unit[[entry[0] for entry in auxiliary.entries]] = 1.0
        return unit[: couplings.free]


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
