"""Compiled forms on the elements of a mesh: their fields, sums over elements, values at points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import StepBatch

from .form_library import CompiledForm

_LIBRARY = "forms on elements", "expression_rows.c", "expression_rows.h"
# Constants that change in the rows of `RowValues`.
_CHANGING = "time", "dt", "load_increment", "memory", "load_factor", "parameters"
# Values that are found at once, each by a few coefficients.
_MOST = 2**17
_NONE = np.empty(0)


class Space:
    """Degrees of freedom of a kind of field: those of each cell, in the order of its tensors."""

    def __init__(self, dofs: np.ndarray, size: int):
        #: Degrees of freedom (cells, width), and the number of all.
        self.dofs, self.size = dofs, size
        #: Number of degrees of freedom of a cell.
        self.width = dofs.shape[1]


class Field:
    """A function of a space, by its values (size,)."""

    def __init__(self, space: Space):
        self.space, self.array = space, np.zeros(space.size)


class BoundForm:
    """A compiled form or expression on a mesh.

    `data` has fields and arrays by the names of coefficients and constants. Arguments have a
    `space` each. `tags` (cells,) number the subdomains.
    """

    def __init__(
        self,
        compiled: CompiledForm,
        mesh: Any,
        data: Mapping[str, Any],
        spaces: Sequence[Space] = (),
        tags: np.ndarray | None = None,
    ):
        self.compiled, self.spaces = compiled, spaces
        self._mesh, self._tags = mesh, tags
        self.fields: list[Field] = [data[name] for name in compiled.coefficients]
        #: Arrays of its constants by name.
        self.constants: dict[str, np.ndarray] = {name: data[name] for name in compiled.constants}
        #: Numbers of entries of an element's tensor, and of its coefficients.
        self.size = math.prod(space.width for space in spaces)
        self.width = sum(field.space.width for field in self.fields)

    @cached_property
    def cells(self) -> dict[int, np.ndarray]:
        """Cells of each integral by the number of its subdomain; -1 means all cells."""
        cells = np.arange(len(self._mesh.elements))
        return {tag: cells if tag < 0 else cells[self._tags == tag] for tag in self.compiled.tags}

    def coefficients(self) -> dict[int, np.ndarray]:
        """Values (cells, width) of its fields for each subdomain, in the order of its code."""
        none = np.empty((len(self._mesh.elements), 0))
        of_fields = [field.array[field.space.dofs] for field in self.fields]
        values = of_fields[0] if len(of_fields) == 1 else np.concatenate([none, *of_fields], axis=1)
        return {tag: values if tag < 0 else values[cells] for tag, cells in self.cells.items()}

    def values_of_constants(self) -> np.ndarray:
        """Those of all constants, one after the other."""
        return np.concatenate([np.empty(0), *(array.ravel() for array in self.constants.values())])

    @property
    def field_starts(self) -> dict[Field, int]:
        """Where the values of each field begin among its coefficients."""
        return _starts(self.fields, [field.space.width for field in self.fields])

    @property
    def constant_starts(self) -> dict[str, int]:
        """Where those of each constant begin, by name."""
        return _starts(self.constants, [array.size for array in self.constants.values()])

    def indices_in(self, other: BoundForm) -> tuple[list[int], list[int]]:
        """Indices of this form's coefficients and constants in the arrays of another form."""
        fields, constants = other.field_starts, other.constant_starts
        return (
            [fields[f] + k for f in self.fields for k in range(f.space.width)],
            [constants[c] + k for c, array in self.constants.items() for k in range(array.size)],
        )

    # -- Sums -----------------------------------------------------------------------------------

    def _tensors(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Cells of each integral, and their tensors (cells, size)."""
        constants, coordinates = self.values_of_constants()[None], self._mesh.coordinates
        packed = self.coefficients()
        for (tag, cells), function in zip(self.cells.items(), self.compiled.addresses, strict=True):
            places = coordinates if tag < 0 else coordinates[cells]
            arrays = packed[tag][None], constants, places
            yield cells, tabulated(function, *arrays, self.size)[0]

    def total(self) -> float:
        """Value of a functional."""
        return float(sum(tensors.sum() for _, tensors in self._tensors()))

    def add_to(self, out: np.ndarray, places: np.ndarray | None = None) -> None:
        """Add the vector of a linear form to `out` (size,).

        Or that of a bilinear form, whose tensors belong to `places` (cells, width ** 2).
        """
        places = self.spaces[0].dofs if places is None else places
        for cells, tensors in self._tensors():
            out += np.bincount(places[cells].ravel(), tensors.ravel(), len(out))


class RowValues:
    """Values of expressions at Gauss points, or tensors of a form, in several steps.

    Each expression is of some cells. From step to step the fields of `StepBatch.fields` change,
    and the constants of `_CHANGING`. Values may be those of `one_cell`, all expressions are of it.
    """

    def __init__(
        self,
        expressions: Iterable[tuple[BoundForm, int, np.ndarray]],
        mesh: Any,
        moving: Sequence[Field | None],
        one_cell: bool = False,
    ):
        self._mesh, self._moving, self._one_cell = mesh, moving, one_cell
        #: With the addresses of their functions, and their cells.
        self._expressions = [*expressions]

    def __call__(
        self, parts: StepBatch, parameters: np.ndarray, shape: tuple[int, ...]
    ) -> np.ndarray:
        """Values (n, cells, ...) of a shape in n steps, whose parameters (n, k) are given."""
        coordinates = self._mesh.coordinates  # scenes move nodes
        count = 1 if self._one_cell else len(coordinates)
        values = np.zeros((len(parts.t), count, *shape))
        most = max(1, _MOST // values[0].size)
        for first in range(0, len(values), most):
            rows = slice(first, first + most)
            batch = StepBatch(*(array[rows] if len(array) else array for array in parts))
            for form, address, cells in self._expressions:
                fields = self._coefficients(form, cells, batch)
                numbers = fields, self._constants(form, batch, parameters[rows]), coordinates[cells]
                out = tabulated(address, *numbers, math.prod(shape))
                # An array of all cells would copy the values.
                which = slice(None) if len(cells) == count else cells
                values[rows, which] += out.reshape(*out.shape[:2], *shape)
        return values

    def _coefficients(self, form: BoundForm, cells: np.ndarray, parts: StepBatch) -> np.ndarray:
        """Coefficients (n, cells, width) of an expression."""
        changing = dict(zip(self._moving, parts.fields, strict=True))
        coefficients = np.empty((len(parts.t), len(cells), form.width))
        for field, start in form.field_starts.items():
            values, dofs = changing.get(field, _NONE), field.space.dofs[cells]
            of_field = values.take(dofs, axis=1) if values.size else field.array[dofs]
            coefficients[..., start : start + field.space.width] = of_field
        return coefficients

    def _constants(self, form: BoundForm, parts: StepBatch, parameters: np.ndarray) -> np.ndarray:
        """Constants (n, m) of an expression."""
        factors = parts.load_factor if len(parts.load_factor) else np.ones(len(parts.t))
        columns = (x[:, None] for x in (parts.t, parts.dt, parts.dt, parts.memory, factors))
        changing = dict(zip(_CHANGING, (*columns, parameters), strict=True))
        constants = [np.empty((len(parts.t), 0))]
        for name, array in form.constants.items():
            value = changing.get(name)
            constants.append(np.tile(array.ravel(), (len(parts.t), 1)) if value is None else value)
        return np.hstack(constants)


def tabulated(function: int, w: np.ndarray, c: np.ndarray, x: np.ndarray, size: int) -> np.ndarray:
    """Values (n, cells, size) of a function that FFCx generates, by its address.

    Given are coefficients (n, cells, ...), constants (n, ...) and coordinates (cells, ...).
    """
    ffi, library = c_library.open_library(*_LIBRARY)
    values = np.zeros((*w.shape[:2], size))
    sizes = w.shape[2], c.shape[1], x.shape[1], size
    arrays = map(np.ascontiguousarray, (w, c, x, values))
    pointers = [ffi.from_buffer("double[]", array) for array in arrays]
    library.fx_tabulate(ffi.cast("Tabulate", function), sizes, *w.shape[:2], *pointers)
    return values


def _starts(keys: Iterable[Any], sizes: Iterable[int]) -> dict[Any, int]:
    return dict(zip(keys, itertools.accumulate(sizes, initial=0), strict=False))
