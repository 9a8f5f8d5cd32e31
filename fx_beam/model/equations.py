"""The equations of a step, reduced to the unknowns that supports and joints leave."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.mechanics.interval import Interval
from fx_beam.results.state import State

from .model import Model


class Balance(NamedTuple):
    """The equations at one increment.

    Parameters
    ----------
    D : (size,) float
        Increment of displacements and rotations.
    f : (size,) float
        Internal forces and couples less the added ones [N, N m]; overwritten by the next.
    r : (size,) float
        Forces and couples out of balance at the nodes: those of supports and joints [N, N m].
    residual : (columns,) float
        The same reduced: zero in the unknowns, the forces of supports in the other columns.
    """

    D: np.ndarray
    f: np.ndarray
    r: np.ndarray
    residual: np.ndarray


class Equations:
    """That^T r = 0 with r = M a(D) + f(D) - F (eqs 43 and 46), at the scheme's level of a step.

    Parameters
    ----------
    model : Model
        Forms, matrices and couplings.
    time : float
        In statics the time at which functions of time are taken [s].
    """

    def __init__(self, model: Model, time: float = 0.0):
        self.model, self.time = model, time
        self._reduction = model.reduction

    def begin(self, interval: Interval, start: State) -> None:
        """Set the step, by its interval and the state at its start."""
        model, q = self.model, start.q
        self._start, self._length = start, interval.length
        if model.scheme.rates.at_rest:
            # The interval is one of the load factor; nothing depends on its length.
            model.forms.load_factor.value = interval.end
            model.forms.set_step(self.time, 0.0, q, start.v, start.a)
            model.reduction.begin(q, start.slides, 1.0)
        else:
            model.actuators.set_rates(q, start.v, start.slides)
            model.forms.set_step(interval.start, interval.length, q, start.v, start.a)
            model.reduction.begin(q, start.slides, interval.length)

    def at(self, y: np.ndarray, driven: np.ndarray, force: np.ndarray) -> Balance:
        """The equations at an increment, for which the tangent is assembled as well.

        Parameters
        ----------
        y : (free,) float
            Increment of the unknowns.
        driven : (driven,) float
            Increments of prescribed motions and motors [m, rad].
        force : (size,) float
            External dead forces at the scheme's level [N, N m].
        """
        model, rates, K = self.model, self.model.scheme.rates, self.model.forms.stiffness
        D = self._reduction.expand(y, driven)
        f = model.forms.internal_force(D)
        model.forms.assemble_stiffness()
        r = f - force
        if not rates.at_rest:
            start = self._start
            a, slope = rates.acceleration(D, start.v, start.a, self._length, model.turns)
            r += model.mass @ a
            K.data += model.mass.data * slope[K.indices]
        return Balance(D, f, r, self._reduction.project(r))

    def at_start(self, force: np.ndarray) -> Balance:
        """The equations at no increment."""
        free, driven = self._reduction.free, self._reduction.driven
        return self.at(np.zeros(free), np.zeros(driven), force)

    def fill_tangent(self, r: np.ndarray, values: np.ndarray) -> None:
        """Write the reduced tangent, of the reduction's pattern, for forces r at the nodes."""
        self._reduction.fill(self.model.forms.stiffness.data, r, values)

    def tangent(self, r: np.ndarray) -> scipy.sparse.csr_matrix:
        """Reduced tangent (free, free) for forces r at the nodes."""
        indptr, indices = self._reduction.pattern
        values = np.empty(len(indices))
        self.fill_tangent(r, values)
        return scipy.sparse.csr_matrix((values, indices, indptr), (self._reduction.free,) * 2)
