"""Meshes of dolfinx: all beams of a scene as one, and beams from one such as of gmsh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError
from fx_beam.fem import elements
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import Beam, Node, gauss_rule, lagrange
from fx_beam.scene.curve import MeshBeams
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section

from . import versions

# -- The elements of all beams of a scene as a mesh of dolfinx, and values on it ----------------


class BeamMesh:
    """A mesh of dolfinx with the elements of a scene; each process has a part of them.

    Values of elements (cells, ...) are in the scene's order, and of all of them.
    """

    def __init__(
        self,
        scene: Scene,
        nodes: Mesh,
        beams: BeamForms,
        comm: MPI.Comm,
        mesh: dolfinx.mesh.Mesh | None = None,
    ):
        self.scene, self._nodes, self.beams, self.comm = scene, nodes, beams, comm
        self.degree = degree = beams.kind.degree
        element = elements.lagrange(degree if nodes.curved else 1, 2)
        points = nodes.points.astype(np.int64)
        if mesh is not None:
            self._check(mesh)
        #: Intervals in the plane. At joints vertices coincide.
        self.mesh = mesh or versions.create_mesh(comm, points, nodes.X, element)
        #: Number in the scene of each element that this process has.
        self.cells = np.asarray(self.mesh.topology.original_cell_index)
        if mesh is not None:
            self.cells = np.arange(len(points))
        X = self.mesh.geometry.x[versions.cell_nodes(self.mesh)[:, :2], :2]
        assert np.array_equal(X, nodes.X[points[:, :2]][self.cells])  # dolfinx keeps their order
        #: Number of the beam of each element, and of the node at each vertex that is an end.
        self.cell_tags, self.end_tags = self.tagged(nodes.beam_of_cell), self._tagged_ends()
        #: Number of the material of each element.
        self.materials = self.tagged(beams.data.tags)
        # Compiled, by expression and points.
        self._expressions: dict[tuple[Expr, bytes], versions.CompiledExpression] = {}
        self._spaces: dict[versions.Element, fem.FunctionSpace] = {}

    def _check(self, mesh: dolfinx.mesh.Mesh) -> None:
        """Refuse a mesh whose cells are not the elements of the scene, one by one."""
        ends = self._nodes.points[:, :2]
        is_it = mesh.geometry.dim == 2 and mesh.topology.dim == 1 and mesh.comm.size == 1
        if is_it and (rows := versions.cell_nodes(mesh)[:, :2]).shape == ends.shape:
            pairs = np.unique(np.column_stack([rows.ravel(), ends.ravel()]), axis=0)
            is_it = np.array_equal(mesh.geometry.x[rows, :2], self._nodes.X[ends])
            is_it = is_it and all(len(np.unique(side)) == len(pairs) for side in pairs.T)
            if is_it:
                return
        raise SceneError(
            "fenicsx: mesh: its cells are not the elements of the scene. All beams must be those "
            "of beams_of(scene, mesh, ..., elements=1) with this mesh in the plane, rigid where "
            "they meet, on one process. Else leave out `mesh`: problem.cell_map has the cell of "
            "each element"
        )

    def space(self, element: versions.Element) -> fem.FunctionSpace:
        """A function space, one for each element: it takes as long as several steps."""
        if element not in self._spaces:
            self._spaces[element] = versions.function_space(self.mesh, element)
        return self._spaces[element]

    def tagged(self, tags: np.ndarray) -> versions.MeshTags:
        """Tags of elements as tags of the mesh of dolfinx."""
        numbers = np.arange(len(self.cells), dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 1, numbers, tags[self.cells].astype(np.int32))

    def numbers(self, space: fem.FunctionSpace, cell_numbers: np.ndarray) -> np.ndarray:
        """The number of each degree of freedom of a space, from numbers (cells, width) in cells."""
        return self.in_space(space, cell_numbers).astype(PETSc.IntType)

    def in_space(self, space: fem.FunctionSpace, cell_values: np.ndarray) -> np.ndarray:
        """The array of a Function in a space that has values (cells, ...)."""
        dofs = versions.cell_dofs(space)
        values = np.zeros(dofs.max(initial=-1) + 1)
        values[dofs] = cell_values.reshape(len(cell_values), -1)[self.cells]
        return values

    def total(self, values: np.ndarray) -> np.ndarray:
        """The sum over all processes, in place."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, values)
        return values

    # -- Integrals ---------------------------------------------------------------------------------

    def measure(
        self, place: Beam | Sequence[Beam] | Node | None, points: int | None
    ) -> ufl.Measure:
        """Measure of beams, of all, or of a node, by a Gauss rule; see `Steps.measure`."""
        domain = self.mesh.ufl_domain()
        if isinstance(place, Node):
            if not self.comm.allreduce(int((self.end_tags.values == place.number).sum())):
                raise SceneError(
                    f"fenicsx: measure: {place} is no end of the mesh, but an inner node of beams. "
                    "Use scene.add_force for a force on it"
                )
            return ufl.Measure("ds", domain=domain, subdomain_data=self.end_tags)(place.number)
        dx = elements.measure(domain, points or self.degree)(subdomain_data=self.cell_tags)
        if place is None:
            return dx
        beams = [*place] if isinstance(place, Sequence) else [place]
        for beam in beams:
            if not isinstance(beam, Beam) or not self.scene.beams.has(beam):
                raise SceneError(
                    f"fenicsx: measure: {beam} is no beam of this scene. By numbers: dx(i), by "
                    "tags of a mesh: measure(beams.tagged(2))"
                )
        return dx(tuple(self.scene.beams.number_of(beam.name) for beam in beams))

    def over_beams(self, form: ufl.Form) -> ufl.Form:
        """A form with the tags of beams, if it has those of materials or none, to add to others."""
        materials, parts = {*zip(self._nodes.beam_of_cell, self.beams.data.tags, strict=True)}, []
        for part in form.integrals():
            tags, number = part.subdomain_data(), part.subdomain_id()
            if tags is self.materials:
                beams = sorted(int(beam) for beam, k in materials if k == number)
                number = tuple(beams) or "everywhere"
            if tags is self.materials or (tags is None and part.integral_type() == "cell"):
                part = part.reconstruct(subdomain_id=number, subdomain_data=self.cell_tags)
            parts.append(part)
        return ufl.Form(parts)

    def _tagged_ends(self) -> versions.MeshTags:
        """Numbers of the nodes at the vertices in which a single element ends."""
        numbers, vertices = self._nodes.points[self.cells][:, :2], versions.cell_vertices(self.mesh)
        number = np.zeros(vertices.max(initial=-1) + 1, np.int32)
        number[vertices] = numbers
        self.mesh.topology.create_connectivity(0, 1)
        ends = np.sort(dolfinx.mesh.exterior_facet_indices(self.mesh.topology)).astype(np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 0, ends, number[ends])

    # -- Values ------------------------------------------------------------------------------------

    def at_points(self, expressions: Sequence[Expr], points: ArrayLike | None = None) -> np.ndarray:
        """Values (cells, points, ...) of an expression in UFL for each material, or of one."""
        tags = self.beams.data.tags if len(expressions) > 1 else 0 * self.beams.data.tags
        places = gauss_rule(self.degree)[0] if points is None else np.asarray(points, float)
        owned_cells = self.cells[: versions.count_cells(self.mesh)[0]]
        values = np.zeros((len(tags), len(places), *expressions[0].ufl_shape))
        for number, part in enumerate(expressions):
            key = part, places.tobytes()
            if key not in self._expressions:
                zero = fem.Constant(self.mesh, np.zeros(part.ufl_shape))  # of numbers, too
                self._expressions[key] = versions.compiled_expression(part + zero, places[:, None])
            chosen = np.flatnonzero(tags[owned_cells] == number)
            computed = versions.values_of(self._expressions[key], self.mesh, chosen)
            values[owned_cells[chosen]] = computed.reshape(len(chosen), *values.shape[1:])
        return self.total(values)

    def interpolated(self, values: np.ndarray, name: str) -> fem.Function:
        """A discontinuous Function with values (cells, degree, ...) at the Gauss points."""
        p = self.degree
        places = [0.5] if p == 1 else [0.0, 1.0, *np.linspace(0, 1, p)[1:-1]]
        interpolation = lagrange(gauss_rule(p)[0], np.array(places))
        element = elements.lagrange(p - 1, *values.shape[2:], broken=True)
        function = fem.Function(self.space(element), name=name)
        values = np.einsum("np,cp...->cn...", interpolation, values)
        function.x.array[:] = self.in_space(function.function_space, values)
        return function


# -- Beams from a mesh of dolfinx, such as one that gmsh has made -------------------------------


class BeamsOfMesh(MeshBeams):
    """Beams of the cells of a mesh of dolfinx, in their order, with tags of cells and points."""

    def __init__(
        self, beams: MeshBeams, nodes: list[Node], mesh: dolfinx.mesh.Mesh, tags: np.ndarray | None
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

    def nodes_of(self, facet_tags: versions.MeshTags, tag: int) -> list[Node]:
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
        if facet_tags.dim != 0 or not versions.fits(facet_tags, self._mesh):
            raise SceneError("fenicsx: nodes_of: the tags must be those of points of the mesh")
        vertices = facet_tags.indices[facet_tags.values == tag]
        if not len(vertices):
            raise SceneError(f"fenicsx: nodes_of: no point has the tag {tag}")
        row = dict(
            zip(
                versions.cell_vertices(self._mesh).flat,
                versions.cell_nodes(self._mesh)[:, :2].flat,
                strict=True,
            )
        )
        return [self.nodes[row[vertex]] for vertex in vertices]


def beams_of(
    scene: Scene,
    mesh: dolfinx.mesh.Mesh,
    section: Section | Mapping[int, Section],
    cell_tags: versions.MeshTags | None = None,
    **options: Any,
) -> BeamsOfMesh:
    """Add a beam for each cell of a mesh of intervals to a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    mesh : dolfinx.mesh.Mesh
        Intervals in the plane, as ``dolfinx.io.gmshio`` reads them; z of points in space is
        ignored.
    section : Section or dict
        Cross-section of all beams, or a dict of sections by tag.
    cell_tags : dolfinx.mesh.MeshTags, optional
        Tags of the cells, by which their sections are chosen.
    **options
        ``elements``, ``degree``, ``joints`` and ``join`` of `Scene.add_mesh`.

    Returns
    -------
    list of Beams
        The beams in the order of the cells; ``beams.nodes[i]`` is the node at row i of
        ``mesh.geometry.x``, or None for a point in the middle of an interval. ``beams.tagged(2)``
        are the beams of the cells with the tag 2, ``beams.nodes_of(facet_tags, 7)`` the nodes at
        points with the tag 7.

    Raises
    ------
    SceneError
        For cells that are no straight intervals, a mesh shared by several processes, cells without
        a tag, and in the cases of `Scene.add_mesh`.

    Notes
    -----
    Intervals of second order, as gmsh makes them, become elements of degree 2.

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
    rows = versions.cell_nodes(mesh) if mesh.topology.dim == 1 else np.zeros((1, 4), int)
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
