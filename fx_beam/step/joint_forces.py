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

    def evaluate(self, r: np.ndarray) -> np.ndarray:
        """Force [N] and moment [N m] of each joint (joints, 3).

        `r` (size,) has the forces and couples of supports and joints on the nodes.
        """
        model, reduction = self._model, self._model.reduction
        r = reduction.carried(reduction.closed(r)).copy()
        out = np.zeros((model.scene.joint_count, 3))
        _pass(self.displacements, r, out)
        if (closing := reduction.closing()) is not None:
            out[: len(closing)] += closing
        # Joints with an offset or a slide exert a moment on their guiding node, which is no moment
        # of another joint.
        carried = reduction.carrier_moments(out[:, :2])
        if carried is not None:
            r[model.mesh.dofs[:, 2]] += carried
        out[:, 2] += model.points.moments(len(out))
        _pass(self.rotations, r, out)
        return out


def _pass(passing: Passing, r: np.ndarray, out: np.ndarray) -> None:
    """Add to the joint forces, and to the forces r of the nodes that others follow."""
    forces, on_joints = r.tolist(), out.ravel().tolist()
    rows = (part.tolist() for part in passing)
    for dof, to, of, sign in zip(*rows, strict=True):
        on_joints[of] += sign * forces[dof]
        if to >= 0:
            forces[to] += forces[dof]
    out[:] = np.reshape(on_joints, out.shape)
