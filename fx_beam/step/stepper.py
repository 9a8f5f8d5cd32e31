"""Time steps from the state in C: in time and in load, halved where they fail, recorded."""

from __future__ import annotations

import functools
import logging
import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.c_library import array_at
from fx_beam.dual import floats
from fx_beam.errors import Failure, StepError, any_of
from fx_beam.laws.interval import Interval
from fx_beam.results.records import Stats, stats_unchanged
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS, arc_lengths, gauss_rule
from fx_beam.scene.forces_between import RopeOverPulleys
from fx_beam.scene.sliders import corner_advice

from .equations import Equations, Residual
from .forcing import Forcing, LoadForcing
from .full_turns import TurnCounter
from .model import Model, fact, recursive_columns
from .newton import LONGEST_TURN, NewtonOptions
from .recorded_rows import sums_of
from .recorder import Mark, NullRecorder, Recorder, RecordInC, Rows
from .step_control import Halving
from .step_inputs import StepBlock, StepInputs, inputs_of
from .tables import ProblemInC, problem_of
from .tangent_storage import ProblemKind

if TYPE_CHECKING:
    from .state_vector import StateVector
    from .step_control import StepControl
    from .tape import Tape


# -- Check of eq. 4, t . phi' > 0 at every Gauss point: no section may be inverted --------------


_log = logging.getLogger("fx_beam")
_INVERTED = (
    "%s: beam %r has an inverted section at its arc length %.4g m and %s = %.6g: there t . phi' is "
    "%.3g, but must be positive (eq. 4). Check the units of loads, velocities and stiffnesses, or "
    "make the section stiffer"
)


def count_inverted(model: Model, stats: Stats, number: int, t: float, q: np.ndarray) -> None:
    """Count steps with inverted sections; a warning reports the first, at t [s] or load factor.

    With the beam and the position of the worst section at displacements and rotations q (size,).
    """
    stats.inverted += number
    if stats.inverted > number:
        return
    beams = model.forms.beams
    assert beams is not None  # sections are those of beams
    stretch = beams.normal_stretch(q)
    cell, point = np.unravel_index(np.argmin(stretch), stretch.shape)
    beam_number = model.mesh.beam_of_cell[cell]
    beam, element = model.scene.beams[beam_number], cell - model.mesh.cells[beam_number][0]
    start, end = beam.s[element : element + 2]
    s = start + (end - start) * gauss_rule(beam.degree)[0][point]
    place = stats.scheme, beam.name, s, "load factor" if stats.static else "t", t
    _log.warning(_INVERTED, *place, stretch[cell, point])


def least_energy(model: Model) -> float:
    """Lower bound of the strain energy of a Gauss point whose axial strain is -1 [J].

    It is EA/2 times the length of the Gauss point, here half of that; less with natural strains,
    from which strains count; 0 for stored energies that are not quadratic.
    """
    least: float = np.inf
    for beam, length in zip(model.scene.beams, model.mesh.shortest, strict=True):
        section, (gauss, weights) = beam.section, gauss_rule(beam.degree)
        if section.strain_energy is not None:
            return 0.0
        EA = section.EA
        if callable(EA):
            EA = floats(section.values("EA", arc_lengths(beam, gauss) / beam.length)).min()
        share = 0.02 if model.data.natural else min(weights) / 4
        least = min(least, float(EA) * length * share)
    return least


# -- Driven motions that jump, where Newmark's family carries on what they do to rates -----------


# How much faster than before and after a driven motion moves where it jumps; what is no motion, in
# sizes of the scene or rad; halvings of a step down to the part in which a function jumps.
_AT_ONCE, _NO_MOTION, _HALVINGS = 10.0, 1e-10, 12
_JUMPS = (
    "%s: %s jumps in the step to t = %.6g: rates and accelerations of masses that joints couple to "
    "it, and forces there, are wrong from then on; displacements are right. Let it move over many "
    "steps, or take EnergyMomentum"
)


class JumpWatch:
    """Warns once of a driven motion that jumps and moves what joints hold, by Newmark's family.

    It is one that moves ten times as fast as in the step before, and as in the next one, or, if it
    is a function of time, half of its way at once.
    """

    def __init__(self, forcing: Forcing):
        self._forcing, self._columns = forcing, fact(forcing.model, recursive_columns)
        #: Whether there is something to warn of.
        self.on = any_of(self._columns)
        self._times, self._places = np.empty(0), np.empty((0, len(self._columns)))

    def begin(self, state: StateVector) -> None:
        """Begin steps from a state; those behind it were undone. A motion starts from rest."""
        before = self._times <= state.t
        self._times, self._places = self._times[before], self._places[before]
        if len(self._times) < 2:
            start = self._forcing.current(state.read())
            self._times, self._places = np.array([-np.inf, state.t]), np.array([start, start])

    def follow(self, ends: np.ndarray, places: np.ndarray) -> None:
        """Look at steps that were taken, to places (n, driven), with the two before."""
        model = self._forcing.model
        times, places = np.append(self._times, ends), np.concatenate([self._places, places])
        moved = abs(np.diff(places, axis=0))
        speeds = moved / np.diff(times)[:, None]
        jumps = speeds[1:] > _AT_ONCE * speeds[:-1]
        jumps &= (moved[1:] > _NO_MOTION * model.mesh.size) & self._columns
        jumps[:-1] &= speeds[1:-1] > _AT_ONCE * speeds[2:]
        for column in np.flatnonzero(jumps[-1]):
            jumps[-1, column] = self._at_once(column, times[-2:], places[-2:, column])
        self._times, self._places = times[-3:], places[-3:]
        if jumps.any():
            step, column = np.argwhere(jumps)[0]
            name = self._forcing.names[column]
            _log.warning(_JUMPS, model.scheme.name, name, times[step + 2])
            self.on = False

    def _at_once(self, column: int, times: np.ndarray, places: np.ndarray) -> bool:
        """Whether half of a motion from place to place is in a small part of this time [s]."""
        (t0, t1), (start, end) = times, places
        if self._forcing.straight[column]:
            return False
        for _ in range(_HALVINGS):
            t = (t0 + t1) / 2
            place = floats(self._forcing.series(np.array([t])))[0, column]
            if abs(place - start) > abs(end - place):
                t1, end = t, place
            else:
                t0, start = t, place
        return bool(abs(end - start) > abs(places[1] - places[0]) / 2)


# -- Why a step fails: what is checked of it, and what is said ----------------------------------


_MOVED = "points move further in contact with members than half an element"
_PASSED = (
    "a node passes through the middle of a member. Raise the stiffness of the contact, "
    "or the radius of the members"
)
_SINGULAR = "the tangent is singular or a value is not finite"
OPEN = "a loop of joints cannot be closed"
_UNMET = "the friction of joints and the force that it follows do not meet"
_AMPLIFIED = "damping adds energy to the motion, as a sub-step goes back in time"


class StepFailed(Exception):
    """A failed step: kind and reason as in `Failure`, last increment, sizes of corrections."""

    def __init__(self, kind: str, reason: str, D: np.ndarray, corrections: Sequence[float] = ()):
        super().__init__(reason)
        self.kind, self.reason = kind, reason
        self.D = D
        self.corrections = corrections


class StepFailures:
    """Limits that steps of a model must not pass."""

    def __init__(self, model: Model, options: NewtonOptions, stats: Stats):
        self.model, self.options, self._stats = model, options, stats

    def shortening(self, correction: np.ndarray) -> float:
        """Factor that limits the rotations of a correction (size,)."""
        turn = abs(correction[self.model.mesh.turns]).max()
        return LONGEST_TURN / turn if LONGEST_TURN < turn < np.inf else 1.0

    def check_finite(self, size: float, corrections: list[float]) -> None:
        """Reject a correction whose size is not finite."""
        if not np.isfinite(size):
            raise StepFailed("singular", _SINGULAR, np.full(self.model.size, np.nan), corrections)

    def check_turn(self, D: np.ndarray, corrections: list[float]) -> None:
        """Reject an increment (size,) with a rotation above the bound."""
        turn = abs(D[self.model.mesh.turns]).max()
        if not np.isfinite(turn):
            raise StepFailed("no convergence", OPEN, D, corrections)
        if turn > self.options.max_turn:
            raise StepFailed("large rotation", self._turned(turn), D, corrections)

    def _turned(self, turn: float) -> str:
        most = self.options.max_turn
        return f"a node turns by {turn:.3g} rad in one step, more than max_turn = {most:g}"

    def check_places(self, D: np.ndarray, corrections: list[float]) -> None:
        """Reject a step in which a node leaves the beam on which it slides.

        Or a point passes a member, or comes near more than were found.
        """
        if (fault := self.model.reduction.fault()) is not None:
            raise StepFailed(*fault, D, corrections)
        if (members := self.model.points.members) is None:
            return
        from fx_beam.fem.member_contacts import Found

        reasons: dict[int, str] = {Found.MOVED: _MOVED, Found.SLID: _MOVED}
        reasons[Found.PASSED] = _PASSED
        if (reason := reasons.get(members.check_search(D))) is not None:
            raise StepFailed("members", reason, D, corrections)

    def unconverged(self, D: np.ndarray, corrections: list[float]) -> StepFailed:
        """After the largest number of iterations."""
        reason = f"no convergence in {self.options.max_iterations} iterations"
        return StepFailed("no convergence", reason, D, corrections)

    def in_c(self, problem: Any, state: State) -> StepFailed:
        """Of the last step in C, from a state."""
        p, C, reduction = problem.c, problem.library, self.model.reduction
        D = next(problem.results(D=self.model.size)).copy()
        last = range(max(0, p.work.newton.tried - C.CORRECTIONS), p.work.newton.tried)
        corrections = [p.work.newton.corrections[i % C.CORRECTIONS] for i in last]
        reduction.set_start(state.q, state.slides)  # which says whether it is singular
        if p.work.run.failure == C.SLID_TOO_FAR:
            arcs = [(s.s0, s.s1) for s in (p.work.slider[i] for i in range(p.tables.sliders.count))]
            return StepFailed(*(reduction.fault(arcs) or ("", "")), D, corrections)
        if p.work.run.failure == C.OUT_OF_LINE:
            return StepFailed("singular", reduction.singularity, 0 * D)
        turn, nowhere = abs(D[self.model.mesh.turns]).max(), np.full(len(D), np.nan)
        reasons = {
            C.TURNED_TOO_FAR: ("large rotation", self._turned(turn), D),
            C.SINGULAR: ("singular", _SINGULAR, nowhere),
            C.OPEN_LOOP: ("no convergence", OPEN, nowhere),
            C.PASSED_THROUGH: ("members", _PASSED, D),
            C.MOVED_TOO_FAR: ("members", _MOVED, D),
            C.UNMET_FRICTION: ("no convergence", _UNMET, D),
            C.AMPLIFIED: ("damping", _AMPLIFIED, D),
        }
        if p.work.run.failure in reasons:
            return StepFailed(*reasons[p.work.run.failure], corrections)
        return self.unconverged(D, corrections)

    def error(
        self, message: str, tries: int, start: State, failed: StepFailed, advice: str
    ) -> StepError:
        """StepError for a step that failed after some cuts: what, why, the worst node, advice."""
        model = self.model
        D = abs(failed.D / model.units.nodes).reshape(-1, 3)
        node, component = np.unravel_index(np.argmax(np.nan_to_num(D, nan=np.inf)), D.shape)
        history = ", ".join(f"{r:.1e}" for r in failed.corrections[-8:])
        named = model.mesh.named(int(node), model.scene)
        place = (
            f"Largest increment: {COMPONENTS[component]} of {named}. Last corrections, in sizes of "
            f"the scene or rad: {history or 'none'}"
        )
        solver, cuts = ("static", "cuts") if self._stats.static else (model.scheme.name, "halvings")
        tries_text = f" after {tries} {cuts}" if tries else ""
        reason = f"{solver}: {message}{tries_text}: {failed.reason}"
        advice = corner_advice(model.scene.joints, start.slides) or advice
        return StepError(Failure(failed.kind, reason, start.t, place, advice))


# -- Time steps in C, in blocks: loads and driven motions are evaluated in Python before each ---


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
        self._jumps = JumpWatch(forcing)
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
        if self._jumps.on:
            self._jumps.begin(self.state)
        tape = recorder.tape if isinstance(recorder, NullRecorder) else self.tape
        if tape is None:
            limits = steps.limits(problem)
            count = self._steps(number, t, steps.dt, inputs.in_c(problem.ffi), record, limits)
        else:
            count = self._run_taped(tape, steps, t, record)
        recorder.rows, recorder.starts.count = record.rows, record.starts
        if count:
            p.work.state.t = float(steps.ends[count - 1])  # without the rounding of sums
            if self._jumps.on:
                self._jumps.follow(steps.ends[:count], inputs.ends_of_driven[:count])
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
            if count > record.parts:  # whole steps
                count -= (record.part + count) % record.parts
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


# -- Time steps from the state in C: halved where they fail, counted, recorded, and undone ------


# Difference of the lengths of equal steps, relative to them, besides the rounding of times.
_SAME = 1e-12
# Distance at which a point of a rope comes to a circle, relative to the radius.
_NEAR = 1e-3


class Trial(NamedTuple):
    """A step that is not part of a run."""

    #: State at its end; None if it fails, or if something that is watched switches in it.
    state: State | None = None
    #: `Model.switches` at its end, or after the first of its sub-steps in which one changes its
    #: sign; None if it fails, or if they are not watched.
    switches: np.ndarray | None = None


class Stepper:
    """Takes time steps from the state in C; a step that fails is halved.

    At the end of steps a single assignment makes a mark the `end` of their recorder.
    """

    def __init__(self, loop: CompiledLoop, halving: Halving, turn_counter: TurnCounter):
        self.loop, self.halving, self.turn_counter = loop, halving, turn_counter
        self.model, self.stats = loop.model, loop.stats

    # -- The state --------------------------------------------------------------------------------

    def load(self, state: State) -> None:
        """Begin with a state, its past, and the parts of its steps."""
        self.loop.state.load(state)
        self.loop.state.past = state.past
        self.halving.resume(state.parts)

    def state(self) -> State:
        """A copy of the state, with all on which the next step depends."""
        state = self.loop.state
        return state.read().changed(past=state.past, parts=self.halving.state)

    def begin_rows(self, state: State, recorder: Rows) -> None:
        """Begin the rows of a run with its first state."""
        if isinstance(recorder, Recorder):
            self.loop.record(state, recorder)
        self.mark(recorder)

    def mark(self, recorder: Rows) -> None:
        """Make the state the end of the last steps of a recorder."""
        state = self.loop.state
        halving, turns = dict(vars(self.halving)), self.turn_counter.removed
        recorder.end = Mark(state.t, state.copy(), halving, recorder.rows, turns)

    def return_to(self, mark: Mark, recorder: Rows) -> None:
        """Undo all steps after a mark."""
        self.loop.state.restore(mark.state)
        vars(self.halving).update(mark.halving)
        self.turn_counter.removed = mark.turns
        recorder.truncate(mark.rows)
        recorder.miss(mark.turns)
        recorder.end = mark

    def count_turns(self, recorder: Rows) -> None:
        """Take full turns out of the state, which rows miss from here on.

        Counted separately, they do not add to rounding errors.
        """
        counter, arrays = self.turn_counter, self.loop.state.arrays
        if not (turns := counter.turns_of(arrays["q"])).any():
            return
        for name in ("q", "q_previous"):
            if arrays[name].size:
                arrays[name][:] -= turns
        counter.removed = counter.removed + turns
        recorder.miss(counter.removed)
        self.mark(recorder)

    # -- Steps ------------------------------------------------------------------------------------

    def advance(self, times: np.ndarray, first: int, recorder: Rows) -> None:
        """Take steps that end at `times`, from number `first` on.

        StepError if a step fails after all halvings, or if a function of time fails.
        """
        done, state = 0, self.loop.state
        while done < len(times):
            number, dt = equal_steps(state.t, times[done:], self.halving.dt)
            self._equal(times[done : done + number], dt, first + done, recorder)
            done += number

    def _equal(self, times: np.ndarray, dt: float, first: int, recorder: Rows) -> None:
        """Take steps of the length dt [s]."""
        loop, halving, t0 = self.loop, self.halving, self.loop.state.t
        inputs, done = loop.inputs_ahead(t0, times), 0
        while done < len(times):
            ends, part_inputs, parts = times[done:], inputs, halving.parts
            if halving.times:
                ends = halving.ends(np.append(t0, times)[done:])
                part_inputs = loop.inputs_ahead(loop.state.t, ends)
            steps = EqualSteps(ends, dt / parts, part_inputs, first + done, halving.done, parts)
            count = loop.take_steps(steps, recorder)
            steps_done = self._completed(count, recorder) if count else 0
            done += steps_done
            if count < part_inputs.steps:
                loop.state.past = None
                if not halving.fail():
                    raise self.error(halving.ends(np.append(t0, times)[done:])[0])
                self.stats.halvings += 1
            elif part_inputs.error is not None:
                raise part_inputs.error
            if done < len(times):
                inputs = inputs.after(steps_done)

    def _completed(self, count: int, recorder: Rows) -> int:
        """Number of whole steps that parts of steps complete, which are counted."""
        halving, times = self.halving, self.halving.times
        whole = halving.count_done(count)
        if halving.times != times:
            # Where steps fail, predictions from steps of another length lead astray.
            self.loop.state.past = None
        self.stats.steps += whole
        self.mark(recorder)
        return whole

    # -- Steps whose local errors are controlled --------------------------------------------------

    @contextmanager
    def unchanged(self) -> Iterator[None]:
        """In this block steps are tried, after which state and statistics are as before."""
        with self.loop.state.unchanged(), stats_unchanged(self.stats):
            yield

    def trial(
        self, state: State, t1: float, watch: bool = False, tape: Tape | None = None
    ) -> Trial:
        """One step to t1 [s] that is not part of the run; with `watch` also its switches."""
        loop, ends, recorder = self.loop, np.array([t1]), NullRecorder()
        recorder.tape = tape
        with self.unchanged():
            loop.state.load(state)
            inputs = loop.inputs_ahead(state.t, ends)
            steps = EqualSteps(ends, t1 - state.t, inputs, 1, watch=watch)
            count = loop.take_steps(steps, recorder)
            switches = loop.result(steps, count).switches
            return Trial(loop.state.read() if count else None, switches)

    def try_steps(
        self,
        ends: np.ndarray,
        dt: float,
        first: int,
        recorder: Rows,
        control: StepControl,
        watch: bool = False,
    ) -> StepsResult:
        """Take steps of the length dt from number `first` on, as long as this length is right.

        With `watch` only up to where a contact or a law switches.
        """
        inputs = self.loop.inputs_ahead(self.loop.state.t, ends)
        steps = EqualSteps(ends, dt, inputs, first, control=control, watch=watch)
        count = self.loop.take_steps(steps, recorder)
        if count:
            self.stats.steps += count
            self.mark(recorder)
        if inputs.error is not None and count == inputs.steps:
            raise inputs.error
        return self.loop.result(steps, count)

    # -- Errors -----------------------------------------------------------------------------------

    def error(self, end: float, advice: str = "") -> StepError:
        """StepError for a step to a time [s] that fails after all halvings."""
        start, halvings = self.loop.state.read(), self.halving.most
        failure = self.loop.failure(start, end)
        advice = advice or self._advice(failure)
        message = f"the step from t = {start.t:.6g} to {end:.6g} failed"
        error = self.loop.failures.error(message, halvings, start, failure, advice)
        error.__cause__ = failure
        return error

    def _advice(self, failure: StepFailed) -> str:
        if self.model.reduction.singularity:
            return (
                "Its velocity does not take it out of there. Let it not come to rest in this "
                "position, or let a member yield: a beam in place of a body"
            )
        if met := _met_circle(self.model, self.loop.state.arrays["q"]):
            return met
        if failure.kind == "off the end":
            return (
                "The steps before are kept. Use a longer beam, an earlier t_end, or a stop on the "
                "slide that turns the node back"
            )
        if failure.reason == OPEN and self.model.couplings.driven:
            return (
                "A motor or a driven motion may lead it past a position where bodies are in line "
                "(a toggle), which no dt passes: let it turn back before, or drive another joint. "
                "Else try a smaller dt"
            )
        advice = (
            f"Try a smaller dt{'' if self.halving.most else ' or max_halvings > 0'}. If this does "
            "not help, check the units of loads, velocities and stiffnesses, or try another scheme"
        )
        if failure.kind == "large rotation":
            advice += (
                ". A moment on a node with almost no inertia, as of a controller, turns it this "
                "far as well: add_mass(node, 0.0, inertia=...)"
            )
        return advice


def _met_circle(model: Model, q: np.ndarray) -> str:
    """Advice where a point of a rope comes to a circle at displacements (size,); else empty."""
    moved = np.append(q.reshape(-1, 3)[:, :2], [[0.0, 0.0]], axis=0)
    for rope in model.scene.forces_between:
        if not isinstance(rope, RopeOverPulleys):
            continue
        ways = floats(rope.apart) + np.diff(moved[[*rope.nodes]], axis=0)
        met = np.hypot(*ways.T) < (1 + _NEAR) * abs(floats(rope.steps))
        if met.any():
            i = int(np.argmax(met))
            return (
                f"{rope}: point {i} or {i + 1} comes into the circle of the other one, where the "
                "rope has no tangent. Keep it off, as by a contact with a Circle, or end before"
            )
    return ""


def equal_steps(t: float, times: np.ndarray, dt: float | None = None) -> tuple[int, float]:
    """Number of steps from t [s] on that have equal length, and this length [s].

    It is dt where they differ by the rounding of times only: so it is the same in all blocks.
    """
    first, last = float(times[0]) - t, float(times[-1])
    rounding = 4 * math.ulp(max(abs(t), abs(last))) + _SAME * first
    if is_known := dt is not None and abs(first - dt) <= rounding:
        first = dt
    number = len(times)
    if number > 1 and any_of(different := abs(times[1:] - times[:-1] - first) > rounding):
        number = 1 + int(np.argmax(different))
    return number, first if is_known else (float(times[number - 1]) - t) / number


# -- Load steps in C, one at a time: equilibria at rising load factors --------------------------


class StepSolution(NamedTuple):
    """A converged step."""

    #: Increment (size,) of displacements and rotations, and (free,) of the unknowns.
    D: np.ndarray
    y: np.ndarray
    #: Forces and couples (size,) of supports and joints [N, N m].
    r: np.ndarray
    #: Number of corrections, and why they ended: "increment" or "round-off".
    iterations: int
    ended_by: str
    #: D by the tangent at the start: the linear predictor.
    predicted: np.ndarray


class LoadLoop(CompiledLoop):
    """Takes steps of the load factor; the states of a model have it in place of time."""

    forcing: LoadForcing

    def __init__(self, forcing: LoadForcing, options: NewtonOptions, stats: Stats):
        super().__init__(forcing, options, stats)
        model = forcing.model
        free = model.reduction.free
        #: Holding forces (free,) on the unknowns, in addition to the forces of the model.
        self.hold, self._predicted = np.zeros(free), np.zeros(model.size)
        #: Weights (size,) of a viscous drag on increments; zero at points at which nothing acts.
        self.drag_weight = np.where(model.acted_on, model.units.nodes**-2.0, 0.0)
        diagonal_at = self.problem.storage.stored_at[model.masses.places.diagonal]
        self.problem.set(
            numbers={"viscous_weight": self.drag_weight},
            work={
                "statics": {"hold": self.hold, "diagonal_at": diagonal_at},
                "newton": {"predicted": self._predicted},
            },
        )
        self.problem.set_frame(forcing.turning)
        n, columns = model.size, model.reduction.columns
        sizes = {"D": n, "z": columns, "r": n, "tangent": self.problem.storage.entries}
        # Increments of nodes and columns, the residual at nodes, and the tangent, by C.
        self._results = [*self.problem.results(**sizes)]
        # A record of forces alone, for one step.
        self._one_row, self._row = self.problem.ffi.new("Record *"), np.zeros(1, np.int32)
        self._one_row.every = self._one_row.first = self._one_row.parts = self._one_row.forces = 1
        self._one_row.up_to_row = self.problem.ffi.from_buffer("int[]", self._row)
        # Dead forces at the end and their mean, and natural strains, for C.
        self._given_forces = [*self.problem.given()]
        #: The equations of load steps, which have the arrays of the loop.
        time, turning = forcing.time, forcing.turning
        self.equations = Equations(model, time, turning, forcing.natural, self.problem)

    @property
    def drag(self) -> float:
        """Drag [J] on increments, in all tangents and residuals of the loop and its equations."""
        return float(self.problem.c.work.statics.viscosity)

    @drag.setter
    def drag(self, drag: float) -> None:
        self.problem.set(work={"statics": {"viscosity": drag}})

    def record(self, state: State, recorder: Recorder) -> None:
        """Record a state in the next row of a recorder.

        Masses of a frame that turns have no rotary inertia in C.
        """
        super().record(state, recorder)
        if (frame := self.forcing.turning) is not None:
            rows, row = recorder.arrays, recorder.rows - 1
            spin = (self.model.masses.matrix - frame.mass) @ state.v
            rows["energies"][row, 0] += state.v @ spin / 2
            rows["momenta"][row] += sums_of(self.model, state.q[None], spin[None])[0]

    def balance(self, state: State, factor: float) -> Residual:
        """The equations in a state at a load factor, without holding forces."""
        self.equations.set_start(Interval(factor, factor), state)
        return self.equations.at_start(self.forcing.dead(factor))

    def step(self, state: State, interval: Interval) -> tuple[State, StepSolution]:
        """State at the end of a load step, and its increment; StepFailed if none is found."""
        p, length = self.problem.c, interval.length
        inputs = self._begin_step(state, interval, length)
        self.problem.library.fx_take_counts(p)  # those of the steps before
        self._one_row.rows = 0
        c_inputs, t = inputs.in_c(self.problem.ffi), self.forcing.time - length
        if not self._steps(1, t, length, c_inputs, self._one_row):
            raise self.failures.in_c(self.problem, state)
        ended_by = "round-off" if p.work.counts.by_round_off else "increment"
        D, z, r, _ = self._results
        y, predicted = z[: self.model.reduction.free].copy(), self._predicted.copy()
        step = StepSolution(D.copy(), y, r.copy(), p.work.newton.tried, ended_by, predicted)
        return self._taken(state, interval), step

    def finished(self, state: State, interval: Interval, y: np.ndarray, r: np.ndarray) -> State:
        """State at the end of a step whose increment and forces are known.

        No time passes for internal variables.
        """
        driven = self.forcing.positions(interval.end)
        inputs = self._begin_step(state, interval, 0.0)
        z = self.model.reduction.in_columns(y, driven - self.forcing.current(state))
        c_inputs, r = inputs.in_c(self.problem.ffi), np.ascontiguousarray(r)
        c_inputs.known, c_inputs.known_forces = map(
            self.problem.ffi.from_buffer, ("double[]",) * 2, (z, r)
        )
        self._one_row.rows = 0
        self._steps(1, self.forcing.time, 0.0, c_inputs, self._one_row)
        return self._taken(state, interval)

    def _begin_step(self, state: State, interval: Interval, length: float) -> StepInputs:
        """Begin in a state; the inputs of the step."""
        model, forcing, self._interval = self.model, self.forcing, interval
        self.state.load(state)
        model.forms.compiled_points.set_load(interval.end, length)
        force, mean_force, strains = self._given_forces
        force[:], mean_force[:] = map(forcing.dead, (interval.end, interval.time_at(0.5)))
        if model.masses.weight is not None:  # whose work is all of its potential energy
            mean_force -= model.masses.weight
        if (natural := forcing.natural(interval.end)) is not None:
            strains[:] = natural.ravel()
        t, followers = np.array([forcing.time]), model.points.followers
        follower_force = floats(followers.series(t, t)) if len(followers) else np.empty((1, 0))
        values = np.array([[model.forms.parameters.values] * 2])
        driven, none = floats(forcing.positions(interval.end))[None], np.empty((1, 0))
        return StepInputs(none, driven, follower_force, values, none, 1, ratio=interval.end)

    def interval(self, dt: float) -> Interval:
        """Load factors of the step that C takes."""
        return self._interval

    def _taken(self, state: State, interval: Interval) -> State:
        new = self.state.read().changed(t=interval.end)
        if (frame := self.forcing.turning) is not None:
            pushes = (end.t * frame.force(end.q) for end in (state, new))
            new.work += float(sum(pushes) / 2 @ self._results[0])
        return new

    def change_of_sizes(self, left: np.ndarray, right: np.ndarray) -> float:
        """Product of sizes: of a vector (size,), of the last tangent's entries, and `right`."""
        return float(abs(left) @ self.equations.change(right, sizes=True))

    # -- The last tangent -------------------------------------------------------------------------

    @property
    def singular(self) -> bool:
        """Whether it was singular, or nearly."""
        return self.problem.c.work.newton.raised < 0

    @property
    def values(self) -> np.ndarray:
        """Values of the last tangent, in the sparsity of the reduced matrix."""
        return self._results[3]

    def negative_eigenvalues(self) -> int | None:
        """Number of negative eigenvalues of a symmetric tangent; None if it is singular.

        By Sylvester's law of inertia: the pivots have their signs. The next step has its factors.
        """
        p = self.problem.c
        if p.work.newton.raised:
            return None
        if p.work.newton.old_factors and not self.problem.library.fx_renew_factors(p):
            return None
        if not p.tables.system.unknowns:
            return 0
        rows = p.work.factors.rows
        factors = array_at(self.problem.ffi, rows.factors, rows.start[p.tables.system.unknowns])
        diagonal = array_at(self.problem.ffi, rows.diagonal, p.tables.system.unknowns)
        return int((factors[diagonal] < 0).sum())
