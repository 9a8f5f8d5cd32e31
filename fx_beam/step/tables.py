"""Converts a model for the compiled loop: forms, matrices and couplings as arrays."""

from __future__ import annotations

import ctypes
import itertools
import math
from collections.abc import Callable, Container, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.c_library import Structs, array_at, declared
from fx_beam.content_cache import cached_by_content, cached_property, shallow_copy
from fx_beam.dual import floats
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.compiled_forms import Field, MeshTerm
from fx_beam.fem.mesh import rotation_of, starts_of
from fx_beam.laws.interval import StepBatch
from fx_beam.laws.schemes import MOST_SUB_STEPS
from fx_beam.results.state import MACROS
from fx_beam.scene.beam import gauss_rule

from .block import Block, BlockPlan, address_of, aligned_zeros
from .build import begin_to_build, load_batches, load_library
from .model import Model, fact, keeps_previous, led_dofs, little_mass, massless_dofs, sizes_of
from .newton import ENERGY_FLOOR, LONGEST_TURN, NEGLIGIBLE
from .sparse_lu import GROUP, ROW
from .state_vector import StateVector
from .step_control import LARGE_TURN
from .tangent_storage import ProblemKind, TangentStorage

if TYPE_CHECKING:
    from fx_beam.coupling.graph import Couplings
    from fx_beam.fem.mesh import Mesh

    from .forcing import TurningFrame


# -- Parts of a scene with energies of their own, by which Newton's method judges (c/newton.h) --


_Members = frozenset[int]
# An unknown that moves more members is judged by all: else the joints of a chain of n bodies would
# have n^2 members, and as many parts inside each other.
_MOST = 32


def part_tables(model: Model) -> dict[str, Any]:
    """``Parts`` of c/tables.h; none if there is only one.

    Nodes of the same beams are a part, others are one each; unknowns are one if they move nodes of
    the same. Light beams beside heavy ones are judged by themselves, what both share by both.
    """
    parts, node_parts = _parts_of_nodes(model.mesh)
    dof_parts = np.repeat(node_parts, 3)
    column_parts = _parts_of_columns(model.couplings, parts, dof_parts)
    if len(parts) < 2:
        return {}
    inner_parts = _parts_inside(parts)
    starts = np.cumsum([0, *map(len, inner_parts)])
    return {
        "count": len(parts),
        **_runs("dof", dof_parts),
        **_runs("column", column_parts),
        "inside_start": starts,
        "inside": np.concatenate(inner_parts),
    }


def _parts_of_nodes(mesh: Mesh) -> tuple[dict[_Members, int], np.ndarray]:
    """Numbers of parts by their members, and the part (nodes,) of each node.

    Members of a node are its beams; without any it is a member of its own.
    """
    nodes = np.concatenate([*mesh.nodes, np.empty(0, int)])
    beams = np.repeat(np.arange(len(mesh.nodes)), [*map(len, mesh.nodes)])
    shared = (np.bincount(nodes, minlength=len(mesh.X)) > 1)[nodes]
    member = -1 - np.arange(len(mesh.X))
    member[nodes[~shared]] = beams[~shared]
    node_beams: dict[int, list[int]] = {}
    for node, beam in zip(nodes[shared].tolist(), beams[shared].tolist(), strict=True):
        node_beams.setdefault(node, []).append(beam)
    parts, starts = dict[_Members, int](), _starts(member)
    numbers = [
        parts.setdefault(_Members(node_beams.get(node, [only])), len(parts))
        for node, only in zip(starts.tolist(), member[starts].tolist(), strict=True)
    ]
    return parts, np.repeat(np.array(numbers, int), np.diff(starts, append=len(member)))


def _parts_of_columns(
    couplings: Couplings, parts: dict[_Members, int], dof_parts: np.ndarray
) -> np.ndarray:
    """The part (free,) of each unknown, by members whose nodes it moves; new parts are added.

    It has every member where they are many, or not known.
    """
    members, all_members = [*parts], _Members().union(*parts)
    entries, auxiliaries = couplings.all_entries, couplings.auxiliaries
    pairs = np.unique(entries.column.astype(int) * len(parts) + dof_parts[entries.row])
    column, part = np.divmod(pairs, len(parts))
    numbers = np.zeros(couplings.columns + len(auxiliaries), int)
    numbers[column] = part
    # Others than those that move nodes of one part only.
    mixed = np.bincount(column, minlength=len(numbers)) != 1
    mixed[column] |= np.array([len(some) > _MOST for some in members])[part]
    mixed[[entry[0] for auxiliary in auxiliaries for entry in auxiliary.entries]] = True
    mixed[couplings.columns :] = True
    moved = {k: set[int]() for k in np.flatnonzero(mixed).tolist()}
    of_mixed = mixed[column]
    for k, number in zip(column[of_mixed].tolist(), part[of_mixed].tolist(), strict=True):
        moved[k] |= members[number]
    for k, auxiliary in reversed([*enumerate(auxiliaries, couplings.columns)]):
        for entry in auxiliary.entries:
            # Of too many members some are too many as well.
            moved[entry[0]].update(itertools.islice(moved[k], _MOST + 1))
    for k, some in moved.items():
        if k < couplings.free:
            several = _Members(some if 0 < len(some) <= _MOST else all_members)
            numbers[k] = parts.setdefault(several, len(parts))
    return numbers[: couplings.free]


def _parts_inside(parts: dict[_Members, int]) -> list[list[int]]:
    """For each part the parts whose members are all members of it, itself among them."""
    sharing: dict[int, list[_Members]] = {}
    for members in parts:
        for member in members:
            sharing.setdefault(member, []).append(members)
    inner_parts = []
    for members in parts:
        neighbours = dict.fromkeys(other for member in members for other in sharing[member])
        inner_parts.append([parts[other] for other in neighbours if other <= members])
    return inner_parts


def _runs(name: str, part: np.ndarray) -> dict[str, Any]:
    """Runs of the same part: their number, where they begin and the last one ends, their parts."""
    starts = _starts(part)
    return {
        f"{name}_runs": len(starts),
        f"{name}_run_start": np.append(starts, len(part)),
        f"{name}_run_part": part[starts],
    }


def _starts(numbers: np.ndarray) -> np.ndarray:
    """Where runs of equal numbers begin."""
    return np.flatnonzero(np.append(True, numbers[1:] != numbers[:-1])[: len(numbers)])


# -- Compiled forms and the elements on which they are integrated, for the compiled loop --------


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
        if cells and name == "tangent" and p.system.chain and not self._all_forms.nodal_rules:
            self._leave_masses(numbers_of_cells, cells)
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
        nodes = self._first_dofs(cells)
        data |= {"dofs": self._blocks(nodes), "to": self._blocks(nodes, self._tables.dofs)}
        data["in_row"] = first_in_row(nodes, self._lanes)
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

    def _first_dofs(self, cells: np.ndarray) -> np.ndarray:
        """First degree of freedom of each node of cells."""
        dofs = self.rows["dofs"]
        return dofs[cells, 2 * dofs.shape[1] // 3 :] - 2

    def _leave_masses(self, integrals: Any, cells: list[np.ndarray]) -> None:
        """Leave masses to the blocks of integrals that can set their rows of a chain."""
        start, dof = self._storage.mass["start"], self._storage.mass["dof"]
        elements = np.bincount(self._first_dofs(np.concatenate(cells)).ravel() // 3)
        by_elements, lanes = np.zeros(len(dof), np.int32), np.arange(self._lanes + 1)
        for integral, rows in zip(integrals, cells, strict=True):
            tables: dict[str, Any] = self._tables_of(rows)[0]
            first, run = tables["in_row"], tables["run"]
            step = run[:, 3] - run[:, 0]
            in_chain = (step == step[:, :1]) & (run < self._tables.tangent.stored).all(axis=1)
            in_chain &= (abs(step) == GROUP * ROW) & (first[:, None] >= 0)
            blocks = np.flatnonzero(in_chain.all(axis=1) & bool(len(dof)))
            # Only these elements have the second nodes, and the next block the last one.
            node = first[blocks, None] // 3 + lanes
            goes_on = np.append(first[1:], -1)[blocks] == 3 * node[:, -1]
            if self._piece:
                goes_on &= (blocks + 1) * self._lanes % self._piece != 0
            alone = (elements[node[:, 1:-1]] == 2).all(axis=1)
            alone &= elements[node[:, -1]] == 1 + goes_on
            # Pairs of masses follow each other: of the first node, then two of each second one.
            pairs = start[node[:, 1], None] - 1 + np.arange(3 * self._lanes)
            expected = 3 * node[:, lanes[1:, None] - [0, 1, 0]].reshape(pairs.shape)
            alone &= (dof.take(pairs, mode="clip") == expected).all(axis=1)
            alone &= (start[node[:, 1:]] == pairs[:, 1::3]).all(axis=1)
            mass_pair = np.full(len(first), -1, dtype=np.int32)
            mass_pair[blocks[alone]] = pairs[alone, 0]
            by_elements[pairs[alone]] = 1
            self._structs.set(integral.of, mass_pair=mass_pair)
        if by_elements.any():
            self._structs.set(self._tables, mass={"by_elements": by_elements})

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


def first_in_row(nodes: np.ndarray, lanes: int) -> np.ndarray:
    """Blocks' ``in_row``, from the first degrees of freedom of nodes (cells, n)."""
    first, whole = np.full(-(-len(nodes) // lanes), -1, dtype=np.int32), len(nodes) // lanes
    if nodes.shape[1] == 2:
        blocks = nodes[: whole * lanes].reshape(whole, lanes, 2)
        expected = blocks[:, :1, :1] + 3 * (np.arange(lanes)[:, None] + np.arange(2))
        first[:whole] = np.where((blocks == expected).all((1, 2)), blocks[:, 0, 0], -1)
    return first


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


# -- Converts a model for the compiled loop: forms, matrices and couplings as arrays ------------
# FFCx generates the integrals along beams from the UFL, and the laws of forces at points. All
# else is in the C files: Newton's method, couplings and nodal rates.


# Forms of the equations.
_OF_EQUATIONS = "internal_forces", "drag"


def _return_freed_memory() -> None:
    """Return what was freed to the system: C's library, if it is GNU's, keeps it for later."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


class SceneNumbers:
    """Members of the C struct that are numbers of the scene, which C reads here."""

    # The numbers of the program.
    _pattern: SceneNumbers

    def __init__(self, storage: TangentStorage):
        self._storage = storage
        self._model = model = storage.model
        #: The numbers of the model that this has.
        self.data, self._X = model.data, model.mesh.X
        numbers = self._numbers(masses=True) | self._positions()
        #: Arrays by name.
        self.own = {name: np.array(values, float) for name, values in numbers.items()}

    def in_block(self, block: Block, model: Model) -> SceneNumbers:
        """The numbers of a run, in its block, which has those of the program."""
        other = shallow_copy(self)
        other._model, other._pattern = model, self
        other.own = {name: block.view(array) for name, array in self.own.items()}
        return other

    def write(self) -> np.ndarray | None:
        """Write the numbers of the model into a block that has those of the program.

        Gives coordinates of cells if these differ from those of the program.
        """
        model, pattern = self._model, self._pattern
        moved = model.mesh.X is not pattern._X
        numbers = self._numbers(pattern.data.masses is not model.data.masses)
        for name, values in (numbers | (self._positions() if moved else {})).items():
            self.own[name][...] = values
        self.data = model.data
        return model.mesh.coordinates if moved else None

    def _positions(self) -> dict[str, np.ndarray]:
        """The numbers that change where nodes move, by the names in c/numbers.h."""
        return {
            "position": self._model.mesh.X,
            "per_unit": 1 / self._model.units.nodes,
            "per_error": 1 / self._model.units.errors(self._model.scene),
        }

    def _numbers(self, masses: bool) -> dict[str, np.ndarray]:
        """The other numbers of the scene, besides those of forms and points."""
        model, kind = self._model, self._storage.kind
        offset, axis = model.reduction.joints.arms
        numbers = {"offset": offset, "axis": axis}
        numbers["load_force"] = floats(model.data.loads.entries)
        if masses:
            values, turning = 0, 0 if kind.turns else 1  # centrifugal forces have no moments
            if len(self._storage.mass_entries):
                values = model.masses.matrix.data[self._storage.mass_entries] * [1, 1, turning]
            numbers["mass"] = np.append(kind.inertia * values, 0.0)
        if kind.rates:
            matrix, units = model.masses.matrix, model.units.nodes
            little = little_mass(matrix, units, model.scene, model.mesh)
            numbers["viscous_weight"] = little
        if model.masses.weight is not None:
            numbers["weight"] = model.masses.weight
        if model.data.natural:
            numbers["natural"] = floats(model.data.natural.entries)
        return numbers


class ProblemInC:
    """The C struct Problem of a model, and the arrays to which it points."""

    #: The block of a run that a program has given it, and the problem of the program.
    block: Block
    _pattern: ProblemInC

    def __init__(self, model: Model, kind: ProblemKind):
        assert model.program is None, "use problem_of: tables of a run have numbers of its pattern"
        self.model, self.kind = model, kind
        #: The linear system.
        self.storage = storage = TangentStorage(model, kind)
        begin_to_build(storage.features)  # beside what is compiled for the elements
        self.ffi = declared("problem.h", MACROS)
        #: Constants of these headers.
        self.constants = self.ffi.dlopen(None)
        #: Sets members of structs.
        self.structs = Structs(self.ffi)
        self.c = self.ffi.new("Problem *")
        self.structs.set(self.c, tables=[{}])
        storage.hand_over(self)
        # Libraries of derivatives by their way, once they are asked for; all runs share them.
        self._derivatives: dict[str, Any] = {}
        self.tables = None
        self._set_mesh()
        self.set(tables={"has_added": model.forms.has_added, "scheme": _scheme(storage)})
        assert self.constants.SUB_STEPS == MOST_SUB_STEPS
        if kind.rates:
            diagonal_at = storage.stored_at[model.masses.places.diagonal]
            self.set(numbers={"points": [{}]}, work={"statics": {"diagonal_at": diagonal_at}})
        else:
            self.set(**_points(storage))
        sizes = fact(model, sizes_of)  # the scene may have more by now
        self.set(tables={"motors": _motors(model), "at_points": {"lines": sizes["lines"]}})
        if sizes["joints"]:  # also of joints that were removed
            self.set(tables={"passes": _passes(model)})
        newton = {
            **vars(kind.newton),
            "negligible": NEGLIGIBLE * kind.newton.tolerance,
            "energy_floor": ENERGY_FLOOR,
            "longest_turn": LONGEST_TURN,
            "large_turn": LARGE_TURN,
        }
        self.set(tables={"newton": newton})
        beam_nodes = model.mesh.nodes
        if len(beam_nodes) != 1 or len(beam_nodes[0]) < len(model.mesh.X):  # else all is one part
            parts = part_tables(model)
            room = np.zeros(2 * parts.get("count", 0))
            self.set(tables={"parts": parts}, work={"part_energy": room})
        #: Numbers of the scene, but for those of forms and points.
        self.numbers = SceneNumbers(storage)
        self.set(numbers=self.numbers.own)
        #: The state, its past and its local errors.
        self.state = StateVector(model, self.c, self.ffi, self.library)
        self.set(work=self.state.members)
        switches = sum(model.points.switch_counts)
        #: First configuration with inverted sections; switches at both ends of a sub-step.
        self.inverted_q, self.sides = np.zeros(model.size), np.zeros((2, switches))
        control = {"switches": switches, "sides": self.sides}
        self.set(work={"inverted": {"q": self.inverted_q}, "control": control})
        #: Memory of the arrays of C's Work.
        self.scratch = aligned_zeros(self.library.fx_lay_out(self.c, self.ffi.NULL))
        self.library.fx_lay_out(self.c, self.ffi.from_buffer("double[]", self.scratch))
        if storage.is_large:
            _return_freed_memory()

    @property
    def memory(self) -> tuple[list, list[np.ndarray], list[np.ndarray]]:
        """Structs and arrays that change in a run, and arrays that begin as zeros."""
        c, ffi, storage = self.c, self.ffi, self.storage
        structs, arrays = [c], [*self.numbers.own.values(), self.state.memory]
        if self.tables is not None:
            own_structs, own_arrays = self.tables.memory
            structs, arrays = structs + own_structs, arrays + own_arrays
        p, w = c.tables, c.work
        if changing := w.factors.changing:
            structs.append(ffi.cast("ChangingRows(*)[1]", changing)[0])  # with its rows
            sizes = p.system.positions, storage.entries, len(self.model.couplings.sliding)
            places = w.factors.order, w.factors.at, changing.window
            arrays += [array_at(ffi, *x) for x in zip(places, sizes, strict=True)]
        elif w.factors.rows:
            structs.append(ffi.cast("SparseRows *", w.factors.rows))
        if p.sliders.count:
            structs.append(ffi.cast(f"Slider(*)[{p.sliders.count}]", w.slider)[0])
        own = {"part_energy": 2 * p.parts.count, "following": p.loops.closures}
        own["slide_rate"] = self.model.scene.joint_count if w.slide_rate else 0
        arrays += [array_at(ffi, getattr(w, name), n) for name, n in own.items()]
        return structs, arrays, [self.scratch, self.inverted_q, self.sides, storage.sparse_factors]

    def places(self, plan: BlockPlan) -> dict[str, tuple[np.ndarray, np.ndarray]] | None:
        """Places in a block of the data of beams by name, if each has one of its own."""
        tables = self.tables
        return tables.places(plan) if tables is not None and tables.is_placed else None

    def in_block(self, block: Block, model: Model) -> ProblemInC:
        """The problem of a run, with the numbers of its model, by the pattern that this is."""
        other, view = shallow_copy(self), block.view
        other._pattern, other.block, other.model = self, block, model
        other.c = c = block.struct(self.ffi, self.c)
        other.storage = shallow_copy(self.storage)
        other.storage.model = model
        other.storage.sparse_factors = view(self.storage.sparse_factors)
        if c.work.factors.changing:
            other.storage.free_rows_with(other, owner=c)
        other.scratch, other.sides = view(self.scratch), view(self.sides)
        other.inverted_q = view(self.inverted_q)
        other.state = self.state.in_block(model, c, self.ffi, view(self.state.memory))
        other.numbers = self.numbers.in_block(block, model)
        del other.tables  # they are made when something adds forms
        other._write()
        return other

    def restart(self) -> None:
        """Begin anew, with the numbers that the model has now."""
        if changing := self.c.work.factors.changing:
            self.library.fx_free_rows(changing)
        self.block.reset()
        self._write()

    def _write(self) -> None:
        """Write the numbers of the model into the block, which is as that of the program."""
        self.structs, coordinates = Structs(self.ffi), self.numbers.write()
        pattern, block = self._pattern.tables, self.block
        if pattern is None:
            return
        numbers, places = self.model.data.forms.beams, block.plan.places
        if places is None or "tables" in self.__dict__:
            assert self.tables is not None  # as the pattern has some
            self.tables.set_numbers(coordinates, numbers)
            return
        if coordinates is not None:
            pattern.move(coordinates, block.view)
        memory = block.memory[: block.plan.copied].view(np.float64)
        for name, values in numbers.items():
            if (pair := places.get(name)) is not None:
                memory[pair[0]] = floats(values).ravel()[pair[1]]

    @cached_property
    def tables(self) -> FormTables | None:
        """Tables of the forms of beams, None without any."""
        pattern = self._pattern.tables
        return None if pattern is None else pattern.in_block(self.block, self)

    @cached_property
    def library(self) -> Any:
        """The library of steps."""
        return load_library(self.storage.features)[1]

    def derivatives(self, way: str) -> Any:
        """The library of the derivatives of steps, backwards ("VJP") or forwards ("JVP")."""
        libraries = self._derivatives
        if way not in libraries:
            libraries[way] = load_library(self.storage.features, way)[1]
        return libraries[way]

    def set(self, **values: object) -> None:
        """Set `tables`, `numbers` and `work` of the struct by name, as `Structs.set`.

        All runs of a program have the same tables.
        """
        self.structs.set(self.c, **values)

    @property
    def work(self) -> list[np.ndarray]:
        """Arrays on which steps by the factors of earlier ones depend, beside the state."""
        return [self.scratch, self.storage.sparse_factors]

    def _set_mesh(self) -> None:
        model, kind, storage = self.model, self.kind, self.storage
        stored_at = storage.stored_at
        mesh, K = model.mesh, model.forms.stiffness
        cells, cell_dofs = mesh.unknowns.dofs.shape
        at_rest = model.scheme.rates.at_rest
        massless = np.empty(0, int) if at_rest else np.flatnonzero(fact(model, massless_dofs))
        tables: dict[str, object] = {}
        if natural := model.data.natural:
            tables["natural"] = {
                "per_cell": int(np.prod(natural.shape[1:])),
                "count": len(natural.starts) - 1,
                "start": natural.starts,
                "at": natural.rows,
            }
        loads = model.data.loads
        cell_size = 0 if kind.rates else int(np.prod(model.forms.internal_shape[1:]))
        tables |= {
            "cells": cells,
            "mesh": {
                "nodes": len(mesh.X),
                "cell_dofs": cell_dofs,
                "cell_coordinates": 2 * mesh.coordinates.shape[1] // 3,
                "massless_count": len(massless),
                "massless": massless,
                "threads": storage.threads,
            },
            "internal": {"per_cell": cell_size},
            "tangent": {"row_start": K.indptr, "column_of": K.indices, "stored_at": stored_at},
            "loads": {
                "count": len(loads.starts) - 1,
                "start": loads.starts,
                "dof": loads.rows,
                "follower_forces": 0 if kind.rates else len(model.points.followers),
            },
        }
        self.set(tables=tables)
        if (beams := model.forms.beams) is not None and not kind.rates:
            self.tables = FormTables(self)
            forms = self.tables.all(_OF_EQUATIONS if kind.forces_only else FORMS)
            self.set(numbers={"forms": forms})
            if cell_size:
                weights = gauss_rule(beams.kind.degree)[1]
                inverse_weights = np.repeat(1 / weights, beams.internal_shape[-1])
                self.set(tables={"internal": {"per_weight": inverse_weights}})

    def keep_joint_forces(self) -> None:
        """Find forces of joints in each step, whether it is recorded or not."""
        self.c.work.run.keeps_joint_forces = True

    def set_frame(self, frame: TurningFrame | None) -> None:
        """Let C read a frame that turns, or None."""
        if frame is not None:
            arm = frame.arms(np.zeros(self.model.size))
            self.set(numbers={"frame": {"arm": arm, "spin_squared": frame.spin**2}})

    def results(self, **sizes: int) -> Iterator[np.ndarray]:
        """Arrays of C's Work in the last step, by the names in c/work.h, with sizes."""
        return (array_at(self.ffi, getattr(self.c.work, name), n) for name, n in sizes.items())

    def given(self) -> Iterator[np.ndarray]:
        """Inputs of a step set here: dead forces at its level, their mean, strains at the end."""
        n, natural = self.model.size, self.model.data.natural
        return self.results(force=n, dead=n, natural_end=natural.size if natural else 0)


def _points(storage: TangentStorage) -> dict[str, dict[str, object]]:
    """Forces at points, and parameters, by the names in c/tables.h, numbers.h and work.h."""
    model, points, stored_at = storage.model, storage.model.points, storage.stored_at
    point_members: dict[str, object] = {"spring_width": points.width}
    point_members["friction_follows"] = len(points.normal_forces) > 0
    tables: dict[str, object] = {"at_points": point_members}
    tables["newton"] = {"may_overshoot": model.kinks.overshoot}
    numbers: dict[str, object] = {"points": [{}]}
    work: dict[str, object] = {}
    if len(parameters := model.forms.parameters):
        tables["parameters"] = {
            "count": len(parameters),
            "vary": parameters.vary,
            "energies_vary": parameters.energies_vary,
        }
        numbers["parameters"] = parameters.values
    if points.any:
        point_stored_at = np.where(points.value_at >= 0, stored_at[points.value_at], -1)
        # Each force on a slide has one entry, the last ones.
        places, forces = storage.slide_forces
        point_stored_at[len(point_stored_at) - len(points.slides) + forces] = places
        point_members["stored_at"] = point_stored_at
        numbers["points"] = model.forms.compiled_points.address
        if len(points.slides):
            work["slide_rate"] = np.zeros(model.scene.joint_count)
    return {"tables": tables, "numbers": numbers, "work": work}


def _scheme(storage: TangentStorage) -> dict[str, object]:
    """The scheme, by the names in c/tables.h."""
    model, kind = storage.model, storage.kind
    rates, fractions = model.scheme.rates, model.scheme.fractions
    scheme = {
        "level": rates.level,
        "at_rest": rates.at_rest or not kind.inert,
        **rates.constants,
        "keeps_previous": keeps_previous(model),
        "sub_steps": len(fractions),
        "fractions": fractions,
    }
    if rules := model.forms.nodal_rules:
        addresses = np.array([function.address for function in rules], np.uintp)
        scheme |= {"rules": len(rules), "nodal_rule": addresses}
    return scheme


def _motors(model: Model) -> dict[str, object]:
    """Driven motions, by the names in c/tables.h."""
    prescribed, motors = [*model.prescribed], model.data.motors
    return {
        "prescribed": len(prescribed),
        "a": [-1] * len(prescribed) + [rotation_of(joint.a) for joint, _ in motors],
        "b": prescribed + [rotation_of(joint.b) for joint, _ in motors],
        "slides": [0] * len(prescribed) + [name == "slide" for _, name in motors],
        "led": len(led := fact(model, led_dofs)),
        "led_dof": led,
    }


def _passes(model: Model) -> dict[str, object]:
    """How forces on nodes pass through joints of trees, from the leaves to the roots.

    The force of a joint on b is the sum of those on all nodes that follow through it.
    """
    couplings, counts = model.couplings, []
    sums: list[tuple[int, ...]] = []
    for i in range(3):
        counts.append(len(sums))
        for branch in reversed(couplings.forests[i]):
            parent_dof = 3 * branch.parent + i if branch.parent >= 0 else -1
            sums.append(
                (3 * branch.node + i, parent_dof, 3 * branch.joint.number + i, int(branch.sign))
            )
        for joint in couplings.sliding:
            if i < len(couplings.carried[joint.number]):
                sums.append((3 * joint.b.number + i, -1, 3 * joint.number + i, 1))
    columns = np.array(sums, dtype=int).reshape(-1, 4).T
    tables = dict(zip(("dof", "to", "of", "sign"), columns, strict=True))
    joints = fact(model, sizes_of)["joints"]
    return {"joints": joints, "count": len(sums), "force_count": counts[2], **tables}


def problem_of(model: Model, kind: ProblemKind) -> ProblemInC:
    """A problem in C of a model, for one purpose and one user."""
    if model.program is None:
        return ProblemInC(model, kind)
    return model.program.problem_of(model, kind)
