"""The motion of a scene step by step, with inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from threading import RLock
from time import perf_counter
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, as_float, check_takes, is_number, positive, require
from fx_beam.laws.schemes import Scheme
from fx_beam.results.audit import Stats
from fx_beam.results.solution import Solution
from fx_beam.scene.outputs import Output, check_outputs
from fx_beam.scene.scene import Scene
from fx_beam.step.held_inputs import HeldInputs
from fx_beam.step.interrupts import ctrl_c_between_blocks, one_thread, uninterrupted
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record, Recorder

from .evaluation import solution_of
from .measurement import Grid, reading
from .open_motion import OpenMotion, Snapshot
from .options import MOST_STEPS, Options, check_scene
from .prepared import Prepared, state_of
from .surroundings import waiting_team

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
        The scene. If something is added to it later, `step` ends with an error.
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
        clock, self._alone = perf_counter(), RLock()
        check_scene(scene, "Motion")
        self._dt = positive(dt, "Motion: dt")
        options = Options.among(locals(), what="Motion", dt=self._dt, outputs=None)
        if options.record.times is not None:
            raise SceneError("Motion: a record at times is not possible; use Record(every=...)")
        if options.record.file is not None:
            raise SceneError("Motion: a record to a file is not possible; use simulate")
        outputs = {} if outputs is None else dict(outputs)
        check_outputs(scene, outputs, "Motion: outputs")
        self._arguments = {
            "scene": scene,
            "scheme": options.scheme,
            "dt": self._dt,
            "outputs": outputs,
            "record": record,
            "newton": newton,
            "max_halvings": max_halvings,
        }
        held = HeldInputs(scene)
        self._prepared = prepared = Prepared(held.scene, options, waiting_team(held.scene))
        if start is not None:
            state = state_of(prepared.model, start)
            held.resume(prepared.forcing, state, state.inputs)
        forces = any(output.quantity == "force" for output in outputs.values())
        self._open = OpenMotion(prepared, held, self._dt, record, forces)
        turns = prepared.turn_counter.removed
        self._readings = {
            name: reading(prepared.model, self._open.shown, turns, output)
            for name, output in outputs.items()
        }
        state = prepared.first_state(self._dt, start)
        self._open.begin(state, np.zeros(prepared.model.size), Grid(state.t, 0, self._dt))
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
        fits = is_number(t_end) and (as_float(t_end) - self.t) / self._dt <= MOST_STEPS
        wanted = f"a finite number, at most {MOST_STEPS:.0e} steps away"
        require(fits, "Motion.run: t_end", t_end, wanted)
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
        return self._prepared.model.to_nodes(self._settled.present.q + turns)

    @property
    @one_thread
    def v(self) -> np.ndarray:
        """Their rates, (n_node, 3) [m/s, rad/s]."""
        return self._prepared.model.to_nodes(self._settled.shown.v)

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
        recorder = Recorder(self._prepared.model, np.array([self.t]), Record())
        end = self._open.end()
        recorder.record(0, end)
        return solution_of(self._prepared.model, recorder, self.stats, lambda: end)

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
        return solution_of(self._prepared.model, recorder, self.stats, self._open.end)

    # -- Snapshots --------------------------------------------------------------------------------

    @one_thread
    def snapshot(self) -> Snapshot:
        """Everything that the next steps depend on, for `restore`; it can be pickled.

        Returns
        -------
        Snapshot
            The present state.
        """
        return self._open.snapshot()

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
