"""Values at the Gauss points in many steps at once, such as stress resultants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam import c_library
from fx_beam.laws.interval import Parts

from . import dolfinx_api, ffcx_api
from .dolfinx_api import CompiledForm

_LIBRARY = "values at Gauss points", "expression_rows.c", "expression_rows.h"
# Values that are found at once, each by a few coefficients.
_MOST = 2**17


class _OnCells(NamedTuple):
    """An expression on some cells: its function in C, and its fields in their order there."""

    tabulate: Any
    cells: np.ndarray
    coefficients: list[Any]
    constants: list[Any]


class PointValues:
    """Values of UFL expressions at the Gauss points of elements.

    They are compiled, each with its cells; `data` has what is in the place of their symbols. Those
    that change are `Parts.moving`, and the time, the step, its memory and parameters.
    """

    def __init__(
        self,
        expressions: Iterable[tuple[CompiledForm, np.ndarray]],
        mesh: Any,
        data: Mapping[Any, Any],
        moving: Sequence[Any],
        changing: Sequence[Any],
    ):
        self._mesh, self._data, self._moving, self._changing = mesh, data, moving, changing
        self._ffi, self._c = c_library.kept_library(*_LIBRARY)
        self._expressions = [
            _OnCells(
                self._ffi.cast("Tabulate", ffcx_api.expression_function(compiled)),
                cells,
                *dolfinx_api.fields_of_expression(compiled),
            )
            for compiled, cells in expressions
        ]

    def __call__(self, parts: Parts, parameters: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Values (n, cells, ...) of a shape in n steps, whose parameters (n, k) are given."""
        coordinates = dolfinx_api.element_coordinates(self._mesh)  # scenes move nodes
        values = np.zeros((len(parts.t), len(coordinates), *shape))
        most = max(1, _MOST // values[0].size)
        for first in range(0, len(values), most):
            rows = slice(first, first + most)
            given = Parts(*(of[rows] if len(of) else of for of in parts))
            for own in self._expressions:
                w, c = self._coefficients(own, given), self._constants(own, given, parameters[rows])
                out = self._tabulated(own.tabulate, w, c, coordinates[own.cells], shape)
                values[rows, own.cells] = out
        return values

    def _coefficients(self, of: _OnCells, parts: Parts) -> np.ndarray:
        """Coefficients (n, cells, width) of an expression."""
        shape = len(parts.t), len(of.cells)
        fields = [self._on_cells(field, parts)[:, of.cells] for field in of.coefficients]
        each = [np.broadcast_to(field, (*shape, field.shape[2])) for field in fields]
        return np.concatenate([np.empty((*shape, 0)), *each], axis=2)

    def _on_cells(self, field: Any, parts: Parts) -> np.ndarray:
        """Values (n, cells, width) of a field, with n = 1 if it does not change."""
        function = self._data[field]
        for symbol, values in zip(self._moving, parts.moving, strict=True):
            if symbol is field:
                dofs = dolfinx_api.element_dofs(function.function_space)
                return values if values.ndim == 3 else values[:, dofs]
        return dolfinx_api.values_on_cells(function)[None]

    def _constants(self, of: _OnCells, parts: Parts, parameters: np.ndarray) -> np.ndarray:
        """Constants (n, m) of an expression."""
        columns = parts.t[:, None], parts.dt[:, None], parts.memory[:, None], parameters
        constants = [np.empty((len(parts.t), 0))]
        for constant in of.constants:
            pairs = zip(self._changing, columns, strict=True)
            value = next((values for symbol, values in pairs if symbol is constant), None)
            if value is None:
                value = np.tile(np.ravel(self._data[constant].value), (len(parts.t), 1))
            constants.append(value)
        return np.hstack(constants)

    def _tabulated(
        self,
        tabulate: Any,
        w: np.ndarray,
        c: np.ndarray,
        x: np.ndarray,
        shape: tuple[int, ...],
    ) -> np.ndarray:
        """Values (n, cells, ...) of coefficients, constants of rows, and coordinates of cells."""
        values = np.zeros((*w.shape[:2], *shape))
        sizes = w.shape[2], c.shape[1], x.shape[1], int(np.prod(shape))
        arrays = (np.ascontiguousarray(array) for array in (w, c, x, values))
        given = (self._ffi.from_buffer("double[]", array) for array in arrays)
        self._c.fx_tabulate(tabulate, self._ffi.new("Sizes *", sizes)[0], *w.shape[:2], *given)
        return values
