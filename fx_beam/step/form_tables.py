"""Compiled forms and the elements on which they are integrated, for the compiled loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.c_library import Structs
from fx_beam.content_cache import cached_by_content, shallow_copy
from fx_beam.dual import floats
from fx_beam.fem.assembly import Field, MeshTerm
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.sparsity import starts_of
from fx_beam.laws.interval import StepBatch

from .block import address_of, aligned_zeros
from .build import load_batches
from .lu_layout import ROW

#: Forms that are evaluated together, by their names in C.
FORMS = {
    "internal_forces": ("internal forces", "tangent"),
    "energy": ("strain energy",),
    "inversion": ("inverted sections",),
    "added": ("added virtual work",),
    "actuated": ("work of natural strains",),
    "lost": ("lost energy",),
    "taken": ("scheme's loss",),
    "held_by_scheme": ("scheme's energy",),
    "held_before": ("scheme's energy at the start",),
    "evolution": ("internal variables",),
    "drag": ("drag", "tangent of drag"),
    "lost_to_drag": ("loss to drag",),
}


class Kernel(NamedTuple):
    """Forms that are evaluated together, such as internal forces and their tangent.

    The compiler evaluates only once what they have in common, such as sines and cosines.
    """

    #: Forms on a mesh; their tensor entries are in this order. The first has all coefficients and
    #: constants.
    forms: list[MeshTerm]

    @property
    def size(self) -> int:
        """Number of all tensor entries."""
        return sum(form.size for form in self.forms)

    @property
    def key(self) -> str:
        """Identifier of the generated code."""
        return " ".join(f"{form.compiled.module.key} {form.compiled.name}" for form in self.forms)

    def source(self) -> str:
        """C functions element_0, element_1, ... for each integral."""
        tags = self.forms[0].compiled.tags
        bodies: dict[int, list[str]] = {tag: [] for tag in tags}
        declared, modules = [], [form.compiled.module for form in self.forms]
        unused = ", 0" * (modules[0].arguments - 4)
        for number, form in enumerate(self.forms):
            for tag, name in form.compiled.functions:
                declared.append(f"INLINED ufcx_tabulate_tensor_float64 {name};")
                bodies[tag].append(self._call(number, name, unused))
        arguments = "double *A, const double *w, const double *c, const double *x"
        elements = [
            f"INLINED void element_{i}({arguments}) {{\n{''.join(bodies[tag])}}}"
            for i, tag in enumerate(tags)
        ]
        # Forms of one module have the same text.
        texts = dict.fromkeys(module.source for module in modules)
        header = [modules[0].header, *declared, "#define for UNROLLED for"]
        return "\n".join([*header, *texts, *elements, "#undef for"])

    def _call(self, number: int, name: str, unused: str) -> str:
        """Call of the function of a form with its own coefficients and constants."""
        if number == 0:
            return f"{name}(A, w, c, x{unused});\n"
        first = sum(form.size for form in self.forms[:number])
        indices = self.forms[number].indices_in(self.forms[0])
        arrays = zip("wc", indices, strict=True)
        lists = (", ".join(f"{array}[{i}]" for i in index) or "0" for array, index in arrays)
        packed = "double own_w[] = {{{}}}, own_c[] = {{{}}}".format(*lists)
        return f"{{ {packed};\n{name}(A + {first}, own_w, own_c, x{unused}); }}\n"


# Blocks of cells that have their coefficients each.
_FEW = 64
# What is read before any step.
_NO_STEP = StepBatch(np.zeros(1), np.ones(1))


class FormTables:
    """Forms as ``Form`` of c/numbers.h, of the `Problem` of tables.py."""

    def __init__(self, problem: Any):
        self._tables, self._lanes = (p := problem.c.tables), problem.constants.LANES
        self._storage, self._ffi = problem.storage, problem.ffi
        self._structs = Structs(self._ffi)
        # Cells that threads take at once.
        self._piece = problem.constants.PIECE * self._lanes if self._storage.is_large else 0
        self._forms: BeamForms = problem.model.forms.beams
        self._all_forms, mesh = problem.model.forms, problem.model.mesh
        #: Degrees of freedom, internal variables and natural strains (cells, n) of each cell.
        self.rows = {"dofs": mesh.unknowns.dofs}
        for name, n in ("internal", p.internal.per_cell), ("natural", p.natural.per_cell):
            if n:
                self.rows[name] = np.arange(p.cells * n).reshape(-1, n)
        self._coordinates_of_cells = mesh.coordinates
        #: Tables and coordinates of cells by cells, since forms have them in common.
        self._shared: dict[bytes, tuple[dict[str, object], np.ndarray]] = {}
        #: Numbers of the scene, which C reads here: coordinates with their cells; data of beams;
        #: and load factors where C sets none.
        self._coordinates: list[tuple[np.ndarray, np.ndarray]] = []
        self._data: list[CellData] = []
        self._factors: list[np.ndarray] = []
        self._cells: list[Any] = []
        self._constants: list[np.ndarray] = []

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        arrays = [blocks for _, blocks in self._coordinates] + self._constants
        return self._cells, arrays + [data.array for data in self._data if data.is_own]

    def in_block(self, block: Any, problem: Any) -> FormTables:
        """The tables of a run, in its block, with the numbers of its model."""
        other, view = shallow_copy(self), block.view
        other._tables, other._storage = problem.c.tables, problem.storage
        other._all_forms, other._forms = problem.model.forms, problem.model.forms.beams
        other._structs = Structs(self._ffi)
        other._shared = {key: (data, view(x)) for key, (data, x) in self._shared.items()}
        other._coordinates = [(cells, view(blocks)) for cells, blocks in self._coordinates]
        other._factors = [view(factor) for factor in self._factors]
        other._constants = [*map(view, self._constants)]
        other._cells = [block.struct(self._ffi, x) for x in self._cells]
        cells = (x for several in other._cells for x in several)
        other._data = [data.in_block(block, x) for data, x in zip(self._data, cells, strict=True)]
        model = problem.model
        other.set_numbers(model.mesh.coordinates, model.data.forms.beams)
        return other

    @property
    def is_placed(self) -> bool:
        """Whether all numbers have places of their own."""
        return all(data.is_own for data in self._data)

    def places(self, plan: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Places of data of beams in a block, by name, and the entries that are there."""
        pairs: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for data in self._data:
            for name, at, entries in data.places(plan):
                pairs.setdefault(name, []).append((at, entries))
        return {
            name: (np.concatenate([at for at, _ in rows]), np.concatenate([e for _, e in rows]))
            for name, rows in pairs.items()
        }

    def move(self, coordinates: np.ndarray, view: Callable = lambda blocks: blocks) -> None:
        """Set coordinates of cells, here or in the `view` of a block."""
        for cells, blocks in self._coordinates:
            view(blocks)[...] = self._in_plane(coordinates[cells])

    def set_numbers(self, coordinates: np.ndarray | None, numbers: Mapping[str, Any]) -> None:
        """Set the numbers of a scene; coordinates of cells only if given."""
        if coordinates is not None:
            self._coordinates_of_cells = coordinates  # also of forms that are added later
            self.move(coordinates)
        self.set_load(1.0)
        flat = {name: floats(values).ravel() for name, values in numbers.items()}
        for data in self._data:
            data.set_numbers(flat)

    def set_load(self, factor: float) -> None:
        """Set the load factor of virtual works in steps of a motion."""
        for value in self._factors:
            value[...] = factor

    def all(self, names: Container[str]) -> dict[str, dict]:
        """The wanted ones of `FORMS` that the model has, by their names in C."""
        tables, bound = dict[str, dict](), self._forms.bound
        for name, forms in FORMS.items():
            known = [form for form in forms if form in bound]
            if known and name in names:
                tables[name] = self.of(known[-1], Kernel([bound[form] for form in known]))
        if self._piece:
            self._all_forms.forget_cell_entries()
        return tables

    def of(self, name: str, kernel: Kernel) -> dict[str, object]:
        """Forms of a kernel; `name` is that of the form that takes longest to compile."""
        p, data, fields = self._tables, self._forms.data, self._forms.data.moving
        form, cells = kernel.forms[0], kernel.forms[0].cells
        width = form.width
        numbers = kernel.size, width, p.mesh.cell_coordinates
        loaded = form.compiled.module.batches  # which stays as long as the form
        batches = load_batches(name, kernel.key, kernel.source, len(cells), numbers, loaded)
        starts = form.field_starts
        moving = [(i, starts[field]) for i, field in enumerate(fields) if field in starts]
        at_rest, known = self._forms.kind.scheme.rates.at_rest, form.constant_starts
        step_names = ("load_increment", "load_factor") if at_rest else ("dt", "memory")
        constants = np.array(form.constants_in(_NO_STEP)[0])
        self._constants.append(constants)
        parameter_members = {"parameters": len(data.parameters), "parameter": data.parameters}
        *offsets, first = (known.get(name, -1) for name in ("time", *step_names, "parameters"))
        named = {id(field): name for name, field in data.named.items()}
        # C sets those that move.
        still = {named[id(field)]: field for field in starts if field not in fields}
        columns = [starts[field] + k for field in still.values() for k in range(field.space.width)]
        numbers_of_cells = self._ffi.new("Cells[]", len(cells))
        self._cells.append(numbers_of_cells)
        for own, rows, batch in zip(numbers_of_cells, cells, batches, strict=True):
            tables, coordinates = self._tables_of(rows)
            integral = {"batch": batch, "cells": len(rows)} | tables
            self._structs.set(own, of=[integral], coordinates=coordinates)
            self._data.append(CellData(still, rows, self._lanes, self._ffi, own))
        if "load_factor" in known and not at_rest:
            self._factors.append(constants[known["load_factor"] :][:1])
        form_tables = {
            "width": width,
            "data_width": len(columns),
            "data_column": columns,
            "moving": len(moving),
            "kind": [kind for kind, _ in moving],
            "offset": [offset for _, offset in moving],
            **dict(zip(("time_at", "dt_at", "memory_at"), offsets, strict=True)),
            "parameters_at": first,
            **(parameter_members if first >= 0 else {}),
        }
        return {
            "integrals": len(cells),
            "tables": [form_tables],
            "cells": int(self._ffi.cast("uintptr_t", numbers_of_cells)),
            "constants": constants,
        }

    def _tables_of(self, cells: np.ndarray) -> tuple[dict[str, object], np.ndarray]:
        """Tables of some cells, by their names in C, and coordinates."""
        if (key := cells.tobytes()) in self._shared:
            return self._shared[key]
        stored_at = self._storage.stored_at[self._all_forms.cell_entries[cells]]
        first_free = self._tables.tangent.stored
        data: dict[str, object] = {
            n: self._blocks(rows[cells]) for n, rows in self.rows.items() if n != "dofs"
        }
        nodes = self.rows["dofs"][cells, 2 * self.rows["dofs"].shape[1] // 3 :] - 2
        data |= {"dofs": self._blocks(nodes), "to": self._blocks(nodes, self._tables.dofs)}
        if self._piece:
            data |= in_colours(nodes, self._piece)
        coordinates = self._in_plane(self._coordinates_of_cells[cells])
        self._coordinates.append((cells, coordinates))
        if self._tables.system.chain:
            rows = rows_of_nodes(stored_at, first_free, self._lanes)
            data |= rows | {"run": self._blocks(rows["run"], first_free)}
        else:
            data["stored_at"] = self._blocks(stored_at, first_free)
        self._shared[key] = data, coordinates
        return data, coordinates

    def _blocks(self, rows: np.ndarray, first_free: int | None = None) -> np.ndarray:
        return in_lanes(rows, self._lanes, first_free)

    def _in_plane(self, coordinates: np.ndarray) -> np.ndarray:
        """Blocks of x and y of coordinates (cells, 3 n) of places."""
        places = coordinates.reshape(len(coordinates), -1, 3)[:, :, :2]
        return self._blocks(places.reshape(len(places), -1))


class CellData:
    """Coefficients of the cells of an integral that do not move, from fields by name.

    Few blocks of cells have numbers of their own, which are set in place; of many, C has equal
    blocks once.
    """

    def __init__(self, fields: dict[str, Field], cells: np.ndarray, lanes: int, ffi: Any, own: Any):
        self._fields, self._cells, self._lanes = fields, cells, lanes
        self._ffi, self._of_c = ffi, own
        #: Whether each block has numbers of its own.
        self.is_own = -(-len(cells) // lanes) <= _FEW
        if not self.is_own:
            self._share({})
            return
        # Columns of each field in a block, and places of its numbers in the array of the field.
        self._places: list[tuple[slice, np.ndarray]] = []
        blocks, column = self._blocks({}), 0
        self._point_to(blocks, np.arange(len(blocks), dtype=np.int32))
        for field in fields.values():
            places = in_lanes(field.space.dofs[cells], lanes)
            columns = slice(column, column := column + places.shape[1])
            self._places.append((columns, places))

    def places(self, plan: Any) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name of each field, places of its numbers among those of a block, and their entries."""
        first = plan.place(address_of(self.array)) // 8
        at = first + np.arange(self.array.size).reshape(self.array.shape)
        for name, (columns, places) in zip(self._fields, self._places, strict=True):
            yield name, at[:, columns].ravel(), places.ravel()

    def in_block(self, block: Any, own: Any) -> CellData:
        """The coefficients of a run, in its block."""
        other = shallow_copy(self)
        other._of_c = own
        if self.is_own:
            other.array = block.view(self.array)
        return other

    def set_numbers(self, numbers: Mapping[str, np.ndarray]) -> None:
        """Set the values of some fields, by their names."""
        if not self.is_own:
            self._share(numbers)
            return
        for name, (columns, places) in zip(self._fields, self._places, strict=True):
            if (values := numbers.get(name)) is not None:
                self.array[:, columns] = values[places]

    def _share(self, numbers: Mapping[str, np.ndarray]) -> None:
        """Have equal blocks once."""
        blocks = self._blocks(numbers)
        is_new = np.ones(len(blocks), bool)
        is_new[1:] = (blocks[1:] != blocks[:-1]).any(axis=(1, 2))
        data = aligned_zeros(np.count_nonzero(is_new), *blocks.shape[1:])
        data[...] = blocks[is_new]
        self._point_to(data, np.cumsum(is_new, dtype=np.int32) - 1)

    def _blocks(self, numbers: Mapping[str, np.ndarray]) -> np.ndarray:
        parts = [
            numbers.get(name, field.array)[field.space.dofs[self._cells]]
            for name, field in self._fields.items()
        ]
        return in_lanes(np.hstack([np.empty((len(self._cells), 0)), *parts]), self._lanes)

    def _point_to(self, data: np.ndarray, numbers: np.ndarray) -> None:
        """Have C read a block of cells in the row of `data` that `numbers` has for it."""
        self.array, self._numbers = data, numbers
        self._of_c.data = self._ffi.from_buffer("double[]", data)
        self._of_c.data_at = self._ffi.from_buffer("int[]", numbers)


def in_lanes(rows: np.ndarray, lanes: int, first_free: int | None = None) -> np.ndarray:
    """Rows in blocks of `lanes`, column by column (blocks, columns, lanes).

    The last block is padded with copies of the last row, or with indices from `first_free` on,
    which lie apart: the processor waits where what is stored overlaps.
    """
    missing = -len(rows) % lanes
    if missing:
        padding = np.repeat(rows[-1:], missing, axis=0)
        if first_free is not None:
            padding[:] = first_free + 4 * np.arange(missing)[:, None]
        rows = np.concatenate([rows, padding])
    blocks = rows.reshape(len(rows) // lanes, lanes, rows.shape[1]).swapaxes(1, 2)
    kind: type = np.float64 if rows.dtype == np.float64 else np.int32
    placed = aligned_zeros(*blocks.shape, dtype=kind)
    placed[...] = blocks
    return placed


def in_colours(nodes: np.ndarray, size: int) -> dict[str, object]:
    """Pieces of so many cells with `nodes` (cells, n), by colours, and their names in C.

    Pieces of a colour have no node in common.
    """
    piece = np.repeat(np.arange(len(nodes)) // size, nodes.shape[1])
    pieces = int(piece[-1]) + 1
    touched = scipy.sparse.csr_matrix((np.ones(piece.size), (piece, nodes.ravel())))
    links = (touched @ touched.T).tocsr()
    colour = np.full(pieces, -1)
    for k in range(pieces):
        taken = set(colour[links.indices[links.indptr[k] : links.indptr[k + 1]]].tolist())
        colour[k] = next(c for c in range(len(taken) + 1) if c not in taken)
    start = starts_of(np.bincount(colour))
    return {
        "colours": len(start) - 1,
        "colour_start": start,
        "piece": np.argsort(colour, kind="stable"),
    }


@cached_by_content
def rows_of_nodes(stored_at: np.ndarray, first_free: int, lanes: int) -> dict[str, np.ndarray]:
    """Where entries (cells, n * n) of element tangents go in a chain, by their names in C.

    Those of two nodes are in three rows of a group; single ones have their own places.
    """
    cells, n = len(stored_at), math.isqrt(stored_at.shape[1])
    nodes, number = n // 3, np.arange(n)
    dofs = np.column_stack([number[: 2 * nodes].reshape(nodes, 2), number[2 * nodes :]])
    # Those (a, b, 3, 3) of the nodes a and b.
    entries = dofs[:, None, :, None] * n + dofs[None, :, None, :]
    first = stored_at[:, entries[:, :, 0, 0]]
    together = np.ones(first.shape, dtype=bool)
    for i, j in np.ndindex(3, 3):
        together &= stored_at[:, entries[:, :, i, j]] == first + ROW * i + j
    # Rows behind the end lie apart: the processor waits where stored rows overlap.
    lane = np.arange(cells + -cells % lanes) % lanes
    run = np.empty((len(lane), nodes, nodes), dtype=np.int32)
    run[:] = first_free + 3 * ROW * lane[:, None, None]
    run[:cells][together] = first[together]
    cell, a, b = np.nonzero(~together)
    singles = entries[a, b].reshape(-1, 9)
    start = np.searchsorted(cell, np.arange(0, cells + lanes, lanes))
    return {
        "run": run.reshape(len(lane), -1),
        "single_start": 9 * start,
        "single_from": (singles * lanes + lane[cell, None]).ravel(),
        "single_to": stored_at[cell[:, None], singles].ravel(),
    }
