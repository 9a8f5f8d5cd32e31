"""The symbols of the weak form as dolfinx has them: spaces, Functions and Constants on a mesh."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

import numpy as np

from fx_beam.fem.elements import Symbols

from .versions import Mesh, function_space


class DolfinxSymbols(Symbols):
    """Makes the symbols of forms on a mesh; the tags of cells number materials."""

    def __init__(self, mesh: Mesh, materials: Any):
        super().__init__(mesh.ufl_domain())
        self._mesh, self._materials = mesh, materials
        self._spaces: dict[Any, Any] = {}

    def space(self, element: Any) -> Any:
        """A function space, one for each element."""
        if element not in self._spaces:
            self._spaces[element] = function_space(self._mesh, element)
        return self._spaces[element]

    def coefficient(self, space: Any) -> fem.Function:
        """A Function."""
        return fem.Function(space)

    def constant(self, *shape: int) -> fem.Constant:
        """A Constant."""
        return fem.Constant(self._mesh, np.zeros(shape))

    def measure(self, points: int) -> ufl.Measure:
        """Measure of the beams; its subdomains are materials."""
        return super().measure(points)(subdomain_data=self._materials)
