"""Finite elements: those of UFL in dolfinx 0.5, those of basix later."""

from __future__ import annotations

import functools
from importlib import import_module
from typing import Any

import basix
import ufl

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
