"""The derivatives of a run, forwards: changes of its states with the numbers of its scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fx_beam.c_library import Structs, declarations

from .adjoint import Adjoint, check_followed
from .element_data import aligned
from .layout import never_empty
from .tape import Part, Tape

_NONE = np.empty(0, dtype=int)


class Forward:
    """Changes of the states of a run in several directions, each a change of all numbers."""

    def __init__(self, adjoint: Adjoint):
        self._adjoint, problem, self._layout = adjoint, adjoint.problem, adjoint.layout
        self._model, self._heavy = problem.model, problem.heavy
        self._ffi, self._p = problem.ffi, problem.c
        of_start, of_elements = ("q", "slides", "motors", "mass", "X"), adjoint.of_element_names
        #: Names of the numbers whose changes it follows.
        self.names = {*self._layout.numbers, *self._layout.steps, *of_start, *of_elements}

    def jvp(
        self,
        tape: Tape,
        changes: Mapping[str, np.ndarray],
        rows: np.ndarray,
        sub_steps: np.ndarray = _NONE,
    ) -> dict[str, np.ndarray]:
        """Changes of "q" and "v" (n, m, size) and "slides" (n, m, joints) at some boundaries.

        Also of "internal" and "spring internal" (n, m, variables); and of the forces in some
        `sub_steps` (k,), "constraints" (k, m, columns) and "joints" (k, m, 3 joints). `changes`
        are those of the numbers by their names in `Adjoint.pull`, m of
        each; `rows` (n,) the numbers of sub-steps before the boundaries.
        """

        def rows_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
            return rows[part.own(rows)], sub_steps[part.of_sub_steps(sub_steps)]

        parts = [*self.jvp_parts(tape, changes, rows_of)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def along(
        self, changes: Mapping[str, np.ndarray], by_vector: np.ndarray, of_step: np.ndarray
    ) -> np.ndarray:
        """Sums (n, m) of derivatives times changes (m, ...) of the numbers of a single sub-step.

        Derivatives by the vector of `Layout` (n, size), and by the numbers of the step.
        """
        count = len(changes["X"])
        of_numbers = self._of_steps(changes, count, 1)
        return by_vector @ self._vector(changes, count).T + of_step @ of_numbers.T

    def jvp_parts(
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
        library = self._adjoint.problem.derivatives("JVP")
        group_size = library.GROUP_SIZE
        of_steps = self._of_steps(changes, count, len(tape))
        x = _side_by_side(self._vector(changes, count), group_size)
        masses = x[:, self._layout.of["mass"].start : self._layout.of["weight"].stop]
        self._adjoint.hand_over_slopes("X" in changes and bool(np.any(changes["X"])))
        directions = self._ffi.new("Directions *")
        structs.set(
            directions,
            count=count,
            changes_mass=masses.any(axis=(1, 2)),
            of_steps=never_empty(_side_by_side(of_steps, group_size)),
            x=x,
        )
        for part in tape.parts(self._adjoint.problem):
            at, of = rows_of(part)
            states, forces = self._layout.states, self._layout.forces
            of_states, of_forces = states.empty(len(at), count), forces.empty(len(of), count)
            # C keeps the addresses of the results until the next part.
            own = Structs(self._ffi, declarations("problem.h"))
            own.set(
                directions,
                states=states.members(at, len(tape) + 1, of_states),
                forces=forces.members(of, len(tape), of_forces),
            )
            left = library.fx_jvp(p, tape.c, self._adjoint.c, directions)
            check_followed(left, tape, part.end - left)
            yield states.parts(of_states) | forces.parts(of_forces)
        at_end = _one_by_one(x, count)
        columns = at_end[:, self._layout.of["Y"]]
        #: Changes of the rest of the state at the end of the tape.
        self.at_end = {
            "motors": columns[:, p.free + len(model.prescribed) : p.free + p.driven],
            "internal": at_end[:, self._layout.of["internal"]],
            "spring_internal": at_end[:, self._layout.of["spring internal"]],
        }

    def _vector(self, changes: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        """Changes (count, size) of the numbers of the scene and of its state."""
        model, of = self._model, self._layout.of
        x = np.zeros((count, self._layout.size))
        for name in changes.keys() & {*self._layout.numbers} - {"mass", "q"}:
            x[:, of[name]] = _rows(changes[name], count, -1)
        x[:, of["mass"]] = _rows(changes.get("mass"), count, model.mass.nnz)[:, self._heavy]
        x[:, of["Y"]] = self._columns(changes, count)
        self._adjoint.set_elements(changes, x)
        if "X" in changes:
            places = np.zeros((count, self._p.dofs))
            places[:, model.mesh.dofs[:, :2]] = changes["X"]
            x[:, of["member places"]] = places
        return x

    def _of_steps(self, changes: Mapping[str, np.ndarray], count: int, rows: int) -> np.ndarray:
        """Changes (count, rows * step_size) of the numbers of sub-steps."""
        steps = np.zeros((count, rows, self._layout.step_size))
        for name in changes.keys() & {*self._layout.steps}:
            steps[:, :, self._layout.in_step(name)] = np.reshape(changes[name], (count, rows, -1))
        return steps.reshape(count, -1)

    def _columns(self, changes: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        """Changes of the columns at the start, with those of auxiliary unknowns, which follow."""
        model, p = self._model, self._p
        q = _rows(changes.get("q"), count, p.dofs)
        slides = _rows(changes.get("slides"), count, model.scene.joint_count)
        motors = _rows(changes.get("motors"), count, len(model.motors))
        found = np.zeros((count, p.columns + p.auxiliaries))
        found[:, : p.free] = model.couplings.unknowns(q, slides)
        found[:, p.free : p.free + p.driven] = np.hstack([q[:, model.prescribed], motors])
        return found


def _rows(changes: Any, count: int, size: int) -> np.ndarray:
    if changes is None:
        return np.zeros((count, size))
    return np.ascontiguousarray(np.array(changes, float).reshape(count, size))


def _side_by_side(rows: np.ndarray, group_size: int) -> np.ndarray:
    """Rows (n, size) in groups (groups, size, group_size), the last one filled with zeros."""
    count, size = rows.shape
    groups = aligned(np.zeros((-(-count // group_size), size, group_size)))
    for i in range(count):
        groups[i // group_size, :, i % group_size] = rows[i]
    return groups


def _one_by_one(groups: np.ndarray, count: int) -> np.ndarray:
    """The rows of which these are groups."""
    return np.concatenate(groups.swapaxes(1, 2))[:count]
