"""Compiled forms on the elements of a mesh: what they read, their values in steps, and sums."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.laws.interval import StepBatch

from .form_library import CompiledForm

_LIBRARY = "forms on elements", "expression_rows.c", "expression_rows.h"
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


class Term:
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
        self._mesh, self._moving, cells = mesh, moving, np.arange(len(mesh.elements))
        self.fields: list[Field] = [data[name] for name in compiled.coefficients]
        #: Arrays of its constants by name.
        self.constants: dict[str, np.ndarray] = {name: data[name] for name in compiled.constants}
        #: Numbers of entries of an element's tensor, and of its coefficients.
        self.size = math.prod(space.width for space in spaces)
        self.width = sum(field.space.width for field in self.fields)
        #: Cells of each kernel, one of each subdomain; -1 means all cells.
        self.cells = [cells if tag < 0 else cells[tags == tag] for tag in compiled.tags]

    @property
    def field_starts(self) -> dict[Field, int]:
        """Where the values of each field begin among its coefficients."""
        return _starts(self.fields, [field.space.width for field in self.fields])

    @property
    def constant_starts(self) -> dict[str, int]:
        """Where those of each constant begin, by name."""
        return _starts(self.constants, [array.size for array in self.constants.values()])

    def indices_in(self, other: Term) -> tuple[list[int], list[int]]:
        """Indices of this form's coefficients and constants in the arrays of another form."""
        fields, constants = other.field_starts, other.constant_starts
        return (
            [fields[f] + k for f in self.fields for k in range(f.space.width)],
            [constants[c] + k for c, array in self.constants.items() for k in range(array.size)],
        )

    # -- What its kernels read ------------------------------------------------------------------

    def coefficients(self, cells: np.ndarray, steps: StepBatch) -> np.ndarray:
        """Coefficients (n, cells, width) of some cells in n steps; what these lack is constant."""
        changing = dict(zip(self._moving, steps.fields, strict=False))
        coefficients = np.empty((len(steps.t), len(cells), self.width))
        for field, start in self.field_starts.items():
            values, dofs = changing.get(field, _NONE), field.space.dofs[cells]
            of_field = values.take(dofs, axis=1) if values.size else field.array[dofs]
            coefficients[..., start : start + field.space.width] = of_field
        return coefficients

    def constants_in(self, steps: StepBatch) -> np.ndarray:
        """Constants (n, m) in n steps; what these lack stays as it is."""
        columns = {"time": steps.t, "dt": steps.dt, "load_increment": steps.dt}
        columns |= {"memory": steps.memory, "load_factor": steps.load_factor}
        columns["parameters"] = steps.parameters
        constants = np.empty((count := len(steps.t), sum(a.size for a in self.constants.values())))
        for name, start in self.constant_starts.items():
            array, values = self.constants[name], columns.get(name, _NONE)
            of_steps = values.reshape(count, -1) if values.size else array.ravel()
            constants[:, start : start + array.size] = of_steps
        return constants

    # -- Values and sums ------------------------------------------------------------------------

    def tensors(
        self, steps: StepBatch, size: int, cell: int | None = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Cells of each kernel, or one of them, and what it gives (n, cells, size) in n steps."""
        constants = self.constants_in(steps)
        for function, cells in zip(self.compiled.addresses, self.cells, strict=True):
            chosen = cells if cell is None else cells[cells == cell]
            if len(chosen):
                places = self._mesh.coordinates[chosen]  # scenes move nodes
                arrays = self.coefficients(chosen, steps), constants, places
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
                # An array of all cells would copy the values.
                values[rows, slice(None) if len(cells) == count else cells] += tensors
        return values.reshape(*values.shape[:2], *shape)

    def total(self, step: StepBatch) -> float:
        """Value of a functional in one step."""
        return float(sum(tensors.sum() for _, tensors in self.tensors(step, 1)))

    def add_to(self, out: np.ndarray, step: StepBatch, places: np.ndarray | None = None) -> None:
        """Add the vector of a linear form in one step to `out` (size,).

        Or that of a bilinear form, whose tensors belong to `places` (cells, width ** 2).
        """
        places = self.spaces[0].dofs if places is None else places
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
