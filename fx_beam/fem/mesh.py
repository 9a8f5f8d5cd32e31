"""From a scene to a dolfinx mesh and the table of degrees of freedom."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import Beam
from fx_beam.scene.scene import Scene

from . import dolfinx_api


@dataclass(frozen=True)
class Mesh:
    """The mesh of a scene.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane: straight, or of the beams' degree where one of them is curved.
    space : dolfinx.fem.FunctionSpace
        Displacement and rotation.
    X : (n, 2) float
        Reference positions of the nodes [m]: the scene's nodes by their number, then the nodes
        inside elements of degree 2 and 3.
    dofs : (n, 3) int
        Degrees of freedom of x, y and rotation of each node.
    beam_of_cell : (cells,) int
        Place of each cell's beam in the scene.
    cells : list of (elements,) int arrays
        Cells of each beam, in order along it.
    nodes : list of (elements * degree + 1,) int arrays
        Nodes of each beam, in order along it.
    """

    mesh: Any
    space: Any
    X: np.ndarray
    dofs: np.ndarray
    beam_of_cell: np.ndarray
    cells: list[np.ndarray]
    nodes: list[np.ndarray]

    @functools.cached_property
    def size(self) -> float:
        """Largest extent of the scene [m]."""
        return float(np.hypot(*np.ptp(self.X, axis=0)))

    def to_nodes(self, vector: np.ndarray) -> np.ndarray:
        """Values (n_node, 3) at the nodes of a vector (size,) over all degrees of freedom."""
        return vector[self.dofs]

    def from_nodes(self, values: np.ndarray) -> np.ndarray:
        """Vector (size,) over all degrees of freedom of values (n_node, 3) at the nodes."""
        vector = np.empty(self.dofs.size)
        vector[self.dofs] = values
        return vector

    def nodes_of(self, scene: Scene, target) -> np.ndarray:
        """Nodes of a beam, those inside its elements included, or the one node itself."""
        if isinstance(target, Beam):
            return self.nodes[scene.beams.index(target)]
        return np.array([target.number])


def build_mesh(scene: Scene) -> Mesh:
    """Mesh of a scene.

    Parameters
    ----------
    scene : Scene
        At least one beam.

    Returns
    -------
    Mesh
        Mesh, function space and numbering.

    Raises
    ------
    SceneError
        For a scene without beams.
    """
    if not scene.beams:
        raise SceneError("the scene has no beams; add one with scene.add_beam")
    degree = scene.beams[0].degree
    points = np.array([(node.x, node.y) for node in scene.nodes])
    ends = [
        (a.number, b.number)
        for beam in scene.beams
        for a, b in zip(beam.nodes[:-1], beam.nodes[1:], strict=True)
    ]
    # Nodes inside elements are numbered after the scene's own, element by element.
    X = np.vstack([points, *(_inner(beam) for beam in scene.beams)])
    inner = len(points) + np.arange(len(ends) * (degree - 1)).reshape(len(ends), degree - 1)
    nodes_of_element = np.hstack([ends, inner])
    if degree > 1 and any(beam.inner is not None for beam in scene.beams):
        mesh, order = dolfinx_api.interval_mesh(X, nodes_of_element, degree)
    else:
        mesh, order = dolfinx_api.interval_mesh(points, np.array(ends))
    space = dolfinx_api.beam_space(mesh, degree)
    dofs = np.full((len(X), 3), -1)
    dofs[nodes_of_element[order]] = dolfinx_api.dofs_of_cells(space)

    cell_of_element = np.argsort(order)
    counts = [beam.elements for beam in scene.beams]
    first, beam_of_element = np.cumsum([0, *counts]), np.repeat(np.arange(len(counts)), counts)
    cells, nodes_of_beam = [], []
    for number in range(len(scene.beams)):
        elements = np.arange(*first[number : number + 2])
        cells.append(cell_of_element[elements])
        chain = [ends[elements[0]][0]]
        for e in elements:
            chain += [*inner[e], ends[e][1]]
        nodes_of_beam.append(np.array(chain))
    return Mesh(mesh, space, X, dofs, beam_of_element[order], cells, nodes_of_beam)


def _inner(beam: Beam) -> np.ndarray:
    """Places (elements * (degree - 1), 2) of the nodes inside the elements of a beam."""
    if beam.inner is not None:
        return beam.inner.reshape(-1, 2)
    if beam.degree == 1:
        return np.empty((0, 2))
    points = np.array([(node.x, node.y) for node in beam.nodes])
    fractions = np.arange(1, beam.degree)[:, None] / beam.degree
    return (points[:-1, None] + fractions * np.diff(points, axis=0)[:, None]).reshape(-1, 2)
