"""Inertia of a step: rates are nodal (eqs 27 to 30), so that it is no integral of UFL."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.fem.compiled_laws import PointFunction
from fx_beam.results.state import State
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.model import fact, led_dofs


class Inertia:
    """Forces M a (size,) of nodal accelerations a(D), and their tangent M da/dD."""

    def __init__(self, loop: CompiledLoop):
        self._loop, self._model, self._mass = loop, loop.model, loop.model.masses.matrix
        #: Slopes da/dD: of each degree of freedom (size,), or of nodes (nodes, 3, 3).
        self._slopes = np.zeros(0)
        self._led = np.zeros(loop.model.size)

    def begin(self, start: State, dt: float, D: np.ndarray) -> np.ndarray:
        """Begin a sub-step of length `dt` at a state, with increments (size,) of driven motions.

        Gives the accelerations (size,) beside those of the rule, of what these alone move.
        """
        self._start, self._dt = start, dt
        led, rates = fact(self._model, led_dofs), self._model.scheme.rates
        if not len(led):
            return self._led
        v, a, D = start.v[led], start.a[led], D[led]
        before, earlier = (start.length, start.length_before) if start.length else (dt, dt)
        means = [v - dt / 2 * a, D / dt]
        if start.length and start.q_previous is not None:
            means[0] = (start.q - start.q_previous)[led] / before
        # The third derivative of the cubic through the last places, and the second at the level.
        bends = (v - means[0]) / before, (means[1] - means[0]) / (before + dt)
        third = 6 * (bends[1] - bends[0]) / (earlier + before + dt)
        at_level = 2 * bends[1] + third * ((before + 2 * dt) / 3 - (1 - rates.level) * dt)
        self._led[led] = at_level - rates.acceleration(D, v, a, dt)[0]
        return self._led

    def force(self, D: np.ndarray) -> np.ndarray:
        """M a (size,) at increments D (size,)."""
        rates, start = self._model.scheme.rates, self._start
        if rules := self._model.forms.nodal_rules:
            rule = rules[self._loop.problem.c.work.run.sub_step % len(rules)]
            return self._mass @ self._by_rule(rule, D)
        path, slope = rates.work_increment(D, self._model.mesh.turns)
        a, steepness = rates.acceleration(path, start.v, start.a, self._dt)
        self._slopes = steepness * slope
        return self._mass @ (a + self._led)

    def _by_rule(self, rule: PointFunction, D: np.ndarray) -> np.ndarray:
        """Accelerations (size,) by a nodal rule of a user."""
        start, nodes = self._start, self._model.mesh.dofs
        previous = start.q if start.q_previous is None else start.q_previous
        rows = [x[nodes] for x in (D, start.v, start.a, start.q - previous)]
        values = rule.in_rows(np.hstack([*rows, np.full((len(nodes), 1), self._dt)]))
        self._slopes = values[:, 3:12].reshape(-1, 3, 3)
        return values[:, :3].ravel()

    def with_tangent(self, K: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """K + M da/dD, where forces were found last, for K in M's sparsity.

        Slopes by rules of a user couple nodes' components: the sum has more entries.
        """
        if self._slopes.ndim == 1:
            K.data += self._mass.data * self._slopes[self._mass.indices]
            return K
        nodes = np.arange(len(self._slopes) + 1)
        blocks = self._slopes, nodes[:-1], nodes
        return K + self._mass @ scipy.sparse.bsr_matrix(blocks, self._mass.shape).tocsr()
