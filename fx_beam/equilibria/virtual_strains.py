"""Axes and virtual strains at the Gauss points of beams: what section forces do work on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import gauss_rule, lagrange_and_slopes


class Axes(NamedTuple):
    """Axes at the Gauss points of all elements in some configurations (..., cells, points)."""

    #: Weights (points,) of an element; shape functions (points, nodes) and their slopes.
    weights: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    #: J phi' (..., 2), J that of the reference axis, and directions of N and Q.
    dphi: np.ndarray
    t: np.ndarray
    n: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, q: np.ndarray) -> Axes:
        """Axes for displacements and rotations q (..., size)."""
        nodes = mesh.elements
        points, weights = gauss_rule(nodes.shape[1] - 1)
        values, slopes = lagrange_and_slopes(np.linspace(0, 1, nodes.shape[1]), points)
        moved = q.reshape(*q.shape[:-1], -1, 3)[..., nodes, :]
        dX = np.einsum("ga,eai->egi", slopes, mesh.X[nodes])  # J times the tangent
        x, y = np.moveaxis(dX / np.linalg.norm(dX, axis=-1, keepdims=True), -1, 0)
        psi = moved[..., 2] @ values.T
        c, s = np.cos(psi), np.sin(psi)
        t = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        n = np.stack([-t[..., 1], t[..., 0]], axis=-1)
        dphi = dX + np.einsum("ga,...eai->...egi", slopes, moved[..., :2])
        return cls(weights, values, slopes, dphi, t, n)

    def forces(self, resultants: np.ndarray) -> np.ndarray:
        """Forces (..., cells, nodes, 3) of elements by N, Q and M (..., cells, points, 3)."""
        N, Q, M = (part * self.weights for part in np.moveaxis(resultants, -1, 0))
        pull = N[..., None] * self.t + Q[..., None] * self.n
        lever = N * (self.n * self.dphi).sum(axis=-1) - Q * (self.t * self.dphi).sum(axis=-1)
        forces = np.einsum("...gi,ga->...ai", pull, self.slopes)
        moments = lever @ self.values + M @ self.slopes
        return np.concatenate([forces, moments[..., None]], axis=-1)
