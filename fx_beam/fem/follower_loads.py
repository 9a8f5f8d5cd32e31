"""Forces that rotate with the section of their node."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.mechanics.interval import Interval, just_inside
from fx_beam.scene.scene import Scene
from fx_beam.validation import Constant, series

from .mesh import Mesh


class Followers:
    """Follower forces R(psi) F, with psi and F at the scheme's level in a step.

    The audit counts the work R(psi_m) F . Du of a mid-point step. The force has no potential, and
    its tangent W R F is not symmetric.
    """

    def __init__(self, scene: Scene, mesh: Mesh, stiffness: scipy.sparse.csr_matrix, level: float):
        self._loads = [load for load in scene.loads if load.follower]
        self._level = level
        dofs = np.array([mesh.dofs[mesh.nodes_of(scene, load.target)[0]] for load in self._loads])
        #: Degrees of freedom (n, 3) of their nodes.
        self.dofs = dofs
        self._u, self._psi = dofs[:, :2], dofs[:, 2]
        entry = stiffness.copy()
        entry.data = np.arange(len(entry.data)) + 1.0
        #: Entries (n, 2) of the stiffness that they change.
        self.places = np.array([[int(entry[row, psi]) - 1 for row in (x, y)] for x, y, psi in dofs])

    @property
    def constant(self) -> bool:
        """Whether all forces are constant in time."""
        return all(isinstance(load.value, Constant) for load in self._loads)

    def set_step(self, interval: Interval) -> None:
        """Set the interval of a step."""
        self._F = self.series(np.array([interval.start]), np.array([interval.end]))[0]

    def series(self, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Forces (steps, n, 2) [N] at the scheme's level in each step, in the section's frame."""
        start, end = (
            np.stack([series(load.value, times, str(load)) for load in self._loads], axis=1)
            for times in just_inside(t0, t1)
        )
        return (1 - self._level) * start + self._level * end

    def add_force(self, q0: np.ndarray, D: np.ndarray, factor: float, out: np.ndarray) -> None:
        """Add the forces times `factor` to `out`, for the increment D from q0."""
        np.add.at(out, self._u, factor * self._turned(q0, D))

    def subtract_tangent(
        self, q0: np.ndarray, D: np.ndarray, factor: float, data: np.ndarray
    ) -> None:
        """Subtract the derivative of `add_force` by D from the entries of the stiffness."""
        x, y = self._turned(q0, D).T
        turned = np.column_stack([-y, x])
        np.subtract.at(data, self.places, factor * self._level * turned)

    def _turned(self, q0: np.ndarray, D: np.ndarray) -> np.ndarray:
        psi = q0[self._psi] + self._level * D[self._psi]
        c, s = np.cos(psi), np.sin(psi)
        x, y = self._F.T
        return np.column_stack([c * x - s * y, s * x + c * y])
