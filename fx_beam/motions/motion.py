"""The motion of a scene step by step, with inputs and outputs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from threading import RLock
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError, as_float, check_takes, is_number, positive, require, vector
from fx_beam.laws.schemes import Scheme
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Node
from fx_beam.scene.loads import check_node
from fx_beam.scene.outputs import Output, check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.step import full_turns
from fx_beam.step.interrupts import Method, ctrl_c_waits, one_thread
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Mark, NullRecorder, Record, Recorder, Rows
from fx_beam.step.step_inputs import HeldInputs, SingleInputs

from . import motion_setup
from .contact_check import check_on_pulleys
from .evaluation import solution_of
from .measurement import Instant, fitted_state, fitted_value, readings, rope_reading
from .motion_setup import MOST_STEPS, MotionSetup, Options, TimeGrid, grid_from, prepare, state_of

# Steps for whose rows room is made at once.
_ROWS = 1024


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Everything that the next steps of a motion depend on; made by `Motion.snapshot`.

    Parameters
    ----------
    t : float
        Time of the snapshot [s].
    state : State
        The state, for internal use.
    step : (float, int)
        Time from which steps are counted [s], and number of steps since then.
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

    def check_model(self, model: Model, inputs: int) -> None:
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
        input_count = 0 if state.inputs is None else len(state.inputs)
        sizes = len(state.q), len(state.slides), len(state.motors), input_count
        if sizes != (model.size, model.scene.joint_count, len(model.data.motors), inputs):
            raise SceneError(
                "Motion.restore: the snapshot is of another scene. Its nodes, joints, motors and "
                "inputs must be the same"
            )


class _Present(NamedTuple):
    """The end of a step of a motion; no further step changes it."""

    #: Times of the ends of steps since the motion began or was restored, and their rows.
    grid: TimeGrid
    recorder: Rows
    #: Number of all steps before them, and of the steps on the grid.
    before: int
    number: int
    mark: Mark
    #: Values of inputs by name.
    inputs: dict[str, np.ndarray]
    #: Where the last step starts and ends, if rates are fitted.
    start: Instant | None = None
    end: Instant | None = None


class OpenMotion:
    """Takes steps of the length dt [s].

    A step changes the state in C, inputs and record; then one assignment makes it the present one.
    After an interrupt before that, `settle` returns to the present one.
    """

    #: The end of the last step.
    now: _Present

    def __init__(self, prepared: MotionSetup, inputs: HeldInputs, dt: float, record: Record | None):
        self._prepared, self._dt, self._record = prepared, dt, record
        self.held = inputs
        self._loop, self._stepper = prepared.loop, prepared.stepper
        self._inputs = SingleInputs(self._loop.problem, prepared.forcing)
        #: Dead forces (size,) of the step beside those of the scene, which C reads.
        self._pushes: np.ndarray | None = None
        #: Whether state, inputs and record are those of the present step.
        self._settled = False
        #: Arrays of the state in C by name.
        self.arrays = self._loop.state.arrays.__getitem__
        ropes = [line for line in prepared.model.scene.forces_between if line.has_pulleys]
        # Ropes over pulleys, with functions that read their angles and force.
        self._ropes = [(rope, rope_reading(prepared, self.arrays, rope)) for rope in ropes]

    def start_stepping(self, state: State, removed: np.ndarray, grid: TimeGrid) -> None:
        """Begin to step and to record from a state, in which full turns are missing."""
        prepared = self._prepared
        recorder: Rows = NullRecorder()
        if self._record is not None:
            recorder = Recorder(prepared.model, np.array([state.t]), self._record)
        counter = prepared.turn_counter
        turns = counter.turns_of(state.q)
        counter.removed = removed + turns
        recorder.miss(counter.removed)
        state = counter.without(turns, state)
        self._stepper.load(state)
        self._stepper.begin_rows(state, recorder)
        recorder.plan(1, grid(np.arange(1, 1 + _ROWS)), last=False)
        self._inputs.start_grid(grid)
        self._loop.inputs_ahead = self._inputs.ahead
        mark, end = recorder.end, None
        if prepared.model.fits_rates:
            arrays = self._loop.state.arrays_of(mark.state)
            end = Instant(prepared.forcing, mark.t, -self._dt, arrays, state.driven_rates)
        before, inputs = prepared.stats.steps, self.held.values
        self.now = _Present(grid, recorder, before, 0, mark, inputs, end=end)
        self._settled = True

    def settle(self) -> None:
        """Undo what an interrupt or an error has left of a step that was not taken."""
        if self._settled:
            return
        self._push(None)
        present = self.now
        self._stepper.return_to(present.mark, present.recorder)
        self._prepared.forcing.hold(self._loop.state.read())
        self.held.set(present.inputs)
        self.held.arrive()
        self._inputs.start_grid(present.grid)
        self._settled = True

    # -- Steps --------------------------------------------------------------------------------

    def step(self, inputs: Mapping[str, object], pushes: np.ndarray | None = None) -> None:
        """Take a step with some new inputs, and dead forces (size,) beside those of the scene."""
        self.settle()
        now = self.now
        grid, recorder, number, start = now.grid, now.recorder, now.number + 1, now.end
        checked, t1 = self.held.checked(inputs), grid(number)
        if number >= recorder.grid.planned:
            recorder.plan(number, grid(np.arange(number, number + _ROWS)), last=False)
        self._settled = False
        self.held.set(checked)
        self.held.set_times(now.mark.t, t1)
        self._inputs.next(number, now.mark.t, t1)
        if pushes is not None:
            self._push(pushes)
        self._stepper.advance(np.array([t1]), number, recorder)
        if pushes is not None:
            self._push(None)
        for rope, read in self._ropes:
            check_on_pulleys(rope, np.array([t1]), *read())
        self.held.arrive()
        mark, end = recorder.end, None
        if start is not None:
            arrays = self._loop.state.arrays_of(mark.state)
            end = Instant(self._prepared.forcing, t1, self._dt, arrays, start=start)
        values = self.held.values
        self.now = _Present(grid, recorder, now.before, number, mark, values, start, end)
        if number % full_turns.STEPS == 0:
            self._stepper.count_turns(recorder)
            self.now = self.now._replace(mark=recorder.end)
        self._settled = True

    def _push(self, pushes: np.ndarray | None) -> None:
        problem, self._pushes = self._loop.problem, pushes
        memory = problem.ffi.NULL if pushes is None else problem.ffi.from_buffer("double[]", pushes)
        problem.c.work.pushes = memory

    def count(self) -> None:
        """Add what was counted to the statistics."""
        self._prepared.stats.steps = self.now.before + self.now.number
        self._loop.count()

    # -- The present state ----------------------------------------------------------------------

    def value(self, name: str) -> Any:
        """An array of `State` as it is shown, with rates that fit the joints."""
        return fitted_value(name, self.arrays, self.now.start, self.now.end)

    def last_row(self) -> tuple[_Present, Rows, np.ndarray]:
        """Identity of the state, its record, and its accelerations (size,)."""
        return self.now, self.now.recorder, self.value("a")

    def shown(self) -> State:
        """Present state as it is shown, with the present inputs."""
        self.settle()
        state = fitted_state(self._stepper.state(), self.now.start, self.now.end)
        return state.changed(inputs=self.held.all, input_names=self.held.names)

    def end(self) -> State:
        """Present state with its full turns."""
        return self._prepared.turn_counter.with_turns(self.shown())

    def solution(self, stats: Stats) -> Solution:
        """Present state as a solution of one row."""
        end = self.end()
        recorder = Recorder(self._prepared.model, np.array([end.t]), Record())
        self._settled = False
        self._loop.record(end, recorder)
        return solution_of(recorder, stats, lambda: end)

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same scene."""
        self.settle()
        self.count()
        self._settled, forcing = False, self._prepared.forcing
        forcing.hold(snapshot.state)
        self.held.resume(forcing, snapshot.state)
        self.start_stepping(snapshot.state, snapshot.turns, TimeGrid(*snapshot.step, self._dt))


def one_motion(method: Method) -> Method:
    """A method for one thread; meanwhile no other one reads solutions of the motion."""

    @functools.wraps(method)
    def alone(self: Motion, *arguments, **options):
        with self._prepared.model.lock:
            return method(self, *arguments, **options)

    return one_thread(alone)  # type: ignore[return-value]


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
        Outputs that `step` returns: `Output` by names.
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

    Examples
    --------
    A cart that a controller brings to the position x = 1 m:

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0, rhoI=0.1)
    >>> cart = scene.add_beam([(0, 0), (1, 0)], section, elements=1)
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
        passed = {name: x for name, x in locals().items() if name not in ("self", "start")}
        clock, self._alone = perf_counter(), RLock()
        motion_setup.check_scene(scene, "Motion")
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
        self._arguments = passed | {"scheme": options.scheme, "dt": self._dt, "outputs": outputs}
        held_inputs = HeldInputs(scene)
        self._prepared = prepared = prepare(held_inputs.scene, options)
        if start is not None:
            state = state_of(prepared.model, start)
            held_inputs.resume(prepared.forcing, state)
        self._open = OpenMotion(prepared, held_inputs, self._dt, record)
        every = record is not None and record.rates and record.every == 1
        last_row = self._open.last_row if every else None
        self._readings = readings(prepared, self._open.value, outputs, last_row)
        state = prepared.first_state(self._dt, start)
        self._open.start_stepping(
            state, np.zeros(prepared.model.size), grid_from(state.t, self._dt)
        )
        prepared.stats.setup_seconds = perf_counter() - clock

    # -- Steps ------------------------------------------------------------------------------------

    @one_motion
    def step(
        self,
        inputs: Mapping[str, Any] | None = None,
        forces: Mapping[Node, Sequence[float]] | None = None,
    ) -> dict[str, Any]:
        """Take one step.

        Parameters
        ----------
        inputs : dict, optional
            Values of inputs by their names: forces [N] and moments [N m] in this step, positions of
            motors and driven motions [m or rad] at its end.
        forces : dict, optional
            Additional forces (fx, fy) [N] by nodes, which act in this step only.

        Returns
        -------
        dict
            The outputs after the step.

        Raises
        ------
        SceneError
            For an input that is unknown; for an input or a force that has the wrong size or is not
            finite; for a node of another scene; or if something was added to the scene since the
            motion was created. The motion is then unchanged.
        StepError
            If the step fails. The motion stays in the state before the step, with its inputs.
        """
        clock = perf_counter()
        inputs = {} if inputs is None else inputs
        if forces:
            self._open.held.checked(inputs)  # the nodes are those of the start
            self._open.step(inputs, self._on_nodes(forces))
        else:
            self._open.step(inputs)
        outputs = {name: read() for name, read in self._readings.items()}
        self._prepared.stats.seconds += perf_counter() - clock
        return outputs

    def _on_nodes(self, forces: Mapping[Node, Sequence[float]]) -> np.ndarray:
        """Dead forces (size,) by nodes [N]."""
        expected = "a dictionary of forces (fx, fy) by nodes"
        require(isinstance(forces, Mapping), "forces", forces, expected)
        dead = np.zeros((len(self._prepared.model.mesh.X), 3))
        for node, force in forces.items():
            check_node(self.scene, node, "forces")
            dead[node.number, :2] += vector(force, 2, f"force on {node}")
        return dead.reshape(-1)

    @one_motion
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
        with ctrl_c_waits() as whole:
            motion = self._open
            while (t := motion.now.mark.t) < last:
                with whole:  # what the controller remembers belongs to the step
                    inputs = None if controller is None else controller(t, outputs)
                    outputs = self.step(inputs)
        return outputs

    # -- What is known ----------------------------------------------------------------------------

    @property
    def _settled(self) -> OpenMotion:
        """The motion without what an interrupt has left of a step."""
        self._open.settle()
        return self._open

    @property
    @one_motion
    def t(self) -> float:
        """Present time [s]."""
        return self._open.now.mark.t

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self._dt

    @property
    @one_motion
    def q(self) -> np.ndarray:
        """Present displacements and rotations of the nodes, (n_node, 3) [m, rad]."""
        motion = self._settled
        return (motion.arrays("q") + motion.now.mark.turns).reshape(-1, 3)

    @property
    @one_motion
    def v(self) -> np.ndarray:
        """Present velocities and spins of the nodes, (n_node, 3) [m/s, rad/s]."""
        return np.array(self._settled.value("v")).reshape(-1, 3)

    @property
    @one_motion
    def slides(self) -> np.ndarray:
        """Present slides of the joints, (joints,) [m]; NaN of those that were removed."""
        slides = self._settled.arrays("slides").copy()
        slides[self._prepared.model.couplings.missing] = np.nan
        return slides

    @property
    def scene(self) -> Scene:
        """The scene of the motion."""
        scene: Scene = self._arguments["scene"]
        return scene

    @property
    @one_motion
    def inputs(self) -> dict[str, Any]:
        """Present values of the inputs: a number, or an array (2,) of an input without factor."""
        return {
            name: value.copy() if len(value) > 1 else float(value[0])
            for name, value in self._open.now.inputs.items()
        }

    @property
    @one_motion
    def outputs(self) -> dict[str, Any]:
        """The outputs in the present state; forces are those of the last step, at first zero."""
        self._open.settle()
        return {name: read() for name, read in self._readings.items()}

    @property
    @one_motion
    def stats(self) -> Stats:
        """Statistics of all steps so far."""
        self._settled.count()
        return copy(self._prepared.stats)

    @property
    @one_motion
    def state(self) -> Solution:
        """The present state, a solution of one row: for `start`, `modes`, `linearise`, pictures."""
        return self._open.solution(self.stats)

    @one_motion
    def solution(self) -> Solution:
        """Motion that was recorded since the start or since the last `restore`.

        Returns
        -------
        Solution
            The motion, as `simulate` gives it.

        Raises
        ------
        SceneError
            If nothing is recorded.
        """
        recorder = self._settled.now.recorder
        if not isinstance(recorder, Recorder):
            raise SceneError(
                "Motion.solution: nothing was recorded. Create the motion with record=fb.Record()"
            )
        # Its steps are those of its rows, and not those before the last `restore`.
        stats = replace(self.stats, steps=self._open.now.number)
        return solution_of(recorder, stats, self._open.end)

    # -- Snapshots --------------------------------------------------------------------------------

    @one_motion
    def snapshot(self) -> Snapshot:
        """Everything that the next steps depend on, for `restore`; it can be pickled.

        Returns
        -------
        Snapshot
            The present state.
        """
        state, present = self._open.shown(), self._open.now
        step = present.grid.origin, present.grid.first + present.number
        return Snapshot(present.mark.t, state, step, present.mark.turns)

    @one_motion
    def restore(self, snapshot: Snapshot) -> dict[str, Any]:
        """Return to a snapshot. The next steps are the same, to round-off; the record begins anew.

        Parameters
        ----------
        snapshot : Snapshot
            A snapshot of this motion, or of a motion of an equal scene with the same `dt` and
            scheme.

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
        snapshot.check_model(self._prepared.model, sum(self._open.held.widths.values()))
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
