"""The recorded histories of a simulation, also of one that ended early, and starts of sub-steps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, check_fields, flag, real_array, require, whole
from fx_beam.laws.interval import INSTANT, StepBatch
from fx_beam.results.state import ROWS, State

from .model import Model
from .recorded_histories import RecordedHistories, fitted

# What may be recorded.
_KINDS = "motion", "rates", "forces"


def grown(array: np.ndarray, rows: int, used: int) -> np.ndarray:
    """An array with at least some rows, of which those used are kept."""
    if len(array) >= rows:
        return array
    grown = np.zeros((max(rows, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    grown[:used] = array[:used]
    return grown


def _starts(model: Model, motion: bool, rates: bool) -> dict[str, np.ndarray]:
    """Arrays of starts of sub-steps by name, without rows, and the shares of these in their steps.

    Of forces that are not at mid-step only the last part of a step counts.
    """
    forms, beams, needed = model.forms, model.forms.beams, {"share": 0}
    if motion:
        needed["start_q"] = model.size
        if rates and beams is not None and beams.facts.resultants_need_rates:
            needed |= {"start_v": model.size, "start_a": model.size}
        if width := math.prod(forms.internal_shape):
            needed["start_internal"] = width
        if model.natural:
            needed["start_natural"] = model.natural.size
        if forms.needs_previous:
            needed |= {"start_q_previous": model.size, "memory": 0}
    if model.fits_rates:
        needed |= {"start_q": model.size, "start_v": model.size}
    return {name: np.zeros((0, width) if width else 0) for name, width in needed.items()}


@dataclass(frozen=True)
class Record:
    """What a simulation records; energies, momenta and slides are always recorded.

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
        are those of polynomials through the nearest ends of steps, cubic for schemes of order 2, of
        degree 5 for order 4, on the smooth side of a contact; velocities are their derivatives.
        Energies and momenta are linear; forces and accelerations are those of the step. All steps
        are stored to the end; the motion must be recorded. Other times than the run's are left out;
        where `until` ends it, this time is added.
    file : str or path, optional
        For large scenes: a file for ParaView, such as "run.pvd", to which motion and rates go as
        they come, with stress resultants and internal variables, in place of memory. On several
        processes each writes its members. The solution has all else, and its end, from which
        another motion starts. The folder "run" has the grids, and "end.npz", the solution so far.
        Only for `simulate` without `until`, `changes` and `times`.

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
            from fx_beam.results.files import writable

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


class NullRecorder:
    """In place of a `Recorder`, for trial steps."""

    #: The tape of a trial step, if it has one.
    tape: Any = None
    every = planned = np.iinfo(np.int32).max
    last, rows, starts, complete = -1, 0, 0, 0
    plans, end = 0, None
    #: No arrays.
    arrays: dict[str, np.ndarray] = {}
    arrays_of_starts: dict[str, np.ndarray] = {}

    def stores_starts(self, parts: int) -> bool:
        """Whether starts are stored: never."""
        return False

    def make_room(self, *_: Any, **options: Any) -> None:
        """Nothing."""

    count = plan = miss = truncate = make_room


class Recorder:
    """Histories of motion, forces, energies and momenta at the times (n,) of a grid."""

    def __init__(self, model: Model, times: np.ndarray, record: Record):
        self.model, self.every, self.last = model, record.every, -1
        #: Times at the ends of all steps, and numbers of the steps that have a row.
        self._times, self._steps = np.empty(0), np.empty(0, dtype=int)
        #: Number of steps, and the start, that have a plan.
        self.planned = 0
        #: How often the arrays were replaced.
        self.plans = 0
        #: The last state.
        self.end: State
        self._first: State
        self.restart()
        kinds = {"always"} | {kind for kind in _KINDS if getattr(record, kind)}
        names = [name for name, quantity in ROWS.items() if quantity.record in kinds]
        #: Names of the rows that only serve the others.
        self._serving = {"q", "v"} - {*names} if model.fits_rates else set()
        #: Starts (n, ...) of the sub-steps before rows, where these are not the rows before;
        #: `up_to_row` has their number up to each row.
        self.arrays_of_starts = _starts(model, record.motion, record.rates)
        self._parted = len(model.scheme.fractions) > 1 or model.forms.needs_previous
        #: Rows (n, ...) by name, vectors in the order of the degrees of freedom.
        self.arrays: dict[str, np.ndarray] = {}
        self.plan(0, times, last=True)
        rows = len(self._steps)
        names += self._serving
        self.arrays = {name: np.zeros((rows, model.widths[name])) for name in names}
        self.arrays["up_to_row"] = np.zeros(rows, dtype=np.int32)

    def restart(self) -> None:
        """Have no rows: those of another run of the same steps overwrite the present ones."""
        self.rows = self.starts = 0
        #: Gives the accelerations of row 0, if they are found when they are read.
        self.late_accelerations: Callable[[], np.ndarray] | None = None
        #: Whether row 0 is the start.
        self._begins = True
        #: Full turns (size,) [rad] that are missing in the rows from a number on.
        self.turns: dict[int, np.ndarray] = {}

    @property
    def t(self) -> np.ndarray:
        """Times (n,) of the rows so far [s]."""
        return self._times[self._steps[: self.rows]]

    def has_as_it_is(self, name: str) -> bool:
        """Whether a solution has the rows of a name as they are here."""
        fitted = name == "v" and self.model.fits_rates
        return name in self.arrays.keys() - self._serving and not (fitted or self.turns)

    def plan(self, first: int, ends: np.ndarray, last: bool) -> None:
        """Make room for steps from number `first` on that end at times (n,); step 0 is the start.

        With `last` the run ends with them. Steps that are planned again replace those before.
        """
        self.plans += 1  # at first: an interrupt may come after some of the arrays
        stop = first + len(ends)
        self._times = grown(self._times, stop, first)
        self._times[first:stop] = ends
        self.last = stop - 1 if last else -1
        steps = np.arange(first, stop)
        steps = steps[(steps % self.every == 0) | (steps == self.last)]
        rows = self.rows + len(steps)
        self._steps = grown(self._steps, rows, self.rows)
        self._steps[self.rows : rows] = steps
        for name, array in self.arrays.items():
            self.arrays[name] = grown(array, rows, self.rows)
        if self.stores_starts(1):
            self.make_room(len(self.model.scheme.fractions) * len(steps))
        self.planned = stop

    def make_room(self, starts: int) -> None:
        """Make room for some more starts of sub-steps."""
        room, arrays = self.starts + starts, self.arrays_of_starts
        if room > min(map(len, arrays.values())):
            self.plans += 1
            for name, array in arrays.items():
                arrays[name] = grown(array, room, self.starts)

    def count(self, rows: int, starts: int) -> None:
        """Count all rows that are written, and all starts."""
        self.rows, self.starts = rows, starts

    def truncate(self, rows: int) -> None:
        """Have some rows, which are written; what was begun after them is forgotten."""
        self.rows = rows
        self.starts = self.complete

    def settle_at_end(self) -> None:
        """Have the rows up to the last state: an exception may have come between the two."""
        self.truncate(int(np.searchsorted(self.t, self.end.t, side="right")))

    def forget(self) -> None:
        """Have the last two rows only, on which the next ones depend."""
        gone = max(self.rows - 2, 0)
        rest = self.rows - gone
        for array in (self._steps, *self.arrays.values()):
            array[:rest] = array[gone : self.rows].copy()
        self.arrays["up_to_row"][:rest] = 0
        self.turns = {max(row - gone, 0): missing for row, missing in self.turns.items()}
        self.rows, self.starts = rest, 0
        if gone:
            self._begins, self.late_accelerations = False, None
        self.plans += 1

    def miss(self, turns: np.ndarray) -> None:
        """Note that full turns (size,) [rad] are missing in the rows from here on."""
        self.turns[self.rows] = turns.copy()

    @property
    def impact(self) -> float:
        """Energy that changes of the scene took before the start [J]."""
        return self._first.impact

    @property
    def complete(self) -> int:
        """Number of starts up to the last row; within a step there are more."""
        return self._up_to(self.rows - 1)

    def _up_to(self, row: int) -> int:
        return int(self.arrays["up_to_row"][row]) if row >= 0 else 0

    def stores_starts(self, parts: int) -> bool:
        """Whether starts of a step in parts are stored: the last one is not the previous row."""
        return self._parted or parts > 1 or self.every > 1

    def begin(self, state: State) -> None:
        """Have a last state, which is also the first one if there is no row yet."""
        self.end = state
        if not self.rows:
            self._first = state

    def _missing(self, rows: np.ndarray) -> np.ndarray | float:
        """Full turns (n, size) [rad] that are missing in some rows."""
        if not self.turns:
            return 0.0
        turns = np.array([np.zeros(self.model.size), *self.turns.values()])
        return turns[np.searchsorted([*self.turns], rows, side="right")]

    def histories(self) -> RecordedHistories:
        """Histories of the rows so far by their names in `Solution`."""
        model, n, fit = self.model, self.rows, None
        rows = {name: of[:n] for name, of in self.arrays.items()}
        times, steps = self._times, self._steps[:n]
        if model.fits_rates:
            first, starts = rows["up_to_row"][:-1], None
            if self.every > 1:
                starts = tuple(self.arrays_of_starts[f"start_{name}"][first] for name in "qv")
            driven = self._first.driven_rates if self._begins else None
            fit = functools.partial(fitted, model, rows, starts, (times, steps), driven)
        t = self.t
        recorded = {name: of for name, of in rows.items() if name not in self._serving}

        def t_level() -> np.ndarray:
            return t - (1 - model.scheme.rates.level) * self._lengths()

        late = self.late_accelerations
        return RecordedHistories(model, recorded, fit, self.turns, t, t_level, self.impact, late)

    def _lengths(self) -> np.ndarray:
        """Length (n,) of the step or last part that a row's forces belong to; 0 for row 0."""
        steps = self._steps[: self.rows]
        of_step = self._times[steps] - self._times[np.maximum(steps - 1, 0)]
        row, shares, _ = self._parts(0)
        return of_step * np.bincount(row, shares)

    def _parts(self, first: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the sub-steps before rows from one on: the row, the share, and if the start is stored.

        If not, it is a whole step, which starts at the row before.
        """
        counts = np.diff(self.arrays["up_to_row"][: self.rows], prepend=0)[first:]
        repeats, rows = np.maximum(counts, 1), np.arange(first, self.rows)
        row, stored = np.repeat(rows, repeats), np.repeat(counts > 0, repeats)
        shares = np.ones(len(row))
        shares[stored] = self.arrays_of_starts["share"][self._up_to(first - 1) : self.complete]
        return row, shares, stored

    def means(self, values: np.ndarray, first: int = 0) -> np.ndarray:
        """Forces (n, ...) of rows, from those of `sub_steps`: means over the steps."""
        if len(values) == self.rows - first:  # one sub-step before each row
            return values
        row, shares, _ = self._parts(first)
        weights = shares / np.bincount(row, shares)[row]
        begins = np.flatnonzero(np.diff(row, prepend=-1))
        return np.add.reduceat(weights.reshape(-1, *[1] * (values.ndim - 1)) * values, begins)

    def sub_steps(self, first: int = 0) -> StepBatch:
        """The sub-steps before each row from one on, for which its forces are evaluated.

        Row 0 has a single one, so short that its forces depend on the rates, but not on a motion.
        """
        arrays, starts, beams = self.arrays, self.arrays_of_starts, self.model.forms.beams
        assert beams is not None
        row, rest, stored = self._parts(first)
        before, last = np.maximum(row - 1, 0), np.flatnonzero(np.diff(row, append=self.rows))
        rows, counts = row[last], np.diff(last, prepend=-1)
        span = slice(self._up_to(first - 1), self.complete)

        def begins(name: str) -> np.ndarray:
            values = arrays[name][before]
            values[stored] = starts[f"start_{name}"][span]
            return values

        def ends(begins: np.ndarray, of_rows: np.ndarray) -> np.ndarray:
            values = np.empty_like(begins)
            values[:-1], values[last] = begins[1:], of_rows
            return values

        for end, count in zip(last[counts > 1], counts[counts > 1], strict=True):
            of_step = slice(end + 1 - count, end + 1)
            rest[of_step] = np.cumsum(rest[of_step][::-1])[::-1]
        t1, t0 = self._times[self._steps[row]], self._times[np.maximum(self._steps[row] - 1, 0)]
        begin = t1 - (t1 - t0) * rest
        dt, level = ends(begin, t1[last]) - begin, self.model.scheme.rates.level
        t = begin + level * dt
        q = begins("q") + self._missing(np.where(stored, row, before))
        D = ends(q, arrays["q"][rows] + self._missing(rows)) - q
        if not first:
            dt[0] = INSTANT * np.diff(self._times[:2]).sum() or 1.0
            if beams.facts.resultants_move:
                D[0] = dt[0] * self._first.v
                q[0] -= level * D[0]
        parts = StepBatch(t, dt, D, q)
        names = [*("v", "a")[: 2 * beams.facts.resultants_need_rates]]
        names += ["internal"] * (beams.internal_shape[-1] > 0)
        names += ["natural"] * bool(self.model.natural)
        more = {name: begins(name) for name in names}
        if not first and "a" in more:  # there is no motion in row 0
            more["a"][0] = 0.0
        if "natural" in more:
            more["natural_end"] = ends(more["natural"], arrays["natural"][rows])
        memory, q_previous = np.zeros(len(row)), q
        if beams.facts.needs_previous:  # all are stored, but for the start
            q_previous = q.copy()
            memory[stored] = starts["memory"][span]
            q_previous[stored] = starts["start_q_previous"][span] + self._missing(row[stored])
        # Where parameters are inputs of a motion, only the rows know their earlier values.
        if any(function.ramps for function in self.model.forms.parameters.functions):
            more["parameters"] = self._parameters_in(row, parts.t)
        return parts._replace(memory=memory, q_previous=q_previous, **more)

    def _parameters_in(self, row: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Parameters (n, k) at times (n,) before rows: linear between these and those before."""
        previous, values = np.maximum(row - 1, 0), self.arrays["parameters"]
        t0, t1 = (self._times[self._steps[of]] for of in (previous, row))
        part = (t - t0) / np.where(row > 0, t1 - t0, 1.0)
        return values[previous] + part[:, None] * (values[row] - values[previous])


#: What takes the rows of steps.
Rows = Recorder | NullRecorder
