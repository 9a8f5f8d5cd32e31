"""Degrees of freedom, coordinates and tangent entries of all elements, for the compiled loop."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.fem import dolfinx_api
from fx_beam.fem.mesh import Mesh


def element_data(
    mesh: Mesh, K: scipy.sparse.csr_matrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Degrees of freedom (cells, n), coordinates (cells, m), and entries of K (cells, n * n)."""
    if mesh.space is None:  # no beams
        return np.empty((0, 6), int), np.empty((0, 6)), np.empty((0, 36), int)
    dofs = dolfinx_api.element_dofs(mesh.space)
    # Indices of the entries of K plus 1: explicit zeros would be lost.
    numbered = scipy.sparse.csr_matrix((np.arange(1, K.nnz + 1), K.indices, K.indptr), K.shape)
    n = dofs.shape[1]
    entries = numbered[np.repeat(dofs, n, axis=1).ravel(), np.tile(dofs, (1, n)).ravel()]
    entries = np.asarray(entries).reshape(len(dofs), n * n) - 1
    return dofs, dolfinx_api.element_coordinates(mesh.mesh), entries
