"""Forces and moments of the joints in a step."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .model import Model


class JointForces:
    """Forces and moments of the joints on their nodes b, as sums over what follows through them."""

    def __init__(self, model: Model):
        self._model = model
        couplings, dofs = model.couplings, model.mesh.dofs
        joints = range(len(model.scene.joints))
        rows, columns, signs = [], [], []
        for j in joints:
            for i in range(3):
                followers, sign = couplings.subtree[i][j], couplings.sign[i, j]
                rows += [3 * j + i] * len(followers)
                columns += dofs[followers, i].tolist()
                signs += [sign] * len(followers)
        shape = (3 * len(joints), model.size)
        self._sums = scipy.sparse.csr_matrix((signs, (rows, columns)), shape)
        turning = couplings.subtree[2]
        counts = [len(nodes) for nodes in turning]
        nodes = np.concatenate([np.empty(0, int), *turning])
        turned = np.repeat(couplings.sign[2], counts), nodes, np.cumsum([0, *counts])
        self._turning = scipy.sparse.csr_matrix(turned, (len(joints), len(dofs)))

    @property
    def tables(self) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Sums over nodal forces, three rows a joint, and over the moments of carrying nodes."""
        return self._sums, self._turning

    def evaluate(self, r: np.ndarray) -> np.ndarray:
        """Force [N] and moment [N m] of each joint (joints, 3).

        `r` (size,) are the forces and couples of supports and joints on the nodes.
        """
        out = (self._sums @ r).reshape(-1, 3)
        # Offset and sliding joints turn what carries them, springs turn both of their ends: what
        # that takes of the moments of the nodes is not this joint's, but for its own spring.
        carried = self._model.reduction.guide_moments(r)
        if carried is not None:
            actuators = self._model.actuators
            carried = carried - actuators.node_moments(len(carried))
            out[:, 2] += self._turning @ carried + actuators.moments(len(out))
        return out
