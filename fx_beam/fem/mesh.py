"""From a scene to a dolfinx mesh and the table of degrees of freedom."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.content_cache import cached_by_content
from fx_beam.dual import Dual, DualFloat, have_slopes, plain, stacked
from fx_beam.errors import SceneError, all_of
from fx_beam.scene.beam import Beam, inner_positions
from fx_beam.scene.scene import Scene

from . import dolfinx_api, interval_mesh


@dataclass(eq=False)
class Mesh:
    """The mesh of a scene. `X` changes if the scene does, and all that is derived from it."""

    #: dolfinx mesh of intervals: straight, or of the beams' degree if one of them is curved. None
    #: without beams, as the space.
    mesh: Any
    #: Function space of displacement and rotation.
    space: Any
    #: Reference positions (n, 2) [m]: nodes of the scene by number, then nodes inside elements.
    X: np.ndarray
    #: Degrees of freedom (n, 3) of x, y and rotation of each node: those of dolfinx, then those of
    #: nodes that belong to no beam.
    dofs: np.ndarray
    #: Number of degrees of freedom of dolfinx.
    in_beams: int
    #: Index of each cell's beam in the scene.
    beam_of_cell: np.ndarray
    #: Cells and nodes of each beam, in order along it.
    cells: list[np.ndarray]
    nodes: list[np.ndarray]
    #: Whether the elements are curved, with the beams' degree, or straight.
    curved: bool

    @functools.cached_property
    def size(self) -> float:
        """Largest extent of the scene [m]; 1 for a single node."""
        return float(np.hypot(*np.ptp(self.X, axis=0))) or 1.0

    @functools.cached_property
    def shortest(self) -> list[float]:
        """Shortest distance of the ends of an element of each beam [m]."""
        pairs = zip(self.nodes, self.cells, strict=True)
        ends = [nodes[:: (len(nodes) - 1) // len(cells)] for nodes, cells in pairs]
        return [float(np.hypot(*np.diff(self.X[beam_ends], axis=0).T).min()) for beam_ends in ends]

    def refill(self, scene: Scene) -> bool:
        """Move the nodes to those of a scene with the same structure; whether any moves.

        Arrays that were read from here keep their values.
        """
        X = _positions(scene)
        if all_of(X == self.X):
            return False
        self.X = X
        for name in ("size", "shortest"):
            self.__dict__.pop(name, None)
        if self.mesh is not None:
            self.mesh.move(X if self.curved else X[: len(scene.nodes)])
        return True

    def places(self, scene: Scene) -> Any:
        """`X`, with slopes if positions of a scene with these nodes have some."""
        ends = (x for node in scene.nodes for x in (node.x, node.y))
        if self.curved or not (have_slopes() and any(type(x) is DualFloat for x in ends)):
            return self.X
        points = [stacked([(node.x, node.y) for node in scene.nodes])]
        points += [inner_positions(beam) for beam in scene.beams if beam.degree > 1]
        return np.concatenate(points)

    @functools.cached_property
    def elements(self) -> np.ndarray:
        """Nodes (cells, degree + 1) of each cell, in order along it."""
        rows: list[Any] = []
        for nodes, cells in zip(self.nodes, self.cells, strict=True):
            degree = (len(nodes) - 1) // len(cells)
            rows.append(nodes[np.arange(len(cells))[:, None] * degree + np.arange(degree + 1)])
        return self.from_elements(np.concatenate(rows))

    def to_nodes(self, vector: np.ndarray) -> np.ndarray:
        """Values (n_node, 3) at the nodes of a vector (size,) over all degrees of freedom."""
        return vector[self.dofs]

    def from_nodes(self, values: Any) -> Any:
        """Vector (size,) over all degrees of freedom of values (n_node, 3) at the nodes."""
        if isinstance(values, Dual):
            return Dual(self.from_nodes(values.values), self.from_nodes(values.slopes))
        vector = np.empty((self.dofs.size, *values.shape[2:]))
        vector[self.dofs] = values
        return vector

    def to_elements(self, values: np.ndarray) -> np.ndarray:
        """Values (elements, ...) in the order of the beams of those of the cells."""
        return values[np.concatenate(self.cells)]

    def from_elements(self, values: Any) -> Any:
        """Values (cells, ...) of those of the elements in the order of the beams."""
        return values[np.argsort(np.concatenate(self.cells))]

    def sum_at_points(self, values: np.ndarray) -> np.ndarray:
        """Sums (n_node, 2) of values (cells, 2 points) at the points of the cells' geometry."""
        points, sums = dolfinx_api.element_points(self.mesh), np.zeros_like(self.X)
        np.add.at(sums, points, values.reshape(*points.shape, 2))
        return sums

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values (m, cells, 2 points) of those (m, n_node, 2) at the points of the geometry."""
        points = dolfinx_api.element_points(self.mesh)
        return values[:, points].reshape(len(values), len(points), -1)

    def nodes_of(self, scene: Scene, target) -> np.ndarray:
        """Nodes of a beam, those inside its elements included, or the node itself."""
        if isinstance(target, Beam):
            return self.nodes[scene.beams.index(target)]
        return np.array([target.number])


def build_mesh(scene: Scene) -> Mesh:
    """Mesh of a scene with at least one beam or body."""
    if not scene.nodes:
        raise SceneError("the scene has no beams. Add one with scene.add_beam, or add_body")
    X = _positions(scene)
    if not scene.beams:
        dofs = np.arange(3 * len(X)).reshape(-1, 3)
        return Mesh(None, None, X, dofs, 0, np.empty(0, int), [], [], False)
    degree = scene.beams[0].degree
    pairs = [
        (a.number, b.number)
        for beam in scene.beams
        for a, b in zip(beam.nodes[:-1], beam.nodes[1:], strict=True)
    ]
    ends = np.array(pairs)
    inner = np.arange(len(ends) * (degree - 1)).reshape(len(ends), degree - 1) + len(scene.nodes)
    nodes_of_element = np.hstack([ends, inner])
    curved = degree > 1 and any(beam.inner is not None for beam in scene.beams)
    if curved:
        mesh, order = interval_mesh.mesh_between(X, nodes_of_element, degree)
    else:
        mesh, order = interval_mesh.mesh_between(X[: len(scene.nodes)], ends)
    space = interval_mesh.beam_space(mesh, degree)
    of_cells = dolfinx_api.dofs_of_cells(space)
    counts = np.array([beam.elements for beam in scene.beams])
    numbers = _numbers(len(X), nodes_of_element, order, of_cells, counts)
    return Mesh(mesh, space, X, *numbers, curved)


def _positions(scene: Scene) -> np.ndarray:
    """Positions (n, 2): nodes of the scene, then those inside elements, in order."""
    points = np.empty((len(scene.nodes), 2))  # filled by columns, twice as fast as by tuples
    points[:, 0] = [node.x for node in scene.nodes]
    points[:, 1] = [node.y for node in scene.nodes]
    if not scene.beams or scene.beams[0].degree == 1:
        return points
    return np.vstack([points, *(plain(inner_positions(beam)) for beam in scene.beams)])


@cached_by_content
def _numbers(
    count: int, elements: np.ndarray, order: np.ndarray, of_cells: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """`dofs`, `in_beams`, `beam_of_cell`, `cells` and `nodes` of a mesh of so many nodes.

    From the nodes of the elements, the element and the degrees of freedom of each cell, and the
    number of elements of each beam.
    """
    dofs = np.full((count, 3), -1)
    dofs[elements[order]] = of_cells
    alone = dofs[:, 0] < 0
    in_beams = 3 * int(np.count_nonzero(~alone))
    dofs[alone] = np.arange(in_beams, dofs.size).reshape(-1, 3)

    cell_of_element, degree = np.argsort(order), elements.shape[1] - 1
    first, beam_of_element = np.cumsum([0, *counts]), np.repeat(np.arange(len(counts)), counts)
    cells = _split(cell_of_element, first)
    # The chains of all beams: the start of each, then inner nodes and end of each element.
    chain = np.insert(
        elements[:, [*range(2, degree + 1), 1]], first[:-1] * degree, elements[first[:-1], 0]
    )
    nodes_of_beam = _split(chain, first * degree + np.arange(len(first)))
    return dofs, in_beams, beam_of_element[order], cells, nodes_of_beam


def _split(values: np.ndarray, at: np.ndarray) -> list[np.ndarray]:
    """Parts of an array between bounds that rise from its start to its end."""
    bounds = at.tolist()
    return [values[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
