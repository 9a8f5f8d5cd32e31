"""The derivatives of a run, forwards: changes of its states with the numbers of its scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fx_beam.c_library import declarations
from fx_beam.structs import Structs

from .adjoint import Adjoint, never_empty, numbered, path_numbers, singular
from .element_data import aligned
from .tape import Part, Tape

# Numbers of a scene that steps read as they are, by their names in C.
_PLAIN = {
    "weight": "weight",
    "columns": "load_force",
    "points": "points",
    "offset": "offset",
    "axis": "axis",
    "rest": "rest",
    "places": "places",
    "paths": "paths",
    "internal": "internal",
    "spring internal": "spring_internal",
    "natural": "natural",
    "natural columns": "natural_value",
    "v": "v",
    "before": "before",
    "members": "member_number",
    "arcs": "member_arc",
}
# Numbers of each sub-step.
_OF_STEPS = "loads", "driven", "thrust", "parameters", "naturals"
_NONE = np.empty(0, dtype=int)


class Forward:
    """Changes of the states of a run in several directions, each a change of all numbers."""

    def __init__(self, adjoint: Adjoint):
        self._adjoint, problem = adjoint, adjoint.problem
        self._model, self._heavy = problem.model, problem.heavy
        self._ffi, self._library, self._p = problem.ffi, problem.library, problem.c
        of_start, of_elements = ("q", "slides", "motors", "mass", "X"), adjoint.of_element_names
        #: Names of the numbers whose changes it follows.
        self.names = {*_PLAIN, *_OF_STEPS, *of_start, *of_elements}

    def push(
        self,
        tape: Tape,
        changes: Mapping[str, np.ndarray],
        rows: np.ndarray,
        sub_steps: np.ndarray = _NONE,
    ) -> dict[str, np.ndarray]:
        """Changes of "q" and "v" (n, m, size) and "slides" (n, m, joints) at some boundaries.

        Also of "internal" and "spring internal" (n, m, variables); and of the forces in some
        `sub_steps` (k,), "constraints" (k, m, columns) and "joints" (k, m, joints, 3). `changes`
        are those of the numbers by their names in `Adjoint.pull`, m of
        each; `rows` (n,) the numbers of sub-steps before the boundaries.
        """

        def rows_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
            return rows[part.own(rows)], sub_steps[part.of_sub_steps(sub_steps)]

        parts = [*self.push_parts(tape, changes, rows_of)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def push_parts(
        self,
        tape: Tape,
        changes: Mapping[str, np.ndarray],
        rows_of: Callable[[Part], tuple[np.ndarray, np.ndarray]],
    ) -> Iterator[dict[str, np.ndarray]]:
        """The same of each part of the tape, the first one first, with rows and sub-steps of each.

        These are asked for when the part is on the tape.
        """
        model, p = self._model, self._p
        structs = Structs(self._ffi, declarations("problem.h"))
        count = len(next(iter(changes.values())))
        given = {
            name: array if name == "paths" else _side_by_side(array, self._library.WAYS)
            for name, array in self._given(tape, changes, count).items()
        }
        self._adjoint.hand_over_slopes("X" in changes and bool(np.any(changes["X"])))
        directions = self._ffi.new("Directions *")
        room = self._library.fx_forward_scratch(p, self._adjoint.c)
        structs.set(
            directions,
            count=count,
            changes_mass=[
                given["mass"][k].any() or given["weight"][k].any()
                for k in range(len(given["mass"]))
            ],
            point_numbers=given["points"].shape[1],
            element_numbers=given["of_elements"].shape[1],
            drag_numbers=given["of_drag"].shape[1],
            member_numbers=given["member_number"].shape[1],
            member_arcs=given["member_arc"].shape[1],
            scratch=aligned(np.zeros(room)),
            **{name: never_empty(array) for name, array in given.items()},
        )
        for part in tape.parts(self._adjoint.problem):
            at, of = rows_of(part)
            results = self._results(len(at), len(of), count)
            # C keeps the addresses of the results until the next part.
            own = Structs(self._ffi, declarations("problem.h"))
            own.set(
                directions,
                row_at=numbered(at, len(tape) + 1),
                force_at=numbered(of, len(tape)),
                **{name: never_empty(array) for name, array in results.items()},
            )
            left = self._library.fx_push(p, tape.c, self._adjoint.c, directions)
            if left:
                raise singular(tape, part.end - left)
            names = "q", "v", "slides", "internal", "spring internal", "constraints", "joints"
            yield dict(zip(names, results.values(), strict=True))
        first = p.free + len(model.prescribed)
        #: Changes of the rest of the state at the end of the tape.
        self.at_end = {
            "motors": _one_by_one(given["columns"], count)[:, first : p.free + p.driven],
            "internal": _one_by_one(given["internal"], count),
            "spring_internal": _one_by_one(given["spring_internal"], count),
        }

    def _results(self, rows: int, forces: int, count: int) -> dict[str, np.ndarray]:
        """Arrays of results by their names in C."""
        p, joints = self._p, self._model.scene.joint_count
        return {
            "q_rows": np.zeros((rows, count, p.dofs)),
            "v_rows": np.zeros((rows, count, p.dofs)),
            "slide_rows": np.zeros((rows, count, joints)),
            "internal_rows": np.zeros((rows, count, p.cells * p.cell_internal)),
            "spring_rows": np.zeros((rows, count, p.spring_width)),
            "constraint_rows": np.zeros((forces, count, p.columns - p.free)),
            "joint_rows": np.zeros((forces, count, joints, 3)),
        }

    def _given(
        self, tape: Tape, changes: Mapping[str, np.ndarray], count: int
    ) -> dict[str, np.ndarray]:
        """Arrays of `Directions` in problem.h by name."""
        model, p, rows = self._model, self._p, len(tape)
        internal, members = p.cells * p.cell_internal, model.points.members
        sizes = {
            "weight": p.dofs,
            "load_force": p.load_start[p.loads],
            "points": len(model.points.numbers),
            "offset": 2 * p.joints,
            "axis": 2 * p.joints,
            "rest": p.joints,
            "places": 3 * p.sliders,
            "paths": path_numbers(model),
            "internal": internal,
            "spring_internal": p.spring_width,
            "natural": model.natural.size,
            "natural_value": model.natural.columns.nnz,
            "v": p.dofs,
            "before": p.dofs,
            "member_number": 0 if members is None else len(members.numbers),
            "member_arc": 0 if members is None else len(members.arcs),
        }
        given: dict[str, np.ndarray] = {
            to: _rows(changes.get(name), count, sizes[to]) for name, to in _PLAIN.items()
        }
        widths = 2 * p.loads, p.driven, 2 * p.thrusts, 2 * p.parameter_count, p.naturals
        for name, size in zip(_OF_STEPS, widths, strict=True):
            given[name] = _rows(changes.get(name), count, rows * size)
        mass = _rows(changes.get("mass"), count, model.mass.nnz)
        given["mass"] = np.ascontiguousarray(mass[:, self._heavy])
        given["q"] = np.zeros((count, p.dofs))
        given["columns"] = self._columns(changes, count)
        given["member_place"] = np.zeros((count, p.dofs))
        if "X" in changes:
            given["member_place"][:, model.mesh.dofs[:, :2]] = changes["X"]
        given["of_elements"], given["of_drag"] = self._adjoint.of_elements(changes, count)
        return given

    def _columns(self, changes: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        """Changes of the columns at the start, with those of ties, which follow."""
        model, p = self._model, self._p
        q = _rows(changes.get("q"), count, p.dofs)
        slides = _rows(changes.get("slides"), count, model.scene.joint_count)
        motors = _rows(changes.get("motors"), count, len(model.motors))
        found = np.zeros((count, p.columns + p.ties))
        found[:, : p.free] = model.couplings.unknowns(q, slides)
        found[:, p.free : p.free + p.driven] = np.hstack([q[:, model.prescribed], motors])
        return found


def _rows(changes: Any, count: int, size: int) -> np.ndarray:
    if changes is None:
        return np.zeros((count, size))
    return np.ascontiguousarray(np.array(changes, float).reshape(count, size))


def _side_by_side(rows: np.ndarray, ways: int) -> np.ndarray:
    """Rows (n, size) in groups (groups, size, ways), of which the last one is filled with zeros."""
    count, size = rows.shape
    found = aligned(np.zeros((-(-count // ways), size, ways)))
    for i in range(count):
        found[i // ways, :, i % ways] = rows[i]
    return found


def _one_by_one(groups: np.ndarray, count: int) -> np.ndarray:
    """The rows of which these are groups."""
    return np.concatenate(groups.swapaxes(1, 2))[:count]
