"""Elements between nodes, the table of degrees of freedom, and sparse matrices of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from fx_beam.content_cache import cached_by_content
from fx_beam.dual import DualFloat, MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, all_of
from fx_beam.scene.beam import Beam, Node, inner_positions
from fx_beam.scene.joints import NodalMotion
from fx_beam.scene.scene import Scene

from .compiled_forms import Space

# -- Sparse matrices in compressed rows: where their entries are, and with more of them ---------


#: Sparsity (indptr, indices) of a matrix in compressed rows.
Pattern = tuple[np.ndarray, np.ndarray]


def starts_of(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    """Starts (n,) of parts of some counts, and the end of the last one."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(int)


def sparsity(rows: np.ndarray, columns: np.ndarray, n: int) -> tuple[Pattern, np.ndarray]:
    """Compressed rows of the given pairs, and the position of each pair in them."""
    keys = rows.astype(int) * n + columns
    if (keys[1:] > keys[:-1]).all():
        position = np.arange(len(keys), dtype=np.int32)
    else:
        keys, position = np.unique(keys, return_inverse=True)
        rows, columns = np.divmod(keys, n)
    indptr = starts_of(np.bincount(rows, minlength=n)).astype(np.int32)
    return (indptr, columns.astype(np.int32)), position.astype(np.int32, copy=False)


@cached_by_content
def connected_parts(pairs: np.ndarray, count: int) -> np.ndarray:
    """Number (count,) of the part to which each node belongs; pairs (2, n) are connected."""
    graph = scipy.sparse.coo_matrix((np.ones(pairs.shape[1]), tuple(pairs)), (count, count))
    return connected_components(graph, directed=False)[1]


def positions_in(
    indptr: np.ndarray, indices: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Indices (n,) of the entries at some rows and columns (n,), in a square matrix in order."""
    size = len(indptr) - 1
    keys = np.repeat(np.arange(size), np.diff(indptr)) * size + indices
    return np.searchsorted(keys, rows.astype(int) * size + columns).astype(np.int32)


def places_of_cells(dofs: np.ndarray, indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Indices (cells, n * n) of the entries of cells with degrees of freedom (cells, n).

    In each row the three columns of a node are beside each other.
    """
    cells, n = dofs.shape
    if not cells:
        return np.empty((0, n * n), np.int32)
    node, component = np.divmod(dofs[0], 3)
    _, some, number = np.unique(node, return_index=True, return_inverse=True)
    columns = dofs[:, None, some] // 3 * 3
    first = positions_in(indptr, indices, dofs[:, :, None], columns)
    return (first[:, :, number] + component).reshape(cells, n * n)


def blocks_with(
    entries: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of 3 x 3 that have some of the entries: starts of their rows, columns, and positions.

    The latter (n, 3, 3) are those of all entries.
    """
    nodes, places = (len(indptr) - 1) // 3, np.flatnonzero(entries)
    rows = (np.searchsorted(indptr, places, side="right") - 1) // 3
    row, column = np.divmod(np.unique(rows * nodes + indices[places] // 3), nodes)
    block_rows = 3 * row[:, None] + np.arange(3)
    first = positions_in(
        indptr, indices, block_rows, np.broadcast_to(3 * column[:, None], block_rows.shape)
    )
    starts = np.searchsorted(row, np.arange(nodes + 1))
    return starts, column, first[:, :, None] + np.arange(3, dtype=np.int32)


def matrix_between(elements: np.ndarray, nodes: int) -> scipy.sparse.csr_matrix:
    """Sparsity with a block of 3 x 3 for each node, and for each two nodes of an element."""
    numbers, n = np.arange(nodes), elements.shape[1]
    row = np.append(numbers, np.repeat(elements, n, axis=1))
    column = np.append(numbers, np.tile(elements, (1, n)))
    pairs = scipy.sparse.csr_matrix((np.ones(len(row)), (row, column)))
    matrix = scipy.sparse.kron(pairs, np.ones((3, 3)), "bsr").tocsr()
    matrix.data = np.zeros(matrix.nnz, np.int8)
    return matrix


def with_pairs(matrix: scipy.sparse.csr_matrix, pairs: np.ndarray) -> scipy.sparse.csr_matrix:
    """Sparsity with more entries, at some rows and columns (n, 2); itself for none."""
    if not len(pairs):
        return matrix
    existing = np.ones(matrix.nnz), matrix.indices, matrix.indptr
    added = scipy.sparse.csr_matrix((np.ones(len(pairs)), tuple(pairs.T)), matrix.shape)
    union = scipy.sparse.csr_matrix(existing, matrix.shape) + added
    union.data = np.zeros(union.nnz, np.int8)
    return union


# -- From a scene to elements between nodes, and the table of degrees of freedom ----------------


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
        rows_of_beams: dict[tuple[str, str], np.ndarray] = {}  # many nodes may slide on a beam

        def rows_of_beam(name: str, beam: Beam) -> np.ndarray:
            if (key := (name, beam.name)) not in rows_of_beams:
                rows_of_beams[key] = nodal[name][:, self.nodes_of(scene, beam)]
            return rows_of_beams[key]

        return NodalMotion(lambda name, node: nodal[name][:, node.number].T, rows_of_beam)

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
