"""Compiled forms on the elements of a mesh: what they read, their values in steps, and sums."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.content_cache import shallow_copy
from fx_beam.laws.interval import StepBatch

from .form_library import CompiledForm

_LIBRARY = "forms on elements", "expression_rows.c", "expression_rows.h"
# Values that are found at once, each by a few coefficients.
_MOST = 2**17
_NONE = np.empty(0)
# Fields of `StepBatch` by the names of constants.
_OF_STEPS = {"time": 0, "dt": 1, "load_increment": 1, "memory": 10}
_OF_STEPS |= {"parameters": 11, "load_factor": 12}


class Space:
    """Degrees of freedom of a kind of field: those of each cell, in the order of its tensors."""

    def __init__(self, dofs: np.ndarray, size: int):
        #: Degrees of freedom (cells, width), and the number of all.
        self.dofs, self.size = dofs, size
        #: Number of degrees of freedom of a cell.
        self.width = dofs.shape[1]


class Field:
    """A function of a space, by its values (size,), which are zero if it has `none` of its own."""

    def __init__(self, space: Space, none: bool = False):
        self.space = space
        self.array = np.broadcast_to(0.0, space.size) if none else np.zeros(space.size)


class MeshTerm:
    """A compiled form or expression on a mesh: degrees of freedom, kernels, and what these read.

    `data` has fields and arrays by the names of coefficients and constants; those of `moving` are
    fields of `StepBatch`. Arguments have a `space` each. `tags` (cells,) number the subdomains.
    """

    def __init__(
        self,
        compiled: CompiledForm,
        mesh: Any,
        data: Mapping[str, Any],
        spaces: Sequence[Space] = (),
        tags: np.ndarray | None = None,
        moving: Sequence[Field | None] = (),
    ):
        self.compiled, self.spaces = compiled, spaces
        self._mesh = mesh
        self.fields: list[Field] = [data[name] for name in compiled.coefficients]
        #: Arrays of its constants by name.
        self.constants: dict[str, np.ndarray] = {name: data[name] for name in compiled.constants}
        #: Numbers of entries of an element's tensor, and of its coefficients.
        self.size = math.prod(space.width for space in spaces)
        self.width = sum(field.space.width for field in self.fields)
        #: Cells of each kernel, one of each subdomain; -1 means all cells.
        self.cells = [
            mesh.numbers if tag < 0 or np.all(tags == tag) else mesh.numbers[tags == tag]
            for tag in compiled.tags
        ]
        #: Where the values of each field begin among its coefficients.
        self.field_starts = _starts(self.fields, [field.space.width for field in self.fields])
        #: Where those of each constant begin, by name.
        self.constant_starts = _starts(self.constants, [a.size for a in self.constants.values()])
        # Fields of `StepBatch` that set coefficients and constants.
        self._field_numbers = [moving.index(f) + 2 if f in moving else None for f in self.fields]
        self._constant_numbers = [_OF_STEPS[name] for name in self.constants]

    def on(self, mesh: Any, data: Mapping[str, Any]) -> MeshTerm:
        """The form on the mesh of another scene of this structure, which reads other data."""
        other = shallow_copy(self)
        other._mesh, other.fields = mesh, [data[name] for name in self.compiled.coefficients]
        other.constants = {name: data[name] for name in self.constants}
        other.field_starts = dict(zip(other.fields, self.field_starts.values(), strict=True))
        return other

    def indices_in(self, other: MeshTerm) -> tuple[list[int], list[int]]:
        """Indices of this form's coefficients and constants in the arrays of another form."""
        fields, constants = other.field_starts, other.constant_starts
        return (
            [fields[f] + k for f in self.fields for k in range(f.space.width)],
            [constants[c] + k for c, array in self.constants.items() for k in range(array.size)],
        )

    # -- What its kernels read ------------------------------------------------------------------

    def coefficients(self, cells: Any, steps: StepBatch) -> np.ndarray:
        """Coefficients (n, cells, width) of some cells in n steps; what these lack is constant."""
        count = len(self._mesh.coordinates[cells])
        coefficients = np.empty((len(steps.t), count, self.width))
        for (field, start), number in zip(
            self.field_starts.items(), self._field_numbers, strict=True
        ):
            values, dofs = _NONE if number is None else steps[number], field.space.dofs[cells]
            field_values = values.take(dofs, axis=1) if values.size else field.array[dofs]
            coefficients[..., start : start + field.space.width] = field_values
        return coefficients

    def constants_in(self, steps: StepBatch) -> np.ndarray:
        """Constants (n, m) in n steps; what these lack stays as it is."""
        parts, count = [np.empty((len(steps.t), 0))], len(steps.t)
        for array, number in zip(self.constants.values(), self._constant_numbers, strict=True):
            values = steps[number]
            constants = values if values.size else np.broadcast_to(array, (count, *array.shape))
            parts.append(constants.reshape(count, -1))
        return np.hstack(parts) if len(parts) > 1 else parts[0]

    # -- Values and sums ------------------------------------------------------------------------

    def tensors(
        self, steps: StepBatch, size: int, cell: int | None = None
    ) -> Iterator[tuple[Any, np.ndarray]]:
        """Cells of each kernel, or one of them, and what it gives (n, cells, size) in n steps."""
        constants, coordinates = self.constants_in(steps), self._mesh.coordinates
        for function, cells in zip(self.compiled.addresses, self.cells, strict=True):
            chosen: Any = cells if cell is None else cells[cells == cell]
            if len(chosen):
                # An array of all cells would copy the values.
                chosen = slice(None) if len(chosen) == len(coordinates) else chosen
                arrays = self.coefficients(chosen, steps), constants, coordinates[chosen]
                yield chosen, tabulated(function, *arrays, size)

    def values(
        self, steps: StepBatch, shape: tuple[int, ...], cell: int | None = None
    ) -> np.ndarray:
        """Values (n, cells, ...) of a shape in n steps, or those (n, 1, ...) of one cell."""
        count, size = 1 if cell is not None else len(self._mesh.elements), math.prod(shape)
        values = np.zeros((len(steps.t), count, size))
        most = max(1, _MOST // (count * size))
        for first in range(0, len(values), most):
            rows = slice(first, first + most)
            batch = StepBatch(*(array[rows] if len(array) else array for array in steps))
            for cells, tensors in self.tensors(batch, size, cell):
                values[rows, cells if cell is None else slice(None)] += tensors
        return values.reshape(*values.shape[:2], *shape)

    def total(self, step: StepBatch) -> float:
        """Value of a functional in one step."""
        return float(sum(tensors.sum() for _, tensors in self.tensors(step, 1)))

    def add_to(self, out: np.ndarray, step: StepBatch) -> None:
        """Add the vector of a linear form in one step to `out` (size,)."""
        places = self.spaces[0].dofs
        for cells, tensors in self.tensors(step, self.size):
            out += np.bincount(places[cells].ravel(), tensors.ravel(), len(out))


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
