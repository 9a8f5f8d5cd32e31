"""UFL's finite elements and symbols on intervals: UFL's own or those of basix."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from fx_beam.symbolic import ufl


def _of_ufl() -> bool:
    """Whether elements belong to UFL, in 2022.2, or to basix."""
    return hasattr(ufl, "FiniteElement")


def _basix() -> Any:
    return import_module("basix.ufl")


def lagrange(degree: int, size: int | None = None, *, broken: bool = False):
    """Scalar or vector element with equispaced nodes; a broken one is discontinuous between cells.

    The explicit variant makes signatures of forms, and so the cache, equal in all processes.
    """
    family = "DG" if broken else "Lagrange"
    if _of_ufl():
        cell = ufl.Cell("interval", geometric_dimension=2)
        element = ufl.FiniteElement(family, cell, degree, variant="equispaced")
        return element if size is None else ufl.VectorElement(element, dim=size)
    variant = import_module("basix").LagrangeVariant.equispaced
    shape = None if size is None else (size,)
    return _basix().element(family, "interval", degree, lagrange_variant=variant, shape=shape)


def domain(degree: int):
    """UFL's mesh of intervals in the plane, for forms that are compiled without a mesh."""
    return ufl.Mesh(lagrange(degree, 2))


class Symbols:
    """Makes the spaces, functions and constants of forms: here UFL's, on no particular mesh."""

    def __init__(self, domain: Any):
        #: UFL's mesh.
        self.domain = domain
        self._coefficients = _coefficients()

    def space(self, element: Any) -> Any:
        """A space of functions."""
        return ufl.FunctionSpace(self.domain, element)

    def coefficient(self, space: Any) -> Any:
        """A function."""
        return self._coefficients(space)

    def constant(self, *shape: int) -> Any:
        """Numbers that are constant on the mesh."""
        return ufl.Constant(self.domain, shape=shape)

    def beam_space(self, degree: int, nodal: bool = False) -> Any:
        """Displacement (2) and rotation (1) with equispaced nodes.

        With `nodal` rotations, those at the nodes of a cell are components, constant on it: the
        degrees of freedom are the same, but UFL has the nodal values at every point of the cell.
        """
        rotation = lagrange(0, degree + 1, broken=True) if nodal else lagrange(degree)
        fields = [lagrange(degree, 2), rotation]
        return self.space(ufl.MixedElement(fields) if _of_ufl() else _basix().mixed_element(fields))

    def gauss_space(self, points: int, *shape: int) -> Any:
        """Values at the points of a Gauss rule; a single one is constant on each cell."""
        if points == 1:
            return self.space(lagrange(0, *shape, broken=True))
        degree = 2 * points - 1
        if not _of_ufl():
            return self.space(_basix().quadrature_element("interval", shape, degree=degree))
        make = ufl.VectorElement if shape else ufl.FiniteElement
        cell = ufl.Cell("interval", geometric_dimension=2)
        return self.space(make("Quadrature", cell, degree, *shape, quad_scheme="default"))

    def measure(self, points: int) -> Any:
        """Measure `dx` with the `gauss_rule` of so many points."""
        return measure(self.domain, points)

    def data(self, points: int, shape: tuple[int, ...] = ()) -> Any:
        """Data on a `gauss_space`."""
        return self.coefficient(self.gauss_space(points, *shape))


def _coefficients() -> type:
    class Coefficient(ufl.Coefficient):
        """A function whose name may stand in C; FFCx 0.5 takes UFL's own, w_{10}."""

        def __str__(self):
            return f"w{self.count()}"

    return Coefficient


def measure(ufl_domain, points: int):
    """Measure `dx` with the `gauss_rule` of so many points."""
    rule = {"quadrature_degree": 2 * points - 1, "quadrature_rule": "Gauss-Jacobi"}
    return ufl.Measure("dx", domain=ufl_domain, metadata=rule)
