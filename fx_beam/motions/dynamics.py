"""Simulation of a scene over time: motions one after the other, and scenes that change."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.changes import Fuse, Latch, checked_changes, excess, is_over, output_of
from fx_beam.scene.functions import with_functions
from fx_beam.scene.outputs import Output, check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.model import data_of
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record

from .initial_state import end_of
from .motion_setup import Condition, MotionSetup, Options, check_scene, prepare
from .progress import attach_partial_result
from .run import Run
from .sweep_context import call_with_arrays, warn_of_equal_work

if TYPE_CHECKING:
    from fx_beam.step.tape import Tape


# -- Motions one after the other, each of which has the memory of the last if only numbers differ


def simulated(scene: Scene, options: Options, start: Solution | None = None) -> Solution:
    """The motion of a scene, from its reference configuration or the end of a solution."""
    run = begun(scene, options, start)
    return run.take_steps(run.solution)


class MotionSeries:
    """Motions of a response, one after the other, in the same memory if only numbers differ.

    With a `memory` [bytes] for tapes.
    """

    def __init__(self, memory: float):
        self._memory = memory
        #: The prepared scene of the last motion, and whether something may read that later.
        self.prepared: MotionSetup | None = None
        self.is_kept = False
        # What has the numbers of other scenes.
        self._alike: MotionSetup | None = None
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        self.tape: Tape | None = None

    def begun(
        self, scene: Scene, options: Options, start: Solution | None = None, old: Run | None = None
    ) -> Run:
        """A run that is to take its steps; it may overwrite the rows of an `old` one."""
        return begun(scene, options, start, self, old)

    def prepare(self, scene: Scene, options: Options) -> MotionSetup:
        """A prepared scene: the last one with other numbers, if the structure is the same."""
        last, self.prepared, reason = self.prepared, None, ""
        if last is not None:
            try:
                if self.is_kept:
                    last.model.structure.check(scene)
                elif not options.scheme.built_in:
                    raise OtherStructureError(
                        "the scheme has functions of your own, which may have changed"
                    )
                else:
                    last.restart(scene, options)
                    self.prepared = last
                    return last
            except OtherStructureError as other:
                reason = str(other)
        self._alike, self.is_kept = None, False
        self.prepared = new = prepare(scene, options, owned=True)
        new.stats.setup_reason = new.stats.setup_reason and (reason or new.stats.setup_reason)
        return new

    def alike(self, scene: Scene, options: Options) -> MotionSetup:
        """Prepared model of another scene of the structure of the last one, beside it."""
        assert self.prepared is not None
        if self._alike is not None:
            try:
                self._alike.restart(scene, options)
            except OtherStructureError:  # its joints may lie elsewhere
                self._alike = None
            else:
                return self._alike
        data_of(self.prepared.model, scene)  # which says how the structure differs
        self._alike = prepare(scene, options, owned=True)
        return self._alike

    def begin_tape(self, prepared: MotionSetup) -> None:
        """Have a tape for the run of what was prepared, if runs are taped."""
        problem = prepared.loop.problem
        if not self.tapes:
            self.tape = None
        elif self.tape is None or self.tape.problem is not problem:
            from fx_beam.step.tape import Tape

            self.tape = Tape(problem, self._memory)
        else:
            self.tape.clear()
        prepared.loop.tape = self.tape


def begun(
    scene: Scene,
    options: Options,
    start: Solution | None = None,
    series: MotionSeries | None = None,
    old: Run | None = None,
) -> Run:
    """A run that is to take its steps, alone or in a series."""
    clock = time.perf_counter()
    if start is not None or (old is not None and old.options is not options):
        old = None
    t0 = 0.0 if start is None else end_of(start).t
    plan = options.plan(t0, start is not None) if old is None else old.plan
    if options.until:
        check_outputs(scene, options.outputs or {}, f"{options.what}: outputs")
    call_with_arrays(scene)
    connected = with_functions(scene, options.inputs, f"{options.what}: inputs")
    warn_of_equal_work()
    prepared = (prepare if series is None else series.prepare)(connected, options)
    run = Run(prepared, scene, start, plan, series is not None, old)
    if series is not None:
        series.begin_tape(prepared)
    prepared.stats.setup_seconds = time.perf_counter() - clock
    return run


# -- Simulation of a scene over time; of one that changes from change to change, as one solution


# Changes that are so near to their limits when another one happens happen with it, as those of a
# symmetric scene: relative to the force, to the size of the scene, or 1 rad.
_TOGETHER = 1e-9
# Of a step, or of a thousandth of the time: what is left after the last change is no motion.
_NOTHING = 1e-6


class ChangingScene:
    """A scene with changes that are still to come, by names."""

    def __init__(self, scene: Scene, changes: Mapping[str, Latch | Fuse], options: Options):
        self._scene, self._options = scene, options
        self._until, self._outputs = options.until or {}, options.outputs or {}
        self._changes = checked_changes(scene, changes)
        for name in self._changes:
            if name in self._until or name in self._outputs:
                raise SceneError(
                    f"simulate: {name!r} in `changes` is a name in `until` or `outputs` as well. "
                    "Use two names"
                )
        record = options.record
        if not (record.motion and record.forces and record.times is None):
            raise SceneError(
                "simulate: `changes` need rows at the ends of steps, with motion and forces. Omit "
                "times, motion=False and forces=False in Record"
            )

    def motion(self, start: Solution | None) -> Solution:
        """The motion to its end, in parts between changes."""
        whole: Solution | None = None
        t_end, dt = self._options.t_end, self._options.dt
        while True:
            try:
                run = simulated(self._scene, self._options_of_part(), start)
            except BaseException as stop:
                if whole is not None:
                    last = getattr(stop, "solution", None)
                    stop.solution = whole if last is None else whole.then(last)  # type: ignore[attr-defined]
                raise
            name, t = run.stats.until, float(run.t[-1])
            happened = self._apply(run) if name in self._changes else []
            times = dict.fromkeys(happened, t)
            run.stats = replace(run.stats, until="" if happened else name, changes=times)
            whole = run if whole is None else whole.then(run)
            if not happened or t_end - t <= _NOTHING * (dt or 1e-3 * abs(t_end)):
                return whole
            start = run

    def _options_of_part(self) -> Options:
        """Options of the next part: the next change ends it as well."""
        conditions = {
            name: lambda t, y, name=name, change=change: excess(change, y[name])
            for name, change in self._changes.items()
        }
        needed = {name: output_of(change) for name, change in self._changes.items()}
        until = {**self._until, **conditions} or None
        outputs = {**self._outputs, **needed} if until else None
        return replace(self._options, until=until, outputs=outputs)

    def _apply(self, run: Solution) -> list[str]:
        """Change the scene as at the end of a part; names of the changes, that of the end first.

        What another change has held or taken away stays.
        """
        changes, applied = self._changes, list[str]()
        together = [n for n in changes if abs(self._relative_excess(run, changes[n])) < _TOGETHER]
        for name in dict.fromkeys([run.stats.until, *together]):
            if (done := self._changes.get(name)) is not None:
                if isinstance(done, Latch):
                    self._scene.lock(done.joint, done.coordinate)
                else:
                    self._scene.remove(done.joint)
                applied.append(name)
                left = self._changes.items()
                self._changes = {n: other for n, other in left if not is_over(other, done)}
        return applied

    def _relative_excess(self, run: Solution, change: Latch | Fuse) -> float:
        joint_motion = run.joint(change.joint)
        if isinstance(change, Fuse):
            return excess(change, joint_motion.force[-1]) / change.force
        slides = output_of(change).quantity == "slide"
        distance = excess(change, float((joint_motion.slide if slides else joint_motion.angle)[-1]))
        size = float(abs(run.X - run.X.mean(axis=0)).max()) or 1.0
        return distance / size if slides else distance


@attach_partial_result
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
    inputs: Mapping[str, object] | None = None,
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
        Time step [s]. The last step is shorter if `t_end` is no multiple of `dt`. With a tolerance
        `dt` is optional, the length that is tried first.
    tolerance : float, optional
        With a tolerance the steps are chosen such that errors of displacements are about as large
        as the tolerance times the size of the scene (1 m for a single node). No local error of a
        displacement or of a rotation [rad] is above half of the tolerance. The sum of errors over
        steps is limited as well, without vibrations that are too fast for the steps. For schemes of
        order 2 and 4; in sensitive motions errors grow with time.
    dt_max : float, optional
        Largest step with a tolerance [s]; by default a tenth of the whole time. A load that acts
        for a shorter time may be overlooked.
    breaks : sequence of float, optional
        Times at which loads or driven motions have a kink or a jump [s]. With a tolerance steps end
        at these times. At jumps that are not given steps become short; at such kinks order 4 loses
        accuracy.
    start : Solution, optional
        Solution whose end is the initial state; by default the reference configuration. From a
        static solution the scene starts deformed, with its initial velocities, at the time `t` of
        `static`; with a spin it continues to turn, without other velocities. From an earlier motion
        the simulation continues without interruption, including the work done so far and, for the
        same scheme and `dt`, the length of sub-steps. Loads, masses, supports, joints and members
        may have changed since. Members that stay are recognised by their names; new members begin
        in their reference shape with their initial velocities. Joints must be satisfied in this
        state. Velocities are projected by the mass onto those that new joints and supports allow,
        as in a plastic impact: `Energy.impact` is the lost energy. Energy that is added or removed
        with members is part of `Energy.work`.
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
        A function of time or a constant for each name of an `Input` of the scene; other inputs are
        zero. Use `Motion` to set inputs step by step.
    until : callable or dict, optional
        ``until(t, y)`` ends the motion before `t_end`, where this function of the time and of a
        dictionary of `outputs` changes its sign, or a condition such as ``y["x"] > 0.5`` becomes
        true. The last step ends there exactly, up to 1e-13 of its length, so that nothing is
        interpolated. A dict has several functions by names; `Stats.until` is the name of the
        function that ended the motion. A sign that changes twice within a step is not seen. Forces
        are means over steps or values at a level in them: here they are extrapolated to the end of
        the step, by the line through the last two.
    outputs : dict, optional
        Outputs that `until` needs: `Output` by names, as in `Motion`.
    changes : dict, optional
        Latches that close and joints that break, `Latch` and `Fuse` by names. At the time of each
        change, found as for `until`, a step ends, and the motion continues with the changed scene
        and new steps `dt`. `Stats.changes` has the times. The scene remains changed, as by
        `Scene.lock` and `Scene.remove`: a motion that starts from the solution continues with it.

    Returns
    -------
    Solution
        The motion at the times t0, t0 + dt, t0 + 2 dt, ..., t_end, from t0 = 0 or the end of
        `start`; with a tolerance at the ends of the steps. With `until` it may end before.

    Raises
    ------
    SceneError
        Before the first step, if the scene, the scheme or the time grid is invalid.
    StepError
        If a step fails. Its attribute `solution` has all steps before it.
    KeyboardInterrupt
        After Ctrl-C. The attribute `solution` has the steps so far, or is None before the first
        one; as the `start` of another call it continues the run. Any other exception has this
        attribute as well.

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
    check_scene(scene, "simulate")
    options = Options.among(locals())
    if changes is None:
        return simulated(scene, options, start)
    return ChangingScene(scene, changes, options).motion(start)
