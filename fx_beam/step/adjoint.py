"""The derivatives of a run: the sub-steps of a tape, followed backwards in C (c/adjoint.h)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fx_beam.c_library import Structs, declarations
from fx_beam.errors import SceneError
from fx_beam.scene.joints import joints_by_number

from .element_data import aligned
from .layout import Layout, never_empty
from .model import Model
from .tables import Problem
from .tape import Part, Tape
from .vjp_work import VjpWork

#: Weights by name, the numbers of their rows, and those of sub-steps of forces.
Weights = tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray]


class Adjoint:
    """Derivatives of a function of the states of a run by all numbers of its scene.

    What `Forward` needs as well is in both libraries; `way` is that of the first derivatives.
    """

    def __init__(self, problem: Problem, way: str = "VJP"):
        check(problem.model)
        self.problem, self._model = problem, problem.model
        problem.begin_derivatives(way)  # beside slopes of forms
        self._ffi, self._p = problem.ffi, problem.c
        self._structs = Structs(self._ffi, declarations("problem.h"))
        #: The C struct Adjoint.
        self.c = self._ffi.new("Adjoint *")
        self._works: list[VjpWork] = []
        #: Whether slopes of elements are those by places too; None for no slopes.
        self._has_places: bool | None = None
        self._hand_over_elements()
        self._hand_over_points()
        self._library = problem.derivatives(way)
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
        self.layout = Layout(problem, self._library.fx_layout(self._p, self.c))
        self._x = aligned(np.zeros(self.layout.size))
        followed = self.layout.of["spring internal"].start + self._model.points.followed
        self._structs.set(self.c, x=self._x, followed=followed)
        self._make_room()

    def _make_room(self) -> None:
        room = self._library.fx_linear_scratch(self._p, self.c)
        self._structs.set(self.c, scratch=aligned(np.zeros(room)))

    def _hand_over_elements(self) -> None:
        """How many numbers elements have; their derivatives are compiled when they are needed."""
        beams = self._model.forms.beams
        if beams is None:
            return
        self._works.append(VjpWork("internal_forces", beams.vjp(), beams, self.problem))
        if beams.drag is not None:
            self._works.append(VjpWork("drag", beams.vjp_drag(), beams, self.problem))
        for work in self._works:
            self._structs.set(self.c, **{work.name: work.handed_over()})

    def _hand_over_points(self) -> None:
        addresses, numbers, sizes = zip(*(self._model.points.slopes or [(0, 0, 0)]), strict=True)
        slopes = np.array(addresses, np.uintp)
        self._structs.set(self.c, slopes=slopes, numbers=numbers, found=np.zeros(max(sizes) + 1))

    def constraint_forces(self, tape: Tape) -> np.ndarray:
        """Forces (n, columns) of driven and fixed columns in the n sub-steps on the tape now."""
        first, end = tape.present
        found = np.zeros((end - first, self._p.columns - self._p.free))
        to = self._ffi.from_buffer("double[]", np.append(found, 0.0) if not found.size else found)
        left = self._library.fx_taped_forces(self._p, tape.c, self.c, to)
        check_followed(left, tape, end - left)
        return found

    def vjp_of_equations(
        self, tape: Tape, ends: list[int], of_equations: np.ndarray, of_ends: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of sums of weights times residuals and configurations at ends of load steps.

        Weights (n, free) and (n, size) of all steps; a sum ends with each of `ends`. By the vector
        of `Layout` (sums, size), and of each step by its numbers and by the unknowns at its end.
        """
        self.hand_over_slopes(True)
        count, every = len(tape), np.arange(len(tape) + 1)
        stride = -(-self.layout.size // 8) * 8  # each row is aligned
        x = aligned(np.zeros((len(ends), stride)))[:, : self.layout.size]
        of_steps = np.zeros((count + 1, self.layout.step_size))
        by_unknowns = np.zeros((count, self._p.free))
        self.sizes = np.zeros(count)
        states, equations = self.layout.states, self.layout.equations
        weights = equations.filled({"equations": of_equations}, count)
        structs = Structs(self._ffi, declarations("problem.h"))
        structs.set(
            self.c,
            sizes=self.sizes,
            of_steps=never_empty(of_steps),
            by_unknowns=by_unknowns,
            states=states.members(every[1:], count + 1, states.filled({"q": of_ends}, count)),
            forces=equations.members(every[:-1], count, weights),
        )
        for row, first, end in zip(x, [0, *ends], ends, strict=False):
            tape.show(first, end)
            structs.set(self.c, x=row)
            left = self.problem.derivatives("VJP").fx_vjp(self._p, tape.c, self.c)
            check_followed(left, tape, first + left - 1)
        self._structs.set(self.c, x=self._x, by_unknowns=0)
        return x, of_steps[:-1], by_unknowns

    def vjp(
        self, tape: Tape, weights_of: Callable[[Part], Weights], by_places: bool = True
    ) -> dict[str, Any]:
        """Derivatives by all numbers, or by all but places of nodes, "X".

        `weights_of` gives the weights of each part of the tape, the last one first, whose state is
        then on the tape: derivatives by "q" and "v" (m, size), "slides" (m, joints), "internal" and
        "spring internal" (m, variables) at boundaries between sub-steps with the numbers `rows`
        (m,); and by the forces in some `sub_steps` (k,):
        "constraints" (k, columns) of driven and fixed columns, and "joints" (k, joints, 3).
        """
        self.hand_over_slopes(by_places)
        p, every, states, forces = self._p, len(tape), self.layout.states, self.layout.forces
        self._x[...] = 0.0
        of_steps = np.zeros((every + 1, self.layout.step_size))
        structs = Structs(self._ffi, declarations("problem.h"))
        #: Sizes of the derivatives by the rates at the starts of all sub-steps.
        self.sizes = np.zeros(every)
        structs.set(self.c, sizes=self.sizes, of_steps=never_empty(of_steps))
        left_over: np.ndarray | None = None
        for part in tape.parts(self.problem, backwards=True):
            weights, rows, sub_steps = weights_of(part)
            of_states = states.filled(weights, len(rows))
            if left_over is not None:
                if not len(rows) or rows[-1] != part.end:
                    rows, of_states = (
                        np.append(rows, part.end),
                        np.vstack([of_states, 0 * left_over]),
                    )
                of_states[-1] += left_over
            # What is weighted at the start of this part, the part before it ends with.
            at_start = bool(part.first and len(rows) and rows[0] == part.first)
            left_over = of_states[0] if at_start else None
            # C keeps the addresses of the weights until the next part.
            own = Structs(self._ffi, declarations("problem.h"))
            own.set(
                self.c,
                states=states.members(rows, every + 1, of_states),
                forces=forces.members(sub_steps, every, forces.filled(weights, len(sub_steps))),
            )
            left = self.problem.derivatives("VJP").fx_vjp(p, tape.c, self.c)
            check_followed(left, tape, part.first + left - 1)
        named = self._named(of_steps[:-1])
        if not by_places:
            named.pop("X", None)
        return named

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
        for work in self._works:
            named.pop(work.array)
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

    def hand_over_slopes(self, by_places: bool) -> None:
        """Derivatives of forces of elements, by places of nodes if these are wanted."""
        if self._has_places == by_places:
            return
        self._has_places = by_places
        for work in self._works:
            self._structs.set(self.c, **{work.name: work.members(self.layout, by_places)})
        self._make_room()

    def set_elements(self, changes: Mapping[str, np.ndarray], x: np.ndarray) -> None:
        """Set the changes of the numbers of each element in vectors (count, size)."""
        own = dict(changes)
        if "X" in changes and self._works:
            own["coordinates"] = self._model.mesh.at_points(np.asarray(changes["X"]))
        for work in self._works:
            work.set_changes(self.layout, own, x)

    def _of_elements(self) -> dict[str, np.ndarray]:
        """Derivatives by the positions of nodes, and by the data of beams at their points."""
        named: dict[str, np.ndarray] = {}
        for work in self._works:
            parts = work.of_cells(self.layout, self._x)
            by_places = self._model.mesh.sum_at_points(parts.pop("coordinates"))
            named["X"] = named.get("X", 0.0) + by_places
            named |= parts
        return named


def check_followed(left: int, tape: Tape, sub_step: int) -> None:
    """Refuse a tape of which sub-steps are left, from one whose tangent is singular."""
    if left < 0:
        raise MemoryError("derivatives of a motion")
    if left:
        raise SceneError(
            f"the tangent of the step from t = {tape.starts[sub_step]:.6g} is singular, so that "
            "there is no derivative. Try a smaller dt"
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
