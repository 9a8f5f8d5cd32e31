"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
from typing import Any

import ufl

import numpy as np
import scipy.sparse

from fx_beam.scene.scene import Scene

from . import dolfinx_api
from .dolfinx_api import CompiledForm
from .fields import Fields
from .forms import Forms
from .mesh import Mesh
from .section_fields import Data, DataShape, section_data

_WORDS = {"rhoA": "distributed mass", "rhoI": "distributed rotary inertia"}


class Mass:
    """Constant mass matrix and weight of a scene.

    Each is assembled when it is first asked for: statics does without the mass.
    """

    def __init__(self, scene: Scene, mesh: Mesh, forms: Forms, at_rest: bool):
        self._scene, self._mesh, self._forms, self._at_rest = scene, mesh, forms, at_rest
        #: What was assembled, in words.
        self.assembled: list[str] = []

    @functools.cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity."""
        data = {name: self._data(name) for name in ("rhoA", "rhoI") if self._has(name)}
        mass = self._forms.stiffness.copy()
        mass.data[:] = 0.0
        if data:
            shapes = (data[name].shape if name in data else None for name in ("rhoA", "rhoI"))
            compiled, densities = _mass_form(self._forms.fields.plain, *shapes)
            own = {symbol: data[name].on(self._mesh) for name, symbol in densities.items()}
            form, matrix = self._forms.bind(compiled, own), self._forms.matrix
            values = dolfinx_api.entries(form, matrix)
            mass.data[self._forms.assembled] = values
        self.assembled += [_WORDS[name] for name in data]
        if self._scene.masses:
            row = np.repeat(np.arange(len(mass.indptr) - 1), np.diff(mass.indptr))
            mass.data[row == mass.indices] += self._mesh.from_nodes(self.lumped)
            self.assembled.append("lumped mass")
        return mass

    @functools.cached_property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) of every mass [N], or none without gravity."""
        if self._scene.gravity is None:
            return None
        self.assembled.append("gravity")
        gravity = np.array([*self._scene.gravity, 0.0])
        if not self._at_rest:
            return self.matrix @ self._mesh.from_nodes(np.tile(gravity, (len(self._mesh.X), 1)))
        return self._mesh.from_nodes(self.lumped * gravity) + self._distributed_weight()

    def _distributed_weight(self) -> np.ndarray:
        """Weight (size,) of the beams, as a load, which needs no mass matrix."""
        weight = np.zeros(self._forms.size)
        if self._has("rhoA"):
            data = self._data("rhoA")
            compiled, density, gravity = _weight_form(self._forms.fields.plain, data.shape)
            pull = dolfinx_api.constant(self._mesh.mesh, self._scene.gravity)
            form = self._forms.bind(compiled, {density: data.on(self._mesh), gravity: pull})
            dolfinx_api.assemble_vector(weight[: self._mesh.in_beams], form)
        return weight

    def _has(self, name: str) -> bool:
        """Whether any section has one of the data."""
        return any(getattr(beam.section, name) for beam in self._scene.beams)

    def _data(self, name: str) -> Data:
        """Distributed mass or inertia."""
        return section_data(self._mesh, self._scene, (name,), self._forms.fields.full_rule)

    @functools.cached_property
    def lumped(self) -> np.ndarray:
        """Lumped masses and inertias (n_node, 3) by the components that they resist."""
        lumped = np.zeros((len(self._mesh.X), 3))
        for node, mass, inertia in self._scene.masses:
            lumped[node] += mass, mass, inertia
        return lumped


@functools.cache
def _mass_form(
    fields: Fields, rhoA: DataShape | None, rhoI: DataShape | None
) -> tuple[CompiledForm, dict[str, Any]]:
    """Form of the mass matrix, and its symbols of rhoA and rhoI, for those that there are."""
    shapes = {"rhoA": rhoA, "rhoI": rhoI}
    data = {name: fields.data(shape) for name, shape in shapes.items() if shape is not None}
    u, psi, virtual_u, virtual_psi = fields.trial_and_test()
    work: Any = data.get("rhoA", 0) * ufl.dot(virtual_u, u)
    work += data.get("rhoI", 0) * virtual_psi * psi
    form = work * fields.measure(fields.full_rule)
    return dolfinx_api.compile_form(form, "mass"), data


@functools.cache
def _weight_form(fields: Fields, rhoA: DataShape) -> tuple[CompiledForm, Any, Any]:
    """Form of the beams' weight, and its symbols of rhoA and of gravity."""
    density, gravity = fields.data(rhoA), fields.data((0, (2,)))
    *_, virtual_u, _ = fields.trial_and_test()
    form = density * ufl.dot(gravity, virtual_u) * fields.measure(fields.full_rule)
    return dolfinx_api.compile_form(form, "weight"), density, gravity
