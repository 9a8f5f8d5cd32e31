"""Sizes of unit increments, how easily they move, and little masses of what has none."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.coupling.graph import Couplings
from fx_beam.coupling.reduction import Reduction
from fx_beam.fem.mass import about_centres, mobilities
from fx_beam.fem.mesh import Mesh
from fx_beam.fem.scene_data import SceneArrays
from fx_beam.fem.sparsity import connected_parts
from fx_beam.scene.joints import GROUND, slides_at_start
from fx_beam.scene.scene import Scene

# Mass of what has none in rates that fit joints, relative to the least mass that there is.
_LITTLE = 1e-8
# Degrees of freedom up to which a coupling is an array.
_SMALL = 200


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


def turning_together(scene: Scene) -> np.ndarray:
    """Pairs (n, 2) of nodes that joints let turn together only; -1 is the ground."""
    pairs = [(joint.a.number, joint.b.number) for joint in scene.joints if joint.turns_together]
    return np.reshape(pairs, (-1, 2)).astype(int)


def only_turn(scene: Scene, mesh: Mesh) -> np.ndarray:
    """Which nodes (n,) are in no element, and turn together with none that is or lies elsewhere."""
    pairs = turning_together(scene)
    pairs = pairs[(pairs >= 0).all(axis=1)]
    displacing = np.zeros(len(mesh.X), dtype=bool)
    displacing[mesh.elements.ravel()] = True
    geared = {node.number for gear in scene.gears if gear.is_ideal for node in gear.nodes}
    displacing[[number for number in geared if number >= 0]] = True  # which the others follow
    apart = (mesh.X[pairs[:, 0]] != mesh.X[pairs[:, 1]]).any(axis=1)
    displacing[pairs[apart].ravel()] = True
    part = connected_parts(pairs.T, len(displacing))
    return ~np.bincount(part, displacing).astype(bool)[part]


def little_mass(
    mass: scipy.sparse.csr_matrix, unit: np.ndarray, scene: Scene, mesh: Mesh
) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none, for fits."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    little = np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)
    for joint in scene.joints:  # what is rigid with a mass needs none
        if joint.is_rigid and GROUND not in (joint.a, joint.b):
            a, b = (mesh.dofs[node.number] for node in (joint.a, joint.b))
            if inertia[a].all():
                little[b] = 0.0
    return little


def mobility(
    data: SceneArrays, mass: scipy.sparse.csr_matrix, reduction: Reduction, mesh: Mesh
) -> np.ndarray:
    """1 / mass that moves with each degree of freedom, then with each slide; 0 without mass.

    Of displacements that in the direction in which the node moves most easily. By the diagonal
    of the reduced mass in the reference; what is free moves about its centre of mass, unless
    nodes slide on beams.
    """
    scene, couplings, size = data.scene, reduction.couplings, mesh.dofs.size
    joints = reduction.joints
    arms, gears = joints.arms.copy(), joints.gears.copy()
    joints.set_numbers(data.arms, data.gears)
    reduction.set_start(np.zeros(size), slides_at_start(scene))
    closed = not reduction.singularity
    # Operations on small arrays are quick, those on sparse ones take 0.1 ms.
    if size <= _SMALL:
        T = reduction.maps.coupling_array(closed)[:, : couplings.free]
    else:
        T = scipy.sparse.csr_array(reduction.maps.coupling(closed)[:, : couplings.free])
    joints.arms[...], joints.gears[...] = arms, gears
    if not (couplings.is_selection or couplings.sliding):
        roots = np.isin(np.arange(couplings.free), couplings.column[mesh.dofs[:, :2]])
        T = about_centres(T, roots, mass.diagonal())
    unknown_mobility, dof_mobility = mobilities(T, mass)
    slide_mobility = couplings.free_slides(unknown_mobility, scene.joint_count)
    return np.concatenate([dof_mobility, slide_mobility])
