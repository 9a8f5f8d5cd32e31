"""The elements of all beams of a scene as a mesh of dolfinx, and values on it."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, require
from fx_beam.fem import elements
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import Beam, Node, gauss_rule
from fx_beam.scene.scene import Scene

from .versions import (
    CompiledExpression,
    Element,
    MeshTags,
    cell_dofs,
    cell_nodes,
    cell_vertices,
    compiled_expression,
    count_cells,
    create_mesh,
    exterior_facets,
    function_space,
    values_of,
)


class Grid:
    """A mesh of dolfinx with the elements of a scene; each process has a part of them.

    Values of elements (cells, ...) are in the scene's order, and of all of them.
    """

    def __init__(self, scene: Scene, nodes: Mesh, beams: BeamForms, comm: MPI.Comm):
        self.scene, self._nodes, self.beams, self.comm = scene, nodes, beams, comm
        self.degree = degree = beams.kind.degree
        element = elements.lagrange(degree if nodes.curved else 1, 2)
        points = nodes.points.astype(np.int64)
        #: Intervals in the plane. At joints vertices coincide.
        self.mesh = create_mesh(comm, points, nodes.X, element)
        #: Number in the scene of each element that this process has.
        self.cells = np.asarray(self.mesh.topology.original_cell_index)
        X = self.mesh.geometry.x[cell_nodes(self.mesh, points.shape[1]), :2]
        assert np.array_equal(X, nodes.X[points][self.cells])  # dolfinx keeps the order of nodes
        self._beam_tags = self.tagged(nodes.beam_of_cell)
        # Compiled, by expression and points.
        self._expressions: dict[tuple[Expr, bytes], CompiledExpression] = {}
        self._spaces: dict[Element, fem.FunctionSpace] = {}

    def space(self, element: Element) -> fem.FunctionSpace:
        """A function space, one for each element: it takes as long as several steps."""
        if element not in self._spaces:
            self._spaces[element] = function_space(self.mesh, element)
        return self._spaces[element]

    def tagged(self, tags: np.ndarray) -> MeshTags:
        """Tags of elements as tags of the mesh of dolfinx."""
        numbers = np.arange(len(self.cells), dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 1, numbers, tags[self.cells].astype(np.int32))

    def numbers(self, space: fem.FunctionSpace, cell_numbers: np.ndarray) -> np.ndarray:
        """The number of each degree of freedom of a space, from numbers (cells, width) in cells."""
        dofs = cell_dofs(space)
        numbers = np.zeros(dofs.max(initial=-1) + 1, dtype=PETSc.IntType)
        numbers[dofs] = cell_numbers[self.cells]
        return numbers

    def fill(self, function: fem.Function, cell_values: np.ndarray) -> None:
        """Set a Function by its values (cells, ...)."""
        values = cell_values.reshape(len(cell_values), -1)[self.cells]
        function.x.array[cell_dofs(function.function_space)] = values

    def _gathered(self, own_values: np.ndarray) -> np.ndarray:
        """Values (cells, ...) from the values of the cells that each process owns."""
        owned, _ = count_cells(self.mesh)
        values = np.zeros((len(self._nodes.points), *own_values.shape[1:]))
        values[self.cells[:owned]] = own_values
        return self.total(values)

    def total(self, values: np.ndarray) -> np.ndarray:
        """The sum over all processes, in place."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, values)
        return values

    # -- Integrals ---------------------------------------------------------------------------------

    def measure(self, place: Beam | Node | None, points: int | None) -> ufl.Measure:
        """Measure of a beam, of all, or of a node, by a Gauss rule; see `Steps.measure`."""
        domain = self.mesh.ufl_domain()
        if isinstance(place, Node):
            ends = self._ends_at(place)
            return ufl.Measure("ds", domain=domain, subdomain_data=ends)(1)
        dx = elements.measure(domain, points or self.degree)(subdomain_data=self._beam_tags)
        if place is None:
            return dx
        if place not in self.scene.beams:
            raise SceneError(f"fenicsx: measure: {place} is no beam of this scene")
        return dx(self.scene.beams.index(place))

    def _ends_at(self, node: Node) -> MeshTags:
        """Tags of the vertices in which a single element ends at a node."""
        numbers = self._nodes.points[self.cells][:, :2]
        vertices = np.unique(cell_vertices(self.mesh)[numbers == node.number])
        ends = vertices[np.isin(vertices, exterior_facets(self.mesh))].astype(np.int32)
        if not self.comm.allreduce(len(ends)):
            raise SceneError(
                f"fenicsx: measure: {node} is no end of the mesh, but an inner node of beams. Use "
                "scene.add_force for a force on it"
            )
        return dolfinx.mesh.meshtags(self.mesh, 0, ends, np.ones(len(ends), np.int32))

    # -- Values ------------------------------------------------------------------------------------

    def at_points(
        self, expression: Expr | list[Expr], points: ArrayLike | None = None
    ) -> np.ndarray:
        """Values (cells, points, ...) of a UFL expression, or of a list with one a material."""
        expressions = expression if isinstance(expression, list) else [expression]
        tags = self.beams.data.tags if isinstance(expression, list) else 0 * self.beams.data.tags
        for part in expressions:
            ok = isinstance(part, Expr) and ufl.domain.extract_domains(part)
            require(
                ok, "fenicsx: expression", part, "in UFL, with something that depends on the mesh"
            )
        places = gauss_rule(self.degree)[0] if points is None else np.asarray(points, float)
        owned_cells = self.cells[: count_cells(self.mesh)[0]]
        values = np.empty((len(owned_cells), len(places), *expressions[0].ufl_shape))
        for number, part in enumerate(expressions):
            key = part, places.tobytes()
            if key not in self._expressions:
                self._expressions[key] = compiled_expression(part, places[:, None])
            chosen = np.flatnonzero(tags[owned_cells] == number)
            computed = values_of(self._expressions[key], self.mesh, chosen)
            values[chosen] = computed.reshape(len(chosen), len(places), *part.ufl_shape)
        return self._gathered(values)

    def interpolated(self, values: np.ndarray, name: str) -> fem.Function:
        """A discontinuous Function with values (cells, degree, ...) at the Gauss points."""
        p, exponents = self.degree, np.arange(self.degree)
        places = [0.5] if p == 1 else [0.0, 1.0, *np.linspace(0, 1, p)[1:-1]]
        interpolation = np.power.outer(places, exponents)
        interpolation = interpolation @ np.linalg.inv(np.power.outer(gauss_rule(p)[0], exponents))
        element = elements.lagrange(p - 1, *values.shape[2:], broken=True)
        function = fem.Function(self.space(element), name=name)
        self.fill(function, np.einsum("np,cp...->cn...", interpolation, values))
        return function
