"""The equations of a step, reduced to the unknowns by supports and joints."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.fem.compiled_laws import NodalRules
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State

from .model import Model
from .turning_frame import TurningFrame


class Balance(NamedTuple):
    """Residual of the equations at one increment, and its parts."""

    #: Increment (size,) of displacements and rotations.
    D: np.ndarray
    #: Internal minus added forces (size,) [N, N m]; the next evaluation overwrites them.
    f: np.ndarray
    #: Full residual (size,) at the nodes: the forces of supports and joints [N, N m].
    r: np.ndarray
    #: Reduced residual (columns,): zero for the unknowns, support forces in the other columns.
    residual: np.ndarray


class Equations:
    """Tv^T r = 0 with r = M a(D) + f(D) - F (eqs 43 and 46), at the scheme's level of a step.

    In statics, functions of time are evaluated at one `time` [s], and the scene may rest in a frame
    that turns. ``natural(end)`` gives the natural strains at the end of a step; without, they are
    those at its start.
    """

    def __init__(
        self,
        model: Model,
        time: float = 0.0,
        turning: TurningFrame | None = None,
        natural: Callable[[float], np.ndarray | None] | None = None,
    ):
        self.model, self.time, self._turning = model, time, turning
        self._natural = natural
        self._reduction = model.reduction
        #: Number of the sub-step of the scheme.
        self.sub_step = 0

    def begin(self, interval: Interval, start: State) -> None:
        """Set the interval of a step and the state at its start."""
        model = self.model
        self._start, self._length, end = start, interval.length, interval.end
        model.reduction.begin(start.q, start.slides)
        if model.scheme.rates.at_rest:
            # The interval is one of load factors; only internal variables depend on its length.
            model.forms.set_load(interval.end, interval.length)
            interval = Interval(self.time, self.time)
        model.forms.begin(interval, model.start_of(start, interval.length))
        if self._natural is not None:
            model.forms.set_natural_end(self._natural(end))

    def at(self, y: np.ndarray, driven: np.ndarray, force: np.ndarray) -> Balance:
        """Evaluate at increments of the unknowns y (free,) and of driven motion (driven,).

        `force` (size,) has the dead loads at the scheme's level. Also assembles the tangent.
        """
        model, rates, K = self.model, self.model.scheme.rates, self.model.forms.stiffness
        D = self._reduction.expand(y, driven)
        f = model.forms.internal_force(D)
        model.forms.assemble_stiffness()
        r = f - force
        if not rates.at_rest:
            r += model.mass @ self._inertia(D, K)
        elif (frame := self._turning) is not None:
            factor, _ = model.forms.load
            r -= factor * frame.force(self._start.q + D)
            K.data -= factor * frame.spin**2 * frame.mass.data
        return Balance(D, f, r, self._reduction.project(r))

    def _inertia(self, D: np.ndarray, K: scipy.sparse.csr_matrix) -> np.ndarray:
        """Acceleration (size,) in the equation of motion; adds the tangent of its forces to K."""
        model, start = self.model, self._start
        if (rules := model.nodal_rules) is None:
            rates = model.scheme.rates
            a, slope = rates.acceleration(D, start.v, start.a, self._length, model.turns)
            at, values, columns = model.masses
            K.data[at] += values * slope[columns]
            return a
        nodal = self._nodal(rules, D)
        rules.add_tangent(nodal, K.data)
        return rules.to_vector(nodal[:, :3])

    def _nodal(self, rules: NodalRules, D: np.ndarray) -> np.ndarray:
        """Values (nodes, VALUES) of the nodal rules."""
        start = self._start
        before = np.zeros_like(D) if start.q_previous is None else start.q - start.q_previous
        parts = D, start.v, start.a, before, self._length
        return rules.at(self.sub_step, *parts)

    def at_start(self, force: np.ndarray) -> Balance:
        """Evaluate at the start of the step: the increment is zero."""
        free, driven = self._reduction.free, self._reduction.driven
        return self.at(np.zeros(free), np.zeros(driven), force)

    def change(self, D: np.ndarray) -> np.ndarray:
        """Change (size,) of the forces with a small change of all degrees of freedom."""
        return self.model.forms.tangent @ D

    def change_of_sizes(self, D: np.ndarray) -> np.ndarray:
        """The same with the sizes of all entries of the tangent."""
        return abs(self.model.forms.tangent) @ D

    def fill_tangent(self, r: np.ndarray, values: np.ndarray) -> None:
        """Write the values of the reduced tangent, for the full residual r."""
        self._reduction.fill(self.model.forms.stiffness.data, r, values)

    def system(self, r: np.ndarray) -> scipy.sparse.csr_matrix:
        """Matrix (n, n) of the linear system for the full residual r, with contact of members.

        Its sparsity, but for this contact, is that of the reduction.
        """
        indptr, indices = self._reduction.pattern
        values = np.empty(len(indices))
        self.fill_tangent(r, values)
        n = len(indptr) - 1
        K = scipy.sparse.csr_matrix((values, indices, indptr), (n, n))
        if (members := self.model.points.members) is None:
            return K
        own, more = K.tocoo(), self._reduction.reduced(members.tangent()).tocoo()
        pairs = np.append(own.row, more.row), np.append(own.col, more.col)
        return scipy.sparse.csr_matrix((np.append(own.data, more.data), pairs), (n, n))

    def tangent(self, r: np.ndarray) -> scipy.sparse.csr_matrix:
        """Reduced tangent (free, free) for the full residual r."""
        return self._reduction.condensed(self.system(r))
