"""Beams from a mesh of dolfinx, such as one that gmsh has made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.mesh import MeshBeams
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section

from .versions import DolfinxMesh, MeshTags, cell_ends, cell_nodes, cell_vertices, fits


class BeamsOfMesh(MeshBeams):
    """Beams of the cells of a mesh of dolfinx, in their order, with tags of cells and points."""

    def __init__(
        self, beams: MeshBeams, nodes: list[Node], mesh: DolfinxMesh, tags: np.ndarray | None
    ):
        super().__init__(nodes, beams.cells)
        self.extend(beams)
        self._mesh, self._tags = mesh, tags

    def tagged(self, tag: int) -> list[Beam]:
        """Beams of the cells with a tag.

        Parameters
        ----------
        tag : int
            A value of ``cell_tags``.

        Returns
        -------
        list of Beams
            In the order of the cells.

        Raises
        ------
        SceneError
            Where no cell has it, or the beams have no tags.
        """
        has_tag = [] if self._tags is None else (self._tags == tag).tolist()
        if not any(has_tag):
            raise SceneError(f"fenicsx: tagged: no cell has the tag {tag} in the cell_tags")
        return [beam for beam, chosen in zip(self, has_tag, strict=True) if chosen]

    def nodes_of(self, facet_tags: MeshTags, tag: int) -> list[Node]:
        """Nodes at the points with a tag, such as supports.

        Parameters
        ----------
        facet_tags : dolfinx.mesh.MeshTags
            Tags of points of the mesh.
        tag : int
            One of their values.

        Returns
        -------
        list of Nodes
            In the order of the points.

        Raises
        ------
        SceneError
            For tags that are not those of points of this mesh, and where no point has it.
        """
        if facet_tags.dim != 0 or not fits(facet_tags, self._mesh):
            raise SceneError("fenicsx: nodes_of: the tags must be those of points of the mesh")
        vertices = facet_tags.indices[facet_tags.values == tag]
        if not len(vertices):
            raise SceneError(f"fenicsx: nodes_of: no point has the tag {tag}")
        row = dict(zip(cell_vertices(self._mesh).flat, cell_ends(self._mesh).flat, strict=True))
        return [self.nodes[row[vertex]] for vertex in vertices]


def beams_of(
    scene: Scene,
    mesh: DolfinxMesh,
    section: Section | Mapping[int, Section],
    cell_tags: MeshTags | None = None,
    **options: Any,
) -> BeamsOfMesh:
    """Add a beam for each cell of a mesh of intervals to a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane, as of ``dolfinx.io.gmshio``; of points in space z is left out.
    section : Section or dict
        Cross-section of all, or sections by tag.
    cell_tags : dolfinx.mesh.MeshTags, optional
        Tags of the cells, which choose their sections.
    **options
        ``elements``, ``degree``, ``joints`` and ``join`` of `Scene.add_mesh`.

    Returns
    -------
    list of Beams
        The beams in the order of the cells; ``beams.nodes[i]`` is the node at row i of
        ``mesh.geometry.x``, None in the middle of a line. ``beams.tagged(2)`` are the beams of
        cells with a tag, ``beams.nodes_of(facet_tags, 7)`` the nodes at points with one.

    Raises
    ------
    SceneError
        For cells that are no straight intervals, a part of a mesh, cells without a tag, and for
        what `Scene.add_mesh` refuses.

    Notes
    -----
    Lines of second order, as of gmsh, become elements of degree 2.

    Examples
    --------
    >>> import fx_beam as fb
    >>> from dolfinx.mesh import create_unit_interval
    >>> from fx_beam import fenicsx
    >>> from mpi4py import MPI
    >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=1.0)
    >>> beams = fenicsx.beams_of(scene, create_unit_interval(MPI.COMM_SELF, 3), section)
    >>> len(beams), len(scene.nodes)
    (3, 4)
    """
    count, X = mesh.topology.index_map(mesh.topology.dim), mesh.geometry.x[:, :2]
    rows = cell_nodes(mesh) if mesh.topology.dim == 1 else np.zeros((1, 4), int)
    middles, inner = X[rows[:, :2]].mean(axis=1, keepdims=True), rows[:, 2:]
    if inner.shape[1] > 1 or (abs(X[inner] - middles) > 1e-9 * np.ptp(X)).any():
        raise SceneError(
            "fenicsx: beams_of: the cells of the mesh must be straight intervals of order 1 or 2, "
            "with nodes in their middle. Curved members: scene.add_beam"
        )
    if count.size_global != count.size_local:
        raise SceneError(
            "fenicsx: beams_of: this process has a part of the mesh. Read it on each process as a "
            "whole, with MPI.COMM_SELF: the scene is whole on each"
        )
    tags: np.ndarray | None = None
    if cell_tags is not None:
        tags = np.full(count.size_local, np.iinfo(np.int32).min)
        tags[cell_tags.indices] = cell_tags.values
        if not isinstance(section, Mapping):
            section = dict.fromkeys(tags.tolist(), section)
    if inner.size:
        options = {"elements": 1, "degree": 2} | options
    points, cells = np.unique(rows[:, :2], return_inverse=True)
    beams = scene.add_mesh(X[points], cells.reshape(-1, 2), section, tags=tags, **options)
    nodes: list[Any] = [None] * len(X)
    for row, node in zip(points, beams.nodes, strict=True):
        nodes[row] = node
    return BeamsOfMesh(beams, nodes, mesh, tags)
