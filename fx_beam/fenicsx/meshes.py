"""Beams from a mesh of dolfinx, such as one that gmsh has made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.mesh import MeshBeams
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section

from .versions import Mesh, MeshTags, cell_nodes, count_cells


def beams_of(
    scene: Scene,
    mesh: Mesh,
    section: Section | Mapping[int, Section],
    cell_tags: MeshTags | None = None,
    **options: Any,
) -> MeshBeams:
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
    MeshBeams
        The beams in the order of the cells; ``beams.nodes[i]`` is the node at row i of
        ``mesh.geometry.x``.

    Raises
    ------
    SceneError
        For cells that are no straight intervals, a part of a mesh, cells without a tag, and for
        what `Scene.add_mesh` refuses.

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
    count, nodes = mesh.topology.index_map(1), mesh.geometry.x
    if mesh.topology.dim != 1 or cell_nodes(mesh, 1).size != 2 * count_cells(mesh)[1]:
        raise SceneError("fenicsx: beams_of: the cells of the mesh must be straight intervals")
    if count.size_global != count.size_local:
        raise SceneError(
            "fenicsx: beams_of: this process has a part of the mesh. Read it on each process as a "
            "whole, with MPI.COMM_SELF: the scene is whole on each"
        )
    tags: np.ndarray | None = None
    if cell_tags is not None:
        tags = np.full(count.size_local, np.iinfo(np.int32).min)
        tags[cell_tags.indices] = cell_tags.values
    return scene.add_mesh(nodes[:, :2], cell_nodes(mesh, 2), section, tags=tags, **options)
