"""dolfinx's meshes of intervals, and spaces on them, which equal connectivity has in common."""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

# Before dolfinx, which would start MPI itself, and slowly.
from .mpi import MPI

# isort: split
import basix
import dolfinx
import ufl
from dolfinx import fem

import numpy as np

from fx_beam.content_cache import cached_by_content

from . import ffcx_api

#: Whether elements belong to UFL or to basix.
OF_UFL = hasattr(ufl, "FiniteElement")
_BASIX: Any = None if OF_UFL else import_module("basix.ufl")


@functools.cache
def beam(degree: int, nodal: bool = False):
    """Displacement (2) and rotation; the rotations `nodal` are constant on each cell."""
    rotation = lagrange(0, degree + 1, broken=True) if nodal else lagrange(degree)
    fields = [lagrange(degree, 2), rotation]
    return ufl.MixedElement(fields) if OF_UFL else _BASIX.mixed_element(fields)


@functools.cache
def lagrange(degree: int, size: int | None = None, *, broken: bool = False):
    """Scalar or vector element with equispaced nodes; a broken one is discontinuous between cells.

    The explicit variant makes signatures of forms, and so the cache, equal in all processes.
    """
    family = "DG" if broken else "Lagrange"
    if OF_UFL:
        cell = ufl.Cell("interval", geometric_dimension=2)
        element = ufl.FiniteElement(family, cell, degree, variant="equispaced")
        return element if size is None else ufl.VectorElement(element, dim=size)
    variant, shape = basix.LagrangeVariant.equispaced, None if size is None else (size,)
    return _BASIX.element(family, "interval", degree, lagrange_variant=variant, shape=shape)


@functools.cache
def values_at_points(points: int, *shape: int):
    """Values at the points of a Gauss rule; a single one is constant on each cell."""
    if points == 1:
        return lagrange(0, *shape, broken=True)
    degree = 2 * points - 1
    if not OF_UFL:
        return _BASIX.quadrature_element("interval", shape, degree=degree)
    kind, cell = "Quadrature", ufl.Cell("interval", geometric_dimension=2)
    if shape:
        return ufl.VectorElement(kind, cell, degree, *shape, quad_scheme="default")
    return ufl.FiniteElement(kind, cell, degree, quad_scheme="default")


F = TypeVar("F", bound=Callable)
T = TypeVar("T")

_FUNCTION_SPACE: Any = getattr(fem, "FunctionSpace" if OF_UFL else "functionspace")
OPTIONS_OF_JIT = (
    "jit_options" if "jit_options" in inspect.signature(fem.form).parameters else "jit_params"
)
# Vector instructions of a single law or element would read pairs of numbers that were just written
# one by one, for which processors wait long. The loop computes several elements at once instead.
_FLAGS = "-O2", "-g0", "-fno-math-errno", "-fno-tree-slp-vectorize"
#: Options of all compilations.
JIT: dict[str, Any] = {"cffi_extra_compile_args": list(_FLAGS)}


def _is_warning(record: logging.LogRecord) -> bool:
    return record.levelno > logging.INFO


def quietly(compiling: F) -> F:
    """Keep the compiler's lines out of the user's log.

    The JIT logs command lines at INFO on the root logger, and changes its level and handlers. What
    other threads say meanwhile on loggers of their own is not lost.
    """

    @functools.wraps(compiling)
    def wrapper(*args, **kwargs):
        root = logging.getLogger()
        level, handlers = root.level, root.handlers[:]
        loggers = root, logging.getLogger("ffcx"), logging.getLogger("UFL")
        for logger in loggers:
            logger.addFilter(_is_warning)
        try:
            return compiling(*args, **kwargs)
        finally:
            root.setLevel(level)
            root.handlers[:] = handlers
            for logger in loggers:
                logger.removeFilter(_is_warning)

    return wrapper  # type: ignore[return-value]


@quietly
def compiled(jit: Callable[..., T], *arguments, **options) -> T:
    """What dolfinx makes with a compiled module, which comes from the cache if it is there."""

    def call(folder: Path) -> T:
        return jit(*arguments, **options, **{OPTIONS_OF_JIT: {**JIT, "cache_dir": folder}})

    return ffcx_api.from_cache(call)


class IntervalMesh(dolfinx.mesh.Mesh):
    """A mesh of intervals in the plane, and what follows from its connectivity."""

    def __init__(self, of_cpp, degree: int, spaces: dict[Any, Any], sparsities: dict[int, Any]):
        super().__init__(of_cpp, ufl.Mesh(lagrange(degree, 2)))
        #: Degree of its geometry.
        self.degree = degree
        #: C++ spaces by element, of this mesh or of one with the same connectivity.
        self.spaces = spaces
        #: Sparsities of bilinear forms by the number of degrees of freedom of a cell.
        self.sparsities = sparsities

    @property
    def of_cpp(self):
        """The object of the C++ library."""
        return self.ufl_domain().ufl_cargo()

    def between(self, points: np.ndarray) -> IntervalMesh:
        """The mesh between other points (n, 2) [m], with the same numbering.

        It is a copy of a few arrays, a hundredth of the work for a new mesh of eight elements.
        """
        here = self.of_cpp
        other = type(here)(MPI.COMM_SELF, here.topology, here.geometry)
        mesh = IntervalMesh(other, self.degree, self.spaces, self.sparsities)
        mesh.move(points)
        return mesh

    def move(self, points: np.ndarray) -> None:
        """Put the nodes at points (n, 2) [m]."""
        geometry = self.of_cpp.geometry
        geometry.x[:, :2] = points[geometry.input_global_indices]

    def space(self, element):
        """Space of a finite element of this mesh."""
        if element not in self.spaces:
            make = functools.partial(compiled, _FUNCTION_SPACE) if OF_UFL else _FUNCTION_SPACE
            made = make(self, element)
            self.spaces[element] = made._cpp_object
        cpp_space = self.spaces[element]
        return self.space_with(element, cpp_space, cpp_space.dofmap)

    def space_with(self, element, like, dofmap):
        """Space of an element, that of the C++ space `like`, with degrees of freedom `dofmap`."""
        shape = [like.value_shape] if hasattr(like, "value_shape") else []
        cpp_space = type(like)(self.of_cpp, like.element, dofmap, *shape)
        return fem.FunctionSpace(self, element, cpp_space)


def mesh_between(
    points: np.ndarray, cells: np.ndarray, degree: int = 1
) -> tuple[IntervalMesh, np.ndarray]:
    """Mesh of intervals between points (n, 2) [m], and the row of `cells` of each mesh cell.

    `cells` (m, degree + 1) has the first and last node of each interval, then the inner nodes.
    """
    mesh, order = _intervals(len(points), cells, degree)
    return mesh.between(points), order


@cached_by_content
@quietly
def _intervals(count: int, cells: np.ndarray, degree: int) -> tuple[IntervalMesh, np.ndarray]:
    """A mesh of so many points, whose positions do not matter for its numbering."""
    create, domain = dolfinx.mesh.create_mesh, ufl.Mesh(lagrange(degree, 2))
    takes_e = "e" in inspect.signature(create).parameters
    named: dict[str, Any] = {"e" if takes_e else "domain": domain}
    # COMM_SELF: each process computes the whole scene.
    x = np.zeros((count, 2))
    made = create(MPI.COMM_SELF, cells=cells.astype(np.int64), x=x, **named)
    order = np.array(made.topology.original_cell_index)
    return IntervalMesh(domain.ufl_cargo(), degree, {}, {}), order


def gauss_space(mesh: IntervalMesh, points: int, *shape: int):
    """Space of values at the Gauss points of each cell, for forms with this rule only.

    With one point it is constant on each cell, and fits every rule.
    """
    return mesh.space(values_at_points(points, *shape))


def beam_space(mesh: IntervalMesh, degree: int):
    """Mixed Lagrange space of displacement (2) and rotation (1) with equispaced nodes."""
    return mesh.space(beam(degree))


def nodal_rotations(space, degree: int):
    """The beam space with the rotations at the nodes of a cell as components, constant on it.

    Degrees of freedom are the same. UFL then has the nodal values at every point of the cell.
    """
    mesh, element = space.mesh, beam(degree, nodal=True)
    return mesh.space_with(element, mesh.space(element)._cpp_object, space._cpp_object.dofmap)


def positions_space(mesh: IntervalMesh):
    """Space of the positions of a mesh's points."""
    return mesh.space(lagrange(mesh.degree, 2))


def coordinate_space(mesh: IntervalMesh):
    """Space of functions that are linear on each cell, and discontinuous."""
    return mesh.space(lagrange(1, broken=True))
