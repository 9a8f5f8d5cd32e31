"""The derivatives of a run: the sub-steps of a tape, followed backwards and forwards in C."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Set

import numpy as np

from fx_beam.c_library import Structs
from fx_beam.content_cache import cached_property
from fx_beam.coupling.graph import joints_with_arms
from fx_beam.dual import nonzero_rows
from fx_beam.errors import SceneError, any_of
from fx_beam.fem.frictions import bristles_of
from fx_beam.fem.scene_data import SceneArrays

from .block import aligned_zeros
from .build import begin_to_build
from .layout import Arrays, Numbers, StepVariables, all_of, never_empty, put_columns
from .model import Model
from .reversals import LEAST_STEPS, all_places, histories_of, reversal_rows
from .tables import ProblemInC
from .tape import Part, Tape
from .vjp_work import Members, VjpWork

#: Weights by name, the numbers of their rows, and those of sub-steps of forces.
Weights = tuple[Arrays, np.ndarray, np.ndarray]
_NONE = np.empty(0, dtype=int)


class TapeDerivatives:
    """Derivatives of the states of a run by all numbers of its scene, in both directions.

    What both need is in the libraries of both; `way` is that of the first derivatives.
    """

    def __init__(self, problem: ProblemInC, way: str = "VJP"):
        _check(problem.model)
        self.problem = problem
        begin_to_build(problem.storage.features, way)  # beside slopes of forms
        self._way = way
        self._structs = Structs(problem.ffi)
        #: The C struct Derivatives.
        self.c = problem.ffi.new("Derivatives *")
        #: Whether slopes of elements are those by places too; None for no slopes.
        self._has_places: bool | None = None
        self._works: list[VjpWork] = []
        if (beams := problem.model.forms.beams) is not None:
            # How many numbers elements have; derivatives are compiled when they are needed.
            for name in beams.forces:
                self._works.append(work := VjpWork(name, beams, problem))
                self._structs.set(self.c, **{work.name: work.first_members()})
        laws = [placed.law for placed in problem.model.points.placed]
        slopes = np.array([law.slopes_address for law in laws] or [0], np.uintp)
        numbers = [law.law.numbers for law in laws] or [0]
        most = max((law.slopes_size for law in laws), default=0)
        self._structs.set(self.c, slopes=slopes, numbers=numbers, point_slopes=np.zeros(most + 1))
        self._structs.set(self.c, point_numbers=sum(numbers))
        members = problem.model.points.members
        if members is not None:
            from fx_beam.fem.point_values import hand_over_slopes

            self._structs.set(self.c, **hand_over_slopes(members, problem.model.points.rule))
        elif not problem.c.work.factors.changing:
            self._structs.set(self.c, transposed_at=problem.storage.transposed(problem))
        #: Slides of moving joints in the reference, and the data of which they are.
        self._slide_at_rest = np.zeros(1 + len(problem.model.couplings.arm_joints))
        self._data: SceneArrays | None = None
        self._structs.set(self.c, slide_at_rest=self._slide_at_rest)

    @cached_property
    def layout(self) -> StepVariables:
        """Where the arrays of the derivatives are in their vector."""
        starts = self.problem.derivatives(self._way).fx_layout(self.problem.c, self.c)
        layout = StepVariables(self.problem, starts)
        followed = layout.at["spring internal"][self.problem.model.points.normal_forces]
        self._structs.set(self.c, followed=followed)
        return layout

    @property
    def places_depend(self) -> bool:
        """Whether motions of nodes for those of the unknowns depend on the state."""
        p = self.problem.c.tables
        return bool(p.map.count > p.map.equal or p.loops.closures or p.sliders.count)

    def constraint_forces(self, tape: Tape) -> np.ndarray:
        """Forces (n, columns) of driven and fixed columns in the n sub-steps on the tape now."""
        (first, end), problem, p = tape.present, self.problem, self.problem.c.tables
        forces = np.zeros((end - first, p.columns - p.free))
        pointer = problem.ffi.from_buffer("double[]", forces if forces.size else np.zeros(1))
        left = problem.derivatives(self._way).fx_taped_forces(problem.c, tape.c, self.c, pointer)
        _check_followed(left, tape, end - left)
        return forces

    def vjp_of_equations(
        self,
        tape: Tape,
        rows: np.ndarray,
        shares: np.ndarray,
        equation_rows: np.ndarray,
        end_rows: np.ndarray,
        state_entries: np.ndarray,
        names: Set[str],
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Derivatives of a sum of weights times residuals and configurations at ends of load steps.

        Each step has a share (k,) of the weights (., free) and (., size) in one of the `rows` (k,).
        By the numbers with some `names`, of the state only by the unknowns `state_entries`; and by
        all unknowns.
        """
        self.set_slopes("X" in names)
        count, boundaries, layout = len(tape), np.arange(len(tape) + 1), self.layout
        x, unknown_values = aligned_zeros(layout.size), np.zeros(self.problem.c.tables.free)
        step_rows, ends = np.zeros((count + 1, layout.step_size)), layout.states.only({"q": ...})
        structs = Structs(self.problem.ffi)
        arrays = {"x": x, "sizes": np.zeros(count), "step_slopes": never_empty(step_rows)}
        structs.set(self.c, **arrays, unknown_slopes=unknown_values, share=shares)
        end_members = ends.members(boundaries[1:], count + 1, end_rows, rows)
        forces = layout.equations.members(boundaries[:-1], count, equation_rows, rows)
        self._follow("VJP", tape, end_members, forces)
        x[layout.at["Y"]] = 0.0
        x[layout.at["Y"][state_entries]] = unknown_values[state_entries]
        step_sums = step_rows.sum(axis=0)
        derivatives = {name: self.numbers[name].sums(x) for name in self.numbers.keys() & names}
        derivatives |= {name: step_sums[layout.steps[name]] for name in layout.steps.keys() & names}
        return derivatives, unknown_values

    def vjp(
        self,
        tape: Tape,
        weights_of: Callable[[Part], Weights],
        names: Set[str],
        entries: Arrays | None = None,
    ) -> dict[str, np.ndarray]:
        """Derivatives by the numbers of the scene that have some `names`.

        `weights_of` gives the weights of each part of the tape, the last one first, whose state is
        then on the tape: derivatives by "q" and "v" (m, size), "slides" (m, joints), "internal" and
        "spring internal" (m, variables) at boundaries between sub-steps with the numbers `rows`
        (m,), or by some `entries` of these alone; and by the forces in some `sub_steps` (k,):
        "constraints" (k, columns) of driven and fixed columns, and "joints" (k, joints, 3).
        """
        self.set_slopes("X" in names)
        count, forces = len(tape), self.layout.forces
        states, x = self.layout.states.only(entries), aligned_zeros(self.layout.size)
        step_rows = np.zeros((count + 1, self.layout.step_size))
        structs = Structs(self.problem.ffi)
        # Sizes of the derivatives by the rates at the starts of all sub-steps.
        sizes = np.zeros(count)
        arrays = {"x": x, "sizes": sizes, "step_slopes": never_empty(step_rows)}
        structs.set(self.c, **arrays, unknown_slopes=0)
        _reversals = self._with_reversals(tape)
        left_over: np.ndarray | None = None
        for part in tape.parts(self.problem, backwards=True):
            weights, rows, sub_steps = weights_of(part)
            state_rows = states.filled(weights, len(rows))
            if left_over is not None:
                if not len(rows) or rows[-1] != part.end:
                    rows = np.append(rows, part.end)
                    state_rows = np.vstack([state_rows, 0 * left_over])
                state_rows[-1] += left_over
            # What is weighted at the start of this part, the part before it ends with.
            at_start = bool(part.first and len(rows) and rows[0] == part.first)
            left_over = state_rows[0] if at_start else None
            force_rows = forces.filled(weights, len(sub_steps))
            row_members = states.members(rows, count + 1, state_rows)
            self._follow("VJP", tape, row_members, forces.members(sub_steps, count, force_rows))
        late = sizes[count // 2 :].max(initial=0.0)
        #: Largest derivative by rates in the first half of the run relative to that in the second:
        #: about 2 where later states depend on earlier ones as in a vibration. In chaotic motions
        #: it has no bound, and the derivatives tell nothing about larger changes.
        self.growth = float(sizes[: count // 2].max(initial=0.0) / late) if late else 0.0
        sums = {name: step_rows[:-1, k] for name, k in self.layout.steps.items() if name in names}
        return sums | {name: self.numbers[name].sums(x) for name in self.numbers.keys() & names}

    @cached_property
    def numbers(self) -> dict[str, Numbers]:
        """The numbers of the scene by name."""
        model, p, rows_of = self.problem.model, self.problem.c.tables, self.layout.at
        skip = {"Y", "member places", *(work.array for work in self._works)}
        numbers = {name: all_of(rows_of[name]) for name in self.layout.numbers if name not in skip}
        columns, dofs, slide_columns, joints = model.couplings.free_columns
        driven, first = rows_of["Y"][p.free : p.free + p.driven], len(model.prescribed)
        q_places = np.append(rows_of["Y"][columns], driven[:first])
        q_dofs = np.append(dofs, model.prescribed)
        X = np.arange(model.mesh.X.size).reshape(model.mesh.X.shape)
        places = [(rows_of["member places"][model.mesh.dofs[:, :2]], X)]
        for work in self._works:
            element_places = work.of_element(self.layout)
            places.append((element_places.pop("coordinates"), X[model.mesh.points]))
            numbers |= {name: all_of(element_rows) for name, element_rows in element_places.items()}
        X_places = np.concatenate([place.ravel() for place, _ in places])
        X_numbers = np.concatenate([number.ravel() for _, number in places])
        return numbers | {
            "q": Numbers(q_places, q_dofs, p.dofs),
            "slides": Numbers(rows_of["Y"][slide_columns], joints, model.scene.joint_count),
            "motors": all_of(driven[first:]),
            "mass": Numbers(
                rows_of["mass"], self.problem.storage.mass_entries.ravel(), model.masses.matrix.nnz
            ),
            "X": Numbers(X_places, X_numbers, X.size),
        }

    def jvp(
        self,
        tape: Tape,
        changes: Arrays,
        rows: np.ndarray,
        sub_steps: np.ndarray = _NONE,
    ) -> dict[str, np.ndarray]:
        """Changes of "q" and "v" (n, m, size) and "slides" (n, m, joints) at some boundaries.

        Also of "internal" and "spring internal" (n, m, variables); and of the forces in some
        `sub_steps` (k,), "constraints" (k, m, columns) and "joints" (k, m, 3 joints). `changes`
        are those of the numbers by `names`, m of each; `rows` (n,) the numbers of sub-steps before
        the boundaries.
        """

        def rows_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
            return rows[part.of_boundaries(rows)], sub_steps[part.of_sub_steps(sub_steps)]

        parts = [*self.jvp_parts(tape, changes, rows_of)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def jvp_parts(
        self,
        tape: Tape,
        changes: Arrays,
        rows_of: Callable[[Part], tuple[np.ndarray, np.ndarray]],
        entries: Arrays | None = None,
    ) -> Iterator[dict[str, np.ndarray]]:
        """Changes of states and forces of each part of the tape, with its rows and sub-steps.

        These are asked for when the part is on the tape. With `entries` of states, of these alone.
        """
        count = len(next(iter(changes.values())))
        x = self.layout.vector(changes, self.numbers, count)
        step_rows = _changes_of_steps(self.layout, changes, count, len(tape))
        _arrays = self._begin_jvp(changes, x, step_rows, directions=count, unknown_slopes=0)
        _reversals = self._with_reversals(tape)
        states, forces = self.layout.states.only(entries), self.layout.forces
        for part in tape.parts(self.problem):
            rows, steps = rows_of(part)
            state_rows, force_rows = states.empty(len(rows), count), forces.empty(len(steps), count)
            end_members = states.members(rows, len(tape) + 1, state_rows)
            self._follow("JVP", tape, end_members, forces.members(steps, len(tape), force_rows))
            yield states.parts(state_rows) | forces.parts(force_rows)
        names = {"motors": "motors", "internal": "internal", "spring_internal": "spring internal"}
        at_end = {name: x[:, self.numbers[number_name].at] for name, number_name in names.items()}
        #: Changes of the rest of the state at the end of the tape.
        self.at_end = {n: np.concatenate(v.swapaxes(1, 2))[:count] for n, v in at_end.items()}

    def closures_at_start(self, tape: Tape, changes: Arrays) -> np.ndarray:
        """Changes (m, closures) of the gaps of loops [m] at the start, where no unknown follows."""
        count, closures = len(changes["X"]), self.layout.closures
        x = self.layout.vector(changes, self.numbers, count)
        step_rows = _changes_of_steps(self.layout, changes, count, len(tape))
        _arrays = self._begin_jvp(changes, x, step_rows, directions=count, unknown_slopes=0)
        _reversals = self._with_reversals(tape)
        gaps, none = closures.empty(1, count), np.empty((0, count, len(self.layout.at["R"])))
        start_members = closures.members(np.zeros(1, int), len(tape) + 1, gaps)
        forces = self.layout.forces.members(_NONE, len(tape), none)
        self._follow("JVP", tape, start_members, forces)
        return gaps[0]

    def jvp_of_equations(
        self,
        tape: Tape,
        changes: Arrays,
        unknown_values: np.ndarray | None,
        rows: np.ndarray,
        shares: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of forces on unknowns (n, m, free) and configurations (n, m, size) at ends.

        Sums of those of load steps, with shares (k,), in n `rows` (k,). Both ends of steps have the
        changes of the unknowns (m, free), if these are given.
        """
        p, count, boundaries = self.problem.c.tables, len(changes["X"]), np.arange(len(tape) + 1)
        x, columns = self.layout.vector(changes, self.numbers, count), self.layout.at["Y"]
        put_columns(x, columns[p.free : p.free + p.driven], changes["driven"].reshape(count, -1).T)
        if unknown_values is not None:
            put_columns(x, columns[: p.free], unknown_values.T)
        step_rows = np.tile(_changes_of_steps(self.layout, changes, count, 1), (1, len(tape), 1))
        force_rows, end_rows = (np.zeros((rows.max() + 1, count, n)) for n in (p.free, p.dofs))
        forces = self.layout.equations.members(boundaries[:-1], len(tape), force_rows, rows)
        row_of = rows if self.places_depend else np.full(len(rows), -1)
        ends = self.layout.ends.members(boundaries[1:], len(tape) + 1, end_rows, row_of)
        arguments = {"directions": count, "unknown_slopes": np.zeros(1), "share": shares}
        _arrays = self._begin_jvp(changes, x, step_rows, **arguments)
        self._follow("JVP", tape, ends, forces)
        return force_rows, end_rows

    def _begin_jvp(
        self, changes: Arrays, x: np.ndarray, steps: np.ndarray, **members: object
    ) -> Structs:
        """Hand over changes of all numbers, in groups; returns the owner of their memory."""
        structs = Structs(self.problem.ffi)
        self.set_slopes("X" in changes and any_of(changes["X"]))
        masses = np.zeros(len(x), int)
        for name in changes.keys() & {"mass", "weight"}:
            masses[nonzero_rows(changes[name]) // x.shape[2]] = 1
        structs.set(self.c, step_slopes=never_empty(steps), x=x, changes_mass=masses, **members)
        return structs

    def _follow(self, way: str, tape: Tape, states: Members, forces: Members) -> None:
        """Follow the sub-steps on the tape, with members for rows of states and of forces."""
        structs = Structs(self.problem.ffi)
        structs.set(self.c, states=states, forces=forces)
        library, (first, end), backwards = self.problem.derivatives(way), tape.present, way == "VJP"
        left = (library.fx_vjp if backwards else library.fx_jvp)(self.problem.c, tape.c, self.c)
        _check_followed(left, tape, first + left - 1 if backwards else end - left)

    def _with_reversals(self, tape: Tape) -> Structs:
        """Hand over where slip reverses in few steps; returns what keeps it."""
        moves = len(tape) >= LEAST_STEPS and not (
            tape.c.apart or self.problem.c.tables.scheme.at_rest
        )
        bristles = bristles_of(self.problem.model.points) if moves else []
        histories = histories_of(tape, self.problem, all_places(bristles)) if bristles else _NONE
        rows = reversal_rows(bristles, histories, tape.times.lengths)
        structs = Structs(self.problem.ffi)
        structs.set(self.c, **rows)
        return structs

    @property
    def names(self) -> set[str]:
        """Names of the numbers of which there are derivatives."""
        return {*self.numbers, *self.layout.steps}

    def set_slopes(self, has_places: bool) -> None:
        """Derivatives of forces of elements, by places of nodes if these are wanted.

        And the slides of joints in the reference of the present scene.
        """
        if self._data is not (model := self.problem.model).data:
            self._data = model.data
            self._slide_at_rest[:-1] = [
                joint.start()[0] for joint in joints_with_arms(model.couplings, model.scene)
            ]
        if self._has_places == has_places:
            return
        self._has_places = has_places
        for work in self._works:
            work.compiled(has_places)  # before the library is waited for
        for work in self._works:
            self._structs.set(self.c, **{work.name: work.members(self.layout, has_places)})
        _, library = self.layout, self.problem.derivatives(self._way)  # which has sizes for C
        room = library.fx_linear_scratch(self.problem.c, self.c)
        self._structs.set(self.c, scratch=aligned_zeros(room))


def _changes_of_steps(layout: StepVariables, changes: Arrays, count: int, rows: int) -> np.ndarray:
    """Changes of the numbers of sub-steps in groups (groups, rows * step_size, group size)."""
    steps = layout.groups(count, rows * layout.step_size)
    for name in changes.keys() & layout.steps.keys():
        places = layout.step_size * np.arange(rows)[:, None] + layout.steps[name]
        put_columns(steps, places.ravel(), changes[name].reshape(count, -1).T)
    return steps


def _check_followed(left: int, tape: Tape, sub_step: int) -> None:
    """Refuse a tape of which sub-steps are left, from one whose tangent is singular."""
    if left < 0:
        raise MemoryError("derivatives of a motion")
    if left:
        raise SceneError(
            f"the tangent of the step from t = {tape.times.starts[sub_step]:.6g} is singular, so "
            "that there is no derivative. Try a smaller dt"
        )


def _check(model: Model) -> None:
    """Refuse a scheme, or a part of the scene, that has no derivatives; the error names it."""
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
