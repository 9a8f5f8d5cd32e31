"""The loop over time steps: halving where a step fails, and the record of what happened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse.linalg

from .audit import Energy, Stats
from .beam import COMPONENTS
from .errors import SceneError, StepError
from .model import Model
from .newton import Newton, StepFailed, StepSolution
from .values import evaluate


@dataclass
class State:
    """The system at one time, and what the next step needs of the last one.

    Parameters
    ----------
    t : float
        Time [s].
    q, v, a : (size,) float
        Displacements and rotations, rates and accelerations.
    reaction, added : (size,) float or None
        Forces of the supports and of the added virtual works in the step that ended here.
    work : float
        Work done since the start [J].
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    reaction: np.ndarray | None = None
    added: np.ndarray | None = None
    work: float = 0.0


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
        self._motions = [
            (function, f"prescribed {COMPONENTS[component]} of {model.scene.nodes[node]}")
            for (node, component), function in model.scene.prescribed.items()
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
        q, v, a = (np.zeros(model.size) for _ in range(3))
        values = self._prescribed(0.0)
        for value, (_, what) in zip(values, self._motions, strict=True):
            if value != 0:
                raise SceneError(
                    f"{what} is {value:g} at t = 0, and the scene starts from 0: let it start there"
                )
        v[:] = self._initial_velocity()
        # One-sided differences of second order: a motion need not be defined before t = 0.
        h = 1e-3 * dt
        f1, f2, f3 = (self._prescribed(k * h) for k in (1, 2, 3))
        v[model.prescribed] = (4 * f1 - f2) / (2 * h)
        a[model.prescribed] = (-5 * f1 + 4 * f2 - f3) / h**2
        self._solve_acceleration(q, v, a, self._end_forces(0.0, dt)[0], h)
        return State(0.0, q, v, a)

    def _initial_velocity(self) -> np.ndarray:
        model, mesh = self.model, self.model.mesh
        v = np.full((len(mesh.X), 3), np.nan)
        for item in model.scene.velocities:
            for node in mesh.nodes_of(model.scene, item.target):
                x, y = map(float, mesh.X[node])
                value = np.concatenate([item.value(x, y), item.spin(x, y)])
                if not np.isfinite(value).all():
                    raise SceneError(f"initial velocity at ({x:g}, {y:g}) is {value}, not finite")
                if (abs(v[node] - value) > 1e-9 * abs(value).max()).any():
                    raise SceneError(
                        f"two initial velocities at ({x:g}, {y:g}): {v[node]} and {value}"
                    )
                v[node] = value
        v = np.nan_to_num(v)
        for node, component in model.scene.fixed:
            if v[node, component] != 0:
                raise SceneError(
                    f"{model.scene.nodes[node]} is supported in {COMPONENTS[component]} and has "
                    f"an initial rate of {v[node, component]:g} there; it must be 0"
                )
        return model.from_nodes(v)

    def _solve_acceleration(self, q, v, a, force, h) -> None:
        """Accelerations of what has mass and is free, from M a = F - f."""
        model = self.model
        # An increment over a very short step gives added forces the initial velocity.
        D = 1e-6 * h * v if model.forms.has_added else np.zeros(model.size)
        model.forms.set_step(0.0, 1e-6 * h, q, v, a)
        r = force - model.forms.internal_force(D) - model.mass @ a
        moving = np.setdiff1d(model.free, np.flatnonzero(model.massless))
        if len(moving):
            M = model.mass[moving][:, moving].tocsc()
            a[moving] = scipy.sparse.linalg.spsolve(M, r[moving])

    # -- Steps ----------------------------------------------------------------------------------

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
        forces = self._end_forces(state.t, t1)
        motion = np.zeros(model.size)
        motion[model.prescribed] = self._prescribed(t1) - state.q[model.prescribed]
        model.forms.set_step(state.t, dt, state.q, state.v, state.a)
        force = (1 - rates.level) * forces[0] + rates.level * forces[1]
        step = self.newton.solve(state.v, state.a, dt, force, motion)
        self.stats.newton_iterations += step.iterations
        self.stats.ended_by[step.ended_by] = self.stats.ended_by.get(step.ended_by, 0) + 1

        v, a = rates.end(step.D, state.v, state.a, dt, model.turns)
        # Rates without mass appear in no equation, and the mid-point rule would let them swing
        # about their mean; the mean is what they are.
        free = model.massless
        v[free] = rates.work_increment(step.D, model.turns)[0][free] / dt
        a[free] = (v - state.v)[free] / dt
        new = State(t1, state.q + step.D, v, a)
        return self._with_work(state, step, (forces[0] + forces[1]) / 2, new)

    def _with_work(self, old: State, step: StepSolution, dead: np.ndarray, new: State) -> State:
        """The new state with the work of dead loads, prescribed motion and added forces."""
        model, rates = self.model, self.model.scheme.rates
        path, _ = rates.work_increment(step.D, model.turns)
        if model.weight is not None:
            dead = dead - model.weight
        work = old.work + dead @ path
        new.reaction = step.reaction
        if len(model.prescribed):
            moved = model.prescribed
            work += self._mid(new.reaction, old.reaction)[moved] @ path[moved]
        if model.forms.has_added:
            model.forms.internal_force(step.D)
            new.added = model.forms.added_force()
            work += self._mid(new.added, old.added) @ path
        new.work = float(work)
        return new

    def _mid(self, force: np.ndarray, previous: np.ndarray | None) -> np.ndarray:
        """A force at mid-step from those at the scheme's level in this step and the last."""
        level = self.model.scheme.rates.level
        if previous is None or level == 0.5:
            return force
        return force + (0.5 - level) * (force - previous)

    def _end_forces(self, t0: float, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Dead forces at the start and at the end of a step, weight included.

        Both are taken just inside the step: a load that jumps from one step to the next belongs
        to the one in which it acts, whichever way its function rounds.
        """
        inset = max(1e-9 * (t1 - t0), 4 * np.spacing(t1))
        forces = [self.model.loads.at(t) for t in (t0 + inset, t1 - inset)]
        if self.model.weight is not None:
            forces = [force + self.model.weight for force in forces]
        return forces[0], forces[1]

    def _prescribed(self, t: float) -> np.ndarray:
        return np.array([evaluate(function, t, what)[0] for function, what in self._motions])

    def _message(self, state: State, t1: float, failure: StepFailed, halvings: int) -> str:
        model = self.model
        D = abs(model.to_nodes(failure.D)) / [model.mesh.size, model.mesh.size, 1.0]
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


class Recorder:
    """Histories of motion, energies and momenta, kept also when the run breaks off.

    Parameters
    ----------
    model : Model
        The compiled scene.
    times : (n,) float
        Times of the grid [s].
    """

    def __init__(self, model: Model, times: np.ndarray):
        self.model = model
        self.count = 0
        n, shape = len(times), (len(times), *model.mesh.dofs.shape)
        self._t = times
        self._motion = {name: np.zeros(shape) for name in ("q", "v", "a", "reactions")}
        self._energy = Energy(*(np.zeros(n) for _ in range(4)))
        self._linear, self._angular = np.zeros((n, 2)), np.zeros(n)

    def record(self, state: State) -> None:
        """Add a state.

        Parameters
        ----------
        state : State
            The system at the next time of the grid.
        """
        model, k = self.model, self.count
        momentum = model.mass @ state.v
        q, p = model.to_nodes(state.q), model.to_nodes(momentum)
        for name, value in (
            ("q", q),
            ("v", model.to_nodes(state.v)),
            ("a", model.to_nodes(state.a)),
        ):
            self._motion[name][k] = value
        if state.reaction is not None and len(model.constrained):
            self._motion["reactions"][k] = model.to_nodes(state.reaction)
        energy = self._energy
        energy.kinetic[k] = state.v @ momentum / 2
        energy.strain[k] = model.forms.strain_energy(state.q)
        if model.weight is not None:
            energy.potential[k] = -(model.weight @ state.q)
        energy.work[k] = state.work
        x = model.mesh.X + q[:, :2]
        self._linear[k] = p[:, :2].sum(axis=0)
        self._angular[k] = x[:, 0] @ p[:, 1] - x[:, 1] @ p[:, 0] + p[:, 2].sum()
        self.count += 1

    def histories(self) -> dict:
        """The recorded part of all histories, by the names that `Solution` gives them."""
        n = self.count
        return {
            "t": self._t[:n],
            **{name: values[:n] for name, values in self._motion.items()},
            "energy": Energy(*(values[:n] for values in vars(self._energy).values())),
            "linear_momentum": self._linear[:n],
            "angular_momentum": self._angular[:n],
        }
