"""Differences between versions of dolfinx: 0.5, 0.9, 0.10 and 0.11."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI  # before dolfinx: only then are the libraries of its wheel found
from petsc4py import PETSc  # noqa: F401

import dolfinx
import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np

from fx_beam.fem import ffcx_api

_log = logging.getLogger("fx_beam")
DolfinxMesh = dolfinx.mesh.Mesh
#: What versions type in different ways: elements of UFL or of basix, tags, and what is compiled.
Element = Any
MeshTags = Any
CompiledForm = Any
CompiledExpression = Any
# All options of compilers: dolfinx would else look for more in the current folder and in the home.
_DEFAULTS = next(x for name, x in vars(dolfinx.jit).items() if name.startswith("DOLFINX_DEFAULT"))
_OPTIONS = {
    "form_compiler": ffcx_api.OPTIONS,
    "jit": {name: value for name, (value, _) in _DEFAULTS.items()},
}
for _file in filter(Path.is_file, map(Path, (".petscrc", "petscrc"))):
    _log.warning(
        "PETSc takes options of %s in the current folder: they may act in fx_beam.fenicsx, too",
        _file,
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Compile without the lines of the compiler, which setuptools would show from here on."""
    root = logging.getLogger()
    disabled_level, level, handlers = root.manager.disable, root.level, root.handlers[:]
    logging.disable(logging.INFO)
    try:
        yield
    finally:
        logging.disable(disabled_level)
        root.setLevel(level)
        root.handlers[:] = handlers


def _takes(function: Callable, name: str) -> bool:
    return name in inspect.signature(function).parameters


def _compiling(function: Callable[..., Any], *arguments: object) -> Any:
    """The value of a function of dolfinx that compiles."""
    names = ((f"{kind}_{word}", kind) for kind in _OPTIONS for word in ("params", "options"))
    options = {name: _OPTIONS[kind].copy() for name, kind in names if _takes(function, name)}
    with quiet():
        return function(*arguments, **options)


def compiled(form: ufl.Form) -> CompiledForm:
    """A form of dolfinx."""
    return _compiling(fem.form, form)


@quiet()
def create_mesh(comm: MPI.Comm, cells: np.ndarray, X: np.ndarray, element: Element) -> DolfinxMesh:
    """A mesh of intervals in the plane, which may branch; each process has a part of its cells."""
    make = dolfinx.mesh.create_mesh
    options: dict[str, object] = {"e" if _takes(make, "e") else "domain": ufl.Mesh(element)}
    if _takes(make, "max_facet_to_cell_links"):
        options["max_facet_to_cell_links"] = max(2, int(np.bincount(cells[:, :2].ravel()).max()))
    if _takes(make, "ghost_mode"):
        options["ghost_mode"] = dolfinx.mesh.GhostMode.none
    first = comm.rank == 0  # from which dolfinx distributes them
    return make(comm, cells=cells[: len(cells) * first], x=X[: len(X) * first], **options)


def function_space(mesh: DolfinxMesh, element: Element) -> fem.FunctionSpace:
    """A function space."""
    return _compiling(getattr(fem, "functionspace", fem.FunctionSpace), mesh, element)


def _rows(table: object, width: int) -> np.ndarray:
    """Numbers (cells, width) of a list of lists, or of a table."""
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)


def count_cells(mesh: DolfinxMesh) -> tuple[int, int]:
    """Number of cells that this process owns, and number that it has, copies included."""
    cells = mesh.topology.index_map(1)
    return cells.size_local, cells.size_local + cells.num_ghosts


def cell_dofs(space: fem.FunctionSpace) -> np.ndarray:
    """Degrees of freedom (cells, width) of a space; blocks are expanded."""
    dofmap, size = space.dofmap, space.dofmap.index_map_bs
    width = dofmap.dof_layout.num_dofs
    dofs = _rows(dofmap.list, width)
    return (size * dofs[..., None] + np.arange(size)).reshape(-1, size * width)


def cell_nodes(mesh: DolfinxMesh) -> np.ndarray:
    """Numbers (cells, width) of the nodes of cells among `mesh.geometry.x`, ends first."""
    geometry = mesh.geometry
    dofs = geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    rows, (_, count) = np.asarray(getattr(dofs, "array", dofs)), count_cells(mesh)
    return rows.reshape(count, rows.size // count if count else 2)


def cell_vertices(mesh: DolfinxMesh) -> np.ndarray:
    """Vertices (cells, 2) at the ends of cells, in the order of the ends in the cells' geometry."""
    mesh.topology.create_connectivity(1, 0)
    return _rows(mesh.topology.connectivity(1, 0), 2)


def compiled_expression(expression: Expr, points: np.ndarray) -> CompiledExpression:
    """An expression of dolfinx at points (m, 1) of cells."""
    return _compiling(fem.Expression, expression, points)


def values_of(expression: CompiledExpression, mesh: DolfinxMesh, cells: np.ndarray) -> np.ndarray:
    """Values of an expression in some cells."""
    mesh_too = [mesh] * _takes(expression.eval, "mesh")
    return np.asarray(expression.eval(*mesh_too, cells.astype(np.int32)))


def is_empty(form: ufl.Form) -> bool:
    """Whether a form, with its derivatives written out, is zero."""
    return ufl.algorithms.expand_derivatives(form).empty()


def terminals(part: Expr | ufl.Form) -> set[Expr]:
    """Symbols and numbers of which an expression or a form consists."""
    expressions = [part]
    if isinstance(part, ufl.Form):
        expressions = [integral.integrand() for integral in part.integrals()]
    unique = ufl.corealg.traversal.traverse_unique_terminals
    return {terminal for expression in expressions for terminal in unique(expression)}


def fits(tags: MeshTags, mesh: DolfinxMesh) -> bool:
    """Whether tags are of a mesh, where dolfinx says of which they are, and else is sure of it."""
    return not hasattr(tags, "mesh") or tags.mesh.topology is mesh.topology


def confuses_rules(form: ufl.Form) -> bool:
    """Whether a form has a single Gauss point and other rules, which FFCx 0.5 confuses."""
    cells = [part for part in form.integrals() if part.integral_type() == "cell"]
    degrees = {part.metadata().get("quadrature_degree") for part in cells}
    return len(degrees) > 1 and 1 in degrees and hasattr(ufl, "FiniteElement")
