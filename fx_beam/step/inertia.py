"""How easily degrees of freedom move, and little masses of those that have none."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.coupling.reduction import Reduction
from fx_beam.fem.mass import about_centres, mobilities
from fx_beam.fem.mesh import Mesh
from fx_beam.fem.scene_data import Data
from fx_beam.scene.joints import GROUND, slides_at_start
from fx_beam.scene.scene import Scene

# Mass of what has none in rates that fit joints, relative to the least mass that there is.
_LITTLE = 1e-8
# Degrees of freedom up to which a coupling is an array.
_SMALL = 200


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
    data: Data, mass: scipy.sparse.csr_matrix, reduction: Reduction, mesh: Mesh
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
    reduction.begin(np.zeros(size), slides_at_start(scene))
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
