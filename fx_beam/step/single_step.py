"""One step: its increment, the state at its end, and the work done in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.errors import Failure, StepError
from fx_beam.fem.parameter_values import before
from fx_beam.laws.interval import Interval, divided
from fx_beam.results.audit import Stats
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.joints import GROUND
from fx_beam.scene.sliders import corner_advice

from .equations import Equations
from .forcing import Forcing
from .joint_forces import JointForces
from .model import Model
from .newton import Newton, NewtonOptions, StepFailed, StepSolution

# How often a step is repeated with the forces of joints that it gives, which friction follows.
_TRIALS = 40


class SingleStep:
    """Takes one step of time, or of the load factor in statics."""

    def __init__(self, model: Model, forcing: Forcing, options: NewtonOptions, stats: Stats):
        self.model, self.forcing, self.stats = model, forcing, stats
        self.equations = Equations(model, forcing.time, forcing.turning, forcing.natural)
        self.newton = Newton(self.equations, options)
        self.joint_forces = JointForces(model) if model.scene.joints else None

    def use(self, equations: Equations, linear: Any = None) -> None:
        """Evaluate other equations, whose linear systems a solver of their own may solve."""
        self.equations = equations
        self.newton.use(equations, linear)

    def take(
        self, state: State, interval: Interval, sub_step: int = 0
    ) -> tuple[State, StepSolution]:
        """State at the end of a step or of a sub-step of it, and its increment.

        StepFailed if it does not converge.
        """
        self.equations.sub_step = sub_step
        level = self.model.scheme.rates.level
        forces, positions = self.forcing.forces(interval), self.forcing.positions(interval.end)
        force = (1 - level) * forces[0] + level * forces[1]
        driven = positions - self.forcing.current(state)
        step = self.newton.solve(interval, state, force, driven)
        if self.model.points.follow_joints:
            step = self._follow_joints(state, step, (interval, force, driven))
        return self.finish(state, interval, step, forces, positions), step

    def through(self, state: State, step: Interval) -> tuple[list[State], list[StepSolution]]:
        """States at both ends of all sub-steps of the scheme in a step, and their increments."""
        states, solutions = [state], list[StepSolution]()
        t0, t1 = np.array(step[:2])[:, None]
        grid = zip(*divided(t0, t1, self.model.scheme.fractions), strict=True)
        for number, ends in enumerate(grid):
            new, solution = self.take(states[-1], Interval(*map(float, ends)), number)
            states.append(new)
            solutions.append(solution)
        return states, solutions

    def failure(self, state: State, t1: float) -> StepFailed:
        """Why a step to t1 [s] fails, without a prediction."""
        predictor, self.newton.predictor = self.newton.predictor, None
        try:
            self.through(state, Interval(state.t, t1))
        except StepFailed as failure:
            return failure
        finally:
            self.newton.predictor = predictor
        return StepFailed("no convergence", "no convergence", np.zeros(self.model.size), [])

    def _follow_joints(self, state: State, step: StepSolution, given: tuple) -> StepSolution:
        """The step with the forces of joints that friction follows; StepFailed without any."""
        assert state.spring_internal is not None and self.joint_forces is not None
        points, internal, still = self.model.points, state.spring_internal.copy(), False
        interval, force, driven = given
        points.begin_following()
        for _ in range(_TRIALS):
            points.evaluate(step.D)
            joints = self.joint_forces.evaluate(step.r)
            for joint, axis in self.model.reduction.axes():
                points.set_axis(joint, axis)
            if not points.follow(joints, state.q, internal, still):
                return step
            started = replace(state, spring_internal=internal)
            step = self.newton.solve(interval, started, force, driven, step)
            still = step.iterations == 1
        reason = "the friction of joints and the force that it follows do not meet"
        raise StepFailed("no convergence", reason, step.D, [])

    def finish(
        self,
        state: State,
        interval: Interval,
        step: StepSolution,
        forces: tuple[np.ndarray, np.ndarray],
        positions: np.ndarray,
    ) -> State:
        """State at the end of a converged step, with the work done in it.

        `forces` are the dead forces at both ends, `positions` those of driven motion at the end.
        """
        model, rates, dt = self.model, self.model.scheme.rates, interval.length
        v, a = self.equations.rates_at_end(step.D)
        path, _ = rates.work_increment(step.D, model.turns)
        if not rates.at_rest:
            # No equation contains the rates of massless degrees of freedom. By the mid-point rule
            # they would oscillate about their mean; the mean is used instead.
            free = model.massless
            v[free] = path[free] / dt
            a[free] = (v - state.v)[free] / dt
        driven = positions - self.forcing.current(state)
        slides = state.slides + self._slide_increments(step, driven)
        motors = positions[len(model.prescribed) :]
        new = State(interval.end, motors, state.q + step.D, v, a, slides)
        if model.keeps_previous:
            new.q_previous, new.length = state.q, dt
        new.natural = self.forcing.natural(interval.end)
        model.forms.set_natural_end(new.natural)
        new.internal = model.forms.evolve(step.D)
        model.points.evaluate(step.D)
        new.spring_internal = model.points.evolve()
        self._add_work(state, step, (forces[0] + forces[1]) / 2, path, new)
        new.parameters = state.parameters
        if model.forms.parameters.vary:
            self._change_parameters(state, interval, step, new)
        return new

    def _change_parameters(
        self, old: State, interval: Interval, step: StepSolution, new: State
    ) -> None:
        """Set the parameters at the end; add the work of what changes those of stored energies."""
        parameters = self.model.forms.parameters
        level = parameters.at(interval.start + self.model.scheme.rates.level * interval.length)
        new.parameters = parameters.at(before(interval.end))
        if parameters.in_energies:
            if (beams := self.model.forms.beams) is not None:
                new.work += beams.held_before(step.D) - old.algorithmic
            new.work += self._stored(old, level) - self._stored(old, old.parameters)
            new.work += self._stored(new, new.parameters) - self._stored(new, level)

    def _stored(self, state: State, parameters: np.ndarray | None) -> float:
        """Stored energy of a state with some values of the parameters [J]."""
        self.model.forms.parameters.use(parameters)
        elastic = self.model.forms.strain_energy(state.q, state.internal, state.natural)
        return elastic + self.model.spring_energy(state)

    def _slide_increments(self, step: StepSolution, driven: np.ndarray) -> np.ndarray:
        z = np.concatenate([step.y, driven])
        increments = np.zeros(self.model.scene.joint_count)
        for number, column in self.model.couplings.slides.items():
            increments[number] = z[column]
        return increments

    def _add_work(
        self, old: State, step: StepSolution, dead: np.ndarray, path: np.ndarray, new: State
    ) -> None:
        """Add the work of dead loads, driven motion and added forces, and the dissipation."""
        model = self.model
        if model.weight is not None:
            dead = dead - model.weight
        work = old.work + dead @ path + model.forms.actuation(step.D)
        lost, taken, new.algorithmic = model.forms.losses(step.D)
        new.dissipated = old.dissipated + lost + taken
        new.numerical = old.numerical + taken
        new.constraint_forces = model.reduction.project(step.r)[model.reduction.free :]
        if self.model.reduction.driven:
            driven = np.concatenate([path[model.prescribed], self._motor_paths(path, new, old)])
            work += self._mid(new.constraint_forces, old.constraint_forces)[: len(driven)] @ driven
        if model.forms.has_added:
            model.forms.internal_force(step.D)
            new.added_forces = model.forms.added_force()
            work += self._mid(new.added_forces, old.added_forces) @ path
        if (frame := self.forcing.turning) is not None:
            pushes = (state.t * frame.force(state.q) for state in (old, new))
            work += sum(pushes) / 2 @ path
        if self.joint_forces is not None:
            new.joint_forces = self.joint_forces.evaluate(step.r)
        if model.points.contacts:
            new.contact_forces = model.points.contact_forces()
        new.work = float(work)

    def _motor_paths(self, path: np.ndarray, new: State, old: State) -> np.ndarray:
        """Increments of the motors' coordinates, by which the motors do work."""

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
        """A force at mid-step, from its values at the scheme's level in this and the last step."""
        level, several = self.model.scheme.rates.level, len(self.model.scheme.fractions) > 1
        if previous is None or level == 0.5 or several:
            return force
        return force + (0.5 - level) * (force - previous)

    def error(
        self, what: str, tries: int, start: State, failed: StepFailed, advice: str
    ) -> StepError:
        """StepError for a step that failed after some cuts: what, why, the worst node, advice."""
        model = self.model
        D = model.to_nodes(abs(failed.D / model.unit))
        node, component = np.unravel_index(np.argmax(np.nan_to_num(D, nan=np.inf)), D.shape)
        x, y = model.mesh.X[node]
        history = ", ".join(f"{r:.1e}" for r in failed.residuals[-8:])
        where = (
            f"Largest increment: {COMPONENTS[component]} of node {node} at ({x:g}, {y:g}). Largest "
            f"out-of-balance force, last iterations: {history or 'none'}"
        )
        static = self.stats.static
        who, cuts = ("static", "cuts") if static else (model.scheme.name, "halvings")
        after = f" after {tries} {cuts}" if tries else ""
        reason = f"{who}: {what}{after}: {failed.reason}"
        advice = corner_advice(model.scene.joints, start.slides) or advice
        return StepError(Failure(failed.kind, reason, start.t, where, advice))
