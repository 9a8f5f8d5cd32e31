"""Mass and weight of a scene: of its beams, and lumped at its nodes."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import shallow_copy
from fx_beam.dual import MaybeDual, dual_array, dual_of, floats, linear
from fx_beam.errors import all_of, any_of, warn_once
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .beam_data import distinct, section_data
from .functions_of_time import LoadedBeams, element_rule
from .mesh import Mesh, positions_in

_WORDS = {"rhoA": "distributed mass", "rhoI": "distributed rotary inertia"}


class MassPlaces:
    """Places of masses (n,) of translations and rotations in the values of a tangent.

    First those that are lumped, then those at Gauss points of beams.
    """

    def __init__(
        self, scene: Scene, mesh: Mesh, K: scipy.sparse.csr_matrix, cell_entries: np.ndarray
    ):
        self._K, self._cells = K, len(mesh.elements)
        all_rows = np.arange(len(K.indptr) - 1, dtype=np.int32)
        #: Positions of the diagonal in the values of the stiffness.
        self.diagonal = positions_in(K.indptr, K.indices, all_rows, all_rows)
        nodes = np.array([row.node for row in scene.masses], int)
        #: Storage indices (n,) where masses and inertias are lumped, in the same values.
        self.lumped = self._places = self.diagonal.reshape(-1, 3)[nodes].ravel()
        if scene.beams:
            degree = scene.beams[0].degree
            rows, columns, self._unit = _unit_masses(degree)
            element_places = cell_entries[:, 3 * (degree + 1) * rows + columns].ravel()
            self._places = np.concatenate([self._places, element_places])

    def matrix(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """The matrix with some entries in this sparsity."""
        K = self._K
        return scipy.sparse.csr_matrix((values, K.indices, K.indptr), K.shape, copy=False)

    def entries(self, masses: MaybeDual) -> MaybeDual:
        """Entries of the mass matrix by masses."""
        lumped = len(self.lumped)
        if lumped < len(self._places):
            cell_entries = masses[lumped:].reshape(self._cells, -1) @ self._unit
            masses = np.concatenate([masses[:lumped], cell_entries.reshape(-1)])
        return (
            np.bincount(self._places, masses, self._K.nnz)
            if self._places.size
            else np.zeros(self._K.nnz)
        )

    def mass_slopes(self, entry_slopes: np.ndarray) -> np.ndarray:
        """Derivatives by masses from those by entries."""
        derivatives, lumped = entry_slopes[self._places], len(self.lumped)
        if lumped == len(derivatives):
            return derivatives
        cell_slopes = derivatives[lumped:].reshape(self._cells, -1) @ self._unit.T
        return np.concatenate([derivatives[:lumped], cell_slopes.ravel()])

    def weights(self, gravity: MaybeDual, entries: MaybeDual) -> MaybeDual:
        """Weight (size,) of an acceleration (2,), by entries of the mass."""
        places, rows = self._translations
        pull = dual_array(gravity)[rows % 3]
        return np.bincount(rows, entries[places] * pull, len(self.diagonal))

    def entry_slopes(self, gravity: MaybeDual, weight_slopes: np.ndarray) -> np.ndarray:
        """Derivatives by entries from those by the weight."""
        places, rows = self._translations
        pulls = weight_slopes[rows] * gravity[rows % 3]
        return np.bincount(places, pulls, self._K.nnz)

    @functools.cached_property
    def _translations(self) -> tuple[np.ndarray, np.ndarray]:
        """Entries of equal displacements of two nodes in the values of the stiffness, and rows."""
        K = self._K
        row = np.repeat(np.arange(len(self.diagonal), dtype=np.int32), np.diff(K.indptr))
        places = np.flatnonzero((row % 3 == K.indices % 3) & (row % 3 < 2))
        return places.astype(K.indptr.dtype), row[places]


class MassMatrix:
    """Constant mass matrix and weight of a scene."""

    def __init__(
        self, scene: Scene, mesh: Mesh, K: scipy.sparse.csr_matrix, cell_entries: np.ndarray
    ):
        self._mesh = mesh
        #: Where masses are in the values of the stiffness.
        self.places = MassPlaces(scene, mesh, K, cell_entries)
        #: Mass matrix (eqs 19 to 21), lumped entries included, of the stiffness' sparsity.
        self.matrix = self.places.matrix(np.zeros(K.nnz))
        #: Weight (size,); None without gravity.
        self.weight: np.ndarray | None = None
        #: Names of what is assembled.
        self.assembled: list[str] = []
        # Masses, gravity and positions without slopes, and the numbers that follow from them.
        # In one attribute: several threads may ask at the same time.
        self._last: tuple[tuple[list, list | None], np.ndarray, dict] | None = None

    def numbers_of(self, scene: Scene, X: MaybeDual) -> dict[str, MaybeDual]:
        """Entries of the mass, and the weight if there is any, with slopes that the scene has.

        The same arrays as in the last call if nothing differs.
        """
        sections = [beam.section for beam in scene.beams]  # which beams may share in other ways
        pairs = [*[(section.rhoA, section.rhoI) for section in sections], *scene.masses]
        gravity, last = scene.gravity, self._last
        plain = {type(number) for pair in pairs for number in pair} <= {float, int}
        is_dual = gravity is not None and dual_of(gravity) is not None
        if is_dual or not plain or type(X) is not np.ndarray:
            return self._numbers_of(scene, X)
        inputs = pairs, None if gravity is None else gravity.tolist()
        if not (last and last[0] == inputs and (last[1] is X or all_of(last[1] == X))):
            self._last = last = (inputs, X, self._numbers_of(scene, X))
        return last[2]

    def _numbers_of(self, scene: Scene, X: MaybeDual) -> dict[str, MaybeDual]:
        masses = dual_array([(m, m, inertia) for _, m, inertia in scene.masses]).reshape(-1)
        if scene.beams:
            masses = np.concatenate([masses, self.at_points(scene, X).reshape(-1)])
        places, gravity = self.places, scene.gravity
        mass = linear(places.entries, masses, places.mass_slopes)
        if gravity is None:
            return {"mass": mass}
        weights = functools.partial(places.weights, gravity)
        if dual_of(gravity) is not None:
            return {"mass": mass, "weight": weights(mass)}
        back = functools.partial(places.entry_slopes, gravity)
        return {"mass": mass, "weight": linear(weights, mass, back)}

    def check(self, numbers: dict[str, MaybeDual]) -> None:
        """OtherStructureError if other entries are zero."""
        if ((self.matrix.data != 0) != (floats(numbers["mass"]) != 0)).any():
            raise OtherStructureError("other nodes have mass")

    def set_numbers(self, numbers: dict[str, MaybeDual]) -> None:
        """Set mass and weight."""
        self.matrix.data = floats(numbers["mass"])
        if "weight" in numbers:
            self.weight = floats(numbers["weight"])

    def on(self, mesh: Mesh) -> MassMatrix:
        """The masses of another scene with this structure; `set_numbers` is to follow."""
        other = shallow_copy(self)
        other._mesh, other.matrix = mesh, shallow_copy(self.matrix)
        return other

    def name(self, scene: Scene, at_rest: bool) -> None:
        """Note what there is, without inertia `at_rest`."""
        if not at_rest:
            sections = distinct(beam.section for beam in scene.beams)
            named = _WORDS.items()
            self.assembled += [word for x, word in named if any(getattr(s, x) for s in sections)]
            self.assembled += ["lumped mass"] * bool(scene.masses)
        if self.weight is not None and scene.gravity is not None:
            self.assembled.append("gravity")

    def warn_of_no_weight(self, scene: Scene) -> None:
        """Warn if gravity acts on no mass."""
        if self.weight is not None and scene.gravity is not None:
            if any_of(floats(scene.gravity)) and not any_of(self.weight):
                warn_once("gravity acts on no mass. Give sections rho or rhoA, or add masses")

    def at_points(self, scene: Scene | LoadedBeams, X: MaybeDual) -> MaybeDual:
        """Masses (cells, n) of elements, those of translations and rotations at Gauss points."""
        degree = scene.beams[0].degree
        tangents = element_rule(degree, degree + 1)[2] @ X[self._mesh.elements]
        lengths = np.hypot(tangents[..., 0], tangents[..., 1])
        density = section_data(self._mesh, scene, ("rhoA", "rhoI"), degree + 1)
        return (lengths[..., None] * density).reshape(len(self._mesh.elements), -1)


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


def masses_of_points(degree: int) -> np.ndarray:
    """Mass matrices (n, width, width) of an element by the masses (n,) at its Gauss points.

    In the order of `Mesh.unknowns`.
    """
    rows, columns, unit = _unit_masses(degree)
    matrices = np.zeros((len(unit), 3 * (degree + 1), 3 * (degree + 1)))
    matrices[:, rows, columns] = unit
    return matrices


def about_centres(T: Any, roots: np.ndarray, masses: np.ndarray) -> Any:
    """T (size, free) whose turns and slides leave centres of mass, by masses (size,) of nodes.

    Then it does not depend on which nodes are `roots`, whose displacements are unknowns (free,).
    """
    root_part = T * roots
    other_part, root_masses = T - root_part, root_part.T @ masses
    shares = root_part * np.divide(
        1.0, root_masses, out=np.zeros(len(roots)), where=root_masses > 0
    )
    return T - root_part @ ((shares.T * masses) @ other_part)


def mobilities(T: Any, mass: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """1 / mass of unknowns (free,) and of degrees of freedom (size,) that are T times these."""
    masses = (T * (mass @ T)).sum(axis=0)
    unknown_mobilities = np.divide(1.0, masses, out=np.zeros(len(masses)), where=masses > 0)
    dof_mobilities = (T * T) @ unknown_mobilities
    x, y, xy = dof_mobilities[::3], dof_mobilities[1::3], (T[::3] * T[1::3]) @ unknown_mobilities
    dof_mobilities[::3] = dof_mobilities[1::3] = (x + y) / 2 + np.hypot((x - y) / 2, xy)
    return unknown_mobilities, dof_mobilities
