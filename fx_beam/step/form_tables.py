"""Compiled forms and the elements on which they are integrated, for the compiled loop."""

from __future__ import annotations

import math
from collections.abc import Container
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_by_content
from fx_beam.fem.assembly import Field, Term
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.sparsity import starts_of
from fx_beam.laws.interval import StepBatch

from .build import load_batches

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
    forms: list[Term]

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


# Data of cells that not all scenes have: a tangent in rows or in a chain, and fields of beams.
_NOT_ALWAYS = "stored_at", "run", "single_start", "single_from", "single_to", "internal", "natural"
_OF_THREADS = "colour_start", "piece"
# What is read before any step.
_NO_STEP = StepBatch(np.zeros(1), np.ones(1))


class FormTables:
    """Forms as ``Form`` of c/problem.h.

    Given are the `Problem` of tables.py, the storage indices of the tangent of each cell, and
    whether threads may share cells.
    """

    def __init__(self, problem: Any, stored_at: np.ndarray, shares: bool):
        self._problem, self._lanes = (p := problem.c), problem.constants.LANES
        # Cells that threads take at once.
        self._piece = problem.constants.PIECE * self._lanes if shares else 0
        self._forms: BeamForms = problem.model.forms.beams
        self._stored_at, mesh = stored_at, problem.model.mesh
        #: Degrees of freedom, internal variables and natural strains (cells, n) of each cell.
        self.rows = {"dofs": mesh.unknowns.dofs}
        for name, n in ("internal", p.internal.per_cell), ("natural", p.natural.per_cell):
            if n:
                self.rows[name] = np.arange(p.cells * n).reshape(-1, n)
        self._places = mesh.coordinates
        #: Data of cells by cells, since forms have them in common.
        self._shared: dict[bytes, dict[str, np.ndarray]] = {}
        #: Numbers of the scene, which C reads here: coordinates with their cells; data of beams
        #: with their fields, and where they are in these; and load factors where C sets none.
        self._coordinates: list[tuple[np.ndarray, np.ndarray]] = []
        self._data: list[tuple[np.ndarray, Field, np.ndarray]] = []
        self._factors: list[np.ndarray] = []

    def bind(self, coordinates: np.ndarray | None) -> None:
        """Set the numbers to those that the forms have now, and coordinates of cells if given."""
        if coordinates is not None:
            for cells, blocks in self._coordinates:
                blocks[...] = self._blocks(coordinates[cells])
        for blocks, field, places in self._data:
            blocks[...] = field.array[places]
        for factor in self._factors:
            factor[...] = self._forms.data.named["load_factor"]

    def all(self, names: Container[str]) -> dict[str, dict]:
        """The wanted ones of `FORMS` that the model has, by their names in C."""
        tables, bound = dict[str, dict](), self._forms.bound
        for name, forms in FORMS.items():
            known = [form for form in forms if form in bound]
            if known and name in names:
                tables[name] = self.of(known[-1], Kernel([bound[form] for form in known]))
        return tables

    def of(self, name: str, kernel: Kernel) -> dict[str, Any]:
        """Forms of a kernel; `name` is that of the form that takes longest to compile."""
        p, data, fields = self._problem, self._forms.data, self._forms.data.moving
        form, cells = kernel.forms[0], kernel.forms[0].cells
        width = form.width
        numbers = kernel.size, width, p.mesh.cell_coordinates
        loaded = form.compiled.module.batches  # which stays as long as the form
        batches = load_batches(name, kernel.key, kernel.source, len(cells), numbers, loaded)
        starts = form.field_starts
        moving = [(i, starts[field]) for i, field in enumerate(fields) if field in starts]
        at_rest, known = self._forms.kind.scheme.rates.at_rest, form.constant_starts
        of_step = ("load_increment", "load_factor") if at_rest else ("dt", "memory")
        constants = form.constants_in(_NO_STEP)[0]
        of_scene = {"parameters": len(data.parameters), "parameter": data.parameters}
        *offsets, first = (known.get(name, -1) for name in ("time", *of_step, "parameters"))
        blocks = [self._blocks(form.coefficients(rows, _NO_STEP)[0]) for rows in cells]
        for field in starts.keys() - {*fields}:  # C sets those that move
            columns = slice(starts[field], starts[field] + field.space.width)
            for block, rows in zip(blocks, cells, strict=True):
                self._data.append((block[:, columns], field, self._blocks(field.space.dofs[rows])))
        if "load_factor" in known and not at_rest:
            self._factors.append(constants[known["load_factor"] :][:1])
        return {
            "integrals": len(cells),
            "width": width,
            "of": [
                {"batch": batch, "cells": len(rows), "packed": block} | self._data_of(rows)
                for rows, batch, block in zip(cells, batches, blocks, strict=True)
            ],
            "moving": len(moving),
            "changing": sum(kind == 0 for kind, _ in moving),
            "kind": [kind for kind, _ in moving],
            "offset": [offset for _, offset in moving],
            "constants": constants,
            **dict(zip(("time_at", "dt_at", "memory_at"), offsets, strict=True)),
            "parameters_at": first,
            **(of_scene if first >= 0 else {"parameter": None}),
        }

    def _data_of(self, cells: np.ndarray) -> dict[str, np.ndarray]:
        """Data of some cells, by their names in C."""
        if (key := cells.tobytes()) in self._shared:
            return self._shared[key]
        stored_at, behind = self._stored_at[cells], self._problem.tangent.stored
        data: dict[str, Any] = dict.fromkeys(_NOT_ALWAYS + _OF_THREADS)
        data |= {n: self._blocks(rows[cells]) for n, rows in self.rows.items() if n != "dofs"}
        nodes = self.rows["dofs"][cells, 2 * self.rows["dofs"].shape[1] // 3 :] - 2
        data |= {"dofs": self._blocks(nodes), "to": self._blocks(nodes, self._problem.dofs)}
        if self._piece:
            data |= in_colours(nodes, self._piece)
        data["coordinates"] = self._blocks(self._places[cells])
        self._coordinates.append((cells, data["coordinates"]))
        if self._problem.system.chain:
            rows = rows_of_nodes(stored_at, behind, self._lanes)
            data |= rows | {"run": self._blocks(rows["run"], behind)}
        else:
            data["stored_at"] = self._blocks(stored_at, behind)
        self._shared[key] = data
        return data

    def _blocks(self, rows: np.ndarray, behind: int | None = None) -> np.ndarray:
        return in_lanes(rows, self._lanes, behind)


def aligned_zeros(*shape: int, dtype: type = np.float64) -> np.ndarray:
    """Zeros that begin with a cache line, as vectors of the processor are faster there."""
    line, size = 64, math.prod(shape) * np.dtype(dtype).itemsize
    space = np.zeros(size + line, dtype=np.int8)
    begin = -space.ctypes.data % line
    return space[begin : begin + size].view(dtype).reshape(shape)


def in_lanes(rows: np.ndarray, lanes: int, behind: int | None = None) -> np.ndarray:
    """Rows in blocks of `lanes`, column by column (blocks, columns, lanes).

    The last block is padded with copies of the last row, or with indices from `behind` on, which
    lie apart: the processor waits where what is stored overlaps.
    """
    missing = -len(rows) % lanes
    if missing:
        padding = np.repeat(rows[-1:], missing, axis=0)
        if behind is not None:
            padding[:] = behind + 4 * np.arange(missing)[:, None]
        rows = np.concatenate([rows, padding])
    blocks = rows.reshape(len(rows) // lanes, lanes, rows.shape[1]).swapaxes(1, 2)
    kind: type = np.float64 if rows.dtype == np.float64 else np.int32
    placed = aligned_zeros(*blocks.shape, dtype=kind)
    placed[...] = blocks
    return placed


def in_colours(nodes: np.ndarray, size: int) -> dict[str, Any]:
    """Pieces of so many cells with `nodes` (cells, n), by colours, and their names in C.

    Pieces of a colour have no node in common.
    """
    piece = np.repeat(np.arange(len(nodes)) // size, nodes.shape[1])
    pieces = int(piece[-1]) + 1
    touched = scipy.sparse.csr_matrix((np.ones(piece.size), (piece, nodes.ravel())))
    near = (touched @ touched.T).tocsr()
    colour = np.full(pieces, -1)
    for k in range(pieces):
        taken = set(colour[near.indices[near.indptr[k] : near.indptr[k + 1]]].tolist())
        colour[k] = next(c for c in range(len(taken) + 1) if c not in taken)
    start = starts_of(np.bincount(colour))
    return {
        "colours": len(start) - 1,
        "colour_start": start,
        "piece": np.argsort(colour, kind="stable"),
    }


@cached_by_content
def rows_of_nodes(stored_at: np.ndarray, behind: int, lanes: int) -> dict[str, np.ndarray]:
    """Where entries (cells, n * n) of element tangents go in a chain, by their names in C.

    Those of a node are in a row of three; single ones have their own places.
    """
    cells, n = len(stored_at), math.isqrt(stored_at.shape[1])
    nodes, number = n // 3, np.arange(n)
    columns = np.column_stack([number[: 2 * nodes].reshape(nodes, 2), number[2 * nodes :]])
    targets = stored_at.reshape(cells, n, n)[:, :, columns]  # (cells, n, nodes, 3)
    together = (np.diff(targets, axis=-1) == 1).all(axis=-1)
    # Rows behind the end lie apart: the processor waits where stored rows overlap.
    lane = np.arange(cells + -cells % lanes) % lanes
    run = np.empty((len(lane), n, nodes), dtype=int)
    run[:] = behind + 4 * lane[:, None, None]
    run[:cells][together] = targets[together][:, 0]
    cell, row, node = np.nonzero(~together)
    source = (row[:, None] * n + columns[node]) * lanes + lane[cell, None]
    start = np.searchsorted(cell, np.arange(0, cells + lanes, lanes))
    return {
        "run": run.reshape(len(lane), -1),
        "single_start": 3 * start,
        "single_from": source.ravel(),
        "single_to": targets[cell, row, node].ravel(),
    }
