"""The check that nothing can move without mass or support."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .errors import SceneError
from .mesh import Mesh


def check_no_massless_mechanism(
    mesh: Mesh, mass: scipy.sparse.csr_matrix, constrained: np.ndarray
) -> None:
    """Refuse a scene of which a part can move as a rigid body without mass or support.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    mass : (size, size) sparse matrix
        Mass matrix, with the sparsity of the stiffness.
    constrained : int array
        Supported degrees of freedom.

    Raises
    ------
    SceneError
        If such a part exists; the message describes its motion.
    """
    supported = np.zeros(mesh.dofs.size, dtype=bool)
    supported[constrained] = True
    # The sparsity joins what the elements join, whatever the values of the entries are.
    graph = scipy.sparse.csr_matrix((np.ones_like(mass.data), mass.indices, mass.indptr))
    _, part_of_dof = scipy.sparse.csgraph.connected_components(graph, directed=False)
    part_of_node = part_of_dof[mesh.dofs[:, 0]]
    for part in np.unique(part_of_node):
        nodes = np.flatnonzero(part_of_node == part)
        modes = _rigid_modes(mesh, nodes)
        held = modes * supported[:, None]
        inertia = modes.T @ (mass @ modes)
        scale = _unit_diagonal(inertia)
        resistance = inertia * np.outer(scale, scale) + held.T @ held
        scale = _unit_diagonal(resistance)
        values, vectors = np.linalg.eigh(resistance * np.outer(scale, scale))
        if values[0] < 1e-10:
            raise SceneError(_message(mesh.X[nodes], scale * vectors[:, 0]))


def _rigid_modes(mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Unit translations and unit rotation about the middle, lengths divided by the size."""
    X = mesh.X[nodes]
    x, y = ((X - X.mean(axis=0)) / np.ptp(X, axis=0).max()).T
    modes = np.zeros((mesh.dofs.size, 3))
    dofs = mesh.dofs[nodes]
    modes[dofs[:, 0], 0] = modes[dofs[:, 1], 1] = modes[dofs[:, 2], 2] = 1.0
    modes[dofs[:, 0], 2], modes[dofs[:, 1], 2] = -y, x
    return modes


def _unit_diagonal(matrix: np.ndarray) -> np.ndarray:
    """Factors of rows and columns that give a unit diagonal where it is not zero."""
    d = np.sqrt(np.diag(matrix))
    return np.divide(1.0, d, out=np.ones_like(d), where=d > 0)


def _message(X: np.ndarray, mode: np.ndarray) -> str:
    middle = X.mean(axis=0)
    motion = "can move"
    if abs(mode[2]) > 1e-6:
        # Velocity (mode0 - w y, mode1 + w x) vanishes at the pole.
        pole = middle + np.ptp(X, axis=0).max() * np.array([-mode[1], mode[0]]) / mode[2]
        motion = f"can turn about ({pole[0]:.4g}, {pole[1]:.4g})"
    else:
        motion = f"can move along ({mode[0]:.3g}, {mode[1]:.3g})"
    return (
        f"the part of the scene around ({middle[0]:.4g}, {middle[1]:.4g}) {motion} without mass or "
        "support: give its section rhoA and rhoI, add a mass, or support it"
    )
