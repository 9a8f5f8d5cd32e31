"""Forces and moments of the joints in a step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .model import Model


class Passing(NamedTuple):
    """How forces pass through the joints of trees, from the leaves to the roots."""

    #: Degree of freedom that follows through a joint, and the one that it follows; -1 for none.
    dof: np.ndarray
    to: np.ndarray
    #: Index in the joint forces (joints, 3), and sign of the force on b in that on the follower.
    of: np.ndarray
    sign: np.ndarray


class JointForces:
    """Joint forces on nodes b: sums over all nodes that follow through the joint."""

    def __init__(self, model: Model):
        self._model = model
        #: For displacements, and for rotations.
        self.displacements, self.rotations = self._passing((0, 1)), self._passing((2,))

    def _passing(self, components: tuple[int, ...]) -> Passing:
        couplings, dofs = self._model.couplings, self._model.mesh.dofs
        rows = [
            (dofs[b.node, i], dofs[b.parent, i] if b.parent >= 0 else -1, b.joint.number, i, b.sign)
            for i in components
            for b in reversed(couplings.forests[i])
        ]
        rows += [
            (dofs[joint.b.number, i], -1, joint.number, i, 1.0)
            for joint in couplings.sliding
            for i in components
            if i < len(couplings.carried[joint.number])
        ]
        dof, to, joint, component, sign = np.array(rows, dtype=float).reshape(-1, 5).T
        return Passing(dof.astype(int), to.astype(int), (3 * joint + component).astype(int), sign)
