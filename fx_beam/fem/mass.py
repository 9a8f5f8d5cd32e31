"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.dual import DualFloat, have_slopes, plain, stacked
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .fields import distinct, section_data
from .forms import Forms
from .loads import gauss_rule
from .mesh import Mesh

_WORDS = {"rhoA": "distributed mass", "rhoI": "distributed rotary inertia"}


class Mass:
    """Constant mass matrix and weight of a scene.

    Each is assembled when it is first asked for: statics does without the mass.
    """

    def __init__(self, scene: Scene, mesh: Mesh, forms: Forms):
        self._mesh, self._forms = mesh, forms
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
        self._has = [name for name in _WORDS if any(getattr(s, name) for s in sections)]

    @functools.cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity."""
        K = self._forms.stiffness
        self.assembled += [_WORDS[name] for name in self._has]
        if self._scene.masses:
            self.assembled.append("lumped mass")
        self.changes += 1
        entries = plain(self._entries(self._blocks())), K.indices, K.indptr
        return scipy.sparse.csr_matrix(entries, K.shape, copy=False)

    def refill(self, scene: Scene, moved: bool) -> bool:
        """Set mass and weight to those of a scene of the same structure, whose mesh is set.

        Returns whether any mass differs. OtherStructureError if other entries are zero.
        """
        mass, masses, gravity, given = self.matrix, self._masses, self._gravity, self._given
        self._read(scene)
        anew = moved or given != self._given or masses != self._masses
        # Functions may give other values.
        anew |= any(callable(value) for pair in given for value in pair)
        heavier = False
        if anew:
            blocks = self._blocks()
            entries, self.changes = plain(self._entries(blocks)), self.changes + 1
            if ((mass.data != 0) != (entries != 0)).any():
                raise OtherStructureError("other nodes have mass")
            heavier = bool((mass.data != entries).any())
            mass.data[:] = entries
        # The mass may be assembled only here, and then differs from none.
        if scene.gravity is not None and (anew or (scene.gravity != gravity).any()):
            self.weight = plain(self._weights(blocks if anew else self._blocks(["rhoA"])))
        return heavier

    @functools.cached_property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) of every mass [N], or none without gravity."""
        if self._scene.gravity is None:
            return None
        self.assembled.append("gravity")
        return plain(self._weights(self._blocks(["rhoA"])))

    def numbers(self) -> dict[str, Any]:
        """Entries of the mass, and the weight if there is any, with slopes that the scene has."""
        numbers = {"mass": self.matrix.data, "weight": self.weight}
        given = [value for rows in (self._given, self._masses) for row in rows for value in row]
        given += [] if self._gravity is None else [*self._gravity]
        moves = self._mesh.places(self._scene) is not self._mesh.X
        if have_slopes() and (moves or any(type(v) is DualFloat or callable(v) for v in given)):
            blocks = self._blocks()
            numbers["mass"] = self._entries(blocks)
            if self.weight is not None:
                numbers["weight"] = self._weights(blocks)
        return numbers

    def _entries(self, blocks: Mapping[str, Any]) -> Any:
        size = len(self._forms.stiffness.data)
        if not (blocks or self._masses):
            return np.zeros(size)
        places, values = [], []
        if self._masses:
            places, values = [self._diagonal], [self._mesh.from_nodes(self.lumped)]
        for name, block in blocks.items():
            for component in (0, 1) if name == "rhoA" else (2,):
                places.append(self._places[component])
                values.append(block.reshape(-1))
        return np.bincount(np.concatenate(places), np.concatenate(values), size)

    def _weights(self, blocks: Mapping[str, Any]) -> Any:
        masses = self.lumped[:, 0]
        if "rhoA" in blocks:
            at, of_nodes = self._mesh.elements.ravel(), np.sum(blocks["rhoA"], 2).reshape(-1)
            masses = masses + np.bincount(at, of_nodes, len(masses))
        return self._mesh.from_nodes(np.outer(masses, np.append(stacked(self._scene.gravity), 0.0)))

    def _blocks(self, names: Iterable[str] = tuple(_WORDS)) -> dict[str, Any]:
        """Masses and inertias (cells, degree + 1, degree + 1) of the nodes of cells, by name."""
        if not (given := [name for name in names if name in self._has]):
            return {}
        mesh, degree = self._mesh, self._scene.beams[0].degree
        weights, shape, slope = gauss_rule(degree, degree + 1)
        products = weights[:, None, None] * shape[:, :, None] * shape[:, None]
        along = slope @ mesh.places(self._scene)[mesh.elements]
        lengths, blocks = np.hypot(along[..., 0], along[..., 1]), {}
        for name in given:
            density = section_data(mesh, self._scene, (name,), degree + 1).values
            of_points = np.broadcast_to(density, lengths.shape) * lengths
            of_cells = of_points @ products.reshape(len(weights), -1)
            blocks[name] = of_cells.reshape(-1, degree + 1, degree + 1)
        return blocks

    @functools.cached_property
    def _places(self) -> np.ndarray:
        """Positions (3, cells * (degree + 1)^2) of blocks in the values of the stiffness."""
        K, dofs = self._forms.stiffness, self._mesh.dofs[self._mesh.elements]
        n, count, columns = len(K.indptr) - 1, dofs.shape[1], np.moveaxis(dofs, 2, 0)
        keys = np.repeat(np.arange(n), np.diff(K.indptr)) * n + K.indices
        wanted = np.repeat(columns, count, axis=2) * n + np.tile(columns, count)
        order = None if (np.diff(keys) > 0).all() else np.argsort(keys)
        at = np.searchsorted(keys, wanted.reshape(3, -1), sorter=order)
        return (at if order is None else order[at]).astype(np.int32)

    @functools.cached_property
    def _diagonal(self) -> np.ndarray:
        """Positions of the diagonal in the values of the stiffness."""
        K = self._forms.stiffness
        row = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr))
        return np.flatnonzero(row == K.indices)

    @property
    def lumped(self) -> Any:
        """Lumped masses and inertias (n_node, 3) by the components that they resist."""
        given = stacked([(mass, mass, inertia) for _, mass, inertia in self._scene.masses])
        at = 3 * np.array([row.node for row in self._scene.masses], int)[:, None] + np.arange(3)
        return np.bincount(at.ravel(), given.reshape(-1), self._mesh.dofs.size).reshape(-1, 3)
