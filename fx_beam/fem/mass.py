"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
from typing import Any

import ufl

import numpy as np
import scipy.sparse

from fx_beam.scene.scene import Scene

from . import dolfinx_api
from .forms import Forms
from .mesh import Mesh
from .section_fields import section_data


class Mass:
    """Constant mass matrix and weight of a scene.

    Each is assembled when it is first asked for: statics does without the mass.
    """

    def __init__(self, scene: Scene, mesh: Mesh, forms: Forms):
        self._scene, self._mesh, self._forms = scene, mesh, forms
        #: What was assembled, in words.
        self.assembled: list[str] = []

    @functools.cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity."""
        u, psi, virtual_u, virtual_psi = self._forms.trial_and_test()
        density: Any = 0
        if self._has("rhoA"):
            density += self._density("rhoA") * ufl.dot(virtual_u, u)
            self.assembled.append("distributed mass")
        if self._has("rhoI"):
            density += self._density("rhoI") * virtual_psi * psi
            self.assembled.append("distributed rotary inertia")
        mass = self._forms.stiffness.copy()
        mass.data[:] = 0.0
        if density != 0:
            form = self._forms.compile("mass", density * self._forms.full_measure())
            matrix = dolfinx_api.create_matrix(form)
            dolfinx_api.assemble_matrix(matrix, form)
            mass.data[:] = matrix.data
        if self._scene.masses:
            mass.setdiag(mass.diagonal() + self._mesh.from_nodes(self._lumped()))
            self.assembled.append("lumped mass")
        return mass

    @functools.cached_property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) of every mass [N], or none without gravity."""
        if self._scene.gravity is None:
            return None
        self.assembled.append("gravity")
        gravity = np.array([*self._scene.gravity, 0.0])
        if self._forms.load_factor is None:
            return self.matrix @ self._mesh.from_nodes(np.tile(gravity, (len(self._mesh.X), 1)))
        return self._mesh.from_nodes(self._lumped() * gravity) + self._distributed_weight()

    def _distributed_weight(self) -> np.ndarray:
        """Weight (size,) of the beams, as a load, which needs no mass matrix."""
        weight = np.zeros(self._forms.size)
        if self._has("rhoA"):
            gravity = dolfinx_api.constant(self._mesh.mesh, self._scene.gravity)
            pull = self._density("rhoA") * ufl.dot(gravity, self._forms.step.virtual_u)
            form = self._forms.compile("weight", pull * self._forms.full_measure())
            dolfinx_api.assemble_vector(weight, form)
        return weight

    def _has(self, name: str) -> bool:
        """Whether any section has one of the data."""
        return any(getattr(beam.section, name) for beam in self._scene.beams)

    def _density(self, name: str):
        """Distributed mass or inertia in UFL."""
        return section_data(self._mesh, self._scene, (name,), self._forms.full_rule)

    def _lumped(self) -> np.ndarray:
        """Lumped masses and inertias (n_node, 3) by the components that they resist."""
        lumped = np.zeros((len(self._mesh.X), 3))
        for node, mass, inertia in self._scene.masses:
            lumped[node] += mass, mass, inertia
        return lumped
