"""A tape of sub-steps: what each was given and found, from which a run is followed backwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.laws.interval import divided
from fx_beam.results.state import State

from .forcing import LoadForcing
from .model import Model
from .tables import Problem

# Numbers of a row before its arrays: start, length, memory, and shares of means (c/tape.h).
TAPED_NUMBERS = 5
#: Largest size of all rows [bytes]; of a longer run parts are repeated.
LIMIT = 1e9


class Steps(NamedTuple):
    """Some whole steps of a run, with all parts and sub-steps."""

    #: Numbers (n,) of the sub-steps with which they begin, and lengths [s]; 0 for the start itself.
    starts: np.ndarray
    lengths: np.ndarray
    #: Numbers (k,) of all their sub-steps, the steps to which they belong, and their shares.
    sub_steps: np.ndarray
    of: np.ndarray
    shares: np.ndarray


class Part(NamedTuple):
    """Sub-steps of a run that are on the tape together: the first one, and that after the last."""

    first: int
    end: int

    def of_boundaries(self, boundaries: np.ndarray) -> np.ndarray:
        """Which boundaries are ends of these sub-steps, or the start of the run."""
        after = self.first if self.first else -1
        return np.flatnonzero((boundaries > after) & (boundaries <= self.end))

    def of_sub_steps(self, sub_steps: np.ndarray) -> np.ndarray:
        """Which sub-steps are among these."""
        return np.flatnonzero((sub_steps >= self.first) & (sub_steps < self.end))


class TakenSteps(NamedTuple):
    """Steps that C takes at once, from which they can be repeated."""

    number: int
    dt: float
    #: Parts of a halved step, and those of the first step that were taken before.
    parts: int
    part: int
    #: The C struct Inputs, and what it points to.
    inputs: Any
    arrays: Any
    #: Starts of the steps or parts, and the end of the last [s], as in their inputs.
    times: np.ndarray


class _Checkpoint(NamedTuple):
    """What C has before some steps."""

    first: int
    steps: TakenSteps
    #: Time at their start [s], the struct Problem, and the memory of the state and its past.
    t: float
    problem: bytes
    memory: np.ndarray
    #: Work space and factors of earlier steps, if these are used.
    work: list[np.ndarray]
    #: Increments (sub-steps, columns) of these steps, if they are kept.
    increments: np.ndarray | None


class Times(NamedTuple):
    """Starts, ends and lengths of sub-steps [s], and whether a whole step begins with each.

    Some sub-steps of schemes of order 4 go back in time.
    """

    starts: np.ndarray
    ends: np.ndarray
    lengths: np.ndarray
    begins: np.ndarray


class Tape:
    """Rows of numbers, one for each sub-step, which the compiled loop writes (c/tape.h).

    If they need more memory than `limit` [bytes], only states at some steps are kept, and the steps
    between are repeated where their rows are needed, to the last digit. As far as half of the
    memory lasts, increments are kept as well, from which steps are repeated without iterations.
    """

    def __init__(self, problem: Problem, limit: float = LIMIT):
        self._ffi, self._limit, self.problem = problem.ffi, limit, problem
        #: The C struct Tape.
        self.c: Any = problem.ffi.new("Tape *")
        self.c.size = problem.library.fx_tape_size(problem.c)
        self._sub_steps = int(problem.c.scheme.sub_steps)
        self._rows = np.empty((0, self.c.size))
        #: The state at the end of the run, from whoever takes its steps.
        self.last: State
        self.clear()

    def _set_rows(self, rows: np.ndarray) -> None:
        self._rows = rows
        self.c.row = self._ffi.cast("double *", rows.ctypes.data)

    def clear(self) -> None:
        """Forget all sub-steps; the memory is kept."""
        self._set_rows(self._rows)
        self._read_increments(None)
        self.c.rows = self.c.first = 0
        self._checkpoints: list[_Checkpoint] = []
        self._count = 0
        # Of the sub-steps, once they are asked for.
        self._times: Times | None = None
        # Memory of their increments [bytes].
        self._kept = 0
        #: In statics, forces (sub-steps, free) that hold the unknowns at their ends, if any do.
        self.hold: np.ndarray | None = None
        #: Whether the rows of all sub-steps are kept.
        self.is_whole = True

    def write(self, rows: np.ndarray) -> None:
        """Take rows that the loop did not write."""
        self._set_rows(rows)
        self.c.rows = self.c.all = self._count = len(rows)
        self._times = Times(rows[:, 0], rows[:, 0] + rows[:, 1], rows[:, 1], rows[:, 4] == 0)

    def repeat(self, moves: np.ndarray, lengths: np.ndarray, factors: np.ndarray) -> None:
        """Take the only row n times, with increments (n, free) added, and other lengths (n,) [s].

        And with load factors (n,) of forces that depend on the motion. The scheme's level remains
        at the same time.
        """
        rows = np.repeat(self._rows, len(moves), axis=0)
        rows[:, 0] += self.problem.c.scheme.level * (rows[:, 1] - lengths)
        rows[:, 1], rows[:, 2] = lengths, factors
        first = self.c.size - self.problem.c.columns
        rows[:, first : first + moves.shape[1]] += moves
        self.write(rows)

    def __len__(self):
        return self._count

    # -- Written in a run -------------------------------------------------------------------------

    @property
    def most_steps(self) -> int:
        """Number of steps between two checkpoints: their rows need half of the memory."""
        return max(1, int(self._limit / (16 * self.c.size * self._sub_steps)))

    def begin(self, steps: TakenSteps) -> Any:
        """Keep the state before some steps; the C struct for their rows, or 0 for none."""
        problem, p = self.problem, self.problem.c
        work = [array.copy() for array in problem.work] if p.system.reused.worth else []
        before = p.state.t, bytes(self._ffi.buffer(p)), problem.state.memory.copy()
        more = steps.number * self._sub_steps
        if self.is_whole and 8 * self.c.size * (self.c.rows + more) > self._limit:
            self.is_whole = False
            self._take_increments()
            self._set_rows(np.empty((0, self.c.size)))
        increments = None if self.is_whole else self._increments(more)
        self._checkpoints.append(_Checkpoint(len(self), steps, *before, work, increments))
        if self.is_whole:
            return self._with_room(more)
        if increments is None:
            return self._ffi.NULL
        self.c.row, self.c.rows = self._ffi.NULL, 0
        self._read_increments(increments)
        return self.c

    def _increments(self, sub_steps: int) -> np.ndarray | None:
        """Room for increments, if there is memory, and if steps follow from these alone."""
        p = self.problem.c
        bytes_now = 8 * sub_steps * p.columns
        touches = self.problem.model.points.members is not None or p.at_points.friction_follows
        if touches or self._kept + bytes_now > self._limit / 2:
            return None
        self._kept += bytes_now
        return np.empty((sub_steps, p.columns))

    def _take_increments(self) -> None:
        """Take increments out of the rows, which end with them, before these are given up."""
        for i, checkpoint in enumerate(self._checkpoints):
            rows = self._rows[checkpoint.first :][: checkpoint.steps.number * self._sub_steps]
            if (increments := self._increments(len(rows))) is None:
                return
            increments[:] = rows[:, self.c.size - self.problem.c.columns :]
            self._checkpoints[i] = checkpoint._replace(increments=increments)

    def _read_increments(self, increments: np.ndarray | None) -> None:
        """Let C write or read increments, or none."""
        address = self._ffi.NULL if increments is None else increments.ctypes.data
        self.c.increments = self._ffi.cast("double *", address)

    def end(self, taken: int) -> None:
        """Keep how many steps were taken."""
        last = self._checkpoints.pop()
        if taken:
            self._checkpoints.append(last._replace(steps=last.steps._replace(number=taken)))
        self._count += taken * self._sub_steps
        self._times = None

    def _with_room(self, more: int) -> Any:
        """The C struct, with room for some more sub-steps."""
        if self.c.rows + more > len(self._rows):
            doubled = min(2 * len(self._rows), int(self._limit / (8 * self.c.size)))
            rows = np.empty((max(self.c.rows + more, doubled), self.c.size))
            rows[: self.c.rows] = self._rows[: self.c.rows]
            self._set_rows(rows)
        return self.c

    # -- Read afterwards --------------------------------------------------------------------------

    def parts(self, problem: Problem, backwards: bool = False) -> Iterator[Part]:
        """The parts of the run, one after the other on the tape; each begins with a whole step."""
        self.c.all = len(self)
        if self.is_whole:
            self.c.first = 0
            yield Part(0, len(self))
            return
        groups: list[list[_Checkpoint]] = []
        for checkpoint in self._checkpoints:
            if checkpoint.steps.part % checkpoint.steps.parts == 0:
                groups.append([])
            groups[-1].append(checkpoint)
        order = range(len(groups))
        for i in reversed(order) if backwards else order:
            self.c.rows, self.c.first = 0, groups[i][0].first
            for checkpoint in groups[i]:
                self._repeat(problem, checkpoint)
            self._after = groups[i + 1][0] if i + 1 in order else None
            yield self.present

    @property
    def present(self) -> Part:
        """The part that is on the tape now."""
        return Part(self.c.first, self.c.first + self.c.rows)

    def _repeat(self, problem: Problem, checkpoint: _Checkpoint) -> None:
        """Write the rows of the steps after a checkpoint."""
        p, steps, ffi = problem.c, checkpoint.steps, self._ffi
        ffi.memmove(p, checkpoint.problem, len(checkpoint.problem))
        problem.state.memory[:] = checkpoint.memory
        for array, values in zip(problem.work, checkpoint.work, strict=False):
            array[:] = values
        if (members := problem.model.points.members) is not None:
            members.forget()
        to = ffi.new("Record *")
        to.every, to.first, to.last, to.parts, to.part = 2**30, 1, -1, steps.parts, steps.part
        to.tape = self._with_room(steps.number * self._sub_steps)
        self._read_increments(checkpoint.increments)
        problem.library.fx_repeat(p, steps.number, steps.dt, steps.inputs, to)

    @property
    def times(self) -> Times:
        """Those of all sub-steps."""
        if self._times is None:
            none = Times(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=bool))
            fractions = self.problem.model.scheme.fractions
            parts = (_times_of(checkpoint, fractions) for checkpoint in self._checkpoints)
            self._times = Times(*map(np.concatenate, zip(none, *parts, strict=True)))
        return self._times

    @property
    def widths(self) -> dict[str, int]:
        """Numbers of the arrays of a state in a row, by the names of the derivatives by them."""
        p = self.problem.c
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
        behind = boundaries - self.c.apart == end
        for name, size in self.widths.items():
            first += size
            if names and name not in names:
                continue
            states[name] = self._rows[rows, first - size : first]
            if size and behind.any():
                states[name][behind] = self._behind(name.replace(" ", "_"))[:size]
        return states

    def _behind(self, name: str) -> np.ndarray:
        """An array of the state behind the present part."""
        if self.present.end == len(self):
            return np.ravel(getattr(self.last, name))
        assert self._after is not None
        return self._after.memory[self.problem.state.places[name]]

    def histories(self, problem: Problem, places: np.ndarray) -> np.ndarray:
        """Internal variables (n + 1, places) of forces at points at all ends of sub-steps.

        If not all rows are kept the run is repeated for them.
        """
        values = np.empty((len(self) + 1, len(places)))
        for part in self.parts(problem):
            boundaries = np.arange(part.first, part.end + 1)
            states = self.states(boundaries, "spring internal")
            values[boundaries] = states["spring internal"][:, places]
        return values

    def steps_to(self, boundaries: np.ndarray) -> Steps:
        """The steps that end before some sub-steps."""
        begins = np.flatnonzero(self.times.begins)
        last = np.searchsorted(begins, np.maximum(boundaries - 1, 0), side="right") - 1
        starts = np.minimum(begins[last], boundaries)
        counts = boundaries - starts
        rows = np.repeat(np.arange(len(boundaries)), counts)
        sub_steps = np.arange(counts.sum()) + np.repeat(boundaries - counts.cumsum(), counts)
        of_parts = self.times.lengths[sub_steps]
        lengths, shares = np.bincount(rows, of_parts, len(boundaries)), np.ones(len(rows))
        np.divide(of_parts, lengths[rows], out=shares, where=counts[rows] > 1)
        return Steps(starts, lengths, sub_steps, rows, shares)

    @property
    def memories(self) -> np.ndarray:
        """`Step.memory` of all sub-steps."""
        return self._rows[: self.c.rows, 2]

    @property
    def first_length(self) -> float:
        """Length of the first step [s]."""
        begins = np.flatnonzero(self.times.begins)
        return float(self.times.lengths[: begins[1] if len(begins) > 1 else None].sum())

    def boundaries(self, times: np.ndarray) -> np.ndarray:
        """Numbers of sub-steps before the ends of steps at times (n,) [s].

        SceneError if the tape has a gap, or if a time is inside a step.
        """
        whole = slice(None, None, self._sub_steps)
        ends = self.times.ends[self._sub_steps - 1 :: self._sub_steps]
        grid = np.concatenate([self.times.starts[:1], ends])
        least = abs(self.times.lengths).min(initial=np.inf)
        if (gaps := abs(self.times.starts[whole] - grid[:-1]) > 1e-3 * least).any():
            raise SceneError(
                f"the step after t = {grid[:-1][gaps][0]:.6g} failed in the compiled loop, so "
                "that there is no derivative. Try a smaller dt"
            )
        rows = np.searchsorted((grid[1:] + grid[:-1]) / 2, times)
        if (inside := abs(grid[rows] - times) > 1e-3 * least).any():
            raise SceneError(
                f"the row at t = {times[inside][0]:.6g} is inside a step, and has no derivative. "
                "Record at ends of steps: with a tolerance, give the times as `breaks` too"
            )
        return self._sub_steps * rows


def _times_of(checkpoint: _Checkpoint, fractions: Sequence[float]) -> Times:
    """Those of the sub-steps that follow a checkpoint."""
    steps, times = checkpoint.steps, checkpoint.steps.times[: checkpoint.steps.number + 1]
    lengths = np.empty((steps.number, len(fractions)))
    lengths[:] = steps.dt * np.array(fractions)
    begins = np.zeros(lengths.shape, dtype=bool)
    begins[-steps.part % steps.parts :: steps.parts, 0] = True
    return Times(*divided(times[:-1], times[1:], fractions), lengths.ravel(), begins.ravel())


# -- Load steps, which are followed as steps in time are -------------------------------------------


def static_tape(
    problem: Problem, start: State, states: Sequence[State], forcing: LoadForcing
) -> Tape:
    """The steps from a state over others, as rows of a tape (c/tape.h).

    Their length is the increment of the load factor, and their `ratio` the factor itself. Without
    internal variables an equilibrium depends on none before, and is a step from itself.
    """
    model, t = problem.model, np.array([forcing.time])
    loads, strains = (floats(model.loads.series(t))[0], floats(forcing.naturals(t))[0])
    values, followers = model.forms.parameters.at(forcing.time), model.points.followers
    follower_force = floats(followers.series(t, t)) if len(followers) else None
    rows, apart, last = [], not model.flows, start.t
    for old, new in zip(states if apart else [start, *states], states, strict=False):
        length, last = new.t - last, new.t
        parts = (
            *([forcing.time - length, length, new.t, 1.0, 0.0], old.q, np.zeros(model.size)),
            *(old.slides, old.internal, _at_start(model, old, new), old.natural),
            *(new.t * loads, new.t * loads, follower_force, new.t * strains),
            *(values, _increments(model, old, new)),
        )
        rows.append(np.concatenate([np.ravel(part) for part in parts if part is not None]))
    tape = Tape(problem)
    tape.c.apart, tape.last = apart, states[-1]
    tape.write(np.array(rows))
    return tape


def _at_start(model: Model, old: State, new: State) -> np.ndarray | None:
    """Internal variables of forces at points at its start, with forces that friction follows."""
    if old.spring_internal is None or new.spring_internal is None:
        return None
    given, followed = old.spring_internal.copy(), model.points.followed
    given[followed] = new.spring_internal[followed]
    return given


def _increments(model: Model, old: State, new: State) -> np.ndarray:
    """Increments (columns,) of the unknowns and of driven motions; zero for those that follow."""
    D = new.q - old.q
    y = model.couplings.unknowns(D, new.slides - old.slides)
    driven = np.append(D[model.prescribed], new.motors - old.motors)
    return model.reduction.in_columns(y, driven)
