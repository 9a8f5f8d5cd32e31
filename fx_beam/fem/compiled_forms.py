"""Compiled forms and expressions: their C from a cache, and their values on elements."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fx_beam import c_library, library_cache
from fx_beam.c_library import compiled
from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.laws.interval import StepBatch
from fx_beam.symbolic import Written

# -- Compiled forms and expressions, in the cache by keys that are known before anything is in UFL
# FFCx makes a text in C of what is written in UFL, once. Beside it are the names of its fields,
# which is all that a process needs to know. Functions of one element are compiled where they are
# called.


# Vector instructions of a single law or element would read pairs of numbers that were just written
# one by one, for which processors wait long. The loop computes several elements at once instead.
_FLAGS = "-O2", "-fno-tree-slp-vectorize"
# Where all that becomes a form is written.
_PACKAGE = Path(__file__).parents[1]
_WRITERS = "laws/*.py", "fem/*.py", "scene/law.py"


class CompiledForm(NamedTuple):
    """A form or an expression that was compiled for all meshes of its kind."""

    name: str
    module: FormModule
    #: Names of its coefficients and constants, in the order of its code.
    coefficients: list[str]
    constants: list[str]
    #: Number of arguments of a form, and of values of an expression.
    arguments: int
    values: int
    #: Subdomain (-1: all cells) and name in C of each function.
    functions: list[tuple[int, str]]

    @property
    def tags(self) -> list[int]:
        """Subdomain of each integral (-1: all cells)."""
        return [tag for tag, _ in self.functions]

    @property
    def addresses(self) -> list[int]:
        """Addresses of the functions of one element, one for each integral."""
        return [self.module.addresses[name] for _, name in self.functions]


class FormModule:
    """Forms whose code is one text in C, by name."""

    def __init__(self, key: str, content: Mapping[str, Any]):
        #: Identifier of the text.
        self.key = key
        #: What it includes, the text, and the number of arguments of its functions.
        self.header, self.source = content["header"], content["source"]
        self.arguments = content["arguments"]
        #: What else was written of them.
        self.facts = content["facts"]
        self.forms = {
            name: CompiledForm(name, self, **form) for name, form in content["forms"].items()
        }
        #: Functions for several elements at once, by what was asked for.
        self.batches: dict[tuple[str, ...], c_library.Functions] = {}

    @cached_property
    def addresses(self) -> dict[str, int]:
        """Addresses of the functions of one element, by their names in C."""
        title, text = " and ".join(map(repr, self.forms)), self.header + self.source
        names = [name for form in self.forms.values() for _, name in form.functions]
        self._functions = c_library.functions_of(title, text, lambda: text, names, _FLAGS)
        return dict(zip(names, self._functions, strict=True))


def form_module(key: object, write: Callable[[], Written]) -> FormModule:
    """The forms of a key, which are written if they are not in the cache.

    Without a key they are written in any case, and signed: functions of a user may have changed.
    """
    if key is not None:
        return compiled((FormModule, key), lambda: _loaded(key, write))
    from . import ffcx_api

    written = write()
    key = ffcx_api.signature(written)
    return compiled((FormModule, key), lambda: _loaded(key, lambda: written), user_defined=True)


def _loaded(key: object, write: Callable[[], Written]) -> FormModule:
    origin = compiled((_origin,), _origin)
    name = hashlib.sha256(repr((key, origin)).encode()).hexdigest()[:32]
    file = f"{name}.forms"

    def loader(path: Path) -> dict:
        return json.loads(library_cache.content(path))

    def builder(folder: Path) -> dict:
        from . import ffcx_api

        c_library.check()
        content = ffcx_api.generated(write(), name)
        (folder / file).write_text(json.dumps(content))
        return content

    return FormModule(name, library_cache.loaded(file, loader, builder))


def _origin() -> tuple:
    """Digest of the files in which forms are written, and the places of UFL and FFCx."""
    texts = (path.read_bytes() for pattern in _WRITERS for path in sorted(_PACKAGE.glob(pattern)))
    specs = [find_spec(name) for name in ("ufl", "basix", "ffcx")]
    places = [Path(spec.origin) for spec in specs if spec is not None and spec.origin]
    installed = [(str(place), place.stat().st_mtime_ns) for place in places]
    return hashlib.sha256(b"".join(texts)).hexdigest(), installed


# -- Compiled forms on the elements of a mesh: what they read, their values in steps, and sums --


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
