"""Forces of a step and their tangent for the unknowns y: Tv(y)^T r(g(y)) and its derivative."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from fx_beam.scene.joints import slides_at_start
from fx_beam.step.loop import CompiledLoop

from .form import StepForm
from .unknowns import Unknowns, unknowns_of


class NoConfigurationError(Exception):
    """No configuration belongs to the unknowns; `failure` is its code in C."""

    def __init__(self, failure: int):
        super().__init__(failure)
        self.failure = failure


class Equations:
    """Forces r (size,) of a step at unknowns, and their tangent.

    The state at its start is in the memory of the engine, which gets the increment.
    """

    def __init__(self, form: StepForm, loop: CompiledLoop, max_turn: float):
        self.form, self.loop, self.model, self._max_turn = form, loop, loop.model, max_turn
        n, problem, reduction = loop.model.size, loop.problem, loop.model.reduction
        #: Memory of C: increment D, unknowns z, all forces r and internal ones f of the step.
        self.memory = tuple(problem.results(D=n, z=reduction.columns, r=n, f=n))
        self._force, _, self._strains = problem.given()
        #: All forces (size,), and internal ones, where they were found last.
        self.forces, self.internal = np.zeros(n), np.zeros(n)
        #: Natural strains (cells, degree, 3) that a user gives at the end of a step.
        self.natural: np.ndarray | None = None
        # End of the last step [s], and forces of added terms in it.
        self._last_added: tuple[float, Any] = (np.nan, None)
        self._steepness = 0.0
        reduction.begin(np.zeros(n), slides_at_start(loop.model.scene))
        #: Unknowns of the last step.
        self.unknowns: Unknowns = unknowns_of(form)

    def begin(self, dt: float) -> bool:
        """Begin a sub-step at the state in C; whether other unknowns are the independent ones."""
        model = self.model
        reduction, natural = model.reduction, model.data.natural
        # The end less the start differs from dt by round-off, which would count as work.
        self._interval = interval = self.loop.interval(dt)
        self._start = state = self.loop.state.read(self.loop.problem.c.state.t)
        reduction.begin(state.q, state.slides)
        if self.natural is not None:
            self._strains[:] = self.natural.ravel()
        strains = self._strains.reshape(natural.shape) if natural else None
        self.form.begin(interval, state, strains)
        z, free = self.memory[1], reduction.free
        self._y, self._driven = z[:free].copy(), z[free : free + reduction.driven]
        if np.array_equal(reduction.independent, self.unknowns.independent):
            return False
        self.unknowns = unknowns_of(self.form)
        return True

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
        model, rates, reduction = self.model, self.model.scheme.rates, self.model.reduction
        self._y[self.unknowns.independent] = y
        D = self.memory[0][:] = reduction.increment(self._y, self._driven)
        if not abs(D[model.mesh.turns]).max() <= self._max_turn:
            constants, closed = self.loop.problem.constants, np.isfinite(D).all()
            raise NoConfigurationError(constants.TURNED_TOO_FAR if closed else constants.OPEN_LOOP)
        self._path, self._slope = rates.work_increment(D, model.mesh.turns)
        self.internal, self._added = self.form.residual(D)
        r = self.forces = self.internal + self._added - self._force
        if not rates.at_rest:
            r += self.form.mass @ self._acceleration(D)
        model.forms.compiled_points.add_force(D, r)

    def _acceleration(self, D: np.ndarray) -> np.ndarray:
        """Nodal accelerations (size,); their derivatives by the increment are kept."""
        state, dt = self._start, self._interval.length
        if not (rules := self.model.forms.nodal_rules):
            rates = self.model.scheme.rates
            a, self._steepness = rates.acceleration(self._path, state.v, state.a, dt)
            return a
        past = state.q - (state.q if state.q_previous is None else state.q_previous)
        nodes = self.model.mesh.dofs
        rows = [x[nodes] for x in (D, state.v, state.a, past)] + [np.full((len(nodes), 1), dt)]
        rule = rules[self.loop.problem.c.run.sub_step % len(rules)]
        values = rule.in_rows(np.hstack(rows))
        self._by_increment = values[:, 3:12].reshape(-1, 3, 3)
        return values[:, :3].ravel()

    def finish(self, dt: float) -> None:
        """Hand the increment, its forces and the work of added terms over to the engine."""
        p, (_, z, r, f) = self.loop.problem.c, self.memory
        z[: self.model.reduction.free], r[:], f[:] = self._y, self.forces, self.internal
        state = p.state
        state.work -= self._mean_added(state.t, dt) @ self._path

    def _mean_added(self, t: float, dt: float) -> np.ndarray:
        """Forces of added terms (size,) in mid-step, from forces at the levels of steps."""
        level, (end, previous) = self.model.scheme.rates.level, self._last_added
        self._last_added = t + dt, self._added
        if level == 0.5 or not np.isclose(end, t, rtol=1e-12, atol=1e-9 * abs(dt)):
            return self._added
        return self._added + (0.5 - level) * (self._added - previous)

    def tangent(self) -> PETSc.Mat:
        """The reduced tangent where forces were found last."""
        model, mass, values = self.model, self.form.mass, np.zeros(self.form.pattern.nnz)
        added = None
        if model.forms.nodal_rules:
            nodes = np.arange(len(self._by_increment) + 1)
            blocks = self._by_increment, nodes[:-1], nodes
            added = mass @ scipy.sparse.bsr_matrix(blocks, mass.shape).tocsr()
        elif not model.scheme.rates.at_rest:
            values += mass.data * (self._steepness * self._slope)[mass.indices]
        model.forms.compiled_points.add_tangent(values)
        if model.points.members is not None:
            member_tangent = model.points.members.tangent()
            added = member_tangent if added is None else added + member_tangent
        self.unknowns.assemble(values, added, self._y, self._driven, self.forces)
        return self.unknowns.A
