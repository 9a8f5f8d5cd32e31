"""Forces and moments of the joints in a step."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .model import Model


class JointForces:
    """Joint forces on nodes b: sums over all nodes that follow through the joint."""

    def __init__(self, model: Model):
        self._model = model
        couplings, dofs = model.couplings, model.mesh.dofs
        joints = range(len(model.scene.joints))
        columns = [dofs[couplings.subtree[i][j], i] for j in joints for i in range(3)]
        counts = [len(followers) for followers in columns]
        signs = np.repeat(couplings.sign.T.ravel(), counts)
        sums = signs, np.concatenate(columns), np.cumsum([0, *counts])
        self._sums = scipy.sparse.csr_matrix(sums, (3 * len(joints), model.size))
        self._sums.sort_indices()
        turning = couplings.subtree[2]
        counts = [len(nodes) for nodes in turning]
        nodes = np.concatenate([np.empty(0, int), *turning])
        turned = np.repeat(couplings.sign[2], counts), nodes, np.cumsum([0, *counts])
        self._turning = scipy.sparse.csr_matrix(turned, (len(joints), len(dofs)))

    @property
    def tables(self) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Sums over nodal forces, three rows per joint, and over moments of the guiding nodes."""
        return self._sums, self._turning

    def evaluate(self, r: np.ndarray) -> np.ndarray:
        """Force [N] and moment [N m] of each joint (joints, 3).

        `r` (size,) has the forces and couples of supports and joints on the nodes.
        """
        reduction = self._model.reduction
        r = reduction.closed(reduction.carried(r))
        out = (self._sums @ r).reshape(-1, 3)
        if (closing := reduction.closing()) is not None:
            out[: len(closing), :2] += closing
        # Joints with an offset or a slide exert a moment on their guiding node, rotational springs
        # on both of their nodes. The sums contain these moments of other joints; subtract them.
        carried = reduction.guide_moments(r)
        if carried is not None:
            actuators = self._model.actuators
            carried = carried - actuators.node_moments(len(carried))
            out[:, 2] += self._turning @ carried + actuators.moments(len(out))
        return out
