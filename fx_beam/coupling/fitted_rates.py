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
from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam import c_library
from fx_beam.results.state import MACROS
from fx_beam.structs import Structs

from .rate_derivatives import RateDerivatives
from .rate_equations import RateEquations
from .rate_masses import tables_of_masses
from .rigid_points import RigidPoints

# Mass of what has none, relative to the least mass that there is. Repetitions remove its effect: at
# most so many, until corrections are below round-off.
_LITTLE, _REPETITIONS, _ROUND_OFF = 1e-6, 20, 1e-14


_LIBRARY = "rates of joints", "fitted_rates.c", "fitted_rates.h", MACROS


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions, by fitted_rates.c.

    `mass` (size, size) is that of the scene, `unit` (size,) the size of a unit increment.
    """

    def __init__(
        self, equations: RateEquations, points: RigidPoints, mass: scipy.sparse.csr_matrix, unit
    ):
        #: Masses with the little ones (size,) of what has none.
        self._little = _little_mass(mass, unit)
        self._of_scene = equations, mass
        self._mass = (mass + scipy.sparse.diags(self._little)).tocsc()
        self._at, self._rows = (points.row, points.dof), len(points.remaining)
        of_masses = tables_of_masses(*self._at, self._rows, self._mass, self._little)
        #: Whether C solves the equations. Otherwise each configuration has a sparse matrix.
        self.in_c = of_masses["width"] > 0 or not self._rows
        #: Values of the entries, what each equation lacks, and multipliers.
        self._entry, self._lacking, self._multipliers = (
            np.zeros(n) for n in (len(points.row), self._rows, self._rows)
        )
        ffi, self._library = c_library.kept_library(*_LIBRARY)
        self._of = functools.partial(ffi.from_buffer, ffi.typeof("double[]"))
        self._structs = structs = Structs(ffi, c_library.declarations("fitted_rates.h"))
        self._c = ffi.new("RateFit *")
        structs.set(
            self._c,
            **equations.tables(),
            **points.tables(),
            **of_masses,
            entry=self._entry,
            lacking=self._lacking,
            multiplier=self._multipliers,
        )
        structs.set(self._c, scratch=np.zeros(self._library.fx_fit_scratch(self._c)))
        structs.check(self._c)

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        n, c = len(q), self._c
        c.driven = driven.shape[1]
        fit = Fit(np.empty(v.shape), np.zeros(v.shape), *self._forces(n))
        given = [np.ascontiguousarray(x) for x in (q, v, slides, driven)]
        if self.in_c:
            self._library.fx_fit(c, n, *map(self._of, (*given, *fit)))
            return fit
        factored = np.full(len(self._entry), np.nan)
        for k in range(n):
            self._library.fx_begin_fit(c, *(self._of(x[k]) for x in given))
            if (self._entry != factored).any():
                factored = self._entry.copy()
                factors = scipy.sparse.linalg.splu(self._saddle())
            self._solve(factors, fit.corrections[k])
            self._library.fx_end_fit(c, self._of(given[1][k]), *(self._of(x[k]) for x in fit))
        return fit

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Numbers of the scene that rates depend on, besides masses and driven rates."""
        tables = self._of_scene[0].tables()
        return {"arms of joints": tables["apart"], "axes of joints": tables["slide_axis"]}

    def derivatives(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray
    ) -> RateDerivatives:
        """What `fit` found for n configurations, and its derivatives; all as there."""
        return RateDerivatives(*self._of_scene, self._little, q, v, slides, driven)

    def _forces(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        return np.empty((n, self._c.joints, 3)), np.empty((n, self._c.columns))

    def _solve(self, factors, c: np.ndarray) -> None:
        """Set the corrections (size,) and the multipliers."""
        size, little = len(c), self._little
        for _ in range(_REPETITIONS):
            x, before = factors.solve(np.append(little * c, self._lacking)), c.copy()
            c[:], self._multipliers[:] = x[:size], -x[size:]
            small = _ROUND_OFF * abs(c).max()
            if not little.any() or abs(c - before)[little > 0].max() <= small:
                break

    def _saddle(self) -> scipy.sparse.csc_matrix:
        """Matrix of the rates and of the negative multipliers."""
        G = scipy.sparse.csr_matrix((self._entry, self._at), (self._rows, len(self._little)))
        G.eliminate_zeros()  # a node that slides has entries of the whole beam
        return scipy.sparse.bmat([[self._mass, G.T], [G, None]], format="csc")


def _little_mass(mass: scipy.sparse.csr_matrix, unit: np.ndarray) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    return np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)
