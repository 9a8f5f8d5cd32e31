"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
from typing import Any

import ufl

import numpy as np
import scipy.sparse

from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from . import dolfinx_api
from .beam_forms import BeamForms
from .dolfinx_api import CompiledForm
from .fields import Data, DataShape, Fields, FilledField, distinct, refill, section_data
from .forms import Forms
from .mesh import Mesh

_WORDS = {"rhoA": "distributed mass", "rhoI": "distributed rotary inertia"}


class Mass:
    """Constant mass matrix and weight of a scene.

    Each is assembled when it is first asked for: statics does without the mass.
    """

    def __init__(self, scene: Scene, mesh: Mesh, forms: Forms, at_rest: bool):
        self._mesh, self._forms, self._at_rest = mesh, forms, at_rest
        self._read(scene)
        #: How often the matrix was computed.
        self.changes = 0
        #: What was assembled, in words.
        self.assembled: list[str] = []

    def _read(self, scene: Scene) -> None:
        """Keep what of it may be changed in the scene itself later."""
        self._scene, self._masses, self._gravity = scene, scene.masses[:], scene.gravity
        sections = distinct(beam.section for beam in scene.beams)
        self._given = [(section.rhoA, section.rhoI) for section in sections]

    @property
    def _beams(self) -> BeamForms:
        assert self._forms.beams is not None  # some have distributed mass
        return self._forms.beams

    @functools.cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity."""
        K, data = self._forms.stiffness, self._densities()
        entries = np.zeros_like(K.data), K.indices, K.indptr
        mass = scipy.sparse.csr_matrix(entries, K.shape, copy=False)
        #: Densities by name, on the mesh.
        self._fields = {name: FilledField(values, self._mesh) for name, values in data.items()}
        self._form: Any = None
        #: Values of the beams, None before they are assembled.
        self._of_beams: np.ndarray | None = None
        if data:
            shapes = (data[name].shape if name in data else None for name in ("rhoA", "rhoI"))
            compiled, densities = _mass_form(self._beams.fields.plain, *shapes)
            fields = {symbol: self._fields[name].on_mesh for name, symbol in densities.items()}
            self._form = self._beams.bind(compiled, fields)
        self.assembled += [_WORDS[name] for name in data]
        if self._scene.masses:
            self.assembled.append("lumped mass")
        self._assemble(mass)
        return mass

    def _assemble(self, mass: scipy.sparse.csr_matrix) -> None:
        self.changes += 1
        mass.data[:] = 0.0
        if self._form is not None:
            if self._of_beams is None:
                self._of_beams = dolfinx_api.entries(self._form, self._beams.matrix)
            mass.data[self._beams.value_at] = self._of_beams
        if self._scene.masses:
            mass.data[self._diagonal] += self._mesh.from_nodes(self.lumped)

    @functools.cached_property
    def _diagonal(self) -> np.ndarray:
        """Positions of the diagonal in the values of the stiffness."""
        K = self._forms.stiffness
        row = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr))
        return np.flatnonzero(row == K.indices)

    def refill(self, scene: Scene, moved: bool) -> bool:
        """Set mass and weight to those of a scene of the same structure, whose mesh is set.

        Returns whether any mass differs. OtherStructureError if other entries are zero.
        """
        mass, masses, gravity, given = self.matrix, self._masses, self._gravity, self._given
        self._read(scene)
        anew = moved
        # Functions may give other values.
        if given != self._given or any(callable(value) for pair in given for value in pair):
            anew |= bool(refill(self._fields, self._densities()))
        if anew:
            self._of_beams = None
        other, heavier = anew or masses != self._masses, False
        if other:
            before = mass.data.copy()
            self.__dict__.pop("lumped", None)
            self._assemble(mass)
            if ((mass.data != 0) != (before != 0)).any():
                raise OtherStructureError("other nodes have mass")
            heavier = bool((mass.data != before).any())
        # The mass may be assembled only here, and then differs from none.
        if scene.gravity is not None and (other or (scene.gravity != gravity).any()):
            self.weight = self._weigh(scene.gravity)
        return heavier

    @functools.cached_property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) of every mass [N], or none without gravity."""
        if self._scene.gravity is None:
            return None
        self.assembled.append("gravity")
        return self._weigh(self._scene.gravity)

    def _weigh(self, given: np.ndarray) -> np.ndarray:
        gravity = np.append(given, 0.0)
        if not self._at_rest:
            return self.matrix @ self._mesh.from_nodes(np.tile(gravity, (len(self._mesh.X), 1)))
        return self._mesh.from_nodes(self.lumped * gravity) + self._distributed_weight()

    def _distributed_weight(self) -> np.ndarray:
        """Weight (size,) of the beams, as a load, which needs no mass matrix."""
        weight = np.zeros(self._forms.size)
        if self._has("rhoA"):
            data = self._data("rhoA")
            compiled, density, gravity = _weight_form(self._beams.fields.plain, data.shape)
            pull = dolfinx_api.constant(self._mesh.mesh, self._scene.gravity)
            form = self._beams.bind(compiled, {density: data.on(self._mesh), gravity: pull})
            dolfinx_api.assemble_vector(weight[: self._mesh.in_beams], form)
        return weight

    def _has(self, name: str) -> bool:
        """Whether any section has one of the data."""
        return any(getattr(beam.section, name) for beam in self._scene.beams)

    def _densities(self) -> dict[str, Data]:
        """Distributed mass and inertia, if there are any."""
        return {name: self._data(name) for name in ("rhoA", "rhoI") if self._has(name)}

    def _data(self, name: str) -> Data:
        """Distributed mass or inertia."""
        return section_data(self._mesh, self._scene, (name,), self._beams.fields.full_rule)

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
