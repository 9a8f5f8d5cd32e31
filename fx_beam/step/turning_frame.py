"""A frame that turns at a constant spin, in which a scene is at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.scene.loads import damping_of
from fx_beam.scene.scene import Scene

from .model import Model


def check_turns(scene: Scene, caller: str) -> None:
    """Refuse a scene with forces that do not turn with it; errors name the `caller`."""
    for present, name in (
        (scene.gravity is not None and any(scene.gravity), "gravity"),
        (any(load.target is None for load in scene.loads), "an acceleration of all masses"),
        (bool(scene.drags), "drag in air at rest"),
        (damping_of(scene)[0] > 0, "damping in proportion to the mass"),
    ):
        if present:
            raise SceneError(
                f"{caller}: {name} does not turn with the scene, so that it has no steady turn. "
                "Leave it out, or simulate the motion"
            )


class TurningFrame:
    r"""Forces in a frame that turns about a pivot, x = p + R(t) xi, from the load factor 1 on.

    The mass has :math:`M (\ddot\xi + 2 \Omega S \dot\xi + \Omega^2 S^2 \xi)`, with S the quarter
    turn of displacements. At a load factor l the spin is :math:`\sqrt{l} \Omega`.
    """

    def __init__(self, model: Model, spin: float, pivot: Sequence[float]):
        self.spin, self.pivot = spin, np.array(pivot, dtype=float)
        self._X, self._turns = model.mesh.X, model.mesh.turns
        #: Mass (size, size) of displacements, in the sparsity of all.
        self.mass = model.masses.matrix.copy()
        self.mass.data[self.mass.indices % 3 == 2] = 0.0
        quarter = scipy.sparse.csr_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        #: S (size, size): displacements turned by a quarter, no rotations.
        self.quarter_turn = scipy.sparse.kron(scipy.sparse.eye(len(self._X)), quarter, "csr")

    def arms(self, q: np.ndarray) -> np.ndarray:
        """Places (size,) seen from the pivot; zero for rotations."""
        arms = q.copy().reshape(-1, 3)
        arms[:, :2] += self._X - self.pivot
        arms[:, 2] = 0.0
        return arms.ravel()

    def force(self, q: np.ndarray) -> np.ndarray:
        """Centrifugal force (size,) at the full spin."""
        return self.spin**2 * (self.mass @ self.arms(q))

    def rates(self, q: np.ndarray, factor: float) -> np.ndarray:
        """Rates (size,) of the turn at a load factor."""
        rates = self.quarter_turn @ self.arms(q)
        rates[self._turns] = 1.0
        return np.sqrt(factor) * self.spin * rates

    def seen(
        self, q: np.ndarray, v: np.ndarray, factor: float, duration: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and rates (size,) seen in the frame after it turned for a duration [s]."""
        spin = np.sqrt(factor) * self.spin
        quarter, turns = self.quarter_turn, self._turns
        c, s = np.cos(spin * duration), np.sin(spin * duration)
        v, arms = v - self.rates(q, factor), self.arms(q)
        back = q + (c - 1) * arms - s * (quarter @ arms)
        back[turns] -= spin * duration
        rates = c * v - s * (quarter @ v)
        rates[turns] = v[turns]
        return back, rates

    @property
    def gyroscopic(self) -> scipy.sparse.csr_matrix:
        """Coriolis forces by rates (size, size)."""
        return 2 * self.spin * (self.mass @ self.quarter_turn)
