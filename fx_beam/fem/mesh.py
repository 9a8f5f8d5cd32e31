"""From a scene to elements between nodes, and the table of degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fx_beam.dual import DualFloat, MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, all_of
from fx_beam.scene.beam import Beam, Node, inner_positions
from fx_beam.scene.joints import NodalMotion
from fx_beam.scene.scene import Scene

from .assembly import Space


@dataclass(eq=False)
class Mesh:
    """The mesh of a scene. `X` changes if the scene does, with what follows from it."""

    #: Reference positions (n, 2) [m]: nodes of the scene by number, then nodes inside elements.
    X: np.ndarray
    #: Nodes (cells, degree + 1) of each cell, in order along it; cells are in the order of beams.
    elements: np.ndarray
    #: Cells of each beam, in order along it.
    cells: list[np.ndarray]
    #: Whether the elements are curved, with the beams' degree, or straight.
    curved: bool

    def __post_init__(self):
        degree = self.elements.shape[1] - 1
        #: Degrees of freedom (n, 3) of x, y and rotation of each node.
        self.dofs = np.arange(3 * len(self.X), dtype=np.int32).reshape(-1, 3)
        #: Numbers of all cells.
        self.numbers = np.arange(len(self.elements), dtype=np.int32)
        counts = np.array([len(cells) for cells in self.cells], dtype=int)
        #: Index of each cell's beam in the scene.
        self.beam_of_cell = np.repeat(np.arange(len(counts)), counts)
        ends = np.cumsum(counts)
        nodes = self.elements[:, :-1].ravel()
        nodes = np.insert(nodes, degree * ends, self.elements[ends - 1, -1])
        last = degree * ends + np.arange(1, len(ends) + 1)
        #: Nodes of each beam, in order along it.
        self.nodes: list[np.ndarray] = np.split(nodes, last)[:-1]
        # In the order of forms: both ends, then the inner nodes.
        nodes = self.elements[:, [0, degree, *range(1, degree)]]
        #: Nodes (cells, m) between which each cell lies: all of them, or the ends if straight.
        self.points = nodes if self.curved else nodes[:, :2]
        dofs = self.dofs[nodes]
        #: Space of displacements, then rotations, at the nodes of cells.
        self.unknowns = Space(np.hstack([_rows(dofs[..., :2]), dofs[..., 2]]), self.dofs.size)
        # Positions x and y that were read last, and the array of them, of elements without nodes
        # inside.
        self._columns: tuple[tuple[list[float], list[float]], np.ndarray] = ([], []), self.X
        self._set_positions(self.X)

    def _set_positions(self, X: np.ndarray) -> None:
        self.X = X
        #: Largest extent of the scene [m]; 1 for a single node.
        self.size = float(np.hypot(*np.ptp(X, axis=0))) or 1.0
        ends = X[self.elements[:, [0, -1]]]
        lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        #: Shortest distance of the ends of an element of each beam [m].
        self.shortest = [float(lengths[cells].min()) for cells in self.cells]
        positions = np.zeros((*self.points.shape, 3))
        positions[..., :2] = X[self.points]
        #: Positions (cells, 3 m) of `points` in space [m].
        self.coordinates = _rows(positions)

    @property
    def turns(self) -> np.ndarray:
        """Degrees of freedom (n,) that are rotations."""
        return self.dofs[:, 2]

    def motion(self, scene: Scene, **histories: np.ndarray) -> NodalMotion:
        """Motion as joints of a scene read it, of histories (n, size) "q" and "v"."""
        nodal = {name: rows.reshape(-1, len(self.X), 3) for name, rows in histories.items()}
        return NodalMotion(
            lambda name, node: nodal[name][:, node.number].T,
            lambda name, beam: nodal[name][:, self.nodes_of(scene, beam)],
        )

    def place_of(self, node: int, scene: Scene) -> str:
        """In words where a node is: on which beam, or its position."""
        for beam, nodes in zip(scene.beams, self.nodes, strict=True):
            if node in nodes:
                return f"beam {beam.name!r}"
        x, y = self.X[node]
        return f"the node at ({x:g}, {y:g})"

    def named(self, node: int, scene: Scene) -> str:
        """Number, position and beam of a node, in words."""
        x, y = self.X[node]
        names = (b.name for b, nodes in zip(scene.beams, self.nodes, strict=True) if node in nodes)
        beams = " and ".join(map(repr, names))
        return f"node {node} at ({x:g}, {y:g})" + (beams and f" of {beams}")

    def move(self, X: np.ndarray) -> None:
        """Move the nodes to X (n, 2); arrays that were read from here keep their values."""
        if not all_of(X == self.X):
            self._set_positions(X)

    def positions_of(self, scene: Scene) -> MaybeDual:
        """X (n, 2) [m] of a scene with these nodes; of straight elements with slopes."""
        columns = [node.x for node in scene.nodes], [node.y for node in scene.nodes]
        if self.curved or DualFloat not in {*map(type, columns[0]), *map(type, columns[1])}:
            if self.elements.shape[1] > 2:
                return _positions(scene, *columns)
            last_columns, X = self._columns
            if columns != last_columns:
                X = _positions(scene, *columns)
                self._columns = columns, X
            return X
        points = [dual_array([*zip(*columns, strict=True)])]
        points += [inner_positions(beam) for beam in scene.beams if beam.degree > 1]
        return np.concatenate(points)

    @property
    def positions(self) -> Space:
        """Space of the positions of nodes."""
        dofs = np.arange(self.X.size, dtype=np.int32).reshape(self.X.shape)
        return Space(_rows(dofs[self.points]), self.X.size)

    def space(self, points: int, numbers: int = 1) -> Space:
        """Space of so many numbers at each of some points of a cell, such as Gauss points."""
        cells, width = len(self.elements), points * numbers
        dofs = np.arange(cells * width, dtype=np.int32)
        return Space(dofs.reshape(cells, width), cells * width)

    def nodes_of(self, scene: Scene, target) -> np.ndarray:
        """Nodes of a beam, those inside its elements included, or the node itself."""
        if isinstance(target, Beam):
            return self.nodes[scene.beams.number_of(target.name)]
        return np.array([target.number])


def _rows(nodal: np.ndarray) -> np.ndarray:
    """Values (cells, m k) from values (cells, m, k) at nodes."""
    cells, nodes, values = nodal.shape
    return nodal.reshape(cells, nodes * values)


def rotation_of(node: Node) -> int:
    """Degree of freedom of a node's rotation; -1 for the ground."""
    return 3 * node.number + 2


def build_mesh(scene: Scene) -> Mesh:
    """Mesh of a scene with at least one beam or body."""
    if not (scene.beams or scene.bodies):
        raise SceneError("the scene has no beams. Add one with scene.add_beam, or add_body")
    degree = scene.beams[0].degree if scene.beams else 1
    pairs = [(a.number, b.number) for beam in scene.beams for a, b in pairwise(beam.nodes)]
    ends = np.array(pairs, np.int32).reshape(-1, 2)
    inner = len(scene.nodes) + np.arange(len(ends) * (degree - 1), dtype=np.int32)
    first = np.cumsum([0, *(beam.elements for beam in scene.beams)]).tolist()
    cells = [np.arange(a, b) for a, b in pairwise(first)]
    curved = degree > 1 and any(beam.inner is not None for beam in scene.beams)
    elements = np.hstack([ends[:, :1], inner.reshape(len(ends), degree - 1), ends[:, 1:]])
    columns = [node.x for node in scene.nodes], [node.y for node in scene.nodes]
    return Mesh(_positions(scene, *columns), elements, cells, curved)


def _positions(scene: Scene, x: list[float], y: list[float]) -> np.ndarray:
    """Positions (n, 2): nodes of the scene at x and y, then those inside elements, in order."""
    points = np.empty((len(x), 2))  # filled by columns, twice as fast as by tuples
    points[:, 0], points[:, 1] = x, y
    if not scene.beams or scene.beams[0].degree == 1:
        return points
    return np.vstack([points, *(floats(inner_positions(beam)) for beam in scene.beams)])
