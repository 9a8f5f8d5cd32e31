"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
import itertools
import logging
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.dual import Dual, DualFloat, LinearDual, dual_array, dual_of, floats
from fx_beam.errors import any_of
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .fields import distinct, section_data
from .forms import Forms
from .loads import element_rule
from .mesh import Mesh
from .sparsity import positions_in

_log = logging.getLogger("fx_beam")
_WORDS = {"rhoA": "distributed mass", "rhoI": "distributed rotary inertia"}


class Mass:
    """Constant mass matrix and weight of a scene.

    Each is assembled when it is first asked for: statics does without the mass.
    """

    def __init__(self, scene: Scene, mesh: Mesh, forms: Forms):
        self._mesh, self._forms = mesh, forms
        self._read(scene)
        # The masses at the last `refill`, with slopes that the scene has; None if not computed.
        self._refilled: Any = None
        #: How often the matrix was computed.
        self.changes = 0
        #: What was assembled, in words.
        self.assembled: list[str] = []

    def _read(self, scene: Scene) -> None:
        """Keep what of it may be changed in the scene itself later."""
        self._scene, self._gravity = scene, scene.gravity
        sections = distinct(beam.section for beam in scene.beams)
        self._given = [*((section.rhoA, section.rhoI) for section in sections), *scene.masses]
        # What `_unit_masses` gives, if there are elements.
        self._unit: Any = _unit_masses(scene.beams[0].degree) if scene.beams else None
        self._has = [name for name in _WORDS if any(getattr(s, name) for s in sections)]

    @cached_property
    def matrix(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity."""
        K = self._forms.stiffness
        self.assembled += [_WORDS[name] for name in self._has]
        if self._scene.masses:
            self.assembled.append("lumped mass")
        self.changes += 1
        entries = self._entries(floats(self._masses())), K.indices, K.indptr
        return scipy.sparse.csr_matrix(entries, K.shape, copy=False)

    def refill(self, scene: Scene, moved: bool) -> None:
        """Set mass and weight to those of a scene of the same structure, whose mesh is set.

        OtherStructureError if other entries are zero.
        """
        mass, gravity, given = self.matrix, self._gravity, self._given
        self._read(scene)
        # Functions may give other values.
        functions = any(callable(value) for pair in given for value in pair)
        anew = moved or functions or given != self._given
        self._refilled = self._masses() if anew else None
        if anew:
            self.changes += 1
            entries = self._entries(floats(self._refilled))
            if ((mass.data != 0) != (entries != 0)).any():
                raise OtherStructureError("other nodes have mass")
            mass.data[:] = entries
        # The mass may be assembled only here, and then differs from none.
        if scene.gravity is not None and (anew or (scene.gravity != gravity).any()):
            self.weight = floats(self._weights(self._gravity, mass.data))

    @cached_property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) of every mass [N], or none without gravity."""
        if self._scene.gravity is None:
            return None
        self.assembled.append("gravity")
        weight = floats(self._weights(self._gravity, self._entries(floats(self._masses()))))
        if any_of(floats(self._gravity)) and not any_of(weight):
            _log.warning("gravity acts on no mass. Give sections rho or rhoA, or add masses")
        return weight

    def numbers(self) -> dict[str, Any]:
        """Entries of the mass, and the weight if there is any, with slopes that the scene has."""
        numbers: dict[str, Any] = {"mass": self.matrix.data, "weight": self.weight}
        masses, given = self._refilled, itertools.chain(*self._given)
        moves = self._mesh.nodal_positions(self._scene) is not self._mesh.X
        if masses is None and (moves or any(type(value) is DualFloat for value in given)):
            masses = self._masses()
        if isinstance(masses, Dual):
            # Slopes are read later, when this may have the numbers of another scene.
            entries = self.matrix.data.copy()
            numbers["mass"] = LinearDual(entries, self._entries, masses, self._by_masses)
        weights = functools.partial(self._weights, self._gravity)
        if dual_of(self._gravity) is not None:
            numbers["weight"] = weights(numbers["mass"])
        elif isinstance(masses, Dual) and self.weight is not None:
            back = functools.partial(self._by_entries, self._gravity)
            numbers["weight"] = LinearDual(self.weight, weights, numbers["mass"], back)
        return numbers

    def _masses(self) -> Any:
        """Masses (n,), of translations and of rotations: lumped, then at Gauss points of beams."""
        masses = dual_array([(m, m, inertia) for _, m, inertia in self._scene.masses]).reshape(-1)
        if not self._has:
            return masses
        mesh, scene, degree = self._mesh, self._scene, self._scene.beams[0].degree
        along = element_rule(degree, degree + 1)[2] @ mesh.nodal_positions(scene)[mesh.elements]
        lengths = np.hypot(along[..., 0], along[..., 1])
        density = section_data(mesh, scene, ("rhoA", "rhoI"), degree + 1)
        return np.concatenate([masses, (lengths[..., None] * density).reshape(-1)])

    def _entries(self, masses: Any) -> Any:
        """Entries of the mass matrix by masses."""
        at, lumped, size = self._at, 3 * len(self._scene.masses), len(self._forms.stiffness.data)
        if not at.size:
            return np.zeros(size)
        if self._has:
            of_cells = masses[lumped:].reshape(len(self._mesh.elements), -1) @ self._unit[2]
            masses = np.concatenate([masses[:lumped], of_cells.reshape(-1)])
        return np.bincount(at, masses, size)

    def _by_masses(self, by_entries: np.ndarray) -> np.ndarray:
        """Derivatives by masses from those by entries."""
        by, lumped = by_entries[self._at], 3 * len(self._scene.masses)
        if not self._has:
            return by
        by_cells = by[lumped:].reshape(len(self._mesh.elements), -1) @ self._unit[2].T
        return np.concatenate([by[:lumped], by_cells.ravel()])

    def _weights(self, gravity: Any, entries: Any) -> Any:
        """Weight (size,) by entries of the mass: it resists the acceleration of a free fall."""
        at, rows = self._of_translations
        pull = dual_array(gravity)[rows % 3]
        return np.bincount(rows, entries[at] * pull, self._mesh.dofs.size)

    def _by_entries(self, gravity: Any, by_weight: np.ndarray) -> np.ndarray:
        """Derivatives by entries from those by the weight."""
        at, rows = self._of_translations
        by_pull = by_weight[rows] * gravity[rows % 3]
        return np.bincount(at, by_pull, len(self._forms.stiffness.data))

    @property
    def _at(self) -> np.ndarray:
        """Entries of the stiffness where lumped masses are, then those of cells."""
        at = self.entries_of_nodes
        return np.concatenate([at, self._entries_of_cells]) if self._has else at

    @cached_property
    def _entries_of_cells(self) -> np.ndarray:
        """Storage indices (cells * n,) of the entries of cells in the values of the stiffness."""
        rows, columns, _ = self._unit
        dofs = 3 * (self._scene.beams[0].degree + 1)
        return self._forms.of_cells[:, dofs * rows + columns].ravel()

    @cached_property
    def _of_translations(self) -> tuple[np.ndarray, np.ndarray]:
        """Entries of equal displacements of two nodes in the values of the stiffness, and rows."""
        K = self._forms.stiffness
        rows = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr))
        at = np.flatnonzero((rows % 3 == K.indices % 3) & (rows % 3 < 2))
        return at, rows[at]

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Positions of the diagonal in the values of the stiffness."""
        K = self._forms.stiffness
        every = np.arange(len(K.indptr) - 1)
        return positions_in(K.indptr, K.indices, every, every)

    @cached_property
    def entries_of_nodes(self) -> np.ndarray:
        """Storage indices (n,) where masses and inertias are lumped, in the same values."""
        nodes = np.array([row.node for row in self._scene.masses], int)
        return self.diagonal.reshape(-1, 3)[nodes].ravel()


@functools.cache
def _unit_masses(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns (n,) of entries of an element's mass matrix, and those (2 points, n).

    Of an element of unit length, whose rhoA or rhoI is one at one Gauss point, and zero elsewhere.
    Degrees of freedom are numbered as in forms: displacements at nodes, then rotations.
    """
    n = degree + 1
    weights, shape, _ = element_rule(degree, n)
    shape = shape[:, [0, degree, *range(1, degree)]]  # in forms ends come before other nodes
    products = weights[:, None, None] * shape[:, :, None] * shape[:, None]
    masses = np.zeros((n, 2, 3 * n, 3 * n))
    masses[:, 0, : 2 * n, : 2 * n] = np.kron(products, np.eye(2))
    masses[:, 1, 2 * n :, 2 * n :] = products
    masses = masses.reshape(2 * n, 3 * n, 3 * n)
    rows, columns = np.nonzero(masses.any(axis=0))
    return rows, columns, masses[:, rows, columns]


def about_centres(T: Any, roots: np.ndarray, masses: np.ndarray) -> Any:
    """T (size, free) whose turns and slides leave centres of mass, by masses (size,) of nodes.

    Then it does not depend on which nodes are `roots`, whose displacements are unknowns (free,).
    """
    by_roots = T * roots
    others, of_roots = T - by_roots, by_roots.T @ masses
    shares = by_roots * np.divide(1.0, of_roots, out=np.zeros(len(roots)), where=of_roots > 0)
    return T - by_roots @ ((shares.T * masses) @ others)


def mobilities(T: Any, mass: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """1 / mass of unknowns (free,) and of degrees of freedom (size,) that are T times these."""
    masses = (T * (mass @ T)).sum(axis=0)
    of_unknowns = np.divide(1.0, masses, out=np.zeros(len(masses)), where=masses > 0)
    of_dofs = (T * T) @ of_unknowns
    x, y, both = of_dofs[::3], of_dofs[1::3], (T[::3] * T[1::3]) @ of_unknowns
    of_dofs[::3] = of_dofs[1::3] = (x + y) / 2 + np.hypot((x - y) / 2, both)
    return of_unknowns, of_dofs
