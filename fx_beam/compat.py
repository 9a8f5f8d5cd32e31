"""Every call that differs between dolfinx versions; written for 0.5.2 (Debian 12)."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

import basix
import dolfinx
import ufl
from dolfinx import fem
from dolfinx.fem import assemble

import numpy as np

F = TypeVar("F", bound=Callable)


def quietly(compiling: F) -> F:
    """Keep the compiler's lines out of the user's log.

    The JIT logs its command lines at INFO on the root logger, and leaves that logger with another
    level and a handler of its own.
    """

    @functools.wraps(compiling)
    def wrapper(*args, **kwargs):
        root = logging.getLogger()
        level, handlers, disabled = root.level, root.handlers[:], root.manager.disable
        logging.disable(max(disabled, logging.INFO))
        try:
            return compiling(*args, **kwargs)
        finally:
            root.setLevel(level)
            root.handlers[:] = handlers
            logging.disable(disabled)

    return wrapper  # type: ignore[return-value]


@quietly
def interval_mesh(points: np.ndarray, cells: np.ndarray):
    """Mesh of straight intervals in the plane.

    Parameters
    ----------
    points : (n, 2) float
        Vertices [m].
    cells : (m, 2) int
        First and last vertex of each interval.

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
        The mesh, which numbers cells and vertices anew.
    cell_order : (m,) int
        Row of `cells` that became each cell of the mesh.
    """
    # The explicit variant keeps the signatures of compiled forms, hence the cache, the same
    # from one process to the next. COMM_SELF: each process computes the whole scene.
    cell = ufl.Cell("interval", geometric_dimension=2)
    domain = ufl.Mesh(ufl.VectorElement("Lagrange", cell, 1, dim=2, variant="equispaced"))
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells.astype(np.int64), points, domain)
    return mesh, np.asarray(mesh.topology.original_cell_index)


@quietly
def beam_space(mesh, degree: int):
    """Mixed Lagrange space of displacement (2) and rotation (1) with equispaced nodes."""
    cell = mesh.ufl_cell()
    displacement = ufl.VectorElement("Lagrange", cell, degree, dim=2, variant="equispaced")
    rotation = ufl.FiniteElement("Lagrange", cell, degree, variant="equispaced")
    return fem.FunctionSpace(mesh, ufl.MixedElement([displacement, rotation]))


def function(space):
    """Zero function of a space."""
    return fem.Function(space)


def cell_dofs(space, cell: int) -> tuple[np.ndarray, np.ndarray]:
    """Degrees of freedom of one cell: displacement (nodes, 2) and rotation (nodes,)."""
    u = space.sub(0).dofmap.cell_dofs(cell).reshape(-1, 2)
    return u, space.sub(1).dofmap.cell_dofs(cell)


@quietly
def cellwise(mesh, values: np.ndarray):
    """Function that is constant on each cell, with values (cells, components) or (cells,)."""
    shape = values.shape[1:]
    element = (
        ufl.VectorElement("DG", mesh.ufl_cell(), 0, dim=shape[0])
        if shape
        else ufl.FiniteElement("DG", mesh.ufl_cell(), 0)
    )
    function = fem.Function(fem.FunctionSpace(mesh, element))
    function.x.array[:] = values.ravel()
    return function


def constant(mesh, value):
    """UFL constant whose value may change without a new compilation."""
    return fem.Constant(mesh, value)


def measure(mesh, points: int, tags: np.ndarray | None = None):
    """Measure `dx` with a Gauss rule of the given number of points; `tags` number subdomains."""
    data = None
    if tags is not None:
        cells = np.arange(len(tags), dtype=np.int32)
        data = dolfinx.mesh.meshtags(mesh, 1, cells, tags.astype(np.int32))
    return ufl.Measure(
        "dx",
        domain=mesh,
        subdomain_data=data,
        metadata={"quadrature_degree": 2 * points - 1, "quadrature_rule": "default"},
    )


@quietly
def compile_form(form):
    """Compile a UFL form through FFCx."""
    return fem.form(form)


def gauss_points(points: int) -> np.ndarray:
    """Reference coordinates in [0, 1] of the Gauss rule that `measure` uses."""
    return basix.make_quadrature(basix.CellType.interval, 2 * points - 1)[0]


@quietly
def compile_expression(expression, points: np.ndarray):
    """Compile a UFL expression for evaluation at reference points of every cell."""
    return fem.Expression(expression, points)


def create_matrix(form):
    """Zero matrix in compressed rows, with the sparsity of a compiled bilinear form."""
    return assemble.create_matrix(form)


def assemble_matrix(matrix, form) -> None:
    """Assemble a bilinear form over the old values of `matrix`."""
    matrix.set(0.0)
    fem.assemble_matrix(matrix, form)


def assemble_vector(array: np.ndarray, form) -> None:
    """Assemble a linear form over the old values of `array`."""
    array[:] = 0.0
    fem.assemble_vector(array, form)


def assemble_scalar(form) -> float:
    """Assemble a functional."""
    return float(fem.assemble_scalar(form))
