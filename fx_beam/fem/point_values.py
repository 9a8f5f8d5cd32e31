"""Values at the Gauss points in many steps at once, such as stress resultants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.laws.interval import Parts

from . import dolfinx_api, ffcx_api
from .dolfinx_api import CompiledForm

_LIBRARY = "values at Gauss points", "form_rows.c", "form_rows.h"
# Numbers of elements that are stored together.
_MOST = 2**20


class PointValues:
    """Values at the Gauss points of elements, by a form of each times the weight of its point.

    The form is bound to a mesh, whose cells on a subdomain `cells_of` gives. Fields that change are
    those of `Parts.moving`; `symbols` are the time, the step, its memory, and parameters.
    """

    def __init__(
        self,
        form: Any,
        compiled: CompiledForm,
        mesh: Any,
        degree: int,
        moving: Sequence[Any],
        symbols: Sequence[Any],
        cells_of: Callable[[int], np.ndarray],
    ):
        self._form, self._compiled, self._mesh = form, compiled, mesh
        self._ffi, self._c = c_library.kept_library(*_LIBRARY)
        self._integrals = [
            (tag, self._ffi.cast("Tabulate", address), cells_of(tag))
            for tag, address in ffcx_api.integral_functions(compiled)
        ]
        #: Number, offset and degrees of freedom of each field that changes.
        self._moving = [
            (kind, offset, dolfinx_api.element_dofs(moving[kind].function_space))
            for kind, offset in dolfinx_api.coefficient_offsets(form, moving)
        ]
        self._offsets = dolfinx_api.packed_constants(form, compiled, symbols)[1]
        #: Weights (points, 1) of the points, relative to the element's length.
        self._weights = dolfinx_api.gauss_weights(degree)[:, None]

    def __call__(self, parts: Parts, parameters: np.ndarray) -> np.ndarray:
        """Values (n, cells, points, m) in n steps, with the parameters (n, k) of the form."""
        coordinates = dolfinx_api.element_coordinates(self._mesh)  # scenes move nodes
        rows, cells = len(parts.t), len(coordinates)
        fields, constants = self._fields(parts), self._constants(parts, parameters)
        packed = dolfinx_api.packed_coefficients(self._form, self._compiled)
        size = dolfinx_api.tensor_size(self._form)
        values = np.empty((rows, cells, size))
        for tag, tabulate, of_tag in self._integrals:
            given = packed[tag]
            most = max(1, _MOST // max(1, given.size))
            for first in range(0, rows, most):
                own = slice(first, min(first + most, rows))
                w = np.empty((own.stop - first, *given.shape))
                w[:] = given
                for offset, field in fields:
                    of_rows = field[own][:, of_tag]
                    w[..., offset : offset + of_rows.shape[2]] = of_rows
                values[own, of_tag] = self._tabulated(
                    tabulate, w, constants[own], coordinates[of_tag], size
                )
        return values.reshape(rows, cells, len(self._weights), -1) / self._weights

    def _fields(self, parts: Parts) -> list[tuple[int, np.ndarray]]:
        """Offsets of fields that change, and their values (n, cells, width)."""
        of_kinds = parts.moving
        return [
            (offset, of_kinds[kind] if of_kinds[kind].ndim == 3 else of_kinds[kind][:, dofs])
            for kind, offset, dofs in self._moving
        ]

    def _constants(self, parts: Parts, parameters: np.ndarray) -> np.ndarray:
        """Constants (n, m) of the form."""
        known = dolfinx_api.values_of_constants(self._form)
        constants = np.tile(known, (len(parts.t), 1))
        columns = parts.t[:, None], parts.dt[:, None], parts.memory[:, None], parameters
        for offset, values in zip(self._offsets, columns, strict=True):
            if offset >= 0:
                constants[:, offset : offset + values.shape[1]] = values
        return constants

    def _tabulated(
        self, tabulate: Any, w: np.ndarray, c: np.ndarray, x: np.ndarray, size: int
    ) -> np.ndarray:
        """Tensors (n, cells, size) of coefficients, constants and coordinates."""
        rows, cells, width = w.shape
        tensors = np.zeros((rows, cells, size))
        address = self._ffi.from_buffer
        sizes = self._ffi.new("FormSizes *", (width, c.shape[1], x.shape[1], size))[0]
        given = (address("double[]", np.ascontiguousarray(array)) for array in (w, c, x, tensors))
        self._c.fx_tabulate(tabulate, sizes, rows, cells, *given)
        return tensors
