"""States before some steps of a run, from which these are repeated to the last digit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.laws.interval import divided

from .step_inputs import StepBlock
from .sub_step_times import Times
from .tables import ProblemInC


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
        record.every, record.first, record.last, record.parts, record.part = (
            2**30,
            1,
            -1,
            steps.parts,
            steps.part,
        )
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
