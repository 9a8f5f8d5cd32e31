"""The derivatives of a run: the sub-steps of a tape, followed backwards in C (c/adjoint.h)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.c_library import Structs, declarations
from fx_beam.errors import SceneError
from fx_beam.scene.joints import joints_by_number

from .element_data import aligned
from .layout import Layout
from .model import Model
from .tables import Problem
from .tape import Part, Tape
from .vjp_work import VjpWork

_NONE = np.empty(0, dtype=int)

# Weights at boundaries, by name.
_AT_STATES = {"q", "v", "slides", "internal", "spring internal"}
#: Weights by name, the numbers of their rows, and those of sub-steps of forces.
Weights = tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray]


class Adjoint:
    """Derivatives of a function of the states of a run by all numbers of its scene."""

    def __init__(self, problem: Problem):
        check(problem.model)
        self.problem, self._model = problem, problem.model
        self._ffi, self._library, self._p = problem.ffi, problem.derivatives, problem.c
        self._structs = Structs(self._ffi, declarations("problem.h"))
        #: The C struct Adjoint.
        self.c = self._ffi.new("Adjoint *")
        self._works: list[VjpWork] = []
        self._has_forms = False
        self._hand_over_elements()
        self._hand_over_points()
        members = self._model.points.members
        if members is not None:
            counts = {"member_numbers": len(members.numbers), "member_arcs": len(members.arcs)}
            members.follow()
            self._structs.set(self.c, **counts)
        elif not problem.factors.band:
            self._structs.set(self.c, transposed_at=problem.transposed())
        own = joints_by_number(self._model.scene)
        rest = [own[joint.number].start()[0] for joint in self._model.couplings.moving]
        self._structs.set(self.c, slide_at_rest=[*rest, 0.0])
        #: Where the arrays of the derivatives are in this vector.
        self.layout = Layout(problem, self.c)
        self._x = aligned(np.zeros(self.layout.size))
        scratch = aligned(np.zeros(self._library.fx_backward_scratch(self._p, self.c)))
        self._structs.set(self.c, x=self._x, scratch=scratch)

    def _hand_over_elements(self) -> None:
        """The works of elements' forces on weights, and their derivatives."""
        beams = self._model.forms.beams
        if beams is None:
            return
        self._works.append(VjpWork("internal_forces", beams.vjp()))
        if beams.drag is not None:
            self._works.append(VjpWork("drag", beams.vjp_drag()))
        for work in self._works:
            given = work.handed_over(self.problem, beams)
            self._structs.set(self.c, **{work.name: given})

    def _hand_over_points(self) -> None:
        addresses, numbers, sizes = zip(*(self._model.points.slopes or [(0, 0, 0)]), strict=True)
        slopes = np.array(addresses, np.uintp)
        self._structs.set(self.c, slopes=slopes, numbers=numbers, found=np.zeros(max(sizes) + 1))

    def constraint_forces(self, tape: Tape) -> np.ndarray:
        """Forces (n, columns) of driven and fixed columns in the n sub-steps on the tape now."""
        first, end = tape.present
        found = np.zeros((end - first, self._p.columns - self._p.free))
        to = self._ffi.from_buffer("double[]", np.append(found, 0.0) if not found.size else found)
        if left := self._library.fx_taped_forces(self._p, tape.c, self.c, to):
            raise singular(tape, end - left)
        return found

    def vjp(
        self,
        tape: Tape,
        weights: Mapping[str, np.ndarray],
        rows: np.ndarray,
        sub_steps: np.ndarray = _NONE,
    ) -> dict[str, Any]:
        """Derivatives by all numbers.

        `weights` are derivatives by "q" and "v" (m, size), "slides" (m, joints), "internal" and
        "spring internal" (m, variables) at boundaries between sub-steps with the numbers `rows`
        (m,); and by the forces in some `sub_steps` (k,):
        "constraints" (k, columns) of driven and fixed columns, and "joints" (k, joints, 3).
        """

        def of_part(part: Part) -> Weights:
            at, of = part.own(rows), part.of_sub_steps(sub_steps)
            own = {
                name: values[of if name in ("constraints", "joints") else at]
                for name, values in weights.items()
            }
            return own, rows[at], sub_steps[of]

        return self.vjp_parts(tape, of_part)

    def vjp_parts(self, tape: Tape, weights_of: Callable[[Part], Weights]) -> dict[str, Any]:
        """The same with the weights of each part of the tape, the last one first.

        Then the state of the part is on the tape.
        """
        self._hand_over_forms()
        p, every = self._p, len(tape)
        for array in (self._x, *(work.sums for work in self._works)):
            array[...] = 0.0
        of_steps = np.zeros((every + 1, self.layout.step_size))
        structs = Structs(self._ffi, declarations("problem.h"))
        #: Sizes of the derivatives by the rates at the starts of all sub-steps.
        self.sizes = np.zeros(every)
        structs.set(self.c, sizes=self.sizes, of_steps=never_empty(of_steps))
        left_over: dict[str, np.ndarray] = {}
        for part in tape.parts(self.problem, backwards=True):
            weights, rows, sub_steps = weights_of(part)
            weights, rows = _with_last(weights, rows, part.end, left_over)
            # What is weighted at the start of this part, the part before it ends with.
            at_start = bool(part.first and len(rows) and rows[0] == part.first)
            left_over = {name: weights[name][0] for name in _AT_STATES & {*weights} if at_start}
            # C keeps the addresses of the weights until the next part.
            own = Structs(self._ffi, declarations("problem.h"))
            own.set(self.c, **self._given(every, weights, rows, sub_steps))
            left = self._library.fx_vjp(p, tape.c, self.c)
            if left:
                raise singular(tape, part.first + left - 1)
        return self._named(of_steps[:-1])

    def _given(
        self,
        every: int,
        weights: Mapping[str, np.ndarray],
        rows: np.ndarray,
        sub_steps: np.ndarray,
    ) -> dict[str, np.ndarray]:
        """Weights as members of the C struct."""
        p, n, joints = self._p, self._model.size, self._model.scene.joint_count
        of_rows = {
            "q": ("q_weight", len(rows), n),
            "v": ("v_weight", len(rows), n),
            "slides": ("slide_weight", len(rows), joints),
            "internal": ("internal_weight", len(rows), p.cells * p.cell_internal),
            "spring internal": ("spring_weight", len(rows), p.spring_width),
            "constraints": ("constraint_weight", len(sub_steps), p.columns - p.free),
            "joints": ("joint_weight", len(sub_steps), 3 * joints),
        }
        given = {"weight_at": numbered(rows, every + 1), "force_at": numbered(sub_steps, every)}
        for key, (name, *shape) in of_rows.items():
            values = np.reshape(weights[key], shape) if key in weights else np.zeros(shape)
            given[name] = never_empty(values)
        return given

    def _named(self, of_steps: np.ndarray) -> dict[str, Any]:
        model, p = self._model, self._p
        named = self.layout.named(self._x, of_steps)
        by_columns = named.pop("Y")
        columns, dofs, of_slides, joints = model.couplings.free_columns
        q, slides = np.zeros(p.dofs), np.zeros(model.scene.joint_count)
        # Of equal degrees of freedom the last has the column, as in `Couplings.unknowns`.
        last = {column: dof for column, dof in zip(columns.tolist(), dofs.tolist(), strict=True)}
        q[list(last.values())] = by_columns[list(last)]
        slides[joints] = by_columns[of_slides]
        driven = by_columns[p.free : p.free + p.driven]
        first = len(model.prescribed)
        np.add.at(q, model.prescribed, driven[:first])
        mass = np.zeros(model.mass.nnz)
        mass[self.problem.heavy] = named["mass"]
        named |= {"q": q, "slides": slides, "motors": driven[first:], "mass": mass}
        by_places = named.pop("member places")
        named |= self._of_elements()
        if model.points.members is not None:
            named["X"] = named["X"] + by_places[model.mesh.dofs[:, :2]]
        return named

    @property
    def growth(self) -> float:
        """Largest derivative by rates in the first half of the run relative to that in the second.

        About 2 where later states depend on earlier ones as in a vibration; in chaotic motions it
        grows without bound, and the derivatives tell nothing about larger changes.
        """
        half = len(self.sizes) // 2
        late = self.sizes[half:].max(initial=0.0)
        return float(self.sizes[:half].max(initial=0.0) / late) if late else 0.0

    @property
    def of_element_names(self) -> set[str]:
        """Names of the data of beams of which there are derivatives."""
        return {name for work in self._works for name in work.names}

    def _hand_over_forms(self) -> None:
        """What runs backwards need of the works of elements; compiled at the first one."""
        if not self._has_forms:
            for work in self._works:
                self._structs.set(self.c, **{work.name: work.form(self.problem)})
        self._has_forms = True

    def hand_over_slopes(self, by_places: bool) -> None:
        """What runs forwards need: derivatives of forces, by places if these change."""
        for work in self._works:
            given = work.slopes(self.problem, by_places)
            self._structs.set(self.c, **{work.name: given})

    def of_elements(self, changes: Mapping[str, np.ndarray], count: int) -> list[np.ndarray]:
        """Changes of the numbers of each element, as its sums in C, of internal forces and drag."""
        mesh, found = self._model.mesh, [np.zeros((count, 0))] * 2
        for i, work in enumerate(self._works):
            own = dict(changes)
            if "X" in changes:
                own["coordinates"] = mesh.at_points(np.asarray(changes["X"]))
            found[i] = work.in_lanes(own, count, len(mesh.beam_of_cell))
        return found

    def _of_elements(self) -> dict[str, np.ndarray]:
        """Derivatives by the positions of nodes, and by the data of beams at their points."""
        named: dict[str, np.ndarray] = {}
        mesh = self._model.mesh
        for work in self._works:
            parts = work.of_cells(len(mesh.beam_of_cell))
            named["X"] = named.get("X", 0.0) + mesh.sum_at_points(parts.pop("coordinates"))
            parts.pop("parameters of elements", None)  # they are those of steps
            named |= parts
        return named


def numbered(which: np.ndarray, count: int) -> np.ndarray:
    """Places (count,) of some numbers among themselves; -1 of the others."""
    places = np.full(count, -1)
    places[which] = np.arange(len(which))
    return places


def never_empty(array: np.ndarray) -> np.ndarray:
    """An array with an address."""
    return array if array.size else np.zeros(1)


def _with_last(
    weights: Mapping[str, np.ndarray], rows: np.ndarray, end: int, more: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Weights and their rows with more weights at a boundary, which is or follows the last row."""
    found = dict(weights)
    if not more:
        return found, rows
    if not len(rows) or rows[-1] != end:
        rows = np.append(rows, end)
        for name in _AT_STATES & {*found}:
            found[name] = np.concatenate([found[name], np.zeros((1, *found[name].shape[1:]))])
    for name, values in more.items():
        own = found.get(name, np.zeros((len(rows), *values.shape))).copy()
        own[-1] += values
        found[name] = own
    return found, rows


def singular(tape: Tape, sub_step: int) -> SceneError:
    """The error for a sub-step whose tangent is singular."""
    return SceneError(
        f"the tangent of the step from t = {tape.starts[sub_step]:.6g} is singular, so that there "
        "is no derivative. Try a smaller dt"
    )


def check(model: Model) -> None:
    """Refuse what has no derivatives, by its name."""
    scheme = model.scheme
    if not scheme.rates.has_derivatives:
        raise SceneError(
            f"{scheme.name}: motions of this scheme have no derivatives. Use EnergyMomentum, "
            "MidPoint, ModifiedMidPoint or EnergyDecaying"
        )
    if model.points.members is not None and model.couplings.sliding:
        raise SceneError(
            "contact with members has no derivatives in a scene with nodes that slide on beams. "
            "Write the joint as a stiff spring of add_force_between, for example"
        )
