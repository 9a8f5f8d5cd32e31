"""All calls that differ between dolfinx versions: 0.5.2 (Debian 12), 0.9 (Debian 13), 0.11 (sid).

The constants below test for features, not for version numbers.
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


# Whether elements belong to UFL or to basix.
_OF_UFL = hasattr(ufl, "FiniteElement")
_BASIX: Any = None if _OF_UFL else import_module("basix.ufl")
_FUNCTION_SPACE: Any = getattr(fem, "FunctionSpace" if _OF_UFL else "functionspace")
_OPTIONS_OF_JIT = "jit_options" if _takes(fem.form, "jit_options") else "jit_params"
_EXPRESSION_TAKES_MESH = _takes(fem.Expression.eval, "mesh")
_PARAMETERS = find_spec("ffcx.parameters") is not None  # called options in later versions
_PREFIX = "prefix" if _takes(ffcx.compiler.compile_ufl_objects, "prefix") else "namespace"
#: Errors of UFL and FFCx for an invalid form; ArityMismatch is not always an Exception.
REFUSALS: tuple[type[BaseException], ...] = (Exception, ArityMismatch)

# Processes that need the same form wait for the first one, which may be slow [s].
_JIT: dict[str, Any] = {"timeout": 30}
_WITH_JIT: dict[str, Any] = {_OPTIONS_OF_JIT: _JIT}
_REAL: Any = np.float64  # also if PETSc is built for complex numbers


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

    The JIT logs command lines at INFO on the root logger, and changes its level and handlers.
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
    """Mesh of intervals between points (n, 2) [m], and the row of `cells` of each mesh cell.

    `cells` (m, degree + 1) has the first and last node of each interval, then the inner nodes.
    """
    create, domain = dolfinx.mesh.create_mesh, ufl.Mesh(_lagrange(degree, 2))
    named: dict[str, Any] = {"e" if _takes(create, "e") else "domain": domain}
    # COMM_SELF: each process computes the whole scene.
    mesh = create(MPI.COMM_SELF, cells=cells.astype(np.int64), x=points, **named)
    return mesh, np.asarray(mesh.topology.original_cell_index)


@quietly
def beam_space(mesh, degree: int):
    """Mixed Lagrange space of displacement (2) and rotation (1) with equispaced nodes."""
    return _space(mesh, _mixed(_lagrange(degree, 2), _lagrange(degree)))


@quietly
def nodal_rotations(space, degree: int):
    """The beam space with the rotations at the nodes of a cell as components, constant on it.

    Degrees of freedom are the same. UFL then has the nodal values at every point of the cell.
    """
    element = _mixed(_lagrange(degree, 2), _lagrange(0, degree + 1, broken=True))
    own, other = _cpp(space), _cpp(_space(space.mesh, element))
    shape = [other.value_shape] if hasattr(other, "value_shape") else []
    shared = type(own)(own.mesh, other.element, own.dofmap, *shape)
    return fem.FunctionSpace(space.mesh, element, shared)


@quietly
def coordinate_on_cells(mesh, length: float):
    """Function that is linear on each cell, from 0 at its first node to `length` at its last."""
    coordinate = function(_space(mesh, _lagrange(1, broken=True)))
    coordinate.x.array[element_dofs(coordinate.function_space)] = 0.0, length
    return coordinate


def _mixed(*elements):
    return ufl.MixedElement(elements) if _OF_UFL else _BASIX.mixed_element(elements)


def _space(mesh, element):
    return _FUNCTION_SPACE(mesh, element, **(_WITH_JIT if _OF_UFL else {}))


def _lagrange(degree: int, size: int | None = None, *, broken: bool = False):
    """Scalar or vector element with equispaced nodes; a broken one is discontinuous between cells.

    The explicit variant makes signatures of forms, and so the cache, equal in all processes.
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
    """Function, constant on each cell, with values (cells, components) or (cells,)."""
    constant = function(_space(mesh, _lagrange(0, *values.shape[1:], broken=True)))
    constant.x.array[:] = values.ravel()
    return constant


@quietly
def at_gauss_points(mesh, values: np.ndarray):
    """Function with values (cells, points, components) or (cells, points) at the Gauss points.

    On each cell it is the interpolating polynomial, discontinuous between cells.
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
    """UFL constant whose value may change without compiling again."""
    return fem.Constant(mesh, value)


def measure(mesh, points: int, tags: np.ndarray | None = None):
    """Measure `dx` with a Gauss rule of so many points; `tags` number the subdomains."""
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
    """Compile a UFL form through FFCx; forms that were not in the cache are logged."""
    compiled = quietly(fem.form)(form, dtype=_REAL, **_WITH_JIT)
    if any(compiled.code):
        _log.info("compiled the form %r, once", name)
    return compiled


def gauss_points(points: int) -> np.ndarray:
    """Reference coordinates (points, 1) in [0, 1] of the Gauss rule that `measure` uses."""
    return (np.polynomial.legendre.leggauss(points)[0][:, None] + 1) / 2


@quietly
def compile_expression(expression, points: np.ndarray):
    """Compile a UFL expression for evaluation at reference points of all cells."""
    return fem.Expression(expression, points, dtype=_REAL, **_WITH_JIT)


def evaluate(expression, mesh, cells: np.ndarray) -> np.ndarray:
    """Values (cells, points * components) of a compiled expression."""
    values = expression.eval(*([mesh] if _EXPRESSION_TAKES_MESH else []), cells.astype(np.int32))
    return values.reshape(len(cells), -1)


def create_matrix(form):
    """Zero matrix in compressed rows, with the sparsity of a compiled bilinear form."""
    return assemble.create_matrix(form)


def assemble_matrix(matrix, form) -> None:
    """Assemble a bilinear form; old values of `matrix` are overwritten."""
    matrix.data[:] = 0.0
    fem.assemble_matrix(matrix, form)


def assemble_vector(array: np.ndarray, form) -> None:
    """Assemble a linear form; old values of `array` are overwritten."""
    array[:] = 0.0
    fem.assemble_vector(array, form)


def assemble_scalar(form) -> float:
    """Assemble a functional."""
    return float(fem.assemble_scalar(form))


# -- Data for the compiled loop --------------------------------------------------------------------


def element_dofs(space) -> np.ndarray:
    """Degrees of freedom (cells, n) of all cells, in the order of the element tensors."""
    cells = space.mesh.topology.index_map(1).size_local
    return np.array([space.dofmap.cell_dofs(cell) for cell in range(cells)])


def element_coordinates(mesh) -> np.ndarray:
    """Coordinates (cells, 3 nodes) of the geometry of all cells, for compiled forms."""
    cells, geometry = mesh.topology.index_map(1).size_local, mesh.geometry
    nodes = geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    nodes = getattr(nodes, "array", nodes)  # an adjacency list, or already an array
    return geometry.x[np.reshape(nodes, (cells, -1))].reshape(cells, -1)


def _integrals(form) -> list[tuple[int, Any]]:
    """Cell integrals of a compiled form, ordered by subdomain (-1: all cells)."""
    cell, ufcx = 0, form.ufcx_form  # cell integrals are type 0
    if hasattr(ufcx, "num_integrals"):
        count, ids, of = ufcx.num_integrals(cell), ufcx.integral_ids(cell), ufcx.integrals(cell)
        return [(ids[i], of[i]) for i in range(count)]
    places = range(*ufcx.form_integral_offsets[cell : cell + 2])
    return [(ufcx.form_integral_ids[i], ufcx.form_integrals[i]) for i in places]


def integrals(form) -> list[int]:
    """Subdomain of each integral of a compiled form (-1: all cells)."""
    return [subdomain for subdomain, _ in _integrals(form)]


def signature(form) -> str:
    """Identifier of a compiled form, with the version of its compiler."""
    return _FFI.string(form.ufcx_form.signature).decode() + ffcx.codegeneration.get_signature()


def ufcx_folder() -> str:
    """Folder of the header that generated C includes."""
    return ffcx.codegeneration.get_include_path()


def element_functions(form, ufl_form) -> tuple[str, list[str], int]:
    """C source of a form's element tensors, a function name for each integral, parameter count.

    Raises LookupError if the compiled form does not give these names.
    """
    functions = [integral.tabulate_tensor_float64 for _, integral in _integrals(form)]
    module, names = "", []
    for function in functions:
        module, name = _symbol(int(_FFI.cast("uintptr_t", function)))
        names.append(name)
    _, source = form.code  # empty unless it has just been compiled
    if not source:
        # Function names derive from the module's name, so they are the same again.
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
    """File and name of a function, from the linker."""
    found = _Symbol()
    ctypes.CDLL(None).dladdr(ctypes.c_void_p(address), ctypes.byref(found))
    if found.address != address:  # the address of an earlier symbol
        raise LookupError("the functions that FFCx generates have no symbol names")
    return found.file.decode(), found.name.decode()


def _generated(ufl_form, prefix: str) -> str:
    """C that FFCx generates for a form."""
    if _PARAMETERS:
        options = {"parameters": import_module("ffcx.parameters").get_parameters()}
    else:
        options = {"options": import_module("ffcx.options").get_options()}
    # Header and code, or a list of these with file name extensions.
    made: Any = ffcx.compiler.compile_ufl_objects([ufl_form], **{_PREFIX: prefix}, **options)
    return made[1] if isinstance(made[1], str) else made[0][1]


def coefficient_offsets(form, functions) -> list[tuple[int, int]]:
    """Which of the functions a compiled form has, and their offsets in its packed coefficients."""
    objects = [function._cpp_object for function in functions]
    found, offset = [], 0
    for coefficient in _cpp(form).coefficients:
        if coefficient in objects:
            found.append((objects.index(coefficient), offset))
        offset += coefficient.function_space.element.space_dimension
    return found


def packed_coefficients(form) -> dict[int, np.ndarray]:
    """Coefficients (cells, width) of a compiled form on each subdomain."""
    packed = dolfinx.cpp.fem.pack_coefficients(_cpp(form))
    # Keys end in the subdomain or in its index: the same order in both cases.
    values = [np.array(packed[key]) for key in sorted(packed, key=lambda key: key[1])]
    return dict(zip(sorted(integrals(form)), values, strict=True))


def packed_constants(form, ufl_form, sought) -> tuple[np.ndarray, list[int]]:
    """Constants of a compiled form, and the positions of the `sought` ones (-1: missing)."""
    places, at = {}, 0
    for constant in ufl_form.constants():
        places[id(constant)] = at
        at += int(np.prod(constant.ufl_shape, dtype=int))
    packed = np.array(dolfinx.cpp.fem.pack_constants(_cpp(form)))
    return packed, [places.get(id(x), -1) for x in sought]


def _cpp(wrapped):
    """The object of the C++ library: Python's object itself, or an attribute of it."""
    return getattr(wrapped, "_cpp_object", wrapped)
