"""Values at the Gauss points in many steps at once, such as stress resultants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fx_beam.laws.interval import Parts

from . import ffcx_api
from .assembly import BoundForm, Field, tabulated
from .mesh import Mesh

# Values that are found at once, each by a few coefficients.
_MOST = 2**17


class PointValues:
    """Values of expressions at the Gauss points of elements, each of cells with its tag.

    Fields that change are `Parts.moving`; constants that do, by their symbols, are the time, the
    step, its memory and parameters.
    """

    def __init__(
        self,
        expressions: Sequence[BoundForm],
        tags: np.ndarray,
        mesh: Mesh,
        moving: Sequence[Field | None],
        changing: Sequence[Any],
    ):
        self._mesh, self._moving, self._changing = mesh, moving, changing
        self._expressions = [(of, np.flatnonzero(tags == i)) for i, of in enumerate(expressions)]

    def __call__(self, parts: Parts, parameters: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Values (n, cells, ...) of a shape in n steps, whose parameters (n, k) are given."""
        coordinates = self._mesh.coordinates  # scenes move nodes
        values = np.zeros((len(parts.t), len(coordinates), *shape))
        most = max(1, _MOST // values[0].size)
        for first in range(0, len(values), most):
            rows = slice(first, first + most)
            given = Parts(*(of[rows] if len(of) else of for of in parts))
            for of, cells in self._expressions:
                fields = self._coefficients(of, cells, given)
                numbers = fields, self._constants(of, given, parameters[rows]), coordinates[cells]
                function = ffcx_api.expression_function(of.compiled)
                out = tabulated(function, *numbers, math.prod(shape))
                values[rows, cells] = out.reshape(*out.shape[:2], *shape)
        return values

    def _coefficients(self, of: BoundForm, cells: np.ndarray, parts: Parts) -> np.ndarray:
        """Coefficients (n, cells, width) of an expression."""
        shape = len(parts.t), len(cells)
        fields = [self._on_cells(field, parts)[:, cells] for field in of.fields]
        each = [np.broadcast_to(field, (*shape, field.shape[2])) for field in fields]
        return np.concatenate([np.empty((*shape, 0)), *each], axis=2)

    def _on_cells(self, field: Field, parts: Parts) -> np.ndarray:
        """Values (n, cells, width) of a field, with n = 1 if it does not change."""
        for moving, values in zip(self._moving, parts.moving, strict=True):
            if moving is field:
                return values if values.ndim == 3 else values[:, field.space.dofs]
        return field.on_cells[None]

    def _constants(self, of: BoundForm, parts: Parts, parameters: np.ndarray) -> np.ndarray:
        """Constants (n, m) of an expression."""
        columns = parts.t[:, None], parts.dt[:, None], parts.memory[:, None], parameters
        changing = dict(zip(self._changing, columns, strict=True))
        constants = [np.empty((len(parts.t), 0))]
        for symbol, array in of.constants.items():
            value = changing.get(symbol)
            constants.append(np.tile(array.ravel(), (len(parts.t), 1)) if value is None else value)
        return np.hstack(constants)
