"""Time steps in C, in blocks: loads and driven motions are evaluated in Python before each."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.laws.interval import Interval
from fx_beam.results.records import Stats
from fx_beam.results.state import State

from .forcing import Forcing
from .inverted_sections import count_inverted, least_energy
from .newton import NewtonOptions
from .recorder import NullRecorder, Recorder, RecordInC, Rows
from .step_failures import StepFailed, StepFailures
from .step_inputs import StepBlock, StepInputs, inputs_of
from .tables import ProblemInC, problem_of
from .tangent_storage import ProblemKind

if TYPE_CHECKING:
    from .step_control import StepControl
    from .tape import Tape

# Motions below this part of the size of the scene need not have more digits than these.
_SLIGHT = 1e-5


class CompiledLoop:
    """Tries many steps at once."""

    # Error of a function that finds increments in the place of C.
    _error: BaseException | None = None

    def __init__(self, forcing: Forcing, options: NewtonOptions, stats: Stats):
        self.model = forcing.model
        #: Owns the arrays to which C points, and with them the state.
        kind = ProblemKind(options, forcing.turning is not None)
        self.problem = problem = problem_of(self.model, kind)
        self.state = problem.state
        #: The record of C.
        self._record = RecordInC(problem)
        #: Where sub-steps are taped, but for those of trials; None for nowhere.
        self.tape: Tape | None = None
        self._begin(forcing, stats)

    def restart(self, forcing: Forcing, stats: Stats) -> None:
        """Begin another run, with the numbers that the model has now."""
        self.problem.restart()
        self._begin(forcing, stats)

    def _begin(self, forcing: Forcing, stats: Stats) -> None:
        self.forcing, self.stats = forcing, stats
        #: Inputs of steps from a time to other times [s] that are taken next.
        self.inputs_ahead: Callable[[float, np.ndarray], StepInputs]
        self.inputs_ahead = functools.partial(inputs_of, self.problem, forcing)
        self.problem.c.work.inverted.least_energy = least_energy(self.model)
        stats.solver = stats.solver or f"compiled, {self.problem.storage.factors}"

    @property
    def failures(self) -> StepFailures:
        """Why steps fail."""
        return StepFailures(self.model, self.problem.kind.newton, self.stats)

    def take_steps(self, steps: EqualSteps, recorder: Rows) -> int:
        """Take steps or parts of equal length from the state in C; number of successful ones.

        With a control they end behind the first step whose error asks for another length.
        """
        p, inputs, problem = self.problem.c, steps.inputs, self.problem
        number, t = inputs.steps, p.work.state.t
        record = self._record.next(recorder, number, steps.first, steps.parts, steps.done)
        tape = recorder.tape if isinstance(recorder, NullRecorder) else self.tape
        if tape is None:
            limits = steps.limits(problem)
            count = self._steps(number, t, steps.dt, inputs.in_c(problem.ffi), record, limits)
        else:
            count = self._run_taped(tape, steps, t, record)
        recorder.rows, recorder.starts.count = record.rows, record.starts
        if count:
            p.work.state.t = float(steps.ends[count - 1])  # without the rounding of sums
        if count < number:
            self.stats.unconverged += p.work.run.failure == problem.library.NO_CONVERGENCE
        self.count()
        return count

    def result(self, steps: EqualSteps, count: int) -> StepsResult:
        """Outcome of the steps that were taken last, of which a number succeeded."""
        p, C, last_ratio, ratio = self.problem.c, self.problem.library, None, None
        failure = p.work.run.failure
        switched = steps.watch and failure == C.SWITCHED
        if steps.control is not None and failure in (C.OK, C.TOO_INACCURATE):
            last_ratio, ratio = (known if known >= 0 else None for known in p.work.control.ratios)
        return StepsResult(
            *(count, last_ratio if count > 1 else None, ratio),
            failed=failure not in (C.OK, C.SWITCHED, C.TOO_INACCURATE),
            switched=switched,
            switches=self.problem.sides[1].copy() if steps.watch and (count or switched) else None,
        )

    def record(self, state: State, recorder: Recorder) -> None:
        """Record a state in the next row of a recorder, as C records the ends of steps."""
        self.model.forms.parameters.use(state.parameters)
        self.state.load(state)
        recorder.begin_row(state)
        record = self._record.next(recorder, 0, first=0)
        problem, none = self.problem, self.problem.ffi.NULL
        problem.library.fx_run(problem.c, 0, state.t, 0.0, none, none, record)
        recorder.rows, recorder.starts.count = record.rows, record.starts

    def _steps(
        self, number: int, t: float, dt: float, c_inputs: Any, record: Any, limits: Any = None
    ) -> int:
        """Number of steps that C takes from t [s]."""
        problem, limits = self.problem, limits or self.problem.ffi.NULL
        count = problem.library.fx_run(problem.c, number, t, dt, c_inputs, limits, record)
        error, self._error = self._error, None
        if error is not None:
            raise error  # of a function that C calls in the last step
        return count

    def interval(self, dt: float) -> Interval:
        """Interval of the sub-step of this length [s] that C takes."""
        t = self.problem.c.work.state.t
        return Interval(t, t + dt, dt)

    def find_by(self, find: Callable[[float, Any], int]) -> None:
        """Find increments of sub-steps by a function, ``find`` of c/work.h."""
        keep = weakref.ref(self)

        def fail(kind: type, error: BaseException, trace: object) -> None:
            loop = keep()
            if loop is not None:
                loop._error = error

        ffi, newton = self.problem.ffi, self.problem.c.work.newton
        kind, failed = ffi.typeof(newton.find), self.problem.library.NO_CONVERGENCE
        newton.find = self._find = ffi.callback(kind, find, error=failed, onerror=fail)

    def _run_taped(self, tape: Tape, steps: EqualSteps, t: float, record: Any) -> int:
        """Number of steps that succeeded, on a tape with the state before every so many steps."""
        total, inputs, times = 0, steps.inputs, np.concatenate([[t], steps.ends])
        number = inputs.steps
        while total < number:
            rest = inputs.after(total) if total else inputs
            count = min(tape.most_steps, number - total)
            count -= (
                (record.part + count) % record.parts if count > record.parts else 0
            )  # whole steps
            taken = StepBlock(count, steps.dt, record.parts, record.part, rest, times[total:])
            record.tape = tape.keep_steps(taken)
            now, limits = self.problem.c.work.state.t, steps.limits(self.problem)
            c_inputs = rest.in_c(self.problem.ffi)
            done = self._steps(count, now, steps.dt, c_inputs, record, limits)
            tape.end(done)
            total, record.part = total + done, record.part + done
            if done < count or self.problem.c.work.control.stopped:
                break
        return total

    def failure(self, start: State, t1: float) -> StepFailed:
        """Why a step from the state in C to t1 [s] fails, without a prediction."""
        inputs = self.inputs_ahead(start.t, np.array([t1]))
        if inputs.error is not None:
            raise inputs.error
        with self.state.unchanged():
            self.state.past = None
            record = self._record.next(NullRecorder(), 1)
            c_inputs = inputs.in_c(self.problem.ffi)
            if not self._steps(1, start.t, t1 - start.t, c_inputs, record):
                return self.failures.in_c(self.problem, start)
        return StepFailed("no convergence", "no convergence", np.zeros(self.model.size))

    def count(self) -> None:
        """Add what C has counted since it was asked last to the statistics."""
        counts, stats = self.problem.library.fx_take_counts(self.problem.c), self.stats
        stats.substeps += counts.taken
        stats.newton_iterations += counts.iterations
        stats.too_large += counts.too_large
        stats.amplified += counts.amplified
        if counts.inverted:
            inverted = counts.inverted, counts.inverted_t, self.problem.inverted_q
            count_inverted(self.model, stats, *inverted)
        last = counts.by_round_off
        converged = counts.taken * self.problem.c.tables.scheme.sub_steps - last
        for name, count in (("increment", converged), ("round-off", last)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        if counts.left:
            stats.rounding += counts.left / min(max(counts.moved, _SLIGHT), 1.0)
            if not stats.rounding_in:
                stats.rounding_in = self.model.mesh.place_of(counts.left_at // 3, self.model.scene)


class EqualSteps(NamedTuple):
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

    def limits(self, problem: ProblemInC) -> Any:
        """The struct ``Limits``: when C ends them, as their errors or switches tell."""
        watches, control = self.watch and problem.c.work.control.switches > 0, self.control
        if control is None:
            return problem.ffi.new("Limits *", [0, watches]) if watches else problem.ffi.NULL
        limits = *control.factors(self.dt), *control.band(self.dt)
        return problem.ffi.new("Limits *", [1, watches, *limits])


class StepsResult(NamedTuple):
    """Outcome of steps of equal length."""

    #: Number of the steps that succeeded.
    taken: int
    #: Ratios of error and limit in the last step but one and in the last one, if they are known.
    last_ratio: float | None = None
    ratio: float | None = None
    #: Whether Newton's method failed in the step after them; a ratio above 1 rejects the last one.
    failed: bool = False
    #: Whether a contact or a law switches in the step after them; the switches at its end if they
    #: are watched.
    switched: bool = False
    switches: np.ndarray | None = None
