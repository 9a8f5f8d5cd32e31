"""Parts of a scene that nothing but supports holds, and their rigid motions that these leave.

Where loads are in balance among themselves, such a motion meets no force. A spring at as many
degrees of freedom holds it, as a statically determinate support does: it carries nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from fx_beam.coupling.unjoined import links
from fx_beam.fem.sparsity import connected_parts
from fx_beam.step.extended import ConstrainedMatrix
from fx_beam.step.model import Model

# Forces without balance that are round-off, relative to the sum of all; motions of supports.
_BALANCED, _ROUNDING = 1e-9, 1e-9


class FreePart(NamedTuple):
    """Nodes that hang together, and that nothing joins to the ground but supports."""

    nodes: np.ndarray
    #: Whether it has no support at all.
    unsupported: bool

    def middle(self, x: np.ndarray) -> np.ndarray:
        """The middle (2,) of the nodes, of all positions (n_node, 2)."""
        return x[self.nodes].mean(axis=0)

    def rigid(self, x: np.ndarray) -> np.ndarray:
        """Motions (n_node, 3, 3) along x and y, and about its middle."""
        motions, (dx, dy) = np.zeros((len(x), 3, 3)), (x[self.nodes] - self.middle(x)).T
        motions[self.nodes] = np.eye(3)
        motions[self.nodes, 0, 2], motions[self.nodes, 1, 2] = -dy, dx
        return motions


def free_parts(model: Model) -> list[FreePart]:
    """The parts of a scene that joints, springs and obstacles do not join to the ground."""
    scene, mesh = model.scene, model.mesh
    beams, ground = len(mesh.X), len(mesh.X) + len(scene.beams)
    pairs = links(scene, mesh)
    pairs += [(beams + i, node) for i, nodes in enumerate(mesh.nodes) for node in nodes]
    ends = np.reshape(pairs, (-1, 2)).astype(int).T % (ground + 1)  # -1 is the ground
    part_of = connected_parts(ends, ground + 1)
    supported = {node for node, _ in (*scene.fixed, *scene.prescribed)}
    parts = (np.flatnonzero(part_of[:beams] == k) for k in np.unique(part_of[:beams]))
    apart = (nodes for nodes in parts if part_of[nodes[0]] != part_of[ground])
    return [FreePart(nodes, supported.isdisjoint(nodes.tolist())) for nodes in apart]


def without_balance(model: Model, forces: np.ndarray) -> str:
    """Resultants of all forces (size,) on parts without support, where they are not zero."""
    for part in free_parts(model):
        # Virtual works may join it to the ground, as a bed does.
        if part.unsupported and not model.scene.virtual_works:
            motions = part.rigid(model.mesh.X).reshape(-1, 3)
            sums, sizes = motions.T @ forces, abs(motions.T) @ abs(forces)
            sizes[2] += sizes[:2].sum() * model.mesh.size
            if (abs(sums) > _BALANCED * sizes).any():
                x, y, moment = np.where(abs(sums) > _BALANCED * sizes, -sums, 0.0) + 0.0
                middle = part.middle(model.mesh.X)
                return (
                    f"its loads have no balance: their sum is ({x:.4g}, {y:.4g}) N and, about "
                    f"({middle[0]:.4g}, {middle[1]:.4g}), {moment:.4g} N m, and it has no support"
                )
    return ""


def left_by_supports(model: Model, q: np.ndarray) -> np.ndarray:
    """Rigid motions (size, n) of free parts that supports leave, in a configuration (size,)."""
    scene, x = model.scene, model.mesh.X + q.reshape(-1, 3)[:, :2]
    supports = np.array([*scene.fixed, *scene.prescribed], dtype=int).reshape(-1, 2)
    motions = [np.zeros((model.size, 0))]
    for part in free_parts(model):
        rigid = part.rigid(x) / [1, 1, model.mesh.size]
        # With rows of zeros, as a matrix needs rows where there are no supports.
        rows = np.vstack([rigid[supports[:, 0], supports[:, 1]], np.zeros((3, 3))])
        left = scipy.linalg.null_space(rows, rcond=_ROUNDING)
        motions.append(rigid.reshape(-1, 3) @ left)
    return np.hstack(motions)


def held_for_nothing(model: Model, q: np.ndarray, K: ConstrainedMatrix, none: float) -> np.ndarray:
    """Degrees of freedom (n,) at which supports hold motions of `left_by_supports` without force.

    K is the tangent of the configuration; a stiffness [J] up to `none` is none.
    """
    rigid = left_by_supports(model, q) / model.units.nodes[:, None]
    if not rigid.size:
        return np.empty(0, int)
    reduction, unit = model.reduction, model.units.nodes
    rigid = scipy.linalg.orth(rigid)
    unknown_forces = [reduction.maps.transpose_to_nodes(r / unit) for r in rigid.T]
    sides = np.array(unknown_forces)[:, reduction.independent].T
    moved = K.weighted(scipy.sparse.diags(unit**-2.0), reduction).solve(sides)
    node_motions = np.array([reduction.maps.motion(x) / unit for x in moved.T]).T
    _, apart, parts = np.linalg.svd(node_motions - rigid, full_matrices=False)
    together = parts[apart <= _ROUNDING**0.5].T  # joints leave them as well
    k = together.T @ moved.T @ (K @ (moved @ together))
    stiffness, parts = np.linalg.eigh((k + k.T) / 2)
    neutral = rigid @ together @ parts[:, abs(stiffness) <= none]
    if not neutral.size:
        return np.empty(0, int)
    order = scipy.linalg.qr(neutral.T * model.acted_on, mode="r", pivoting=True)[1]
    return order[: neutral.shape[1]]
