"""The motion of a scene step by step, with inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from threading import RLock
from time import perf_counter
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, as_float, check_takes, is_number, positive, require
from fx_beam.laws.schemes import Scheme
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.outputs import Output, check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.step import full_turns
from fx_beam.step.held_inputs import HeldInputs
from fx_beam.step.interrupts import ctrl_c_between_blocks, one_thread, uninterrupted
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import NullRecorder, Record, Recorder, Rows
from fx_beam.step.single_steps import CompiledSingleSteps

from .evaluation import solution_of
from .grid import Grid, grid_from
from .measurement import FittedState, readings
from .options import MOST_STEPS, Options, check_scene
from .prepared import Prepared, state_of
from .surroundings import waiting_team

# Steps for whose rows room is made at once.
_ROWS = 1024


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Everything that the next steps of a motion depend on; made by `Motion.snapshot`.

    Parameters
    ----------
    t : float
        Its time [s].
    state : State
        The state, for internal use.
    step : (float, int)
        Time at the start of the count of steps [s], and their number.
    turns : (size,) float
        Full turns that are counted separately [rad].

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
    >>> arm = scene.add_beam([(0, 0), (1, 0)], section)
    >>> fb.Motion(scene, dt=0.1).snapshot().t
    0.0
    """

    t: float
    state: State
    step: tuple[float, int]
    turns: np.ndarray

    def check(self, model: Model, inputs: int) -> None:
        """Refuse the snapshot for another model.

        Parameters
        ----------
        model : Model
            The model of a motion.
        inputs : int
            Number of values of its inputs.

        Raises
        ------
        SceneError
            If nodes, joints, motors or inputs differ.
        """
        state = self.state
        given = 0 if state.inputs is None else len(state.inputs)
        theirs = len(state.q), len(state.slides), len(state.motors), given
        if theirs != (model.size, model.scene.joint_count, len(model.motors), inputs):
            raise SceneError(
                "Motion.restore: the snapshot is of another scene. Its nodes, joints, motors and "
                "inputs must be the same"
            )


class OpenMotion:
    """Takes steps of the length dt [s]. State, time, inputs and record agree after all interrupts.

    What changes several of them first says how it is completed or undone; `settle` does so. Steps
    that fail, and those in parts, are taken by the `Stepper`.
    """

    def __init__(self, prepared: Prepared, held: HeldInputs, dt: float, record: Record | None):
        self._prepared, self._dt, self._record = prepared, dt, record
        #: What completes or undoes what an interrupt may have broken off, and its arguments.
        self._pending: tuple[Callable[..., None], tuple] | None = None
        self.held = held
        #: What tries the steps, and has the present state.
        self._steps = CompiledSingleSteps(prepared.stepper.integrator, dt)
        #: The present state as it is shown.
        self.shown = FittedState(prepared.model, prepared.forcing, self)

    def begin(self, state: State, removed: np.ndarray, grid: Grid) -> None:
        """Begin to step and to record from a state, in which full turns are missing."""
        counter, model = self._prepared.turn_counter, self._prepared.model
        turns = counter.turns_of(state)
        state = counter.without(turns, state)
        counter.removed[:] = removed + turns
        #: Times of the ends of steps.
        self.grid = grid
        self._load(state, 0)
        self.shown.begin(state)
        #: The rows of the steps.
        self.recorder: Rows = NullRecorder()
        if self._record is not None:
            self.recorder = Recorder(model, np.array([state.t]), self._record)
            self.recorder.miss(counter.removed)
            self._prepared.stepper.integrator.record(state, self.recorder)
        #: Present time [s].
        self.t = grid(0)

    def _load(self, state: State, number: int) -> None:
        """Return to a state and the number of steps to it."""
        self._prepared.stepper.load(state)
        self._steps.load(state, number)
        #: Number of steps that the statistics have.
        self._counted = number
        #: While a step is taken in parts: the last state, and the number of steps to it.
        self._last: tuple[State, int] | None = None

    def settle(self) -> None:
        """Complete or undo what an interrupt has broken off."""
        if self._pending is not None:
            mend, arguments = self._pending
            mend(*arguments)  # which may be interrupted, and called again
            self._pending = None

    # -- Steps --------------------------------------------------------------------------------

    def step(self, inputs: Mapping[str, Any]) -> None:
        """Take a step with some new inputs."""
        if self._pending is not None:
            self.settle()
        held, number = self.held, self.number + 1
        checked, t0, t1 = held.checked(inputs), self.t, self.grid(number)
        if number >= self.recorder.planned:
            ends = self.grid(np.arange(number, number + _ROWS))
            self.recorder.plan(number, ends, last=False)
        self._pending = self._end_step, (number, t0, t1, held.values)
        self.shown.leave()
        held.set(checked)
        held.begin(t0, t1)
        self._take(number, t0, t1)
        self._end_step(number, t0, t1, {})
        self._pending = None
        if number % full_turns.STEPS == 0:
            self._count_turns()

    def _take(self, number: int, t0: float, t1: float) -> None:
        """Take a step from t0 to t1 [s]; one that fails, or is one of parts, by the stepper."""
        stepper = self._prepared.stepper
        if stepper.halving.times or not self._steps.take(number, t0, self.grid, self.recorder):
            self.count()
            start = self.state()
            self._last = start, number - 1
            end = stepper.advance(start, np.array([t1]), number, self.recorder)
            past, parts = stepper.integrator.state.past, stepper.halving.state
            self._last = replace(end, parts=parts, past=past), number

    def _end_step(self, number: int, t0: float, t1: float, inputs: Mapping[str, Any]) -> None:
        """End a step, whether it was taken or not; if not, with the inputs that it began with."""
        if self._last is not None:
            self._load(*self._last)
        done = self.number == number
        if done:
            self.held.arrive()
        else:
            self.held.set(inputs)
        self.t = t1 if done else t0
        self.recorder.truncate(1 + self.number // self.recorder.every)

    def _count_turns(self) -> None:
        """Count full turns separately, so that they do not add to rounding errors."""
        counter, state = self._prepared.turn_counter, self.state()
        turns = counter.turns_of(state)
        if turns.any():
            self.count()  # as C begins to count anew
            without = counter.without(turns, state), self.number
            self._pending = self._turn_back, (*without, counter.removed + turns)
            self.settle()

    def _turn_back(self, state: State, number: int, removed: np.ndarray) -> None:
        """Go on from the present state without its full turns; `removed` are all that miss."""
        self._prepared.turn_counter.removed[:] = removed
        self.recorder.miss(removed)
        self._load(state, number)

    def count(self) -> None:
        """Add what was counted to the statistics."""
        steps = self.number - self._counted
        self._prepared.stats.steps += steps
        self._steps.count(steps)
        self._counted += steps

    # -- The present state ----------------------------------------------------------------------

    @property
    def number(self) -> int:
        """Number of steps since `begin`."""
        return self._steps.completed

    @property
    def present(self) -> Any:
        """The present state: its arrays by the names in `State`, with the rates of steps."""
        return self._steps.now

    def state(self) -> State:
        """The same, with all on which the next step depends."""
        state = self._steps.state(self.grid(self.number))
        return replace(state, parts=self._prepared.stepper.halving.state)

    def end(self) -> State:
        """The same as it is shown, with its full turns."""
        self.settle()
        return self.holding(self._prepared.turn_counter.with_turns(self.shown.state()))

    def solution(self, stats: Stats) -> Solution:
        """The same as a solution of one row; C returns to the state of the steps after it."""
        end, loop = self.end(), self._prepared.stepper.integrator
        recorder = Recorder(self._prepared.model, np.array([end.t]), Record())
        self._pending = loop.state.restore, loop.state.copy()
        loop.record(end, recorder)
        self.settle()
        return solution_of(recorder, stats, lambda: end)

    def holding(self, state: State) -> State:
        """A state with the present inputs."""
        return state.changed(inputs=self.held.all, input_names=self.held.names)

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same scene."""
        self.settle()
        self.count()
        self._pending = self._return_to, (snapshot,)
        self.settle()

    def _return_to(self, snapshot: Snapshot) -> None:
        state = snapshot.state
        self._prepared.forcing.hold(state)
        self.held.resume(self._prepared.forcing, state)
        self.begin(state, snapshot.turns, Grid(*snapshot.step, self._dt))


Controller = Callable[[float, dict[str, Any]], Mapping[str, Any] | None]


class Motion:
    """The motion of a scene, one step at a time: inputs are set, outputs are measured.

    Inputs of the scene (`Input`) do not change within a step: forces and moments are constant, and
    prescribed motions and motors have a constant rate, from their position at the start of the step
    to that given for its end. Their work is in the energy balance. An input that is not given keeps
    its value; at the start it is zero, or that of the solution from which the motion starts.

    Functions of time in the scene are evaluated some steps ahead: quantities that depend on the
    motion must be inputs.

    A copied or unpickled motion continues from the same state, with a scene of its own; its record
    begins anew.

    After Ctrl-C, or another exception from a signal, the last step is either complete or not done:
    state, time, inputs and record agree, and the motion can continue.

    A motion is for one thread at a time: while a step or `run` lasts, another thread gets a
    RuntimeError.

    Parameters
    ----------
    scene : Scene
        The scene. If something is added to it later, or its gravity or a parameter is set, `step`
        ends with an error.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    dt : float
        Time step [s].
    outputs : dict, optional
        What `step` returns: `Output` by names.
    start : Solution, optional
        Solution whose end is the initial state, as in `simulate`; by default the reference
        configuration with the initial velocities of the scene.
    record : Record, optional
        What is recorded for `solution`; by default nothing.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_halvings : int
        How often a failing step is halved before `step` fails.

    Raises
    ------
    SceneError
        Before the first step, if the scene, an option or an output is invalid.
    RuntimeError
        On several processes, if PETSc is missing.

    Examples
    --------
    A cart that a controller brings to the position x = 1 m:

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0, rhoI=0.1)
    >>> cart = scene.add_beam([(0, 0), (1, 0)], section)
    >>> rail = scene.add_joint(fb.Prismatic(fb.GROUND, cart.start, axis=(1, 0)))
    >>> load = scene.add_force(cart.start, fb.Input("push", factor=(1, 0)))
    >>> outputs = {"x": fb.Output("slide", rail), "v": fb.Output("rate", rail)}
    >>> motion = fb.Motion(scene, dt=0.01, outputs=outputs)
    >>> motion.step({"push": 2.0})["v"] > 0
    True

    `run` calls a function of the time and the outputs before each step:

    >>> def controller(t, y):
    ...     return {"push": 4 * (1 - y["x"]) - 4 * y["v"]}
    >>> y = motion.run(4.0, controller)
    >>> round(y["x"], 2), round(motion.t, 6)
    (1.0, 4.0)
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme | None = None,
        *,
        dt: float,
        outputs: Mapping[str, Output] | None = None,
        start: Solution | None = None,
        record: Record | None = None,
        newton: NewtonOptions | None = None,
        max_halvings: int = 12,
    ):
        given = {name: of for name, of in locals().items() if name not in ("self", "start")}
        clock, self._alone = perf_counter(), RLock()
        check_scene(scene, "Motion")
        positive(dt, "Motion: dt")
        options = Options.among(locals(), what="Motion", outputs=None)
        self._dt = options.dt
        if options.record.times is not None:
            raise SceneError("Motion: a record at times is not possible; use Record(every=...)")
        if options.record.file is not None:
            raise SceneError("Motion: a record to a file is not possible; use simulate")
        outputs = {} if outputs is None else outputs
        check_outputs(scene, outputs, "Motion: outputs")
        outputs = dict(outputs)
        self._arguments = given | {"scheme": options.scheme, "dt": self._dt, "outputs": outputs}
        held = HeldInputs(scene)
        self._prepared = prepared = Prepared(held.scene, options, waiting_team(held.scene))
        if start is not None:
            state = state_of(prepared.model, start)
            held.resume(prepared.forcing, state)
        self._open = OpenMotion(prepared, held, self._dt, record)
        self._readings = readings(prepared, self._open.shown, outputs)
        state = prepared.first_state(self._dt, start)
        self._open.begin(state, np.zeros(prepared.model.size), grid_from(state.t, self._dt))
        prepared.stats.setup_seconds = perf_counter() - clock

    # -- Steps ------------------------------------------------------------------------------------

    @one_thread
    def step(self, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Take one step.

        Parameters
        ----------
        inputs : dict, optional
            Values of inputs by their names: forces [N] and moments [N m] in this step, positions of
            motors and driven motions [m or rad] at its end.

        Returns
        -------
        dict
            The outputs after the step.

        Raises
        ------
        SceneError
            For an input that is unknown, has the wrong size or is not finite, or if something was
            added to the scene since the motion was created. Nothing is changed.
        StepError
            If the step fails. The motion stays in the state before the step, with its inputs.
        """
        clock = perf_counter()
        self._open.step({} if inputs is None else inputs)
        outputs = {name: read() for name, read in self._readings.items()}
        self._prepared.stats.seconds += perf_counter() - clock
        return outputs

    @one_thread
    def run(self, t_end: float, controller: Controller | None = None) -> dict[str, Any]:
        """Take steps up to a time.

        Parameters
        ----------
        t_end : float
            Time at which or after which the last step ends [s].
        controller : callable, optional
            ``controller(t, outputs)`` is called before each step and returns inputs for `step`, or
            None to keep them.

        Returns
        -------
        dict
            The outputs at the end.

        Raises
        ------
        SceneError
            For a `t_end` that is not a number, or inputs that do not fit.
        StepError
            If a step fails. The motion stays in the state before it.
        KeyboardInterrupt
            After Ctrl-C. The motion stays in the state after the last step.
        """
        ok = is_number(t_end) and (as_float(t_end) - self.t) / self._dt <= MOST_STEPS
        expected = f"a finite number, at most {MOST_STEPS:.0e} steps away"
        require(ok, "Motion.run: t_end", t_end, expected)
        last = as_float(t_end) - 1e-6 * self._dt
        if controller is not None:
            check_takes(controller, "t, outputs", "Motion.run: controller")
        outputs = self.outputs
        with ctrl_c_between_blocks():
            motion = self._open
            while motion.t < last:
                with uninterrupted:  # what the controller remembers belongs to the step
                    inputs = None if controller is None else controller(motion.t, outputs)
                    outputs = self.step(inputs)
        return outputs

    # -- What is known ----------------------------------------------------------------------------

    @property
    def _settled(self) -> OpenMotion:
        """The motion after what an interrupt has broken off is completed or undone."""
        self._open.settle()
        return self._open

    @property
    @one_thread
    def t(self) -> float:
        """Present time [s]."""
        return self._settled.t

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self._dt

    @property
    @one_thread
    def q(self) -> np.ndarray:
        """Present displacements and rotations of the nodes, (n_node, 3) [m, rad]."""
        turns = self._prepared.turn_counter.removed
        return (self._settled.present.q + turns).reshape(-1, 3)

    @property
    @one_thread
    def v(self) -> np.ndarray:
        """Their rates, (n_node, 3) [m/s, rad/s]."""
        return np.array(self._settled.shown.value("v")).reshape(-1, 3)

    @property
    @one_thread
    def slides(self) -> np.ndarray:
        """Present slides of the joints, (joints,) [m]; NaN of those that were removed."""
        slides = self._settled.present.slides.copy()
        slides[self._prepared.model.removed_joints] = np.nan
        return slides

    @property
    @one_thread
    def inputs(self) -> dict[str, Any]:
        """Present values of the inputs: a number, or an array (2,) of an input without factor."""
        return {
            name: value.copy() if len(value) > 1 else float(value[0])
            for name, value in self._settled.held.values.items()
        }

    @property
    @one_thread
    def outputs(self) -> dict[str, Any]:
        """The outputs in the present state; forces are those of the last step, at first zero."""
        self._open.settle()
        return {name: read() for name, read in self._readings.items()}

    @property
    @one_thread
    def stats(self) -> Stats:
        """Statistics of all steps so far."""
        self._settled.count()
        return copy(self._prepared.stats)

    @property
    @one_thread
    def state(self) -> Solution:
        """The present state, a solution of one row: for `start`, `modes`, `linearise`, pictures."""
        return self._open.solution(self.stats)

    @one_thread
    def solution(self) -> Solution:
        """What was recorded since the start or since the last `restore`.

        Returns
        -------
        Solution
            The motion, as `simulate` gives it.

        Raises
        ------
        SceneError
            If nothing is recorded.
        """
        recorder = self._settled.recorder
        if not isinstance(recorder, Recorder):
            raise SceneError(
                "Motion.solution: nothing was recorded. Create the motion with record=fb.Record()"
            )
        # Its steps are those of its rows, and not those before the last `restore`.
        return solution_of(recorder, replace(self.stats, steps=self._open.number), self._open.end)

    # -- Snapshots --------------------------------------------------------------------------------

    @one_thread
    def snapshot(self) -> Snapshot:
        """Everything that the next steps depend on, for `restore`; it can be pickled.

        Returns
        -------
        Snapshot
            The present state.
        """
        motion, turns = self._settled, self._prepared.turn_counter.removed.copy()
        state = motion.holding(motion.shown.state())
        step = motion.grid.origin, motion.grid.first + motion.number
        return Snapshot(motion.t, state, step, turns)

    @one_thread
    def restore(self, snapshot: Snapshot) -> dict[str, Any]:
        """Return to a snapshot. The next steps are the same, to round-off; the record begins anew.

        Parameters
        ----------
        snapshot : Snapshot
            From this motion, or from one of an equal scene with the same `dt` and scheme.

        Returns
        -------
        dict
            The outputs.

        Raises
        ------
        SceneError
            For a snapshot of another scene.
        """
        require(isinstance(snapshot, Snapshot), "Motion.restore", snapshot, "a snapshot")
        snapshot.check(self._prepared.model, sum(self._open.held.widths.values()))
        self._open.restore(snapshot)
        return self.outputs

    def __reduce__(self):
        # The initial velocities of a scene that has changed need not fit its joints.
        return _rebuilt, (self._arguments | {"start": self.state}, self.snapshot())

    def __repr__(self):
        return (
            f"<Motion: {self._prepared.stats.scheme}, dt = {self._dt:g}, at t = {self.t:g}, inputs "
            f"{list(self._open.held.widths)}, outputs {list(self._readings)}>"
        )


def _rebuilt(arguments: dict[str, Any], snapshot: Snapshot) -> Motion:
    """A motion that was copied or pickled."""
    motion = Motion(**arguments)
    motion.restore(snapshot)
    return motion
