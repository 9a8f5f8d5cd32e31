"""The derivatives of a run: the sub-steps of a tape, followed backwards and forwards in C."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from typing import NamedTuple

import numpy as np

from fx_beam.c_library import Structs
from fx_beam.content_cache import cached_property
from fx_beam.coupling.graph import joints_with_arms
from fx_beam.dual import nonzero_rows
from fx_beam.errors import SceneError, any_of
from fx_beam.fem.beam_forms import BeamForms, BeamSlopes
from fx_beam.fem.forms import SceneArrays
from fx_beam.fem.point_values import Bristle, bristles_of, hand_over_slopes

from .block import aligned_zeros
from .build import begin_to_build
from .fitted_rates import Arrays, Numbers, StepVariables, all_of, never_empty, put_columns
from .model import Model
from .tables import Kernel, ProblemInC, in_lanes
from .tape import Part, Tape

# -- Forces of elements as their work on weights: the local Jacobians that runs both ways follow


#: Members of a struct in C by name.
Members = dict[str, object]
# Arrays of `StepVariables` and rows of `FormTables` of numbers that elements have in common, by
# the names of derivatives; other numbers are of each element.
_IN_COMMON = {
    "increment": ("q1", "dofs"),
    "start": ("q", "dofs"),
    "q_previous": ("q previous", "dofs"),
    "internal": ("internal", "internal"),
    "natural": ("natural", "natural"),
    "natural_end": ("natural1", "natural"),
    "parameters": ("parameters", ""),
}


class VjpWork:
    """Dense Jacobians of all elements, and where their numbers are in the vector of a sub-step.

    They are by the configurations at the end and at the start, not by increment and start.
    """

    def __init__(self, name: str, beams: BeamForms, problem: ProblemInC):
        assert problem.tables is not None  # as there are beams
        #: The forms, as the array of `StepVariables` with the numbers of one element after the
        #: other.
        self.array, self._beams, self._tables = name, beams, problem.tables
        self._slopes, self._lanes = BeamSlopes(beams), problem.constants.LANES
        #: Its name in C.
        self.name = name.replace(" ", "_")
        nodal = dict.fromkeys(("increment", "start"), problem.c.tables.mesh.cell_dofs)
        self._sizes = nodal | self._slopes.sizes(name)
        self._local = {name: size for name, size in self._sizes.items() if name not in _IN_COMMON}
        self._compiled: dict[bool, tuple[list[tuple[str, int]], Kernel, Members]] = {}

    def first_members(self) -> Members:
        """Members of ``Vjp`` of c/problem.h that the layout of the vector needs."""
        has_previous = int("q_previous" in self._sizes)
        return {"element_numbers": sum(self._local.values()), "q_previous": has_previous}

    def compiled(self, has_places: bool) -> tuple[list[tuple[str, int]], Kernel, Members]:
        """Names of derivatives, each by a weight, and their forms, also as a table for C."""
        if has_places not in self._compiled:
            slopes = self._slopes.jacobians(self.array, has_places)
            kernel = Kernel([*slopes.values()])
            table = self._tables.of("slopes of forces", kernel)
            self._compiled[has_places] = [*slopes][1:], kernel, table  # behind the work
        return self._compiled[has_places]

    def members(self, layout: StepVariables, has_places: bool) -> Members:
        """The other members; without derivatives by places of nodes if they are not wanted."""
        slopes, kernel, table = self.compiled(has_places)
        ends = {weight: i for i, (name, weight) in enumerate(slopes) if name == "increment"}
        pieces = slopes + [key for weight in ends if (key := ("start", weight)) not in slopes]
        numbers, weights, lanes = self._numbers(layout), self._weights(layout), self._lanes
        first, widths = _starts(self._sizes.values()), [rows.shape[1] for rows in weights]
        first_number = dict(zip(self._sizes, first, strict=False))
        size = [self._sizes[name] for name, _ in pieces]
        width = [widths[weight] for _, weight in pieces]
        piece_start = _starts([1, *(m * n for m, n in zip(size, width, strict=True))])
        nowhere, state_names = layout.at["nowhere"][0], _IN_COMMON.keys() - {"parameters"}
        cells = kernel.forms[0].cells
        sources, targets = (
            np.concatenate([in_lanes(np.hstack(rows)[chosen], lanes, nowhere) for chosen in cells])
            for rows in ([*numbers], weights)
        )
        return {
            "slopes": table,
            "blocks": sum(-(-len(chosen) // lanes) for chosen in cells),
            "numbers": first[-1],
            "state_numbers": sum(self._sizes[name] for name in self._sizes.keys() & state_names),
            "weights": sum(widths),
            "slope_numbers": piece_start[-1],
            "pieces": len(pieces),
            "made": len(slopes),
            "piece_start": piece_start[1:-1],
            "number_at": [first_number[name] for name, _ in pieces],
            "piece_numbers": size,
            "weight_at": [_starts(widths)[weight] for _, weight in pieces],
            "piece_weights": width,
            "end_of": [ends.get(weight, -1) if name == "start" else -1 for name, weight in pieces],
            "from": sources,
            "to": targets,
        }

    def of_element(self, layout: StepVariables) -> dict[str, np.ndarray]:
        """Places (cells, n) of the numbers of each element itself, by name."""
        cells = layout.at[self.array].reshape(-1, sum(self._local.values()))
        parts = np.split(cells, _starts(self._local.values())[1:-1], axis=1)
        return dict(zip(self._local, parts, strict=True))

    def _numbers(self, layout: StepVariables) -> Iterator[np.ndarray]:
        """Places (cells, n) of all numbers of the elements, in the order of the sizes."""
        element_rows, rows = iter(self.of_element(layout).values()), self._tables.rows
        for name, size in self._sizes.items():
            if name not in _IN_COMMON:
                yield next(element_rows)
                continue
            array, kind = _IN_COMMON[name]
            columns = self._beams.data.parameters if name == "parameters" else rows[kind]
            places = layout.at[array][np.reshape(columns, (-1, size))]
            yield np.broadcast_to(places, (len(rows["dofs"]), size))

    def _weights(self, layout: StepVariables) -> list[np.ndarray]:
        """Places (cells, n) of forces, and of internal variables at the end."""
        pairs = [("r", "dofs")]
        if "internal" in self._sizes:
            pairs.append(("internal1", "internal"))
        return [layout.at[array][self._tables.rows[kind]] for array, kind in pairs]


def _starts(sizes: Iterable[int]) -> list[int]:
    """Where parts of some sizes begin that stand behind each other, and where the last one ends."""
    return [0, *itertools.accumulate(sizes)]


# -- Reversals of slip in few steps, whose times have derivatives of their own (c/reversals.h) --


#: Sub-steps of a run that may have one.
LEAST_STEPS = 3
# Sub-steps from slip to one side to slip to the other one, above which their derivatives are right.
_FEW = 8
# Slip, relative to the stretch of the spring in the step and to all slip, that is round-off.
_OF_STRETCH, _OF_SLIP = 1e-6, 1e-12
# Of the sides of slip in a sub-step, that of contact which is open.
_OPEN = 2
# Stretch [m or rad] at which friction is at its limit, whatever the increment of the step.
_FAR = 1e20
# In the place of the stretch derivatives carry the time of the reversal, so much smaller that
# outputs do not see it.
_SMALL = 1e-30


class Reversal(NamedTuple):
    """Slip that reverses between two sub-steps, `last` and `next`."""

    bristle: Bristle
    last: int
    next: int
    #: Its sign before, and its rate and acceleration in the last sub-step.
    sign: int
    rate: float
    acceleration: float
    #: Force that limits the friction of a joint, as the mean of both sub-steps.
    force: float

    def rows(self, lengths: np.ndarray) -> Iterator[tuple[int, dict[str, object]]]:
        """Sub-steps with their members of the C struct Reversal.

        The slip rate at the reversal is extrapolated from the last two sub-steps with slip. Its
        change over the acceleration is that of the time, by which in the middle of the next ones
        the friction changes from one side to the other.
        """
        last, place = self.last, self.bristle.place
        previous, length = lengths[last - 1 : last + 1]
        part = min(-self.rate / self.acceleration / length, 1.5)  # of a sub-step, from its middle
        fraction, rate_time = 2 * part * length / (previous + length), -_SMALL / self.acceleration
        yield last - 1, {"place": place, "leads": -fraction * rate_time / previous}
        yield last, {"place": place, "leads": (1 + fraction) * rate_time / length, "keeps": 1.0}
        still = range(last + 1, max(last + 2, self.next))
        middle = still[len(still) // 2]
        for k in still:
            row: dict[str, object] = {
                "place": place,
                "stretch": _FAR * self.sign,
                "force": self.force,
            }
            row["share"] = 2 * part - 2 if len(still) == 1 else 0.0
            if k < middle:
                row["keeps"] = 1.0
            if k == middle:
                row["pushes"] = 2 * self.bristle.mu / lengths[k] / _SMALL
            yield k, row


def all_places(bristles: Sequence[Bristle]) -> np.ndarray:
    """Places (3 n,) of stretch, slip and the force that is followed, or the stretch again."""
    return np.ravel([(b.place, b.place + 1, b.place + 2 * b.follows) for b in bristles])


def histories_of(tape: Tape, problem: ProblemInC, places: np.ndarray) -> np.ndarray:
    """Internal variables (n + 1, places) of forces at points at all ends of sub-steps.

    If not all rows are kept the run is repeated for them.
    """
    values = np.empty((len(tape) + 1, len(places)))
    for part in tape.parts(problem):
        boundaries = np.arange(part.first, part.end + 1)
        states = tape.states(boundaries, "spring internal")
        values[boundaries] = states["spring internal"][:, places]
    return values


def reversal_rows(
    bristles: Sequence[Bristle], histories: np.ndarray, lengths: np.ndarray
) -> dict[str, object]:
    """Members of the C struct Derivatives, from `all_places` (n + 1, ...) over n sub-steps."""
    rows = [
        row
        for i, bristle in enumerate(bristles)
        for reversal in _reversals(bristle, histories[:, 3 * i : 3 * i + 3], lengths)
        for row in reversal.rows(lengths)
    ]
    rows.sort(key=lambda row: row[0])
    starts = np.searchsorted([k for k, _ in rows], np.arange(len(lengths) + 1))
    return {"reversal_start": starts, "reversal": [row for _, row in rows]}


def _reversals(bristle: Bristle, history: np.ndarray, dt: np.ndarray) -> Iterator[Reversal]:
    """The reversals of one spring, from its history (n + 1, 3) at the ends of sub-steps (n,)."""
    stretch, slip, force = history.T
    slips = np.diff(slip)
    least = _OF_STRETCH * abs(np.diff(stretch)) + _OF_SLIP * abs(slip).max()
    signs = np.where(abs(slips) > least, np.sign(slips), 0).astype(int)
    signs[(slip[1:] == 0) & (stretch[1:] == 0)] = _OPEN
    known = np.flatnonzero(signs)
    a, b = known[:-1], known[1:]
    turns = (signs[a] == -signs[b]) & (b - a <= _FEW) & (a > 0) & (signs[a - 1] == signs[a])
    for last, next_slip in zip(a[turns].tolist(), b[turns].tolist(), strict=True):
        previous, rate = slips[last - 1 : last + 1] / dt[last - 1 : last + 1]
        acceleration = 2 * (rate - previous) / (dt[last - 1] + dt[last])
        # At another place of a member slip begins anew, and has not come to rest before.
        if abs(rate) < -signs[last] * acceleration * dt[last] * (next_slip - last + 1):
            mean = (force[last] + force[next_slip]) / 2 if bristle.follows else 0.0
            yield Reversal(bristle, last, next_slip, int(signs[last]), rate, acceleration, mean)


# -- The derivatives of a run: the sub-steps of a tape, followed backwards and forwards in C ----


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
        self, tape: Tape, changes: Arrays, rows: np.ndarray, sub_steps: np.ndarray = _NONE
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
        structs, bristles = Structs(self.problem.ffi), bristles_of(self.problem.model.points)
        if not bristles:
            return structs
        if len(tape) < LEAST_STEPS or tape.c.apart or self.problem.c.tables.scheme.at_rest:
            bristles = []
        histories = histories_of(tape, self.problem, all_places(bristles)) if bristles else _NONE
        rows = reversal_rows(bristles, histories, tape.times.lengths)
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
