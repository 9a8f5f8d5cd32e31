"""All calls that differ between dolfinx versions: 0.5.2 (Debian 12), 0.9 (Debian 13), 0.11 (sid).

The constants below test for features, not for version numbers.
"""

from __future__ import annotations

import functools
import inspect
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

# Before dolfinx, which would start MPI itself, and slowly.
from . import mpi  # noqa: F401

# isort: split
import dolfinx
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.algorithms.check_arities import ArityMismatch

import numpy as np

from . import ffcx_api
from .interval_mesh import (
    OF_UFL,
    OPTIONS_OF_JIT,
    beam,
    compiled,
    coordinate_space,
    gauss_space,
    lagrange,
    values_at_points,
)

_log = logging.getLogger("fx_beam")


def _takes(function: Callable, name: str) -> bool:
    """Whether a function has a parameter of this name."""
    return name in inspect.signature(function).parameters


# Whether a form of Python is one of the C++ library, and may have one for each type of cell.
_FORM_IS_OF_CPP = not hasattr(fem, "form_cpp_class")
_FORM_HAS_SEVERAL = _takes(fem.form, "jit_comm")
#: Flags for forms of which only functions of several elements are called, which are compiled again.
ONLY_IN_BATCHES = ("-O0",)
#: Errors of UFL and FFCx for an invalid form; ArityMismatch is not always an Exception.
REFUSALS: tuple[type[BaseException], ...] = (Exception, ArityMismatch)

if _FORM_IS_OF_CPP:
    _FORM_OF_CPP: Any = type("Form", (fem.FormMetaClass, dolfinx.cpp.fem.Form_float64), {})

_HAS_OPTIONS = hasattr(dolfinx.jit, "get_options")
_KINDS_OF_INTEGRALS = list(fem.IntegralType.__members__.values())
_REAL: Any = np.float64  # also if PETSc is built for complex numbers
_SCALAR = {"scalar_type": "double" if OF_UFL else _REAL}


@functools.cache
def domain(degree: int):
    """UFL's mesh of intervals in the plane, for forms that are compiled without a mesh."""
    return ufl.Mesh(lagrange(degree, 2))


class Coefficient(ufl.Coefficient):
    """UFL's symbol for a function. Its name may stand in C; FFCx 0.5 takes UFL's own, w_{10}."""

    def __str__(self):
        return f"w{self.count()}"


def data(on, points: int, shape: tuple[int, ...] = ()):
    """UFL's symbol for data: a constant for 0 points, else `at_gauss_points` of so many."""
    if not points:
        return ufl.Constant(on, shape=shape)
    return Coefficient(ufl_gauss_space(on, points, *shape))


def ufl_space(on, degree: int, nodal: bool = False):
    """UFL's side of `beam_space`, or of its `nodal_rotations`."""
    return ufl.FunctionSpace(on, beam(degree, nodal))


def ufl_coordinate(on):
    """UFL's symbol for `coordinate_on_cells`."""
    return Coefficient(ufl.FunctionSpace(on, lagrange(1, broken=True)))


def ufl_gauss_space(on, points: int, *shape: int):
    """UFL's side of `gauss_space`."""
    return ufl.FunctionSpace(on, values_at_points(points, *shape))


def coordinate_on_cells(mesh, length: float):
    """Function that is linear on each cell, from 0 at its first node to `length` at its last."""
    coordinate = function(coordinate_space(mesh))
    coordinate.x.array[element_dofs(coordinate.function_space)] = 0.0, length
    return coordinate


def function(space):
    """Zero function of a space."""
    return fem.Function(space, dtype=_REAL)


def dofs_of_cells(space) -> np.ndarray:
    """Degrees of freedom (cells, nodes, 3) of displacement and rotation at the nodes of cells."""
    dofs = element_dofs(space)
    nodes = dofs.shape[1] // 3
    u, psi = dofs[:, : 2 * nodes], dofs[:, 2 * nodes :]
    return np.dstack([u.reshape(-1, nodes, 2), psi])


def at_gauss_points(mesh, values: np.ndarray):
    """Function with values (cells, points, components) or (cells, points) at the Gauss points."""
    field = function(gauss_space(mesh, *values.shape[1:]))
    set_at_gauss_points(field, values)
    return field


def set_at_gauss_points(field, values: np.ndarray) -> None:
    """Set the values (cells, points, ...) of such a function."""
    nodal = field.x.array.reshape(-1, *values.shape[2:])
    nodal[element_dofs(field.function_space)] = values


def values_on_cells(field) -> np.ndarray:
    """Values (cells, n) of a function on all cells."""
    dofs = element_dofs(field.function_space)
    return field.x.array.reshape(dofs.max() + 1, -1)[dofs].reshape(len(dofs), -1)


def constant(mesh, value):
    """UFL constant whose value may change without compiling again."""
    return fem.Constant(mesh, value)


def measure(on, points: int):
    """Measure `dx` with a Gauss rule of so many points."""
    rule = {"quadrature_degree": 2 * points - 1, "quadrature_rule": "Gauss-Jacobi"}
    return ufl.Measure("dx", domain=on, metadata=rule)


class CompiledForm(NamedTuple):
    """A form that was compiled for all meshes of its kind."""

    name: str
    form: Any
    ufcx: Any
    #: FFCx's module, which must stay in memory, and its source if it has just been compiled.
    module: Any
    code: Any
    #: All forms of the module.
    together: tuple[Any, ...]


def compile_together(forms: Mapping[str, Any], flags: Sequence[str] = ()) -> list[CompiledForm]:
    """Compile UFL forms, or expressions with their points, by name through FFCx, as one module.

    For those always used together, with further flags of the C compiler. Those that were not in
    the cache are logged.
    """
    together = tuple(forms.values())
    settings = dolfinx.jit.get_options if _HAS_OPTIONS else dolfinx.jit.get_parameters

    def jit(**options):
        given = settings(options[OPTIONS_OF_JIT])
        given["cffi_extra_compile_args"] = [*given["cffi_extra_compile_args"], *flags]
        return ffcx_api.compile_together(together, _SCALAR, given)

    objects, module, code = compiled(jit)
    for name in forms if any(code) else ():
        _log.info("compiled the form %r, once", name)
    return [
        CompiledForm(name, form, ufcx, module, code, together)
        for (name, form), ufcx in zip(forms.items(), objects, strict=True)
    ]


def compile_form(form, name: str) -> CompiledForm:
    """The same for a single form."""
    return compile_together({name: form})[0]


def bind(compiled: CompiledForm, mesh, space=None, data: Mapping | None = None, tags=None):
    """dolfinx's form on a mesh; the space is that of its arguments, or a list of theirs.

    `data` has the functions and constants in the place of UFL's; `tags` number the subdomains.
    """
    form, ufcx, module, code = compiled[1:5]
    replaced = data or {}
    coefficients = _generated(ufcx, form.coefficients())
    functions, constants = (
        [replaced.get(field, field)._cpp_object for field in fields]
        for fields in (coefficients, form.constants())
    )
    each = space if isinstance(space, list) else [space] * len(form.arguments()) if space else []
    spaces = [one._cpp_object for one in each]
    subdomains, on = _subdomains(mesh, compiled, tags), mesh.ufl_domain().ufl_cargo()
    fields = spaces, functions, constants, subdomains
    if _FORM_IS_OF_CPP:
        return _FORM_OF_CPP(ufcx, *fields, on, module.ffi, code)
    pointer: Any = int(module.ffi.cast("uintptr_t", module.ffi.addressof(ufcx)))
    maps: Any = [] if _FORM_HAS_SEVERAL else {}
    pointers = [pointer] if _FORM_HAS_SEVERAL else pointer
    return fem.Form(fem.form_cpp_class(_REAL)(pointers, *fields, maps, on), ufcx, code, module)


def _generated(ufcx, coefficients: Sequence) -> list:
    """Coefficients of a form or an expression that the generated code has, in its order."""
    plural = "original_coefficient_position" + "s" * hasattr(ufcx, "original_coefficient_positions")
    at = getattr(ufcx, plural)
    return [coefficients[at[i]] for i in range(ufcx.num_coefficients)]


def fields_of_expression(compiled: CompiledForm) -> tuple[list, list]:
    """Coefficients and constants of a compiled expression, in the order of the generated code."""
    expression, _ = compiled.form
    return _generated(compiled.ufcx, extract_coefficients(expression)), extract_constants(
        expression
    )


def _subdomains(mesh, compiled: CompiledForm, tags) -> dict:
    """Cells of each subdomain of a form, as dolfinx wants them."""
    cell = fem.IntegralType.cell
    if _FORM_IS_OF_CPP:
        kinds = dict.fromkeys(_KINDS_OF_INTEGRALS)
        if tags is not None:
            every = np.arange(len(tags), dtype=np.int32)
            kinds[cell] = dolfinx.mesh.meshtags(mesh, 1, every, tags.astype(np.int32))
        return kinds
    ids = [number for number in ffcx_api.integrals(compiled) if number >= 0]
    return {cell: [(number, np.flatnonzero(tags == number).astype(np.int32)) for number in ids]}


@functools.cache
def gauss_points(points: int) -> np.ndarray:
    """Reference coordinates (points, 1) in [0, 1] of the Gauss rule that `measure` uses."""
    x = (np.polynomial.legendre.leggauss(points)[0][:, None] + 1) / 2
    x.flags.writeable = False
    return x


@functools.cache
def gauss_weights(points: int) -> np.ndarray:
    """Weights (points,) of the same rule, relative to the element's length."""
    weights = np.polynomial.legendre.leggauss(points)[1] / 2
    weights.flags.writeable = False
    return weights


def create_matrix(form, mesh):
    """Zero matrix in compressed rows, with the sparsity of a bound bilinear form."""
    dofs = _cpp(form).function_spaces[0].element.space_dimension
    if dofs not in mesh.sparsities:
        pattern = mesh.sparsities[dofs] = fem.create_sparsity_pattern(form)
        (pattern.finalize if hasattr(pattern, "finalize") else pattern.assemble)()
    return dolfinx.la.matrix_csr(mesh.sparsities[dofs], dtype=_REAL)


def assemble_matrix(matrix, form) -> None:
    """Assemble a bilinear form; old values of `matrix` are overwritten."""
    matrix.data[:] = 0.0
    fem.assemble_matrix(matrix, form)


def assemble_vector(array: np.ndarray, form) -> None:
    """Assemble a linear form; old values of `array` are overwritten."""
    array[:] = 0.0
    add_vector(array, form)


def add_vector(array: np.ndarray, form) -> None:
    """Assemble a linear form, and add it to `array`."""
    fem.assemble_vector(array, form)


def assemble_scalar(form) -> float:
    """Assemble a functional."""
    return float(fem.assemble_scalar(form))


# -- Data for the compiled loop --------------------------------------------------------------------


def element_dofs(space) -> np.ndarray:
    """Degrees of freedom (cells, n) of all cells, in the order of the element tensors."""
    return _rows(space.mesh, space.dofmap.list)


def element_coordinates(mesh) -> np.ndarray:
    """Coordinates (cells, 3 nodes) of the geometry of all cells, for compiled forms."""
    rows = _nodes(mesh)
    return mesh.geometry.x[rows].reshape(len(rows), -1)


def element_points(mesh) -> np.ndarray:
    """Numbers (cells, nodes) of the points between which a mesh was made, for all cells."""
    return np.asarray(mesh.geometry.input_global_indices)[_nodes(mesh)]


def _nodes(mesh) -> np.ndarray:
    """Nodes (cells, n) of the geometry of all cells."""
    of = mesh.geometry
    return _rows(mesh, of.dofmaps[0] if hasattr(of, "dofmaps") else of.dofmap)


def _rows(mesh, numbers) -> np.ndarray:
    """Numbers (cells, n) that belong to each cell: an adjacency list, or already an array."""
    numbers = getattr(numbers, "array", numbers)
    return np.reshape(numbers, (mesh.topology.index_map(1).size_local, -1))


def tensor_size(form) -> int:
    """Number of entries of a bound form's element tensors."""
    return math.prod(space.element.space_dimension for space in _cpp(form).function_spaces)


def space_size(space) -> int:
    """Number of degrees of freedom of an element."""
    return _cpp(space).element.space_dimension


def _offsets(parts, size: Callable[[Any], int]) -> dict[Any, int]:
    """Offsets of parts of some sizes that stand behind each other."""
    offsets, offset = {}, 0
    for part in parts:
        offsets[part] = offset
        offset += size(part)
    return offsets


def _entries(coefficient) -> int:
    return coefficient.function_space.element.space_dimension


def _size(constant) -> int:
    return math.prod(constant.ufl_shape)


def coefficient_offsets(form, functions) -> list[tuple[int, int]]:
    """Which of the functions a bound form has, and their offsets in its packed coefficients."""
    objects = [getattr(function, "_cpp_object", None) for function in functions]
    offsets = _offsets(_cpp(form).coefficients, _entries)
    return [(objects.index(part), offset) for part, offset in offsets.items() if part in objects]


def indices_in(*forms: tuple[Any, CompiledForm]) -> tuple[list[int], list[int]]:
    """Indices of a bound form's packed coefficients and constants among those of another one."""

    def indices(size: Callable[[Any], int], parts, others) -> list[int]:
        starts = _offsets(others, size)
        return [starts[part] + k for part in parts for k in range(size(part))]

    coefficients = [_cpp(form).coefficients for form, _ in forms]
    constants = [compiled.form.constants() for _, compiled in forms]
    return indices(_entries, *coefficients), indices(_size, *constants)


def width_of(form, functions) -> int:
    """Number of packed coefficients of a bound form that are those of some functions."""
    objects = [getattr(function, "_cpp_object", None) for function in functions]
    return sum(_entries(part) for part in _cpp(form).coefficients if part in objects)


def packed_coefficients(form, compiled: CompiledForm) -> dict[int, np.ndarray]:
    """Coefficients (cells, width) of a bound form on each subdomain."""
    packed = dolfinx.cpp.fem.pack_coefficients(_cpp(form))
    # Keys end in the subdomain or in its index: the same order in both cases.
    values = [np.array(packed[key]) for key in sorted(packed, key=lambda key: key[1])]
    return dict(zip(sorted(ffcx_api.integrals(compiled)), values, strict=True))


def packed_constants(form, compiled: CompiledForm, sought) -> tuple[np.ndarray, list[int]]:
    """Constants of a bound form, and the positions of UFL's `sought` ones (-1: missing)."""
    offsets = _offsets(compiled.form.constants(), _size)
    return values_of_constants(form), [offsets.get(constant, -1) for constant in sought]


def values_of_constants(form) -> np.ndarray:
    """Constants of a bound form."""
    return np.array(dolfinx.cpp.fem.pack_constants(_cpp(form)))


def _cpp(wrapped):
    """The object of the C++ library: Python's object itself, or an attribute of it."""
    return getattr(wrapped, "_cpp_object", wrapped)
