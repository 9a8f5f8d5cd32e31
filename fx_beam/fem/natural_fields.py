"""Natural strains at both ends of a step, as functions on the mesh of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import dolfinx_api, interval_mesh
from .fields import Fields


class NaturalFields:
    """Functions in the place of UFL's fields of natural strains; none if they are not `present`."""

    def __init__(self, mesh: Any, fields: Fields, present: bool):
        #: The functions by their fields, and spaces by the names of derivatives.
        self.data: dict[Any, Any] = {}
        self.spaces: dict[str, Any] = {}
        if present:
            space = interval_mesh.gauss_space(mesh, fields.degree, 3)
            self._points = dolfinx_api.element_dofs(space)
            self.data = {field: dolfinx_api.function(space) for field in fields.natural}
            self.spaces = {"natural": space, "natural_end": space}

    def set(self, start: np.ndarray | None, end: np.ndarray | None = None) -> None:
        """Set the strains (cells, degree, 3) at the start or at the end of the step."""
        for function, values in zip(self.data.values(), (start, end), strict=False):
            if values is not None:
                function.x.array.reshape(-1, 3)[self._points] = values
