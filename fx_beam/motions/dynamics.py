"""Simulation of a scene over time."""

from __future__ import annotations

import functools
import logging
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError
from fx_beam.laws.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.changes import Fuse, Latch
from fx_beam.scene.inputs import values_at, with_functions
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene
from fx_beam.step.interrupts import ctrl_c_between_blocks, uninterrupted
from fx_beam.step.local_error import order_and_constant
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorded_histories import RecordedHistories
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.stepper import Stepper, equal_steps
from fx_beam.step.substeps import Halving
from fx_beam.validation import as_float, is_flag, is_number, positive, require

from .adaptive_run import AdaptiveRun
from .bend_check import warn_of_sharp_bends
from .changing_scene import ChangingScene
from .contact_check import warn_of_depth, warn_of_short_impacts
from .ending import Condition, Ending, checked_conditions
from .evaluation import solution_of
from .kept_setup import kept_setup
from .mpi_ranks import warn_of_equal_work
from .progress import attach, failure_of, keeping_steps, progress_bar
from .repeated_motion import RepeatedMotion
from .row_files import RowFiles
from .run_setup import MOST_STEPS, RunSetup, check_options, checked_scheme, end_of
from .step_warnings import warn_of_damping, warn_of_parts
from .tolerance import Tolerance

_log = logging.getLogger("fx_beam")

#: Steps times degrees of freedom between two updates of the progress bar and checks for Ctrl-C.
_BLOCK = 500_000
# The progress bar counts the time of the simulation.
_BAR = {"unit": "s", "bar_format": "{l_bar}{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}]"}
_IMPACTS = (
    "%s: losses at impacts (restitution below 1) change forces within a small part of a step of "
    "order 4. Errors are then far above a small tolerance, up to 70 times at 1e-4 and 1e-5. Use "
    "order=2 or dt_max"
)


@keeping_steps
def simulate(
    scene: Scene,
    scheme: Scheme | None = None,
    *,
    t_end: float,
    dt: float | None = None,
    tolerance: float | None = None,
    dt_max: float | None = None,
    breaks: Sequence[float] = (),
    start: Solution | None = None,
    newton: NewtonOptions | None = None,
    max_halvings: int = 12,
    record: Record | None = None,
    progress: bool | None = None,
    inputs: Mapping[str, Any] | None = None,
    until: Condition | Mapping[str, Condition] | None = None,
    outputs: Mapping[str, Output] | None = None,
    changes: Mapping[str, Latch | Fuse] | None = None,
) -> Solution:
    """Simulate the motion of a scene to `t_end`, from t = 0 or from the end of another solution.

    Parameters
    ----------
    scene : Scene
        The scene.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    t_end : float
        End of the simulation [s].
    dt : float
        Time step [s]. The last step is shorter where `t_end` is no multiple of it. With a
        tolerance it is the first length that is tried, and optional.
    tolerance : float, optional
        With a tolerance, the steps are chosen such that the errors of displacements over time are
        about as large, relative to the size of the scene (1 m for a single node). No local error of
        a displacement or of a rotation [rad] is above half of the tolerance. Smaller errors of
        displacements add up from step to step; those of vibrations that are too fast for the steps
        do not. It applies to schemes of order 2 and 4; where motions are sensitive, errors grow
        with time.
    dt_max : float, optional
        Largest step with a tolerance [s]; by default a tenth of the whole time. A load that acts
        for a shorter time may be overlooked.
    breaks : sequence of float, optional
        Times at which loads or driven motions have a kink or a jump [s]. With a tolerance steps end
        there. At other jumps steps become short; at kinks order 4 loses accuracy.
    start : Solution, optional
        Solution whose end is the initial state; by default the reference configuration. From a
        static solution the scene starts deformed, with its initial velocities, at the time `t` of
        `static`; with a spin it continues to turn, without other velocities. From an earlier
        motion the simulation continues without interruption, including the work done so far and,
        for the same scheme and `dt`, the length of sub-steps. Loads, masses, supports, joints and
        members may have changed since. Members that stay are known by their names; new ones begin
        in their reference shape with their initial velocities. Joints must be satisfied in this
        state. Velocities are projected by the mass onto what new joints and supports allow, as in
        a plastic impact: `Energy.impact` is what they lose. Energy that came or went with members
        is part of `Energy.work`.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_halvings : int
        How often a failing step is halved before the simulation fails; 0 for never. After
        successful sub-steps their length is doubled again.
    record : Record, optional
        What is recorded; by default everything of every step.
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal if the run takes longer than two
        seconds.
    inputs : dict, optional
        For names of inputs of the scene (`Input`) a function of time or a constant. The others are
        zero. Use `Motion` to set them step by step.
    until : callable or dict, optional
        ``until(t, y)`` ends the motion before `t_end`, where this function of the time and of a
        dictionary of `outputs` changes its sign, or a condition such as ``y["x"] > 0.5`` becomes
        true. The last step ends there exactly, up to 1e-13 of its length, so that nothing is
        interpolated. It may be some functions by their names; `Stats.until` is the name of the
        one that ended the motion. What changes twice within a step is not seen. Forces are means
        over the step that ends there.
    outputs : dict, optional
        What `until` needs: `Output` by names, as in `Motion`.
    changes : dict, optional
        Latches that close and joints that break, `Latch` and `Fuse` by names. At the time of each
        one, found as for `until`, a step ends, and the motion goes on with the changed scene, by
        steps `dt` from there. `Stats.changes` has the times. The scene stays changed, as by
        `Scene.lock` and `Scene.remove`: a motion that starts from the solution goes on with it.

    Returns
    -------
    Solution
        The motion at the times t0, t0 + dt, t0 + 2 dt, ..., t_end, from t0 = 0 or the end of
        `start`; with a tolerance at the ends of the steps. With `until` it may end before.

    Raises
    ------
    SceneError
        Before the first step, if the scene, the scheme or the time grid is invalid.
    RuntimeError
        On several processes, if PETSc is missing.
    StepError
        If a step fails. Its attribute `solution` has all steps before it.
    KeyboardInterrupt
        After Ctrl-C. Its attribute `solution` has the steps so far, or is None before the first
        one; as the `start` of another call it continues the run. Every other exception, such as
        one from a signal handler, has `solution` as well.

    Examples
    --------
    A pendulum of a stiff massless bar and a mass, released from rest.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4))
    >>> scene.pin(bar.start)
    >>> mass = scene.add_mass(bar.end, 2.0)
    >>> solution = fb.simulate(scene, dt=0.01, t_end=0.3)
    >>> round(float(solution.displacement(bar.end)[-1, 1]), 2)
    -0.42

    The same with adaptive steps.

    >>> solution = fb.simulate(scene, t_end=0.3, tolerance=1e-3)
    >>> round(float(solution.displacement(bar.end)[-1, 1]), 2), len(solution.t) < 30
    (-0.42, True)

    Until it hangs downwards.

    >>> outputs = {"angle": fb.Output("rotation", bar.start)}
    >>> down = lambda t, y: y["angle"] + 3.141592653589793 / 2
    >>> solution = fb.simulate(scene, dt=0.01, t_end=2.0, until=down, outputs=outputs)
    >>> print(f"{solution.displacement(bar.end)[-1, 0]:.9f}", solution.stats.until)
    -1.000000000 until
    """
    kept = kept_setup()
    options = scheme, t_end, dt, newton, max_halvings, record, progress
    others = start, tolerance, dt_max, inputs, until, outputs, changes
    plain = all(other is None for other in others) and type(breaks) is tuple and not breaks
    again = kept.repeated if plain and isinstance(scene, Scene) else None
    if again is not None and again.serves(options):
        found = again.of(scene, kept)
        if found is not None:
            if record is None or record.motion:
                _warn_of_places(found, scene)
            return found
    scheme = checked_scheme(scene, scheme, "simulate")
    check_options("simulate", newton, max_halvings, record)
    conditions = checked_conditions(scene, until, outputs)
    to_file = record is not None and record.file is not None
    if to_file and (conditions or changes is not None):
        raise SceneError("simulate: a Record with a file is not possible with until or changes")
    if changes is not None:
        part = functools.partial(
            simulate,
            scene,
            scheme,
            t_end=t_end,
            dt=dt,
            tolerance=tolerance,
            dt_max=dt_max,
            breaks=breaks,
            newton=newton,
            max_halvings=max_halvings,
            record=record,
            progress=progress,
            inputs=inputs,
        )
        changing = ChangingScene(scene, changes, conditions, outputs or {}, record)
        return changing.motion(part, start, t_end, dt)
    fits = progress is None or is_flag(progress)
    require(fits, "simulate: progress", progress, "True, False or None")
    scene, named = with_functions(scene, inputs, "simulate: inputs"), scene
    t0 = 0.0 if start is None else end_of(start).t
    control, times = None, np.array([t0])
    if tolerance is None:
        times = _time_grid(dt, t_end, t0, start is not None)
        without = isinstance(breaks, tuple | list) and not breaks
        for name, value, fits in (("dt_max", dt_max, dt_max is None), ("breaks", breaks, without)):
            require(fits, f"simulate: {name}", value, "given with a tolerance only")
    else:
        control = Tolerance(tolerance, dt, dt_max, breaks, (t0, t_end))
        order_and_constant(scheme)  # refuses a scheme whose local errors are not known

    t_end, dt = as_float(t_end), None if dt is None else as_float(dt)
    if record is not None and record.times is not None:
        fits = record.times[-1] >= t0 and record.times[0] <= t_end
        wanted = f"in part within the run, from {t0:g} to {t_end:g} s"
        require(fits, "simulate: the record's times", record.times, wanted)
    warn_of_equal_work()
    clock = time.perf_counter()
    halving = Halving(max_halvings, dt if control is None else None)
    setup = kept.of(scene, scheme, newton, halving)
    stats, stepper, counter = setup.stats, setup.stepper, setup.turn_counter
    record = record or Record()
    recorder = Recorder(setup.model, times[:1] if to_file else times, record)
    files = RowFiles(setup, recorder, record.file) if record.file is not None else None
    rows_at = None if record.times is None else np.array(record.times, float)
    first = float(times[1] - times[0]) if control is None else control.first
    places_known = record.motion and files is None
    late = start is None and setup.model.finds_accelerations_later
    asked = control is not None or (record.rates and not late)
    state = setup.first_state(first, start, control is None, accelerations=asked)
    if record.rates and not asked:
        recorder.late_accelerations = setup.late_accelerations(state, first)
    stepper.integrator.record_start(state, recorder)
    kept.begin(setup)
    stats.setup_seconds, stats.setup_reason = time.perf_counter() - clock, kept.reason
    stats.file = "" if files is None else str(record.file)
    if control is not None and order_and_constant(scheme)[0] > 2 and setup.model.loses_at_impacts:
        _log.warning(_IMPACTS, stats.scheme)

    def of_rows(rows: RecordedHistories | None) -> Solution:
        stats.seconds = time.perf_counter() - clock
        held = values_at(named, inputs, recorder.end.t)

        def end() -> State:
            state = counter.with_turns(recorder.end)
            past = stepper.integrator.past
            return state.changed(parts=halving.memory, past=past, inputs=held)

        return solution_of(
            setup.model,
            recorder,
            stats,
            end,
            rows_at,
            [*breaks, *events],
            ended=True,
            scene_stays=kept.reads_at_once,
            kept=rows,
        )

    def solution() -> Solution:
        if files is not None:
            files.take()
            files.save(of_rows, always=True)
        solution = of_rows(None if files is None else files.histories())
        kept.keep(setup, solution)
        return solution

    clock, events = time.perf_counter(), list[float]()
    try:
        if control is None:
            marched = _steps_of_grid(stepper, times, recorder, 1 if conditions else 1000)
        else:
            run = AdaptiveRun(stepper, recorder, control, single=bool(conditions))
            marched, events = run.advance, run.events
        ending, march = None, marched
        if conditions:
            ending = Ending(setup, recorder, conditions, outputs or {})
            kinks = [*breaks, t0]

            def march(state: State) -> None:
                ending.advance(marched, kinks + events)

        with progress_bar(t_end - t0, progress, **_BAR) as bar, ctrl_c_between_blocks():
            while recorder.end.t < t_end and not stats.until:
                t, turns = recorder.end.t, counter.turns_of(recorder.end)
                if turns.any():
                    with uninterrupted:
                        recorder.end = counter.without(turns, recorder.end)
                        counter.removed += turns
                        recorder.turns[recorder.rows] = counter.removed.copy()
                march(recorder.end)
                if files is not None:
                    files.take()
                    files.save(of_rows)
                stats.until = "" if ending is None else ending.met
                bar.update(recorder.end.t - t)
        if control is None:
            warn_of_parts(stats, first)
        warn_of_damping(stats, first if control is None else None)
        found = solution()
        if places_known:
            _warn_of_places(found, scene)
        if plain and kept.lasts and _repeats(setup, times, record, progress):
            most = halving.most
            kept.repeated = RepeatedMotion(options, times, record, recorder, most)
        return found
    except BaseException as error:
        recorder.settle_at_end()
        stats.failure = failure_of(error, recorder.end.t)
        attach(error, solution)
        if places_known and isinstance(error, StepError):
            warn_of_sharp_bends(error.solution, motion=True)
        raise


def _repeats(setup: RunSetup, times: np.ndarray, record: Record, progress: bool | None) -> bool:
    """Whether a motion took equal steps, all compiled and at once, and nothing else was asked."""
    steps, compiled = len(times) - 1, isinstance(setup.stepper.integrator, CompiledLoop)
    fits = compiled and not setup.stats.halvings and steps <= _most_steps(setup.model)
    asked = progress or record.times is not None or record.file is not None
    return fits and not asked and equal_steps(times[0], times[1:]) == steps


def _most_steps(model: Model, most: int = 1000) -> int:
    """Number of steps that are taken at once."""
    return max(1, min(most, _BLOCK // model.size))


def _steps_of_grid(stepper: Stepper, times: np.ndarray, recorder: Recorder, most: int):
    """A function that takes the next block of steps of a grid."""
    steps = _most_steps(recorder.model, most)
    starts = iter(range(1, len(times), steps))

    def advance(state: State) -> None:
        first = next(starts)
        ends = times[first : first + steps]
        if recorder.planned < first + len(ends):
            recorder.plan(first, ends, last=first + len(ends) == len(times))
        stepper.march(state, ends, first, recorder)

    return advance


def _warn_of_places(found: Solution, scene: Scene) -> None:
    """Warn of contact where its forces say little."""
    warn_of_depth(found, motion=True)
    warn_of_short_impacts(found, scene.joints)
    warn_of_sharp_bends(found, motion=True)


def _time_grid(dt: float | None, t_end: float, t0: float, goes_on: bool) -> np.ndarray:
    """Ends of steps; a motion that goes on may end with a part of a step, as events do."""
    choice = ", or give a tolerance, which chooses the steps" if dt is None else ""
    dt = positive(dt, "dt", f"a positive number{choice}")
    require(is_number(t_end), "t_end", t_end, "a finite number")
    t_end = as_float(t_end)
    if t_end - t0 < dt * (1e-6 if goes_on else 1 - 1e-6):
        least = f"after the start at t = {t0:g}" if goes_on else f"at least one step dt = {dt!r}"
        raise SceneError(f"t_end = {t_end!r} must be {least}")
    if (t_end - t0) / dt > MOST_STEPS:
        raise SceneError(
            f"dt = {dt!r}: {(t_end - t0) / dt:.3g} steps to t_end = {t_end!r} are more than the "
            f"largest number, {MOST_STEPS:.0e}. Try a larger dt"
        )
    # A remainder below 1e-6 steps is a rounding error of t_end / dt, not a step.
    steps = math.ceil((t_end - t0) / dt - 1e-6)
    times = t0 + dt * np.arange(steps + 1)
    times[-1] = t_end
    return times
