"""Nodal forces of unit forces per length at the Gauss points of a beam."""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse

from .mesh import Mesh


def line_forces(mesh: Mesh, number: int, rule: int) -> scipy.sparse.csc_matrix:
    """Forces (size, 2 n) at the nodes of a beam of unit loads along x and y at its n Gauss points.

    They are the weights of a Gauss rule times the Lagrange polynomials of the nodes.
    """
    nodes, elements = mesh.nodes[number], len(mesh.cells[number])
    degree = (len(nodes) - 1) // elements
    of_elements = nodes[np.arange(elements)[:, None] * degree + np.arange(degree + 1)]
    weights, shape, slope = _rule(degree, rule)
    stretch = np.linalg.norm(slope @ mesh.X[of_elements], axis=-1)  # (elements, rule)
    forces = (weights * stretch)[..., None] * shape  # (elements, rule, degree + 1)
    forces = np.repeat(forces[:, :, None], 2, axis=2)
    rows = mesh.dofs[of_elements, :2].swapaxes(1, 2)  # (elements, 2, degree + 1)
    rows = np.broadcast_to(rows[:, None], forces.shape)
    starts = np.arange(0, forces.size + 1, degree + 1)
    parts = forces.ravel(), rows.ravel(), starts
    return scipy.sparse.csc_matrix(parts, (mesh.dofs.size, len(starts) - 1))


@functools.cache
def _rule(degree: int, rule: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (rule,), and polynomials of equidistant nodes (rule, degree + 1), and slopes."""
    x, weights = np.polynomial.legendre.leggauss(rule)
    powers = np.arange(degree + 1)
    of_nodes = np.linspace(0.0, 1.0, degree + 1)[:, None] ** powers
    at = ((x + 1) / 2)[:, None]
    slopes = powers * at ** np.maximum(powers - 1, 0)
    shape, slope = (np.linalg.solve(of_nodes.T, values.T).T for values in (at**powers, slopes))
    return weights / 2, shape, slope
