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
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.loop import CompiledLoop

from .assembly import Assembly
from .inertia import Inertia
from .unknowns import Unknowns, unknowns_of

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


class Equations:
    """Forces r (size,) of a step at unknowns, and their tangent.

    The state at its start is in the memory of the engine, which gets the increment.
    """

    def __init__(self, assembly: Assembly, loop: CompiledLoop, max_turn: float):
        self.assembly, self.loop, self.model = assembly, loop, loop.model
        self._max_turn = max_turn
        n, problem, reduction = loop.model.size, loop.problem, loop.model.reduction
        #: What C has of a step.
        self.c_step = StepInC(*problem.results(D=n, z=reduction.columns, r=n, f=n))
        #: In C: dead forces (size,) at the level of the step, natural strains at its end, flat.
        self.dead, _, self._natural_in_c = problem.given()
        at_rest = loop.model.scheme.rates.at_rest
        self._inertia = None if at_rest else Inertia(loop)
        #: All forces (size,), internal ones, and those of added terms, where they were found last.
        self.forces, self.internal, self._added = np.zeros((3, n))
        # Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self._natural: np.ndarray | None = None
        # Load factors or times of the last step; None before the first.
        self._interval: Interval | None = None
        # End of the last step [s], and forces (size,) of added terms in it.
        self._last_step = np.nan, np.zeros(n)
        reduction.begin(np.zeros(n), slides_at_start(loop.model.scene))
        #: Unknowns of the last step.
        self.unknowns: Unknowns = unknowns_of(assembly)

    def find_natural_strains(self) -> None:
        """Have the natural strains of a user at the end of the next step."""
        form = self.assembly.form
        if form.natural is not None:
            self._natural = form.grid.at_points([form.natural])

    def begin(self, dt: float) -> None:
        """Begin a sub-step at the state in C."""
        reduction, strains = self.model.reduction, self.model.data.natural
        # The end less the start differs from dt by round-off, which would count as work.
        interval = self.loop.interval(dt)
        self._interval, self._start = interval, (start := self.loop.state.read())
        reduction.begin(start.q, start.slides)
        if self._natural is not None:
            self._natural_in_c[:] = self._natural.ravel()
        natural = self._natural_in_c.reshape(strains.shape) if strains else None
        self.assembly.fields.begin(interval, start, natural)
        self._y = self.c_step.z[: reduction.free].copy()
        self._driven = self.c_step.z[reduction.free :][: reduction.driven]
        if self._inertia is not None:
            increment = reduction.increment(self._y, self._driven)
            led = self._inertia.begin(start, interval.length, increment)
            self.assembly.fields.lead(led)
        self._choose_unknowns()

    def _choose_unknowns(self) -> None:
        """Have other unknowns where joints have other independent ones."""
        if not np.array_equal(self.model.reduction.independent, self.unknowns.independent):
            self.unknowns = unknowns_of(self.assembly)

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
        self.forces = self.internal + self._added - self.dead
        if self._inertia is not None:
            self.forces += self._inertia.force(D)
        model.forms.compiled_points.add_force(D, self.forces)

    def tangent(self) -> PETSc.Mat:
        """The reduced tangent where forces were found last."""
        K, members = self.assembly.tangent(), self.model.points.members
        self.model.forms.compiled_points.add_tangent(K.data)
        if self._inertia is not None:
            K = self._inertia.with_tangent(K)
        if members is not None:
            K = K + members.tangent()
        self.unknowns.assemble(K, self._y, self._driven, self.forces)
        return self.unknowns.A

    @property
    def mass(self) -> scipy.sparse.csr_matrix:
        """Mass matrix (size, size) of beams and lumped masses."""
        return self.model.masses.matrix

    def stiffness(self, state: State) -> PETSc.Mat:
        """The reduced tangent for slow motions about a state, of a scheme of the package."""
        model, interval = self.model, instant(state.t, _SLOW)
        still = state.changed(v=0 * state.v, a=0 * state.a)
        model.reduction.begin(state.q, state.slides)
        self.assembly.fields.begin(interval, still, state.natural)
        batch = StepBatch.single(state.t, _SLOW, q=still.q, v=still.v, slides=still.slides)
        model.forms.compiled_points.begin(interval, batch)
        if self._inertia is not None:
            self._inertia.begin(still, _SLOW, np.zeros(model.size))
        self._y, self._driven = np.zeros(model.reduction.free), np.zeros(model.reduction.driven)
        self._choose_unknowns()
        self.evaluate(self.y)
        K = self.tangent().copy()
        K.scale(1 / model.scheme.rates.level)
        return K

    def load_slope(self, forcing: LoadForcing) -> np.ndarray:
        """Derivative (n,) of the reduced residual by the load factor, in statics."""
        if self._interval is None:
            raise SceneError("fenicsx: load_derivative: no residual was found yet. Begin a step")
        points, end = self.model.forms.compiled_points, self._interval.end
        inputs, sides = self.model.points.inputs.copy(), []
        for factor in (end + _APART, end - _APART, end):
            self.assembly.fields.set_load(factor, forcing.natural(factor))
            points.set_load(factor, self._interval.length)
            self._driven = forcing.positions(factor) - forcing.current(self._start)
            self.dead[:] = forcing.dead(factor)
            self.evaluate(self.y)
            sides.append(self.unknowns.reduced_force(self.forces))
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
