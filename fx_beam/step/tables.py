"""Converts a model for the compiled loop: forms, matrices and couplings as arrays.

FFCx generates the integrals along beams from the UFL, and the laws of forces at points. All else is
in the C files: Newton's method, couplings and nodal rates.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.c_library import Structs, array_at, declared
from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.dual import floats
from fx_beam.fem.mesh import rotation_of
from fx_beam.laws.schemes import MOST_SUB_STEPS
from fx_beam.results.state import MACROS
from fx_beam.scene.beam import gauss_rule

from .block import Block, BlockPlan, aligned_zeros
from .build import begin_to_build, load_library
from .form_tables import FORMS, FormTables
from .model import Model, fact, keeps_previous, led_dofs, massless_dofs, sizes_of
from .newton import ENERGY_FLOOR, LONGEST_TURN, NEGLIGIBLE
from .state_vector import StateVector
from .substeps import LARGE_TURN
from .tangent_storage import ProblemKind, TangentStorage
from .units import little_mass

if TYPE_CHECKING:
    from .turning_frame import TurningFrame

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
            from .parts import part_tables

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
        return load_library(self.storage.features, way)[1]

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
