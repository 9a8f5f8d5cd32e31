"""A tape of sub-steps, from which a run is followed backwards, and its checkpoints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.laws.interval import divided
from fx_beam.results.state import State

from .forcing import LoadForcing
from .model import Model
from .step_control import Times
from .step_inputs import StepBlock
from .tables import ProblemInC

# -- States before some steps of a run, from which these are repeated to the last digit ---------


class Checkpoint(NamedTuple):
    """Memory of C before some steps."""

    first: int
    steps: StepBlock
    #: The struct Problem, and the memory of the state and its past.
    problem: bytes
    memory: np.ndarray
    #: Work space and factors of earlier steps, if these are used.
    work: list[np.ndarray]
    #: Increments (sub-steps, columns) of these steps, if they are kept.
    increments: np.ndarray | None

    def repeat(self, problem: ProblemInC, rows: Any) -> None:
        """Take the steps again from here, with their `rows` in a C struct Tape."""
        ffi, steps, p = problem.ffi, self.steps, problem.c
        ffi.memmove(p, self.problem, len(self.problem))
        problem.state.memory[:] = self.memory
        for array, values in zip(problem.work, self.work, strict=False):
            array[:] = values
        if (members := problem.model.points.members) is not None:
            members.forget()
        record = ffi.new("Record *")
        record.every, record.first, record.last = 2**30, 1, -1
        record.parts, record.part = steps.parts, steps.part
        record.tape, rows.increments = rows, pointer_to(ffi, self.increments)
        inputs = steps.inputs.in_c(ffi)
        problem.library.fx_repeat(p, steps.number, p.work.state.t, steps.dt, inputs, record)


def pointer_to(ffi: Any, increments: np.ndarray | None) -> Any:
    """Where C writes or reads increments; 0 for none."""
    return ffi.NULL if increments is None else ffi.cast("double *", increments.ctypes.data)


class Checkpoints:
    """The checkpoints of a run, with increments of the steps as far as half of `limit` lasts."""

    def __init__(self, problem: ProblemInC, limit: float):
        #: Memory of all rows [bytes], half of which is for increments.
        self.limit, self._problem = limit, problem
        #: Sub-steps of a step.
        self.parts = int(problem.c.tables.scheme.sub_steps)
        self.clear()

    def clear(self) -> None:
        """Forget all of them."""
        self._every: list[Checkpoint] = []
        # Memory of increments [bytes].
        self._kept = 0

    def keep_state(self, first: int, steps: StepBlock, keeps_increments: bool) -> np.ndarray | None:
        """Keep the state before steps, whose `first` sub-step is this; room for their increments.

        Without these, or without memory for them, None.
        """
        problem, p = self._problem, self._problem.c
        work = [array.copy() for array in problem.work] if p.work.factors.reused.worth else []
        snapshot = bytes(problem.ffi.buffer(p)), problem.state.memory.copy()
        increments = self._increments(steps.number * self.parts) if keeps_increments else None
        self._every.append(Checkpoint(first, steps, *snapshot, work, increments))
        return increments

    def end(self, count: int) -> None:
        """Keep how many steps were taken."""
        last = self._every[-1]
        if not count:
            del self._every[-1:]
        elif count < last.steps.number:
            self._every[-1] = last._replace(steps=last.steps._replace(number=count))

    def _increments(self, sub_steps: int) -> np.ndarray | None:
        """Room for increments, if there is memory, and if steps follow from these alone."""
        p = self._problem.c.tables
        bytes_now = 8 * sub_steps * p.columns
        touches = self._problem.model.points.members is not None or p.at_points.friction_follows
        if touches or self._kept + bytes_now > self.limit / 2:
            return None
        self._kept += bytes_now
        return np.empty((sub_steps, p.columns))

    def take_increments(self, rows: np.ndarray) -> None:
        """Take increments out of the rows, which end with them, before these are given up."""
        for i, checkpoint in enumerate(self._every):
            part_rows = rows[checkpoint.first :][: checkpoint.steps.number * self.parts]
            if (increments := self._increments(len(part_rows))) is None:
                return
            increments[:] = part_rows[:, part_rows.shape[1] - self._problem.c.tables.columns :]
            self._every[i] = checkpoint._replace(increments=increments)

    def groups(self) -> list[list[Checkpoint]]:
        """Checkpoints of parts of a run, each of which begins with a whole step."""
        groups: list[list[Checkpoint]] = []
        for checkpoint in self._every:
            if checkpoint.steps.part % checkpoint.steps.parts == 0:
                groups.append([])
            groups[-1].append(checkpoint)
        return groups

    def times(self) -> Times:
        """Times of all sub-steps."""
        none = np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=bool)
        parts = zip(none, *map(self._times_of, self._every), strict=True)
        starts, ends, lengths, begins = map(np.concatenate, parts)
        return Times(starts, ends, lengths, begins, self.parts)

    def _times_of(self, checkpoint: Checkpoint) -> tuple[np.ndarray, ...]:
        """Times of the sub-steps that follow a checkpoint."""
        fractions = self._problem.model.scheme.fractions
        steps, times = checkpoint.steps, checkpoint.steps.times[: checkpoint.steps.number + 1]
        lengths = np.empty((steps.number, len(fractions)))
        lengths[:] = steps.dt * np.array(fractions)
        begins = np.zeros(lengths.shape, dtype=bool)
        begins[-steps.part % steps.parts :: steps.parts, 0] = True
        starts, ends = divided(times[:-1], times[1:], fractions)
        return starts, ends, lengths.ravel(), begins.ravel()


# -- A tape of sub-steps: what each was given and found, from which a run is followed backwards -


# Numbers of a row before its arrays: start, length, memory, and shares of means (c/tape.h).
TAPED_NUMBERS = 5
#: Largest size of all rows [bytes]; of a longer run parts are repeated.
LIMIT = 1e9


class Part(NamedTuple):
    """Sub-steps of a run that are on the tape together: the first one, and that after the last."""

    first: int
    end: int

    def of_boundaries(self, boundaries: np.ndarray) -> np.ndarray:
        """Indices of the boundaries that are ends of these sub-steps, or the start of the run."""
        bound = self.first if self.first else -1
        return ((boundaries > bound) & (boundaries <= self.end)).nonzero()[0]

    def of_sub_steps(self, sub_steps: np.ndarray) -> np.ndarray:
        """Indices of the sub-steps that are among these."""
        return ((sub_steps >= self.first) & (sub_steps < self.end)).nonzero()[0]


class Tape:
    """Rows of numbers, one for each sub-step, which the compiled loop writes (c/tape.h).

    If they need more memory than `limit` [bytes], only states at some steps are kept, and the steps
    between are repeated where their rows are needed, to the last digit. As far as half of the
    memory lasts, increments are kept as well, from which steps are repeated without iterations.
    """

    def __init__(self, problem: ProblemInC, limit: float = LIMIT):
        self.problem = problem
        #: The C struct Tape.
        self.c = problem.ffi.new("Tape *")
        self.c.size = problem.library.fx_tape_size(problem.c)
        self._checkpoints = Checkpoints(problem, limit)
        #: Number of steps between two checkpoints: their rows need half of the memory.
        self.most_steps = max(1, int(limit / (16 * self.c.size * self._checkpoints.parts)))
        self._rows = np.empty((0, self.c.size))
        #: The state at the end of the run, from whoever takes its steps.
        self.last: State
        self.clear()

    def _set_rows(self, rows: np.ndarray) -> None:
        self._rows = rows
        self.c.row = self.problem.ffi.from_buffer("double[]", rows)

    def clear(self) -> None:
        """Forget all sub-steps; the memory is kept."""
        self._set_rows(self._rows)
        self.c.increments = self.problem.ffi.NULL
        self.c.rows = self.c.first = 0
        self._checkpoints.clear()
        self._count = 0
        # Of the sub-steps, once they are asked for.
        self._times: Times | None = None
        #: In statics, forces (sub-steps, free) that hold the unknowns at their ends, if any do.
        self.hold: np.ndarray | None = None
        #: Whether the rows of all sub-steps are kept.
        self.is_whole = True

    def write(self, rows: np.ndarray) -> None:
        """Take rows that the loop did not write."""
        self._set_rows(rows)
        self.c.rows = self.c.all = self._count = len(rows)
        self._times = Times(rows[:, 0], rows[:, 0] + rows[:, 1], rows[:, 1], rows[:, 4] == 0)

    def __len__(self):
        return self._count

    # -- Written in a run -------------------------------------------------------------------------

    def keep_steps(self, steps: StepBlock):
        """Keep the state before some steps; the C struct for their rows, or 0 for none."""
        sub_steps = steps.number * self._checkpoints.parts
        if self.is_whole and 8 * self.c.size * (self.c.rows + sub_steps) > self._checkpoints.limit:
            self.is_whole = False
            self._checkpoints.take_increments(self._rows)
            self._set_rows(np.empty((0, self.c.size)))
        increments = self._checkpoints.keep_state(len(self), steps, not self.is_whole)
        if self.is_whole:
            return self._with_room(sub_steps)
        if increments is None:
            return self.problem.ffi.NULL
        self.c.row, self.c.rows = self.problem.ffi.NULL, 0
        self.c.increments = pointer_to(self.problem.ffi, increments)
        return self.c

    def end(self, count: int) -> None:
        """Keep how many steps were taken."""
        self._checkpoints.end(count)
        self._count += count * self._checkpoints.parts
        self._times = None

    def _with_room(self, sub_steps: int):
        """The C struct, with room for some more sub-steps."""
        if self.c.rows + sub_steps > len(self._rows):
            doubled = min(2 * len(self._rows), int(self._checkpoints.limit / (8 * self.c.size)))
            rows = np.empty((max(self.c.rows + sub_steps, doubled), self.c.size))
            rows[: self.c.rows] = self._rows[: self.c.rows]
            self._set_rows(rows)
        return self.c

    # -- Read afterwards --------------------------------------------------------------------------

    def parts(self, problem: ProblemInC, backwards: bool = False) -> Iterator[Part]:
        """The parts of the run, one after the other on the tape; each begins with a whole step."""
        self.c.all = len(self)
        if self.is_whole:
            self.c.first = 0
            yield Part(0, len(self))
            return
        groups = self._checkpoints.groups()
        order = range(len(groups))
        for i in reversed(order) if backwards else order:
            self.c.rows, self.c.first = 0, groups[i][0].first
            for checkpoint in groups[i]:
                sub_steps = checkpoint.steps.number * self._checkpoints.parts
                checkpoint.repeat(problem, self._with_room(sub_steps))
            self._next = groups[i + 1][0] if i + 1 in order else None
            yield self.present

    @property
    def present(self) -> Part:
        """The part that is on the tape now."""
        return Part(self.c.first, self.c.first + self.c.rows)

    @property
    def times(self) -> Times:
        """Times of all sub-steps."""
        if self._times is None:
            self._times = self._checkpoints.times()
        return self._times

    @cached_property
    def widths(self) -> dict[str, int]:
        """Numbers of the arrays of a state in a row, by the names of the derivatives by them."""
        p = self.problem.c.tables
        n, back, internal = p.dofs, p.dofs * p.scheme.keeps_previous, p.cells * p.internal.per_cell
        widths = {"q": n, "v": n, "q previous": back, "slides": p.passes.joints}
        widths |= {"internal": internal, "spring internal": p.at_points.spring_width}
        return widths | {"natural": p.cells * p.natural.per_cell}

    def states(self, boundaries: np.ndarray, *names: str) -> dict[str, np.ndarray]:
        """States (n, ...) at some boundaries of the present part, by the names of `widths`.

        Some names alone if these are given.
        """
        states, first, end = {}, TAPED_NUMBERS, self.present.end
        # Rows have the states before their sub-steps; those of equilibria apart the states behind.
        rows = np.clip(boundaries - self.c.apart, self.c.first, end - 1) - self.c.first
        is_end = boundaries - self.c.apart == end
        for name, size in self.widths.items():
            first += size
            if names and name not in names:
                continue
            states[name] = self._rows[rows, first - size : first]
            if not (size and is_end.any()):
                continue
            array = name.replace(" ", "_")
            if end == len(self):
                states[name][is_end] = np.ravel(getattr(self.last, array))[:size]
            else:
                assert self._next is not None
                states[name][is_end] = self._next.memory[self.problem.state.places[array]][:size]
        return states

    @property
    def memories(self) -> np.ndarray:
        """`Step.memory` of all sub-steps."""
        return self._rows[: self.c.rows, 2]


# -- Load steps, which are followed as steps in time are -------------------------------------------


def static_tape(
    problem: ProblemInC, start: State, states: Sequence[State], forcing: LoadForcing
) -> Tape:
    """The steps from a state over others, as rows of a tape (c/tape.h).

    Their length is the increment of the load factor, and their memory the factor itself. Without
    internal variables an equilibrium depends on none before, and is a step from itself.
    """
    model, t = problem.model, np.array([forcing.time])
    loads, strains = (floats(model.data.loads.series(t))[0], floats(forcing.naturals(t))[0])
    values, followers = model.forms.parameters.values_at(forcing.time), model.points.followers
    follower_force = floats(followers.series(t, t)) if len(followers) else None
    rows, apart, last = [], not model.kinks.flows, start.t
    for old, new in zip(states if apart else [start, *states], states, strict=False):
        length, last = new.t - last, new.t
        numbers = np.array([forcing.time - length, length, new.t, 1.0, 0.0])
        parts: list[np.ndarray | None] = [numbers, old.q, np.zeros(model.size)]
        parts += [old.slides, old.internal, _at_start(model, old, new), old.natural]
        parts += [new.t * loads, new.t * loads, follower_force, new.t * strains]
        parts += [values, _increments(model, old, new)]
        rows.append(np.concatenate([np.ravel(part) for part in parts if part is not None]))
    tape = Tape(problem)
    tape.c.apart, tape.last = apart, states[-1]
    tape.write(np.array(rows))
    return tape


def repeated(tape: Tape, moves: np.ndarray, lengths: np.ndarray, factors: np.ndarray) -> Tape:
    """A tape of its only row n times, with increments (n, free) added, and lengths (n,) [s].

    And with load factors (n,) of forces that depend on the motion. The scheme's level remains at
    the same time.
    """
    rows = np.repeat(tape._rows, len(moves), axis=0)
    rows[:, 0] += tape.problem.c.tables.scheme.level * (rows[:, 1] - lengths)
    rows[:, 1], rows[:, 2] = lengths, factors
    first = tape.c.size - tape.problem.c.tables.columns
    rows[:, first : first + moves.shape[1]] += moves
    tape.write(rows)
    return tape


def _at_start(model: Model, old: State, new: State) -> np.ndarray | None:
    """Internal variables of forces at points at its start, with forces that friction follows."""
    if old.spring_internal is None or new.spring_internal is None:
        return None
    variables, followed = old.spring_internal.copy(), model.points.normal_forces
    variables[followed] = new.spring_internal[followed]
    return variables


def _increments(model: Model, old: State, new: State) -> np.ndarray:
    """Increments (columns,) of the unknowns and of driven motions; zero for those that follow."""
    D = new.q - old.q
    y = model.couplings.unknowns(D, new.slides - old.slides)
    driven = np.append(D[model.prescribed], new.motors - old.motors)
    return model.reduction.in_columns(y, driven)
