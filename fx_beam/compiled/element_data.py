"""Degrees of freedom, coordinates and tangent entries of all elements, for the compiled loop."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.fem import dolfinx_api
from fx_beam.fem.mesh import Mesh
from fx_beam.kept import kept


def element_data(
    mesh: Mesh, K: scipy.sparse.csr_matrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Degrees of freedom (cells, n), coordinates (cells, m), and entries of K (cells, n * n)."""
    if mesh.space is None:  # no beams
        return np.empty((0, 6), int), np.empty((0, 6)), np.empty((0, 36), int)
    dofs = dolfinx_api.element_dofs(mesh.space)
    entries = _entries(dofs, K.indptr, K.indices)
    return dofs, dolfinx_api.element_coordinates(mesh.mesh), entries


@kept
def _entries(dofs: np.ndarray, indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Indices (cells, n * n) of the entries of each cell in compressed rows."""
    # Plus 1: explicit zeros would be lost.
    numbers, shape = np.arange(1, len(indices) + 1), (len(indptr) - 1,) * 2
    numbered = scipy.sparse.csr_matrix((numbers, indices, indptr), shape)
    n = dofs.shape[1]
    entries = numbered[np.repeat(dofs, n, axis=1).ravel(), np.tile(dofs, (1, n)).ravel()]
    return np.asarray(entries).reshape(len(dofs), n * n) - 1
