"""Steps in Python, on PETSc: the reference, and the way out where the compiled loop fails."""

from __future__ import annotations

import numpy as np

from .audit import Stats
from .beam import COMPONENTS
from .errors import SceneError, StepError
from .initial import acceleration_of, initial_rates
from .joints import GROUND
from .model import JointForces, Model
from .newton import Newton, StepFailed, StepSolution
from .recorder import Recorder
from .state import State
from .values import evaluate


class Stepper:
    """Takes a model from time to time.

    Parameters
    ----------
    model : Model
        The compiled scene.
    newton : Newton
        Solver for one step.
    stats : Stats
        Counts what is done.
    max_halvings : int
        How often a failing step may be halved before it is given up.
    """

    def __init__(self, model: Model, newton: Newton, stats: Stats, max_halvings: int):
        self.model = model
        self.newton = newton
        self.stats = stats
        self.max_halvings = max_halvings
        scene = model.scene
        self.joint_forces = JointForces(model) if scene.joints else None
        self._driven = [
            (function, f"prescribed {COMPONENTS[component]} of {scene.nodes[node]}")
            for (node, component), function in scene.prescribed.items()
        ]
        self._driven += [
            (getattr(joint, name).motor, f"motor of {joint}") for joint, name in model.motors
        ]

    # -- Start ----------------------------------------------------------------------------------

    def initial_state(self, dt: float) -> State:
        """State at t = 0, in equilibrium with its accelerations.

        Parameters
        ----------
        dt : float
            Time step [s], of which a small part serves to differentiate prescribed motions.

        Returns
        -------
        State
            The start.

        Raises
        ------
        SceneError
            If the initial velocities violate a support, or a prescribed motion does not start
            from zero.
        """
        model = self.model
        values = self.driven_at(0.0)
        for value, (_, what) in zip(values, self._driven, strict=True):
            if abs(value) > 1e-12:
                raise SceneError(
                    f"{what} is {value:g} at t = 0, and the scene starts from 0: let it start there"
                )
        slides = np.array([joint.start()[0] for joint in model.scene.joints])
        q, v, a = (np.zeros(model.size) for _ in range(3))
        state = State(0.0, q, v, a, slides, np.zeros(len(model.motors)))
        # One-sided differences of second order: a motion need not be defined before t = 0.
        h = 1e-3 * dt
        f1, f2, f3 = (self.driven_at(k * h) for k in (1, 2, 3))
        rates, accelerations = (4 * f1 - f2) / (2 * h), (-5 * f1 + 4 * f2 - f3) / h**2
        # A motion that starts at rest has a rate of no more than the error of these.
        rates[abs(rates) < 1e-3 * abs(self.driven_at(100 * h)) / (100 * h)] = 0.0

        model.reduction.begin(state.q, slides, h)
        model.reduction.expand(np.zeros(model.reduction.free), np.zeros(len(rates)))
        w = initial_rates(model, rates)
        state.v = model.reduction.spread(w)
        state.a = self._initial_acceleration(state, w, accelerations, dt)
        return state

    def _initial_acceleration(self, state: State, w: np.ndarray, driven: np.ndarray, dt: float):
        """Accelerations of what has mass, from T^T M a = T^T (F - f)."""
        model, reduction = self.model, self.model.reduction
        h = 1e-9 * dt
        # An increment over a very short step gives added forces the initial velocity.
        D = h * state.v if model.forms.has_added else np.zeros(model.size)
        model.forms.set_step(0.0, h, state.q, state.v, state.a)
        free, moved = reduction.free, slice(reduction.free, reduction.free + reduction.driven)
        a = np.zeros(reduction.columns)
        a[moved] = driven
        curved = np.zeros(model.size)
        if model.scene.joints and w.any():
            # What joints accelerate at constant rates: the second difference of their motion.
            k = 1e-4 / abs(state.v / model.unit).max()
            ahead, back = (reduction.expand(s * k * w[:free], s * k * w[moved]) for s in (1, -1))
            curved = (ahead + back) / k**2
            reduction.expand(np.zeros(free), np.zeros(reduction.driven))
        T = reduction.coupling()
        force = self.end_forces(0.0, dt)[0] - model.forms.internal_force(D)
        force -= model.mass @ (T @ a + curved)
        model.actuators.set_rates(state.q, state.v, state.slides)
        model.actuators.begin(state.q, state.slides, h)
        model.actuators.set_increment(h * state.v, h * w)
        b = T.T @ force - model.actuators.forces(reduction.columns)
        a[:free] = acceleration_of((T.T @ model.mass @ T)[:free, :free], b[:free])
        return T @ a + curved

    # -- Steps ----------------------------------------------------------------------------------

    def march(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> State:
        """State after several steps of the grid.

        Parameters
        ----------
        state : State
            The present.
        times : (steps,) float
            Ends of the steps [s].
        first : int
            Number of the first of them, from 1.
        recorder : Recorder
            Keeps what it wants.

        Returns
        -------
        State
            The state at the last of the times.

        Raises
        ------
        StepError
            If a step fails after all halvings, or a function of time fails.
        """
        for number, t in enumerate(times, start=first):
            before = state.q
            state = self.advance(state, float(t))
            self.stats.steps += 1
            if recorder.wants(number):
                recorder.record(state, before)
        return state

    def advance(self, state: State, t1: float, halvings: int = 0) -> State:
        """State at a later time, in one step or, where that fails, in halves.

        Parameters
        ----------
        state : State
            The present.
        t1 : float
            Time to reach [s].
        halvings : int
            How often the step has been halved already.

        Returns
        -------
        State
            The state at `t1`.

        Raises
        ------
        StepError
            If the step fails after all halvings, or a function of time fails.
        """
        try:
            return self._step(state, t1)
        except StepFailed as failure:
            if halvings >= self.max_halvings:
                raise StepError(self._message(state, t1, failure, halvings), state.t) from failure
        self.stats.halvings += 1
        middle = self.advance(state, (state.t + t1) / 2, halvings + 1)
        return self.advance(middle, t1, halvings + 1)

    def _step(self, state: State, t1: float) -> State:
        model, rates = self.model, self.model.scheme.rates
        dt = t1 - state.t
        forces = self.end_forces(state.t, t1)
        start = np.concatenate([state.q[model.prescribed], state.motors])
        values = self.driven_at(t1)
        model.forms.set_step(state.t, dt, state.q, state.v, state.a)
        model.actuators.set_rates(state.q, state.v, state.slides)
        model.reduction.begin(state.q, state.slides, dt)
        force = (1 - rates.level) * forces[0] + rates.level * forces[1]
        step = self.newton.solve(state.v, state.a, dt, force, values - start)
        self.stats.newton_iterations += step.iterations
        self.stats.ended_by[step.ended_by] = self.stats.ended_by.get(step.ended_by, 0) + 1

        v, a = rates.end(step.D, state.v, state.a, dt, model.turns)
        # Rates without mass appear in no equation, and the mid-point rule would let them swing
        # about their mean; the mean is what they are.
        free = model.massless
        path, _ = rates.work_increment(step.D, model.turns)
        v[free] = path[free] / dt
        a[free] = (v - state.v)[free] / dt
        slides = state.slides + self._slide_increments(step, values - start)
        motors = values[len(model.prescribed) :]
        new = State(t1, state.q + step.D, v, a, slides, motors)
        self._add_work(state, step, (forces[0] + forces[1]) / 2, path, new)
        return new

    def _slide_increments(self, step: StepSolution, driven: np.ndarray) -> np.ndarray:
        z = np.concatenate([step.y, driven])
        increments = np.zeros(len(self.model.scene.joints))
        for number, column in self.model.couplings.slides.items():
            increments[number] = z[column]
        return increments

    def _add_work(
        self, old: State, step: StepSolution, dead: np.ndarray, path: np.ndarray, new: State
    ) -> None:
        """Add the work of dead loads, driven motion, dampers and added forces to a new state."""
        model = self.model
        if model.weight is not None:
            dead = dead - model.weight
        work = old.work + dead @ path - model.actuators.dissipated()
        new.held = model.reduction.project(step.r)[model.reduction.free :]
        if self._driven:
            drive = np.concatenate([path[model.prescribed], self._motor_paths(path, new, old)])
            work += self._mid(new.held, old.held)[: len(drive)] @ drive
        if model.forms.has_added:
            model.forms.internal_force(step.D)
            new.added = model.forms.added_force()
            work += self._mid(new.added, old.added) @ path
        if self.joint_forces is not None:
            new.joint_forces = self.joint_forces.of(step.r)
        new.work = float(work)

    def _motor_paths(self, path: np.ndarray, new: State, old: State) -> np.ndarray:
        """Increments on which the motors do work."""

        def turn(node) -> float:
            return path[self.model.mesh.dofs[node.number, 2]] if node is not GROUND else 0.0

        return np.array(
            [
                turn(joint.b) - turn(joint.a)
                if name == "rotation"
                else new.slides[joint.number] - old.slides[joint.number]
                for joint, name in self.model.motors
            ]
        )

    def _mid(self, force: np.ndarray, previous: np.ndarray | None) -> np.ndarray:
        """A force at mid-step from those at the scheme's level in this step and the last."""
        level = self.model.scheme.rates.level
        if previous is None or level == 0.5:
            return force
        return force + (0.5 - level) * (force - previous)

    def end_forces(self, t0: float, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Dead forces at the start and at the end of a step, weight included.

        Both are taken just inside the step: a load that jumps from one step to the next belongs
        to the one in which it acts, whichever way its function rounds.
        """
        inset = max(1e-12 * (t1 - t0), 4 * np.spacing(t1))
        forces = [self.model.loads.at(t) for t in (t0 + inset, t1 - inset)]
        if self.model.weight is not None:
            forces = [force + self.model.weight for force in forces]
        return forces[0], forces[1]

    def driven_at(self, t: float) -> np.ndarray:
        """Prescribed motions and motors at a time, (driven,) [m, rad]."""
        return np.array([evaluate(function, t, what)[0] for function, what in self._driven])

    def _message(self, state: State, t1: float, failure: StepFailed, halvings: int) -> str:
        model = self.model
        D = model.to_nodes(abs(failure.D / model.unit))
        node, component = np.unravel_index(np.argmax(np.nan_to_num(D, nan=np.inf)), D.shape)
        x, y = model.mesh.X[node]
        history = ", ".join(f"{r:.1e}" for r in failure.residuals[-8:])
        return (
            f"{model.scheme.name}: the step from t = {state.t:.6g} to {t1:.6g} failed"
            f"{f' after {halvings} halvings' if halvings else ''}: {failure.reason}. Largest "
            f"increment: {COMPONENTS[component]} of node {node} at ({x:g}, {y:g}). Largest "
            f"out-of-balance force, last iterations: {history or 'none'}. Try a smaller dt"
            f"{'' if halvings else ' or max_halvings > 0'}; if that does not help, look for a "
            "load, a velocity or a stiffness in the wrong unit, or another scheme"
        )
