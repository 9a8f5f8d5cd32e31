"""Rates that fit the joints, and the impulses of joints and supports that make them fit.

The mid-point rule leaves in the rates a part that joints do not allow: v1 = 2 Du/dt - v0. It
alternates from step to step, and hardly enters the motion, but forces of a step contain its change.
The nearest rates in the norm of the mass are without it:

    v* = v + c    with    M c = G^T mu,    G v* = g

The joints exert the impulses mu. So their mean force over a step is that of the step, plus the
increment of mu, divided by the length of the step.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.coupling.rate_equations import RateEquations

from .rate_derivatives import RateDerivatives
from .rate_solver import RateSolver


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions.

    `equations` gives those of the scene, with or without rigid points; `mass` (size, size) is that
    of the scene, `unit` (size,) the size of a unit increment.
    """

    def __init__(
        self,
        equations: Callable[[bool], RateEquations],
        mass: scipy.sparse.csr_matrix,
        unit: np.ndarray,
    ):
        self._equations, self._mass, self._unit = equations, mass, unit

    @functools.cached_property
    def _solver(self) -> RateSolver:
        return RateSolver(self._equations(False), self._mass, self._unit)

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        return Fit(*self._solver.fit(q, v, slides, driven, driven=driven.shape[1]))

    @functools.cached_property
    def _solver_of_all(self) -> RateSolver:
        return RateSolver(self._equations(True), self._mass, self._unit, all_rates=True)

    def derivatives(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray
    ) -> RateDerivatives:
        """What `fit` found for n configurations, and its derivatives; all as there."""
        return RateDerivatives(self._solver_of_all, self._mass, q, v, slides, driven)
