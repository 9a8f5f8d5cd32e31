"""Every call that differs between dolfinx versions; written for 0.5.2 (Debian 12)."""

from __future__ import annotations

import functools
import logging
import re
from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

import basix
import dolfinx
import ffcx.codegeneration
import ffcx.compiler
import ffcx.parameters
import ufl
from dolfinx import fem
from dolfinx.fem import assemble

import cffi
import numpy as np

_FFI = cffi.FFI()
# Several processes may want one form: they wait for the first, which may have a slow machine.
_JIT = {"timeout": 30}
_log = logging.getLogger("fx_beam")
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
def interval_mesh(points: np.ndarray, cells: np.ndarray, degree: int = 1):
    """Mesh of intervals in the plane, straight or curved.

    Parameters
    ----------
    points : (n, 2) float
        Nodes [m].
    cells : (m, degree + 1) int
        First and last node of each interval, then those inside it.
    degree : int
        Polynomial degree of the geometry.

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
    domain = ufl.Mesh(ufl.VectorElement("Lagrange", cell, degree, dim=2, variant="equispaced"))
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells.astype(np.int64), points, domain)
    return mesh, np.asarray(mesh.topology.original_cell_index)


def _space(mesh, element):
    return fem.FunctionSpace(mesh, element, jit_params=_JIT)


@quietly
def beam_space(mesh, degree: int):
    """Mixed Lagrange space of displacement (2) and rotation (1) with equispaced nodes."""
    cell = mesh.ufl_cell()
    displacement = ufl.VectorElement("Lagrange", cell, degree, dim=2, variant="equispaced")
    rotation = ufl.FiniteElement("Lagrange", cell, degree, variant="equispaced")
    return _space(mesh, ufl.MixedElement([displacement, rotation]))


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
    function = fem.Function(_space(mesh, element))
    function.x.array[:] = values.ravel()
    return function


@quietly
def at_gauss_points(mesh, values: np.ndarray):
    """Function with values (cells, points, components) or (cells, points) at the Gauss points.

    It is the polynomial through them on each cell, discontinuous from cell to cell.
    """
    points, shape = values.shape[1], values.shape[2:]
    element = ufl.FiniteElement("DG", mesh.ufl_cell(), points - 1, variant="equispaced")
    if shape:
        element = ufl.VectorElement(element, dim=shape[0])
    space = _space(mesh, element)
    powers = np.arange(points)
    through = np.linalg.inv(gauss_points(points) ** powers)
    at_nodes = space.element.interpolation_points()[:, :1] ** powers @ through
    function = fem.Function(space)
    nodal = function.x.array.reshape(-1, *shape)
    for cell, own in enumerate(values):
        nodal[space.dofmap.cell_dofs(cell)] = np.tensordot(at_nodes, own, 1)
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


def compile_form(form, name: str):
    """Compile a UFL form through FFCx; the log names it where the cache did not have it."""
    compiled = quietly(fem.form)(form, jit_params=_JIT)
    if any(compiled.code):
        _log.info("compiled the form %r, once", name)
    return compiled


def gauss_points(points: int) -> np.ndarray:
    """Reference coordinates in [0, 1] of the Gauss rule that `measure` uses."""
    return basix.make_quadrature(basix.CellType.interval, 2 * points - 1)[0]


@quietly
def compile_expression(expression, points: np.ndarray):
    """Compile a UFL expression for evaluation at reference points of every cell."""
    return fem.Expression(expression, points, jit_params=_JIT)


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


# -- What the compiled loop takes ------------------------------------------------------------------


def element_dofs(space) -> np.ndarray:
    """Degrees of freedom (cells, n) of all cells, in the order of the element tensors."""
    cells = space.mesh.topology.index_map(1).size_local
    return np.array([space.dofmap.cell_dofs(cell) for cell in range(cells)])


def element_coordinates(mesh) -> np.ndarray:
    """Coordinates (cells, 3 nodes) of the geometry of all cells, as compiled forms take them."""
    cells = mesh.topology.index_map(1).size_local
    x, nodes = mesh.geometry.x, mesh.geometry.dofmap
    return np.array([x[nodes.links(cell)].ravel() for cell in range(cells)])


def integrals(form) -> list[int]:
    """Subdomain of each integral of a compiled form (-1: all cells)."""
    cell = 0  # the first of the types of integrals
    ufcx = form.ufcx_form
    return [ufcx.integral_ids(cell)[i] for i in range(ufcx.num_integrals(cell))]


def signature(form) -> str:
    """What tells a compiled form from others, the version of its compiler included."""
    return _FFI.string(form.ufcx_form.signature).decode() + ffcx.codegeneration.get_signature()


def element_functions(form, ufl_form) -> tuple[str, list[str]]:
    """C of the functions that compute a form's element tensors, and their names by integral."""
    _, source = form.code  # there where it has just been compiled
    if not source:
        parameters = ffcx.parameters.get_parameters()
        _, source = ffcx.compiler.compile_ufl_objects(
            [ufl_form], prefix="batch", parameters=parameters
        )
    functions = re.findall(r"^void tabulate_tensor_\w+\(.*?^}$", source, re.M | re.S)
    (listed,) = re.findall(r"integrals_cell_form_\w+\[\d+\] = {(.*?)}", source)
    return "\n".join(functions), [f"tabulate_tensor_{name}" for name in re.findall(r"\w+", listed)]


def coefficient_offsets(form, functions) -> list[tuple[int, int]]:
    """Which of some functions a compiled form has, and their offsets in its packed coefficients."""
    objects = [function._cpp_object for function in functions]
    found, offset = [], 0
    for coefficient in form.coefficients:
        if coefficient in objects:
            found.append((objects.index(coefficient), offset))
        offset += coefficient.function_space.element.space_dimension
    return found


def packed_coefficients(form) -> dict[int, np.ndarray]:
    """Coefficients (cells, width) of a compiled form on each subdomain."""
    packed = fem.assemble.pack_coefficients(form)
    return {tag: np.array(values) for (_, tag), values in packed.items()}


def packed_constants(form, ufl_form, sought) -> tuple[np.ndarray, list[int]]:
    """Constants of a compiled form, and the places of some of them (-1: not there)."""
    places, at = {}, 0
    for constant in ufl_form.constants():
        places[id(constant)] = at
        at += int(np.prod(constant.ufl_shape, dtype=int))
    return np.array(fem.assemble.pack_constants(form)), [places.get(id(x), -1) for x in sought]
