"""Steps in Python, on PETSc: the reference, and the way out where the compiled loop fails."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import StepError
from fx_beam.model import JointForces, Model
from fx_beam.results.audit import Stats
from fx_beam.results.state import Past, State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.joints import GROUND

from .forcing import Drive
from .newton import Newton, StepFailed, StepSolution
from .recorder import Recorder
from .section_facing import Facing
from .substeps import LARGE_TURN, Halving


class Stepper:
    """Takes a model from time to time.

    Parameters
    ----------
    model : Model
        The compiled scene.
    newton : Newton
        Solver for one step.
    drive : Drive
        Loads and driven motions.
    stats : Stats
        Counts what is done.
    max_halvings : int
        How often a failing step may be halved before it is given up.
    """

    def __init__(self, model: Model, newton: Newton, drive: Drive, stats: Stats, max_halvings: int):
        self.model = model
        self.newton = newton
        self.stats = stats
        self.halving = Halving(max_halvings)
        self.drive = drive
        self.facing = Facing(model, stats)
        self.joint_forces = JointForces(model) if model.scene.joints else None

    @property
    def past(self) -> Past:
        """What the next increment is foretold from."""
        return self.newton.guess.past

    @past.setter
    def past(self, past: Past | None) -> None:
        self.newton.guess.past = past

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
        for number, t in enumerate(map(float, times), start=first):
            start = state.t
            while state.t < t:
                state = self.part(state, start, t, number, recorder)
            self.stats.steps += 1
        return state

    def part(
        self, state: State, start: float, end: float, number: int, recorder: Recorder
    ) -> State:
        """State after the next part of a step that succeeds.

        Parameters
        ----------
        state : State
            The present.
        start, end : float
            Those of the step of the grid [s].
        number : int
            Number of that, from 1.
        recorder : Recorder
            Keeps what it wants of the step.

        Returns
        -------
        State
            The state at the end of the part.

        Raises
        ------
        StepError
            If it may be halved no more, or a function of time fails.
        """
        before = state
        while True:
            t1 = float(self.halving.ends(np.array([start, end]))[0])
            try:
                state = self.step(state, t1)
            except StepFailed as failure:
                if not self.halving.fail():
                    message = self._message(state, t1, failure, self.halving.most)
                    raise StepError(message, state.t) from failure
                self.stats.halvings += 1
                continue
            self.stats.substeps += 1
            self.facing.look(state.t, state.q)
            parts = self.halving.parts
            if parts > 1:
                turn = abs(state.q - before.q)[self.model.turns].max()
                self.stats.too_large += int(turn * parts > LARGE_TURN)
            if self.halving.take(1):
                recorder.record(number, state, before, parts)
            return state

    def step(self, state: State, t1: float) -> State:
        """State at a later time, in one step.

        Parameters
        ----------
        state : State
            The present.
        t1 : float
            Time to reach [s].

        Returns
        -------
        State
            The state at `t1`.

        Raises
        ------
        StepFailed
            If there is no convergence.
        """
        level = self.model.scheme.rates.level
        forces, places = self.drive.forces(state.t, t1), self.drive.places(t1)
        dt = self.begin(state, t1)
        force = (1 - level) * forces[0] + level * forces[1]
        step = self.newton.solve(state.v, state.a, dt, force, places - self.drive.moved(state))
        return self.finish(state, t1, step, forces, places)

    def begin(self, state: State, t1: float) -> float:
        """Set a step.

        Parameters
        ----------
        state : State
            Its start.
        t1 : float
            Its end [s].

        Returns
        -------
        float
            Its length [s].
        """
        model, dt = self.model, t1 - state.t
        model.forms.set_step(state.t, dt, state.q, state.v, state.a)
        model.actuators.set_rates(state.q, state.v, state.slides)
        model.reduction.begin(state.q, state.slides, dt)
        return dt

    def finish(
        self,
        state: State,
        t1: float,
        step: StepSolution,
        forces: tuple[np.ndarray, np.ndarray],
        places: np.ndarray,
    ) -> State:
        """State at the end of a step, with the work done in it.

        Parameters
        ----------
        state : State
            Its start.
        t1 : float
            Its end [s].
        step : StepSolution
            The increment.
        forces : pair of (size,) float
            Dead forces at the start and at the end.
        places : (driven,) float
            Where driven motions are at the end.

        Returns
        -------
        State
            The end.
        """
        model, rates = self.model, self.model.scheme.rates
        self.stats.newton_iterations += step.iterations
        self.stats.ended_by[step.ended_by] = self.stats.ended_by.get(step.ended_by, 0) + 1
        dt = t1 - state.t
        v, a = rates.end(step.D, state.v, state.a, dt, model.turns)
        path, _ = rates.work_increment(step.D, model.turns)
        if not rates.at_rest:
            # Rates without mass appear in no equation, and the mid-point rule would let them swing
            # about their mean; the mean is what they are.
            free = model.massless
            v[free] = path[free] / dt
            a[free] = (v - state.v)[free] / dt
        slides = state.slides + self._slide_increments(step, places - self.drive.moved(state))
        new = State(t1, state.q + step.D, v, a, slides, places[len(model.prescribed) :])
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
        """Add the work of dead loads, driven motion and added forces, and the dampers' loss."""
        model = self.model
        if model.weight is not None:
            dead = dead - model.weight
        work = old.work + dead @ path
        new.dissipated = old.dissipated + model.actuators.dissipated()
        new.held = model.reduction.project(step.r)[model.reduction.free :]
        if self.model.reduction.driven:
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

    def largest(self, failure: StepFailed) -> str:
        """The largest increment of a failed step, and how its residuals went."""
        model = self.model
        D = model.to_nodes(abs(failure.D / model.unit))
        node, component = np.unravel_index(np.argmax(np.nan_to_num(D, nan=np.inf)), D.shape)
        x, y = model.mesh.X[node]
        history = ", ".join(f"{r:.1e}" for r in failure.residuals[-8:])
        return (
            f"Largest increment: {COMPONENTS[component]} of node {node} at ({x:g}, {y:g}). Largest "
            f"out-of-balance force, last iterations: {history or 'none'}"
        )

    def _message(self, state: State, t1: float, failure: StepFailed, halvings: int) -> str:
        return (
            f"{self.model.scheme.name}: the step from t = {state.t:.6g} to {t1:.6g} failed"
            f"{f' after {halvings} halvings' if halvings else ''}: {failure.reason}. "
            f"{self.largest(failure)}. Try a smaller dt"
            f"{'' if halvings else ' or max_halvings > 0'}; if that does not help, look for a "
            "load, a velocity or a stiffness in the wrong unit, or another scheme"
        )
