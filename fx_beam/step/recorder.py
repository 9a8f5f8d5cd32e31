"""The recorded histories of a simulation, also of one that ended early, and starts of sub-steps."""

from __future__ import annotations

import copy
import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError, any_of, check_fields, flag, real_array, require, whole
from fx_beam.results.state import ROWS, State

from .model import Model, fact, need_rates, widths_of

if TYPE_CHECKING:
    from .state_vector import StateCopy
    from .tables import ProblemInC
    from .tape import Tape

# What may be recorded.
_KINDS = "motion", "rates", "forces"
# More steps than a motion has.
_MANY = np.iinfo(np.int32).max


def grown(array: np.ndarray, rows: int, used: int) -> np.ndarray:
    """An array with at least `rows` rows, and the values of the `used` ones."""
    if len(array) >= rows:
        return array
    grown = np.zeros((max(rows, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    grown[:used] = array[:used]
    return grown


def _starts(model: Model, motion: bool, rates: bool) -> dict[str, np.ndarray]:
    """Arrays of starts of sub-steps by name, without rows, and the shares of these in their steps.

    Of forces that are not at mid-step only the last part of a step counts.
    """
    forms, needed = model.forms, {"share": 0}
    if motion:
        needed["start_q"] = model.size
        if rates and fact(model, need_rates):
            needed |= {"start_v": model.size, "start_a": model.size}
        if width := math.prod(forms.internal_shape):
            needed["start_internal"] = width
        if model.data.natural:
            needed["start_natural"] = model.data.natural.size
        if forms.needs_previous:
            needed |= {"start_q_previous": model.size, "memory": 0}
    if model.fits_rates:
        needed |= {"start_q": model.size, "start_v": model.size}
    return {name: np.zeros((0, width) if width else 0) for name, width in needed.items()}


@dataclass(frozen=True)
class Record:
    """Choice of what a simulation records; energies, momenta and slides are always recorded.

    Parameters
    ----------
    every : int
        Steps between two rows; the start and the last step are always recorded. Forces are those of
        the step that ends with the row, not means since the row before.
    motion : bool
        Whether to record displacements and rotations; stress resultants need them as well.
    rates : bool
        Whether to record velocities and accelerations.
    forces : bool
        Whether to record the forces of supports and joints.
    times : sequence of float, optional
        Increasing times of the rows [s], in place of the ends of steps. Displacements and rotations
        are interpolated by polynomials through the nearest ends of steps, cubic for schemes of
        order 2, of degree 5 for order 4, without crossing the start or end of a contact; velocities
        are the derivatives of these polynomials. Energies and momenta are interpolated linearly;
        forces and accelerations are those of the step. The run stores all steps, and `motion` must
        be True. Times outside the run are left out; if `until` ends the run, this time is added.
    file : str or path, optional
        For large scenes: a file for ParaView, such as "run.pvd". Motion, rates, stress resultants
        and internal variables are written to it during the run, and not kept in memory. The
        solution has all other quantities and the last state, from which another motion can start.
        The folder "run" has the grids, and "end.npz" with the solution so far. Only for `simulate`
        without `until`, `changes` and `times`.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> scene.clamp(scene.add_beam([(0, 0), (1, 0)], section).start)
    >>> record = fb.Record(every=4, rates=False)
    >>> fb.simulate(scene, dt=0.1, t_end=1.0, record=record).t.round(3)
    array([0. , 0.4, 0.8, 1. ])

    >>> record = fb.Record(times=[0.0, 0.25, 0.5])
    >>> fb.simulate(scene, tolerance=1e-3, t_end=1.0, record=record).t
    array([0.  , 0.25, 0.5 ])
    """

    every: int = whole(1, default=1)
    motion: bool = flag(default=True)
    rates: bool = flag(default=True)
    forces: bool = flag(default=True)
    times: Sequence[float] | None = None
    file: str | Path | None = None

    def __post_init__(self):
        check_fields(self)
        if self.file is not None:
            from fx_beam.results.export import writable

            writable(self.file, ("pvd",))
            if not self.motion or self.times is not None:
                raise SceneError("Record: a file needs motion=True, and no times")
        if self.times is None:
            return
        times = real_array(self.times)
        rising = times.ndim == 1 and times.size > 0 and bool((np.diff(times) > 0).all())
        ok = rising and bool(np.isfinite(times).all())
        require(ok, "Record: times", self.times, "increasing finite times")
        if not (self.every == 1 and self.motion):
            raise SceneError("Record: times need every=1 and motion=True")
        object.__setattr__(self, "times", tuple(times.tolist()))  # a column of a table has labels


class StepGrid:
    """Times at the ends of steps, and which of them have a row: every so many, and the last one."""

    def __init__(self, every: int, planned: int = 0):
        self.every, self.last = every, -1
        #: Times at the ends of all steps, and numbers of the steps that have a row.
        self.times, self.steps = np.empty(0), np.empty(0, dtype=int)
        #: Number of steps, and the start, that have a plan.
        self.planned = planned

    def plan(self, first: int, ends: np.ndarray, last: bool, rows: int) -> int:
        """Plan steps as `Recorder.plan` behind some rows; number of rows that they add."""
        stop = first + len(ends)
        self.times = grown(self.times, stop, first)
        self.times[first:stop] = ends
        self.last = stop - 1 if last else -1
        steps = np.arange(first, stop)
        steps = steps[(steps % self.every == 0) | (steps == self.last)]
        self.steps = grown(self.steps, rows + len(steps), rows)
        self.steps[rows : rows + len(steps)] = steps
        return len(steps)


class SubStepStarts:
    """Starts of the sub-steps before rows, where these are not the rows before."""

    def __init__(self, arrays: dict[str, np.ndarray], rows: int = 0):
        #: Starts (n, ...) by name, and their number.
        self.arrays, self.count = arrays, 0
        #: Number of starts up to each row.
        self.up_to_row = np.zeros(rows, dtype=np.int32)

    def before_row(self, row: int) -> int:
        """Number of starts up to the row before one; within a step there are more."""
        return int(self.up_to_row[row - 1]) if row > 0 else 0

    def grow(self, room: int) -> None:
        """Make room for a number of starts."""
        for name, array in self.arrays.items():
            self.arrays[name] = grown(array, room, self.count)


class Mark(NamedTuple):
    """The end of a step, to which a run can return; no further step changes it."""

    #: Time [s], and copies of the state in C and of the control of halving.
    t: float
    state: StateCopy
    halving: dict[str, Any]
    #: Number of rows, and full turns (size,) that are missing in the state [rad].
    rows: int
    turns: np.ndarray


class NullRecorder:
    """In place of a `Recorder`, for trial steps."""

    #: The tape of a trial step, if it has one.
    tape: Tape | None = None
    grid = StepGrid(every=_MANY, planned=_MANY)
    rows = plans = 0
    end: Any = None
    #: No arrays.
    arrays: dict[str, np.ndarray] = {}
    starts = SubStepStarts({})

    def stores_starts(self, parts: int) -> bool:
        """Whether starts are stored: never."""
        return False

    def make_room(self, *_: object, **options: object) -> None:
        """Nothing."""

    plan = miss = truncate = make_room


class Recorder:
    """Histories of motion, forces, energies and momenta at the times (n,) of a grid."""

    def __init__(self, model: Model, times: np.ndarray, record: Record):
        self.model = model
        #: The steps.
        self.grid = StepGrid(record.every)
        #: How often the arrays were replaced.
        self.plans = 0
        #: The end of the last steps of a run.
        self.end: Mark
        #: The first state.
        self.first: State
        self.starts = SubStepStarts(_starts(model, record.motion, record.rates))
        self.restart()
        kinds = {"always"} | {kind for kind in _KINDS if getattr(record, kind)}
        names = [name for name, quantity in ROWS.items() if quantity.record in kinds]
        #: Names of the rows that only serve the others.
        self.serving = {"q", "v"} - {*names} if model.fits_rates else set()
        #: Rows (n, ...) by name, vectors in the order of the degrees of freedom.
        self.arrays: dict[str, np.ndarray] = {}
        self.plan(0, times, last=True)
        rows = len(self.grid.steps)
        names += self.serving
        widths = fact(model, widths_of)
        self.arrays = {name: np.zeros((rows, widths[name])) for name in names}

    def restart(self) -> None:
        """Have no rows: those of another run of the same steps overwrite the present ones."""
        self.rows = self.starts.count = 0
        #: Number of rows before the present ones, which were forgotten.
        self.gone = 0
        #: Gives the accelerations of row 0, if they are found when they are read.
        self.late_accelerations: Callable[[], np.ndarray] | None = None
        #: Full turns (size,) [rad] that are missing in the rows from a number on.
        self.turns: dict[int, np.ndarray] = {}

    @property
    def t(self) -> np.ndarray:
        """Times (n,) of the rows so far [s]."""
        return self.grid.times[self.grid.steps[: self.rows]]

    def plan(self, first: int, ends: np.ndarray, last: bool) -> None:
        """Make room for steps from number `first` on that end at times (n,); step 0 is the start.

        With `last` the run ends with them. Steps that are planned again replace those before.
        """
        self.plans += 1  # at first: an interrupt may come after some of the arrays
        added = self.grid.plan(first, ends, last, self.rows)
        rows = self.rows + added
        for name, array in self.arrays.items():
            self.arrays[name] = grown(array, rows, self.rows)
        self.starts.up_to_row = grown(self.starts.up_to_row, rows, self.rows)
        if self.stores_starts(1):
            self.make_room(len(self.model.scheme.fractions) * added)
        self.grid.planned = first + len(ends)

    def make_room(self, starts: int) -> None:
        """Make room for some more starts of sub-steps."""
        room = self.starts.count + starts
        if room > min(map(len, self.starts.arrays.values())):
            self.plans += 1
            self.starts.grow(room)

    def truncate(self, rows: int) -> None:
        """Have some rows, which are written; what was begun after them is forgotten."""
        self.rows = rows
        self.starts.count = self.starts.before_row(rows)

    def steps_to(self, t: float) -> int:
        """Number of steps that end up to a time [s]."""
        return int(np.searchsorted(self.grid.times[: self.grid.planned], t, side="right")) - 1

    def forget(self) -> None:
        """Have the last two rows only, on which the next ones depend."""
        gone = max(self.rows - 2, 0)
        arrays = {name: np.roll(array, -gone, axis=0) for name, array in self.arrays.items()}
        starts = SubStepStarts(self.starts.arrays, len(self.starts.up_to_row))
        late = None if gone else self.late_accelerations
        turns = {max(row - gone, 0): missing for row, missing in self.turns.items()}
        grid = copy.copy(self.grid)
        grid.steps = np.roll(grid.steps, -gone)
        rest = {"arrays": arrays, "grid": grid, "turns": turns}
        rest |= {"rows": self.rows - gone, "starts": starts, "late_accelerations": late}
        rest["end"] = self.end._replace(rows=self.end.rows - gone)
        # At once, as an interrupt may come before or after it.
        vars(self).update(rest, plans=self.plans + 1, gone=self.gone + gone)

    def miss(self, turns: np.ndarray) -> None:
        """Note that full turns (size,) [rad] are missing in the rows from here on."""
        if self.turns or any_of(turns):
            self.turns[self.rows] = turns

    def stores_starts(self, parts: int) -> bool:
        """Whether starts of a step in parts are stored: the last one is not the previous row."""
        parted = len(self.model.scheme.fractions) > 1 or self.model.forms.needs_previous
        return parted or parts > 1 or self.grid.every > 1

    def begin_row(self, state: State) -> None:
        """Have a state of the next row, which is the first one if there is no row yet."""
        if not self.rows:
            self.first = state


#: What takes the rows of steps.
Rows = Recorder | NullRecorder


class RecordInC:
    """The struct ``Record`` of the last recorder, to which C writes rows of its state."""

    def __init__(self, problem: ProblemInC):
        self._ffi, self._state = problem.ffi, problem.c.work.state
        self._sub_steps = problem.c.tables.scheme.sub_steps
        #: The recorder, its plan, the record, and what this points to.
        self._last: tuple[Callable[[], Rows | None], int, Any, Any] = lambda: None, -1, None, None

    def next(self, recorder: Rows, number: int, first: int = 1, parts: int = 1, done: int = 0):
        """Rows of a recorder, from its next one on, for a number of steps or parts.

        From step `first` on, of which some parts are `done`.
        """
        stores = recorder.stores_starts(parts)
        if stores:
            recorder.make_room(number * self._sub_steps)
        last, plan, record, _ = self._last
        if last() is not recorder or plan != recorder.plans:
            record = self._made(recorder)
        record.first, record.last = first, recorder.grid.last
        record.parts, record.part = parts, done
        record.stores_starts, record.tape = stores, self._ffi.NULL
        record.rows, record.starts = recorder.rows, recorder.starts.count
        record.complete = recorder.starts.before_row(recorder.rows)
        return record

    def _made(self, recorder: Rows):
        """The record of a recorder with its present arrays."""
        record = self._ffi.new("Record *")
        rows, starts = recorder.arrays, dict(recorder.starts.arrays)
        record.every, record.forces = recorder.grid.every, "constraint_forces" in rows
        record.up_to_row = self._ffi.from_buffer("int[]", recorder.starts.up_to_row)
        for name in ("share", "memory"):
            if name in starts:
                setattr(record, name, self._ffi.from_buffer("double[]", starts.pop(name)))
        histories, stored = self._rows(rows), self._rows(starts)
        record.histories, record.history = len(histories), histories
        record.stored, record.start = len(stored), stored
        self._last = weakref.ref(recorder), recorder.plans, record, (histories, stored)
        return record

    def _rows(self, arrays: dict[str, np.ndarray]):
        """Rows of arrays, which C writes from those of the same names, also at `start_`."""
        arrays = {name: array for name, array in arrays.items() if array.shape[1]}
        rows = self._ffi.new("Rows[]", len(arrays))
        for row, (name, array) in zip(rows, arrays.items(), strict=True):
            row.source = getattr(self._state, name.removeprefix("start_"))
            row.size = array.shape[1]
            row.target = self._ffi.from_buffer("double[]", array)
        return rows
