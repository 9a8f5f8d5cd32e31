"""The symbols of the weak form as dolfinx has them: spaces, Functions and Constants on a mesh."""

from __future__ import annotations

import ufl
from dolfinx import fem

import numpy as np

from fx_beam.fem.elements import Symbols

from .grid import BeamMesh
from .versions import Element, MeshTags


class NamedConstant(fem.Constant):
    """A Constant whose name is seen where a form is printed."""

    name = ""

    def __str__(self) -> str:
        return self.name


class DolfinxSymbols(Symbols):
    """Makes the symbols of forms on a mesh; the tags of cells number materials."""

    def __init__(self, grid: BeamMesh, materials: MeshTags):
        super().__init__(grid.mesh.ufl_domain())
        self._grid, self._materials = grid, materials

    def space(self, element: Element) -> fem.FunctionSpace:
        """A function space, one for each element."""
        return self._grid.space(element)

    def coefficient(self, space: fem.FunctionSpace) -> fem.Function:
        """A Function."""
        return fem.Function(space)

    def constant(self, *shape: int) -> fem.Constant:
        """A Constant."""
        return NamedConstant(self._grid.mesh, np.zeros(shape))

    def measure(self, points: int) -> ufl.Measure:
        """Measure of the beams; its subdomains are materials."""
        return super().measure(points)(subdomain_data=self._materials)
