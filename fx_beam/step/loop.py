"""Time steps in C, in blocks: loads and driven motions are evaluated in Python before each."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.dual import without_slopes
from fx_beam.laws.interval import divided
from fx_beam.results.records import Stats
from fx_beam.results.state import State

from .forcing import Forcing
from .interrupts import uninterrupted
from .inverted_sections import InversionCheck
from .newton import NewtonOptions
from .recorder import NullRecorder, Recorder, Rows
from .step_failures import StepFailed, StepFailures
from .tables import Problem

if TYPE_CHECKING:
    from .step_control import StepControl
    from .tape import Tape

# Inputs of which a single row may stand for all sub-steps.
_REPEATED = "loads", "follower_force", "natural"
# Motions below this part of the size of the scene need not have more digits than these.
_SLIGHT = 1e-5


class CompiledLoop:
    """Tries many steps at once."""

    #: What several processes do, if they do.
    together: Any = None
    # Error of a function that finds increments in the place of C.
    _error: BaseException | None = None

    def __init__(self, forcing: Forcing, options: NewtonOptions, stats: Stats, alone: bool = True):
        self.model, self._options = forcing.model, options
        #: Owns the arrays to which C points, and with them the state.
        self.problem = problem = Problem.of(self.model, options, forcing.turning is not None, alone)
        self._ffi, self._library = problem.ffi, problem.library
        self._problem, self.state = problem.c, problem.state
        #: Records of C by recorders, each with the recorder's plan and its arrays of rows.
        self._records: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()
        #: Where sub-steps are taped, but for those of trials; None for nowhere.
        self.tape: Tape | None = None
        self._begin(forcing, stats)

    def _begin(self, forcing: Forcing, stats: Stats) -> None:
        self.forcing, self.stats = forcing, stats
        #: Why steps fail.
        self.failures = StepFailures(self.model, self._options, stats)
        #: Checks and counts states with inverted sections.
        self.inversion = InversionCheck(self.model, stats)
        self.problem.c.inverted.least_energy = self.inversion.least_energy
        stats.solver = stats.solver or f"compiled, {self.problem.factors}"

    def refill(self, forcing: Forcing, stats: Stats) -> None:
        """Begin another run, with the numbers that the model has now."""
        self.problem.refill()
        self._begin(forcing, stats)

    def take(
        self, state: State, steps: Steps, recorder: Rows, completed: Callable[[int], int] = int
    ) -> StepsResult:
        """Take steps or parts of equal length, as long as they succeed and this length is right.

        `completed` counts the parts that were taken, and gives the number of whole steps.
        """
        p, ends, inputs = self._problem, steps.ends, steps.inputs
        with uninterrupted:
            if taken := self._run(state, steps, recorder):
                state = self.state.read(float(ends[taken - 1]))
                self.stats.steps += completed(taken)
                recorder.end = state
        C, before, ratio = (
            self._library,
            *(ratio if ratio >= 0 else None for ratio in p.control.ratios),
        )
        switched = steps.watch and p.run.failure == C.SWITCHED
        self.stats.unconverged += p.run.failure == C.NO_CONVERGENCE
        if steps.control is None or p.run.failure not in (C.OK, C.TOO_INACCURATE):
            before = ratio = None
        return StepsResult(
            *(state, taken, before if taken > 1 else None, ratio),
            failed=p.run.failure not in (C.OK, C.SWITCHED, C.TOO_INACCURATE),
            switched=switched,
            switches=self.problem.sides[1].copy() if steps.watch and (taken or switched) else None,
            error=inputs.error if taken == len(inputs.driven) // p.scheme.sub_steps else None,
        )

    def record(self, state: State, recorder: Recorder) -> None:
        """Record a state in the next row of a recorder, as C records the ends of steps."""
        self.model.forms.parameters.use(state.parameters)
        self.state.load(state)
        recorder.begin(state)
        to = self.c_record(recorder, 0, first=0)
        self._library.fx_run(self._problem, 0, 0.0, self._ffi.NULL, self._ffi.NULL, to)
        recorder.count(to.rows, to.starts)

    def _run(self, state: State, steps: Steps, recorder: Rows) -> int:
        """Number of steps or parts of equal length that succeeded."""
        self.state.load(state)
        inputs, number, dt = steps.inputs, len(steps.ends), steps.dt
        to = self.c_record(recorder, number, steps.first, steps.parts, steps.done)
        tape = recorder.tape if isinstance(recorder, NullRecorder) else self.tape
        if tape is not None:
            taken = self._run_taped(tape, steps, state.t, to)
        else:
            known = len(inputs.driven) // self._problem.scheme.sub_steps
            taken = self._steps(known, dt, self.c_inputs(inputs), to, self._limits(steps))
        recorder.count(to.rows, to.starts)
        self.count()
        return taken

    def _limits(self, steps: Steps) -> Any:
        """When C ends a run before its last step, as the errors or switches of a step tell."""
        watches, control = steps.watch and self._problem.control.switches > 0, steps.control
        if control is None:
            return self._ffi.new("Limits *", [0, watches])
        limits = *control.factors(steps.dt), *control.band(steps.dt)
        return self._ffi.new("Limits *", [1, watches, *limits])

    def _steps(self, number: int, dt: float, c_inputs: Any, to: Any, limits: Any = None) -> int:
        """Number of steps that C takes."""
        limits = self._ffi.NULL if limits is None else limits
        taken = self._library.fx_run(self._problem, number, dt, c_inputs, limits, to)
        self.check()
        return taken

    def check(self) -> None:
        """Raise the error of another process, or of a function that C calls, in the last step."""
        if self.together is not None:
            self.together.check()
        error, self._error = self._error, None
        if error is not None:
            raise error

    def find_by(self, find: Callable[[float], int]) -> None:
        """Find increments of sub-steps of a length [s] by a function, ``find`` of c/problem.h."""
        keep = weakref.ref(self)

        def fail(kind: type, error: BaseException, trace: Any) -> None:
            loop = keep()
            if loop is not None:
                loop._error = error

        kind, failed = self._ffi.typeof(self._problem.newton.find), self._library.NO_CONVERGENCE
        self._find = self._ffi.callback(kind, find, error=failed, onerror=fail)
        self._problem.newton.find = self._find

    def _run_taped(self, tape: Tape, steps: Steps, t: float, to: Any) -> int:
        """The same on a tape, which keeps the state before every so many steps."""
        from .tape import TakenSteps

        taken, inputs, times = 0, steps.inputs, np.append(t, steps.ends)
        total = len(inputs.driven) // self._problem.scheme.sub_steps
        while taken < total:
            rest, count = inputs.after(taken), min(tape.most_steps, total - taken)
            count -= (to.part + count) % to.parts if count > to.parts else 0  # whole steps
            c_inputs = self.c_inputs(rest)
            now = TakenSteps(count, steps.dt, to.parts, to.part, c_inputs, rest, times[taken:])
            to.tape = tape.begin(now)
            done = self._steps(count, steps.dt, c_inputs, to, self._limits(steps))
            tape.end(done)
            taken, to.part = taken + done, to.part + done
            if done < count or self._problem.control.stopped:
                break
        return taken

    def failure(self, state: State, t1: float) -> StepFailed:
        """Why a step to t1 [s] fails, without a prediction."""
        copy, inputs = self.state.copy(), self.inputs(state.t, np.array([t1]))
        if inputs.error is not None:
            raise inputs.error
        self.state.past = None
        self.state.load(state)
        to = self.c_record(NullRecorder(), 1)
        taken = self._steps(1, t1 - state.t, self.c_inputs(inputs), to)
        failure = StepFailed("no convergence", "no convergence", np.zeros(self.model.size))
        if not taken:
            failure = self.failures.in_c(self.problem, state)
        self.state.restore(copy)
        return failure

    def c_inputs(self, inputs: StepInputs):
        """The inputs for C; they must be kept as long as C uses them."""
        c_inputs = self._ffi.new("Inputs *")
        for name, rows in inputs.arrays().items():
            if rows.size:
                # The first row is contiguous, also where it stands for all.
                setattr(c_inputs, name, self._ffi.from_buffer("double[]", rows[:1]))
                if name in _REPEATED:
                    setattr(c_inputs, f"{name}_stride", rows.strides[0] // rows.itemsize)
        return c_inputs

    def c_record(self, recorder: Rows, number: int, first: int = 1, parts: int = 1, done: int = 0):
        """Rows of a recorder for C, from its next one on, for a number of steps or parts.

        From step `first` on, of which some parts are `done`.
        """
        stores = recorder.stores_starts(parts)
        if stores:
            recorder.make_room(number * self._problem.scheme.sub_steps)
        plan, to, _ = self._records.get(recorder, (-1, None, None))
        if plan != recorder.plans:
            to = self._record_of(recorder)
        to.first, to.last, to.parts, to.part = first, recorder.last, parts, done
        to.stores_starts, to.tape = stores, self._ffi.NULL
        to.rows, to.starts, to.complete = recorder.rows, recorder.starts, recorder.complete
        return to

    def _record_of(self, recorder: Rows):
        """The same with the arrays that a recorder has now."""
        to = self._ffi.new("Record *")
        rows, starts = dict(recorder.arrays), dict(recorder.arrays_of_starts)
        to.every, to.forces = recorder.every, "constraint_forces" in rows
        if "up_to_row" in rows:
            to.up_to_row = self._ffi.from_buffer("int[]", rows.pop("up_to_row"))
        for name in ("share", "memory"):
            if name in starts:
                setattr(to, name, self._ffi.from_buffer("double[]", starts.pop(name)))
        histories, stored = self._rows(rows), self._rows(starts)
        to.histories, to.history = len(histories), histories
        to.stored, to.start = len(stored), stored
        self._records[recorder] = recorder.plans, to, (histories, stored)
        return to

    def _rows(self, arrays: dict[str, np.ndarray]):
        """Rows of arrays, which C writes from those of the same names, also at `start_`."""
        arrays = {name: array for name, array in arrays.items() if array.shape[1]}
        rows = self._ffi.new("Rows[]", len(arrays))
        for row, (name, array) in zip(rows, arrays.items(), strict=True):
            row.source = getattr(self._problem.state, name.removeprefix("start_"))
            row.size = array.shape[1]
            row.target = self._ffi.from_buffer("double[]", array)
        return rows

    def count(self) -> None:
        """Add what C has counted since it was asked last to the statistics."""
        counts, stats = self._library.fx_take_counts(self._problem), self.stats
        stats.substeps += counts.taken
        stats.newton_iterations += counts.iterations
        stats.too_large += counts.too_large
        stats.amplified += counts.amplified
        if counts.inverted:
            self.inversion.count(counts.inverted, counts.inverted_t, self.problem.inverted_q)
        by_round_off = counts.by_round_off
        solves = counts.taken * self._problem.scheme.sub_steps - by_round_off
        for name, count in (("increment", solves), ("round-off", by_round_off)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        if counts.left:
            stats.rounding += counts.left / min(max(counts.moved, _SLIGHT), 1.0)
            if not stats.rounding_in:
                stats.rounding_in = self.model.mesh.place_of(counts.left_at // 3, self.model.scene)

    def inputs_ahead(self, t: float, times: np.ndarray) -> StepInputs:
        """Inputs of steps from t to `times` [s] that are taken next."""
        return self.inputs(t, times)

    def inputs(self, t: float, times: np.ndarray) -> StepInputs:
        """Inputs of all sub-steps; if a function of time fails, only of the steps before."""
        p = self._problem
        inputs = no_inputs(p.scheme.sub_steps, len(times))
        if not (
            p.loads.count
            or p.driven
            or p.loads.follower_forces
            or p.parameters.vary
            or p.natural.count
        ):
            return inputs
        starts = np.concatenate([[t], times[:-1]])
        t0, t1 = divided(starts, times, self.model.scheme.fractions)
        model, forcing, strains = self.model, self.forcing, self.model.natural
        follow, parameters = model.points.followers, model.forms.parameters
        level = model.scheme.rates.level

        def rows(of: Callable[..., np.ndarray], constant: bool, *ends: np.ndarray) -> np.ndarray:
            """Rows of all sub-steps; a single row is repeated without copies."""
            values = of(*(end[: 1 if constant else None] for end in ends))
            values = np.ascontiguousarray(without_slopes(values))
            shape = len(t1), *values.shape[1:]
            return np.broadcast_to(values, shape) if values.size else np.empty(shape)

        try:
            given: dict[str, Any] = {"loads": rows(forcing.loads, model.loads.constant, t0, t1)}
            if follow:
                given["follower_force"] = rows(follow.series, follow.constant, t0, t1)
            if parameters.vary:
                given["parameters"] = without_slopes(parameters.over_steps(t0, t1, level))
            if strains:
                given["natural"] = rows(forcing.naturals, strains.constant, t1)
            return inputs._replace(driven=without_slopes(forcing.series(t1)), **given)
        except BaseException as raised:
            before = int(np.searchsorted(times, getattr(raised, "time", t)))
            inputs = self.inputs(t, times[:before]) if before else no_inputs(p.scheme.sub_steps)
            return inputs._replace(error=inputs.error or raised)


class Steps(NamedTuple):
    """Steps or parts of equal length that are tried."""

    #: Their ends [s], the length of each [s], which has no rounding of times, and their inputs.
    ends: np.ndarray
    dt: float
    inputs: StepInputs
    #: Number of the first one; how many of its parts were taken before, and parts of a step.
    first: int
    done: int = 0
    parts: int = 1
    #: Limits of their local errors, if these are controlled.
    control: StepControl | None = None
    #: Whether they end before one in which a contact or a law switches.
    watch: bool = False


class StepsResult(NamedTuple):
    """What came of steps of equal length."""

    #: State at the end of the steps that succeeded, and their number.
    state: State
    taken: int
    #: Ratios of error and limit in the last step but one and in the last one, if they are known.
    before: float | None = None
    ratio: float | None = None
    #: Whether Newton's method failed in the step after them; a ratio above 1 rejects the last one.
    failed: bool = False
    #: Whether a contact or a law switches in the step after them; the switches at its end if they
    #: are watched.
    switched: bool = False
    switches: np.ndarray | None = None
    #: Error of a function of time in the step after them.
    error: BaseException | None = None


class StepInputs(NamedTuple):
    """Loads, driven motions and the like of sub-steps, and what ended them."""

    loads: np.ndarray
    driven: np.ndarray
    follower_force: np.ndarray
    #: Values (sub-steps, 2, n) at the scheme's level and at the end; (..., 0) if none varies.
    parameters: np.ndarray
    #: Natural strains (sub-steps, n) at the end.
    natural: np.ndarray
    #: Sub-steps of a step.
    parts: int
    error: BaseException | None = None

    def arrays(self) -> dict[str, Any]:
        """All rows by name."""
        return dict(zip(self._fields, self[:5], strict=False))

    def after(self, steps: int) -> StepInputs:
        """The inputs of the steps after some."""
        first = steps * self.parts
        return self._replace(**{name: rows[first:] for name, rows in self.arrays().items()})


def no_inputs(parts: int, steps: int = 0) -> StepInputs:
    """Those of steps without any."""
    none, of_ends = np.empty((steps * parts, 0)), np.empty((steps * parts, 2, 0))
    return StepInputs(of_ends, none, none, of_ends, none, parts)
