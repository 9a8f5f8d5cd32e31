"""Forces of a step and their tangent for the unknowns y: Tv(y)^T r(g(y)) and its derivative."""

from __future__ import annotations

from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, StepBatch, instant
from fx_beam.results.state import State
from fx_beam.scene.joints import slides_at_start
from fx_beam.step.equations import Equations as EngineEquations
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.model import fact, led_dofs

from .assembly import Assembly
from .unknowns import Unknowns

# Change of the load factor by which derivatives are found as differences.
_APART = 1e-5
# Length [s] of a step in which inertia and dampers give no forces.
_SLOW = 1e12


class NoConfigurationError(Exception):
    """No configuration belongs to the unknowns; `failure` is its code in C."""

    def __init__(self, failure: int):
        super().__init__(failure)
        self.failure = failure


class StepInC(NamedTuple):
    """In C: increments (size,), unknowns (columns,), all forces (size,) and internal ones."""

    D: np.ndarray
    z: np.ndarray
    r: np.ndarray
    f: np.ndarray


class ReducedEquations:
    """Forces r (size,) of a step at unknowns, and their tangent.

    dolfinx has those of beams; masses, points, joints and the reduction are the engine's.
    """

    def __init__(self, assembly: Assembly, loop: CompiledLoop, max_turn: float):
        self.assembly, self.loop, self.model = assembly, loop, loop.model
        self._max_turn = max_turn
        n, problem, reduction = loop.model.size, loop.problem, loop.model.reduction
        #: What C has of a step.
        self.c_step = StepInC(*problem.results(D=n, z=reduction.columns, r=n, f=n))
        #: In C: dead forces (size,) at the level of the step, natural strains at its end, flat.
        self.dead, _, self._natural_in_c = problem.given()
        # Forces of beams, and entries of their tangent, as the engine's equations take them.
        self._beam_forces, self._tangent = np.zeros(n), np.zeros(loop.model.forms.stiffness.nnz)
        self._engine = EngineEquations(loop.model, loop.forcing.time)
        #: All forces (size,), internal ones, and those of added terms, where they were found last.
        self.forces, self.internal, self._added = np.zeros((3, n))
        # Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self._natural: np.ndarray | None = None
        # Load factors or times of the last step; None before the first.
        self._interval: Interval | None = None
        # End of the last step [s], and forces (size,) of added terms in it.
        self._last_step = np.nan, np.zeros(n)
        reduction.set_start(np.zeros(n), slides_at_start(loop.model.scene))
        #: Unknowns of the last step.
        self.unknowns = Unknowns(assembly)

    def find_natural_strains(self) -> None:
        """Have the natural strains of a user at the end of the next step."""
        form = self.assembly.form
        if form.natural is not None:
            self._natural = form.grid.at_points([form.natural])

    def begin_step(self, dt: float) -> None:
        """Begin a sub-step at the state in C."""
        reduction, strains = self.model.reduction, self.model.data.natural
        # The end less the start differs from dt by round-off, which would count as work.
        interval, start = self.loop.interval(dt), self.loop.state.read()
        if self._natural is not None:
            self._natural_in_c[:] = self._natural.ravel()
        natural = self._natural_in_c.reshape(strains.shape) if strains else None
        self._begin(interval, start, natural)
        self._y = self.c_step.z[: reduction.free].copy()
        self._driven = self.c_step.z[reduction.free :][: reduction.driven]
        if len(led := fact(self.model, led_dofs)):
            increment = reduction.increment(self._y, self._driven)
            accelerations = np.zeros(self.model.size)
            accelerations[led] = self._beside_the_rule(interval.length, led, increment[led])
            self.assembly.fields.lead(accelerations)

    def _beside_the_rule(self, dt: float, led: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Accelerations beside those of the rule, of what driven motions alone move by D."""
        start, rates = self._start, self.model.scheme.rates
        v, a = start.v[led], start.a[led]
        before, earlier = (start.length, start.length_before) if start.length else (dt, dt)
        means = [v - dt / 2 * a, D / dt]
        if start.length and start.q_previous is not None:
            means[0] = (start.q - start.q_previous)[led] / before
        # The third derivative of the cubic through the last places, and the second at the level.
        bends = (v - means[0]) / before, (means[1] - means[0]) / (before + dt)
        third = 6 * (bends[1] - bends[0]) / (earlier + before + dt)
        at_level = 2 * bends[1] + third * ((before + 2 * dt) / 3 - (1 - rates.level) * dt)
        return at_level - rates.acceleration(D, v, a, dt)[0]

    def _begin(self, interval: Interval, start: State, natural: np.ndarray | None) -> None:
        self._interval, self._start = interval, start
        sub_step = self.loop.problem.c.work.run.sub_step
        values = self.model.forms.parameters.values.copy()  # C has those at the level of the step
        self._engine.set_start(interval, start.changed(parameters=values))
        self._engine.take_beams(self._beam_forces, self._tangent, sub_step)
        self.assembly.fields.set_start(interval, start, natural)
        if not np.array_equal(self.model.reduction.independent, self.unknowns.independent):
            self.unknowns = Unknowns(self.assembly)

    @property
    def y(self) -> np.ndarray:
        """Independent unknowns (n,) where forces were found last, or at the start."""
        return self._y[self.unknowns.independent]

    def evaluate(self, y: np.ndarray) -> None:
        """Find all forces (size,) at the unknowns.

        Raises
        ------
        NoConfigurationError
            For loops that do not close, and for nodes that turn too far.
        """
        model = self.model
        self._y[self.unknowns.independent] = y
        D = self.c_step.D[:] = model.reduction.increment(self._y, self._driven)
        if not abs(D[model.mesh.turns]).max() <= self._max_turn:
            constants, failure = self.loop.problem.constants, "TURNED_TOO_FAR"
            if not np.isfinite(D).all():
                failure = "OPEN_LOOP" if np.isfinite(y).all() else "NO_CONVERGENCE"
            raise NoConfigurationError(getattr(constants, failure))
        self.internal, self._added = self.assembly.residual(D)
        self._beam_forces[:], self._tangent[:] = self.internal + self._added, 0.0
        self._balance()

    def _balance(self) -> None:
        balance = self._engine.evaluate(self._y, self._driven, self.dead)
        self.forces = balance.r.copy()
        #: Forces (n,) on the unknowns, Tv^T r.
        self.residual = balance.residual[self.unknowns.independent]

    def tangent(self) -> PETSc.Mat:
        """The reduced tangent where forces were found last."""
        self._tangent[:] = self.assembly.tangent()
        self._balance()
        reduction, couplings = self.model.reduction, self.model.couplings
        others = couplings.sliding or couplings.closures or couplings.auxiliaries
        if others or self.model.points.members is not None or self.unknowns.comm.size > 1:
            return self.unknowns.assemble(self._engine.tangent())
        return self.unknowns.set_values(*reduction.tangent.pattern, self._engine.values)

    @property
    def mass(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (size, size) of beams and lumped masses."""
        return self.model.masses.matrix

    def stiffness(self, state: State) -> PETSc.Mat:
        """The reduced tangent for slow motions about a state, of a scheme of the package."""
        model, interval = self.model, instant(state.t, _SLOW)
        still = state.changed(v=0 * state.v, a=0 * state.a)
        self._begin(interval, still, state.natural)
        batch = StepBatch.single(state.t, _SLOW, q=still.q, v=still.v, slides=still.slides)
        model.forms.compiled_points.begin_step(interval, batch)
        self._y, self._driven = np.zeros(model.reduction.free), np.zeros(model.reduction.driven)
        self.evaluate(self.y)
        K = self.tangent().copy()
        K.scale(1 / model.scheme.rates.level)
        return K

    def load_slope(self, forcing: LoadForcing) -> np.ndarray:
        """Derivative (n,) of the reduced residual by the load factor, in statics."""
        if self._interval is None:
            raise SceneError("fenicsx: load_derivative: no residual was found yet. Begin a step")
        end, inputs, sides = self._interval.end, self.model.points.inputs.copy(), []
        for factor in (end + _APART, end - _APART, end):
            self.assembly.fields.set_load(factor, forcing.natural(factor))
            self._engine.end_at(factor)
            self._driven = forcing.positions(factor) - forcing.current(self._start)
            self.dead[:] = forcing.dead(factor)
            self.evaluate(self.y)
            sides.append(self.residual.copy())
        self.model.points.inputs[:] = inputs  # laws remember iterations, not what is beside them
        return (sides[0] - sides[1]) / (2 * _APART)

    def finish(self, dt: float) -> None:
        """Hand the increment, its forces and the work of added terms over to the engine."""
        model, state = self.model, self.loop.problem.c.work.state
        self.c_step.z[: model.reduction.free] = self._y
        self.c_step.r[:], self.c_step.f[:] = self.forces, self.internal
        path, _ = model.scheme.rates.work_increment(self.c_step.D, model.mesh.turns)
        state.work -= self._mean_added(state.t, dt) @ path

    def _mean_added(self, t: float, dt: float) -> np.ndarray:
        """Forces of added terms (size,) in mid-step, from forces at the levels of steps."""
        level, (end, previous) = self.model.scheme.rates.level, self._last_step
        self._last_step = t + dt, self._added
        if level == 0.5 or not np.isclose(end, t, rtol=1e-12, atol=1e-9 * abs(dt)):
            return self._added
        return self._added + (0.5 - level) * (self._added - previous)
