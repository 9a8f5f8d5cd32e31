"""Every call that differs between dolfinx versions: 0.5.2 (Debian 12), 0.9 (13) and 0.11 (sid).

What a version can do is asked for, not its number. The constants below are all that is asked.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import logging
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from mpi4py import MPI

import basix
import dolfinx
import ffcx.codegeneration
import ffcx.codegeneration.jit
import ffcx.compiler
import ufl
from dolfinx import fem
from dolfinx.fem import assemble
from ufl.algorithms.check_arities import ArityMismatch

import cffi
import numpy as np

_FFI = cffi.FFI()
_log = logging.getLogger("fx_beam")
F = TypeVar("F", bound=Callable)


def _takes(function: Callable, name: str) -> bool:
    """Whether a function has a parameter of this name."""
    return name in inspect.signature(function).parameters


# Elements are UFL's own, or basix's.
_OF_UFL = hasattr(ufl, "FiniteElement")
_BASIX: Any = None if _OF_UFL else import_module("basix.ufl")
_FUNCTION_SPACE: Any = getattr(fem, "FunctionSpace" if _OF_UFL else "functionspace")
_OPTIONS_OF_JIT = "jit_options" if _takes(fem.form, "jit_options") else "jit_params"
_EXPRESSION_TAKES_MESH = _takes(fem.Expression.eval, "mesh")
_PARAMETERS = find_spec("ffcx.parameters") is not None  # later called options
_PREFIX = "prefix" if _takes(ffcx.compiler.compile_ufl_objects, "prefix") else "namespace"
#: What UFL and FFCx raise for a form that they refuse; the second is no Exception everywhere.
REFUSALS: tuple[type[BaseException], ...] = (Exception, ArityMismatch)

# Several processes may want one form: they wait for the first, which may have a slow machine.
_JIT: dict[str, Any] = {"timeout": 30}
_WITH_JIT: dict[str, Any] = {_OPTIONS_OF_JIT: _JIT}
_REAL: Any = np.float64  # also where PETSc is built for complex numbers


def _loaded_once(find: Callable) -> Callable:
    """FFCx's search for a compiled module, which reads the whole cache folder, once for each."""
    found: dict[tuple[str, str], Any] = {}  # nothing that Python would unload

    @functools.wraps(find)
    def wrapper(module_name, object_names, cache_dir, timeout):
        key = module_name, str(cache_dir)
        objects, module = found.get(key) or find(module_name, object_names, cache_dir, timeout)
        if module is not None:  # else it is to be compiled
            found[key] = objects, module
        return objects, module

    return wrapper


# In the place of FFCx's own, as dolfinx lets nobody hand it another.
ffcx.codegeneration.jit.get_cached_module = _loaded_once(ffcx.codegeneration.jit.get_cached_module)


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
    create, domain = dolfinx.mesh.create_mesh, ufl.Mesh(_lagrange(degree, 2))
    named: dict[str, Any] = {"e" if _takes(create, "e") else "domain": domain}
    # COMM_SELF: each process computes the whole scene.
    mesh = create(MPI.COMM_SELF, cells=cells.astype(np.int64), x=points, **named)
    return mesh, np.asarray(mesh.topology.original_cell_index)


@quietly
def beam_space(mesh, degree: int):
    """Mixed Lagrange space of displacement (2) and rotation (1) with equispaced nodes."""
    fields = [_lagrange(degree, 2), _lagrange(degree)]
    return _space(mesh, ufl.MixedElement(fields) if _OF_UFL else _BASIX.mixed_element(fields))


def _space(mesh, element):
    return _FUNCTION_SPACE(mesh, element, **(_WITH_JIT if _OF_UFL else {}))


def _lagrange(degree: int, size: int | None = None, *, broken: bool = False):
    """Element with equispaced nodes, for scalars or vectors; broken ones jump between cells.

    The explicit variant keeps the signatures of compiled forms, hence the cache, the same from one
    process to the next.
    """
    family = "DG" if broken else "Lagrange"
    if _OF_UFL:
        cell = ufl.Cell("interval", geometric_dimension=2)
        element = ufl.FiniteElement(family, cell, degree, variant="equispaced")
        return element if size is None else ufl.VectorElement(element, dim=size)
    variant, shape = basix.LagrangeVariant.equispaced, None if size is None else (size,)
    return _BASIX.element(family, "interval", degree, lagrange_variant=variant, shape=shape)


def function(space):
    """Zero function of a space."""
    return fem.Function(space, dtype=_REAL)


def dofs_of_cells(space) -> np.ndarray:
    """Degrees of freedom (cells, nodes, 3) of displacement and rotation at the nodes of cells."""
    cells = range(space.mesh.topology.index_map(1).size_local)
    u, psi = (space.sub(part).dofmap for part in (0, 1))
    parts = [(u.cell_dofs(cell).reshape(-1, 2), psi.cell_dofs(cell)) for cell in cells]
    return np.array([np.column_stack(part) for part in parts])


@quietly
def cellwise(mesh, values: np.ndarray):
    """Function that is constant on each cell, with values (cells, components) or (cells,)."""
    constant = function(_space(mesh, _lagrange(0, *values.shape[1:], broken=True)))
    constant.x.array[:] = values.ravel()
    return constant


@quietly
def at_gauss_points(mesh, values: np.ndarray):
    """Function with values (cells, points, components) or (cells, points) at the Gauss points.

    It is the polynomial through them on each cell, discontinuous from cell to cell.
    """
    points, shape = values.shape[1], values.shape[2:]
    space = _space(mesh, _lagrange(points - 1, *shape, broken=True))
    nodes = space.element.interpolation_points
    nodes = nodes() if callable(nodes) else nodes
    powers = np.arange(points)
    through = np.linalg.inv(gauss_points(points) ** powers)
    at_nodes = nodes[:, :1] ** powers @ through
    polynomial = function(space)
    nodal = polynomial.x.array.reshape(-1, *shape)
    for cell, own in enumerate(values):
        nodal[space.dofmap.cell_dofs(cell)] = np.tensordot(at_nodes, own, 1)
    return polynomial


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
        metadata={"quadrature_degree": 2 * points - 1, "quadrature_rule": "Gauss-Jacobi"},
    )


def compile_form(form, name: str):
    """Compile a UFL form through FFCx; the log names it where the cache did not have it."""
    compiled = quietly(fem.form)(form, dtype=_REAL, **_WITH_JIT)
    if any(compiled.code):
        _log.info("compiled the form %r, once", name)
    return compiled


def gauss_points(points: int) -> np.ndarray:
    """Reference coordinates (points, 1) in [0, 1] of the Gauss rule that `measure` uses."""
    return (np.polynomial.legendre.leggauss(points)[0][:, None] + 1) / 2


@quietly
def compile_expression(expression, points: np.ndarray):
    """Compile a UFL expression for evaluation at reference points of every cell."""
    return fem.Expression(expression, points, dtype=_REAL, **_WITH_JIT)


def evaluate(expression, mesh, cells: np.ndarray) -> np.ndarray:
    """Values (cells, points * components) of a compiled expression."""
    values = expression.eval(*([mesh] if _EXPRESSION_TAKES_MESH else []), cells.astype(np.int32))
    return values.reshape(len(cells), -1)


def create_matrix(form):
    """Zero matrix in compressed rows, with the sparsity of a compiled bilinear form."""
    return assemble.create_matrix(form)


def assemble_matrix(matrix, form) -> None:
    """Assemble a bilinear form over the old values of `matrix`."""
    matrix.data[:] = 0.0
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
    cells, geometry = mesh.topology.index_map(1).size_local, mesh.geometry
    nodes = geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    nodes = getattr(nodes, "array", nodes)  # an adjacency list, or an array already
    return geometry.x[np.reshape(nodes, (cells, -1))].reshape(cells, -1)


def _integrals(form) -> list[tuple[int, Any]]:
    """Integrals of a compiled form over cells, in the order of their subdomains (-1: all cells)."""
    cell, ufcx = 0, form.ufcx_form  # cells are the first of the types of integrals
    if hasattr(ufcx, "num_integrals"):
        count, ids, of = ufcx.num_integrals(cell), ufcx.integral_ids(cell), ufcx.integrals(cell)
        return [(ids[i], of[i]) for i in range(count)]
    places = range(*ufcx.form_integral_offsets[cell : cell + 2])
    return [(ufcx.form_integral_ids[i], ufcx.form_integrals[i]) for i in places]


def integrals(form) -> list[int]:
    """Subdomain of each integral of a compiled form (-1: all cells)."""
    return [subdomain for subdomain, _ in _integrals(form)]


def signature(form) -> str:
    """What tells a compiled form from others, the version of its compiler included."""
    return _FFI.string(form.ufcx_form.signature).decode() + ffcx.codegeneration.get_signature()


def ufcx_folder() -> str:
    """Where the header is to which generated C is written."""
    return ffcx.codegeneration.get_include_path()


def element_functions(form, ufl_form) -> tuple[str, list[str], int]:
    """C that computes a form's element tensors.

    Parameters
    ----------
    form, ufl_form : dolfinx form and ufl.Form
        The form as compiled, and what it was compiled from.

    Returns
    -------
    source : str
        All that FFCx generates for the form.
    names : list of str
        The function in it of each integral.
    parameters : int
        How many parameters these have.

    Raises
    ------
    LookupError
        If the compiled form does not tell these names.
    """
    functions = [integral.tabulate_tensor_float64 for _, integral in _integrals(form)]
    module, names = "", []
    for function in functions:
        module, name = _symbol(int(_FFI.cast("uintptr_t", function)))
        names.append(name)
    _, source = form.code  # there where it has just been compiled
    if not source:
        # Names are made of the module's, and so are the same again.
        source = _generated(ufl_form, Path(module).name.partition(".")[0])
    return source, names, len(_FFI.typeof(functions[0]).args)


class _Symbol(ctypes.Structure):
    _fields_ = [
        ("file", ctypes.c_char_p),
        ("base", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
    ]


def _symbol(address: int) -> tuple[str, str]:
    """File and name of a function, as the linker knows them."""
    found = _Symbol()
    ctypes.CDLL(None).dladdr(ctypes.c_void_p(address), ctypes.byref(found))
    if found.address != address:  # but that of one before it
        raise LookupError("the functions that FFCx generates have no names for the linker")
    return found.file.decode(), found.name.decode()


def _generated(ufl_form, prefix: str) -> str:
    """C that FFCx generates for a form."""
    if _PARAMETERS:
        options = {"parameters": import_module("ffcx.parameters").get_parameters()}
    else:
        options = {"options": import_module("ffcx.options").get_options()}
    # A header and the code, or a list of these with the ends of their files' names.
    made: Any = ffcx.compiler.compile_ufl_objects([ufl_form], **{_PREFIX: prefix}, **options)
    return made[1] if isinstance(made[1], str) else made[0][1]


def coefficient_offsets(form, functions) -> list[tuple[int, int]]:
    """Which of some functions a compiled form has, and their offsets in its packed coefficients."""
    objects = [function._cpp_object for function in functions]
    found, offset = [], 0
    for coefficient in _cpp(form).coefficients:
        if coefficient in objects:
            found.append((objects.index(coefficient), offset))
        offset += coefficient.function_space.element.space_dimension
    return found


def packed_coefficients(form) -> dict[int, np.ndarray]:
    """Coefficients (its cells, width) of a compiled form on each subdomain."""
    packed = dolfinx.cpp.fem.pack_coefficients(_cpp(form))
    # Keys end in the subdomain, or in its place among them: in one order both ways.
    values = [np.array(packed[key]) for key in sorted(packed, key=lambda key: key[1])]
    return dict(zip(sorted(integrals(form)), values, strict=True))


def packed_constants(form, ufl_form, sought) -> tuple[np.ndarray, list[int]]:
    """Constants of a compiled form, and the places of some of them (-1: not there)."""
    places, at = {}, 0
    for constant in ufl_form.constants():
        places[id(constant)] = at
        at += int(np.prod(constant.ufl_shape, dtype=int))
    packed = np.array(dolfinx.cpp.fem.pack_constants(_cpp(form)))
    return packed, [places.get(id(x), -1) for x in sought]


def _cpp(form):
    """The form of the C++ library, which Python's form is or has."""
    return getattr(form, "_cpp_object", form)
