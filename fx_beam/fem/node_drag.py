"""Drag on the nodes of a scene: force, tangent and loss."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse

from fx_beam.mechanics.rates import UpdateRule
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene

from .mesh import Mesh


class NodeDrag:
    """The drag of a scene's nodes in a step; its force is (linear + quadratic |v|) v.

    At mid-step v is the mean velocity. Other schemes interpolate to their level, as dampers do.
    """

    def __init__(
        self,
        scene: Scene,
        drags: Sequence[Drag],
        mesh: Mesh,
        stiffness: scipy.sparse.csr_matrix,
        rates: UpdateRule,
    ):
        self._rates = rates
        #: Degrees of freedom (n, 3) of their nodes.
        self.dofs = np.array([mesh.dofs[mesh.nodes_of(scene, drag.target)[0]] for drag in drags])
        #: Linear, quadratic and rotational coefficients (n, 3).
        self.factors = np.array([[*d.linear, *d.quadratic, *d.rotation] for d in drags])
        self._turns = np.arange(2, self.dofs.size, 3)
        entry = stiffness.copy()
        entry.data = np.arange(len(entry.data)) + 1.0
        #: Entries (n, 5) of the stiffness that they change: xx, xy, yx, yy and that of rotation.
        self.places = np.array(
            [
                [int(entry[i, j]) - 1 for i, j in ((x, x), (x, y), (y, x), (y, y), (psi, psi))]
                for x, y, psi in self.dofs
            ]
        )

    def set_step(self, dt: float, q: np.ndarray, v: np.ndarray) -> None:
        """Set the length of a step [s] and the rates at its start."""
        self._dt, self._v0 = dt, v[self.dofs]

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the resisting forces (size,) for the increment D."""
        mean, _ = self._mean(D)
        v = self._v0 + 2 * self._rates.level * (mean - self._v0)
        np.add.at(out, self.dofs, self._resistance(v))

    def add_tangent(self, D: np.ndarray, values: np.ndarray) -> None:
        """Add their derivative by D to the entries of the stiffness."""
        mean, slope = self._mean(D)
        per_rate, level = slope / self._dt, 2 * self._rates.level
        v = self._v0 + level * (mean - self._v0)
        linear, quadratic, rotation = self.factors.T
        x, y = v[:, :2].T
        speed = np.hypot(x, y)
        plain, bent = linear + quadratic * speed, quadratic / np.where(speed > 0, speed, 1)
        entries = plain + bent * x**2, bent * x * y, bent * x * y, plain + bent * y**2, rotation
        scales = per_rate[:, [0, 1, 0, 1, 2]]
        np.add.at(values, self.places, level * scales * np.column_stack(entries))

    def loss(self, D: np.ndarray) -> float:
        """Energy that they take in the step at the mean velocity [J]."""
        mean, _ = self._mean(D)
        return float(np.sum(self._resistance(mean) * mean) * self._dt)

    def _mean(self, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean rates (n, 3), by the increment with which forces do work, and that one's slope."""
        path, slope = self._rates.work_increment(D[self.dofs].ravel(), self._turns)
        return path.reshape(-1, 3) / self._dt, slope.reshape(-1, 3)

    def _resistance(self, v: np.ndarray) -> np.ndarray:
        """Forces and moments (n, 3) at rates (n, 3)."""
        linear, quadratic, rotation = self.factors.T
        along = linear + quadratic * np.hypot(*v[:, :2].T)
        return v * np.column_stack([along, along, rotation])
