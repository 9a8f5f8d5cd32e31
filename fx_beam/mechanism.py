"""The check that nothing can move without mass or support."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .errors import SceneError
from .joints import GROUND, Coordinate, Joint
from .mesh import Mesh
from .scene import Scene


def check_no_massless_mechanism(
    scene: Scene,
    mesh: Mesh,
    stiffness: scipy.sparse.csr_matrix,
    mass: scipy.sparse.csr_matrix | None,
) -> None:
    """Refuse a scene that can move as a mechanism of rigid parts without mass or support.

    The rigid motions of all parts that supports and joints, with their motors, springs and
    dampers, allow must have mass. In statics there must be none, and dampers hold nothing.

    Parameters
    ----------
    scene : Scene
        Its supports and joints.
    mesh : Mesh
        The mesh.
    stiffness : (size, size) sparse matrix
        Its sparsity joins what the elements join.
    mass : (size, size) sparse matrix, optional
        Mass matrix; none in statics.

    Raises
    ------
    SceneError
        If such a motion exists; the message describes it.
    """
    # Whatever the values of the entries are.
    ones = np.ones_like(stiffness.data)
    graph = scipy.sparse.csr_matrix((ones, stiffness.indices, stiffness.indptr))
    parts, part_of_dof = scipy.sparse.csgraph.connected_components(graph, directed=False)
    part_of_node = part_of_dof[mesh.dofs[:, 0]]
    modes = np.zeros((mesh.dofs.size, 3 * parts))
    for part in range(parts):
        nodes = np.flatnonzero(part_of_node == part)
        modes[:, 3 * part : 3 * part + 3] = _rigid_modes(mesh, nodes)
    rows = [modes[mesh.dofs[key]] for key in (*scene.fixed, *scene.prescribed)]
    for joint in scene.joints:
        rows += _joint_rows(joint, mesh, modes, mass is None)
    constraints = np.array(rows).reshape(-1, 3 * parts)
    _, values, vectors = np.linalg.svd(constraints)
    rank = int((values > 1e-9 * values.max(initial=1.0)).sum())
    allowed = vectors[rank:].T
    inertia = np.zeros((3 * parts,) * 2) if mass is None else modes.T @ (mass @ modes)
    scale = np.sqrt(np.diag(inertia).max()) or 1.0
    energies, motions = np.linalg.eigh(allowed.T @ inertia @ allowed / scale**2)
    if len(energies) and energies[0] < 1e-14:
        motion = _description(mesh, part_of_node, allowed @ motions[:, 0])
        advice = (
            "without mass or support: give its section rhoA and rhoI, add a mass, or support it"
        )
        if mass is None:
            advice = (
                "without support, which statics has no mass to make up for: support it. If loads "
                "hold it, as weight does a pendulum that hangs, hold it in a copy of the scene, "
                "and go on from that with modes(scene, state=...) or simulate(scene, start=...)"
            )
        raise SceneError(f"{motion} {advice}")


def _joint_rows(joint: Joint, mesh: Mesh, modes: np.ndarray, at_rest: bool) -> list[np.ndarray]:
    """Rates that a joint makes zero, for each mode."""

    def rate(node, component):
        none = np.zeros(modes.shape[1])
        return none if node is GROUND else modes[mesh.dofs[node.number, component]]

    size, slide = mesh.size, joint.start()[0]
    arm = joint.offset + (0.0 if joint.axis is None else slide * joint.axis)
    turn = rate(joint.a, 2) / size
    gap = [
        rate(joint.b, 0) - rate(joint.a, 0) + turn * arm[1],
        rate(joint.b, 1) - rate(joint.a, 1) - turn * arm[0],
    ]
    if joint.axis is not None and not _is_held(joint.slide, at_rest):
        gap = [joint.axis[0] * gap[1] - joint.axis[1] * gap[0]]
    turns_together = joint.turns_together or _is_held(joint.rotation, at_rest)
    return gap + ([rate(joint.b, 2) - rate(joint.a, 2)] if turns_together else [])


def _is_held(coordinate: Coordinate | None, at_rest: bool) -> bool:
    """Whether a motor, a spring or, unless at rest, a damper keeps a coordinate from moving."""
    if coordinate is None:
        return False
    spring, damper = coordinate.spring, coordinate.damper
    stiffness = spring.stiffness if spring else 0.0
    viscosity = damper.viscosity if damper and not at_rest else 0.0
    return bool(coordinate.motor or stiffness or viscosity)


def _rigid_modes(mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Translations by one size of the scene, and unit rotation about the middle of the part."""
    X = mesh.X[nodes]
    x, y = (X - X.mean(axis=0)).T
    modes = np.zeros((mesh.dofs.size, 3))
    dofs = mesh.dofs[nodes]
    modes[dofs[:, 0], 0] = modes[dofs[:, 1], 1] = 1.0
    modes[dofs[:, 0], 2], modes[dofs[:, 1], 2] = -y / mesh.size, x / mesh.size
    modes[dofs[:, 2], 2] = 1.0
    return modes


def _description(mesh: Mesh, part_of_node: np.ndarray, motion: np.ndarray) -> str:
    by_part = motion.reshape(-1, 3)
    part = int(np.argmax(abs(by_part).max(axis=1)))
    X = mesh.X[part_of_node == part]
    mode, middle = by_part[part], X.mean(axis=0)
    if abs(mode[2]) > 1e-6:
        # Velocity (mode0 - w y, mode1 + w x) vanishes at the pole.
        pole = middle + mesh.size * np.array([-mode[1], mode[0]]) / mode[2]
        how = f"can turn about ({pole[0]:.4g}, {pole[1]:.4g})"
    else:
        along = np.round(mode[:2] / abs(mode[:2]).max(), 6) + 0.0  # no -0
        how = f"can move along ({along[0]:.3g}, {along[1]:.3g})"
    return f"the part of the scene around ({middle[0]:.4g}, {middle[1]:.4g}) {how}"
